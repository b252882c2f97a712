"""Grids in steps and random draws: what is tried, and that it is the same ever after."""

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import jaxrl_tab as rl
from jaxrl_tab import export
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import axes
from jaxrl_tab.engine.sweep import configurations

MANY = 4000


def drawn(grid, num_draws=MANY, seed=0, method="sarsa"):
    """What is drawn of each hyperparameter, in lists."""
    trials = axes.spread(grid, num_draws, seed, method)[axes.DRAW]
    return {name: [trial[name] for trial in trials] for name in trials[0]}


def test_the_ends_of_grids_are_exact_and_what_is_between_is_neat():
    """Broken once: what is computed not rounded, 0.30000000000000004 -> fails."""
    assert rl.LogGrid(0.01, 1, 3).values() == [0.01, 0.1, 1.0]
    assert rl.LogGrid(1 / 3, 2 / 3, 2).values() == [1 / 3, 2 / 3]
    assert rl.LinearGrid(0.1, 0.5, 5).values() == [0.1, 0.2, 0.3, 0.4, 0.5]
    np.testing.assert_allclose(rl.LogGrid(0.01, 0.5, 5).values(), np.geomspace(0.01, 0.5, 5), rtol=1e-11)


def test_whole_numbers_stay_whole_where_all_are():
    grid = rl.LogGrid(1, 16, 5).values() + rl.LinearGrid(-1, 7, 3).values()
    assert grid == [1, 2, 4, 8, 16, -1, 3, 7]
    assert {type(x) for x in grid} == {int}
    assert [type(x) for x in rl.LinearGrid(1, 2, 3).values() + rl.LinearGrid(1.0, 2, 2).values()] == [
        float
    ] * 5


@pytest.mark.parametrize(
    ("random", "distribution"),
    [
        (rl.Uniform(-2, 3), stats.uniform(-2, 5)),
        (rl.LogUniform(0.01, 10), stats.loguniform(0.01, 10)),
    ],
)
def test_numbers_are_distributed_as_they_say(random, distribution):
    """Broken once: LogUniform without the logarithm -> fails."""
    found = drawn({"alpha": random})["alpha"]
    assert random.low <= min(found) and max(found) <= random.high
    assert stats.kstest(found, distribution.cdf).pvalue > 0.01


@pytest.mark.parametrize(
    ("random", "values"), [(rl.Integers(-1, 2), [-1, 0, 1, 2]), (rl.Choice(["a", 2.0]), ["a", 2.0])]
)
def test_single_values_are_equally_likely(random, values):
    found = drawn({"n": random})["n"]
    assert set(found) == set(values)
    assert stats.chisquare([found.count(value) for value in values]).pvalue > 0.01


def test_draws_depend_on_seed_method_name_and_number_alone():
    """Broken once: one stream of random numbers for all hyperparameters in their order -> fails."""
    alpha, epsilon = rl.LogUniform(0.01, 1), rl.Uniform(0, 1)
    both = drawn({"alpha": alpha, "epsilon": epsilon}, 5)
    assert drawn({"epsilon": epsilon, "gamma": 0.5, "alpha": alpha}, 5) == both
    assert drawn({"alpha": alpha}, 9)["alpha"][:5] == both["alpha"]
    same = {"alpha": epsilon, "epsilon": epsilon}
    others = [drawn(same, 5), drawn(same, 5, seed=1), drawn(same, 5, method="q-learning")]
    lists = [tuple(found) for other in others for found in other.values()]
    assert len(set(lists)) == 6


def test_draws_are_the_same_ever_after():
    """A result can be had again only so: these numbers must never change."""
    found = drawn({"alpha": rl.LogUniform(0.01, 1), "n": rl.Integers(1, 8)}, 3)
    assert found == {"alpha": [0.239220611232, 0.594993358906, 0.0227899340203], "n": [6, 7, 3]}


def test_what_is_drawn_together_is_one_axis_behind_the_grids():
    grid = {"alpha": rl.LogUniform(0.1, 1), "epsilon": [0.1, 0.5], "q0": rl.Uniform(-1, 0)}
    found, configs = configurations(rl.Sarsa, grid, num_draws=3)
    assert list(found) == ["epsilon", "draw"]
    assert axes.swept_names(found) == ["epsilon", "alpha", "q0"]
    expected = [(epsilon, trial["alpha"], trial["q0"]) for epsilon in (0.1, 0.5) for trial in found["draw"]]
    assert [(config.epsilon, config.alpha, config.q0) for config in configs] == expected


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: rl.LogGrid(0, 1, 3), "the ends must be above 0 on a logarithmic scale, not 0"),
        (lambda: rl.LogUniform(-1, 1), "the ends must be above 0 on a logarithmic scale, not -1"),
        (lambda: rl.Uniform(1, 0.5), "the low end, 1, must be below the high end, 0.5"),
        (lambda: rl.LinearGrid(0, 1, 1), "points must be a whole number of at least 2, not 1"),
        (lambda: rl.LinearGrid(0, float("inf"), 3), "the ends must be numbers, 1e+100 at most, not inf"),
        (lambda: rl.LogUniform(1, 10**400), "the ends must be numbers, 1e+100 at most, not 1000"),
        (lambda: rl.Uniform("0", 1), "the ends must be numbers, 1e+100 at most, not '0'"),
        (
            lambda: rl.Integers(1, 2.5),
            "Integers: high must be a whole number of at least -2147483648, not 2.5",
        ),
        (lambda: rl.Choice([]), "a choice must be among a list of values, not []"),
        (lambda: rl.Choice("glie"), "a choice must be among a list of values, not 'glie'"),
        (lambda: drawn({"alpha": rl.Uniform(0, 1)}, None), "alpha is drawn at random: say how many draws"),
        (lambda: drawn({"alpha": rl.Uniform(0, 1)}, 0), "draws must be a whole number of at least 1, not 0"),
        (
            lambda: drawn({"alpha": [0.5]}, 3),
            "there is nothing to draw: no hyperparameter of sarsa is random",
        ),
        (lambda: drawn({"draw": [{"alpha": 1}, {"q0": 1}]}, None), "draw 1 has other hyperparameters than"),
        (
            lambda: drawn({"draw": [{"alpha": 1}], "alpha": 1}, None),
            "alpha is given both in the draws and beside them",
        ),
        (lambda: drawn({"draw": [0.5]}, None), "draw must be a list of dicts from hyperparameters to values"),
        (lambda: drawn({"draw": [{}], "q0": rl.Uniform(0, 1)}, 2), "and there are draws already"),
    ],
)
def test_bad_input_is_refused(wrong, message):
    with pytest.raises(InputError) as error:
        wrong()
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_sweep_over_draws_has_them_as_coordinates(windy, tmp_path):
    """Also in the file, with schedules among numbers; each run is the run with its own hyperparameters."""
    grid = {"alpha": rl.LogUniform(0.1, 1), "epsilon": rl.Choice([0.5, rl.schedules.glie()]), "q0": [0, -1]}
    budget = {"num_seeds": 2, "num_steps": 300, "log_every": 100}
    result = rl.sweep(windy, "sarsa", grid | {"gamma": rl.Choice([0.5, 1.0])}, num_draws=4, **budget)
    assert repr(result) == "<SweepResult of sarsa in windy-gridworld: 2 q0, 4 draw, 2 seeds>"
    with export.load(export.save(result.to_xarray(), tmp_path / "x.nc"))["sarsa"] as ds:
        assert ds.episodes.dims == ("q0", "draw", "seed", "row")
        assert all(ds[name].dims == ("draw",) for name in ("alpha", "epsilon", "gamma", "optimum"))
        assert set(ds.epsilon.values) == {0.5, "glie"} and set(ds.gamma.values) == {0.5, 1}
        np.testing.assert_allclose(ds.optimum.where(ds.gamma == 1, drop=True), -15)
        assert ds.attrs["fixed"] == "{}"
        alpha = float(ds.alpha[3])
    trial = result.grid["draw"][3]
    assert trial["alpha"] == alpha
    alone = rl.sweep(windy, "sarsa", trial | {"q0": -1}, **budget)
    np.testing.assert_array_equal(result.q[1, 3], alone.q)


@pytest.mark.slow
def test_numbers_beside_schedules_stay_numbers_in_memory_and_in_files(windy, tmp_path):
    """Broken once: all as text, or the file not read back -> fails."""
    grid = {"alpha": [0.5, rl.schedules.sample_average()], "epsilon": [0.1, rl.schedules.glie(), 0]}
    ds = rl.sweep(windy, "sarsa", grid, num_seeds=2, num_steps=300).to_xarray()
    alone = rl.sweep(windy, "sarsa", {"alpha": 0.5, "epsilon": 0.1}, num_seeds=2, num_steps=300)
    read = export.load(export.save(ds, tmp_path / "x.nc"))["sarsa"]
    xr.testing.assert_identical(read.load(), ds)
    for found in (ds, read):
        assert found.epsilon.values.tolist() == [0.1, "glie", 0]
        np.testing.assert_array_equal(found.sel(alpha=0.5, epsilon=0.1).q, alone.q)
        assert found.sel(epsilon="glie", alpha="sample-average").episodes.dims == ("seed", "row")
    frame = export.to_pandas(ds, per="seed")
    assert frame.epsilon.unique().tolist() == ["0.1", "glie", "0"]
    with xr.open_datatree(tmp_path / "x.nc", engine="h5netcdf") as tree:  # without us they are texts
        assert tree["sarsa"].epsilon.values.tolist() == ["0.1", "glie", "0"]


@pytest.mark.parametrize(
    ("method", "grid"),
    [("sarsa-lambda", {"trace": ["accumulating", "dutch"]}), ("monte-carlo", {"first_visit": [False, True]})],
)
def test_names_and_switches_are_axes_like_any_number(windy, tmp_path, method, grid):
    ds = rl.sweep(windy, method, grid, num_seeds=1, num_steps=100).to_xarray()
    ds.to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    ((name, values),) = grid.items()
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as read:
        assert read[name].values.tolist() == values
        assert read.sel({name: values[1]}).episodes.dims == ("seed", "row")
