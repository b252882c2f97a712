"""Sarsa(lambda) with accumulating traces on the windy gridworld, in Numba: exact, no trace is cut off.

What was tried, with the time of a step (ratios within a run on a busy core, EPYC 7003):

- A list of the pairs visited in this episode, whose traces alone are not 0: 1.5. Episodes are long at first,
  and a scattered walk over dozens of pairs costs more than all 280 in vector operations.
- **All pairs in vector operations**: 1.0, once the index is unsigned (2.2 with a signed one, which Numba does
  not vectorise). What bounds it is loading and storing both Q and the traces.
- **Traces that fade by a common scale** instead of one by one: 0.7, for the table of traces is not written.
  `every_pair` is this, and the bar.
- **Fast online traces** (Wiering and Schmidhuber 1998), which postpone what a pair is credited with until
  somebody reads it: 0.4. `when_read` is this. It is another algorithm with the same results: a step costs the
  same however many pairs there are. Float64, for a difference of sums is taken.
"""

import numba  # pyright: ignore[reportMissingImports] (of the extra "bench")
import numpy as np

from benchmarks.numba_tools import U, epsilon_greedy, generator, inline, rounds, xoshiro256pp
from benchmarks.numba_windy import GOAL_ROW, NEXT_ROW, REWARD, START_ROW
from benchmarks.problems import ALPHA_OF_TRACES, LAMBDA
from benchmarks.rounds import Round

PAIRS = U(NEXT_ROW.size)


def every_pair(lanes: int, steps: int) -> Round:
    """All of Q in every step; the outcome of a lane is its number of episodes.

    The trace of a pair is z = scale * marks.
    """
    ONE, ALPHA, FADE, SMALL = (np.float32(x) for x in (1, ALPHA_OF_TRACES, LAMBDA, 1e-12))

    @numba.njit(parallel=True, error_model="numpy")
    def kernel(seeds, tables, episodes, steps):
        for i in numba.prange(seeds.size):
            q, marks = tables[i], np.zeros(PAIRS, np.float32)
            word, rng = xoshiro256pp(generator(seeds[i]))
            row, a, finished = START_ROW, epsilon_greedy(q, START_ROW, word), U(0)
            scale = mark = ONE
            for _ in range(steps):
                word, rng = xoshiro256pp(rng)
                here = row + a
                row = U(NEXT_ROW[here])
                a = epsilon_greedy(q, row, word)
                delta = REWARD + q[row + a] - q[here]  # the goal's row stays 0
                marks[here] += mark
                step = ALPHA * delta * scale
                for k in range(PAIRS):
                    q[k] += step * marks[k]
                scale *= FADE
                mark *= ONE / FADE
                done = row == GOAL_ROW
                if done or scale < SMALL:
                    kept = np.float32(0) if done else scale
                    for k in range(PAIRS):
                        marks[k] *= kept
                    scale = mark = ONE
                if done:
                    row = START_ROW
                    a = epsilon_greedy(q, row, word)
                    finished += U(1)
            episodes[i] = finished

    return rounds(kernel, lanes, NEXT_ROW.size, steps)


def when_read(lanes: int, steps: int) -> Round:
    """Each pair of Q when it is read; the outcome of a lane is its number of episodes.

    With `credit` the sum of alpha delta scale over the steps of this episode, Q is
    settled + marks (credit - settled_at).
    """
    ONE, ALPHA, FADE, SMALL = (np.float64(x) for x in (1, ALPHA_OF_TRACES, LAMBDA, 1e-6))

    @inline
    def value(table, credit, pair):
        settled, marks, settled_at = table
        return settled[pair] + marks[pair] * (credit - settled_at[pair])

    @inline
    def read_row(q_row, table, credit, row):
        q_row[U(0)] = value(table, credit, row)
        q_row[U(1)] = value(table, credit, row + U(1))
        q_row[U(2)] = value(table, credit, row + U(2))
        q_row[U(3)] = value(table, credit, row + U(3))

    @numba.njit(parallel=True, error_model="numpy")
    def kernel(seeds, tables, episodes, steps):
        for i in numba.prange(seeds.size):
            settled, marks, settled_at = np.zeros(PAIRS), np.zeros(PAIRS), np.zeros(PAIRS)
            table = settled, marks, settled_at
            q_row = np.zeros(4, np.float32)
            word, rng = xoshiro256pp(generator(seeds[i]))
            row, a, finished = START_ROW, epsilon_greedy(q_row, U(0), word), U(0)
            scale = mark = ONE
            credit = np.float64(0)
            for _ in range(steps):
                word, rng = xoshiro256pp(rng)
                here = row + a
                row = U(NEXT_ROW[here])
                read_row(q_row, table, credit, row)
                a = epsilon_greedy(q_row, U(0), word)
                q = value(table, credit, here)
                delta = REWARD + q_row[a] - q  # the goal's row stays 0
                settled[here] = q
                settled_at[here] = credit
                marks[here] += mark
                credit += ALPHA * delta * scale
                scale *= FADE
                mark *= ONE / FADE
                done = row == GOAL_ROW
                if done or scale < SMALL:
                    kept = np.float64(0) if done else scale
                    for k in range(PAIRS):
                        settled[k] += marks[k] * (credit - settled_at[k])
                        settled_at[k] = 0
                        marks[k] *= kept
                    scale = mark = ONE
                    credit = np.float64(0)
                if done:
                    row = START_ROW
                    read_row(q_row, table, credit, row)
                    a = epsilon_greedy(q_row, U(0), word)
                    finished += U(1)
            for k in range(PAIRS):
                tables[i, k] = value(table, credit, k)
            episodes[i] = finished

    return rounds(kernel, lanes, NEXT_ROW.size, steps)
