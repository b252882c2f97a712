"""How often 95% intervals hold the true value in simulation: 93% to 97%, or what the docstrings say.

A share of 10 000 has a standard error of 0.22%, of 2000 of 0.5%.
"""

import numpy as np
import pytest
import xarray as xr
from marks import slow_but
from scipy import stats as oracle

from jaxrl_tab import stats
from jaxrl_tab.stats import bootstrap

SEEDS = (10, 30, 100)
DISTRIBUTIONS = {
    "normal": oracle.norm,
    "exponential": oracle.expon,
    "gamma(1/2)": oracle.gamma(0.5),
    "lognormal(1/2)": oracle.lognorm(0.5),
    "lognormal(1)": oracle.lognorm(1),
    "t(4)": oracle.t(4),
}
QUARTILES = (np.arange(20_000) + 0.5) / 20_000 / 2 + 0.25  # of the middle half, for the interquartile mean


def samples(name, trials, *shape):
    """[trial, environment, seed], or without environments."""
    rng = np.random.default_rng([len(name), *shape])
    values = {
        "normal": rng.standard_normal,
        "exponential": rng.standard_exponential,
        "gamma(1/2)": lambda size: rng.standard_gamma(0.5, size),
        "lognormal(1/2)": lambda size: rng.lognormal(0, 0.5, size),
        "lognormal(1)": lambda size: rng.lognormal(0, 1, size),
        "t(4)": lambda size: rng.standard_t(4, size),
    }[name]((trials, *shape))
    return xr.DataArray(
        values, dims=("trial", "environment", "seed") if len(shape) > 1 else ("trial", "seed")
    )


def covered(interval, truth):
    """In per cent."""
    return 100 * float(((interval.low <= truth) & (truth <= interval.high)).mean())


@pytest.mark.parametrize("n", SEEDS)
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_mean(name, n):
    """Broken once: the skewness with its sign turned -> 90.2% of ten exponential values."""
    held = covered(stats.mean_interval(samples(name, 10_000, n)), DISTRIBUTIONS[name].mean())
    if (name, n) == ("lognormal(1)", 10):
        assert held == pytest.approx(92.1, abs=1)  # nothing tried reaches 93 there
    else:
        assert 93 < held < 97


TABLE = {  # of other methods, as in the docstring of the module: of 10 and 100 values
    ("t", "normal"): (95.0, 95.1),
    ("t", "exponential"): (89.7, 94.0),
    ("percentile", "normal"): (90.5, 94.8),
    ("percentile", "exponential"): (85.8, 93.5),
    ("bca", "normal"): (90.1, 94.7),
    ("bca", "exponential"): (87.3, 93.8),
    ("bootstrap-t", "normal"): (95.3, 95.3),
    ("bootstrap-t", "exponential"): (93.8, 94.7),
}


@pytest.mark.slow
@pytest.mark.one_in(5)
@pytest.mark.parametrize(("method", "name"), TABLE)
def test_the_table_of_other_methods(method, name):
    for n, expected in zip((10, 100), TABLE[method, name], strict=True):
        held = covered(stats.mean_interval(samples(name, 3000, n), method=method), DISTRIBUTIONS[name].mean())
        assert held == pytest.approx(expected, abs=2)


@pytest.mark.parametrize("n", SEEDS)
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_median(name, n):
    assert 93 < covered(stats.median_interval(samples(name, 10_000, n)), DISTRIBUTIONS[name].median()) < 97


@pytest.mark.parametrize("n", slow_but([10], SEEDS))
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_interquartile_mean(name, n):
    held = covered(stats.iqm_interval(samples(name, 4000, n)), DISTRIBUTIONS[name].ppf(QUARTILES).mean())
    assert 93 < held < 97


@pytest.mark.slow
@pytest.mark.parametrize("name", ["normal", "exponential"])
def test_the_interquartile_mean_over_environments(name, monkeypatch):
    """Five environments, whose scores differ, with ten seeds each."""
    monkeypatch.setattr(bootstrap, "RESAMPLES", 499)
    shift = np.linspace(0, 2, 5)[:, None]
    everything = np.sort((DISTRIBUTIONS[name].ppf((np.arange(20_000) + 0.5) / 20_000) + shift).ravel())
    truth = everything[25_000:75_000].mean()
    held = covered(stats.iqm_interval(samples(name, 1500, 5, 10) + shift, within="environment"), truth)
    assert 93 < held < 97


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_single_runs(name):
    """By order statistics the interval holds 90% of all runs in at least 95%, whatever the distribution."""
    for n in (46, 100):
        interval = stats.tolerance_interval(samples(name, 10_000, n))
        content = DISTRIBUTIONS[name].cdf(interval.high) - DISTRIBUTIONS[name].cdf(interval.low)
        assert 100 * (content >= 0.9).mean() > 95 - 0.9


def test_few_single_runs():
    """Normal ones as it should be, and what happens to skewed ones."""
    for name, expected in {"normal": 95.2, "exponential": 84.7}.items():
        interval = stats.tolerance_interval(samples(name, 10_000, 10))
        content = DISTRIBUTIONS[name].cdf(interval.high) - DISTRIBUTIONS[name].cdf(interval.low)
        assert 100 * (content >= 0.9).mean() == pytest.approx(expected, abs=1)


@pytest.mark.parametrize("n", SEEDS)
def test_profiles(n):
    """The whole true profile lies in the band, at thresholds as good as everywhere."""
    truth = (np.arange(400) + 0.5) / 400
    band = stats.performance_profile(samples("normal", 1000, n), oracle.norm.isf(truth))
    held = ((band.low <= truth) & (truth <= band.high)).all("threshold")
    assert 93 < 100 * float(held.mean()) < 97.5  # a little more than 95% between these thresholds


@pytest.mark.parametrize("name", ["normal", "exponential"])
@pytest.mark.parametrize("n", SEEDS)
def test_probability_of_improvement(name, n):
    for shift in (0.0, 0.5, 1.0):
        x, y = samples(name, 4000, n), samples(name, 4000, n, 1).isel(seed=0).rename(environment="seed")
        x = x + shift if name == "normal" else x * np.exp(shift)
        truth = oracle.norm.cdf(shift / 2**0.5) if name == "normal" else 1 / (1 + np.exp(-shift))
        assert 93 < covered(stats.probability_of_improvement(x, y), truth) < 97


@pytest.mark.slow
@pytest.mark.one_in(7)
@pytest.mark.parametrize("together", [0, 0.8])
@pytest.mark.parametrize("n", SEEDS)
@pytest.mark.parametrize("name", ["normal", "exponential"])
def test_simultaneous_intervals(name, n, together):
    """All of ten at once, of values that go together as with common random numbers; 97.9% at the most."""
    rng = np.random.default_rng(n)
    z = together**0.5 * rng.normal(size=(1000, 1, n)) + (1 - together) ** 0.5 * rng.normal(size=(1000, 10, n))
    x = z if name == "normal" else oracle.expon.isf(oracle.norm.sf(z))
    band = stats.simultaneous_interval(xr.DataArray(x, dims=("trial", "alpha", "seed")), "alpha")
    truth = DISTRIBUTIONS[name].mean()
    held = 100 * float(((band.low <= truth) & (truth <= band.high)).all("alpha").mean())
    assert 93 < held < (99 if n == 10 else 97.5)
