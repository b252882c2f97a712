"""From what a person wrote in an experiment to environments, methods and values."""

import dataclasses
import itertools
import json
import math
import re
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from jaxrl_tab.core import describe, names, policies
from jaxrl_tab.core.checks import build, repeated
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import InputError, listed, nearest, shown
from jaxrl_tab.core.pytree import checked_dataclass, field, static
from jaxrl_tab.engine import axes
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.budget import RECORDER
from jaxrl_tab.engine.sweep import configurations
from jaxrl_tab.envs import ENVIRONMENT
from jaxrl_tab.experiment import tasks
from jaxrl_tab.experiment.instances import is_array, made, table_of
from jaxrl_tab.experiment.places import Source, at, blame
from jaxrl_tab.experiment.plain import as_lists, as_plain, depth_of
from jaxrl_tab.methods import METHOD

LONGEST_LABEL = 200  # characters
ABOUT = ("name", "label", "sha256")  # in a table, beside parameters; the last is the checksum of its file
References = dict[str, names.Reference]  # what names stand for, as they were typed and as they are recorded


@checked_dataclass
class Selection:
    """How the best setting of each method is chosen, to be run again on seeds that had no part in the choice.

    Attributes:
        by: "score": the mean return of the last tenth, of prediction the error (see `stats.score`).
        fresh_seeds: how many seeds it is then run on. They have a root of their own (see `part.Part`), so no
            other sweep has them, be it ever so large.
    """

    by: Literal["score"] = static("score")
    fresh_seeds: int = field(default=100, at_least=1)


@checked_dataclass
class UntilDecided:
    """How methods are compared on as many fresh seeds as it takes (see `stats.until_decided`).

    The first look is at the `fresh_seeds` of the selection.

    Attributes:
        difference: of mean scores, the size that matters: two methods that are surely apart by less are the same; with
            0 only which one is better is asked.
        most_seeds: what is not decided by so many seeds is left open.
        all_settings: compare every setting of every method with all others, and not the best one of each method alone.
    """

    difference: float = field(default=0.0, at_least=0)
    most_seeds: int = field(default=2000, at_least=2)
    all_settings: bool = field(default=False)


def environments(written: Any, source: Source | None, references: References) -> list[dict[str, Any]]:
    """The plain data of each environment: one for each combination of what is listed."""
    resolved, places = [], []
    for i, table in enumerate(_tables("environment", written, ENVIRONMENT, source, references)):
        with at("environment", i):
            base = source.path.parent if source else None
            several = _environment(table, references[table["name"]].cls, len(resolved), base)
            resolved += several
            places += [i] * len(several)
    _check_labels("environment", resolved, places)
    return resolved


def _environment(table: Mapping[str, Any], cls: type, others: int, base: Path | None) -> list[dict[str, Any]]:
    """The environments that a table describes.

    Args:
        table: it.
        cls: the class that it names.
        others: how many environments the tables before it describe.
        base: the folder from which the names of files start.
    """
    label, about = table["label"], {key: table[key] for key in ABOUT if key in table}
    parameters = {p.name: p for p in describe.parameters(cls)}
    of_runs, rest = tasks.split(table, cls)
    tried = {}
    for key, written in _own(rest, parameters).items():
        with at(key):
            if parameters[key].type == describe.Lines:
                tried[key] = _texts(key, written, base)
            else:
                tried[key] = _values_of_environment(key, written, parameters[key])
    resolved = []
    axes.check_settings(others + math.prod(map(len, tried.values())), "the environments")
    for point in itertools.product(*tried.values()):
        values = dict(zip(tried, point, strict=True))
        with blame(values):
            made(cls, label, values)
        own = [f"{key}={_short(value, tried[key])}" for key, value in values.items() if len(tried[key]) > 1]
        data = {key: values.get(key, as_lists(p.default)) for key, p in parameters.items()}
        data = {key: value for key, value in data.items() if value is not None}
        resolved.append(about | {"label": ",".join([label, *own])} | of_runs | data)
    return resolved


def _texts(key: str, written: Any, base: Path | None) -> list[Any]:
    """What is to be tried of a parameter that is text in lines: a list of lines is one text, one of lists several."""
    several = isinstance(written, list | tuple) and any(not isinstance(x, str) for x in written)
    tried = list(written) if several else [written]
    if wrong := [x for x in tried if not isinstance(x, str | list | tuple | Mapping)]:
        raise InputError(
            f"{key} takes a text, a list of lines, or a list of such lists, not {shown(wrong[0])}"
        )
    texts = [as_lists(describe.read_lines(x, base)) for x in tried]
    if repeated(texts):
        raise InputError(f"the grid of {key} holds one text more than once")
    return texts


def _short(value: Any, tried: Sequence[Any]) -> str:
    """One of the values that are tried, as it can stand in the name of a folder; of several lines their number."""
    lines = [x for x in value if isinstance(x, str)] if isinstance(value, list) else []
    if isinstance(value, Mapping) or lines:
        return lines[0] if len(lines) == 1 else str(tried.index(value) + 1)
    return re.sub(r'[" ]', "", json.dumps(value))


def _values_of_environment(key: str, written: Any, parameter: describe.Parameter) -> list[Any]:
    """The values of a parameter of an environment that are to be tried."""
    if is_array(written):
        return [written]
    written = axis(key, written)
    if isinstance(written, axes.Random):
        raise InputError(f"{key}: an environment can have grids, but nothing random")
    written = as_lists(written.values() if isinstance(written, axes.Grid) else written)
    depth = _depth_of_value(parameter)
    if parameter.type == describe.Plain and parameter.default is None:
        return [written]  # a list may be meant as one
    tried = written if depth_of(written) == depth + 1 else [written]
    if any(depth_of(x) != depth for x in tried):
        what = "a list, or a list of lists" if depth else "a value, or a list"
        raise InputError(f"{key} takes {what} to be tried one by one, not {shown(written)}")
    values = [_deep(x, lambda entry: describe.value(key, entry, parameter)) for x in tried]
    if not values:
        raise InputError(f"the grid of {key} is empty")
    if again := repeated(values):
        raise InputError(f"the grid of {key} holds {shown(again[0])} more than once")
    return values


def _depth_of_value(parameter: describe.Parameter) -> int:
    """How deeply lists are nested in a value of a parameter."""
    if parameter.default is dataclasses.MISSING:
        return 1 if typing.get_origin(parameter.type) is tuple else 0
    return depth_of(parameter.default) if isinstance(parameter.default, tuple) else 0


def _deep(value: Any, change: Callable[[Any], Any]) -> Any:
    """Nested lists with `change` applied to each entry."""
    return [_deep(x, change) for x in value] if isinstance(value, list) else change(value)


def methods(
    written: Any, source: Source | None, references: References, seed: int, environments: int
) -> list[dict[str, Any]]:
    """The plain data of each method."""
    tables = _tables("method", written, METHOD, source, references)
    classes = [references[table["name"]].cls for table in tables]
    by_kind: dict[bool, str] = {}  # whether the values of states are learned
    for i, (table, cls) in enumerate(zip(tables, classes, strict=True)):
        with at("method", i):
            by_kind.setdefault(of_method(cls).learns is Learns.STATES, table["name"])
            if len(by_kind) == 2:
                raise InputError(
                    f"{by_kind[True]} learns the values of a policy, and {by_kind[False]} a "
                    "policy, which cannot be compared; sweep methods of prediction and of control apart"
                )
    grids, settings = [], 0
    for i, (table, cls) in enumerate(zip(tables, classes, strict=True)):
        with at("method", i):
            grids.append(grid_of(table, cls, seed))
            settings += math.prod(len(x) for x in grids[-1].values() if isinstance(x, list))
            times = f" in {environments:,} environments" if environments > 1 else ""
            axes.check_settings(settings * environments, f"the methods{times}")
    _check_labels("method", tables, range(len(tables)))
    resolved = []
    for i, (table, cls, grid) in enumerate(zip(tables, classes, grids, strict=True)):
        with at("method", i):
            resolved.append(_method(table, cls, grid))
    return resolved


def _method(table: Mapping[str, Any], cls: type, grid: Mapping[str, Any]) -> dict[str, Any]:
    with blame(table):
        _, configs = configurations(cls, grid)
    data = {key: table[key] for key in ABOUT if key in table}
    together = [name for trial in grid.get(DRAW, [])[:1] for name in trial]
    for key in [*(key for key in keys(cls) if key not in together), *([DRAW] if together else [])]:
        with at(key):
            value = grid[key] if key in grid else getattr(configs[0], key)
            data |= {} if value is None else {key: as_plain(key, value)}
    return data


def grid_of(table: Mapping[str, Any], cls: type, seed: int) -> dict[str, Any]:
    """The grid of a method, as `sweep` takes it, in the order of the class; what is random is drawn."""
    parameters = {p.name: p for p in describe.parameters(cls)}
    own = _own(table, parameters, "draws", DRAW)
    written = {}
    for key, x in own.items():
        with at(key):
            written[key] = axis(key, x)
    with at("draws"):
        grid = axes.spread(written, written.pop("draws", None), seed, table["label"])
    trials = grid.pop(DRAW, [])
    with at(DRAW):
        drawn = {name: [trial[name] for trial in trials] for name in (trials[0] if trials else {})}
        drawn = _own({"label": table["label"], **drawn}, parameters)
    for key, x in grid.items():
        with at(key):
            p = parameters[key]
            several = depth_of(x) > 0 and not (_takes_table(p) and depth_of(x) == 2)
            grid[key] = [_value(key, y, p) for y in x] if several else _value(key, x, p)
    for key, x in drawn.items():
        with at(key if key in own else DRAW):
            drawn[key] = [_value(key, y, parameters[key]) for y in x]
    if drawn:
        grid[DRAW] = [dict(zip(drawn, values, strict=True)) for values in zip(*drawn.values(), strict=True)]
    return grid


def _tables(
    key: str, written: Any, kind: names.Kind, source: Source | None, references: References
) -> list[dict[str, Any]]:
    """What is written for `key`, as tables with a name, a label, and the checksum of its file where there is one.

    What the names stand for is added to `references`.
    """
    several = isinstance(written, Sequence) and not isinstance(written, str)
    tables = []
    with at(key):
        axes.check_settings(len(written) if several else 1, f"so many tables [[{key}]]")
    for i, table in enumerate(written if several else [written]):
        with at(key, i):
            if not isinstance(table, Mapping | str | type) and not dataclasses.is_dataclass(table):
                raise InputError(
                    f"{key} must be a name, a class, an instance, or a table with one of them as its name, not "
                    f"{shown(table)}"
                )
            table = dict(table) if isinstance(table, Mapping) else {"name": table}
            if "name" not in table:
                raise InputError(f"the {key} has no name: one of {listed(kind.registry)}")
            with at("name"):
                if dataclasses.is_dataclass(table["name"]) and not isinstance(table["name"], type):
                    table = table_of(kind, table["name"]) | {k: x for k, x in table.items() if k != "name"}
                reference = _find(kind, table, source, references)
            with at("label"):
                label = table.get("label", reference.label)
                _check_label(label)
            about = {"name": reference.name, "label": label}
            about |= {"sha256": reference.file.sha256} if reference.file else {}
            tables.append({**table, **about})
    if not tables:
        with at(key):
            raise InputError(f"there is no {key}: name one or more of {listed(kind.registry)}")
    return tables


def _find(
    kind: names.Kind, table: Mapping[str, Any], source: Source | None, references: References
) -> names.Reference:
    """What the name of a table stands for, which is added to `references`."""
    name, sha256 = table["name"], table.get("sha256")
    pinned = source.pinned.get(name) if source and isinstance(name, str) else None
    if pinned:
        reference = names.find(kind, pinned["name"], None, pinned["sha256"])._replace(label=pinned["label"])
    else:
        reference = names.find(kind, name, source.path.parent if source else None, sha256)
    for spelling in (name, reference.name) if isinstance(name, str) else (reference.name,):
        if references.setdefault(spelling, reference).file != reference.file:
            raise InputError(f"{spelling} is named twice, and its file was changed in between")
    return reference


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


def belongs(key: Any) -> str | None:
    """Which kind of table has a parameter that was written outside of any, as a hint."""
    for table, kind in (("method", METHOD), ("environment", ENVIRONMENT)):
        if any(key in keys(cls) for cls in kind.registry.values()):
            return f"write it below a [[{table}]] that has it"
    return None


def _own(
    table: Mapping[str, Any], parameters: Mapping[str, describe.Parameter], *more: str
) -> dict[str, Any]:
    """The parameters of a table, and keys that may be there besides, in the order of the class."""
    allowed = [*parameters, *more]
    for key in table:
        if key not in (*ABOUT, *allowed):
            with at(key):
                from jaxrl_tab.experiment.spec import Experiment  # which is made from what is resolved here

                hint = nearest(key, parameters)
                if key in keys(Experiment):
                    hint = "it is of the whole experiment: write it above the first table"
                raise InputError(f"{table['label']} has no parameter {shown(key)}; {hint}")
    return {key: table[key] for key in allowed if key in table}


def axis(key: str, written: Any) -> Any:
    """What is written; as a grid in steps or a distribution where it is a dict, {"log": [0.01, 1], "points": 5}."""
    if not isinstance(written, Mapping):
        return written
    kinds = [name for name in written if name in axes.WRITTEN]
    if len(kinds) != 1:
        choices = ", ".join(axes.WRITTEN)
        hint = nearest(next(iter(written)), axes.WRITTEN) if written and not kinds else f"one of {choices}"
        raise InputError(f"{key}: {shown(dict(written))} is not a way to give values to try; {hint}")
    (kind,) = kinds
    cls, ends = axes.WRITTEN[kind], written[kind]
    more = {name: x for name, x in written.items() if name != kind}
    if wrong := [name for name in more if name != "points"]:
        raise InputError(f"{key}: {kind} has no {shown(wrong[0])}; {nearest(wrong[0], ['points'])}")
    if issubclass(cls, axes.Grid) and not more:
        raise InputError(f"{key}: say how many points, {{{kind} = [0.1, 1], points = 5}}")
    if cls is axes.Choice:
        own = {"values": ends}
    elif isinstance(ends, Sequence) and not isinstance(ends, str) and len(ends) == 2:
        own = {"low": ends[0], "high": ends[1]}
    else:
        raise InputError(f"{key}: {kind} must be the two ends, such as [0.1, 1], not {shown(ends)}")
    try:
        return build(cls, kind, more | own)
    except InputError as error:
        raise error.renamed(key) from None


def _value(key: str, written: Any, parameter: describe.Parameter) -> Any:
    """`written` as a value of a hyperparameter."""
    if _takes_table(parameter) and depth_of(written) == 2:
        return policies.Table(as_lists(written))
    if _only_table(parameter):
        if isinstance(written, policies.Table):
            return written
        raise InputError(f"{key} takes probabilities, a list for each state, not {shown(written)}")
    return describe.value(key, written, parameter)


def _takes_table(parameter: describe.Parameter) -> bool:
    return describe.takes_policy(parameter) or _only_table(parameter)


def _only_table(parameter: describe.Parameter) -> bool:
    is_text = parameter.type == str | None
    return parameter.default is None and not is_text and not describe.takes_policy(parameter)


def recorder(record: Any, source: Source | None, references: References) -> dict[str, Any]:
    """The plain data of a recorder: the name of the function, and the checksum of its file."""
    table = dict(record) if isinstance(record, Mapping) else {"name": record}
    if "name" not in table or table.keys() - {"name", "sha256"}:
        raise InputError(f"record must be a function, or its name, not {shown(record)}")
    reference = _find(RECORDER, table, source, references)
    return {"name": reference.name} | ({"sha256": reference.file.sha256} if reference.file else {})


def selection(written: Any, seeds: int) -> dict[str, Any]:
    """The plain data of how the best settings are chosen; by default they are run on `seeds` fresh seeds."""
    if isinstance(written, Selection):
        return dataclasses.asdict(written)
    if not isinstance(written, Mapping):
        raise InputError(f"select must be a table of {', '.join(keys(Selection))}, not {shown(written)}")
    with blame(written):
        return dataclasses.asdict(build(Selection, "select", {"fresh_seeds": seeds, **written}))


def comparison(written: Any, methods: int, fresh_seeds: int) -> dict[str, Any]:
    """The plain data of how many `methods` are compared; True, or the difference that matters, is enough."""
    if isinstance(written, UntilDecided):
        written = dataclasses.asdict(written)
    if written is True or isinstance(written, int | float):
        written = {} if written is True else {"difference": written}
    if not isinstance(written, Mapping):
        wanted = f"true, the difference that matters, or a table of {', '.join(keys(UntilDecided))}"
        raise InputError(f"until_decided must be {wanted}, not {shown(written)}")
    with blame(written):
        one = build(UntilDecided, "until_decided", dict(written))
    if fresh_seeds < 2:
        raise InputError("until_decided: the first look takes two fresh seeds or more, not 1")
    if one.most_seeds < fresh_seeds:
        raise InputError(
            f"until_decided: most_seeds must be at least the {fresh_seeds} fresh seeds of the first look, not "
            f"{one.most_seeds}"
        )
    if methods < 2 and not one.all_settings:
        raise InputError(
            "until_decided: name two methods or more to compare, or set all_settings, which compares all of their "
            "settings"
        )
    return dataclasses.asdict(one) | {"difference": float(one.difference)}


def keys(cls: type) -> list[str]:
    """The fields that are data."""
    return [field.name for field in dataclasses.fields(cls) if field.compare]
