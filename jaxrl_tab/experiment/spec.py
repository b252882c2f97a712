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

import dataclasses
import hashlib
import json
import re
import tomllib
from collections.abc import Collection, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from jaxrl_tab.core import memory, modules, notebook
from jaxrl_tab.core.checks import checked
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import InputError, as_path, listed, nearest, one_line, shown
from jaxrl_tab.core.pytree import field
from jaxrl_tab.engine.backend import Backend
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.log import recorded_shapes
from jaxrl_tab.engine.part import Part
from jaxrl_tab.engine.sweep import prepare
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment import tasks
from jaxrl_tab.experiment.instances import made
from jaxrl_tab.experiment.places import Source, at, located, split_statements
from jaxrl_tab.experiment.resolve import (
    ABOUT,
    References,
    belongs,
    comparison,
    environments,
    grid_of,
    keys,
    methods,
    recorder,
    selection,
)
from jaxrl_tab.methods import METHODS

MOST_BYTES = 2**26  # of a file
LATER = {"first_seed": 0}  # what was added to experiments since: left out as it was before, fingerprints stay
TEMPLATE = Path(__file__).with_name("template.toml")


@dataclasses.dataclass(frozen=True)
class Experiment:
    """Methods in environments, with every combination of hyperparameters, each over the same seeds.

    What is given is checked and resolved: after that the attributes are plain data, as JSON has it, from
    which `Experiment(**data)` makes the same one again.

    Attributes:
        environment: one or several, each a name (also "mine.py:MyEnv", see `core.names`), a class, an
            instance, or a dict of `name` (which may be a class or an instance, too), parameters, and a `label`
            where it is not called by its name. Where a parameter is given as a list (of lists, where it is a
            list itself), each combination is an environment of its own. Also what holds in this one alone, instead
            of what holds for all: `steps` or `episodes`, `log_every`, and the `gamma` of the methods.
        method: one or several, each a name, a class, an instance, whose fields are fixed, or a dict of `name`,
            hyperparameters, `label`, and `draws`: how many trials of what is random. A hyperparameter is a
            value, a list, or, as in `axes`, a grid in steps or a distribution: {"log": [0.01, 1], "points": 5}
            or LogGrid(0.01, 1, 5). A schedule or a policy is as it is typed: "glie", "softmax:0.5". A policy
            can also be probabilities [S][A].
        seeds: how many seeds.
        first_seed: the number of the first of them, from which the others follow, as in `sweep`.
        steps, episodes: how long each run is; one of the two.
        log_every: how many steps, or episodes, are summed up in a row of the log.
        seed: the root seed, of runs and of draws.
        exact: whether exact values are recorded at every row; prediction records its error wherever that is known.
        exact_every: exact values of control in one of so many rows only, and in the last; it makes `exact` true.
        record: a function that records more at every row, as in `train`, or its name, "mine.py:function" or
            "package.module:function"; its arrays are variables of the results.
        backend: what compiles it: "lanes", "xla", or "auto", which is `lanes` where it can; see `engine.backend`.
        select: whether the best setting of each method is run again on fresh seeds, and by what it is chosen:
            a dict as `Selection` has it; None: not.
        until_decided: whether methods are compared, each at its best setting, on as many fresh seeds as it takes to
            decide which is better: True, the difference of mean scores that matters, or a dict as `UntilDecided` has
            it; None: not. It makes `select` a dict.
        source: the file that it was read from; not part of the data.
        references: what the names stand for; not part of the data.
    """

    environment: Any
    method: Any
    seeds: int = field(default=100, at_least=1)
    first_seed: int = field(default=0, at_least=0)
    steps: int | None = field(default=None, at_least=1)
    episodes: int | None = field(default=None, at_least=1)
    log_every: int | None = field(default=None, at_least=1)
    seed: int = field(default=0, at_least=0)
    exact: bool = field(default=False)
    exact_every: int | None = field(default=None, at_least=1)
    record: Any = None
    backend: Backend = dataclasses.field(default="auto", metadata={"static": True})
    select: Any = None
    until_decided: Any = None
    source: Source | None = dataclasses.field(default=None, repr=False, compare=False)
    references: References = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self):
        modules.check_not_importing()
        with located(self.source):
            for f in dataclasses.fields(self):
                with at(f.name):
                    self._set(f.name, checked(None, f, getattr(self, f.name)))
            with at("episodes"):
                self._set("log_every", Budget(self.steps, self.episodes, self.log_every).row)
            source, references = self.source, self.references
            self._set("environment", environments(self.environment, source, references))
            count = len(self.environment)
            self._set("method", methods(self.method, source, references, self.seed, count))
            classes = [references[method["name"]].cls for method in self.method]
            with at("environment"):
                tasks.check(self.environment, self._environments, self.method, self.steps)
            prediction = all(of_method(cls).learns is Learns.STATES for cls in classes)
            known = all(
                getattr(cls, "num_states", None) != 0 or hasattr(cls, "known_values")
                for cls in self._environments
            )
            self._set("exact", self.exact or self.exact_every is not None or (prediction and known))
            with at("record"):
                self._set(
                    "record", None if self.record is None else recorder(self.record, source, references)
                )
            if self.until_decided is False:
                self._set("until_decided", None)
            if self.until_decided is not None and self.select is None:
                self._set("select", {})
            with at("select"):
                self._set("select", None if self.select is None else selection(self.select, self.seeds))
            if self.until_decided is not None and self.select is not None:
                with at("until_decided"):
                    first, count = self.select["fresh_seeds"], len(self.method)
                    self._set("until_decided", comparison(self.until_decided, count, first))

    def __repr__(self) -> str:
        return f"<Experiment: {self.in_words}>"

    def _repr_html_(self) -> str:
        rows = [
            (kind, one_line(table["label"]), one_line("; ".join(_toml_lines(_without(table, ABOUT)))))
            for kind in ("environment", "method")
            for table in getattr(self, kind)
        ]
        return notebook.table(f"Experiment: {self.in_words}", ("", "name", "parameters"), rows)

    @property
    def in_words(self) -> str:
        """What it is, in a line: methods, environments, seeds and the length of runs."""
        names = [", ".join(table["label"] for table in x) for x in (self.method, self.environment)]
        unit = "steps" if self.steps is not None else "episodes"
        lengths = {table.get(unit, getattr(self, unit)) for table in self.environment}
        length = " to ".join(map(str, sorted({min(lengths), max(lengths)})))
        return one_line(f"{names[0]} in {names[1]}; {self.seeds} seeds, {length} {unit}")

    @property
    def _environments(self) -> list[type]:
        """The classes of the environments."""
        return [self.references[table["name"]].cls for table in self.environment]

    def _set(self, name: str, value: Any) -> None:
        # The class is frozen for all others.
        object.__setattr__(self, name, value)

    @classmethod
    def load(cls, path: str | Path, pinned: Mapping[str, Mapping[str, Any]] | None = None) -> Self:
        """The experiment in a TOML file.

        Args:
            path: the file. Paths in it start from its folder.
            pinned: names in it whose meaning is settled, as `sources.read` gives it.

        Raises:
            InputError: the file cannot be read, or something in it is wrong; with its name and the line.
        """
        return cls.from_source(source_of(path, pinned))

    @classmethod
    def from_source(cls, source: Source) -> Self:
        """The experiment that stands in a text; see `load` for what is raised."""
        return cls.from_data(read_source(source), source)

    @classmethod
    def from_data(cls, data: Mapping[str, Any], source: Source | None = None) -> Self:
        """The experiment that `data` is, or what stands in a file; see `load` for what is raised."""
        if not isinstance(data, Mapping):
            raise InputError(f"an experiment is a dict, not {shown(data)}")
        with located(source):
            for key in data:
                with at(key):
                    if key not in keys(cls):
                        hint = belongs(key) or nearest(key, keys(cls))
                        raise InputError(f"an experiment has no {shown(key)}; {hint}")
            for key, registry in (("environment", ENVS), ("method", METHODS)):
                if key not in data:
                    raise InputError(f"there is no [[{key}]]: name one or more of {listed(registry)}")
        return cls(**data, source=source)

    def data(self) -> dict[str, Any]:
        """All that decides what is computed, as JSON has it: with defaults filled in, and draws drawn."""
        data = {name: value for name in keys(type(self)) if (value := getattr(self, name)) is not None}
        return {name: value for name, value in data.items() if LATER.get(name) != value}

    @property
    def fingerprint(self) -> str:
        """The sha256 of the data, in hexadecimal digits."""
        return hashlib.sha256(_canonical(self.data()).encode()).hexdigest()

    @property
    def files(self) -> tuple[modules.File, ...]:
        """The files that its own classes and tables are in."""
        files = {x.file.sha256: x.file for x in self.references.values() if x.file}
        return tuple(files.values())

    def parts(self) -> dict[str, Part]:
        """What is to be run, by the labels "ENVIRONMENT/METHOD"; nothing is compiled.

        Raises:
            InputError: a method does not fit an environment.
        """
        return self._parts

    @cached_property
    def _parts(self) -> dict[str, Part]:
        parts = {}
        record = self.references[self.record["name"]].cls if self.record else None
        budget = Budget(self.steps, self.episodes, self.log_every, self.exact, record, self.exact_every)
        with located(self.source):
            for environment in self.environment:
                env, own = environment_of(environment, self.references)
                for i, method in enumerate(self.method):
                    with at("method", i):
                        cls = self.references[method["name"]].cls
                        part = prepare(
                            env,
                            cls,
                            grid_of(own.method(method), cls, self.seed),
                            own.budget(budget),
                            num_seeds=self.seeds,
                            seed=self.seed,
                            first_seed=self.first_seed,
                        )
                    with at("record"):
                        recorded_shapes(record, part.configs[0], env)
                    with at("method", i):
                        _ = part.needs  # policies in tables must be of the task's size
                    parts[f"{environment['label']}/{method['label']}"] = part
            with at("until_decided"):
                if self.until_decided and sum(len(x.configs) for x in parts.values()) == len(
                    self.environment
                ):
                    raise InputError(
                        "until_decided: there is one setting alone, and nothing to compare it with"
                    )
        return parts

    def to_toml(self) -> str:
        """The data as a file, which `load` reads as the same experiment."""
        return as_toml(self.data())


def environment_of(table: Mapping[str, Any], references: References) -> tuple[Any, tasks.Own]:
    """The environment that a resolved table describes, and what it has of its own."""
    cls = references[table["name"]].cls
    own, values = tasks.split(_without(table, ABOUT), cls)
    return made(cls, table["label"], values), tasks.Own(**own)


def as_toml(data: Mapping[str, Any]) -> str:
    """The data of an experiment as a file. The methods come last, and the last of them at the end."""
    lines, listed, single = [], [], []
    for key, value in data.items():
        if key in ("environment", "method"):
            for table in value:
                listed += ["", f"[[{key}]]", *_toml_lines(table)]
        elif isinstance(value, Mapping):
            single += ["", f"[{key}]", *_toml_lines(value)]
        else:
            lines += _toml_lines({key: value})
    return "\n".join([*lines, *single, *listed]) + "\n"


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What is not the same in the data of two experiments, a line for each."""
    lines = []
    for key in keys(Experiment):
        before, after = old.get(key), new.get(key)
        if key not in ("environment", "method"):
            lines += change(key, before, after)
            continue
        before, after = ({table["label"]: table for table in data[key]} for data in (old, new))
        lines += [f"{key} {label} is gone" for label in before if label not in after]
        lines += [f"{key} {label} is new" for label in after if label not in before]
        both = [label for label in after if label in before]
        if both != [label for label in before if label in after]:
            lines.append(f"{key}: the order is another one")
        for label in both:
            for name in before[label] | after[label]:
                lines += change(f"{key} {label}: {name}", before[label].get(name), after[label].get(name))
    return lines


def change(what: str, before: Any, after: Any) -> list[str]:
    """That something is not what it was, in a line; none where it is."""
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


def _canonical(data: Any) -> str:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _without(table: Mapping[str, Any], keys: Collection[str]) -> dict[str, Any]:
    return {key: x for key, x in table.items() if key not in keys}


def _toml_lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(_toml_lines(value)) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)  # of these TOML's form is JSON's


def source_of(path: str | Path, pinned: Mapping[str, Mapping[str, Any]] | None = None) -> Source:
    """The text of a file of an experiment; see `Experiment.load` for the arguments, and for what is raised."""
    path = as_path("the file of an experiment", path)
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{one_line(str(path))} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{one_line(str(path))} is not UTF-8 text") from None
    if len(content) > MOST_BYTES:
        raise InputError(
            f"{one_line(str(path))} is larger than {memory.words(MOST_BYTES)}: that is not an experiment"
        )
    return Source(path, text.replace("\r\n", "\n"), pinned or {})


def read_source(source: Source) -> dict[str, Any]:
    """What the file says. Raises InputError, with the line, where it is no TOML or nested beyond reason."""
    statements = split_statements(source)
    try:
        return tomllib.loads(source.text)
    except tomllib.TOMLDecodeError as error:
        what, _, place = str(error).partition(" (at ")
        numbered = re.match(r"line (\d+)", place)  # if not, it is the end: something was left open
        line = numbered[1] if numbered else statements[-1].line
        raise InputError(f"{source}, line {line}: {one_line(what[0].lower() + what[1:])}") from None
    except ValueError:
        raise InputError(f"{source}: a whole number has more digits than Python reads") from None
