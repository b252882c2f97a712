"""From the raw numbers of every seed to means with intervals, curves and a summary table.

Everything works on the datasets that `SweepResult.to_xarray` gives, also after a round trip through netCDF.
The seed is the unit of replication: numbers are first made one per seed, then intervals are taken over seeds.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from scipy import stats

from jaxrl_tab.types import InputError

NOT_SWEPT = ("seed", "row", "state", "action")  # dimensions of a dataset that are no hyperparameters


class Interval(NamedTuple):
    """A mean over seeds and a confidence interval of that mean; without the dimension of the seeds.

    Attributes:
        mean: mean of the values that are there, float64; NaN where there are none.
        low, high: bounds of the interval, float64; NaN where fewer than two values are there, or not all
            of them are finite.
        n: how many values are there, int.
    """

    mean: xr.DataArray
    low: xr.DataArray
    high: xr.DataArray
    n: xr.DataArray


def mean_interval(x: xr.DataArray, dim: str = "seed", confidence: float = 0.95) -> Interval:
    """The mean of `x` along `dim`, with Student's t interval: mean ± t(n - 1) · s / sqrt(n).

    For n independent values that are near to normal its coverage is right at any n >= 2, so it may be used
    with few seeds. It says where the *mean* lies, not how much single runs differ. For values far from
    normal (a few failed runs among many good ones) it needs many seeds to be right.

    A NaN means that the seed has no value there, for instance because it finished no episode; it is left out,
    and `n` says how many were not. If such seeds are the bad ones, the mean of the others flatters.

    Args:
        x: numbers, [..., dim, ...].
        dim: the dimension of independent replications.
        confidence: the coverage aimed at, between 0 and 1.

    Raises:
        InputError: `x` has no such dimension, or `confidence` is not between 0 and 1.
    """
    if dim not in x.dims:
        raise InputError(f"no dimension {dim!r} to take the interval over; there are {_names(x.dims)}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence must be between 0 and 1, not {confidence!r}")
    x = x.astype(float)
    there = x.notnull()
    n = there.sum(dim)
    mean = x.sum(dim) / n.where(n > 0)
    squares = ((x - mean) ** 2).where(there, 0).sum(dim, skipna=False)
    error = np.sqrt(squares / (n - 1).where(n > 1) / n)
    half = error * stats.t.ppf((1 + confidence) / 2, n - 1)
    return Interval(mean, mean - half, mean + half, n)


# --- one number per seed -----------------------------------------------------------------------------


def last_tenth(ds: xr.Dataset) -> slice:
    """The rows that begin in the last tenth of the steps (of the episodes, where these were the budget).

    Where rows are so long that none does, the last row.
    """
    budget = ds.attrs["num_steps"] if "num_steps" in ds.attrs else ds.attrs["num_episodes"]
    first = -(-9 * int(budget) // (10 * int(ds.attrs["log_every"])))  # rounded up
    return slice(min(first, ds.sizes["row"] - 1), ds.sizes["row"])


def mean_return(ds: xr.Dataset, rows: slice = slice(None)) -> xr.DataArray:
    """Mean return of the episodes that ended in `rows`, float64 [*hyperparameters, seed].

    The sum of all returns over the number of all episodes: every episode weighs the same, whichever row it
    is in. NaN where a seed finished none.
    """
    chosen = ds.isel(row=rows)
    episodes = chosen.episodes.sum("row")
    return chosen.returns.astype(float).sum("row", skipna=False) / episodes.where(episodes > 0)


def is_prediction(*datasets: xr.Dataset) -> bool:
    """Whether all are of methods of prediction whose error was recorded (`exact=True`)."""
    return all("v_error" in ds for ds in datasets)


def score(ds: xr.Dataset) -> xr.DataArray:
    """The number of each seed by which settings are compared, float64 [*hyperparameters, seed].

    The mean return of the last tenth, the higher the better. Of a method of prediction the mean of its RMS
    error over all rows of the log, the lower the better (as in the book's figures 7.2 and 12.3).
    """
    if is_prediction(ds):
        return ds.v_error.astype(float).mean("row", skipna=False)
    return mean_return(ds, last_tenth(ds))


def learning_curve(ds: xr.Dataset) -> xr.DataArray:
    """Mean return of the episodes that ended in each row, float64 [*hyperparameters, seed, row].

    NaN where a seed finished none in the row. Early rows therefore know only the seeds that were quick:
    look at the `n` of their interval.
    """
    return ds.returns.astype(float) / ds.episodes.where(ds.episodes > 0)


def episode_curve(ds: xr.Dataset) -> xr.Dataset:
    """Time steps and episodes until the end of each row.

    Returns:
        `time_steps` and `episodes`, int64 [*hyperparameters, seed, row] each.
    """
    return xr.Dataset(
        {
            "time_steps": ds.steps.astype(np.int64).cumsum("row"),
            "episodes": ds.episodes.astype(np.int64).cumsum("row"),
        }
    )


def merge_rows(ds: xr.Dataset, at_most: int) -> xr.Dataset:
    """The sums of the log in no more than `at_most` rows: neighbouring rows are added up."""
    rows = ds.sizes["row"]
    group = xr.DataArray(np.arange(rows) // -(-rows // at_most), dims="row", name="group")
    sums = ds[["steps", "episodes", "returns", "lengths", "rewards"]]
    merged = sums.groupby(group).sum("row", skipna=False).rename(group="row")
    return merged.transpose(..., "row").assign_attrs(ds.attrs)


# --- hyperparameters ---------------------------------------------------------------------------------


def hyperparameters(ds: xr.Dataset) -> list[str]:
    """The names of the hyperparameters that were swept, in the order of the axes."""
    return [str(name) for name in ds.episodes.dims if name not in NOT_SWEPT]


def drawn(ds: xr.Dataset) -> list[str]:
    """The names of the hyperparameters that were drawn at random: coordinates along the axis `draw`."""
    return [str(name) for name, x in ds.coords.items() if x.dims == ("draw",) and name != "draw"]


def named(ds: xr.Dataset, setting: Mapping[str, Any]) -> dict[str, Any]:
    """`setting`, fit for `ds.sel`, in hyperparameters: instead of the number of a draw what was drawn."""
    found = dict(setting)
    if "draw" in found:
        trial = ds.sel(draw=found.pop("draw"))
        found |= {name: trial[name].item() for name in drawn(ds)}
    return found


def fixed(ds: xr.Dataset) -> dict[str, Any]:
    """The hyperparameters that were not swept, with their values."""
    return json.loads(ds.attrs.get("fixed", "{}"))


def optimum(ds: xr.Dataset) -> xr.DataArray:
    """v* (of prediction v_pi) from the start: [], or [gamma] where gamma was swept. NaN where not known."""
    return ds["optimum"] if "optimum" in ds else xr.DataArray(float(ds.attrs.get("optimal_value", np.nan)))


def best(ds: xr.Dataset, **given: Any) -> dict[str, Any]:
    """The combination of hyperparameters with the best mean `score`: the highest return, the lowest error.

    Only combinations in which the most seeds finished an episode in the last tenth compete: the mean of those
    that did flatters a setting in which others are lost. Of equals the first.

    The selection is biased: the winner was chosen for being good on these very seeds, so its own mean
    (and interval) promises too much. Run it again on fresh seeds for a number to report.

    Args:
        ds: a sweep.
        given: hyperparameters to hold at one of their values; the best of the others is looked for.

    Returns:
        A value for every swept hyperparameter, fit for `ds.sel`.

    Raises:
        InputError: a given name was not swept, or not at that value.
    """
    names = hyperparameters(ds)
    for name, value in given.items():
        if name not in names:
            raise InputError(f"{name} was not swept; swept were {_names(names)}")
        if value not in ds[name].values.tolist():
            tried = ", ".join(map(repr, ds[name].values.tolist()))
            raise InputError(f"{name} was not swept at {value!r}; there are {tried}")
    ds = ds.sel(given)
    result = mean_interval(score(ds))
    merit = (-result.mean if is_prediction(ds) else result.mean).where(result.n == result.n.max())
    place = np.unravel_index(np.argmax(merit.fillna(-np.inf).values), merit.shape)
    found = {str(name): ds[name].values[i].item() for name, i in zip(merit.dims, place, strict=True)}
    return {name: given.get(name, found.get(name)) for name in names}


def summary(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """A table with a row for each method and combination of hyperparameters.

    Args:
        datasets: a sweep for each method, by its name.

    Returns:
        A frame with the columns `method`; every hyperparameter of any method, swept or not (empty where a
        method has no such); `episodes`, episodes finished in the whole run, mean over seeds;
        `last_tenth_return` with `last_tenth_low` and `last_tenth_high`, the mean return of the last tenth
        and its 95% interval; `seeds`, how many seeds finished an episode there and so were counted;
        `steps_per_second` of the method's sweep; where they were recorded, `greedy_value`, the exact value
        of the greedy policy at the end, median over seeds, or, of prediction, `v_error` with `v_error_low`
        and `v_error_high`, the mean RMS error over all rows and its 95% interval, and `final_v_error`, that
        at the end, mean over seeds; `optimum`, v* from the start, of prediction v_pi.
    """
    records, names, results = [], {}, {}
    for method, ds in datasets.items():
        swept, constant = hyperparameters(ds), fixed(ds)
        names |= dict.fromkeys([*swept, *drawn(ds), *constant])
        late = mean_interval(mean_return(ds, last_tenth(ds)))
        results = {
            "episodes": ds.episodes.sum("row").mean("seed"),
            "last_tenth_return": late.mean,
            "last_tenth_low": late.low,
            "last_tenth_high": late.high,
            "seeds": late.n,
            "steps_per_second": ds.attrs.get("steps_per_second", np.nan),
        }
        if "greedy_value" in ds:
            results["greedy_value"] = ds.greedy_value.isel(row=-1).median("seed")
        if is_prediction(ds):
            error = mean_interval(score(ds))
            results |= {"v_error": error.mean, "v_error_low": error.low, "v_error_high": error.high}
            results["final_v_error"] = ds.v_error.isel(row=-1).astype(float).mean("seed", skipna=False)
        results["optimum"] = optimum(ds)
        table = xr.Dataset(results).expand_dims(method=[method])
        frame = table.to_dataframe(dim_order=["method", *swept]).reset_index()
        records += [constant | record for record in frame.to_dict("records")]
    return pd.DataFrame(records, columns=["method", *names, *results])


def _names(names: Any) -> str:
    return ", ".join(str(name) for name in names) or "none"
