"""What can be looked at of a sweep: measures over time, as curves, and as one number for each setting.

All is worked out from the sums of the log, some settings at a time, by the same functions of `stats` that a reader
may call: the page shows the same numbers.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core import memory
from jaxrl_tab.stats.along import along
from jaxrl_tab.stats.intervals import mean_and_bounds, median_and_bounds
from jaxrl_tab.stats.measures import only_costs

POINTS = 40  # of a curve, at most: as `plot.learning_curves` has them
MOST_SEEDS = 0.9  # where fewer of the seeds have a number at a point, those that have flatter: it is left out
BLOCK = 2**21  # numbers that are worked out at a time
SUMS = ("steps", "episodes", "returns", "lengths", "rewards")
# The statistics of a curve, in this order: the mean with its 95% interval at each point, and that of all points at
# once (Bonferroni); the median with its interval at each point; and of how many seeds.
STATISTICS = ("mean", "low", "high", "all_low", "all_high", "median", "median_low", "median_high", "n")

# What is exact about the values that the features of a setting allow: the number in a dataset -> what it is called
# beside the curves of `value_error`.
REFERENCES = {"least_value_error": "the least possible", "td_value_error": "fixed point of TD"}

Kind = Literal["return", "cost", "count", "share"]
Sums = dict[str, np.ndarray]


@dataclass(frozen=True)
class Measure:
    """Something that changes while a method learns: one number for each run and point of time.

    Attributes:
        key: its name in the address of the page.
        title: its name for people.
        of: from sums of the log between points, float64 [..., points] each, and what was recorded at the points.
        kind: how its axis is: of returns; of what is the better the smaller; of counts; of shares of seeds.
        code: the lines of Python that work it out, as `x`, from one setting `ds`.
        partial: whether a run may have no number at a point.
        middle: by which statistic settings are compared: of values that may be infinite there is no mean.
    """

    key: str
    title: str
    of: Callable[[Sums], np.ndarray]
    kind: Kind
    code: str
    partial: bool = False
    middle: Literal["mean", "median"] = "mean"


def measures_of(ds: xr.Dataset) -> list[Measure]:
    """The measures for which a dataset has the numbers; the first is the one that methods are compared by."""
    by_steps = "num_steps" in ds.attrs
    points = f"stats.merge_rows(ds, {POINTS})"
    last = ".isel(row=ends)  # at the end of each group of rows"
    shown = [
        Measure("return", "mean return per episode", lambda x: _per(x["returns"], x["episodes"]), "return",
                f"x = stats.learning_curve({points})", partial=True),
        Measure("length", "mean length of an episode", lambda x: _per(x["lengths"], x["episodes"]), "cost",
                f"merged = {points}\nx = merged.lengths / merged.episodes.where(merged.episodes > 0)",
                partial=True),
        Measure("reward", "mean reward per step", lambda x: _per(x["rewards"], x["steps"]), "return",
                f"merged = {points}\nx = merged.rewards / merged.steps"),
    ]  # fmt: skip
    count = ("episodes", "episodes finished") if by_steps else ("steps", "time steps taken")
    shown.append(
        Measure(count[0], count[1], lambda x: x[count[0]].cumsum(-1), "count",
                f'x = {points}.{count[0]}.cumsum("row")')
    )  # fmt: skip
    recorded: dict[str, tuple[str, Kind]] = {
        "greedy_value": ("exact value of the greedy policy", "return"),
        "policy_value": ("exact value of the policy that acts", "return"),
        "q_error": ("largest |Q − q*|", "cost"),
        "v_error": ("RMS error of V", "cost"),
        "value_error": ("value error √VE", "cost"),
        "bellman_error": ("Bellman error √BE", "cost"),
        "projected_bellman_error": ("projected Bellman error √PBE", "cost"),
    }
    own = [str(n) for n, x in ds.items() if x.dims == ds.episodes.dims and n not in (*SUMS, *recorded)]
    for name in (*recorded, *own):
        if name in ds and ds[name].dtype.kind in "fiub":
            title, kind = recorded.get(name, (name, "count"))
            of_policy = name in ("greedy_value", "policy_value")
            middle = "median" if of_policy else "mean"
            every = exact_every(ds, name)
            at_ends = last if every == 1 else _last_known(every)
            code = f'x = ds["{name}"]{at_ends}'
            shown.append(Measure(name, title, lambda x, n=name: x[n], kind, code, middle=middle))
            if of_policy:
                whose = "greedy policy arrives" if name == "greedy_value" else "acting policy arrives"
                shown.append(
                    Measure(f"{name}_finite", f"share of seeds whose {whose}",
                            lambda x, n=name: np.where(np.isnan(x[n]), np.nan, np.isfinite(x[n])), "share",
                            f'x = np.isfinite(ds["{name}"]{at_ends.partition("  #")[0]})')
                )  # fmt: skip
    return sorted(shown, key=lambda measure: measure.key != "v_error") if "v_error" in ds else shown


def exact_every(ds: xr.Dataset, name: str) -> int:
    """Of how many rows one has this number, and the last has it."""
    return int(ds.attrs.get("exact_every", 1)) if name in ("greedy_value", "policy_value", "q_error") else 1


def _last_known(every: int) -> str:
    """The code for what was measured in some rows only: at the end of each group of rows as it was known by then."""
    known = f"e if e == ends[-1] else e - (e + 1) % {every}"
    return f".reindex(row=[{known} for e in ends])  # NaN until it was measured once"


class Flat:
    """A sweep with its settings in one row: number i is the i-th combination of the values on its axes.

    Attributes:
        ds: the sweep.
        count, seeds, rows: how many settings, seeds, and rows of the log.
        every: how many rows of the log are a point of a curve.
        x: the time at the end of each point, in steps or, where these were the budget, episodes; int [points].
    """

    def __init__(self, ds: xr.Dataset) -> None:
        self.ds = ds
        *axes, self.seeds, self.rows = ds.episodes.shape
        self.count = int(np.prod(axes))
        self.every = -(-self.rows // POINTS)
        self.starts = np.arange(0, self.rows, self.every)
        self.ends = np.append(self.starts[1:], self.rows) - 1
        self.x = self.times[self.ends]

    @cached_property
    def times(self) -> np.ndarray:
        """The time at the end of each row of the log, int [rows]."""
        attrs = self.ds.attrs
        budget = attrs["num_steps"] if "num_steps" in attrs else attrs["num_episodes"]
        return np.minimum((np.arange(self.rows) + 1) * int(attrs["log_every"]), int(budget))

    @cached_property
    def merged(self) -> xr.Dataset:
        """The sums of the log at the points of a curve."""
        return stats.merge_rows(self.ds, POINTS)

    @cached_property
    def returns(self) -> xr.DataArray:
        """The mean return at the points of a curve, [*hyperparameters, seed, row]."""
        return stats.learning_curve(self.merged)

    @cached_property
    def diverged(self) -> np.ndarray:
        """Bool [settings, seeds]."""
        x = self.ds.diverged.values if "diverged" in self.ds else np.zeros(self.ds.episodes.shape[:-1])
        return x.astype(bool).reshape(self.count, self.seeds)

    def flat(self, x: xr.DataArray) -> np.ndarray:
        """An array with an axis of settings in place of their own: [settings, ...]. A view where that can be."""
        axes = len(stats.hyperparameters(self.ds))
        return x.values.reshape(self.count, *x.shape[axes:])

    def sums(self, setting: int) -> Sums:
        """What the measures are made of, of one setting: float64 [seeds, points]."""
        sums = {}
        for name, x in self.ds.items():
            if x.dims != self.ds.episodes.dims:
                continue
            of_setting = self.flat(x)[setting]
            if name in SUMS:
                sums[name] = np.add.reduceat(of_setting.astype(float), self.starts, axis=-1)
            else:
                known = self._known(exact_every(self.ds, str(name)))
                sums[name] = np.where(known < 0, np.nan, of_setting[:, known].astype(float))
        return sums

    def _known(self, every: int) -> np.ndarray:
        """The last row, up to the end of each point, that has what one in so many rows has; -1 for none, [points]."""
        return np.where(self.ends == self.rows - 1, self.ends, self.ends - (self.ends + 1) % every)

    def curves(self, measures: list[Measure], settings: list[int]) -> Iterator[tuple[slice, np.ndarray]]:
        """The runs of some settings, some at a time: which, and float64 [measures, settings, seeds, points]."""
        for some in memory.blocks(len(settings), len(measures) * self.seeds * len(self.x), BLOCK):
            yield some, np.stack([self._curve(measures, i) for i in settings[some]], axis=1)

    def _curve(self, measures: list[Measure], setting: int) -> np.ndarray:
        sums = self.sums(setting)
        with np.errstate(invalid="ignore", divide="ignore"):
            curve = np.stack([measure.of(sums) for measure in measures])
        curve[:, self.diverged[setting]] = np.nan
        return curve


def statistics(
    flat: Flat, measures: list[Measure], settings: list[int], singles: list[list[int]]
) -> np.ndarray:
    """Curves of settings, float64 [settings, measures, statistics and single runs, points].

    The `STATISTICS`, but for the number of seeds, are NaN where fewer than `MOST_SEEDS` of the seeds have a number,
    of measures of which a run may have none.

    Args:
        flat: the sweep.
        measures: of what.
        settings: their numbers.
        singles: for each setting the places of the runs that are shown one by one, the same number for all.
    """
    count = len(STATISTICS) + len(singles[0])
    shown = np.full((len(settings), len(measures), count, len(flat.x)), np.nan)
    costs = only_costs(flat.ds)
    for some, runs in flat.curves(measures, settings):
        for m, measure in enumerate(measures):
            shown[some, m, : len(STATISTICS)] = _of_seeds(runs[m], measure, flat, costs, settings[some])
            for i, own in enumerate(singles[some]):
                shown[some.start + i, m, len(STATISTICS) :] = runs[m, i, own]
    return shown


def _of_seeds(runs: np.ndarray, measure: Measure, flat: Flat, costs: bool, settings: list[int]) -> np.ndarray:
    """The `STATISTICS` of runs [settings, seeds, points]: [settings, statistics, points]."""
    x = xr.DataArray(runs, dims=("setting", "seed", "row"))
    if measure.kind == "share":
        share = stats.proportion_interval(x == 1)
        return np.stack([np.asarray(part) for part in (*share[:3], share.low, share.high, *share)], 1)
    together = 1 - 0.05 / x.sizes["row"]

    def of(values: np.ndarray) -> tuple[np.ndarray, ...]:
        return *mean_and_bounds(values, "hall", 0.95, together), *median_and_bounds(values, 0.95)

    # In one go, which takes a third of the time.
    *statistics, n = along(x, "seed", of, parts=len(STATISTICS) - 1)
    parts = np.stack([part.values for part in statistics], 1)
    if measure.key == "return":
        parts[:, [2, 4]] = np.minimum(
            parts[:, [2, 4]], _highest(x, flat, costs, settings, parts[:, 0])[:, None]
        )
    elif measure.kind == "cost":
        parts[:, [1, 3]] = np.maximum(parts[:, [1, 3]], 0)
    if measure.partial:
        parts[np.broadcast_to((n.values < MOST_SEEDS * flat.seeds)[:, None], parts.shape)] = np.nan
    return np.concatenate([parts, n.values[:, None]], 1)


def _highest(x: xr.DataArray, flat: Flat, costs: bool, settings: list[int], mean: np.ndarray) -> np.ndarray:
    """What no mean return can be above, [settings, points]: as in `stats.possible`."""
    optimum = stats.optimum(flat.ds).broadcast_like(flat.ds.episodes.isel(seed=0, row=0))
    axes = stats.hyperparameters(flat.ds)
    top = np.asarray(optimum.transpose(*axes)).reshape(-1)[settings][:, None]
    with np.errstate(invalid="ignore"):
        seen = np.nanmax(np.where(np.isnan(x.values), -np.inf, x.values), axis=1)
        top = np.where(seen <= top + 1e-6 * abs(top), top, np.inf)
        top = np.minimum(top, 0) if costs else top
        return np.where(top > mean, top, mean)


def _per(x: np.ndarray, n: np.ndarray) -> np.ndarray:
    return np.where(n > 0, x / np.where(n > 0, n, 1), np.nan)
