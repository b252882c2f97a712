"""Intervals from resampled seeds."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from scipy import special

from jaxrl_tab.core.checks import FRACTION, check_within
from jaxrl_tab.stats.along import Interval, along, blocks

RESAMPLES = 1999  # of every bootstrap: both 2.5% points are an order statistic


def standard_error(z: np.ndarray) -> np.ndarray:
    """The standard error of the mean of each row, [c], from the deviations z [c, n] from that mean."""
    n = z.shape[-1]
    return np.sqrt((z**2).sum(-1) / (n - 1) / n)


def percentile(z: np.ndarray, confidence: float) -> np.ndarray:
    return np.quantile(resampled(z.shape[-1], lambda w: z @ w.T), tail_probabilities(confidence), axis=-1)


def bca(z: np.ndarray, confidence: float) -> np.ndarray:
    """Bias-corrected and accelerated."""
    means = np.sort(resampled(z.shape[-1], lambda w: z @ w.T))
    squares = (z**2).sum(-1)
    acceleration = (z**3).sum(-1) / np.where(squares > 0, 6 * squares**1.5, 1)
    below = ((means < 0).mean(-1) + (means <= 0).mean(-1)) / 2
    bias = special.ndtri(np.clip(below, 0.5 / RESAMPLES, 1 - 0.5 / RESAMPLES))
    shifted = bias + special.ndtri(tail_probabilities(confidence))[:, None]
    place = special.ndtr(bias + shifted / (1 - acceleration * shifted)) * (RESAMPLES - 1)
    first = np.floor(place).astype(int)
    rows = np.arange(len(means))
    left, right = means[rows, first], means[rows, np.minimum(first + 1, RESAMPLES - 1)]
    return left + (place - first) * (right - left)


def bootstrap_t(z: np.ndarray, confidence: float) -> np.ndarray:
    t = np.sort(resampled(z.shape[-1], lambda w: studentised(z, w)))
    places = np.rint(tail_probabilities(confidence) * (RESAMPLES + 1)).astype(int) - 1
    low, high = np.moveaxis(t[:, np.clip(places, 0, RESAMPLES - 1)], -1, 0)
    error = standard_error(z)
    with np.errstate(invalid="ignore"):  # infinite times zero, where all are equal
        return np.where(error > 0, np.stack([-high, -low]) * error, 0)


@functools.lru_cache(maxsize=4)
def _weights(n: int) -> np.ndarray:
    """How often each of n values is drawn in each resample, over n: [RESAMPLES, n], always the same."""
    return np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), RESAMPLES) / n


def resampled(n: int, of: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """`of(weights)`, [..., resamples], for the resamples of `_weights`, in blocks of them if n is large."""
    if len(blocks(RESAMPLES, n)) == 1:
        return of(_weights(n))
    rng = np.random.default_rng(0)
    sizes = (block.stop - block.start for block in blocks(RESAMPLES, n))
    drawn = (rng.multinomial(n, np.full(n, 1 / n), size) / n for size in sizes)
    return np.concatenate([of(weights) for weights in drawn], axis=-1)


def studentised(z: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """t of the mean of each resample, [c, resamples], of deviations [c, n]; infinite where all are equal."""
    n = z.shape[-1]
    mean = z @ weights.T
    variance = (z**2) @ weights.T - mean**2
    spread = variance > 1e-12 * (z**2).mean(-1, keepdims=True)  # below it is rounding
    error = np.sqrt(np.where(spread, variance, 1) / (n - 1))
    flat = np.where(abs(mean) > 1e-9 * abs(z).max(-1, keepdims=True), np.copysign(np.inf, mean), 0)
    return np.where(spread, mean / error, flat)


def tail_probabilities(confidence: float) -> np.ndarray:
    return np.array([(1 - confidence) / 2, (1 + confidence) / 2])


def iqm(values: np.ndarray, axis: int = -1) -> Any:  # as of np.mean: an array, or of one axis a number
    """The interquartile mean: without the lowest and the highest quarter of the values, each rounded down."""
    values = np.moveaxis(np.asarray(values), axis, -1)
    n = values.shape[-1]
    if not n:
        return np.full(values.shape[:-1], np.nan)[()]
    cut = n // 4
    # Only which values are in the middle is asked, and not their order.
    return np.partition(values, (cut, n - cut - 1))[..., cut : n - cut].mean(-1)


def iqm_interval(
    x: xr.DataArray, dim: str = "seed", within: str | None = None, confidence: float = 0.95
) -> Interval:
    """The interquartile mean with its interval: over seeds, or over seeds x environments.

    With `within="environment"` it is the IQM of all runs of all environments, from a bootstrap stratified by
    environment (Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice").
    Scores of different environments must first be made comparable, for instance by the optimum of each. Over
    seeds alone it takes the normal quantile for that of t in `bootstrap_interval`, with which its intervals
    of ten seeds would be too wide: as it is, they held in 93.8% to 94.9% of the simulations of the table
    above for 10, 30 and 100 seeds, but for 5 seeds in 90%. Of thousands of seeds, where a bootstrap would
    only take long, it is Yuen's (1974, Biometrika 61, 165-170). Arguments and errors as there.
    """
    if within is not None:
        return bootstrap_interval(x, iqm, dim, within, confidence)
    check_within("confidence", confidence, FRACTION)

    def of(values: np.ndarray) -> tuple[np.ndarray, ...]:
        # Of each rank, a resample keeps those copies that lie in its middle: the same for all places.
        n = values.shape[-1]
        if len(blocks(RESAMPLES, n)) > 1:
            return _yuen(values, confidence)
        copies = np.rint(_weights(n) * n).cumsum(-1)
        kept = np.diff(np.clip(copies, n // 4, n - n // 4), axis=-1, prepend=n // 4) / (n - 2 * (n // 4))
        return iqm(values), *_percentiles(np.sort(values) @ kept.T, n, 1, np.inf, confidence)

    return Interval(*along(x, dim, of, RESAMPLES))


def _yuen(values: np.ndarray, confidence: float) -> tuple[np.ndarray, ...]:
    """The IQM and bounds, [c] each, of many values [c, n], by the spread of the winsorized values."""
    n = values.shape[-1]
    values = np.sort(values)
    cut = n // 4
    kept = n - 2 * cut
    centre = values[:, cut : n - cut].mean(-1)
    winsorized = np.clip(values, values[:, [cut]], values[:, [n - cut - 1]])
    half = winsorized.std(-1) * np.sqrt(n / kept / (kept - 1)) * special.ndtri((1 + confidence) / 2)
    return centre, centre - half, centre + half


def bootstrap_interval(
    x: xr.DataArray,
    statistic: Callable[..., np.ndarray],
    dim: str = "seed",
    within: str | None = None,
    confidence: float = 0.95,
) -> Interval:
    """Any statistic of the values along `dim`, with a percentile-bootstrap interval.

    A resample of n values in k strata varies less than fresh values do, by the factor 1 - k / n, and its
    spread is itself uncertain. So its quantiles are not taken at 2.5% and 97.5% but further out, where the
    standard normal distribution function is at ± sqrt(n / (n - k)) t(n - k) (Hesterberg 2015, Am. Statist.
    69, 371-386). In simulation as in the table in the package's docstring, intervals of the IQM over 5 or
    20 environments with ten seeds each held in 93.0% to 95.5%; with three seeds only, in 88% to 94.9%. For
    means `mean_interval` is better.

    Args:
        x: numbers, [..., dim, ...]; a NaN is left out.
        statistic: a function like `np.mean` of an array with the keyword `axis`, which it removes.
        dim: the dimension that is resampled.
        within: a dimension such as "environment": the statistic is one of all values along both, and `dim` is
            resampled for each label of it apart, so that each keeps its number of values.
        confidence: the coverage aimed at, between 0 and 1.

    Raises:
        InputError: `x` lacks a dimension that is named, or `confidence` is not between 0 and 1.
    """
    check_within("confidence", confidence, FRACTION)

    def of(*strata: np.ndarray) -> tuple[np.ndarray, ...]:
        rngs = [np.random.default_rng((0, k)) for k in range(len(strata))]
        n = sum(values.shape[-1] for values in strata)
        estimate = statistic(np.concatenate(strata, axis=-1), axis=-1)
        resampled = []
        for block in blocks(RESAMPLES, n * len(estimate)):
            sizes = [(block.stop - block.start, values.shape[-1]) for values in strata]
            drawn = [x[:, r.integers(s[1], size=s)] for x, r, s in zip(strata, rngs, sizes, strict=True)]
            with np.errstate(invalid="ignore"):  # infinities
                resampled.append(statistic(np.concatenate(drawn, axis=-1), axis=-1))
        bounds = _percentiles(np.concatenate(resampled, -1), n, len(strata), n - len(strata), confidence)
        return estimate, *bounds

    return Interval(*along(x, dim if within is None else (within, dim), of, RESAMPLES))


def statistic_bounds(
    of: Callable[[np.ndarray], np.ndarray], n: int, error: float, confidence: float
) -> np.ndarray:
    """Bounds, [2], of how far a statistic of n values is off, from what it is in resamples less what it is, `of`.

    `of` takes weights [B, n] of the values and gives [B]. Of thousands of values, where a bootstrap would only take
    long, bounds are those of a normal distribution with the standard error that is given.
    """
    if len(blocks(RESAMPLES, n)) > 1:
        return error * special.ndtri(tail_probabilities(confidence))
    return _percentiles(resampled(n, of)[None], n, 1, n - 1, confidence)[:, 0]


def percentile_bounds(resampled: np.ndarray, n: int, strata: int, confidence: float) -> np.ndarray:
    """Bounds, [2, c], from what resamples of n values in so many strata gave, [c, resamples]."""
    return _percentiles(resampled, n, strata, n - strata, confidence)


def _percentiles(resampled: np.ndarray, n: int, strata: int, degrees: float, confidence: float) -> np.ndarray:
    """Bounds, [2, c], from what resamples of n values gave, [c, resamples]; NaN where n is too small."""
    if n <= strata:
        return np.full((2, len(resampled)), np.nan)
    z = np.sqrt(n / (n - strata)) * special.stdtrit(degrees, tail_probabilities(confidence))
    with np.errstate(invalid="ignore"):  # infinities
        return np.quantile(resampled, special.ndtr(z), axis=-1)
