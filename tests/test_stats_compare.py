"""Comparisons, curves, selection, diverged runs and drawn hyperparameters."""

import numpy as np
import pytest
import xarray as xr
from scipy import stats as oracle

import jaxrl_tab as rl
from jaxrl_tab import stats

nan, inf = np.nan, np.inf


def per_seed(values, **coords):
    return xr.DataArray(np.asarray(values, float), dims=(*coords, "seed"), coords=coords)


# --- comparisons -------------------------------------------------------------------------------------


def test_paired_difference_by_hand():
    """x - y is 1, ..., 7: mean 4, s^2 = 14/3; Var x = 121 · 14/3, Var y = 100 · 14/3; t(6) at 97.5%: 2.446912."""
    x, y = per_seed(11 * np.arange(1, 8)), per_seed(10 * np.arange(1, 8))
    found = stats.paired_difference(x, y)
    assert float(found.interval.estimate) == 4
    half = 2.446912 * (14 / 3 / 7) ** 0.5
    np.testing.assert_allclose([found.interval.low, found.interval.high], [4 - half, 4 + half], rtol=1e-6)
    p = oracle.ttest_rel(x, y).pvalue  # 0.0027, of symmetric differences
    np.testing.assert_allclose(found.p, max(p, 2 / 2**7))  # and at best 0.0156 in the sign test
    np.testing.assert_allclose(found.reduction, 1 - 1 / 221)


@pytest.mark.parametrize(("n", "p"), [(2, 0.5), (5, 2 / 2**5), (6, 2 / 2**6), (20, 2 / 2**20)])
def test_equal_differences_give_no_certainty(n, p):
    """Of two differences of 1 the interval was [1, 1], and p 0. Zeros say nothing of the sign."""
    found = stats.paired_difference(per_seed([1.0] * n), per_seed([0.0] * n))
    assert float(found.p) == p
    assert (float(found.interval.low), float(found.interval.high)) == (0 if n < 6 else 1, 1)
    negative = stats.paired_difference(per_seed([0.0] * n), per_seed([1.0] * n))
    assert (float(negative.interval.low), float(negative.interval.high)) == (-1, 0 if n < 6 else -1)
    assert float(stats.paired_difference(per_seed([0.0] * n), per_seed([0.0] * n)).p) == 1


def test_p_value_and_interval_agree():
    """0 is a bound of the interval whose confidence is 1 - p."""
    rng = np.random.default_rng(0)
    x, y = (per_seed(rng.exponential(size=(20, 12)), alpha=np.arange(20)) for _ in range(2))
    for alpha in range(20):
        p = float(stats.paired_difference(x[alpha], y[alpha]).p)
        interval = stats.paired_difference(x[alpha], y[alpha], confidence=max(1 - p, 1e-9)).interval
        assert p == 1 or min(abs(interval.low), abs(interval.high)) < 1e-9


def test_pairs_are_seeds_with_the_same_number():
    x = xr.DataArray([1.0, 2, 3], dims="seed", coords={"seed": [0, 1, 2]})
    y = x.assign_coords(seed=[3, 4, 5])
    with pytest.raises(rl.InputError, match=r"the same labels along seed: \[0 1 2\] and \[3 4 5\]"):
        stats.paired_difference(x, y)
    with pytest.raises(rl.InputError, match="the same labels along seed"):
        stats.paired_difference(x, x[:2])
    found = stats.paired_difference(x, per_seed([nan, 1, 4]).assign_coords(seed=x.seed))
    assert (float(found.interval.estimate), int(found.interval.n)) == (0, 2)
    np.testing.assert_allclose(found.reduction, 1 - 2 / (0.5 + 4.5))


def test_the_reduction_is_what_pairing_saves(windy):
    """Episodes with two step sizes: the variance of the difference, of the same seeds and of others."""
    ds = rl.sweep(windy, rl.Sarsa, {"alpha": [0.1, 0.12]}, num_seeds=500, num_steps=300).to_xarray()
    x, y = ds.episodes.sum("row").astype(float)
    found = stats.paired_difference(x, y)
    measured = 1 - float((x - y).var()) / np.var(x.values - np.roll(y.values, 1))
    assert measured > 0.7
    assert float(found.reduction) == pytest.approx(measured, abs=0.03)
    pairs, apart = found.interval.high - found.interval.low, oracle.ttest_ind(x, y, equal_var=False)
    assert float(pairs) < 0.6 * np.ptp(apart.confidence_interval())


def test_probability_of_improvement_is_mann_whitneys():
    rng = np.random.default_rng(0)
    x, y = rng.poisson(2, (4, 9)), rng.poisson(3, (4, 14))  # with ties
    found = stats.probability_of_improvement(per_seed(x, alpha=range(4)), per_seed(y, alpha=range(4)))
    np.testing.assert_allclose(found.estimate, oracle.mannwhitneyu(x, y, axis=1).statistic / (9 * 14))
    np.testing.assert_array_equal(found.n, 23)
    back = stats.probability_of_improvement(per_seed(y, alpha=range(4)), per_seed(x, alpha=range(4)))
    np.testing.assert_allclose(back.low, 1 - found.high)


def test_probability_of_improvement_where_all_are_better():
    """The interval still has a width; a run without a score loses, and so is not dropped."""
    one, two = per_seed(range(10)), per_seed(range(10, 20))
    better = stats.probability_of_improvement(two, one)
    assert float(better.estimate) == float(better.high) == 1
    assert 0.7 < float(better.low) < 0.9
    two[:5] = nan
    assert float(stats.probability_of_improvement(two, one).estimate) == 0.5
    assert float(stats.probability_of_improvement(one * nan, one * nan).estimate) == 0.5


@pytest.mark.parametrize("over", [None, "method"])
def test_holm_by_hand(over):
    """0.01 · 4, 0.02 · 3, 0.03 · 2 raised to 0.06, 0.5; a comparison that was not made does not count."""
    p = xr.DataArray([0.03, 0.01, nan, 0.5, 0.02], dims="method")
    np.testing.assert_allclose(stats.holm(p, over), [0.06, 0.04, nan, 0.5, 0.06])


def test_holm_of_families():
    p = xr.DataArray([[0.01, 0.04], [0.03, 0.02]], dims=("env", "method"))
    np.testing.assert_allclose(stats.holm(p, "method"), [[0.02, 0.04], [0.04, 0.04]])
    np.testing.assert_allclose(stats.holm(p), [[0.04, 0.06], [0.06, 0.06]])
    np.testing.assert_allclose(stats.holm(p, "env"), [[0.02, 0.04], [0.03, 0.04]])
    with pytest.raises(rl.InputError, match="p-values must be from 0 to 1"):
        stats.holm(p - 0.02)
    with pytest.raises(rl.InputError, match="no dimension 'seed'"):
        stats.holm(p, "seed")


@pytest.mark.parametrize(
    ("effect", "paired", "n"),
    [
        (0.5, False, 64),
        (0.8, False, 26),
        (0.2, False, 394),
        (2.0, False, 6),
        (0.15, True, 351),
        (2.0, True, 6),
    ],
)
def test_seeds_needed(effect, paired, n):
    """For power 0.8 statsmodels needs 63.8, 25.5, 393.4, 5.1 and 350.8; so Cohen (1992), table 2: 64, 26.

    Paired, at least six: fewer show nothing (sign test).
    """
    assert stats.seeds_needed(3 * effect, 3.0, paired=paired, power=0.8) == n
    assert stats.seeds_needed(-3 * effect, 3.0, paired=paired, power=0.8) == n


@pytest.mark.parametrize(("effect", "power"), [(1 / 1.2, 0.8), (1.0, 0.9), (0.5, 0.9)])
def test_seeds_needed_have_the_power_in_the_test_that_is_used(effect, power):
    """Of 20 000 experiments with so many seeds 80% find the difference, and fewer with four seeds less.

    Student's test would have it with 13 seeds for effect 1 and power 0.9; ours then has 0.87.
    """
    n = stats.seeds_needed(effect, 1.0, power=power)
    x = per_seed(np.random.default_rng(0).normal(effect, 1, (20_000, n)), trial=range(20_000))
    for seeds, found in ((x, True), (x[:, :-4], False)):
        p = stats.paired_difference(seeds, 0 * seeds).p
        assert (float((p < 0.05).mean()) > power - 0.006) == found  # three standard errors


def test_seeds_needed_says_what_is_wrong():
    assert stats.seeds_needed(1, 0) == 6
    assert stats.seeds_needed(1, 0, paired=False) == 2
    for given, message in (
        ({"difference": 0, "sd": 1}, "difference must be a number other than 0"),
        ({"difference": 1, "sd": -1}, "sd must be at least 0, not -1"),
        ({"difference": 1, "sd": nan}, "sd must be"),
        ({"difference": 1, "sd": 1, "power": 1}, "power must be greater than 0 and less than 1"),
    ):
        with pytest.raises(rl.InputError, match=message):
            stats.seeds_needed(**given)


# --- profiles and curves -----------------------------------------------------------------------------


def test_profile_by_hand():
    """Above, not at, the threshold; the band is ± 0.6239 of five runs (Kolmogorov's 5% point is 0.56328)."""
    x = per_seed([[0, 1, 1, 2, nan], [3, 3, 3, 3, 3]], alpha=[0.1, 0.5])
    share, low, high, n = stats.performance_profile(x, [-1, 1, 2.5])
    assert share.dims == ("alpha", "threshold")
    np.testing.assert_allclose(share, [[0.8, 0.2, 0], [1, 1, 1]])
    np.testing.assert_allclose(low, np.maximum(share - 0.56328, 0), atol=1e-5)
    np.testing.assert_allclose(high, np.minimum(share + 0.56328, 1), atol=1e-5)
    np.testing.assert_array_equal(n, [5, 5])
    pooled = stats.performance_profile(x, [1.0], within="alpha")
    assert (float(pooled.estimate[0]), int(pooled.n)) == (0.6, 10)
    with pytest.raises(rl.InputError, match="thresholds must be a flat list of numbers"):
        stats.performance_profile(x, [[1.0]])


CURVE = xr.DataArray(
    [[nan, -40, -20, -18], [-50, nan, -30, -10], [nan] * 4], dims=("seed", "row"), coords={"seed": [0, 1, 2]}
)


def test_area_under_a_curve():
    """A row without a value takes the last before, the first rows the first. Weighted by their widths."""
    np.testing.assert_allclose(stats.area_under_curve(CURVE), [-118 / 4, -140 / 4, nan])
    width = xr.DataArray([10, 10, 10, 20], dims="row")
    np.testing.assert_allclose(stats.area_under_curve(CURVE, width), [-136 / 5, -150 / 5, nan])
    np.testing.assert_allclose(stats.area_under_curve(CURVE.T, width), [-136 / 5, -150 / 5, nan])
    labelled = CURVE.assign_coords(row=[0, 1, 2, 3])  # as in every dataset; once it raised IndexError
    widths = width.assign_coords(row=[0, 1, 2, 3])
    np.testing.assert_allclose(stats.area_under_curve(labelled, widths), [-136 / 5, -150 / 5, nan])
    with pytest.raises(rl.InputError, match="no dimension 'row'"):
        stats.area_under_curve(CURVE.rename(row="step"))


def test_time_to_threshold():
    np.testing.assert_array_equal(stats.time_to_threshold(CURVE, -20), [3, 4, inf])
    np.testing.assert_array_equal(stats.time_to_threshold(CURVE, -5), [inf] * 3)
    time = xr.DataArray([10, 20, 30, 45], dims="row")
    np.testing.assert_array_equal(stats.time_to_threshold(CURVE, -18, time), [45, 45, inf])
    np.testing.assert_array_equal(stats.time_to_threshold(-CURVE, 40, at_most=True), [2, 3, inf])
    with pytest.raises(rl.InputError, match="no dimension 'row'"):
        stats.time_to_threshold(CURVE.rename(row="step"), 0)


# --- datasets ----------------------------------------------------------------------------------------


def dataset(returns, alphas=(0.1, 0.5), first_seed=0, diverged=None, root_seed=0):
    """One episode in the only row of each run: [alphas, seeds]."""
    returns = np.asarray(returns, float)
    axes = ("alpha", "seed")
    steps = np.full(returns.shape, 10)
    log = {"returns": returns, "episodes": np.ones(returns.shape, int), "steps": steps, "lengths": steps}
    ds = xr.Dataset({name: ((*axes, "row"), x[..., None]) for name, x in log.items()})
    ds["diverged"] = axes, np.zeros(returns.shape, bool) if diverged is None else np.asarray(diverged)
    seeds = first_seed + np.arange(returns.shape[1])
    ds.attrs = {"num_steps": 10, "log_every": 10, "root_seed": root_seed, "fixed": '{"epsilon": 0.1}'}
    return ds.assign_coords(alpha=list(alphas), seed=seeds)


def test_selection_is_reported_on_fresh_seeds():
    """Alpha 0.5 promises -9 and gives -11, with the interval -11 ± 4.303 · 1 / sqrt(3)."""
    ds = dataset([[-12, -11, -13], [-8, -9, -10]])
    fresh = dataset([[-1, -1, -1], [-10, -11, -12]], first_seed=3)
    setting, promised, found, bias = stats.selection(ds, fresh)
    assert setting == {"alpha": 0.5}
    assert (float(promised.estimate), float(found.estimate), float(bias.estimate)) == (-9, -11, 2)
    half = 4.302653 / 3**0.5
    np.testing.assert_allclose([found.low, found.high], [-11 - half, -11 + half], rtol=1e-6)
    np.testing.assert_allclose([bias.low, bias.high], [2 - half, 2 + half], rtol=1e-6)
    alone = fresh.sel(alpha=0.5, drop=True).assign_attrs(fixed='{"alpha": 0.5, "epsilon": 0.1}')
    assert stats.selection(ds, alone).fresh.estimate == -11
    assert stats.selection(ds, fresh.sel(alpha=0.5)).fresh.estimate == -11


def test_selection_refuses_the_seeds_of_the_choice():
    ds = dataset([[-12, -11, -13], [-8, -9, -10]])
    with pytest.raises(rl.InputError, match="seed 2 is among those that the setting was chosen on"):
        stats.selection(ds, dataset([[0, 0], [0, 0]], first_seed=2))
    assert stats.selection(ds, dataset([[0, 0], [0, 0]], root_seed=1)).fresh.estimate == 0
    own_root = dataset([[0, 0], [0, 0]]).assign_attrs(fresh_seeds=1)
    assert stats.selection(ds, own_root).fresh.estimate == 0
    with pytest.raises(rl.InputError, match=r"the fresh runs have no alpha = 0.5"):
        stats.selection(ds, dataset([[0, 0], [0, 0]], alphas=(0.1, 0.2), first_seed=3))
    other = dataset([[0, 0]], alphas=[0.1], first_seed=3).isel(alpha=0)
    with pytest.raises(rl.InputError, match=r"the fresh runs must have alpha = 0.5, not 0.1"):
        stats.selection(ds, other)


@pytest.mark.slow
def test_selection_has_the_bias_of_the_best_of_many():
    """Twenty settings, all worth 0: the best of five seeds promises 1.867 / sqrt(5), fresh seeds 0.

    1.867 is the mean of the largest of twenty standard normal values.
    """
    rng = np.random.default_rng(0)
    promised, bias = [], []
    for _ in range(80):
        x, y = rng.normal(size=(2, 20, 5))
        found = stats.selection(dataset(x, range(20)), dataset(y, range(20), first_seed=5))
        promised.append(float(found.promised.estimate))
        bias.append(float(found.bias.estimate))
    assert abs(np.mean(promised) - 1.867 / 5**0.5) < 4 * np.std(promised) / 80**0.5
    assert abs(np.mean(bias) - 1.867 / 5**0.5) < 4 * np.std(bias) / 80**0.5


def test_best_by_something_else():
    ds = dataset([[-12, -11, -13], [-8, -9, -90]])
    assert stats.best(ds) == {"alpha": 0.1}
    assert stats.best(ds, lambda ds: stats.score(ds).clip(min=-15)) == {"alpha": 0.5}


def test_diverged_runs_are_the_worst_of_the_sweep_and_counted():
    """A setting at which runs diverge does not win, though the worst of the sweep is not bad here."""
    ds = dataset([[-12, -11, -13], [-8, inf, nan]], diverged=[[False] * 3, [False, True, True]])
    for numbers in (stats.final_return(ds), stats.learning_curve(ds)[..., 0], stats.mean_return(ds)):
        np.testing.assert_array_equal(numbers, [[-12, -11, -13], [-8, nan, nan]])
    np.testing.assert_array_equal(stats.score(ds), [[-12, -11, -13], [-8, -13, -13]])
    assert stats.best(ds) == {"alpha": 0.1}
    assert stats.tied(ds).values.tolist() == [True, False]
    table = stats.summary({"sarsa": ds.assign(episodes=ds.episodes)})
    assert table.diverged.tolist() == [0, 2]
    assert table.seeds.tolist() == [3, 3]
    np.testing.assert_allclose(table.last_tenth_return, [-12, -34 / 3])
    every = ds.assign(diverged=ds.diverged | True)
    assert (stats.score(every) == -inf).all()
    assert stats.best(every) == {"alpha": 0.1}


def test_diverged_runs_are_bad_where_that_is_the_question():
    ds = dataset([[-12, -11, -13], [-8, inf, nan]], diverged=[[False] * 3, [False, True, True]])
    curve, last = stats.learning_curve(ds), stats.final_return(ds)
    np.testing.assert_array_equal(stats.time_to_threshold(curve, -10), [[inf] * 3, [1, inf, inf]])
    profile = stats.performance_profile(last, [-100.0])
    np.testing.assert_allclose(profile.estimate[:, 0], [1, 1 / 3])
    better = stats.probability_of_improvement(last.isel(alpha=1), last.isel(alpha=0))
    assert float(better.estimate) == pytest.approx(1 / 3)


def test_divergence_survives_the_merging_of_rows():
    ds = dataset([[-12, -11, -13], [-8, inf, -9]], diverged=[[False] * 3, [False, True, False]])
    zero = ds.returns * 0
    merged = stats.merge_rows(ds.assign(steps=zero, lengths=zero, rewards=zero), 1)
    np.testing.assert_array_equal(stats.learning_curve(merged)[1, :, 0], [-8, nan, -9])


@pytest.fixture
def draws():
    """Three draws of alpha and lambda together, on an axis of their own beside that of the trace."""
    values = xr.DataArray([[-12.0, -11], [-9, -8], [-30, -31]], dims=("alpha", "seed"))
    ds = dataset(values, alphas=[0, 1, 2]).rename(alpha="draw")
    ds = xr.concat(
        [ds, ds.assign(returns=ds.returns - 1)], xr.Variable("trace", ["dutch", "replacing"]), data_vars="all"
    )
    ds = ds.transpose("draw", "trace", ...)
    return ds.assign_coords(alpha=("draw", [0.3, 0.07, 0.9]), lam=("draw", [0.5, 0.8, 0.2]))


def test_drawn_hyperparameters_have_one_axis(draws):
    assert stats.hyperparameters(draws) == ["draw", "trace"]
    assert stats.drawn(draws) == ["alpha", "lam"]
    chosen = stats.best(draws)
    assert chosen == {"draw": 1, "trace": "dutch"}
    assert draws.sel(chosen).returns.dims == ("seed", "row")
    assert stats.named(draws, chosen) == {"trace": "dutch", "alpha": 0.07, "lam": 0.8}
    assert stats.best(draws, draw=2) == {"draw": 2, "trace": "dutch"}
    with pytest.raises(
        rl.InputError, match="alpha was drawn together with others: hold draw; swept were draw, trace"
    ):
        stats.best(draws, alpha=0.3)


def test_summary_of_draws(draws):
    table = stats.summary({"sarsa-lambda": draws})
    assert table.columns[:6].tolist() == ["method", "draw", "trace", "alpha", "lam", "epsilon"]
    assert table.alpha.tolist() == [0.3, 0.3, 0.07, 0.07, 0.9, 0.9]
    assert table.last_tenth_return.tolist() == [-11.5, -12.5, -8.5, -9.5, -30.5, -31.5]


def test_selection_of_a_draw(draws):
    fresh = draws.assign_coords(seed=[2, 3]).sel(draw=1, trace="dutch", drop=True)
    fresh.attrs["fixed"] = '{"alpha": 0.07, "lam": 0.8, "trace": "dutch", "epsilon": 0.1}'
    fresh = fresh.drop_vars(["alpha", "lam"], errors="ignore")
    found = stats.selection(draws, fresh)
    assert (found.setting["draw"], float(found.fresh.estimate)) == (1, -8.5)
    fresh.attrs["fixed"] = '{"alpha": 0.3, "lam": 0.8, "trace": "dutch"}'
    with pytest.raises(rl.InputError, match=r"must have alpha = 0.07, not 0.3"):
        stats.selection(draws, fresh)
