"""Q-learning on a finite MDP of 1000 states, 4 actions and 5 successors, in Numba."""

import numpy as np

from benchmarks.numba_tools import (
    ACTIONS,
    LOW_24,
    U,
    best,
    epsilon_greedy_40,
    four_in_turn,
    generator,
    inline,
    one_after_another,
    rounds,
    values_of,
    xoshiro256pp,
)
from benchmarks.problems import ALPHA, garnet
from benchmarks.rounds import Round

STEP_SIZE = np.float32(ALPHA)


def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(edges uint32, entered uint16, reward float32), of each flat (S, A): 4, 8 and 1.

    S' is successor k where k of the edges are not above 24 random bits. In `entered` a state is where its
    row begins, plus 1 where it is terminal.
    """
    mdp = garnet()
    edges = np.round(mdp.prob.cumsum(-1)[..., :-1] * 2**24).astype(np.uint32)
    entered = np.zeros((*mdp.reward.shape, 8), np.uint16)
    entered[..., : mdp.successors.shape[-1]] = ACTIONS * mdp.successors + mdp.terminal[mdp.successors]
    return edges.ravel(), entered.ravel(), mdp.reward.astype(np.float32).ravel()


EDGES, ENTERED, REWARDS = _tables()


@inline
def step(q, lane):
    row, a, episodes, rng = lane
    word, rng = xoshiro256pp(rng)  # 24 bits for S', 20 for exploring and 20 for the action
    here = row + a
    below, edge = np.uint32(word & LOW_24), here << U(2)
    k = U(EDGES[edge] <= below) + U(EDGES[edge + U(1)] <= below)
    k += U(EDGES[edge + U(2)] <= below) + U(EDGES[edge + U(3)] <= below)
    into = U(ENTERED[(here << U(3)) + k])
    done = into & U(1)
    row = into - done
    q[here] += STEP_SIZE * (REWARDS[here] + best(q, row) - q[here])  # the rows of terminal states stay 0
    row *= U(1) - done  # episodes start in state 0
    return row, epsilon_greedy_40(values_of(q, row), word), episodes + done, rng


@inline
def begin(q, seed):
    """A lane at time 0: (row of S, A, episodes, generator)."""
    word, rng = xoshiro256pp(generator(seed))
    return U(0), word >> U(62), U(0), rng


def lane_by_lane(lanes: int, steps: int) -> Round:
    """One lane after another; the outcome of a lane is its number of episodes."""
    return rounds(one_after_another(begin, step), lanes, REWARDS.size, steps)


def four_abreast(lanes: int, steps: int) -> Round:
    """Four lanes in turn; the number of lanes must be a multiple of 4."""
    return rounds(four_in_turn(begin, step), lanes, REWARDS.size, steps)
