"""One number per run: scores, curves, what was swept."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from jaxrl_tab.core.declared import Learns, of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning
from jaxrl_tab.stats.along import Interval, blocks, by_seeds, check_dims
from jaxrl_tab.stats.intervals import least_of, mean_interval

NOT_SWEPT = ("seed", "row", "state", "action")  # dimensions of a dataset that are no hyperparameters
LOG = ("steps", "episodes", "returns", "lengths", "rewards")  # of what others computed, some are not known
SOFT_STATES = 5000  # of an environment whose best epsilon-soft policy is looked for: about a second


def last_tenth(ds: xr.Dataset) -> slice:
    """The rows that begin in the last tenth of the steps (of the episodes, where these were the budget).

    Where rows are so long that none does, the last row.
    """
    budget = ds.attrs["num_steps"] if "num_steps" in ds.attrs else ds.attrs["num_episodes"]
    first = -(-9 * int(budget) // (10 * int(ds.attrs["log_every"])))  # rounded up
    return slice(min(first, ds.sizes["row"] - 1), ds.sizes["row"])


@by_seeds
def mean_return(ds: xr.Dataset, rows: slice = slice(None)) -> xr.DataArray:
    """Mean return of the episodes that ended in `rows`, float64 [*hyperparameters, seed].

    The sum of all returns over the number of all episodes: every episode weighs the same, whichever row it
    is in. NaN where a seed finished none, or diverged.
    """
    chosen = ds.isel(row=rows)
    episodes = chosen.episodes.sum("row")
    return sound_runs(
        chosen.returns.astype(float).sum("row", skipna=False) / episodes.where(episodes > 0), ds
    )


def final_return(ds: xr.Dataset) -> xr.DataArray:
    """Final performance: `mean_return` of the last tenth of the run, float64 [*hyperparameters, seed]."""
    return mean_return(ds, last_tenth(ds))


def is_prediction(*datasets: xr.Dataset) -> bool:
    """Whether all are of methods of prediction, which learn the values of states.

    A file that was written before datasets said what was learned tells it by the error that it holds.
    """
    by_error = lambda ds: Learns.STATES if has_errors(ds) else Learns.ACTIONS
    return all(ds.attrs.get("learns", by_error(ds)) == Learns.STATES for ds in datasets)


def has_errors(*datasets: xr.Dataset) -> bool:
    """Whether the errors of all are recorded, by which methods of prediction are compared (`exact=True`)."""
    return all("v_error" in ds for ds in datasets)


@by_seeds
def unfinished(ds: xr.Dataset, rows: slice | None = None) -> xr.DataArray:
    """Which runs finished no episode in `rows` (and did not diverge), bool [*hyperparameters, seed].

    By default in the last tenth.
    """
    without = ds.episodes.isel(row=last_tenth(ds) if rows is None else rows).sum("row") == 0
    return without & ~diverged_runs(ds)


def score(ds: xr.Dataset) -> xr.DataArray:
    """The number of each seed by which settings are compared, float64 [*hyperparameters, seed]; none is left out.

    **The rule.** The setting with the highest mean score wins. The score of a run is the mean return of the
    episodes that ended in the last tenth (`final_return`). A run that finished no episode there scores the
    rewards that it collected there, as if its episode had been cut off at the end. A run that diverged scores
    as the worst run of the dataset.

    Where no reward is above 0 and gamma is 1, the number of an unfinished run is a bound in its favour: its
    episode can only be worth less. So such runs still flatter a setting, but far less than if they were left
    out, as they are the bad ones; and the choice of a setting gets better with more seeds. Where rewards can
    be above 0 it is no bound: the episode is cut off, and what it would have earned later does not count.
    Where most runs are unfinished the last tenth is too short for what is learned: take more steps. With
    gamma below 1 the rewards are discounted as in a return, as if the episode had begun with the last tenth;
    those of a row of the log are taken to be spread evenly over its steps. Where episodes are the budget,
    every run finishes.

    Of a method of prediction it is the mean of the RMS error over all rows of the log, the lower the better
    (as in the book's figures 7.2 and 12.3), and infinite where the run diverged.
    """
    if has_errors(ds):
        return mean_error(ds)
    scores, diverged = earned(ds, last_tenth(ds)), diverged_runs(ds)
    return scores.where(~diverged, scores.min().fillna(-np.inf))


def mean_error(ds: xr.Dataset, rows: slice = slice(None)) -> xr.DataArray:
    """The mean RMS error of V over `rows`, float64 [*hyperparameters, seed]; infinite where the run diverged."""
    mean = by_seeds(lambda some: some.v_error.isel(row=rows).astype(float).mean("row", skipna=False))
    return mean(ds).where(~diverged_runs(ds), np.inf)


@by_seeds
def earned(ds: xr.Dataset, rows: slice) -> xr.DataArray:
    """The mean return of the episodes that ended in `rows`, or the rewards there where none did: see `score`.

    Float64 [*hyperparameters, seed]; NaN where the run diverged, or where rewards are not known.
    """
    returns, without = mean_return(ds, rows), unfinished(ds, rows)
    if not without.any() or "rewards" not in ds:
        return returns
    there = ds.isel(row=rows)
    return returns.where(~without, (there.rewards.astype(float) * _discounts(there)).sum("row"))


def diverged_runs(ds: xr.Dataset) -> xr.DataArray:
    return ds.diverged.astype(bool) if "diverged" in ds else xr.DataArray(False)


def _gamma(ds: xr.Dataset) -> xr.DataArray:
    """The discount rate: [], or [gamma] or [draw] where it was swept."""
    return ds["gamma"].astype(float) if "gamma" in ds.coords else xr.DataArray(fixed(ds).get("gamma", 1.0))


def _discounts(ds: xr.Dataset) -> xr.DataArray:
    """The mean discount gamma^t of the steps of each row, t = 0 at the first of these rows; 1 at gamma = 1."""
    gamma, steps = _gamma(ds), ds.steps.astype(float)
    if (gamma == 1).all():
        return xr.ones_like(gamma)
    rate = gamma.where(gamma < 1, 0.0)
    mean = rate ** (steps.cumsum("row") - steps) * (1 - rate**steps) / ((1 - rate) * steps.clip(min=1))
    return mean.where(gamma < 1, 1.0)


def standstill(ds: xr.Dataset) -> xr.DataArray:
    """What a run scores that finishes no episode in the last tenth and pays in each of its steps, float64.

    It is the number of these steps times the best reward of a step, which is taken to be the highest mean of
    any row there; some of Sarsa's runs on the cliff are like that. It is infinite where this is not below 0,
    where episodes are the budget, and of prediction: then nothing is known of runs that no seed has shown.

    Returns:
        One number, or [gamma] or [draw] where gamma was swept.
    """
    if has_errors(ds) or "num_steps" not in ds.attrs or "rewards" not in ds:
        return xr.DataArray(np.inf)
    late = ds.isel(row=last_tenth(ds))
    highest = by_seeds(lambda some: (some.rewards / some.steps).max("row"))(late)
    others = [d for d in ds.steps.dims if d not in ("row", *_gamma(ds).dims)]
    steps = late[["steps"]].isel(dict.fromkeys(others, 0), drop=True)  # the same in all runs
    worth = highest.where(~diverged_runs(ds)).max() * (steps.steps * _discounts(steps)).sum("row")
    return worth.where(worth < 0, np.inf)


def learning_curve(ds: xr.Dataset) -> xr.DataArray:
    """Mean return of the episodes that ended in each row, float64 [*hyperparameters, seed, row].

    NaN where a seed finished none in the row. Early rows therefore know only the seeds that were quick:
    look at the `n` of their interval. NaN in all rows of a seed that diverged.
    """
    return sound_runs(ds.returns.astype(float) / ds.episodes.where(ds.episodes > 0), ds)


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


def curve_interval(ds: xr.Dataset, at_most: int) -> Interval:
    """`mean_interval(learning_curve(merge_rows(ds, at_most)))`: for as many seeds as the disk holds.

    Values that are impossible are cut off: see `possible`.
    """
    every = -(-ds.sizes["row"] // at_most)
    merged = by_seeds(lambda part: learning_curve(_merged(part, every)))
    costs = only_costs(ds)  # of all rows: a reward above 0 in one row is possible in any

    def of(part: xr.Dataset) -> Interval:
        curve = merged(part)
        return within(mean_interval(curve), curve, part, costs)

    return _over_rows(ds, of, every)


def progress_interval(ds: xr.Dataset, name: str) -> Interval:
    """`mean_interval(episode_curve(ds)[name])`: for as many seeds as the disk holds."""
    until = [xr.DataArray(0)]  # in a list, so that `of` can hand the sum on to the next rows

    def of(part: xr.Dataset) -> Interval:
        curve = until[0] + episode_curve(part)[name]
        until[0] = curve.isel(row=-1, drop=True)
        return mean_interval(curve)

    return _over_rows(ds, of)


def error_interval(ds: xr.Dataset) -> Interval:
    """`mean_interval(ds.v_error)`: how the error of a method of prediction goes down."""
    return mean_interval(ds.v_error)


def _over_rows(ds: xr.Dataset, of: Callable[[xr.Dataset], Interval], every: int = 1) -> Interval:
    """`of(ds)`, worked out in blocks of rows if there are many; groups of `every` rows stay together."""
    groups = -(-ds.sizes["row"] // every)
    intervals = []
    for block in blocks(groups, ds.episodes.size // ds.sizes["row"]):
        intervals.append(of(ds.isel(row=slice(block.start * every, block.stop * every))))
    return Interval(
        *(xr.concat(parts, "row").transpose(*parts[0].dims) for parts in zip(*intervals, strict=True))
    )


def merge_rows(ds: xr.Dataset, at_most: int) -> xr.Dataset:
    """The sums of the log in no more than `at_most` rows: neighbouring rows are added up."""
    return _merged(ds, -(-ds.sizes["row"] // at_most))


def _merged(ds: xr.Dataset, every: int) -> xr.Dataset:
    sums = ds[[name for name in LOG if name in ds]]
    starts = np.arange(0, ds.sizes["row"], every)
    # The groups are neighbours, so this needs no `groupby`, which takes several times as long.
    merged = {name: (x.dims, _sums_from(x, starts), x.attrs) for name, x in sums.items()}
    merged = sums.isel(row=starts).assign(merged).assign_coords(row=np.arange(len(starts)))
    return merged.assign(diverged=ds.diverged) if "diverged" in ds else merged


def _sums_from(x: xr.DataArray, starts: np.ndarray) -> np.ndarray:
    """The sums from each of these rows until before the next, of float64 or int64."""
    dtype = float if x.dtype.kind == "f" else np.int64
    return np.add.reduceat(x.values, starts, axis=x.dims.index("row"), dtype=dtype)


def sound_runs(x: xr.DataArray, ds: xr.Dataset) -> xr.DataArray:
    """`x` with NaN for the runs that diverged, where the dataset says which did."""
    return x.where(~ds.diverged.astype(bool)) if "diverged" in ds else x


def area_under_curve(
    curve: xr.DataArray, width: xr.DataArray | None = None, dim: str = "row"
) -> xr.DataArray:
    """The area under a curve over its length, that is its mean height, float64 without `dim`.

    A row without a value, because no episode ended in it, has that of the last row before it that has one;
    the first rows have that of the first one. NaN where no row has a value.

    Args:
        curve: such as `learning_curve(ds)`, [..., dim, ...].
        width: how wide each row is, such as `ds.steps`; all are the same by default.

    Raises:
        InputError: `curve` has no such dimension.
    """
    check_dims(curve, [dim])
    # Rows are taken by their places, so their labels must be no coordinate of these.
    curve, place = curve.drop_vars(dim, errors="ignore"), xr.DataArray(np.arange(curve.sizes[dim]), dims=dim)
    has_value = curve.notnull()
    any_value = has_value.any(dim)
    last = place.where(has_value, -1).reduce(np.maximum.accumulate, dim=dim)
    first = place.where(has_value, curve.sizes[dim]).min(dim).where(any_value, 0)
    filled = curve.astype(float).isel({dim: last.where(last >= 0, first).astype(int)})
    width = (
        xr.ones_like(place, float) if width is None else width.astype(float).drop_vars(dim, errors="ignore")
    )
    return ((filled * width).sum(dim, skipna=False) / width.sum(dim)).where(any_value)


def time_to_threshold(
    curve: xr.DataArray,
    threshold: float,
    time: xr.DataArray | None = None,
    dim: str = "row",
    *,
    at_most: bool = False,
) -> xr.DataArray:
    """When a curve is first at a threshold or better, float64 without `dim`; infinite where it never is.

    Runs that never reach it, or diverge, are censored and not dropped: for `median_interval` they are slower
    than any other, and `proportion_interval(np.isfinite(...))` says how many did reach it. Such times have no
    mean. A curve of few episodes a row gets there by luck early; merge rows first (`merge_rows`).

    Args:
        curve: such as `learning_curve(ds)`, [..., dim, ...].
        threshold: the level to reach.
        time: at the end of each row, such as `episode_curve(ds).time_steps`; by default the number of rows.
        dim: the dimension of time.
        at_most: whether lower is better, as of errors.

    Raises:
        InputError: `curve` has no such dimension.
    """
    check_dims(curve, [dim])
    if time is None:
        time = xr.DataArray(np.arange(1, curve.sizes[dim] + 1), dims=dim)
    reached = curve <= threshold if at_most else curve >= threshold
    return time.astype(float).where(reached, np.inf).min(dim)


def hyperparameters(ds: xr.Dataset) -> list[str]:
    """The names of the hyperparameters that were swept, in the order of the axes.

    Hyperparameters that were drawn at random, trial by trial, share the axis `draw`, which is named here;
    they are coordinates along it. See `drawn` and `named`.
    """
    return [str(name) for name in ds.episodes.dims if name not in NOT_SWEPT]


def drawn(ds: xr.Dataset) -> list[str]:
    """The names of the hyperparameters that were drawn at random: coordinates along the axis `draw`."""
    return [str(name) for name, x in ds.coords.items() if x.dims == ("draw",) and name != "draw"]


def named(ds: xr.Dataset, setting: Mapping[str, Any]) -> dict[str, Any]:
    """A `setting` that fits `ds.sel`, in hyperparameters: for the number of a draw the values drawn."""
    values = dict(setting)
    if "draw" in values:
        trial = ds.sel(draw=values.pop("draw"))
        values |= {name: trial[name].item() for name in drawn(ds)}
    return values


def fixed(ds: xr.Dataset) -> dict[str, Any]:
    """The hyperparameters that were not swept, with their values."""
    return json.loads(ds.attrs.get("fixed", "{}"))


def optimum(ds: xr.Dataset) -> xr.DataArray:
    """v* (of prediction v_pi) from the start: [], or [gamma] where gamma was swept. NaN where not known."""
    return ds["optimum"] if "optimum" in ds else xr.DataArray(float(ds.attrs.get("optimal_value", np.nan)))


def soft_optimum(env: Environment, setting: Mapping[str, Any]) -> float:
    """What the best policy earns from the start that explores as a setting does: with a constant epsilon.

    A method that goes on exploring in this way cannot earn more than this, whatever it learns.

    Args:
        env: the environment.
        setting: hyperparameters by their names, such as `fixed(ds) | named(ds, best(ds))`.

    Returns:
        `planning.epsilon_soft` from the start; NaN where the setting does not explore so, where the
        environment does not say its probabilities or has more than SOFT_STATES states, where each run draws a
        problem of its own, or the task changes in a run, and where there is no finite answer.
    """
    epsilon = str(setting.get("behaviour") or f"epsilon-greedy:{setting.get('epsilon')}")
    try:
        epsilon, gamma = float(epsilon.removeprefix("epsilon-greedy:")), float(setting.get("gamma", 1.0))
    except ValueError:  # a schedule, or another policy
        return np.nan
    if not epsilon or env.num_states > SOFT_STATES or of_environment(env).differs:
        return np.nan
    try:
        return planning.start_value(env, planning.epsilon_soft(env, epsilon, gamma)[1])
    except InputError:
        return np.nan


Measure = Callable[[xr.Dataset], xr.DataArray]


def possible(interval: Interval, x: xr.DataArray, ds: xr.Dataset) -> Interval:
    """An interval of the mean of returns, or errors, `x` [..., seed, ...] of `ds`, without what no mean can be.

    No error is below 0. No mean return is above the `optimum`: taken to be so where no single one is, for a
    return may be above it by luck, or because the time limit cut a costly episode short. Where no reward is
    above 0, no return is.
    """
    return within(interval, x, ds, only_costs(ds))


def only_costs(ds: xr.Dataset) -> bool:
    """Whether no row of any run has rewards above 0."""
    if has_errors(ds) or "rewards" not in ds:
        return False
    return not by_seeds(lambda some: (some.rewards > 0).any("row"))(ds).any()


def within(interval: Interval, x: xr.DataArray, ds: xr.Dataset, costs_alone: bool) -> Interval:
    """`possible`, where `costs_alone` is `only_costs` of all rows, of which `ds` may have some."""
    if has_errors(ds):
        return interval._replace(low=interval.low.clip(min=0))
    best_seen = x.max("seed")
    top = optimum(ds).broadcast_like(best_seen)
    top = top.where(best_seen <= top + 1e-6 * abs(top), np.inf)  # float32 has its rounding
    if costs_alone:
        top = top.clip(max=0)
    high = least_of(interval.high, top.where(top > interval.estimate, interval.estimate))
    return interval._replace(high=interval.high.copy(data=high.transpose(*interval.high.dims).values))
