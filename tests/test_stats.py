"""The statistics: numbers worked by hand, SciPy as the oracle, and the coverage of the interval."""

import json

import numpy as np
import pytest
import xarray as xr
from scipy import stats as oracle

import jaxrl_tab as rl
from jaxrl_tab import stats
from jaxrl_tab.engine.log import Log
from jaxrl_tab.stats import along


def make_dataset(steps, episodes, returns, alphas=(0.1, 0.5)):
    """What `sweep` would give for these logs, [alphas, seeds, rows]; Q is zero, of 2 states and 2 actions."""
    steps, episodes = np.asarray(steps, np.int32), np.asarray(episodes, np.int32)
    returns = np.asarray(returns, np.float32)
    result = rl.SweepResult(
        environment="windy-gridworld",
        algorithm="sarsa",
        env=rl.make("windy-gridworld"),
        grid={"alpha": tuple(alphas)},
        fixed={"epsilon": 0.1, "gamma": 1.0},
        log=Log(steps, episodes, returns, lengths=steps, rewards=-steps.astype(np.float32)),
        q=np.zeros((*steps.shape[:2], 2, 2), np.float32),
        optimal_value=np.array(-15.0),
        root_seed=0,
        num_steps=40,
        num_episodes=None,
        log_every=10,
        seconds=2.0,
        compile_seconds=1.0,
    )
    return result.to_xarray()


@pytest.fixture
def ds():
    """Two step sizes, three seeds, four rows of ten steps; alpha 0.5, seed 2: none in the last."""
    episodes = [[[0, 1, 1, 2], [1, 0, 2, 2], [0, 0, 0, 1]], [[1, 2, 3, 4], [1, 2, 3, 4], [1, 1, 0, 0]]]
    returns = [
        [[0, -30, -20, -36], [-9, 0, -40, -40], [0, 0, 0, -22]],
        [[-10, -16, -24, -28], [-10, -16, -24, -36], [-10, -9, 0, 0]],
    ]
    return make_dataset(np.full((2, 3, 4), 10), episodes, returns)


# --- the interval ------------------------------------------------------------------------------------


def test_interval_by_hand():
    """Of 1, 2, 3, 4, 5: mean 3, s^2 = 2.5, s / sqrt(5) = sqrt(0.5); t(4) at 97.5% is 2.776445."""
    mean, low, high, n = stats.mean_interval(xr.DataArray([1.0, 2, 3, 4, 5], dims="seed"))
    assert (float(mean), int(n)) == (3.0, 5)
    np.testing.assert_allclose([low, high], [3 - 2.7764451 * 0.5**0.5, 3 + 2.7764451 * 0.5**0.5], rtol=1e-7)


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.99])
def test_interval_is_scipys(confidence):
    x = np.random.default_rng(0).gamma(2.0, size=(4, 7, 3)).astype(np.float32)
    interval = stats.mean_interval(xr.DataArray(x, dims=("alpha", "seed", "row")), "seed", confidence, "t")
    expected = oracle.ttest_1samp(x.astype(float), 0, axis=1).confidence_interval(confidence)
    assert interval.estimate.dims == ("alpha", "row")
    np.testing.assert_allclose(interval.low, expected.low, rtol=1e-12)
    np.testing.assert_allclose(interval.high, expected.high, rtol=1e-12)


def test_interval_covers_the_mean():
    """Of 4000 intervals from ten normal values each, 95% hold the mean; SE 0.34%."""
    x = np.random.default_rng(1).normal(-20, 5, size=(4000, 10))
    interval = stats.mean_interval(xr.DataArray(x, dims=("trial", "seed")))
    covered = float(((interval.low <= -20) & (interval.high >= -20)).mean())
    assert 0.945 < covered < 0.97  # normal instead of t quantiles would cover 91.8%


def test_interval_is_over_the_dimension_named():
    """Values differ between rows and not at all between seeds: over seeds the interval is a point.

    Broken once: sums over the last axis, whatever `dim` -> fails.
    """
    x = xr.DataArray(np.tile([1.0, 2.0, 4.0], (5, 1)), dims=("seed", "row"))
    interval = stats.mean_interval(x)
    np.testing.assert_array_equal(interval.estimate, [1, 2, 4])
    np.testing.assert_array_equal(interval.high - interval.low, 0)
    assert int(stats.mean_interval(x, "row").n[0]) == 3


def test_interval_needs_its_dimension():
    with pytest.raises(rl.InputError, match=r"no dimension 'seed' .* there are alpha, row"):
        stats.mean_interval(xr.DataArray(np.zeros((2, 3)), dims=("alpha", "row")))
    with pytest.raises(rl.InputError, match="confidence must be greater than 0 and less than 1, not 95"):
        stats.mean_interval(xr.DataArray(np.zeros(3), dims="seed"), confidence=95)


def test_seeds_without_a_value_are_left_out_and_counted():
    nan = np.nan
    x = xr.DataArray([[1, nan, 3, nan], [nan, 7, nan, nan], [nan] * 4], dims=("row", "seed"))
    mean, low, high, n = stats.mean_interval(x)
    np.testing.assert_array_equal(n, [2, 1, 0])
    np.testing.assert_array_equal(mean, [2, 7, nan])
    half = 12.7062047 * 1  # t(1) at 97.5%, and s / sqrt(2) = sqrt(2) / sqrt(2)
    np.testing.assert_allclose(low, [2 - half, nan, nan], rtol=1e-8)
    np.testing.assert_allclose(high, [2 + half, nan, nan], rtol=1e-8)


def test_infinite_values_have_no_interval():
    mean, low, high, _ = stats.mean_interval(xr.DataArray([-np.inf, -1, -2], dims="seed"))
    assert float(mean) == -np.inf
    assert np.isnan([low, high]).all()


# --- numbers of each seed ----------------------------------------------------------------------------


def test_mean_return_weighs_episodes_equally(ds):
    """Seed 0, alpha 0.1: (-30 - 20 - 36) / 4 = -21.5; the mean of the rows' means would be -22.67."""
    got = stats.mean_return(ds)
    assert got.dims == ("alpha", "seed")
    np.testing.assert_allclose(got, [[-21.5, -17.8, -22], [-7.8, -8.6, -9.5]])
    np.testing.assert_allclose(stats.mean_return(ds, slice(3, 4)), [[-18, -20, -22], [-7, -9, np.nan]])


@pytest.mark.parametrize(
    ("budget", "log_every", "rows", "first"),
    [(8000, 100, 80, 72), (1000, 300, 4, 3), (1000, 400, 3, 2), (100, 100, 1, 0), (105, 10, 11, 10)],
)
@pytest.mark.parametrize("unit", ["num_steps", "num_episodes"])
def test_last_tenth(unit, budget, log_every, rows, first):
    """Rows that begin at 90% or later: of 8000 in hundreds, row 72 begins after step 7200."""
    ds = xr.Dataset({"steps": ("row", np.zeros(rows))}, attrs={unit: budget, "log_every": log_every})
    assert stats.last_tenth(ds) == slice(first, rows)


def test_learning_curve(ds):
    curve = stats.learning_curve(ds).sel(alpha=0.1)
    nan = np.nan
    np.testing.assert_array_equal(curve, [[nan, -30, -20, -18], [-9, nan, -20, -20], [nan, nan, nan, -22]])


def test_episode_curve(ds):
    curve = stats.episode_curve(ds)
    np.testing.assert_array_equal(curve.time_steps[0, 0], [10, 20, 30, 40])
    np.testing.assert_array_equal(curve.episodes[0], [[0, 1, 2, 4], [1, 1, 3, 5], [0, 0, 0, 1]])


def test_merge_rows(ds):
    """Four rows in at most three: pairs; sums stay what they were, and so does the mean return."""
    merged = stats.merge_rows(ds, 3)
    assert merged.sizes["row"] == 2
    np.testing.assert_array_equal(merged.episodes[0], [[1, 3], [1, 4], [0, 1]])
    np.testing.assert_array_equal(stats.mean_return(merged), stats.mean_return(ds))
    assert stats.merge_rows(ds, 4).equals(
        ds[["steps", "episodes", "returns", "lengths", "rewards", "diverged"]]
    )


# --- hyperparameters and the table -------------------------------------------------------------------


def test_best_counts_unfinished_runs(ds):
    """Alpha 0.5: -7, -9 and, with no episode in the last tenth, the -10 of its ten steps there: -8.67 on average.

    Broken once: left out -> fails.
    """
    np.testing.assert_array_equal(stats.unfinished(ds), [[False] * 3, [False, False, True]])
    np.testing.assert_array_equal(stats.score(ds), [[-18, -20, -22], [-7, -9, -10]])
    assert stats.best(ds) == {"alpha": 0.5}
    assert stats.best(ds, alpha=0.1) == {"alpha": 0.1}
    assert ds.sel(stats.best(ds)).returns.dims == ("seed", "row")
    ds["rewards"][1, 2, 3] = -500  # as on a cliff
    assert stats.best(ds) == {"alpha": 0.1}


def test_best_over_two_hyperparameters():
    axes = ("alpha", "epsilon", "seed", "row")
    ds = xr.Dataset(
        {"episodes": (axes, np.ones((2, 3, 4, 1), int)), "returns": (axes, np.full((2, 3, 4, 1), -20.0))},
        {"alpha": [0.1, 0.5], "epsilon": [0.0, 0.1, 0.2]},
        {"num_steps": 10, "log_every": 10},
    )
    ds["returns"][1, 2], ds["returns"][1, 0] = -10, -15
    assert stats.best(ds) == {"alpha": 0.5, "epsilon": 0.2}
    assert stats.best(ds, epsilon=0.0) == {"alpha": 0.5, "epsilon": 0.0}
    assert stats.best(ds, alpha=0.1) == {"alpha": 0.1, "epsilon": 0.0}


def test_best_where_nothing_was_finished(ds):
    assert stats.best(ds.assign(episodes=ds.episodes * 0)) == {"alpha": 0.1}


def test_best_names_what_was_swept(ds):
    with pytest.raises(rl.InputError, match="epsilon was not swept; swept were alpha"):
        stats.best(ds, epsilon=0.1)
    with pytest.raises(rl.InputError, match=r"alpha was not swept at 0.3; there are 0.1, 0.5"):
        stats.best(ds, alpha=0.3)


def test_summary(ds, tmp_path):
    """Worked by hand, and the same after a round trip through netCDF."""
    ds.to_netcdf(tmp_path / "sweep.nc")
    alone = make_dataset([[[10] * 4] * 2], [[[1] * 4] * 2], [[[-20] * 4] * 2], alphas=[0.9])
    alone = alone.isel(alpha=0, drop=True)  # nothing swept
    alone.attrs["fixed"] = json.dumps({"alpha": 0.9, "lam": 0.5})
    table = stats.summary({"sarsa": xr.load_dataset(tmp_path / "sweep.nc"), "sarsa-lambda": alone})
    of = lambda kind: [f"last_tenth_{kind}{end}" for end in ("", "_low", "_high")]
    assert table.columns.tolist() == [
        *[
            "method",
            "alpha",
            "epsilon",
            "gamma",
            "lam",
            "episodes",
            "first_episode_steps",
            "first_tenth_steps",
        ],
        *["last_tenth_steps", "first_tenth_unfinished", "first_tenth_return", "first_tenth_low"],
        *["first_tenth_high", "interim_return", "interim_low", "interim_high"],
        *["last_tenth_return", "last_tenth_low", "last_tenth_high", *of("median"), *of("iqm")],
        *["seeds", "unfinished", "diverged", "seeds_wanted", "best", "tied"],
        *["difference", "difference_low", "difference_high", "p", "steps_per_second", "optimum"],
    ]
    assert table.method.tolist() == ["sarsa", "sarsa", "sarsa-lambda"]
    assert table.alpha.tolist() == [0.1, 0.5, 0.9]
    np.testing.assert_array_equal(table.lam, [np.nan, np.nan, 0.5])
    np.testing.assert_allclose(table.episodes, [10 / 3, 22 / 3, 4])
    np.testing.assert_allclose(table.last_tenth_return, [-20, -26 / 3, -20])
    half = 4.30265273 * 2 / 3**0.5  # of -18, -20, -22
    assert table.last_tenth_low[0] == pytest.approx(-20 - half)
    assert table.last_tenth_high[0] == pytest.approx(-20 + half)
    np.testing.assert_array_equal(table.last_tenth_median, [-20, -9, -20])
    assert table.seeds.tolist() == [3, 3, 2]
    assert table.unfinished.tolist() == [0, 1, 0]
    assert table.best.tolist() == [False, True, True]
    assert table.tied.tolist() == [True, True, True]  # three seeds tell nothing apart
    assert table.p.isna().all()  # the methods have not the same seeds
    assert table.steps_per_second.tolist() == [120, 120, 40]  # 2 x 3 x 40 steps in 2 seconds
    assert (table.optimum == -15).all()


def test_optimum_where_gamma_was_swept(ds):
    """Every gamma has its own."""
    ds = ds.rename(alpha="gamma").assign_coords(gamma=[0.9, 1.0])
    ds["optimum"] = ("gamma", [-7.94, -15.0])
    ds.attrs["fixed"] = "{}"
    table = stats.summary({"sarsa": ds})
    assert table.gamma.tolist() == [0.9, 1.0]
    assert table.optimum.tolist() == [-7.94, -15.0]


def test_what_is_possible_in_a_row_is_judged_by_all_rows(monkeypatch):
    """Rewards above 0 come in the last row alone. Broken once: judged block by block -> an end is cut at 0."""
    count = np.ones((4, 3), np.int32)
    returns = np.array([[-3.0, -3, 5], [-1, -3, 5], [-2, -1, 5], [-0.1, -0.1, 6]])
    fields = {
        "episodes": count,
        "steps": 10 * count,
        "lengths": 10 * count,
        "returns": returns,
        "rewards": returns,
    }
    ds = xr.Dataset({name: (("seed", "row"), x) for name, x in fields.items()}).assign_attrs(
        num_steps=30, log_every=10
    )
    whole = stats.curve_interval(ds, 3)
    assert whole.high[0] > 0
    monkeypatch.setattr(along, "MEMORY", 4)
    for one, other in zip(stats.curve_interval(ds, 3), whole, strict=True):
        np.testing.assert_array_equal(one, other)
