"""When a run has diverged: numbers that are none, and values beyond any possible return."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from test_reference import random_mdp

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.part import BEYOND
from jaxrl_tab.engine.results import is_diverged
from jaxrl_tab.engine.sweep import prepare
from jaxrl_tab.envs.base import Finite


def returns_of_all_paths(env, gamma, steps, begin):
    """The sums of discounted rewards along all paths of at most so many steps, by trying each."""
    model = planning.exact_model(env)

    def after(s, left):
        yield 0.0
        if not left:
            return
        for a, k in itertools.product(*map(range, model.prob.shape[1:])):
            if model.prob[s, a, k] > 0:
                r = model.reward[s, a, k]
                onward = [0.0] if model.terminal[s, a, k] else after(model.s_next[s, a, k], left - 1)
                yield from (r + gamma * g for g in onward)

    return [g for s in begin for g in after(s, steps)]


@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0])
def test_the_largest_return_is_that_of_some_path(gamma):
    """Broken once: costs not looked at; a step more -> fails."""
    env = rl.WindyGridworld(shape=(2, 3), wind=(0, 0, 0), start=(0, 0), goal=(1, 2))
    found = returns_of_all_paths(env, gamma, 4, range(6))
    assert planning.largest_return(env, gamma, 4) == pytest.approx(np.abs(found).max())
    env = random_mdp()
    found = returns_of_all_paths(env, gamma, 2, range(5))
    assert planning.largest_return(env, gamma, 2, anywhere=True) == pytest.approx(np.abs(found).max())


def test_the_largest_return_by_hand():
    """Broken once: the state that cannot be reached counted -> fails."""
    walk = rl.RandomWalk()
    assert planning.largest_return(walk, 1.0, 10**6) == 1
    windy = rl.WindyGridworld()
    assert planning.largest_return(windy, 1.0, 10**6) == 10**6  # a loop, and one step costs 1
    assert planning.largest_return(windy, 0.9, 10**6) == pytest.approx(10, rel=1e-9)
    stays = np.stack([np.eye(2)] * 2, 1)
    away = rl.FiniteMDP(stays, np.array([[1.0, 0.0], [-1e9, -1e9]]))
    assert planning.largest_return(away, 0.0, 9) == 1
    assert planning.largest_return(away, 0.0, 9, anywhere=True) == 1e9


def test_the_largest_return_knows_no_outcome_without_a_chance():
    """Broken once: its reward counted -> fails."""

    @pytree
    class Lottery(Finite):
        num_states, num_actions, max_steps = 2, 1, 9

        def initial(self):
            return jnp.eye(2)[0]

        def outcomes(self, s, a):
            reward = jnp.where(s == 0, jnp.array([-1.0, 1e6]), 0)
            return jnp.array([1.0, 0.0]), Outcome(jnp.array([1, 1]), reward, jnp.array([True, True]))

    assert planning.largest_return(Lottery(), 1.0, 9) == 1


def test_values_beyond_any_return_have_diverged():
    """With gamma = 0 no value is beyond -1, and yet the sums of the forward view are.

    Broken once: judged by infinities alone -> fails.
    """
    result = rl.sweep(
        rl.WindyGridworld(),
        "sarsa-lambda-forward",
        {"gamma": 0.0, "alpha": [0.01, 0.9]},
        num_seeds=64,
        num_steps=600,
    )
    assert np.isfinite(result.q).all()
    np.testing.assert_array_equal(result.largest_value, [BEYOND, BEYOND])
    np.testing.assert_array_equal(result.diverged, abs(result.q).max((-2, -1)) > BEYOND)
    assert not result.diverged[0].any() and result.diverged[1].any()
    assert result.to_xarray().diverged.values.tolist() == result.diverged.tolist()


def test_what_is_not_judged():
    """Noise that the outcomes do not tell, problems drawn for each run, and returns times ratios."""
    budget = Budget(num_steps=50)
    for env, method, grid in (
        (rl.MaximizationBias(), "sarsa", {}),
        (rl.KArmedTestbed(), "sarsa", {}),
        (rl.RandomWalk(), "off-policy-td", {}),
        (rl.InfiniteVariance(), "off-policy-monte-carlo-prediction", {"weighting": "ordinary"}),
    ):
        assert prepare(env, method, grid, budget, num_seeds=1).largest_values.tolist() == [np.inf]
    judged = prepare(
        rl.InfiniteVariance(), "off-policy-monte-carlo-prediction", {"v0": [0.0, -7.0]}, budget, num_seeds=1
    )
    assert judged.largest_values.tolist() == [BEYOND, 8 * BEYOND]


def test_what_a_state_does_not_have_is_no_divergence():
    """Broken once: its value counted -> fails."""
    q = np.array(
        [[[1.0, rl.policies.UNAVAILABLE]], [[3.0, 0.0]], [[np.nan, 0.0]], [[-3.0, -np.inf]]], np.float32
    )
    assert is_diverged(q).tolist() == [False, False, True, True]
    assert is_diverged(q, largest=2.0).tolist() == [False, True, True, True]
    assert is_diverged(q, largest=np.array([0.5, 3.0, 3.0, 3.0])).tolist() == [True, False, True, True]
