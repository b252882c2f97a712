"""Tabular control in Numba, as fast as we could make it: the bar.

What helps, with the time of a step of Q-learning on one core of a 2021 server (EPYC 7003), where a plain loop
with branches for ties, exploration and walls took 25 ns:

- **No branch that cannot be predicted.** The maximal actions of a row become four bits, exploring sets all
  four, and one table look-up turns bits and a random number into an action. Walls and wind are a table, too.
  (17 ns)
- **Four lanes abreast.** A step is a chain of dependent loads, so one lane leaves the core idle most of the
  time. A core that works on four lanes in turn always has something to do. (8 ns)

Each lane has its own xoshiro256++ generator (Blackman and Vigna 2021), seeded by splitmix64, and draws one
64-bit word a step: the upper half decides on exploring, the lower half on the action. The table is float32.
"""

import time

import numba  # pyright: ignore[reportMissingImports] (of the extra "bench")
import numpy as np

from benchmarks.task import ALPHA, EPSILON, GOAL, MOVES, SHAPE, START, STEPS, WIND, Round, Timing

U = np.uint64  # all integers are unsigned: Numba then spares itself the check for negative indices
NUM_ACTIONS = len(MOVES)
START_ROW, GOAL_ROW = U(START * NUM_ACTIONS), U(GOAL * NUM_ACTIONS)  # where rows of the flat table begin
EXPLORE_BELOW = U(EPSILON * 2**32)
STEP_SIZE, REWARD = np.float32(ALPHA), np.float32(-1)


def _next_row_table() -> np.ndarray:
    """Where the row of S' begins, for each flat (S, A); uint16 [S A]."""
    rows, columns = SHAPE
    row, column = np.divmod(np.arange(rows * columns), columns)
    down, right = np.array(MOVES).T
    next_row = np.clip(row[:, None] + down - np.array(WIND)[column][:, None], 0, rows - 1)
    next_column = np.clip(column[:, None] + right, 0, columns - 1)
    return (NUM_ACTIONS * (next_row * columns + next_column)).astype(np.uint16).ravel()


def _tie_table() -> np.ndarray:
    """An action for each (set of actions as bits, number below 12), uniform; uint8, flat, in rows of 16.

    12 is divisible by 1, 2, 3 and 4, so each action of the set has equally many of the numbers.
    """
    table = np.zeros((16, 16), np.uint8)
    for bits in range(1, 16):
        actions = [a for a in range(NUM_ACTIONS) if bits >> a & 1]
        table[bits, :12] = np.repeat(actions, 12 // len(actions))
    return table.ravel()


NEXT_ROW, TIE = _next_row_table(), _tie_table()

inline = numba.njit(forceinline=True)


# --- random numbers ----------------------------------------------------------------------------------


@inline
def rotate(x, k):
    return (x << U(k)) | (x >> U(64 - k))


@inline
def splitmix64(z):
    z += U(0x9E3779B97F4A7C15)
    y = (z ^ (z >> U(30))) * U(0xBF58476D1CE4E5B9)
    y = (y ^ (y >> U(27))) * U(0x94D049BB133111EB)
    return z, y ^ (y >> U(31))


@inline
def xoshiro256pp(r0, r1, r2, r3):
    word = rotate(r0 + r3, 23) + r0
    t = r1 << U(17)
    r2 ^= r0
    r3 ^= r1
    r1 ^= r2
    r0 ^= r3
    return word, r0, r1, r2 ^ t, rotate(r3, 45)


# --- one step ----------------------------------------------------------------------------------------


@inline
def larger(x, y):
    return x if x > y else y


@inline
def best(q, row):
    """The largest value of a row."""
    return larger(larger(q[row], q[row + U(1)]), larger(q[row + U(2)], q[row + U(3)]))


@inline
def epsilon_greedy(q, row, word):
    high = best(q, row)
    bits = U(1) if q[row] == high else U(0)
    bits |= U(2) if q[row + U(1)] == high else U(0)
    bits |= U(4) if q[row + U(2)] == high else U(0)
    bits |= U(8) if q[row + U(3)] == high else U(0)
    bits = U(15) if (word >> U(32)) < EXPLORE_BELOW else bits
    below_12 = ((word & U(0xFFFFFFFF)) * U(12)) >> U(32)
    return U(TIE[(bits << U(4)) + below_12])


@inline
def begin(q, seed):
    """A lane at time 0: (row of S, A, episodes, generator)."""
    z, r0 = splitmix64(seed)
    z, r1 = splitmix64(z)
    z, r2 = splitmix64(z)
    z, r3 = splitmix64(z)
    word, r0, r1, r2, r3 = xoshiro256pp(r0, r1, r2, r3)
    return START_ROW, epsilon_greedy(q, START_ROW, word), U(0), r0, r1, r2, r3


@inline
def q_learning(q, lane):
    row, a, episodes, r0, r1, r2, r3 = lane
    word, r0, r1, r2, r3 = xoshiro256pp(r0, r1, r2, r3)
    here = row + a
    row = U(NEXT_ROW[here])
    q[here] += STEP_SIZE * (REWARD + best(q, row) - q[here])  # the goal's row stays 0
    done = U(row == GOAL_ROW)
    row -= done * (GOAL_ROW - START_ROW)
    return row, epsilon_greedy(q, row, word), episodes + done, r0, r1, r2, r3


@inline
def sarsa(q, lane):
    row, a, episodes, r0, r1, r2, r3 = lane
    word, r0, r1, r2, r3 = xoshiro256pp(r0, r1, r2, r3)
    here = row + a
    row_next = U(NEXT_ROW[here])
    done = U(row_next == GOAL_ROW)
    row = row_next - done * (GOAL_ROW - START_ROW)
    # At the goal this is the first action of the next episode, chosen before the update. Here it is the same:
    # the last update of an episode never touches the row of the start, which is not next to the goal.
    a = epsilon_greedy(q, row, word)
    q[here] += STEP_SIZE * (REWARD + q[row_next + a] - q[here])  # the goal's row stays 0
    return row, a, episodes + done, r0, r1, r2, r3


# --- all lanes ---------------------------------------------------------------------------------------


def one_at_a_time(step):
    """The kernel that runs one lane after another: (seeds uint64 [lanes], episodes int64 [lanes], out)."""

    @numba.njit(parallel=True, error_model="numpy")
    def kernel(seeds, episodes):
        for i in numba.prange(seeds.size):
            q = np.zeros(NEXT_ROW.size, np.float32)
            lane = begin(q, seeds[i])
            for _ in range(STEPS):
                lane = step(q, lane)
            episodes[i] = lane[2]

    return kernel


def four_abreast(step):
    """The kernel that runs four lanes in turn; the number of lanes must be a multiple of 4."""

    @numba.njit(parallel=True, error_model="numpy")
    def kernel(seeds, episodes):
        for block in numba.prange(seeds.size // 4):
            i = 4 * block
            q0 = np.zeros(NEXT_ROW.size, np.float32)
            q1 = np.zeros(NEXT_ROW.size, np.float32)
            q2 = np.zeros(NEXT_ROW.size, np.float32)
            q3 = np.zeros(NEXT_ROW.size, np.float32)
            lane0 = begin(q0, seeds[i])
            lane1 = begin(q1, seeds[i + 1])
            lane2 = begin(q2, seeds[i + 2])
            lane3 = begin(q3, seeds[i + 3])
            for _ in range(STEPS):
                lane0 = step(q0, lane0)
                lane1 = step(q1, lane1)
                lane2 = step(q2, lane2)
                lane3 = step(q3, lane3)
            episodes[i] = lane0[2]
            episodes[i + 1] = lane1[2]
            episodes[i + 2] = lane2[2]
            episodes[i + 3] = lane3[2]

    return kernel


def numba_peer(method: str, lanes: int, cores: int, kernel) -> Round:
    """`kernel` is `one_at_a_time` or `four_abreast`."""
    program = kernel({"q-learning": q_learning, "sarsa": sarsa}[method])
    program(np.arange(4, dtype=U), np.zeros(4, np.int64))  # compiles

    def run(seed: int) -> Timing:
        seeds = np.arange(lanes, dtype=U) + U(seed << 32)
        episodes = np.zeros(lanes, np.int64)
        numba.set_num_threads(cores)
        begun = time.perf_counter()
        program(seeds, episodes)
        return Timing(time.perf_counter() - begun, episodes)

    return run
