"""What a loop of one lane alone works out ahead: by turns, by cases, and by both.

Numbers are compared with those of XLA, to the last bit.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from lanes_tools import assert_as_xla, assert_same_bits, by_lanes, by_xla
from marks import slow_but_first

from jaxrl_tab.core import policies, rng
from jaxrl_tab.lanes import ahead
from jaxrl_tab.lanes.analysis import Facts
from jaxrl_tab.lanes.emit import emit
from jaxrl_tab.lanes.lower import lower
from jaxrl_tab.lanes.target import host

pytestmark = pytest.mark.usefixtures("optimised")

RANDOM = np.random.default_rng(0)
LANES = 4
KEYS = RANDOM.integers(0, 2**32, (LANES, 2), np.uint32)
Q = RANDOM.normal(size=(LANES, 30, 4)).astype(np.float32).round(1)  # with ties
EPSILON = RANDOM.random(LANES).astype(np.float32)
STARTS = np.array([0, -70, 2**31 - 20, 1000], np.int32)
LENGTHS = (1, 2, 7, 8, 63, 64, 65, 127, 200)  # some are whole multiples of what is worked out at once


@pytest.fixture
def tables(monkeypatch):
    """How many tables of a kind, (by turn, conditions), are worked out."""
    noted = []
    plan = ahead.Ahead._plan

    def noting(self):
        plan(self)
        noted.extend((turn, len(conditions)) for turn, conditions in self._tables)

    monkeypatch.setattr(ahead.Ahead, "_plan", noting)
    return noted


def word(key, t):
    return rng.word((key[0], key[1]), t, 0)


def policy(q, epsilon):
    return policies.epsilon_greedy(q, epsilon)


def as_words(key, start, length, step=1):
    """Words of so many turns, from `start` on; each counts with another weight, and they are put into an array."""

    def turn(k, carried):
        t, total, last = carried
        x = word(key, t)
        return t + step, total * 3 + x, last.at[k % 5].set(x)

    return lax.fori_loop(0, length, turn, (start, jnp.uint32(0), jnp.zeros(5, jnp.uint32)))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("length", LENGTHS)
def test_words_of_the_next_turns(length, tables):
    """Where the counter begins elsewhere, or goes round, and the loop has any length.

    Broken once: the place in the table is the counter, not the number of the turn -> fails.
    """
    assert_as_xla(lambda key, t: as_words(key, t, length), KEYS, STARTS, lanes=1)
    assert tables == ([(True, 0)] if length >= ahead.OFTEN else [])


@pytest.mark.parametrize("step", [-1, 3, 2**31 - 1])
def test_a_counter_may_go_in_other_steps(step):
    """Broken once: it is taken to go up by 1 -> fails."""
    assert_as_xla(lambda key, t: as_words(key, t, 150, np.int32(step)), KEYS, STARTS, lanes=1)


def test_loops_of_a_length_that_nobody_knows(tables):
    """Each is begun again by the one around it. Broken once: the turns are not counted anew -> fails."""

    def function(key, t):
        def on(carried):
            _, x, turns = carried
            return (x % 23 != 0) & (turns < 500)

        def turn(carried):
            t, x, turns = carried
            return t + 1, x ^ word(key, t), turns + 1

        def loop(_, carried):
            return lax.while_loop(on, turn, (carried[0], carried[1] | 1, 0))

        return lax.fori_loop(0, 9, loop, (t, key[0], 0))

    assert_as_xla(function, KEYS, STARTS, lanes=1)
    assert (True, 0) in tables


def walk(q, epsilon, key, t, length=200, conditions=4):
    """Steps of an agent whose state and action depend on all before, and that changes its table."""

    def turn(k, carried):
        q, s, a, t, visits = carried
        row = q[s]
        x = word(key, t)
        if conditions > 4:
            x = jnp.where(s % 3 == 0, word(key, -t), x)
        a = policies.sample(rng.as_key(x), policy(row, epsilon))
        q = q.at[s, a].add(0.1 * (row.max() - 1 - q[s, a]))
        return q, (s * 7 + a + 1) % 30, a, t + 1, visits.at[a].add(1)

    return lax.fori_loop(0, length, turn, (q, 3, 0, t, jnp.zeros(4, jnp.int32)))


@pytest.mark.parametrize("conditions", [4, 5])
@pytest.mark.parametrize("length", slow_but_first([8, 63, 200]))
def test_actions_in_all_cases(length, conditions, tables):
    """By which actions are best, by the word of the turn, and by which of two words is taken.

    Broken once: the bits of a case are put together the other way round -> fails; each turn reads the table of the
    first -> fails.
    """
    assert_as_xla(lambda *x: walk(*x, length, conditions), Q, EPSILON, KEYS, STARTS, lanes=1)
    assert (True, conditions) in tables


def test_the_cases_of_numbers_that_are_not_numbers():
    """NaN is equal to nothing, and 0 to -0, as where lanes go side by side. Broken once: `ueq` for `oeq` -> fails."""
    q = np.full((LANES, 30, 4), np.nan, np.float32)
    q[1:] = RANDOM.choice(np.array([np.nan, np.inf, -np.inf, 0, -0.0, 1], np.float32), q[1:].shape)
    alone, among_others = (by_lanes(walk, q, EPSILON, KEYS, STARTS, lanes=n) for n in (1, LANES))
    assert_same_bits(alone, among_others)


def test_no_more_cases_than_pay(tables):
    """Six actions of which any may be the best. Broken once: however many conditions -> fails."""

    def function(q, epsilon):
        def turn(k, carried):
            s, total = carried
            return (s * 5 + 1) % 30, total + policy(q[s], epsilon)[5]

        return lax.fori_loop(0, 50, turn, (0, 0.0))

    q = RANDOM.normal(size=(LANES, 30, 6)).astype(np.float32).round(0)
    assert_as_xla(function, q, EPSILON, lanes=1)
    assert all(conditions <= ahead.CONDITIONS for _, conditions in tables)


def test_what_no_turn_would_work_out_does_not_stop_the_program():
    """Behind the last turn the divisor is 0, and it is known that it never is in a turn.

    Broken once: whole numbers are divided ahead -> the processor stops the program.
    """

    def turn(carried):
        k, key, total = carried
        x = word(key, k).astype(jnp.int32)
        return k + 1, key, total * 5 + lax.rem(x, 70 - k)

    def function(key):
        return lax.while_loop(lambda carried: carried[0] < 70, turn, (0, key, 0))

    assert_as_xla(function, KEYS, lanes=1)


def test_products_are_rounded_with_sums_as_they_are_otherwise():
    """Broken once: the product that a sum takes is worked out, and rounded, by itself -> fails."""

    def function(q, epsilon, key):
        def turn(k, carried):
            s, total = carried
            u = word(key, k).astype(jnp.float32) * 2**-32
            best = (q[s] == q[s].max()).astype(jnp.float32)
            mean = epsilon * best[0] + 0.3 * best[1] / best.sum() + 0.7
            return (s * 7 + 1) % 30, total * mean + epsilon * u

        return lax.fori_loop(0, 100, turn, (0, 0.0))

    assert_as_xla(function, Q, EPSILON, KEYS, lanes=1)


def test_truth_values_that_a_turn_decides(tables):
    """They lie in bytes. Broken once: they are written as bits -> fails."""

    def function(key, t):
        def turn(k, carried):
            s, hits = carried
            hit = word(key, t + k) < np.uint32(2**30)
            return jnp.where(hit, s * 5 + 1, s ^ k), hits.at[s % 7].set(hit)

        return lax.fori_loop(0, 100, turn, (1, jnp.zeros(7, bool)))

    assert_as_xla(function, KEYS, STARTS, lanes=1)
    assert tables == [(True, 0)]


def test_a_condition_that_an_inner_loop_leaves():
    """It is known behind that loop. Broken once: it is taken for a condition as any other -> fails."""

    def function(q, key):
        def turn(k, carried):
            s, total = carried
            on = lambda x: (x[0] % 5 != 0) & x[1]
            _, odd = lax.while_loop(on, lambda x: (x[0] // 2, x[0] % 3 != 0), (word(key, s), k > 0))
            number = jnp.where(odd, 0.3, 1.7) / jnp.where(q[s, 0] > 0, 0.9, 1.1)
            return (s * 7 + odd + 1) % 30, total + number / 3.3

        return lax.fori_loop(0, 50, turn, (0, 0.0))

    assert_as_xla(function, Q, KEYS, lanes=1)


def test_nothing_is_worked_out_ahead_where_lanes_go_side_by_side(tables):
    found = by_lanes(walk, Q, EPSILON, KEYS, STARTS)
    assert tables == []
    assert_same_bits(found, by_xla(walk, Q, EPSILON, KEYS, STARTS))


def test_one_lane_alone_is_written_without_vectors_of_one():
    """All its numbers are single ones, but in tables. Broken once: its facts are those of many lanes -> fails."""
    args = (Q[0], EPSILON[0], KEYS[0], STARTS[0])
    code = lower(jax.make_jaxpr(walk)(*args), [True] * 4, [None] * 4)
    text = emit(code, Facts(code.region, alone=True), host(), 1, 1).text
    assert "phi <" not in text
    assert "load <1 x" not in text
