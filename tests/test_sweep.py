"""Sweeps: axes and seeds where they belong, and bad input refused before anything is compiled."""

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import batch
from jaxrl_tab.schedules import Power, glie

BUDGET = {"num_steps": 300, "log_every": 100}


@pytest.fixture(scope="module")
def grid(windy):
    """2 step sizes x 3 exploration rates x 4 seeds."""
    return rl.sweep(windy, "sarsa", {"alpha": [0.5, 0.25], "epsilon": (0.1, 0.5, 1)}, num_seeds=4, **BUDGET)


def test_each_point_of_the_grid_is_the_run_with_its_own_hyperparameters(windy, grid):
    """Also the key of seed i is fold_in(key(seed), i), shared by all points: common random numbers."""
    alone = rl.sweep(windy, rl.Sarsa, {"alpha": 0.25, "epsilon": 0.5}, num_seeds=3, **BUDGET)
    np.testing.assert_array_equal(alone.q, grid.q[1, 1, :3])
    key = jax.random.fold_in(jax.random.key(0), 2)
    method = rl.Sarsa(alpha=0.25, epsilon=0.5)
    state, log = jax.jit(jax.vmap(lambda key: rl.train(key, method, windy, **BUDGET)))(
        jax.numpy.stack([key, key])
    )
    np.testing.assert_array_equal(state.q[0], grid.q[1, 1, 2])
    np.testing.assert_array_equal(log.rewards[0], grid.log.rewards[1, 1, 2])


def test_another_root_seed_gives_other_runs(windy, grid):
    other = rl.sweep(windy, "sarsa", {"alpha": [0.5], "epsilon": [0.1]}, num_seeds=4, seed=1, **BUDGET)
    assert not (other.q[0, 0] == grid.q[0, 0]).all(axis=(1, 2)).any()


def test_the_dataset_names_every_axis(grid):
    ds = grid.to_xarray()
    assert dict(ds.sizes) == {"alpha": 2, "epsilon": 3, "seed": 4, "row": 3, "state": 70, "action": 4}
    assert ds.steps.dims == ("alpha", "epsilon", "seed", "row")
    assert ds.q.dims == ("alpha", "epsilon", "seed", "state", "action")
    np.testing.assert_array_equal(ds.rewards.sel(alpha=0.25, epsilon=0.5, seed=2), grid.log.rewards[1, 1, 2])
    assert ds.attrs["environment"] == "windy-gridworld" and ds.attrs["algorithm"] == "sarsa"
    assert ds.attrs["fixed"] == '{"gamma": 1.0, "q0": 0.0}'
    assert ds.attrs["num_steps"] == 300 and "num_episodes" not in ds.attrs
    assert ds.attrs["optimal_value"] == -15


def test_schedules_and_numbers_share_a_grid_and_the_optimum_follows_gamma(windy):
    """Different kinds of rates are different programs; each run is still where it belongs."""
    result = rl.sweep(
        windy,
        "sarsa",
        {"epsilon": [0.25, glie(), Power(clock="step")], "gamma": [0.5, 1.0]},
        num_seeds=2,
        **BUDGET,
    )
    ds = result.to_xarray()
    assert ds.epsilon.values.tolist()[1:] == [repr(glie()), repr(Power(clock="step"))]
    alone = rl.sweep(windy, "sarsa", {"epsilon": glie(), "gamma": 0.5}, num_seeds=2, **BUDGET)
    np.testing.assert_array_equal(result.q[1, 0], alone.q)
    np.testing.assert_allclose(ds.optimum, [-(1 - 0.5**15) / 0.5, -15])


def test_wind_can_be_batched():
    """The strengths are leaves: one program over several winds, each as in a world of its own."""
    winds = np.array([[0] * 10, [0, 0, 0, 1, 1, 1, 2, 2, 1, 0]])
    method = rl.Sarsa(alpha=0.5, epsilon=0.25)
    key = jax.random.key(0)
    run = lambda wind: rl.train(key, method, rl.WindyGridworld(wind=wind), num_steps=600, log_every=600)
    _, log = jax.jit(jax.vmap(run))(winds)
    for wind, episodes in zip(winds, log.episodes, strict=True):
        assert jax.jit(run)(wind)[1].episodes == episodes > 0
    assert log.episodes[0] != log.episodes[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"grid": {"alpa": 0.1}}, "sarsa has no parameter 'alpa'; did you mean 'alpha'?"),
        ({"grid": {"alpha": [0.1, 0.1]}}, "the grid of alpha holds 0.1 more than once"),
        ({"grid": {"alpha": []}}, "the grid of alpha is empty"),
        ({"grid": {"alpha": [0.1, 0]}}, "Sarsa: alpha must be greater than 0, not 0"),
        ({"grid": {"epsilon": "much"}}, "Sarsa: epsilon must be between 0 and 1, not 'much'"),
        ({"num_seeds": 0}, "num_seeds must be a whole number of at least 1, not 0"),
        ({"seed": -1}, "seed must be a whole number of at least 0, not -1"),
        ({"num_steps": None}, "give either num_steps or num_episodes"),
        ({"algorithm": "sarsaa"}, "no method is called 'sarsaa'; did you mean 'sarsa'?"),
        ({"algorithm": rl.Sarsa()}, "algorithm must be a class such as Sarsa, not an instance"),
        ({"env": "windy-gridworld"}, "env must be an environment such as make"),
    ],
)
def test_bad_input_is_refused_before_anything_is_compiled(windy, monkeypatch, arguments, message):
    monkeypatch.setattr(batch, "run", lambda *_, **__: pytest.fail("something was run"))
    good = {"env": windy, "algorithm": "sarsa", "grid": {}, "num_seeds": 2, "num_steps": 10}
    with pytest.raises(rl.InputError) as error:
        rl.sweep(**(good | arguments))
    assert message in str(error.value) and "\n" not in str(error.value)
