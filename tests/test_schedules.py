"""The named schedules by hand, and the two conditions against sums of their values."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxrl_tab as rl
from jaxrl_tab import schedules
from jaxrl_tab.core.clock import CLOCKS
from jaxrl_tab.core.schedules import (
    Exponential,
    Harmonic,
    Linear,
    Optax,
    Power,
    Unbiased,
    is_glie,
    is_robbins_monro,
)
from jaxrl_tab.core.types import Transition

clocks = st.sampled_from(CLOCKS)
powers = st.one_of(
    st.sampled_from([0.5, 1.0]),  # where a condition begins or ends to hold
    st.floats(0.1, 0.45) | st.floats(0.55, 0.95) | st.floats(1.1, 3.0),  # the sums tell these from those
)
families = st.one_of(
    st.builds(Power, powers, st.sampled_from([0.5, 1.0, 20.0]), clocks),
    st.builds(Harmonic, st.sampled_from([0.5, 1.0, 10.0, 100.0]), clocks),
    st.builds(Linear, st.just(1.0), st.sampled_from([0.0, 0.05]), st.sampled_from([1, 10, 500]), clocks),
    st.builds(Exponential, st.just(1.0), st.sampled_from([0.5, 0.99]), st.sampled_from([0, 0.01]), clocks),
    st.builds(Unbiased, st.sampled_from([0.01, 0.5, 1.0]), clocks),
)

# --- values ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("schedule", "wants"),
    [
        (Harmonic(3.0), {1: 1, 2: 3 / 4, 4: 1 / 2, 10: 1 / 4}),
        (Linear(1.0, 0.5, 4), {1: 1, 2: 7 / 8, 4: 5 / 8, 5: 1 / 2, 99: 1 / 2}),
        (Linear(0.0, 0.1, 2), {1: 0, 2: 0.05, 3: 0.1, 4: 0.1}),
        (Exponential(2.0, 0.5), {1: 2, 2: 1, 4: 1 / 4}),
        (Exponential(1.0, 0.5, end=0.2), {1: 1, 3: 1 / 4, 4: 0.2, 99: 0.2}),
        (Unbiased(0.5), {1: 1, 2: 2 / 3, 3: 4 / 7, 99: 0.5}),
        (Unbiased(1e-6), {1: 1, 2: 1 / (2 - 1e-6)}),
        (Unbiased(1.0), {1: 1, 99: 1}),
    ],
)
def test_values_by_hand(schedule, wants):
    np.testing.assert_allclose([schedule(jnp.int32(n)) for n in wants], list(wants.values()), rtol=1e-6)


def test_linear_and_exponential_are_those_of_optax():
    n = jnp.arange(1, 30)
    pairs = (
        (Linear(1.0, 0.1, 7), optax.linear_schedule(1.0, 0.1, 7)),
        (Exponential(1.0, 0.8, 0.05), optax.exponential_decay(1.0, 1, 0.8, end_value=0.05)),
    )
    for ours, theirs in pairs:
        np.testing.assert_allclose(jax.vmap(ours)(n), jax.vmap(Optax(theirs))(n), rtol=1e-6)


def test_the_unbiased_step_size_forgets_the_initial_value_and_weighs_as_a_constant_one():
    """Exercise 2.7, as it is written: beta_n = alpha / o_n, and what is learned is a weighted mean of the targets.

    Broken once: n - 1 for n -> fails.
    """
    alpha, targets, trace, q = 0.3, [4.0, -1.0, 2.0, 7.0], 0.0, 99.0
    for n, target in enumerate(targets, 1):
        trace += alpha * (1 - trace)
        assert float(Unbiased(alpha)(jnp.int32(n))) == pytest.approx(alpha / trace, rel=1e-6)
        q += alpha / trace * (target - q)
    weights = (1 - alpha) ** np.arange(len(targets))[::-1]
    assert q == pytest.approx(np.average(targets, weights=weights))


def test_n0_over_n0_plus_earlier_visits():
    """epsilon = N0 / (N0 + N(s)) with N(s) the visits before this one: 1 at the first, and by state.

    Broken once: n0 / (n0 + n) -> 3/4 at the first visit -> fails.
    """
    method = rl.Sarsa(alpha=Harmonic(3.0), epsilon=Harmonic(3.0), gamma=0.0, q0=1.0)
    state = method.init(2, 2)._replace(q=jnp.array([[1.0, 0.0], [1.0, 0.0]]))

    update, probs = jax.jit(method.update), jax.jit(method.probs)

    def explores(s):  # pi of the worse action is epsilon / 2
        return 2 * float(probs(state, jnp.int32(s))[1])

    for visits in range(4):
        assert explores(0) == pytest.approx(3 / (3 + visits))
        assert explores(1) == 1
        t = Transition(*map(jnp.asarray, (0, 0, 1.0, 1, 0.0, False)))
        state, _ = update(jax.random.key(0), state, t)


def test_the_first_step_size_by_visit_is_1():
    method = rl.Sarsa(alpha=Harmonic(3.0), gamma=0.0, q0=8.0)
    state, wants = method.init(1, 1), (4.0, 4 + 3 / 4 * (0 - 4))  # step sizes 1 and 3/4
    for reward, want in zip((4.0, 0.0), wants, strict=True):
        t = Transition(*map(jnp.asarray, (0, 0, reward, 0, 0.0, False)))
        state, _ = method.update(jax.random.key(0), state, t)
        assert float(state.q[0, 0]) == want


def test_a_batch_of_schedules_is_a_schedule_each():
    """Swept in one program: the numbers are leaves."""
    many = (
        Harmonic(jnp.array([1.0, 3.0])),
        Linear(jnp.ones(2), jnp.array([0.0, 0.5]), jnp.array([2.0, 4.0])),
        Exponential(jnp.ones(2), jnp.array([0.5, 0.25]), jnp.zeros(2)),
    )
    got = [jax.vmap(lambda schedule: schedule(jnp.int32(2)))(schedule) for schedule in many]
    np.testing.assert_allclose(got, [[1 / 2, 3 / 4], [1 / 2, 7 / 8], [1 / 2, 1 / 4]])


# --- the conditions ----------------------------------------------------------------------------------


def blocks(rate):
    """Sums of the values of `rate` and of their squares, over n = 2^j to 2^(j+1) - 1 for j = 0 to 16."""
    n = np.arange(1, 2**17)
    with jax.enable_x64():
        x = np.asarray(jax.vmap(rate)(n)) if callable(rate) else np.full(len(n), float(rate))
    starts = 2 ** np.arange(17)
    return x, np.add.reduceat(x, starts), np.add.reduceat(x**2, starts)


def diverges(sums):
    """By Cauchy's condensation: sums over blocks that double in length shrink by a factor, or do not."""
    return sums[-1] > 0 and sums[-1] / sums[-2] > 0.98


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(families | st.sampled_from([0, 0.1, 1.0]))
def test_the_conditions_agree_with_the_sums(rate):
    """Broken once: `order >= 1` for `order > 1`, `order < 0.5` for `order <= 0.5` -> fails."""
    x, sums, squares = blocks(rate)
    falls = x[-1] < 0.9 * x[2**14]
    assert bool(is_glie(rate)) == (falls and diverges(sums))
    assert bool(is_robbins_monro(rate)) == (diverges(sums) and not diverges(squares))


@pytest.mark.parametrize(
    ("condition", "rate", "holds", "why"),
    [
        (is_glie, 0.1, False, "stays at 0.1: it explores for ever, but it never becomes greedy"),
        (is_glie, 0, False, "is 0, so its sum is finite"),
        (is_glie, np.float32(0.5), False, "stays at 0.5"),
        (is_glie, schedules.glie(), True, "1/n, to 0, and its sum is infinite.*positive rate per episode"),
        (
            is_glie,
            Power(1.0, clock="step"),
            True,
            "assuming that each is visited at a positive rate per step",
        ),
        (
            is_glie,
            Power(0.5, clock="visit"),
            True,
            r"1/n\^0.5, to 0.*in every state that is visited for ever$",
        ),
        (is_glie, Power(2.0), False, r"falls like 1/n\^2, so its sum is finite: from some time on it never"),
        (is_glie, Harmonic(), True, "in every state that is visited for ever$"),
        (is_glie, Linear(1.0, 0.0, 500), False, "is 0 after n = 500, so its sum is finite"),
        (is_glie, Linear(1.0, 0.05, 500), False, "stays at 0.05: it explores for ever, but"),
        (is_glie, Exponential(1.0, 0.99), False, r"falls like 0.99\^n, so its sum is finite"),
        (is_glie, Exponential(1.0, 0.99, 0.01), False, "stays at 0.01"),
        (is_robbins_monro, 0.1, False, "stays at 0.1, so the sum of its squares is infinite"),
        (is_robbins_monro, 0, False, "is 0, so its sum is finite"),
        (
            is_robbins_monro,
            schedules.sample_average(),
            True,
            r"every pair \(s, a\) that is visited for ever$",
        ),
        (is_robbins_monro, Power(0.8), True, "assuming that each is visited at a positive rate per episode"),
        (is_robbins_monro, Power(0.5), False, r"1/n\^0.5, so the sum of its squares is infinite"),
        (is_robbins_monro, Power(1.5), False, r"falls like 1/n\^1.5, so its sum is finite"),
        (
            is_robbins_monro,
            Harmonic(clock="visit"),
            True,
            "its sum is infinite and that of its squares is finite",
        ),
        (is_robbins_monro, Linear(1.0, 0.0, 10), False, "is 0 after n = 10, so its sum is finite"),
        (is_robbins_monro, Linear(1.0, 0.1, 10), False, "stays at 0.1, so the sum of its squares"),
        (is_robbins_monro, Exponential(1.0, 0.9), False, r"falls like 0.9\^n, so its sum is finite"),
        (is_robbins_monro, Unbiased(0.1), False, "stays at 0.1, so the sum of its squares is infinite"),
    ],
)
def test_a_verdict_says_why(condition, rate, holds, why):
    verdict = condition(rate)
    assert (verdict.holds, bool(verdict)) == (holds, holds)
    assert "\n" not in verdict.why
    assert re.search(why, verdict.why)


def test_by_episode_two_exploring_steps_may_never_fall_together():
    """What `is_glie` assumes by episode, and why: a pair that needs both is never tried, 2 times in pi."""
    with jax.enable_x64():
        epsilon = np.asarray(jax.vmap(schedules.glie())(np.arange(1, 10**6)))
    assert np.prod(1 - (epsilon / 2) ** 2) == pytest.approx(2 / np.pi, rel=1e-6)


@pytest.mark.parametrize("condition", [is_glie, is_robbins_monro])
@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (
            Optax(optax.constant_schedule(0.1)),
            r"cannot tell of an arbitrary function \(Optax\): .* give a number",
        ),
        (lambda n: 1 / n, "cannot tell of an arbitrary function"),
        (Power, "cannot tell of a class"),
        (Power(np.array([0.5, 1.0])), "Power: power must be one plain number to tell this"),
        (Linear(1.0, np.array([0.0, 0.1]), 5), "Linear: end must be one plain number"),
        (-0.1, "must be .*, or a schedule, not -0.1"),
        (np.nan, "must be .*, or a schedule, not nan"),
        ("glie", "must be .*, or a schedule, not 'glie'"),
        (None, "must be .*, or a schedule, not None"),
        ([0.1, 0.2], "must be .*, or a schedule, not"),
    ],
)
def test_of_anything_else_they_refuse_to_tell(condition, rate, message):
    with pytest.raises(rl.InputError, match=rf"{condition.__name__}|one plain number") as error:
        condition(rate)
    assert re.search(message, str(error.value))
    assert "\n" not in str(error.value)


def test_an_exploration_rate_is_at_most_1_and_a_step_size_is_not():
    with pytest.raises(rl.InputError, match="is_glie: epsilon must be between 0 and 1, or a schedule, not 2"):
        is_glie(2)
    assert not is_robbins_monro(2)


# --- as they are typed -------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None, derandomize=True)
@given(families)
def test_what_is_printed_is_what_is_typed(schedule):
    again = schedules.parse(str(schedule))
    assert type(again) is type(schedule)
    assert dataclasses.astuple(again) == dataclasses.astuple(schedule)


@pytest.mark.parametrize(
    ("text", "schedule"),
    [
        ("glie", schedules.glie()),
        ("sample-average", schedules.sample_average()),
        ("power:0.8:1:step", Power(0.8, clock="step")),
        ("harmonic:100:visit", Harmonic()),
        ("linear:1:0.05:500:episode", Linear(1, 0.05, 500)),
        ("exponential:1:0.99:0:episode", Exponential(1.0, np.float32(0.99))),
    ],
)
def test_how_schedules_are_printed(text, schedule):
    assert str(schedule) == text


def test_numbers_with_a_default_may_be_left_off():
    for text, long in (
        ("power:step", "power:1:1:step"),
        ("power:0.5:visit", "power:0.5:1:visit"),
        ("harmonic:episode", "harmonic:100:episode"),
        ("exponential:1:0.5:step", "exponential:1:0.5:0:step"),
        ("harmonic:1:visit", "sample-average"),
    ):
        assert str(schedules.parse(text)) == long


def test_a_batch_is_printed_as_it_is():
    assert str(Harmonic(np.array([1.0, 2.0]))) == "Harmonic(n0=array([1., 2.]), clock='visit')"


# --- what is refused ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Harmonic(0), "Harmonic: n0 must be greater than 0, not 0"),
        (
            lambda: Harmonic(clock="day"),
            "Harmonic: clock 'day' is unknown; choose one of step, episode, visit",
        ),
        (lambda: Linear(1.0, -0.1, 5), "Linear: end must be at least 0, not -0.1"),
        (lambda: Linear(1.0, 0.1, 0), "Linear: steps must be at least 1, not 0"),
        (lambda: Exponential(1.0, 1.0), "Exponential: rate must be greater than 0 and less than 1, not 1.0"),
        (lambda: Exponential("1", 0.5), "Exponential: start must be a number, not '1'$"),
        (lambda: Power(Power()), "Power: power must be a number, not Power"),
        (
            lambda: schedules.parse("harmonc:1:visit"),
            "no schedule 'harmonc:1:visit'; did you mean 'harmonic'",
        ),
        (
            lambda: schedules.parse("linear:1:step"),
            "not of the form linear:START:END:STEPS:CLOCK, where CLOCK",
        ),
        (lambda: schedules.parse("harmonic:x:visit"), r"not of the form harmonic\[:N0\]:CLOCK"),
        (lambda: schedules.parse("harmonic:1:2:visit"), "not of the form harmonic"),
        (lambda: schedules.parse("harmonic:1"), "where CLOCK is one of step, episode, visit"),
        (lambda: schedules.parse("power"), r"not of the form power\[:POWER\[:SCALE\]\]:CLOCK"),
        (lambda: schedules.parse("power:-1:visit"), "power: power must be greater than 0, not -1"),
    ],
)
def test_bad_schedules_are_refused(make, message):
    with pytest.raises(rl.InputError, match=message):
        make()
