"""What the peers in Numba share: random numbers, and epsilon-greedy actions, without a branch.

Each lane has its own xoshiro256++ generator (Blackman and Vigna 2021), seeded by splitmix64. Decisions of a
step share its 64-bit words. All integers are unsigned: Numba then spares itself the check for negative
indices. Tables of Q are float32 and flat: a row begins at 4 S, a pair is at 4 S + A.
"""

import functools
import time
from collections.abc import Callable

import numba  # pyright: ignore[reportMissingImports] (of the extra "bench")
import numpy as np

from benchmarks.problems import EPSILON
from benchmarks.rounds import Round, Timing

U = np.uint64
ACTIONS = 4
EXPLORE_BELOW_32 = U(EPSILON * 2**32)
EXPLORE_BELOW_20 = U(round(EPSILON * 2**20))
LOW_32, LOW_24, LOW_20 = U(2**32 - 1), U(2**24 - 1), U(2**20 - 1)

inline = numba.njit(forceinline=True)


def rounds(kernel: Callable, lanes: int, pairs: int, *counts: int) -> Round:
    """A round is `kernel(seeds, tables, outcomes, *counts)`, a thread for each core.

    The kernel reads a seed for each lane, uint64 [lanes], and fills in Q, float32 [lanes, pairs], and the
    outcomes, float32 [lanes]. `counts` are whole numbers: how much each lane does.
    """

    def run(lanes: int, seed: int, *counts: int) -> Timing:
        seeds = np.arange(lanes, dtype=U) + U(seed << 32)
        begun = time.perf_counter()
        tables, outcomes = np.zeros((lanes, pairs), np.float32), np.zeros(lanes, np.float32)
        kernel(seeds, tables, outcomes, *counts)
        return Timing(time.perf_counter() - begun, outcomes)

    run(4, 0, *(1 for _ in counts))  # compiles
    return lambda seed: run(lanes, seed, *counts)


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
def generator(seed):
    """The state of a generator: four words."""
    z, r0 = splitmix64(seed)
    z, r1 = splitmix64(z)
    z, r2 = splitmix64(z)
    z, r3 = splitmix64(z)
    return r0, r1, r2, r3


@inline
def xoshiro256pp(rng):
    """(word, generator after it)."""
    r0, r1, r2, r3 = rng
    word = rotate(r0 + r3, 23) + r0
    t = r1 << U(17)
    r2 ^= r0
    r3 ^= r1
    r1 ^= r2
    r0 ^= r3
    return word, (r0, r1, r2 ^ t, rotate(r3, 45))


# --- actions -----------------------------------------------------------------------------------------


def _tie_table() -> np.ndarray:
    """An action for each (set of actions as bits, number below 12), uniform; uint8, flat, in rows of 16.

    12 is divisible by 1, 2, 3 and 4, so each action of the set has equally many of the numbers.
    """
    table = np.zeros((16, 16), np.uint8)
    for bits in range(1, 16):
        actions = [a for a in range(ACTIONS) if bits >> a & 1]
        table[bits, :12] = np.repeat(actions, 12 // len(actions))
    return table.ravel()


TIE = _tie_table()


@inline
def larger(x, y):
    return x if x > y else y


@inline
def best(q, row):
    """The largest value of a row."""
    return larger(larger(q[row], q[row + U(1)]), larger(q[row + U(2)], q[row + U(3)]))


@inline
def one_of(values, explore, below_12):
    """An action whose value is the largest of four, or where it explores any, by a random number below 12."""
    q0, q1, q2, q3 = values
    high = larger(larger(q0, q1), larger(q2, q3))
    bits = U(1) if q0 == high else U(0)
    bits |= U(2) if q1 == high else U(0)
    bits |= U(4) if q2 == high else U(0)
    bits |= U(8) if q3 == high else U(0)
    bits = U(15) if explore else bits
    return U(TIE[(bits << U(4)) + below_12])


@inline
def values_of(q, row):
    """The four values of a row."""
    return q[row], q[row + U(1)], q[row + U(2)], q[row + U(3)]


@inline
def epsilon_greedy(q, row, word):
    """An action by one word: the upper half decides on exploring, the lower half on the action."""
    return one_of(values_of(q, row), (word >> U(32)) < EXPLORE_BELOW_32, ((word & LOW_32) * U(12)) >> U(32))


@inline
def epsilon_greedy_40(values, word):
    """An action by the upper 40 bits of a word: 20 decide on exploring, 20 on the action."""
    return one_of(values, (word >> U(44)) < EXPLORE_BELOW_20, (((word >> U(24)) & LOW_20) * U(12)) >> U(20))


# --- lanes -------------------------------------------------------------------------------------------
# A lane is a tuple whose third field counts its episodes: begin(q, seed) -> lane, step(q, lane) -> lane.


@functools.cache  # so that one lane and many share what is compiled
def one_after_another(begin, step, threads=True):
    """The kernel that runs one lane after another, on all cores or on one."""

    @numba.njit(parallel=threads, error_model="numpy")
    def kernel(seeds, tables, episodes, steps):
        for i in numba.prange(seeds.size):
            q = tables[i]
            lane = begin(q, seeds[i])
            for _ in range(steps):
                lane = step(q, lane)
            episodes[i] = lane[2]

    return kernel


def four_in_turn(begin, step):
    """The kernel that runs four lanes in turn; the number of lanes must be a multiple of 4."""

    @numba.njit(parallel=True, error_model="numpy")
    def kernel(seeds, tables, episodes, steps):
        for block in numba.prange(seeds.size // 4):
            i = 4 * block
            q0, q1, q2, q3 = tables[i], tables[i + 1], tables[i + 2], tables[i + 3]
            lane0 = begin(q0, seeds[i])
            lane1 = begin(q1, seeds[i + 1])
            lane2 = begin(q2, seeds[i + 2])
            lane3 = begin(q3, seeds[i + 3])
            for _ in range(steps):
                lane0 = step(q0, lane0)
                lane1 = step(q1, lane1)
                lane2 = step(q2, lane2)
                lane3 = step(q3, lane3)
            episodes[i] = lane0[2]
            episodes[i + 1] = lane1[2]
            episodes[i + 2] = lane2[2]
            episodes[i + 3] = lane3[2]

    return kernel
