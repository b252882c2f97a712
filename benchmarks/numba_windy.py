"""Methods that take one step after another, on the windy gridworld in Numba, as fast as we could make them: the bar.

What helps, with the time of a step of Q-learning on one core of a 2021 server (EPYC 7003), where a plain loop
with branches for ties, exploration and walls took 25 ns:

- **No branch that cannot be predicted.** The maximal actions of a row become four bits, exploring sets all
  four, and one table look-up turns bits and a random number into an action. Walls and wind are a table, too.
  (17 ns)
- **Four lanes abreast.** A step is a chain of dependent loads, so one lane leaves the core idle most of the
  time. A core that works on four lanes in turn always has something to do. (8 ns)

A step takes one word of 64 bits. On one core of a 2023 server (EPYC, family 25, model 17, AVX-512), all in one
run, a step takes, lane by lane and four abreast, in ns:

    Q-learning 12.0, 4.5    Sarsa 11.8, 4.4    Expected Sarsa 12.7, 4.9    double Q-learning 15.5, 8.1
    4-step Sarsa 11.0, 5.3

What was tried of the last three, there:

- **Expected Sarsa**: the greedy actions share 1 - epsilon and have the same value, so the mean needs no
  division: epsilon times the mean of the row, plus 1 - epsilon times its largest value.
- **Double Q-learning**: the coin chooses where a table begins, and no branch is taken. Of two tables one after
  the other a step took 15.4 and 7.9; with the rows of both side by side 15.5 and 8.4, with their entries side by
  side 15.8 and 7.5. A third table, of sums, costs as much as it spares: 15.7 and 8.1.
- **4-step Sarsa**: the last three pairs share a word, 16 bits each, so nothing is stored but Q. In the first
  three steps of an episode an entry learns that nobody reads, which spares a branch: 11.0 and 5.3. A ring in
  memory took 11.7, and 7.9 abreast; three variables took 12.9 and 6.1. The branch that is left comes once an
  episode, in some fifty steps. It can go, too: the last three pairs may as well learn in the first three steps
  of the next episode, for those read nothing that they change. That gained nothing (11.8 and 5.4).

To compare pairs of actions first, and so to spare a few cycles of the chain, made LLVM put in branches: 1.3 to
2.4 times as long.
"""

import numpy as np

from benchmarks.numba_tools import (
    ACTIONS,
    LOW_20,
    U,
    best,
    epsilon_greedy,
    epsilon_greedy_40,
    four_in_turn,
    generator,
    inline,
    larger,
    one_after_another,
    one_of,
    rounds,
    values_of,
    xoshiro256pp,
)
from benchmarks.problems import ALPHA, EPSILON, GOAL, START, windy_successors
from benchmarks.rounds import Round, warm

START_ROW, GOAL_ROW = U(START * ACTIONS), U(GOAL * ACTIONS)
STEP_SIZE, REWARD = np.float32(ALPHA), np.float32(-1)
NEXT_ROW = (ACTIONS * windy_successors()).astype(np.uint16).ravel()  # where the row of S' begins
PAIRS = U(NEXT_ROW.size)


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


# --- Expected Sarsa ----------------------------------------------------------------------------------

OF_BEST, OF_EACH = np.float32(1 - EPSILON), np.float32(EPSILON / ACTIONS)


@inline
def expected_sarsa(q, lane):
    row, a, episodes, rng = lane
    word, rng = xoshiro256pp(rng)
    here = row + a
    row = U(NEXT_ROW[here])
    q0, q1, q2, q3 = values_of(q, row)
    high = larger(larger(q0, q1), larger(q2, q3))
    mean = OF_BEST * high + OF_EACH * ((q0 + q1) + (q2 + q3))
    q[here] += STEP_SIZE * (REWARD + mean - q[here])  # the goal's row stays 0
    done = U(row == GOAL_ROW)
    row -= done * (GOAL_ROW - START_ROW)
    return row, epsilon_greedy(q, row, word), episodes + done, rng


# --- double Q-learning -------------------------------------------------------------------------------


@inline
def double_q_learning(q, lane):
    """In `q` Q1 comes first, and Q2 follows it."""
    row, a, episodes, rng = lane
    word, rng = xoshiro256pp(rng)  # 1 bit for the coin, 20 for a tie in the target, 20 to explore, 20 for A'
    learns = (word & U(1)) * PAIRS
    here = row + a
    row = U(NEXT_ROW[here])
    tie = (((word >> U(4)) & LOW_20) * U(12)) >> U(20)
    a_best = one_of(values_of(q, row + learns), False, tie)
    q_next = q[row + (PAIRS - learns) + a_best]  # the goal's rows stay 0
    q[here + learns] += STEP_SIZE * (REWARD + q_next - q[here + learns])
    done = U(row == GOAL_ROW)
    row -= done * (GOAL_ROW - START_ROW)
    q0, q1, q2, q3 = values_of(q, row)
    p0, p1, p2, p3 = values_of(q, row + PAIRS)
    return row, epsilon_greedy_40((q0 + p0, q1 + p1, q2 + p2, q3 + p3), word), episodes + done, rng


# --- 4-step Sarsa ------------------------------------------------------------------------------------

PAIR = U(2**16 - 1)
NONE = PAIRS << U(32) | PAIRS << U(16) | PAIRS  # the first entry behind Q, thrice
FOUR, THREE, TWO = (np.float32(n * REWARD) for n in (4, 3, 2))  # rewards


@inline
def begin_4_step(q, seed):
    """A lane at time 0: as in `begin`, and the three pairs before this one, the oldest uppermost."""
    row, a, episodes, rng = begin(q, seed)
    return row, a, episodes, rng, NONE


@inline
def four_step_sarsa(q, lane):
    row, a, episodes, rng, last = lane
    word, rng = xoshiro256pp(rng)
    here = row + a
    row_next = U(NEXT_ROW[here])
    done = row_next == GOAL_ROW
    row = START_ROW if done else row_next
    a = epsilon_greedy(q, row, word)  # before the updates, as in `sarsa`: they touch no row next to the start
    oldest = (last >> U(32)) & PAIR
    q[oldest] += STEP_SIZE * (FOUR + q[row_next + a] - q[oldest])  # the goal's row stays 0
    if done:  # no episode is so short that one of these is none
        third, second = (last >> U(16)) & PAIR, last & PAIR
        q[third] += STEP_SIZE * (THREE - q[third])
        q[second] += STEP_SIZE * (TWO - q[second])
        q[here] += STEP_SIZE * (REWARD - q[here])
    last = NONE if done else last << U(16) | here
    return row, a, episodes + U(done), rng, last


# --- rounds ------------------------------------------------------------------------------------------

# For each method how a lane begins, its step, and how many numbers it learns.
METHODS = {
    "q-learning": (begin, q_learning, NEXT_ROW.size),
    "sarsa": (begin, sarsa, NEXT_ROW.size),
    "expected-sarsa": (begin, expected_sarsa, NEXT_ROW.size),
    "double-q-learning": (begin, double_q_learning, 2 * NEXT_ROW.size),
    "n-step-sarsa": (begin_4_step, four_step_sarsa, NEXT_ROW.size + ACTIONS),
}


def lane_by_lane(method: str, lanes: int, steps: int) -> Round:
    """One lane after another; the outcome of a lane is its number of episodes."""
    begin, step, numbers = METHODS[method]
    return rounds(one_after_another(begin, step), lanes, numbers, steps)


def one_run(method: str, steps: int) -> Round:
    """One lane, without threads: to start them, and to wait for them, would take as long as the run."""
    begin, step, numbers = METHODS[method]
    return warm(rounds(one_after_another(begin, step, threads=False), 1, numbers, steps))


def four_abreast(method: str, lanes: int, steps: int) -> Round:
    """Four lanes in turn; the number of lanes must be a multiple of 4."""
    begin, step, numbers = METHODS[method]
    return rounds(four_in_turn(begin, step), lanes, numbers, steps)
