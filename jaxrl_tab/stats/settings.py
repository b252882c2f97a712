"""Which setting of a method is best, how good it is, and how methods differ at their best settings."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
import xarray as xr

from jaxrl_tab.core.checks import FRACTION, check_within
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.schedules import typed
from jaxrl_tab.stats.along import Interval, name_list
from jaxrl_tab.stats.comparisons import Difference, paired_difference
from jaxrl_tab.stats.intervals import least_of, mean_interval, seeds_wanted, with_one_more
from jaxrl_tab.stats.measures import (
    Measure,
    diverged_runs,
    drawn,
    fixed,
    has_errors,
    hyperparameters,
    named,
    only_costs,
    score,
    standstill,
    within,
)

T = TypeVar("T")


class Settings:
    """All settings of a method in a sweep, and what is worked out of them: once, when it is first asked for.

    Whoever needs several of these numbers makes one such object and hands it on.

    Attributes:
        ds: the sweep.
        by: the measure by which its settings are compared.
        prediction: whether the measure is an error, the lower the better.
    """

    def __init__(self, ds: xr.Dataset, by: Measure = score) -> None:
        self.ds, self.by, self.prediction = ds, by, has_errors(ds)
        self._once: dict[Any, Any] = {}
        self._intervals: dict[float, Interval] = {}

    @classmethod
    def of(cls, ds: "Sweep", by: Measure = score) -> "Settings":
        """The settings of a sweep; `ds` itself where it is Settings, with what it has worked out already."""
        return ds if isinstance(ds, Settings) else cls(ds, by)

    @cached_property
    def score(self) -> xr.DataArray:
        """The measure, [*hyperparameters, seed]."""
        return self.by(self.ds)

    @cached_property
    def merit(self) -> xr.DataArray:
        """The score, turned so that higher is better; NaN where it is not finite: [*hyperparameters, seed]."""
        return self._higher_is_better.where(np.isfinite(self.score))

    @cached_property
    def _higher_is_better(self) -> xr.DataArray:
        return -self.score if self.prediction else self.score

    @cached_property
    def lost(self) -> xr.DataArray:
        """How many runs diverged or have no finite score, [*hyperparameters]."""
        return (self.merit.isnull() | diverged_runs(self.ds)).sum("seed")

    @cached_property
    def best(self) -> dict[str, Any]:
        """The best setting, fit for `ds.sel`: see the function of this name."""
        place = dict(zip(self.lost.dims, np.unravel_index(self.order[0], self.lost.shape), strict=True))
        return {name: self.ds[name].values.tolist()[place[name]] for name in hyperparameters(self.ds)}

    @cached_property
    def order(self) -> np.ndarray:
        """The numbers of all settings in C order, from the best to the worst, as the rule of `best` has it."""
        mean = self.merit.mean("seed").transpose(*self.lost.dims).fillna(-np.inf)
        return np.lexsort((-mean.values.ravel(), self.lost.values.ravel()))

    @cached_property
    def at_best(self) -> "Settings":
        """The best setting alone."""
        return Settings(self.ds.sel(self.best), self.by)

    def once(self, of: Callable[..., T], *arguments: Any) -> T:
        """`of(ds, *arguments)`, such as `curve_interval`: worked out once, however often it is drawn."""
        key = of, arguments
        if key not in self._once:
            self._once[key] = of(self.ds, *arguments)
        return self._once[key]

    @cached_property
    def chosen(self) -> dict[str, Any]:
        """All hyperparameters of the best setting, swept or not."""
        return fixed(self.ds) | named(self.ds, self.best)

    @cached_property
    def seeds_wanted(self) -> xr.DataArray:
        """How many seeds it takes until the mean's interval can be trusted, [*hyperparameters]."""
        return seeds_wanted(self._higher_is_better)

    @cached_property
    def interval(self) -> Interval:
        """The mean score with its 95% interval, [*hyperparameters]."""
        return self.interval_at(0.95)

    def interval_at(self, confidence: float) -> Interval:
        """The mean score with its interval, [*hyperparameters]: see `score_interval`."""
        check_within("confidence", confidence, FRACTION)
        if confidence not in self._intervals:
            self._intervals[confidence] = self._interval(confidence)
        return self._intervals[confidence]

    def _interval(self, confidence: float) -> Interval:
        good = self._higher_is_better
        mean, low, high, n = mean_interval(good, confidence=confidence)
        if (few := self.seeds_wanted > n).any():
            stuck = least_of(good.min("seed"), self.once(standstill))
            low = low.where(~few, np.fmin(low, with_one_more(good, stuck, "seed", confidence)[1]))
        if self.prediction:
            mean, low, high = -mean, -high, -low
        return self.possible(Interval(mean, low, high, n))

    def possible(self, interval: Interval) -> Interval:
        """An interval of the mean score without what no mean can be: see the function of this name."""
        return within(interval, self.score, self.ds, self.once(only_costs))

    def tied_at(self, confidence: float) -> xr.DataArray:
        """Which settings cannot be told apart from the best one, bool [*hyperparameters]: see `tied`."""
        check_within("confidence", confidence, FRACTION)
        winner = self.merit.sel(self.best)
        winner = winner.drop_vars(hyperparameters(self.ds) + drawn(self.ds), errors="ignore")
        settings = self.merit.sizes["seed"] and self.merit.size // self.merit.sizes["seed"]
        level = 1 - (1 - confidence) / max(1, settings - 1)
        difference = paired_difference(winner, self.merit, confidence=level).interval
        lost = self.lost
        return ~(difference.low > 0).transpose(*lost.dims) & (lost == lost.min())


Sweep = xr.Dataset | Settings


def best(ds: xr.Dataset, by: Measure = score, **held: Any) -> dict[str, Any]:
    """The combination of hyperparameters with the best mean `score`: the highest return, the lowest error.

    All are compared on all their seeds: `score` says how unfinished and diverged runs count. A setting at
    which fewer runs diverge is preferred to any at which more do, whatever their means (of prediction these
    are infinite); so is, of a measure of one's own, one with fewer seeds that have no number. Of equals the
    first.

    The selection is biased: the winner was chosen for being good on these very seeds, so its own mean
    (and interval) promises too much. Run it again on fresh seeds for a number to report: `selection`. Which
    settings may as well be the best one: `tied`.

    The right choice was made in so many per cent of experiments (1500 to 8000 of each kind with up to 300
    seeds, 300 or more with 1000), drawn from 20 000 runs of each setting, 8000 steps, epsilon 0.1:

        seeds                                                    10   30  100  300 1000
        cliff, Sarsa, alpha .1, .5 (1% stuck), 1 (2%)            94   96  100  100  100
        windy, Sarsa, seven alphas                               86   97  100  100  100
        windy, Q-learning, seven alphas                          85   97  100  100  100
        cliff, Sarsa 1 (2% stuck), Sarsa .1, Q-learning .1       61   86  100  100  100
        cliff, Sarsa .5 (1% stuck) and one that is 6.5 better    47   60   81   96  100
        cliff, Sarsa .5 (1% stuck) and one that is 5.5 worse     84   79   76   89   97

    Where 1% of all runs are stuck, nine in ten experiments with ten seeds see none of them, so no rule can be
    good there. Medians and trimmed means choose wrongly in the fourth and fifth line, and more surely so with
    more seeds. What is left open by the seeds there are, `tied` says.

    Args:
        ds: a sweep.
        by: what to choose by, a number for each seed; of prediction lower is better, else higher.
        held: hyperparameters to hold at one of their values; the best values of the others are looked for.

    Returns:
        A value for each of `hyperparameters(ds)`, fit for `ds.sel`; of drawn ones the label of the draw.

    Raises:
        InputError: a hyperparameter that is held was not swept, or not at that value.
    """
    names = hyperparameters(ds)
    for name, value in held.items():
        if name not in names:
            how = "drawn together with others: hold draw" if name in drawn(ds) else "not swept"
            raise InputError(f"{name} was {how}; swept were {name_list(names)}")
        if value not in ds[name].values.tolist():
            tried = ", ".join(map(repr, ds[name].values.tolist()))
            raise InputError(f"{name} was not swept at {value!r}; there are {tried}")
    chosen = Settings(ds.sel(held), by).best
    return {name: held.get(name, chosen.get(name)) for name in names}


def ranked(datasets: Mapping[str, Sweep]) -> list[str]:
    """The names of the methods by their best settings, the best first, as the rule of `best` orders them."""

    methods = {name: Settings.of(ds) for name, ds in datasets.items()}

    def rank(name: str) -> tuple[int, float]:
        settings = methods[name]
        merit, lost = (part.sel(settings.best) for part in (settings.merit, settings.lost))
        return int(lost), -float(merit.mean().fillna(-np.inf))

    return sorted(methods, key=rank)


def tied(ds: xr.Dataset, by: Measure = score, confidence: float = 0.95) -> xr.DataArray:
    """Which settings cannot be told apart from the best one, which is among them: bool [*hyperparameters].

    Those whose difference from it, seed by seed, has an interval that holds 0: at the level 1 - 0.05 / (K - 1)
    of `paired_difference` for K settings, so that the setting with the best true mean is among them with 95%.
    In the experiments of `best` it was in 94.2% at the least (fifth line, 30 seeds), 98% in the fourth line,
    100% in the others; with ten seeds there were 1.5 to 2.9 settings in the set, with 100 1.2 to 2.0.

    Args:
        ds, by: as in `best`.
        confidence: that the setting with the best true mean is among them.
    """
    return Settings(ds, by).tied_at(confidence)


def at_edge(ds: xr.Dataset, setting: Mapping[str, Any]) -> dict[str, str]:
    """The hyperparameters whose value in `setting` is the "largest" or the "smallest" that was tried.

    A better value may lie beyond. Nothing is said of random draws, of what is no number, of a single value,
    and where nothing lies beyond: below 0, below one step of n, and above 1 of what is a probability or a
    discount.
    """
    edges = {}
    for name in hyperparameters(ds):
        tried = ds[name].values
        if name == "draw" or tried.dtype.kind not in "fiu" or len(tried) < 2:
            continue
        if setting[name] == tried.max() and not (name in ("epsilon", "lam", "gamma") and tried.max() == 1):
            edges[name] = "largest"
        elif setting[name] == tried.min() and tried.min() not in (
            (0, 1) if tried.dtype.kind in "iu" else (0,)
        ):
            edges[name] = "smallest"
    return edges


def score_interval(ds: xr.Dataset, confidence: float = 0.95, by: Measure = score) -> Interval:
    """The mean `score` of each setting over all its seeds, with its interval, [*hyperparameters].

    It is that of `mean_interval`, but where the mean rests on few bad runs (`seeds_wanted`): there the bad
    end lies at least where Student's interval has it with one run more, which scores as the worst one seen,
    or as `standstill(ds)` if that is worse. And it leaves out what is impossible: see `possible`.

    In so many per cent of experiments it held the true mean (2000 of each kind with up to 100 seeds, then
    1000 and 400, so the standard error is 0.5 to 1; runs as in the table of `best`), how often that of
    `mean_interval` did, and how often the warning was given, with 10, 30, 100, 300 and 1000 seeds:

                                       this                  mean_interval          warned
        normal numbers             96  95  95  94  93     96  95  95  94  93     18   1   0   0   0
        windy, Q-learning .5       96  96  95  96  95     96  96  95  96  95     25   6   0   0   0
        windy, Sarsa .5            96  96  96  95  95     96  96  96  95  95     44  24   1   0   0
        windy, Sarsa 1             94  94  95  94  94     93  93  94  93  94     67  75  68  52  49
        cliff, Q-learning .5       96  96  96  94  96     96  96  96  94  96     31   8   0   0   0
        cliff, Sarsa 1 (2% stuck)  89  98  96  97  95     77  86  96  97  95     88  98 100 100  24
        cliff, Sarsa .5 (1% stuck) 82  94 100 100  97     66  76  88  94  96     81  94  99 100 100

    Without a warning it missed in at most 6.8%, but 18% and 11% in the last two lines with ten seeds. The
    intervals of median and interquartile mean held in 93% to 98% everywhere. With few seeds the warning is
    often false, and the interval then needlessly wide.

    Whatever is done, no interval knows of what no seed has shown: n runs that are all well leave it possible
    that up to 3 / n of all runs are not (the rule of three, 95%).

    Args:
        ds: a sweep.
        confidence: the coverage aimed at, between 0 and 1.
        by: gives the scores; or another measure of returns, or errors.
    """
    return Settings(ds, by).interval_at(confidence)


def differences(datasets: Mapping[str, Sweep], confidence: float = 0.95) -> dict[str, Difference]:
    """How the best setting of each method differs from that of the best method, seed by seed: x - best.

    The settings, and the method to compare with, were chosen for being good on these very seeds. So p-values
    and intervals are corrected for all pairs of settings of two methods that might have been compared
    (Bonferroni): of identical methods some p is below 5% in at most 5% of experiments, and the intervals all
    hold at once. Where each method comes with one setting alone, such as on fresh seeds, these are the pairs
    of methods, which is far less to correct for: choose on some seeds and compare on others where it matters.

    In 1500 to 3000 experiments with 30 or 100 seeds, of normal numbers and of runs of the product, some p of
    2, 3, 5 and 10 identical methods was below 5% in at most 5.9, 4.7, 3.7 and 3.5% (uncorrected in up to 61%),
    and of one setting beside the best of 7, or 20, like it in at most 2.0% (uncorrected in up to 12 and 21%).

    Args:
        datasets: for each method a sweep, or one setting; all of control, or all of prediction.
        confidence: of all intervals together.

    Returns:
        For each method, that with the best mean first, its `paired_difference` from the first, with `worst` as
        `standstill` has it; the first itself is left out. Empty where there is but one method, or where their
        seeds are not the same.
    """
    methods = {name: Settings.of(ds) for name, ds in datasets.items()}
    prediction = all(settings.prediction for settings in methods.values())
    seeds = [settings.ds.seed.values for settings in methods.values()]
    if len(methods) < 2 or any(not np.array_equal(seeds[0], other) for other in seeds[1:]):
        return {}
    pairs = pairs_to_correct([own.merit.size // own.merit.sizes["seed"] for own in methods.values()])
    at = {name: own.merit.sel(own.best).reset_coords(drop=True) for name, own in methods.items()}
    first, *others = ranked(methods)
    worst = min(float(settings.once(standstill).min()) for settings in methods.values())
    results = {}
    for name in others:
        (mean, low, high, n), p, reduction = paired_difference(
            at[name], at[first], confidence=1 - (1 - confidence) / pairs, worst=worst
        )
        if prediction:
            mean, low, high = -mean, -high, -low
        results[name] = Difference(Interval(mean, low, high, n), (p * pairs).clip(max=1), reduction)
    return results


def pairs_to_correct(settings: Sequence[int]) -> int:
    """How many pairs of settings there are of two methods, that have so many settings each."""
    return (sum(settings) ** 2 - sum(n**2 for n in settings)) // 2


class Selection(NamedTuple):
    """What a setting that was chosen on some seeds promised there, and what it is worth on others.

    Attributes:
        setting: the setting, fit for `sel` on the dataset that it was chosen from.
        promised: its mean on the seeds that it was chosen on; the interval does not know of the choice.
        fresh: its mean on fresh seeds, with its interval: the number to report.
        bias: how far `promised` is off: less `fresh`, and less the bounds of that.
    """

    setting: dict[str, Any]
    promised: Interval
    fresh: Interval
    bias: Interval

    def __repr__(self) -> str:
        setting = ", ".join(f"{name} = {shown(x)}" for name, x in self.setting.items())
        return (
            f"<Selection of {setting or 'the one setting'}: promised {self.promised!r}, fresh {self.fresh!r}>"
        )

    def _repr_html_(self) -> str:
        setting = ", ".join(f"{name} = {shown(x)}" for name, x in self.setting.items())
        rows = [
            (name, *(f"{float(part):.4g}" for part in getattr(self, name)))
            for name in ("promised", "fresh", "bias")
        ]
        return table(f"Selection of {setting or 'the one setting'}", ("", *Interval._fields), rows)


def selection(ds: Sweep, fresh: Sweep, by: Measure = score, confidence: float = 0.95) -> Selection:
    """Selection without bias: the setting that is best in `ds`, and how good it is on the seeds of `fresh`.

    Args:
        ds: the sweep to choose from.
        fresh: a sweep of the same method on other seeds, of the chosen setting, `best(ds, by)`, at least.
        by: what to choose by and what to report, as in `best`.
        confidence: of each interval.

    Raises:
        InputError: `fresh` has no such setting, or shares a seed with `ds`: one of the same number under the
            same root. (What was run with `part.Part.fresh` has a root of its own.)
    """
    settings = Settings.of(ds, by)
    ds, setting = settings.ds, settings.best
    again = Settings.of(fresh, settings.by)
    fresh = again.ds
    same_root = all(ds.attrs.get(key, 0) == fresh.attrs.get(key, 0) for key in ("root_seed", "fresh_seeds"))
    if same_root and (both := np.intersect1d(ds.seed, fresh.seed)).size:
        raise InputError(
            f"seed {both[0]} is among those that the setting was chosen on; report on fresh ones"
        )
    at = fresh
    for name, value in (setting | named(ds, setting)).items():
        if name in at.dims:
            if value not in at[name].values.tolist():
                raise InputError(f"the fresh runs have no {name} = {value}")
            at = at.sel({name: value})
        elif (
            name != "draw"
            and (actual := fixed(at).get(name, at[name].item() if name in at.coords else None)) != value
            and not (isinstance(actual, float) and typed(actual) == value)  # as on an axis beside schedules
        ):
            raise InputError(f"the fresh runs must have {name} = {value}, not {actual}")
    promised = Interval(*(part.sel(setting) for part in settings.interval_at(confidence)))
    reported = (again if at is fresh else Settings(at, settings.by)).interval_at(confidence)
    off = (
        promised.estimate - reported.estimate,
        promised.estimate - reported.high,
        promised.estimate - reported.low,
    )
    return Selection(setting, promised, reported, Interval(*off, reported.n))
