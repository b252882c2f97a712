"""Q-learning and Sarsa on the windy gridworld in Numba, as fast as we could make them: the bar.

What helps, with the time of a step of Q-learning on one core of a 2021 server (EPYC 7003), where a plain loop
with branches for ties, exploration and walls took 25 ns:

- **No branch that cannot be predicted.** The maximal actions of a row become four bits, exploring sets all
  four, and one table look-up turns bits and a random number into an action. Walls and wind are a table, too.
  (17 ns)
- **Four lanes abreast.** A step is a chain of dependent loads, so one lane leaves the core idle most of the
  time. A core that works on four lanes in turn always has something to do. (8 ns)

A step takes one word of 64 bits.
"""

import numpy as np

from benchmarks.numba_tools import (
    ACTIONS,
    U,
    best,
    epsilon_greedy,
    four_in_turn,
    generator,
    inline,
    one_after_another,
    rounds,
    xoshiro256pp,
)
from benchmarks.problems import ALPHA, GOAL, START, windy_successors
from benchmarks.rounds import Round

START_ROW, GOAL_ROW = U(START * ACTIONS), U(GOAL * ACTIONS)
STEP_SIZE, REWARD = np.float32(ALPHA), np.float32(-1)
NEXT_ROW = (ACTIONS * windy_successors()).astype(np.uint16).ravel()  # where the row of S' begins


@inline
def begin(q, seed):
    """A lane at time 0: (row of S, A, episodes, generator)."""
    word, rng = xoshiro256pp(generator(seed))
    return START_ROW, epsilon_greedy(q, START_ROW, word), U(0), rng


@inline
def q_learning(q, lane):
    row, a, episodes, rng = lane
    word, rng = xoshiro256pp(rng)
    here = row + a
    row = U(NEXT_ROW[here])
    q[here] += STEP_SIZE * (REWARD + best(q, row) - q[here])  # the goal's row stays 0
    done = U(row == GOAL_ROW)
    row -= done * (GOAL_ROW - START_ROW)
    return row, epsilon_greedy(q, row, word), episodes + done, rng


@inline
def sarsa(q, lane):
    row, a, episodes, rng = lane
    word, rng = xoshiro256pp(rng)
    here = row + a
    row_next = U(NEXT_ROW[here])
    done = U(row_next == GOAL_ROW)
    row = row_next - done * (GOAL_ROW - START_ROW)
    # At the goal this is the first action of the next episode, chosen before the update. Here it is the same:
    # the last update of an episode never touches the row of the start, which is not next to the goal.
    a = epsilon_greedy(q, row, word)
    q[here] += STEP_SIZE * (REWARD + q[row_next + a] - q[here])  # the goal's row stays 0
    return row, a, episodes + done, rng


STEP = {"q-learning": q_learning, "sarsa": sarsa}


def lane_by_lane(method: str, lanes: int, steps: int) -> Round:
    """One lane after another; the outcome of a lane is its number of episodes."""
    return rounds(one_after_another(begin, STEP[method]), lanes, NEXT_ROW.size, steps)


def one_run(method: str, steps: int) -> Round:
    return lane_by_lane(method, 1, steps)


def four_abreast(method: str, lanes: int, steps: int) -> Round:
    """Four lanes in turn; the number of lanes must be a multiple of 4."""
    return rounds(four_in_turn(begin, STEP[method]), lanes, NEXT_ROW.size, steps)
