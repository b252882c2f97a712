"""What the experiments of figures are made of, where it is more than a sweep."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxrl_tab import planning, schedules
from jaxrl_tab.core.policies import EpsilonGreedy
from jaxrl_tab.figures import FIGURES, blackjack_regret, importance_sampling, trace_gridworld


def expected(name):
    return [number.expected for number in FIGURES[name].numbers]


def test_the_numbers_that_figures_expect_are_those_of_ground_truth():
    """They are the point of the figures: a change of one is a change of what is claimed."""
    assert expected("bias-variance")[:3] == [0.34518, 0.27683, 0.27650]
    assert expected("blackjack")[0] == pytest.approx(-0.0466, abs=5e-5)
    worst = FIGURES["blackjack-regret"].numbers[0]
    assert (worst.expected, worst.relation) == (0.005, "at most")
    assert expected("blackjack-regret")[2] == pytest.approx(0.107 - 0.0466, abs=3 * 0.0035)  # of 20 seeds
    assert expected("importance-sampling")[:4] == [-0.2772042, 10.15621, 9.79059, 10.15621]
    assert expected("trace-gridworld") == [1, 0, 0]


@pytest.mark.parametrize("chosen", range(3))
def test_one_of_several_schedules_is_just_that_one(chosen):
    """Broken once: the clock's episode not handed on -> fails."""
    policies = tuple(EpsilonGreedy(epsilon) for epsilon in blackjack_regret.EPSILONS.values())
    one = blackjack_regret.OneOf(tuple(jnp.eye(3)[chosen]), policies)
    clock = schedules.Clock(jnp.int32(50), jnp.int32(7), jnp.full((4, 2), 30, jnp.int32))
    q = jnp.array([0.25, -0.5])
    assert one.by_visit
    assert (one.probs(q, clock, jnp.int32(2)) == policies[chosen].probs(q, clock, jnp.int32(2))).all()


def test_the_regret_goes_on_in_long_rows_where_the_short_ones_end():
    """Broken once: the row at which both end taken twice -> fails."""

    def log(values, every, episodes):
        attrs = {"log_every": every, "num_episodes": episodes, "optimal_value": -1.0}
        return xr.Dataset({"greedy_value": (("seed", "row"), [values])}, {"row": range(len(values))}, attrs)

    datasets = {"beginning": log([-9.0, -8.0], 5, 10), "whole": log([-8.0, -4.0, -2.0], 10, 25)}
    regret = blackjack_regret._regret(datasets)
    assert regret.episodes.values.tolist() == [5, 10, 20, 25]
    assert regret.values.tolist() == [[8, 7, 3, 1]]


def test_a_value_changed_off_the_path_is_seen_and_one_on_it_unchanged():
    """Broken once: one step more than the episode has -> fails."""
    env = trace_gridworld.ENV
    q = np.zeros((1, env.num_states, env.num_actions))
    q[0, 5, 1] = q[0, 7, 0] = 0.5
    path = xr.Dataset(
        {
            "returns": (("seed", "row"), [[1.0]]),
            "lengths": (("seed", "row"), [[3]]),
            "s": (("seed", "row", "s_0"), [[[5, 6, 7, 9]]]),  # the last is of no step
            "a": (("seed", "row", "a_0"), [[[1, 2, 0, 0]]]),
        }
    )
    datasets = {"path": path, "method": xr.Dataset({"q": (("seed", "state", "action"), q)})}
    differ = trace_gridworld._unlike_the_path
    assert differ("method")(datasets) == 1  # (6, 2)
    assert differ("method", 1)(datasets) == 1  # (5, 1)
    q[0, 6, 2] = 0.5
    assert differ("method")(datasets) == 0
    assert trace_gridworld._changed("method")(datasets).values.tolist() == [3]


def test_the_hand_of_importance_sampling_starts_where_it_should():
    """By GROUND_TRUTH the value of sticking on 20 and 21 alone is -0.2772042 there.

    Broken once: sticks on 19 -> fails.
    """
    env, pi = importance_sampling.HAND, importance_sampling.sticks_on_20()
    start = planning.exact_model(env).start
    assert start[env.state(13, 2, usable=True)] == 1
    assert (pi[:, 0] == 1).sum() == 40
    v = planning.evaluate(env, pi)
    assert planning.start_value(env, v) == pytest.approx(-0.2772042, abs=5e-8)
