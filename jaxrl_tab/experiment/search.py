"""A search as data: an experiment of which only the best settings are run to the end.

It is written as an experiment is, with one table more, `[search]`, which says how it is searched:

    seeds = 20                                     rl.Search(
    steps = 8000                                       "windy-gridworld",
                                                       {
    [search]                                               "name": "sarsa",
    draws = 27                                             "alpha": rl.LogUniform(0.05, 1),
                                                           "epsilon": rl.Uniform(0.01, 0.3),
    [[environment]]                                    },
    name = "windy-gridworld"                           seeds=20,
                                                       steps=8000,
    [[method]]                                         draws=27,
    name = "sarsa"                                 )
    alpha = {log_uniform = [0.05, 1]}
    epsilon = {uniform = [0.01, 0.3]}
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypeAlias

from jaxrl_tab.core.checks import build
from jaxrl_tab.core.errors import InputError, nearest, shown
from jaxrl_tab.core.pytree import checked_dataclass, field, static
from jaxrl_tab.engine.axes import DRAW, MOST_SETTINGS, WRITTEN, Grid, Random
from jaxrl_tab.engine.part import Part
from jaxrl_tab.experiment.places import Source, at, blame, located
from jaxrl_tab.experiment.plain import as_plain
from jaxrl_tab.experiment.resolve import ABOUT, axis, keys
from jaxrl_tab.experiment.spec import Experiment, as_toml, read_source, source_of

ROUNDS = 4  # of Optuna, which learns from one to the next


Growing: TypeAlias = Literal["steps", "seeds"]
Sampling: TypeAlias = Literal["random", "optuna"]


@checked_dataclass
class Halving:
    """How the best setting of each method is searched for: by successive halving (Jamieson and Talwalkar 2016).

    All settings run with a small budget, and of those one in `one_in` goes on, with a budget that is `one_in` times as
    large, and so on.

    Attributes:
        draws: how many settings are drawn of what is random, of each method.
        budget: instead of `draws`: as many as so many steps (or episodes, where runs are so long) allow in all, for
            each method.
        one_in: of the settings of a rung one in so many goes on, and two at least.
        rungs: how many rungs there are; in the last one a run is as long as the experiment says, on all seeds.
        grow: what is more from rung to rung: "seeds", where all runs have full length, or "steps" (or episodes), where
            runs go on from where they are.
        sampler: what proposes settings: "random", or "optuna" (TPE), which learns from those before.
        rounds: in how many rounds Optuna proposes them, each of which is halved; by default 4.
        fresh_seeds: on how many fresh seeds the setting that was found is run.
    """

    draws: int | None = field(default=None, at_least=1)
    budget: int | None = field(default=None, at_least=1)
    one_in: int = field(default=3, at_least=2)
    rungs: int = field(default=3, at_least=1)
    grow: Growing = static(default="seeds")
    sampler: Sampling = static(default="random")
    rounds: int | None = field(default=None, at_least=1)
    fresh_seeds: int = field(default=100, at_least=2)

    def __post_init__(self):
        if self.draws is not None and self.budget is not None:
            raise InputError("give draws or budget, not both: either says how many settings are tried")
        if self.rounds is not None and not self.is_optuna:
            raise InputError("rounds: only optuna learns from one round to the next; a random search has one")

    @property
    def is_optuna(self) -> bool:
        return self.sampler == "optuna"

    @property
    def number_of_rounds(self) -> int:
        return (self.rounds or ROUNDS) if self.is_optuna else 1

    def sizes(self, settings: int) -> list[int]:
        """How many settings are in each rung, of so many in the first: two at least, so that the last one decides."""
        sizes = [settings]
        while len(sizes) < self.rungs:
            sizes.append(max(min(2, settings), -(-sizes[-1] // self.one_in)))
        return sizes

    def of_rounds(self, settings: int) -> list[int]:
        """How many settings are proposed in each round, of so many in all."""
        each = -(-settings // self.number_of_rounds)
        return [min(each, settings - first) for first in range(0, settings, each)]


def seeds_in_words(seeds: int) -> str:
    return f"{seeds:,} seed{'s' if seeds > 1 else ''}"


class Rung(NamedTuple):
    """How far runs are at the end of a rung: so many steps (or episodes), on so many seeds."""

    length: int
    seeds: int


@dataclasses.dataclass(frozen=True)
class Search:
    """An experiment in one environment of which only the best settings are run to the end, by `halving`.

    It is made as `Experiment` is; what `Halving` has may stand beside, or in a dict `search`, as in a file.

    Attributes:
        experiment: all settings, with a run of full length on each seed; where Optuna proposes settings, as many that
            are drawn at random stand for them.
        halving: how it is searched.
        ranges: of each method, by its label, the hyperparameters that are searched, as they are written in a file: a
            list, or a dict such as {"uniform": [0, 1]}.
    """

    experiment: Experiment
    halving: Halving
    ranges: Mapping[str, Mapping[str, Any]]

    def __init__(
        self,
        environment: Any,
        method: Any,
        *,
        search: Any = None,
        source: Source | None = None,
        **more: Any,
    ):
        own = {key: more.pop(key) for key in keys(Halving) if key in more}
        with located(source):
            with at("search"):
                if not isinstance(search, Mapping | None):
                    raise InputError(
                        f"search must be a table of {', '.join(keys(Halving))}, not {shown(search)}"
                    )
                with blame(search or {}):
                    halving = build(Halving, "search", {**(search or {}), **own})
            for key in ("select", "until_decided"):
                if more.get(key) not in (None, False):
                    with at(key):
                        raise InputError(
                            f"{key} cannot be given to a search, which runs what it finds on fresh seeds; to decide "
                            "which method is better, write until_decided into the folder's experiment.toml, and resume"
                        )
        several = isinstance(method, list | tuple)
        tables = [
            dict(x) if isinstance(x, Mapping) else {"name": x} for x in (method if several else [method])
        ]
        given = {"environment": environment, **more}
        make = lambda draws: Experiment(**given, method=[_drawn(x, draws) for x in tables], source=source)
        with located(source), at("search"):
            experiment = _of_budget(make, halving) if halving.budget else make(halving.draws)
            if halving.draws and not any(map(_random, tables)):
                raise InputError(
                    "draws says how many settings are drawn, and nothing is random: give a range"
                )
        ranges = {
            own["label"]: {key: _written(key, x) for key, x in table.items() if _is_searched(key, x)}
            for own, table in zip(experiment.method, tables, strict=True)
        }
        self._keep(experiment, halving, ranges)
        with located(source), at("search"):
            self._check()

    @classmethod
    def of(cls, experiment: Experiment, halving: Halving, ranges: Mapping[str, Mapping[str, Any]]) -> Self:
        """A search of its three parts."""
        search = cls.__new__(cls)
        search._keep(experiment, halving, ranges)
        search._check()
        return search

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The search in a TOML file. Raises InputError as `Experiment.load`."""
        source = source_of(path)
        data = read_source(source)
        with located(source):
            for key in data:
                if key not in (known := [*keys(Experiment), "search"]):
                    with at(key):
                        raise InputError(f"a search has no {shown(key)}; {nearest(key, known)}")
            for key in ("environment", "method"):
                if key not in data:
                    raise InputError(f"there is no [[{key}]]")
        return cls(**data, source=source)

    def _keep(self, experiment: Experiment, halving: Halving, ranges: Mapping[str, Any]) -> None:
        for name, value in (("experiment", experiment), ("halving", halving), ("ranges", ranges)):
            object.__setattr__(self, name, value)

    def _check(self) -> None:
        if len(self.experiment.environment) > 1:
            labels = ", ".join(table["label"] for table in self.experiment.environment)
            raise InputError(
                f"a search is of one environment, and these are {len(self.experiment.environment)}: {labels}; search "
                "in each by itself"
            )
        self.ladder  # noqa: B018  raises where there are too many rungs
        for name, part in self.experiment.parts().items():
            if len(part.configs) < 2:
                raise InputError(
                    f"there is nothing to search: {name.partition('/')[2]} has one setting; give a hyperparameter "
                    "several values, or a range"
                )

    @property
    def ladder(self) -> list[Rung]:
        """How far runs are at the end of each rung. Raises InputError where there are too many rungs."""
        return _ladder(self.experiment, self.halving)

    def settings(self, label: str) -> int:
        """How many settings of a method are tried."""
        part = self.experiment.parts()[self.part_name(label)]
        return len(part.axes[DRAW]) if self.halving.is_optuna and DRAW in part.axes else len(part.configs)

    def part_name(self, label: str) -> str:
        """The name of the part of a method."""
        return f"{self.experiment.environment[0]['label']}/{label}"

    def work(self, label: str) -> int:
        """How many steps (or episodes) all runs of the search of a method have together."""
        return _work(self.ladder, self.halving, self.settings(label))

    def part_of(self, label: str, trials: list[dict[str, Any]]) -> Part:
        """A method with the settings that were proposed: each a value for everything that is searched."""
        table = next(table for table in self.experiment.method if table["label"] == label)
        kept = {key: x for key, x in table.items() if key not in {*self.ranges[label], DRAW, "draws"}}
        data = self.experiment.data() | {"method": [kept | {DRAW: trials}]}
        return Experiment.from_data(data).parts()[self.part_name(label)]

    def found(self, chosen: Mapping[str, Any]) -> Experiment:
        """The experiment with these settings alone, by the labels of the methods: instances of them."""
        data, methods = self.experiment.data(), []
        for table in self.experiment.method:
            config = chosen[table["label"]]
            values = {key: getattr(config, key) for key in keys(type(config))}
            plain = {key: as_plain(key, x) for key, x in values.items() if x is not None}
            methods.append({key: table[key] for key in ABOUT if key in table} | plain)
        data |= {"method": methods, "seeds": self.halving.fresh_seeds}
        data.pop("first_seed", None)
        return Experiment.from_data(data)

    def in_words(self, label: str) -> str:
        """How the settings of a method are searched, in a line."""
        halving, unit = self.halving, "episodes" if self.experiment.episodes else "steps"
        rungs = [
            f"{size:,} for {rung.length:,} {unit} on {seeds_in_words(rung.seeds)}"
            for size, rung in zip(
                halving.sizes(halving.of_rounds(self.settings(label))[0]), self.ladder, strict=True
            )
        ]
        rounds = len(halving.of_rounds(self.settings(label)))
        often = f", {rounds} times" if rounds > 1 else ""
        return f"{label}: {', '.join(rungs)}{often}; {self.work(label):,} {unit} in all"

    def to_toml(self) -> str:
        """The search as a file, with what is drawn at random drawn."""
        given = {key: x for key, x in dataclasses.asdict(self.halving).items() if x is not None}
        return as_toml({"search": given} | self.experiment.data())


def _is_searched(key: str, written: Any) -> bool:
    """Whether what is written for a key of a method is to be searched: a range, or several values."""
    if key in (*ABOUT, "draws", DRAW):
        return False
    return isinstance(written, Random | Grid | Mapping) or (
        isinstance(written, list | tuple) and len(written) > 1
    )


def _written(key: str, written: Any) -> Any:
    """The same as it stands in a file; of a grid the list of its values."""
    one = axis(key, written)
    if isinstance(one, Grid):
        return [as_plain(key, x) for x in one.values()]
    if not isinstance(one, Random):
        return [as_plain(key, x) for x in one]
    kind = next(name for name, cls in WRITTEN.items() if cls is type(one))
    fields = {f.name: getattr(one, f.name) for f in dataclasses.fields(one)}  # pyright: ignore[reportArgumentType]
    return {kind: as_plain(key, fields["values"]) if "values" in fields else [fields["low"], fields["high"]]}


def _drawn(table: Mapping[str, Any], draws: int | None) -> dict[str, Any]:
    """The table of a method, with so many draws where it has something random and does not say how many."""
    random = _random(table)
    if random and draws is None and "draws" not in table:
        raise InputError(
            f"{random[0]} is drawn at random: say how many settings are tried, by draws or budget"
        )
    return {**({"draws": draws} if random and draws else {}), **table}


def _random(table: Mapping[str, Any]) -> list[str]:
    """What of a method is drawn at random."""
    return [key for key, x in table.items() if key not in (*ABOUT, DRAW) and isinstance(axis(key, x), Random)]


def _ladder(experiment: Experiment, halving: Halving) -> list[Rung]:
    length, row = experiment.steps or experiment.episodes or 0, experiment.log_every or 1
    rungs = []
    for below in range(halving.rungs - 1, -1, -1):
        times = halving.one_in**below
        rows = math.ceil(length / (times * row))  # so that a rung ends where a row does
        if halving.grow == "steps":
            rungs.append(Rung(min(length, rows * row), experiment.seeds))
        else:
            rungs.append(Rung(length, -(-experiment.seeds // times)))
    if len(set(rungs)) < len(rungs):
        if halving.grow == "steps":
            what, more = f"rows of {row:,} of {length:,}", "a smaller log_every"
        else:
            what, more = seeds_in_words(experiment.seeds), "more seeds, or let steps grow"
        raise InputError(
            f"{halving.rungs} rungs, each {halving.one_in} times the one before, are too many for {what}: take "
            f"fewer, or {more}"
        )
    return rungs


def _work(ladder: list[Rung], halving: Halving, settings: int) -> int:
    total = 0
    for count in halving.of_rounds(settings):
        done = 0
        for size, rung in zip(halving.sizes(count), ladder, strict=True):
            total += size * (rung.length * rung.seeds - done)
            done = rung.length * rung.seeds
    return total


def _of_budget(make: Any, halving: Halving) -> Experiment:
    """The experiment with as many draws as the budget allows."""
    one = make(1)
    ladder = _ladder(one, halving)
    each = max(1 if halving.is_optuna else len(part.configs) for part in one.parts().values())
    if all(DRAW not in part.axes for part in one.parts().values()):
        raise InputError(
            "budget says how many settings are drawn, and nothing is random: give ranges, or leave it out"
        )
    fewest, most = 0, MOST_SETTINGS // each
    while fewest < most:
        middle = (fewest + most + 1) // 2
        within = _work(ladder, halving, middle * each) <= (halving.budget or 0)
        fewest, most = (middle, most) if within else (fewest, middle - 1)
    if fewest * each < 2:
        raise InputError(
            f"budget: two settings take {_work(ladder, halving, 2 * each):,}, more than {halving.budget:,}: give more, "
            "or fewer seeds or shorter runs"
        )
    return make(fewest)
