"""From what a person wrote in an experiment to environments, methods and values."""

import contextlib
import dataclasses
import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxrl_tab.algorithms.prediction import METHODS
from jaxrl_tab.core import clock, describe, policies, schedules
from jaxrl_tab.core.checks import InputError, build, check_choice, is_whole, nearest, repeated, shown
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.engine import axes
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.sweep import configurations
from jaxrl_tab.envs import ENVS, instead
from jaxrl_tab.experiment.places import DEEPEST, at, blame

LONGEST_LABEL = 200  # characters


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
        with at("by"):
            check_choice("select", "by", self.by, CRITERIA)
        with at("fresh_seeds"):
            whole("fresh_seeds", self.fresh_seeds, 1)


CRITERIA = ("score",)


def environments(given: Any) -> list[dict[str, Any]]:
    """The plain data of each environment: one for each combination of what is listed."""
    found, places = [], []
    for i, table in enumerate(_tables("environment", given, ENVS)):
        with at("environment", i):
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
        with at(key):
            tried[key] = _values_of_environment(key, given, wanted[key])
    found = []
    axes.check_settings(others + math.prod(map(len, tried.values())), "the environments")
    for point in itertools.product(*tried.values()):
        values = dict(zip(tried, point, strict=True))
        with blame(values):
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


def methods(given: Any, seed: int, environments: int) -> list[dict[str, Any]]:
    """The plain data of each method."""
    tables = _tables("method", given, METHODS)
    by_kind: dict[Learns, str] = {}
    for i, table in enumerate(tables):
        with at("method", i):
            by_kind.setdefault(of_method(METHODS[table["name"]]).learns, table["name"])
            if len(by_kind) == 2:
                raise InputError(
                    f"{by_kind[Learns.STATES]} learns the values of a policy, and {by_kind[Learns.ACTIONS]} a "
                    "policy, which cannot be compared; sweep methods of prediction and of control apart"
                )
    grids, settings = [], 0
    for i, table in enumerate(tables):
        with at("method", i):
            grids.append(grid_of(table, seed))
            settings += math.prod(len(x) for x in grids[-1].values() if isinstance(x, list))
            times = f" in {environments:,} environments" if environments > 1 else ""
            axes.check_settings(settings * environments, f"the methods{times}")
    _check_labels("method", tables, range(len(tables)))
    found = []
    for i, (table, grid) in enumerate(zip(tables, grids, strict=True)):
        with at("method", i):
            found.append(_method(table, grid))
    return found


def _method(table: Mapping[str, Any], grid: Mapping[str, Any]) -> dict[str, Any]:
    cls = METHODS[table["name"]]
    with blame(table):
        _, configs = configurations(cls, grid)
    data = {"name": table["name"], "label": table["label"]}
    together = [name for trial in grid.get(DRAW, [])[:1] for name in trial]
    for key in [*(key for key in keys(cls) if key not in together), *([DRAW] if together else [])]:
        with at(key):
            value = grid[key] if key in grid else getattr(configs[0], key)
            data |= {} if value is None else {key: _plain(key, value)}
    return data


def grid_of(table: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The grid of a method, as `sweep` takes it, in the order of the class; what is random is drawn."""
    wanted = {p.name: p for p in describe.parameters(METHODS[table["name"]])}
    own = _own(table, wanted, "draws", DRAW)
    given = {}
    for key, x in own.items():
        with at(key):
            given[key] = _axis(key, x)
    with at("draws"):
        grid = axes.spread(given, given.pop("draws", None), seed, table["label"])
    trials = grid.pop(DRAW, [])
    with at(DRAW):
        drawn = {name: [trial[name] for trial in trials] for name in (trials[0] if trials else {})}
        drawn = _own({"label": table["label"], **drawn}, wanted)
    for key, x in grid.items():
        with at(key):
            several = _depth(x) > 0 and not (_takes_table(wanted[key]) and _depth(x) == 2)
            grid[key] = [_value(key, y, wanted[key]) for y in x] if several else _value(key, x, wanted[key])
    for key, x in drawn.items():
        with at(key if key in own else DRAW):
            drawn[key] = [_value(key, y, wanted[key]) for y in x]
    if drawn:
        grid[DRAW] = [dict(zip(drawn, values, strict=True)) for values in zip(*drawn.values(), strict=True)]
    return grid


def _tables(kind: str, given: Any, registry: Mapping[str, type]) -> list[dict[str, Any]]:
    """What is given for the key `kind`, as tables with a name that is known and a label."""
    several = isinstance(given, Sequence) and not isinstance(given, str)
    found = []
    with at(kind):
        axes.check_settings(len(given) if several else 1, f"so many tables [[{kind}]]")
    for i, table in enumerate(given if several else [given]):
        with at(kind, i):
            table = {"name": table} if isinstance(table, str) else table
            if not isinstance(table, Mapping):
                raise InputError(f"{kind} must be a name, or tables with a name each, not {shown(table)}")
            if "name" not in table:
                raise InputError(f"the {kind} has no name: one of {', '.join(registry)}")
            with at("name"):
                name = table["name"]
                if not isinstance(name, str) or name not in registry:
                    if registry is ENVS:
                        raise InputError(f"{shown(name)} is not an environment; {instead(name)}")
                    raise InputError(f"{shown(name)} is not a method; {nearest(name, registry)}")
            with at("label"):
                label = table.get("label", name)
                _check_label(label)
            found.append({**table, "name": name, "label": label})
    if not found:
        with at(kind):
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
        with at(kind, i):
            _check_label(label)  # also where it is made of the values of a grid
            if first.setdefault(label, i) != i:
                raise InputError(f"the {kind} {label} is named more than once: give each a label of its own")


def belongs(key: str) -> str | None:
    """Below what a parameter belongs that was not written in a table."""
    for kind, registry in (("method", METHODS), ("environment", ENVS)):
        if any(key in keys(cls) for cls in registry.values()):
            return f"write it below a [[{kind}]] that has it"
    return None


def _own(table: Mapping[str, Any], wanted: Mapping[str, describe.Parameter], *more: str) -> dict[str, Any]:
    """The parameters of a table, and keys that may be there besides, in the order of the class."""
    known = [*wanted, *more]
    for key in table:
        if key not in ("name", "label", *known):
            with at(key):
                from jaxrl_tab.experiment.spec import Experiment  # which is made from what is resolved here

                hint = nearest(key, wanted)
                if key in keys(Experiment):
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


def whole(name: str, value: Any, least: int) -> int:
    if not is_whole(value, least):
        raise InputError(
            f"{name} must be a whole number of at least {least} and below 2**31, not {shown(value)}"
        )
    return int(value)


def selection(given: Any, seeds: int) -> dict[str, Any]:
    if isinstance(given, Selection):
        return dataclasses.asdict(given)
    if not isinstance(given, Mapping):
        raise InputError(f"select must be a table of {', '.join(keys(Selection))}, not {shown(given)}")
    for key in given:
        with at(key):
            if key not in keys(Selection):
                raise InputError(f"select has no {shown(key)}; {nearest(key, keys(Selection))}")
    return dataclasses.asdict(Selection(**{"fresh_seeds": seeds, **given}))


def keys(cls: type) -> list[str]:
    return [field.name for field in dataclasses.fields(cls) if field.name != "source"]
