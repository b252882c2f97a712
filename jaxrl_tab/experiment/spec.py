"""An experiment as data: environments x methods x hyperparameters x seeds, in a file or in Python.

A file is TOML, and its keys are the keyword arguments of `Experiment`:

    seeds = 100                                    rl.Experiment(
    steps = 8000                                       seeds=100,
                                                       steps=8000,
    [[environment]]                                    environment=[
    name = "windy-gridworld"                               {"name": "windy-gridworld", "moves": "king"},
    moves = "king"                                     ],
                                                       method=[
    [[method]]                                             {
    name = "sarsa"                                             "name": "sarsa",
    alpha = [0.1, 0.5]                                         "alpha": [0.1, 0.5],
    epsilon = {log = [0.01, 0.5], points = 5}                  "epsilon": rl.LogGrid(0.01, 0.5, 5),
                                                           },
                                                       ],
                                                   )

Either becomes the same plain data, with all defaults filled in and all draws drawn: what is computed depends
on them alone, and `fingerprint` is their checksum. `template()` is a file that explains all of it.
"""

import bisect
import contextlib
import dataclasses
import hashlib
import itertools
import json
import math
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import jax
import numpy as np

from jaxrl_tab.algorithms.prediction import METHODS, PREDICTION
from jaxrl_tab.core import clock, describe, memory, policies, schedules
from jaxrl_tab.core.checks import (
    InputError,
    as_path,
    build,
    check_choice,
    is_whole,
    nearest,
    one_line,
    repeated,
    shown,
)
from jaxrl_tab.core.types import init_learner
from jaxrl_tab.engine import axes, room
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.sweep import Part, configurations, leaves_as_arrays, prepare
from jaxrl_tab.engine.train import default_log_every
from jaxrl_tab.envs import ENVS, instead

LONGEST_LABEL = 200  # characters
MOST_BYTES = 2**26  # of a file
DEEPEST = 32  # brackets in one another, and parts of a key with dots between them
TEMPLATE = Path(__file__).with_name("template.toml")


class Source(NamedTuple):
    """Where an experiment was read from.

    Attributes:
        path: the file.
        text: what stood in it.
    """

    path: Path
    text: str

    def __str__(self) -> str:
        return one_line(str(self.path))


@dataclasses.dataclass(frozen=True)
class Experiment:
    """Methods in environments, with every combination of hyperparameters, each over the same seeds.

    What is given is checked and resolved: after that the attributes are plain data, as JSON has it, from
    which `Experiment(**data)` makes the same one again.

    Attributes:
        environment: one or several, each a name, or a dict of `name`, parameters, and a `label` where it is
            not called by its name. Where a parameter is given as a list (of lists, where it is a list
            itself), each combination is an environment of its own.
        method: one or several, each a name, or a dict of `name`, hyperparameters, `label`, and `draws`: how
            many trials of what is random. A hyperparameter is a value, a list, or, as in `axes`, a grid in
            steps or a distribution: {"log": [0.01, 1], "points": 5} or LogGrid(0.01, 1, 5). A schedule or a
            policy is as it is typed: "glie", "softmax:0.5". A policy can also be probabilities [S][A].
        seeds: how many seeds.
        steps, episodes: how long each run is; one of the two.
        log_every: how many steps, or episodes, are summed up in a row of the log.
        seed: the root seed, of runs and of draws.
        exact: whether exact values are recorded at every row; prediction always records its error.
        select: whether the best setting of each method is run again on fresh seeds, and by what it is chosen:
            a dict as `Selection` has it; None: not.
        source: the file that it was read from; not part of the data.
    """

    environment: Any
    method: Any
    seeds: int = 100
    steps: int | None = None
    episodes: int | None = None
    log_every: int | None = None
    seed: int = 0
    exact: bool = False
    select: Any = None
    source: Source | None = dataclasses.field(default=None, repr=False, compare=False)

    def __post_init__(self):
        with _located(self.source):
            for name, least in (("seeds", 1), ("steps", 1), ("episodes", 1), ("log_every", 1), ("seed", 0)):
                with _at(name):
                    if name in ("seeds", "seed") or getattr(self, name) is not None:
                        self._set(name, _whole(name, getattr(self, name), least))
            if (self.steps is None) == (self.episodes is None):
                with _at("episodes"):
                    raise InputError("give either steps or episodes: how long a run is")
            with _at("exact"):
                if not isinstance(self.exact, bool | np.bool_):
                    raise InputError(f"exact must be true or false, not {shown(self.exact)}")
            self._set("environment", _environments(self.environment))
            self._set("method", _methods(self.method, self.seed, len(self.environment)))
            prediction = all(method["name"] in PREDICTION for method in self.method)
            self._set("exact", bool(self.exact) or prediction)
            self._set("log_every", self.log_every or default_log_every(self.steps))
            with _at("select"):
                self._set("select", None if self.select is None else _selection(self.select, self.seeds))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The experiment in a TOML file.

        Raises:
            InputError: the file cannot be read, or something in it is wrong; with its name and the line.
        """
        path = as_path("the file of an experiment", path)
        try:
            with path.open("rb") as file:
                content = file.read(MOST_BYTES + 1)
            text = content.decode("utf-8-sig")
        except OSError as error:
            raise InputError(f"{one_line(str(path))} cannot be read: {error.strerror}") from None
        except UnicodeDecodeError:
            raise InputError(f"{one_line(str(path))} is no text in UTF-8") from None
        if len(content) > MOST_BYTES:
            raise InputError(
                f"{one_line(str(path))} is larger than {memory.words(MOST_BYTES)}: that is no experiment"
            )
        source = Source(path, text.replace("\r\n", "\n"))
        return cls.from_data(_read(source), source)

    @classmethod
    def from_data(cls, data: Mapping[str, Any], source: Source | None = None) -> Self:
        """The experiment that `data` is, or what stands in a file; see `load` for what is raised."""
        if not isinstance(data, Mapping):
            raise InputError(f"an experiment is a dict, not {shown(data)}")
        with _located(source):
            for key in data:
                with _at(key):
                    if key not in _keys(cls):
                        hint = _belongs(key) or nearest(key, _keys(cls))
                        raise InputError(f"an experiment has no {shown(key)}; {hint}")
            for key, registry in (("environment", ENVS), ("method", METHODS)):
                if key not in data:
                    raise _Wrong(f"there is no [[{key}]]: name one or more of {', '.join(registry)}", ())
        return cls(**data, source=source)

    def data(self) -> dict[str, Any]:
        """All that decides what is computed, as JSON has it: with defaults filled in, and draws drawn."""
        return {name: value for name in _keys(type(self)) if (value := getattr(self, name)) is not None}

    @property
    def fingerprint(self) -> str:
        """The sha256 of the data, in hexadecimal digits."""
        return hashlib.sha256(_canonical(self.data()).encode()).hexdigest()

    def parts(self) -> dict[str, Part]:
        """What is to be run, by the labels "ENVIRONMENT/METHOD"; nothing is compiled.

        Raises:
            InputError: a method does not fit an environment.
        """
        found = {}
        with _located(self.source):
            for environment in self.environment:
                values = {key: x for key, x in environment.items() if key not in ("name", "label")}
                env = build(ENVS[environment["name"]], environment["label"], values)
                for i, method in enumerate(self.method):
                    with _at("method", i):
                        part = prepare(
                            env,
                            method["name"],
                            _grid(method, self.seed),
                            num_seeds=self.seeds,
                            num_steps=self.steps,
                            num_episodes=self.episodes,
                            log_every=self.log_every,
                            seed=self.seed,
                            exact=self.exact,
                        )
                        for config, *_ in part.programs:  # policies in tables must be of the task's size
                            jax.eval_shape(partial(init_learner, part.configs[config], env))
                    found[f"{environment['label']}/{method['label']}"] = part
        return found

    def to_toml(self) -> str:
        """The data as a file, which `load` reads as the same experiment."""
        lines, tables = [], []
        for key, value in self.data().items():
            if key in ("environment", "method"):
                for table in value:
                    tables += ["", f"[[{key}]]", *_toml_lines(table)]
            elif isinstance(value, Mapping):
                tables += ["", f"[{key}]", *_toml_lines(value)]
            else:
                lines += _toml_lines({key: value})
        return "\n".join([*lines, *tables]) + "\n"


@dataclasses.dataclass(frozen=True)
class Selection:
    """How the best setting of each method is chosen, to be run again on seeds that had no part in the choice.

    Attributes:
        by: "score": the mean return of the last tenth, of prediction the error (see `stats.score`).
        fresh_seeds: how many seeds it is then run on. They have a root of their own (see `sweep.Part`), so no
            other sweep has them, be it ever so large.
    """

    by: str = "score"
    fresh_seeds: int = 100

    def __post_init__(self):
        with _at("by"):
            check_choice("select", "by", self.by, CRITERIA)
        with _at("fresh_seeds"):
            _whole("fresh_seeds", self.fresh_seeds, 1)


CRITERIA = ("score",)


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What is not the same in the data of two experiments, a line for each."""
    lines = []
    for key in _keys(Experiment):
        before, after = old.get(key), new.get(key)
        if key not in ("environment", "method"):
            lines += _change(key, before, after)
            continue
        before, after = ({table["label"]: table for table in data[key]} for data in (old, new))
        lines += [f"{key} {label} is gone" for label in before if label not in after]
        lines += [f"{key} {label} is new" for label in after if label not in before]
        both = [label for label in after if label in before]
        if both != [label for label in before if label in after]:
            lines.append(f"{key}: the order is another one")
        for label in both:
            for name in before[label] | after[label]:
                lines += _change(f"{key} {label}: {name}", before[label].get(name), after[label].get(name))
    return lines


def _change(what: str, before: Any, after: Any) -> list[str]:
    if before == after:
        return []
    texts = ["not given" if x is None else _toml(x) for x in (before, after)]
    if max(map(len, texts)) > 200:  # such as many draws
        sizes = [len(x) if isinstance(x, list) else 1 for x in (before, after)]
        if sizes[0] == sizes[1]:
            return [f"{what} has other values"]
        texts = [f"{n} values" if n > 1 else text for n, text in zip(sizes, texts, strict=True)]
    return [f"{what} was {texts[0]}, and is {texts[1]}"]


def template() -> str:
    """A file that explains itself: what can be in one, with comments. It can be run as it is."""
    return TEMPLATE.read_text(encoding="utf-8")


# --- what it will take -------------------------------------------------------------------------------


class PartPlan(NamedTuple):
    """What a part will take.

    Attributes:
        programs: how many programs are compiled for it: what shapes the program, such as the n of n-step
            methods, makes one of its own.
        runs: how many runs there are, of all programs.
        blocks: in how many blocks they go.
        work: how many steps, or episodes, they are in all.
        results: the bytes of what they give.
        working: the bytes that are needed beside, at most, while they are computed.
    """

    programs: int
    runs: int
    blocks: int
    work: int
    results: int
    working: int


class Plan(NamedTuple):
    """What an experiment will take: what is known before anything is compiled.

    Attributes:
        parts: what each of its parts will take, by their labels.
        unit: "steps" or "episodes": what their work is counted in.
        devices: on what it is computed, in words.
    """

    parts: dict[str, PartPlan]
    unit: str
    devices: str

    def text(self) -> str:
        """The plan for people: a line for each part, and the sums."""
        parts = list(self.parts.values())
        total = PartPlan(*map(sum, zip(*parts, strict=True)))._replace(working=max(x.working for x in parts))
        rows = [["", "programs", "runs", "blocks", self.unit, "results", "working memory"]]
        for name, x in [*self.parts.items(), *([("all together", total)] if len(parts) > 1 else [])]:
            counts = [f"{n:,}" for n in x[:4]]
            rows.append([name, *counts, memory.words(x.results), memory.words(x.working)])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
            for row in rows
        ]
        return "\n".join([*lines, f"on {self.devices}"])

    def seconds_left(self, done: Mapping[str, tuple[int, float]]) -> float | None:
        """How much longer it will take, as far as its parts so far tell; None before there is any.

        A part goes on as fast as it went; one that has not begun as fast as the others on average, per step.

        Args:
            done: for each part that has begun, how many of its runs are finished, and in how many seconds.
        """
        each = {name: x.work / x.runs for name, x in self.parts.items()}
        begun = {name: (each[name] * runs, seconds) for name, (runs, seconds) in done.items() if runs}
        if not begun:
            return None
        work, seconds = map(sum, zip(*begun.values(), strict=True))
        left = 0.0
        for name, x in self.parts.items():
            own_work, own_seconds = begun.get(name, (0, 0.0))
            pace = own_seconds / own_work if own_work else seconds / work
            left += pace * (x.work - own_work)
        return left


def plan(parts: Mapping[str, Part], limit: int | None = None, devices: Sequence[Any] | None = None) -> Plan:
    """What these parts of an experiment will take; nothing is compiled.

    Args:
        parts: as `Experiment.parts` gives them.
        limit: how many bytes may be taken; by default half of what is free.
        devices: the JAX devices to use; all by default.
    """
    devices = tuple(devices or jax.devices())
    kind = "core" if devices[0].platform == "cpu" else devices[0].device_kind
    found = {}
    for name, part in parts.items():
        each = [
            room.forecast(
                part.env,
                leaves_as_arrays(part.configs[members[0]]),
                part.root,
                len(members) * part.num_seeds,
                part.budget,
                limit,
                devices,
            )
            for members in part.programs
        ]
        found[name] = PartPlan(
            programs=len(each),
            runs=part.runs,
            blocks=sum(x.blocks for x in each),
            work=part.runs * (part.budget.num_steps or part.budget.num_episodes or 0),
            results=sum(x.results for x in each),
            working=max(x.working for x in each),
        )
    unit = "steps" if next(iter(parts.values())).budget.num_steps else "episodes"
    return Plan(found, unit, f"{len(devices)} {kind}{'s' if len(devices) > 1 else ''}")


# --- from what was given to plain data ---------------------------------------------------------------


def _environments(given: Any) -> list[dict[str, Any]]:
    """The plain data of each environment: one for each combination of what is listed."""
    found, places = [], []
    for i, table in enumerate(_tables("environment", given, ENVS)):
        with _at("environment", i):
            made = _environment(table, len(found))
            found += made
            places += [i] * len(made)
    _check_labels("environment", found, places)
    return found


def _environment(table: Mapping[str, Any], others: int) -> list[dict[str, Any]]:
    """Those that a table describes, beside so many others."""
    cls, label = ENVS[table["name"]], table["label"]
    wanted = {p.name: p for p in describe.parameters(cls)}
    tried = {}
    for key, given in _own(table, wanted).items():
        with _at(key):
            tried[key] = _values_of_environment(key, given, wanted[key])
    found = []
    axes.check_settings(others + math.prod(map(len, tried.values())), "the environments")
    for point in itertools.product(*tried.values()):
        values = dict(zip(tried, point, strict=True))
        with _blame(values):
            build(cls, label, values)
        own = [f"{key}={_short(value)}" for key, value in values.items() if len(tried[key]) > 1]
        data = {key: values.get(key, _listed(p.default)) for key, p in wanted.items()}
        found.append({"name": table["name"], "label": ",".join([label, *own])} | data)
    return found


def _short(value: Any) -> str:
    """A value as it can stand in the name of a folder."""
    return re.sub(r'[" ]', "", json.dumps(value))


def _values_of_environment(key: str, given: Any, parameter: describe.Parameter) -> list[Any]:
    """What is to be tried of a parameter of an environment."""
    given = _axis(key, given)
    if isinstance(given, axes.Random):
        raise InputError(f"{key}: an environment can have grids, but nothing random")
    given = _listed(given.values() if isinstance(given, axes.Grid) else given)
    depth = 1 if isinstance(parameter.default, tuple) else 0
    tried = given if _depth(given) == depth + 1 else [given]
    if any(_depth(x) != depth for x in tried):
        what = "a list, or a list of lists" if depth else "a value, or a list"
        raise InputError(f"{key} takes {what} to be tried one by one, not {shown(given)}")
    one = lambda x: describe.value(key, x, parameter)
    values = [[one(entry) for entry in x] if depth else one(x) for x in tried]
    if not values:
        raise InputError(f"the grid of {key} is empty")
    if again := repeated(values):
        raise InputError(f"the grid of {key} holds {shown(again[0])} more than once")
    return values


def _methods(given: Any, seed: int, environments: int) -> list[dict[str, Any]]:
    """The plain data of each method."""
    tables = _tables("method", given, METHODS)
    first = tables[0]["name"]
    for i, table in enumerate(tables):
        with _at("method", i):
            prediction, control = sorted([first, table["name"]], key=lambda name: name not in PREDICTION)
            if prediction in PREDICTION and control not in PREDICTION:
                raise InputError(
                    f"{prediction} learns the values of a policy, and {control} a policy, which cannot be "
                    "compared; sweep methods of prediction and of control apart"
                )
    grids, settings = [], 0
    for i, table in enumerate(tables):
        with _at("method", i):
            grids.append(_grid(table, seed))
            settings += math.prod(len(x) for x in grids[-1].values() if isinstance(x, list))
            times = f" in {environments:,} environments" if environments > 1 else ""
            axes.check_settings(settings * environments, f"the methods{times}")
    _check_labels("method", tables, range(len(tables)))
    found = []
    for i, (table, grid) in enumerate(zip(tables, grids, strict=True)):
        with _at("method", i):
            found.append(_method(table, grid))
    return found


def _method(table: Mapping[str, Any], grid: Mapping[str, Any]) -> dict[str, Any]:
    cls = METHODS[table["name"]]
    with _blame(table):
        _, configs = configurations(cls, grid)
    data = {"name": table["name"], "label": table["label"]}
    together = [name for trial in grid.get(DRAW, [])[:1] for name in trial]
    for key in [*(key for key in _keys(cls) if key not in together), *([DRAW] if together else [])]:
        with _at(key):
            value = grid[key] if key in grid else getattr(configs[0], key)
            data |= {} if value is None else {key: _plain(key, value)}
    return data


def _grid(table: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The grid of a method, as `sweep` takes it, in the order of the class; what is random is drawn."""
    wanted = {p.name: p for p in describe.parameters(METHODS[table["name"]])}
    own = _own(table, wanted, "draws", DRAW)
    given = {}
    for key, x in own.items():
        with _at(key):
            given[key] = _axis(key, x)
    with _at("draws"):
        grid = axes.spread(given, given.pop("draws", None), seed, table["label"])
    trials = grid.pop(DRAW, [])
    with _at(DRAW):
        drawn = {name: [trial[name] for trial in trials] for name in (trials[0] if trials else {})}
        drawn = _own({"label": table["label"], **drawn}, wanted)
    for key, x in grid.items():
        with _at(key):
            several = _depth(x) > 0 and not (_takes_table(wanted[key]) and _depth(x) == 2)
            grid[key] = [_value(key, y, wanted[key]) for y in x] if several else _value(key, x, wanted[key])
    for key, x in drawn.items():
        with _at(key if key in own else DRAW):
            drawn[key] = [_value(key, y, wanted[key]) for y in x]
    if drawn:
        grid[DRAW] = [dict(zip(drawn, values, strict=True)) for values in zip(*drawn.values(), strict=True)]
    return grid


def _tables(kind: str, given: Any, registry: Mapping[str, type]) -> list[dict[str, Any]]:
    """What is given for the key `kind`, as tables with a name that is known and a label."""
    several = isinstance(given, Sequence) and not isinstance(given, str)
    found = []
    with _at(kind):
        axes.check_settings(len(given) if several else 1, f"so many tables [[{kind}]]")
    for i, table in enumerate(given if several else [given]):
        with _at(kind, i):
            table = {"name": table} if isinstance(table, str) else table
            if not isinstance(table, Mapping):
                raise InputError(f"{kind} must be a name, or tables with a name each, not {shown(table)}")
            if "name" not in table:
                raise InputError(f"the {kind} has no name: one of {', '.join(registry)}")
            with _at("name"):
                name = table["name"]
                if not isinstance(name, str) or name not in registry:
                    if registry is ENVS:
                        raise InputError(f"{shown(name)} is not an environment; {instead(name)}")
                    raise InputError(f"{shown(name)} is not a method; {nearest(name, registry)}")
            with _at("label"):
                label = table.get("label", name)
                _check_label(label)
            found.append({**table, "name": name, "label": label})
    if not found:
        with _at(kind):
            raise InputError(f"there is no {kind}: name one or more of {', '.join(registry)}")
    return found


def _check_label(label: Any) -> None:
    """Raises InputError unless it can name a group in a file, and a folder, and be read in a picture."""
    if not isinstance(label, str) or not re.match(r"\w", label) or "/" in label or not label.isprintable():
        raise InputError(
            "a label must be a text in one line that begins with a letter or a digit and has no '/', "
            f"not {shown(label)}"
        )
    if len(label) > LONGEST_LABEL:
        raise InputError(
            f"a label may have {LONGEST_LABEL} characters, and {shown(label[:40])}... has {len(label):,}"
        )


def _check_labels(kind: str, tables: Sequence[Mapping[str, Any]], places: Sequence[int]) -> None:
    first: dict[str, int] = {}
    for i, table in zip(places, tables, strict=True):
        label = table["label"]
        with _at(kind, i):
            _check_label(label)  # also where it is made of the values of a grid
            if first.setdefault(label, i) != i:
                raise InputError(f"the {kind} {label} is named more than once: give each a label of its own")


def _belongs(key: str) -> str | None:
    """Below what a parameter belongs that was not written in a table."""
    for kind, registry in (("method", METHODS), ("environment", ENVS)):
        if any(key in _keys(cls) for cls in registry.values()):
            return f"write it below a [[{kind}]] that has it"
    return None


def _own(table: Mapping[str, Any], wanted: Mapping[str, describe.Parameter], *more: str) -> dict[str, Any]:
    """The parameters of a table, and keys that may be there besides, in the order of the class."""
    known = [*wanted, *more]
    for key in table:
        if key not in ("name", "label", *known):
            with _at(key):
                hint = nearest(key, wanted)
                if key in _keys(Experiment):
                    hint = "it is of the whole experiment: write it above the first table"
                raise InputError(f"{table['label']} has no parameter {shown(key)}; {hint}")
    return {key: table[key] for key in known if key in table}


def _axis(key: str, given: Any) -> Any:
    """`given`; as a grid in steps or a distribution where it is a dict, {"log": [0.01, 1], "points": 5}."""
    if not isinstance(given, Mapping):
        return given
    kinds = [name for name in given if name in axes.WRITTEN]
    if len(kinds) != 1:
        known = ", ".join(axes.WRITTEN)
        hint = nearest(next(iter(given)), axes.WRITTEN) if given and not kinds else f"one of {known}"
        raise InputError(f"{key}: {shown(dict(given))} is no way to try values; {hint}")
    (kind,) = kinds
    cls, ends = axes.WRITTEN[kind], given[kind]
    more = {name: x for name, x in given.items() if name != kind}
    allowed = {"points"} if issubclass(cls, axes.Grid) else set()
    if wrong := [name for name in more if name not in allowed]:
        takes = nearest(wrong[0], allowed) if allowed else f"{kind} takes nothing else"
        raise InputError(f"{key}: {kind} has no {shown(wrong[0])}; {takes}")
    if allowed - set(more):
        raise InputError(f"{key}: say how many points, {{{kind} = [0.1, 1], points = 5}}")
    if cls is not axes.Choice and (not isinstance(ends, Sequence) or isinstance(ends, str) or len(ends) != 2):
        raise InputError(f"{key}: {kind} must be the two ends, such as [0.1, 1], not {shown(ends)}")
    try:
        return cls(ends) if cls is axes.Choice else cls(*ends, **more)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _value(key: str, given: Any, parameter: describe.Parameter) -> Any:
    """`given` as a value of a hyperparameter."""
    if _takes_table(parameter) and _depth(given) == 2:
        return policies.Table(_listed(given))
    if _only_table(parameter):
        if isinstance(given, policies.Table):
            return given
        raise InputError(f"{key} takes probabilities, a list for each state, not {shown(given)}")
    return describe.value(key, given, parameter)


def _takes_table(parameter: describe.Parameter) -> bool:
    return describe.takes_policy(parameter) or _only_table(parameter)


def _only_table(parameter: describe.Parameter) -> bool:
    return parameter.default is None and not describe.takes_policy(parameter)


def _plain(key: str, value: Any) -> Any:
    """A hyperparameter as JSON has it, and as it can be given again."""
    if isinstance(value, Mapping):
        return {name: _plain(name, x) for name, x in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(key, x) for x in value]
    if isinstance(value, policies.Table):
        return np.asarray(value.probabilities).tolist()
    if not isinstance(value, clock.Schedule | policies.Policy):
        return value
    parse = schedules.parse if isinstance(value, clock.Schedule) else policies.parse
    with contextlib.suppress(InputError):
        if repr(parse(str(value))) == repr(value):
            return str(value)
    raise InputError(f"{key}: {shown(value)} cannot be written in a file; sweep(...) takes it")


def _listed(value: Any, depth: int = 0) -> Any:
    """Lists in place of tuples and arrays."""
    if depth > DEEPEST:
        raise InputError(f"more than {DEEPEST} lists are in one another")
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return [_listed(x, depth + 1) for x in value] if isinstance(value, list | tuple) else value


def _depth(value: Any) -> int:
    """How deep lists are in one another; of lists of unlike entries the deepest."""
    return _depth_of_lists(_listed(value))


def _depth_of_lists(value: Any) -> int:
    return 1 + max(map(_depth_of_lists, value), default=0) if isinstance(value, list) else 0


def _whole(name: str, value: Any, least: int) -> int:
    if not is_whole(value, least):
        raise InputError(
            f"{name} must be a whole number of at least {least} and below 2**31, not {shown(value)}"
        )
    return int(value)


def _selection(given: Any, seeds: int) -> dict[str, Any]:
    if isinstance(given, Selection):
        return dataclasses.asdict(given)
    if not isinstance(given, Mapping):
        raise InputError(f"select must be a table of {', '.join(_keys(Selection))}, not {shown(given)}")
    for key in given:
        with _at(key):
            if key not in _keys(Selection):
                raise InputError(f"select has no {shown(key)}; {nearest(key, _keys(Selection))}")
    return dataclasses.asdict(Selection(**{"fresh_seeds": seeds, **given}))


def _keys(cls: type) -> list[str]:
    return [field.name for field in dataclasses.fields(cls) if field.name != "source"]


def _canonical(data: Any) -> str:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _toml_lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(_toml_lines(value)) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)  # of these TOML's form is JSON's


# --- what is wrong, and where ------------------------------------------------------------------------


class _Wrong(InputError):
    """Something is wrong at `path`: the keys, and places in lists, that lead there."""

    def __init__(self, message: str, path: tuple[str | int, ...]):
        super().__init__(message)
        self.path = path


@contextlib.contextmanager
def _at(*path: str | int) -> Iterator[None]:
    """What is refused inside is at `path`."""
    try:
        yield
    except InputError as error:
        raise _Wrong(str(error), (*path, *getattr(error, "path", ()))) from None


@contextlib.contextmanager
def _blame(names: Collection[str]) -> Iterator[None]:
    """What is refused inside is at the first of `names` that the message has in it."""
    try:
        yield
    except InputError as error:
        said = re.findall(r"\w+", str(error))
        path = min(((name,) for name in names if name in said), key=lambda x: said.index(x[0]), default=())
        raise _Wrong(str(error), path) from None


@contextlib.contextmanager
def _located(source: Source | None) -> Iterator[None]:
    """What is refused inside says where in the file it is, if there is a file."""
    try:
        yield
    except _Wrong as error:
        where = ""
        if source:
            line = _line(source, error.path)
            where = f"{source}, line {line}: " if line else f"{source}: "
        raise InputError(f"{where}{error}") from None


def _read(source: Source) -> dict[str, Any]:
    """What the file says. Raises InputError, with the line, where it is no TOML or nested beyond reason."""
    statements = _statements(source)
    try:
        return tomllib.loads(source.text)
    except tomllib.TOMLDecodeError as error:
        what, _, place = str(error).partition(" (at ")
        found = re.match(r"line (\d+)", place)  # if not, it is the end: something was left open
        line = found[1] if found else statements[-1].line
        raise InputError(f"{source}, line {line}: {one_line(what[0].lower() + what[1:])}") from None
    except ValueError:
        raise InputError(f"{source}: a whole number has more digits than Python reads") from None


# What a file is made of as far as it must be known where statements end: texts, comments, and single characters.
_PIECE = re.compile(
    r'''"""(?:\\.|[^\\])*?(?:"{3,5}|\Z)|'{3}.*?(?:'{3,5}|\Z)|"(?:\\.|[^"\\\n])*"?|'[^'\n]*'?|\#[^\n]*|[][{}=.,\n]''',
    re.DOTALL,
)


class _Statement(NamedTuple):
    line: int  # on which it begins
    end: int  # of the text up to and with it


def _statements(source: Source) -> list[_Statement]:
    """The statements of a file, blank lines among them; the last one may be left open.

    tomllib tells no lines. But the beginning of a file is TOML itself wherever nothing is left open.

    Raises:
        InputError: brackets are in one another, or a key has parts, beyond `DEEPEST`.
    """
    found, line, first, depth, parts = [], 1, 1, 0, 0
    for piece in _PIECE.finditer(source.text):
        text = piece[0]
        depth += (text in ("[", "{")) - (text in ("]", "}"))
        parts = parts + 1 if text == "." else parts if text[0] in "\"'" else 0
        if max(depth, parts) > DEEPEST:
            what = "brackets are in one another" if depth > DEEPEST else "parts are in a key"
            raise InputError(f"{source}, line {line}: more than {DEEPEST} {what}")
        line += text.count("\n")
        if text == "\n" and depth <= 0:
            found.append(_Statement(first, piece.end()))
            first, depth = line, 0
    if not found or found[-1].end < len(source.text):
        found.append(_Statement(first, len(source.text)))
    return found


def _line(source: Source, path: Sequence[str | int]) -> int | None:
    """The line on which what is at `path` begins, or as much of the way there as there is."""
    data = tomllib.loads(source.text)
    path = next((path[:n] for n in range(len(path), 0, -1) if _is_there(data, path[:n])), ())
    if not path:
        return None
    statements = _statements(source)
    said = lambda end: _is_there(tomllib.loads(source.text[:end]), path)
    return statements[bisect.bisect_left(statements, True, key=lambda x: said(x.end))].line


def _is_there(data: Any, path: Sequence[Any]) -> bool:
    for key in path:
        if isinstance(key, int) and not isinstance(data, list):
            continue  # a table alone is the first of one
        try:
            data = data[key]
        except (LookupError, TypeError):
            return False
    return True
