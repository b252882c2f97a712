"""The one table of settings, from which `summary.csv`, the screen, the report and the pictures choose.

A statistic is one entry in `COLUMNS`. It is worked out once for each method, when it is first asked for: the screen
shows some of them, and is not kept waiting for the others.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError, check_choice, shown
from jaxrl_tab.core.types import Environment
from jaxrl_tab.stats.along import Datasets, Interval
from jaxrl_tab.stats.bootstrap import iqm_interval
from jaxrl_tab.stats.column import Column, text
from jaxrl_tab.stats.comparisons import Difference
from jaxrl_tab.stats.early import EARLY, better_early, by_length
from jaxrl_tab.stats.errors import ERRORS
from jaxrl_tab.stats.intervals import mean_interval, median_interval, tolerance_interval
from jaxrl_tab.stats.measures import (
    drawn,
    final_return,
    fixed,
    hyperparameters,
    named,
    optimum,
    soft_optimum,
    sound_runs,
    unfinished,
)
from jaxrl_tab.stats.settings import Settings, at_edge, differences


class Method(Settings):
    """The settings of one method among those that it is compared with.

    Attributes:
        name: of the method.
        among: it and the others.
    """

    def __init__(self, ds: xr.Dataset, name: str, among: "Methods") -> None:
        super().__init__(ds)
        self.name, self.among = name, among
        self._numbers: dict[str, list[Any] | None] = {}

    def numbers(self, column: str) -> list[Any] | None:
        """The numbers of the column of this name, one for each setting; None where the method has no such number."""
        if column not in self._numbers:
            self._numbers[column] = self._worked_out(column)
        return self._numbers[column]

    def _worked_out(self, column: str) -> list[Any] | None:
        one = next((one for one in COLUMNS if one.name == column), None)
        if one is None or (value := one.value(self)) is None:
            return None
        parts = value[:3] if isinstance(value, Interval) else [value]
        axes = hyperparameters(self.ds)
        every = [xr.DataArray(part).broadcast_like(self.lost).transpose(*axes) for part in parts]
        flat = [part.values.ravel().tolist() for part in every]
        return list(zip(*flat, strict=True)) if len(flat) > 1 else flat[0]

    @cached_property
    def unfinished(self) -> xr.DataArray:
        """How many runs finished no episode in the last tenth, [*hyperparameters]; of prediction 0."""
        return xr.zeros_like(self.lost) if self.prediction else unfinished(self.ds).sum("seed")

    @cached_property
    def is_best(self) -> xr.DataArray:
        """True at the best setting, bool [*hyperparameters]."""
        at = xr.zeros_like(self.lost, bool)
        at.loc[self.best] = True
        return at

    @property
    def number_of_best(self) -> int:
        """The number of the best setting among all, in the order of the axes."""
        place = [self.ds[axis].values.tolist().index(value) for axis, value in self.best.items()]
        sizes = [self.ds.sizes[axis] for axis in self.best]
        return int(np.ravel_multi_index(place, sizes)) if place else 0

    def only_at_best(self, x: xr.DataArray | float) -> xr.DataArray:
        """`x` at the best setting, NaN at the others, [*hyperparameters]."""
        return xr.where(self.is_best, x, np.nan)

    @cached_property
    def edges(self) -> dict[str, str]:
        """The hyperparameters whose best value is the "largest" or the "smallest" that was tried."""
        return at_edge(self.ds, self.best)

    @cached_property
    def exploration(self) -> dict[str, Any]:
        """How the best setting explores, and its discount rate: the hyperparameters of `soft`."""
        names = ("behaviour" if self.chosen.get("behaviour") else "epsilon", "gamma")
        return {name: self.chosen[name] for name in names if name in self.chosen}

    @property
    def soft(self) -> float:
        """What the best policy earns that explores as the best setting does; NaN where that is not known."""
        return np.nan if self.prediction else self.among.soft_optimum(self.exploration)

    @property
    def difference(self) -> Difference:
        """How the best setting differs from that of the best method; NaN for that method itself."""
        nowhere = Difference(Interval(*[xr.DataArray(np.nan)] * 4), *[xr.DataArray(np.nan)] * 2)
        return self.among.differences.get(self.name, nowhere)

    @property
    def episodes_within_steps(self) -> xr.DataArray | None:
        """Episodes of the runs that did not diverge, mean; None where episodes were the budget, the same for all."""
        within = "num_steps" in self.ds.attrs and "lengths" in self.ds
        return sound_runs(self.ds.episodes.sum("row"), self.ds).mean("seed") if within else None

    @property
    def arriving(self) -> xr.DataArray | None:
        """The share of sound runs whose greedy policy is worth more than -inf at the end."""
        if (worth := self.at_the_end("greedy_value")) is None:
            return None
        return xr.where(worth.isnull(), np.nan, np.isfinite(worth)).mean("seed")

    def at_the_end(self, name: str) -> xr.DataArray | None:
        """What was recorded in the last row, NaN for runs that diverged; None where it was not recorded."""
        return sound_runs(self.ds[name].isel(row=-1), self.ds) if name in self.ds else None


# In the order in which people see them.
COLUMNS = [
    Column(
        "episodes",
        lambda own: own.ds.episodes.sum("row").mean("seed") if "lengths" in own.ds else None,
        written="tenths",
    ),
    Column(
        "episodes_within_steps",
        lambda own: own.episodes_within_steps,
        in_summary="",
        screen="episodes",
        report="episodes",
        continuing=False,
        tables=("all",),
        written="tenths",
    ),
    *EARLY,
    Column(
        "late_return",
        lambda own: mean_interval(final_return(own.ds)) if own.prediction else None,
        in_summary="last_tenth_return",
    ),
    Column(
        "score",
        lambda own: own.interval,
        in_summary=("last_tenth_return", "v_error"),
        screen=("mean return,\nlast tenth", "RMS error,\nwhole run"),
    ),
    Column(
        "median", lambda own: median_interval(own.score), in_summary=("last_tenth_median", "v_error_median")
    ),
    Column(
        "iqm",
        lambda own: iqm_interval(own.score.where(np.isfinite(own.score))),
        in_summary=("last_tenth_iqm", "v_error_iqm"),
    ),
    Column(
        "runs",
        lambda own: own.possible(tolerance_interval(own.score)),
        in_summary="",
        report="9 of 10 runs",
        written="range",
    ),
    Column("seeds", lambda own: own.score.notnull().sum("seed"), report="seeds", written="count"),
    Column(
        "unfinished",
        lambda own: own.unfinished,
        screen="unfinished\nruns",
        continuing=False,
        report="unfinished",
        written="count",
        help="how many runs finished no episode in the last tenth.",
    ),
    Column(
        "diverged",
        lambda own: own.ds.diverged.sum("seed") if "diverged" in own.ds else None,
        report="diverged",
        written="count",
        help="a run whose numbers became infinite, or grew beyond any possible return, mostly because the "
        "step size is too large. It scores as the worst run of its method, of prediction infinitely badly, "
        "and is left out of the pictures.",
    ),
    Column("seeds_wanted", lambda own: own.seeds_wanted, written="count"),
    Column("best", lambda own: own.is_best),
    Column("tied", lambda own: own.tied_at(0.95)),
    Column("difference", lambda own: Interval(*map(own.only_at_best, own.difference.interval))),
    Column("p", lambda own: own.only_at_best(own.difference.p)),
    *ERRORS,
    Column("steps_per_second", lambda own: own.ds.attrs.get("steps_per_second", np.nan), written="tenths"),
    Column(
        "policy_value",
        lambda own: None if (x := own.at_the_end("policy_value")) is None else x.median("seed"),
        screen="worth of the\nacting policy",
        report="worth of the acting policy",
        written="worth",
        help="what the policy that acts, exploring and all, earns in the long run, exact, as it acts at the end of a "
        "run, without the time limit; median over seeds. –: half of them or more may go round for ever.",
    ),
    Column(
        "greedy_arrives",
        lambda own: own.arriving,
        screen="greedy policy\narrives",
        report="greedy policy arrives",
        written="share",
        help="the share of seeds whose greedy policy at the end does not go round for ever.",
    ),
    Column(
        "greedy_value",
        lambda own: None if (x := own.at_the_end("greedy_value")) is None else x.median("seed"),
        screen="worth of the\ngreedy policy",
        report="worth of the greedy policy",
        written="worth",
        help="what the learned policy would earn without exploring, exact, at the end of a run; median over "
        "seeds. –: half of them or more may go round for ever.",
    ),
    Column(
        "soft",
        lambda own: None if np.isnan(own.soft) else own.only_at_best(own.soft),
        in_summary="",
        report="best ε-soft",
        tables=("chosen",),
        written="exact",
    ),
    Column(
        "optimum",
        lambda own: optimum(own.ds) if {"optimum", "optimal_value"} & {*own.ds, *own.ds.attrs} else None,
        screen=("exact\noptimum", "value of\nthe policy"),
        report=("exact optimum", "exact value"),
        written="exact",
    ),
]
# The last columns of `summary.csv`, in this order, which programs that read it may rely on.
LAST = ("steps_per_second", "greedy_value", "final_v_error", "optimum")


@dataclass(frozen=True)
class Row:
    """One setting of a method in numbers: `row[name]` for each column of this name, NaN where there is none.

    Of an interval it is estimate, low and high.

    Attributes:
        own: the settings of its method.
        place: its values on the axes of the sweep, fit for `ds.sel`.
        setting: all its hyperparameters, swept, drawn and fixed.
        number: the number of the setting among those of its method, in the order of the axes.
    """

    own: Method
    place: dict[str, Any]
    setting: dict[str, Any]
    number: int

    def has(self, column: str) -> bool:
        """Whether the method has such a number."""
        return self.own.numbers(column) is not None

    def __getitem__(self, column: str) -> Any:
        numbers = self.own.numbers(column)
        return np.nan if numbers is None else numbers[self.number]

    @property
    def method(self) -> str:
        return self.own.name

    @property
    def doubtful(self) -> bool:
        """Whether the mean rests on few bad runs."""
        return self["seeds_wanted"] > self["seeds"]


class Methods(Mapping[str, xr.Dataset]):
    """The sweeps of methods in one environment, by their names; and all that is worked out of them, each once.

    It can be passed wherever datasets are expected. `of` makes one of datasets, and returns one as it is.

    Attributes:
        settings: the settings of each method, by its name.
        env: the environment; None where it is not known, and then no best policy that explores is either.
    """

    def __init__(self, datasets: Datasets, env: Environment | None = None) -> None:
        self.settings: dict[str, Method] = {}  # so that it is a mapping when it is handed on
        self.settings |= {name: Method(ds, name, self) for name, ds in datasets.items()}
        self.env, self._soft = env, {}

    @classmethod
    def of(cls, datasets: Datasets, env: Environment | None = None) -> "Methods":
        return datasets if isinstance(datasets, cls) else cls(datasets, env)

    def __getitem__(self, name: str) -> xr.Dataset:
        return self.settings[name].ds

    def __iter__(self) -> Iterator[str]:
        return iter(self.settings)

    def __len__(self) -> int:
        return len(self.settings)

    def renamed(self, names: Mapping[str, str]) -> "Methods":
        """The same methods, with what is worked out of them, under other names.

        Args:
            names: the other names of some of the methods, by their own.

        Raises:
            InputError: there is no such method, or two would have the same name.
        """
        for name in names:
            check_choice(None, "the method", name, self)
        others = Methods({}, self.env)
        for name, own in self.settings.items():
            if (other := str(names.get(name, name))) in others.settings:
                raise InputError(f"two methods cannot both be called {shown(other)}")
            others.settings[other] = own
        return others

    @property
    def prediction(self) -> bool:
        return all(own.prediction for own in self.settings.values())

    @property
    def continuing(self) -> bool:
        """Whether the task has no end; False where the environment is not known."""
        return self.env is not None and of_environment(self.env).continuing

    @cached_property
    def by_length(self) -> bool:
        """Whether episodes earn by their length alone: see the function of this name."""
        return all(own.once(by_length) for own in self.settings.values())

    @cached_property
    def early(self) -> tuple[Row, Row] | None:
        """A setting that is better early than the one that wins in the end, and that one: see `better_early`."""
        found = better_early(self.settings)
        places = [] if found is None else [found.quick, found.winner]
        rows = [next(row for row in self.rows if (row.method, row.place) == place) for place in places]
        return (rows[0], rows[1]) if rows else None

    @cached_property
    def differences(self) -> dict[str, Difference]:
        """How the best settings differ from that of the best method: see the function of this name."""
        return differences(self.settings)

    def soft_optimum(self, setting: Mapping[str, Any]) -> float:
        """What the best policy earns that explores as `setting` does; NaN where that is not known."""
        key = repr(setting)  # probabilities of a behaviour are lists, which cannot be keys
        if key not in self._soft:
            self._soft[key] = np.nan if self.env is None else soft_optimum(self.env, setting)
        return self._soft[key]

    @cached_property
    def rows(self) -> list[Row]:
        """A row for every setting of every method, in the order of the axes."""
        return [row for own in self.settings.values() for row in _rows(own)]

    @property
    def hyperparameters(self) -> list[str]:
        """All that any method has: swept, drawn or fixed."""
        parts = ((*hyperparameters(ds), *drawn(ds), *fixed(ds)) for ds in self.values())
        return list(dict.fromkeys(name for part in parts for name in part))

    @cached_property
    def summary(self) -> pd.DataFrame:
        """The frame of the function `summary`."""
        records, statistics = [], {}
        for row in self.rows:
            numbers = _summarised(row)
            records.append({"method": row.method} | row.setting | row.place | numbers)
            statistics |= dict.fromkeys(numbers)
        last = [name for name in LAST if name in statistics]
        others = [name for name in statistics if name not in last]
        return pd.DataFrame(records, columns=["method", *self.hyperparameters, *others, *last])


def _rows(own: Method) -> Iterator[Row]:
    names = hyperparameters(own.ds)
    for number, values in enumerate(product(*(own.ds[name].values.tolist() for name in names))):
        place = dict(zip(names, values, strict=True))
        yield Row(own, place, named(own.ds, place) | fixed(own.ds), number)


def _summarised(row: Row) -> dict[str, Any]:
    """What `summary.csv` tells of a setting, by the names there."""
    numbers = {}
    for column in COLUMNS:
        name = column.name if column.in_summary is None else text(column.in_summary, row.own.prediction)
        if name and row.has(column.name):
            stem, x = name.removesuffix("_return"), row[column.name]
            parts = x if isinstance(x, tuple) else (x,)
            numbers |= dict(zip((name, f"{stem}_low", f"{stem}_high"), parts, strict=False))
    return numbers


def by_environment(datasets: Datasets, envs: Mapping[str, Environment]) -> dict[str, Methods]:
    """The methods of each environment, from datasets by their names "ENV/METHOD".

    Raises:
        InputError: an environment is missing.
    """
    own: dict[str, dict[str, xr.Dataset]] = {}
    for name, ds in datasets.items():
        label, _, method = name.partition("/")
        if label not in envs:
            raise InputError(f"there is no environment {label!r}; there are {', '.join(envs)}")
        own.setdefault(label, {})[method or name] = ds
    return {label: Methods(parts, envs[label]) for label, parts in own.items()}


def summary(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """A table with a row for each method and combination of hyperparameters: what `summary.csv` holds.

    All intervals are of 95%, each for itself.

    Args:
        datasets: a sweep for each method, by its name.

    Returns:
        A frame with the columns `method`; every hyperparameter of any method, swept or not (empty where a
        method has no such); `episodes`, episodes finished in the whole run, mean over seeds; and

        - of early learning, of the runs that did not diverge: `first_episode_steps`, steps until the end of the
          `first_episode`, median over seeds; `first_tenth_steps` and `last_tenth_steps`, steps an episode, all steps
          that were taken there over all episodes that ended there, infinite where none did; `first_tenth_unfinished`,
          how many runs finished no episode in the `first_tenth`; `first_tenth_return`, mean `early_score`, and
          `interim_return`, mean `interim_return`, with `first_tenth_low`, `interim_low` and so on. Their intervals
          are those of `mean_interval`, not made wider where the mean rests on few bad runs;
        - `reward_per_step` in the last tenth, where the task does not end;
        - `last_tenth_return` with `last_tenth_low` and `last_tenth_high`: the mean `score` of all seeds, and
          its interval by `score_interval`;
        - `last_tenth_median` and `last_tenth_iqm`, each with `_low` and `_high`: median and interquartile
          mean of the score, and their intervals, which hold also where the mean's cannot be trusted;
        - `seeds`: how many seeds there are in these; `unfinished`: how many of them finished no episode in
          the last tenth, and so count with the rewards that they collected there; `diverged`: how many
          diverged, and so count as the worst run of the sweep;
        - `seeds_wanted`: how many seeds it takes until the interval of the mean can be trusted (see the
          function of this name). More than `seeds`: it rests on few bad runs;
        - `best`: whether this is the best setting of its method (`best`); `tied`: whether it cannot be told
          apart from that (`tied`);
        - `difference` with `difference_low` and `difference_high`, and `p`, in the rows of the best settings
          of all methods but the first: how this differs from the best setting of the best method, seed by
          seed, corrected for the choice (`differences`). Empty elsewhere, and where the seeds are not the same;
        - `steps_per_second` of the method's sweep;
        - where it was recorded, `greedy_value`, the exact value of the greedy policy at the end, median over
          seeds; `optimum`, v* from the start, of prediction v_pi.

        Of prediction the score is the error, and its columns are `v_error`, `v_error_low`, `v_error_high`,
        `v_error_median`, ... and `v_error_iqm`, ...; `first_tenth_v_error`, with `first_tenth_v_error_low`, ..., is
        that of the first tenth, and `final_v_error` that at the end, mean over seeds. Of values that are
        linear in features also `final_value_error`, `least_value_error` and `td_value_error` (see `stats.errors`).
        `last_tenth_return`, `_low` and `_high` are then what the policy that acts earned in those runs that
        finished an episode there.
    """
    return Methods.of(datasets).summary
