"""Intervals on arrays with named axes: by hand, SciPy and rliable as oracles, and axes in the wrong place."""

import numpy as np
import pytest
import xarray as xr
from scipy import stats as oracle

import jaxrl_tab as rl
from jaxrl_tab import stats
from jaxrl_tab.stats import along, bootstrap, intervals

TIMES = xr.DataArray(
    np.random.default_rng(0).gamma(2.0, size=(3, 12, 4)),
    dims=("alpha", "seed", "row"),
    coords={"alpha": [0.1, 0.5, 0.9], "seed": np.arange(12)},
)


# --- the mean ----------------------------------------------------------------------------------------


def test_halls_interval_by_hand():
    """Of 0, 0, 0, 10: e = 2.5, g = 2, a = 1, and u = t + t²/3 + t³/27 + 1/6 = (1 + t/3)³ - 1 + 1/6.

    So t is 3 (cbrt(1 + u - 1/6) - 1) at u = ±3.1824, the quantiles of t(3). Below, Student's bound is wider.
    """
    interval = stats.mean_interval(xr.DataArray([0.0, 0, 0, 10], dims="seed"))
    np.testing.assert_allclose(interval.low, 2.5 - 3.182446 * 2.5, rtol=1e-6)
    u = -3.182446305
    np.testing.assert_allclose(interval.high, 2.5 - 2.5 * 3 * (np.cbrt(1 + u - 1 / 6) - 1), rtol=1e-6)


def test_halls_interval_mirrors_and_scales():
    one, two = stats.mean_interval(TIMES), stats.mean_interval(3 - 2 * TIMES)
    np.testing.assert_allclose(two.low, 3 - 2 * one.high)
    np.testing.assert_allclose(two.high, 3 - 2 * one.low)


@pytest.mark.parametrize("method", ["percentile", "bca"])
def test_bootstraps_are_scipys(method, monkeypatch):
    """But for the resamples, of which both take many: a bound has a standard error of 0.6% of the width."""
    monkeypatch.setattr(bootstrap, "RESAMPLES", 19_999)
    bootstrap._weights.cache_clear()
    interval = stats.mean_interval(TIMES, method=method)
    bootstrap._weights.cache_clear()
    expected = oracle.bootstrap(
        (TIMES.values,), np.mean, axis=1, method=method, n_resamples=19_999, rng=np.random.default_rng(1)
    ).confidence_interval
    width = (expected.high - expected.low).max()
    np.testing.assert_allclose(interval.low, expected.low, atol=0.03 * width)
    np.testing.assert_allclose(interval.high, expected.high, atol=0.03 * width)


def test_bootstrap_t_in_plain_loops():
    x = TIMES[1, :, 2]
    weights, t = bootstrap._weights(12), []
    for counts in np.rint(weights * 12).astype(int):
        drawn = np.repeat(x.values, counts)
        t.append((drawn.mean() - x.values.mean()) / (drawn.std(ddof=1) / 12**0.5))
    low, high = np.sort(t)[[49, 1949]]
    # The package takes the spread of a resample with n - 1 in both places, as here.
    error = x.values.std(ddof=1) / 12**0.5
    interval = stats.mean_interval(x, method="bootstrap-t")
    np.testing.assert_allclose(interval.low, x.values.mean() - high * error)
    np.testing.assert_allclose(interval.high, x.values.mean() - low * error)


@pytest.mark.parametrize("method", intervals.BOUNDS)
def test_values_that_are_all_equal_have_a_point(method):
    x = xr.DataArray([[2.0] * 5, [1, 2, 3, 4, 5]], dims=("alpha", "seed"))
    mean, low, high, _ = stats.mean_interval(x, method=method)
    assert (float(mean[0]), float(low[0]), float(high[0])) == (2, 2, 2)
    assert float(low[1]) < 3 < float(high[1])


@pytest.mark.parametrize("method", intervals.BOUNDS)
def test_a_place_has_the_interval_that_it_has_alone(method):
    """Whatever lies beside it, also where values are missing; and the seeds may be any axis."""
    x = TIMES.copy()
    x[0, 3, 1] = x[2, [0, 5, 7], 2] = np.nan
    whole = stats.mean_interval(x.transpose("row", "seed", "alpha"), method=method)
    for alpha, row in ((0, 1), (2, 2), (1, 0)):
        alone = stats.mean_interval(x[alpha, :, row].dropna("seed"), method=method)
        for part, of_all in zip(alone, whole, strict=True):
            np.testing.assert_allclose(of_all[row, alpha], part)


def test_blocks_change_nothing(monkeypatch):
    whole = stats.bootstrap_interval(TIMES, np.median)
    monkeypatch.setattr(along, "MEMORY", 12 * stats.RESAMPLES)
    for part, of_all in zip(stats.bootstrap_interval(TIMES, np.median), whole, strict=True):
        np.testing.assert_array_equal(part, of_all)


def test_an_unknown_method_is_named():
    with pytest.raises(rl.InputError, match=r"no method 'bcca' of an interval; did you mean 'bca'\?"):
        stats.mean_interval(TIMES, method="bcca")


# --- an axis in the wrong place ----------------------------------------------------------------------

EVERYTHING = {
    "mean": stats.mean_interval,
    "median": stats.median_interval,
    "iqm": stats.iqm_interval,
    "bootstrap": lambda x, dim="seed": stats.bootstrap_interval(x, np.mean, dim),
    "tolerance": stats.tolerance_interval,
    "proportion": lambda x, dim="seed": stats.proportion_interval(x > 1, dim),
    "simultaneous": lambda x, dim="seed": stats.simultaneous_interval(x, "alpha", dim),
    "profile": lambda x, dim="seed": stats.performance_profile(x, [1.0], dim),
    "paired": lambda x, dim="seed": stats.paired_difference(x, x + 1, dim).interval,
    "improvement": lambda x, dim="seed": stats.probability_of_improvement(x, x, dim),
}


@pytest.mark.parametrize("of", EVERYTHING.values(), ids=EVERYTHING)
def test_an_axis_in_the_wrong_place_is_an_error(of):
    with pytest.raises(rl.InputError, match=r"no dimension 'seed' .* there are alpha, run, row"):
        of(TIMES.rename(seed="run"))
    with pytest.raises(rl.InputError, match=r"no dimension 1 to take"):
        of(TIMES, 1)
    if of is not EVERYTHING["proportion"]:
        with pytest.raises(rl.InputError, match=r"must be an xarray\.DataArray, whose axes have names"):
            of(TIMES.values)


@pytest.mark.parametrize("of", EVERYTHING.values(), ids=EVERYTHING)
def test_the_order_of_the_axes_does_not_matter(of):
    """Broken once: values reshaped without a transposition -> fails."""
    one, two = of(TIMES), of(TIMES.transpose("row", "seed", "alpha"))
    assert "seed" not in one.estimate.dims
    for x, y in zip(one, two, strict=True):
        xr.testing.assert_allclose(x, y.transpose(*x.dims))
    assert one.low.sizes["alpha"] == 3
    assert (one.low <= one.estimate).all()
    assert (one.estimate <= one.high).all()


def test_nothing_to_take_a_statistic_of():
    with pytest.raises(rl.InputError, match=r"nothing lies along the dimension 'seed'"):
        stats.mean_interval(TIMES[:, :0])
    with pytest.raises(rl.InputError, match=r"the dimensions seed, seed must be different"):
        stats.iqm_interval(TIMES, within="seed")
    with pytest.raises(rl.InputError, match=r"no dimension 'environment'"):
        stats.iqm_interval(TIMES, within="environment")


# --- many at once ------------------------------------------------------------------------------------


def test_a_simultaneous_interval_of_one_place_is_bootstrap_t():
    x = TIMES[:1, :, 0]
    one, two = stats.simultaneous_interval(x, "alpha"), stats.mean_interval(x, method="bootstrap-t")
    np.testing.assert_allclose(one.low, two.low)
    np.testing.assert_allclose(one.high, two.high)


def test_simultaneous_intervals_are_wider_and_know_what_goes_together():
    """Copies of one value need no correction, and do not get one."""
    x = TIMES[:, :, 0]
    together, alone = stats.simultaneous_interval(x, "alpha"), stats.mean_interval(x, method="bootstrap-t")
    assert (together.low <= alone.low).all()
    assert (together.high >= alone.high).all()
    copies = stats.simultaneous_interval(x.isel(alpha=[0, 0, 0]), "alpha")
    np.testing.assert_allclose(copies.low, float(alone.low[0]))
    apart = stats.simultaneous_interval(TIMES, "alpha")
    np.testing.assert_allclose(apart.low[:, 0], together.low)
    both = stats.simultaneous_interval(TIMES, ["alpha", "row"])
    assert (both.low <= apart.low).all()


def test_a_place_without_enough_values_leaves_the_others_as_they_are():
    x = TIMES[:, :, 0].copy()
    expected = stats.simultaneous_interval(x[1:], "alpha")
    x[0, 1:] = np.nan
    found = stats.simultaneous_interval(x, "alpha")
    assert np.isnan(found.low[0])
    np.testing.assert_allclose(found.low[1:], expected.low)
    x[0] = 7.0  # without spread
    found = stats.simultaneous_interval(x, "alpha")
    assert float(found.low[0]) == float(found.high[0]) == 7
    np.testing.assert_allclose(found.high[1:], expected.high)


# --- median, interquartile mean, single runs ---------------------------------------------------------


def test_median_by_hand():
    """Of ten values the 2nd to the 9th hold the median in 97.85%, the 3rd to the 8th in 89.06%."""
    x = xr.DataArray(np.arange(10.0) ** 2, dims="seed")
    two, three = (1 - 2 * oracle.binom.cdf(k, 10, 0.5) for k in (1, 2))
    assert (round(two, 4), round(three, 4)) == (0.9785, 0.8906)
    exact = stats.median_interval(x, confidence=two - 1e-12)
    np.testing.assert_allclose(exact[:3], [20.5, 1, 64], rtol=1e-6)
    median, low, high, n = stats.median_interval(x)
    inner = (two - 0.95) / (two - three)
    inner = 8 * inner / (2 + 6 * inner)
    np.testing.assert_allclose([median, low, high], [20.5, 1 + 3 * inner, 64 - 15 * inner])
    assert int(n) == 10
    assert np.isnan(stats.median_interval(x[:5]).low)  # between the extremes in 93.75% only
    assert float(stats.median_interval(x[:6]).low) < 1


def test_median_of_times_that_are_censored():
    """Four of ten never get there: the median is known, the upper bound not; of six not even the median."""
    inf = np.inf
    x = xr.DataArray(
        [[1, 2, 3, 4, 5, 6, inf, inf, inf, inf], [1, 2, 3, 4] + [inf] * 6], dims=("alpha", "seed")
    )
    median, low, high, n = stats.median_interval(x)
    np.testing.assert_array_equal(median, [5.5, inf])
    assert (low < 3).all()
    np.testing.assert_array_equal(high, inf)
    np.testing.assert_array_equal(n, 10)


def test_iqm_by_hand():
    """The middle half of 1, 2, 3, ..., 7, 100 is 3, 4, 5, 6."""
    interval = stats.iqm_interval(xr.DataArray([100.0, 1, 7, 2, 6, 3, 5, 4], dims="seed"))
    assert float(interval.estimate) == 4.5
    assert np.isnan(stats.iqm_interval(xr.DataArray([1.0], dims="seed")).low)
    pooled = xr.DataArray([[100.0, 1, 7, 2], [6, 3, 5, 4]], dims=("environment", "seed"))
    assert float(stats.iqm_interval(pooled, within="environment").estimate) == 4.5


@pytest.mark.parametrize("n", [2, 3, 5, 12])
def test_the_fast_iqm_is_the_iqm_of_each_resample(n):
    """With the same resamples, in a plain loop: its quantiles are the bounds."""
    x = TIMES[0, :n]
    counts = np.rint(bootstrap._weights(n) * n).astype(int)
    resampled = [stats.iqm(np.repeat(np.sort(x[:, 1]), count)) for count in counts]
    interval = stats.iqm_interval(x)
    expected = np.quantile(resampled, oracle.norm.cdf(np.array([-1, 1]) * 1.959964 * (n / (n - 1)) ** 0.5))
    np.testing.assert_allclose([interval.low[1], interval.high[1]], expected, rtol=1e-5)


def plain_level(n, strata):
    """The confidence of a plain percentile bootstrap that has the quantiles of ours for 95%."""
    t = oracle.t.ppf(0.975, n - strata) * np.sqrt(n / (n - strata))
    return 1 - 2 * oracle.norm.sf(t)


def test_bootstrap_interval_is_scipys():
    interval = stats.bootstrap_interval(TIMES, np.median)
    expected = oracle.bootstrap(
        (TIMES.values,), np.median, axis=1, method="percentile", confidence_level=plain_level(12, 1), rng=1
    ).confidence_interval
    width = expected.high - expected.low
    assert (abs(interval.low - expected.low) < 0.12 * width).all()
    assert (abs(interval.high - expected.high) < 0.12 * width).all()
    assert (abs(interval.low - expected.low).mean() < 0.02 * width.mean()).all()


SCORES = np.random.default_rng(0).gamma(2.0, size=(12, 5))  # runs x environments


def test_stratified_iqm_is_rliables():
    """rliable 1.2.0 gave this (95% percentiles of 20 000 resamples)."""
    x = xr.DataArray(SCORES, dims=("seed", "environment"))
    interval = stats.iqm_interval(x, within="environment")
    assert float(interval.estimate) == pytest.approx(1.6765383029530048)
    assert int(interval.n) == 60
    widened = np.sqrt(60 / 55) * oracle.t.ppf(0.975, 55) / 1.959964
    np.testing.assert_allclose(interval.low, 1.6765 - widened * (1.6765 - 1.36827), atol=0.02)
    np.testing.assert_allclose(interval.high, 1.6765 + widened * (2.02565 - 1.6765), atol=0.03)


def test_rliable_itself():
    library = pytest.importorskip("rliable.library", reason="rliable does not import with pandas 3")
    metrics = pytest.importorskip("rliable.metrics")
    x = xr.DataArray(SCORES, dims=("seed", "environment"))
    found = stats.iqm_interval(x, within="environment")
    point, interval = library.get_interval_estimates(
        {"a": SCORES},
        lambda scores: np.array([metrics.aggregate_iqm(scores)]),
        reps=5000,
        confidence_interval_size=plain_level(60, 5),
    )
    np.testing.assert_allclose(found.estimate, point["a"][0])
    np.testing.assert_allclose([found.low, found.high], interval["a"][:, 0], atol=0.03)
    profile, _ = library.create_performance_profile({"a": SCORES}, np.array([0.0, 1, 2, 4]), reps=10)
    np.testing.assert_allclose(
        stats.performance_profile(x, [0.0, 1, 2, 4], within="environment").estimate, profile["a"]
    )


def test_the_bootstrap_stays_within_its_stratum():
    """Two environments that differ and do not vary: stratified, there is nothing uncertain.

    Broken once: resampled along both dimensions together -> fails.
    """
    x = xr.DataArray([[0.0] * 6, [10.0] * 6], dims=("environment", "seed"))
    interval = stats.bootstrap_interval(x, np.mean, within="environment")
    np.testing.assert_array_equal(interval[:3], [5, 5, 5])


def test_strata_of_different_size():
    x = xr.DataArray([[0.0, 0, 0, np.nan], [10.0, np.nan, np.nan, np.nan]], dims=("environment", "seed"))
    interval = stats.bootstrap_interval(x, np.mean, within="environment")
    np.testing.assert_array_equal(interval, [2.5, 2.5, 2.5, 4])


@pytest.mark.parametrize(("n", "rank"), [(46, 1), (75, 1), (76, 2), (1000, 42)])
def test_tolerance_by_order_statistics(n, rank):
    """The r-th from either end: from 46 values on the first, from 76 the second (Conover 1999, table A6)."""
    x = xr.DataArray(np.random.default_rng(1).permutation(n).astype(float), dims="seed")
    median, low, high, _ = stats.tolerance_interval(x)
    assert [float(v) for v in (median, low, high)] == [(n - 1) / 2, rank - 1, n - rank]
    # What lies between them is less than 90% where fewer than 2 r of n uniform values are in the other 10%.
    assert oracle.binom.sf(2 * rank - 1, n, 0.1) >= 0.95 > oracle.binom.sf(2 * rank + 1, n, 0.1)


def test_tolerance_of_few_values_is_the_normal_one():
    """k for 90% with confidence 95%: 2.839 for ten values, 2.140 for thirty (tables of two-sided k)."""
    for n, k in ((10, 2.839), (30, 2.140)):
        x = xr.DataArray(np.random.default_rng(2).normal(size=n), dims="seed")
        interval = stats.tolerance_interval(x)
        mean, s = float(x.mean()), float(x.std(ddof=1))
        np.testing.assert_allclose([interval.low, interval.high], [mean - k * s, mean + k * s], rtol=5e-3)
    assert np.isnan(stats.tolerance_interval(x[:1]).low)
    with pytest.raises(rl.InputError, match=r"content must be greater than 0 and less than 1, not 90"):
        stats.tolerance_interval(x, content=90)


@pytest.mark.parametrize("k", [0, 3, 10])
def test_proportion_is_wilsons(k):
    x = xr.DataArray(np.arange(10) < k, dims="seed")
    expected = oracle.binomtest(k, 10).proportion_ci(method="wilson")
    np.testing.assert_allclose(stats.proportion_interval(x)[:3], [k / 10, *expected], atol=1e-12)
    with pytest.raises(rl.InputError, match=r"True or False"):
        stats.proportion_interval(TIMES)
