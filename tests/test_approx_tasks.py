"""The tasks of chapter 9: the walk of a thousand states, and the square wave."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.approx.features import read
from jaxrl_tab.envs import LongWalk, SquareWave

KEY = jax.random.key(0)


def test_the_walk_jumps_as_in_the_book():
    """From state 50 of the thousand: 51 of 200 jumps end at the left. Broken once: a jump of 0 -> fails."""
    walk = LongWalk()
    prob, outcome = walk.outcomes(jnp.int32(50), jnp.int32(0))
    np.testing.assert_allclose(prob, 1 / 200)
    assert (np.asarray(outcome.s_next) == 0).sum() == 51
    assert sorted(np.asarray(outcome.s_next)[51:]) == [*range(1, 50), *range(51, 151)]
    assert outcome.reward.sum() == -51
    assert (outcome.terminal == (outcome.s_next == 0)).all()
    assert walk.start_state == 500


def test_steps_of_the_walk_are_its_outcomes():
    """All 6 jumps of a small one, by counting 6000 steps: each within 5 standard errors."""
    walk = LongWalk(states=20, jump=3)
    step = jax.vmap(lambda key: walk.step(key, jnp.int32(2), jnp.int32(0)))(jax.random.split(KEY, 6000))
    counts = np.bincount(np.asarray(step.s_next), minlength=22)
    expected = np.array([2, 1, 0, 1, 1, 1]) * 1000
    assert (abs(counts[:6] - expected) < 5 * np.sqrt(1000 * 5 / 6)).all()
    assert counts[:6].sum() == 6000
    assert (step.reward == np.where(step.s_next == 0, -1, 0)).all()
    assert (step.terminal == (step.s_next == 0)).all()


def test_groups_of_the_walk_are_those_of_example_9_1():
    """States 1 to 100, 101 to 200, and so on."""
    groups = approx.matrix("aggregation(10)", LongWalk()).argmax(1)
    np.testing.assert_array_equal(groups[1:-1], np.repeat(np.arange(10), 100))


def test_the_wave_and_its_intervals():
    """Tilings of one number are overlapping intervals, each as wide as a tile and a tile's width / tilings apart."""
    states = jax.vmap(SquareWave().reset)(jax.random.split(KEY, 500))
    assert states.shape == (500, 1)
    assert 0 <= states.min() < 0.02
    assert 1.98 < states.max() < 2
    after = jax.vmap(lambda s: SquareWave().step(KEY, s, jnp.int32(0)))(states)
    np.testing.assert_array_equal(after.reward, (states[:, 0] >= 0.5) & (states[:, 0] < 1.5))
    assert after.terminal.all()
    features: Any = read("tile-coding(5, 10)")
    features = features.ranged((0.0,), (2.0,))
    ones = np.asarray(jax.vmap(features)(states).ones)
    x = np.asarray(states[:, 0], float)
    left = (np.arange(54)[:, None] - 4) * 0.04  # each is 0.2 wide
    inside = (x >= left) & (x < left + 0.2)
    found = (ones[:, :, None] == np.unique(ones)).any(1).T
    # But for rounding at the ends of one, each is one of the features, and each feature one of them.
    same = (inside[:, None] != found).sum(2) <= 2
    assert same.any(0).all()
    assert same.any(1).all()


def test_the_error_of_the_wave_is_that_of_its_intervals():
    """Four of them, in each of which the wave is 0 or 1. Broken once: its first value -> fails."""
    grid = {"features": "tile-coding(1, 4)", "alpha": 0.1}
    budget = {"num_seeds": 3, "num_steps": 40, "log_every": 20, "exact": True, "progress": False}
    result = rl.sweep(SquareWave(), "semi-gradient-td", grid, **budget)
    error = np.sqrt(((result.q[:, :4, 0] - [0, 1, 1, 0]) ** 2).mean(1))
    np.testing.assert_allclose(result.log.v_error[:, -1], error, rtol=1e-5)
    assert result.log.value_error is None
    experiment = {"method": "semi-gradient-td", "steps": 40}
    assert rl.Experiment(environment="square-wave", **experiment).exact
    assert not rl.Experiment(environment="mountain-car", **experiment).exact
    for env, method in ((rl.MountainCar(), approx.SemiGradientTD), (SquareWave(), approx.SemiGradientSarsa)):
        with pytest.raises(rl.InputError, match="can only be sampled"):
            rl.train(KEY, method(features="tile-coding(1, 4)"), env, num_steps=3, exact=True)
