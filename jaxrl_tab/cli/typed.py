"""From the fields of classes to what can be typed (`options`), and from what was typed back to values.

The options of a command are the fields of its class; those of environments, methods and executors are the
parameters of theirs.
"""

import contextlib
import dataclasses
import inspect
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, get_args, get_origin

import numpy as np

from jaxrl_tab.cli import options
from jaxrl_tab.cli.options import (
    NONE,
    Command,
    Entry,
    Group,
    Option,
    Place,
    Typed,
    check_owners,
    whole_number,
)
from jaxrl_tab.core import clock, describe, names, policies, schedules
from jaxrl_tab.core.checks import KINDS, build, but_none
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.optimizers import PREFIX
from jaxrl_tab.engine import axes
from jaxrl_tab.envs import drawing

PAIRS = Mapping[str, Any]  # the type of a parameter that is typed as KEY=VALUE ...
OPTIONAL = bool | float  # the type of a parameter that is on, and may have a number
FILE = str | Path | None  # the type of a parameter that names a file
RANGE = re.compile(r"([-+.\deE]+):([-+.\deE]+)(:log)?")  # such as 0.01:1:log
METAVARS = {
    int: "N",
    float: "X",
    str: "X",
    Path: "DIR",
    FILE: "FILE",
    PAIRS: "KEY=VALUE",
    OPTIONAL: "D",
    describe.Lines: "TEXT",
}


class Classes(NamedTuple):
    """A registry of classes whose parameters can be typed.

    Attributes:
        registry: name -> class.
        help: what their options are, one line.
        kind: of the classes, where they can come from outside.
        grids: whether every option takes any number of values, to be tried one by one.
        defaults: parameter -> values, instead of the one number that the classes have.
        parts: what people call parts of the registry -> the names in it.
        spelled: parameter -> what it is called on the command line, where that is not its name.
        noun: what one of them is called, with its article, where no kind says it.
        ranges: whether an option also takes a range from which values are drawn: 0.01:0.3, 0.01:1:log, of whole numbers
            1:8.
    """

    registry: Mapping[str, type]
    help: str
    kind: names.Kind | None = None
    grids: bool = False
    defaults: Mapping[str, tuple[Any, ...]] = MappingProxyType({})
    parts: Mapping[str, Collection[str]] = MappingProxyType({})
    spelled: Mapping[str, str] = MappingProxyType({})
    noun: str = ""
    ranges: bool = False

    @property
    def group(self) -> Group:
        """The same as data."""
        entries = {
            name: Entry(describe.summary(cls), self._options(cls)) for name, cls in self.registry.items()
        }
        noun, entry_points = (self.kind.noun, self.kind.group) if self.kind else (self.noun, "")
        parts = {part: tuple(members) for part, members in self.parts.items()}
        return Group(entries, about(self), noun, self.grids, parts, entry_points)

    def _options(self, cls: type) -> tuple[Option, ...]:
        return tuple(option_of(p, self.spelled.get(p.name, p.name), self.default(p)) for p in parameters(cls))

    def by_flag(self, name: str) -> dict[str, describe.Parameter]:
        """The options of an entry of the registry, with the parameters that they are for."""
        owned = parameters(self.registry[name])
        return {flag_of(p, self.spelled.get(p.name, p.name)): p for p in owned}

    def default(self, parameter: describe.Parameter) -> Any:
        """The value of a parameter that is not given; a tuple of several where they make a grid."""
        is_number = isinstance(parameter.default, int | float)
        return self.defaults.get(parameter.name, parameter.default) if is_number else parameter.default


def word(metavar: str, many: bool = False) -> Any:
    """A field of a command that is not an option: a word, or any number of words, in its place."""
    return dataclasses.field(default=() if many else "", metadata={"metavar": metavar})


def command_of(cls: type) -> Command:
    """The command that a class describes."""
    fields = [f for f in dataclasses.fields(cls) if "metavar" in f.metadata]
    return Command(
        cls.__name__.lower(),
        inspect.cleandoc(cls.__doc__ or "").partition("\n\nAttributes:")[0],
        [Place(f.name, f.metadata["metavar"], f.metadata.get("help", ""), f.default == ()) for f in fields],
        [option_of(p, p.name, p.default) for p in parameters(cls)],
    )


def parse(command: type, argv: Sequence[str], **classes: Classes) -> tuple[Any, dict[str, Typed]]:
    """An instance of the class `command` from `argv`, and the options that were typed: see `options.parse`.

    Raises:
        InputError: `argv` cannot be understood, or a value of the command's own is wrong.
        SystemExit: help was asked for, and printed.
    """
    described = command_of(command)
    groups = {name: registry.group for name, registry in classes.items()}
    places, typed = options.parse(described, argv, groups)
    own = values_of(described.name, typed["options"], Classes({described.name: command}, ""))
    return build(command, described.name, places | own), typed


def values(names: Sequence[str], typed: Typed, classes: Classes) -> dict[str, dict[str, list[Any]]]:
    """For each of these entries of a registry the parameters that are not left alone, with their values.

    An option goes to all of them that have it.

    Raises:
        InputError: none of them has such a parameter, or what was typed is of the wrong kind.
    """
    check_owners(names, typed, classes.group)
    return {name: _values(classes.by_flag(name), typed, classes) for name in names}


def values_of(name: str, typed: Typed, classes: Classes) -> dict[str, Any]:
    """The parameters of one entry of a registry that were typed, each with its value."""
    types = {p.name: p for p in parameters(classes.registry[name])}
    return {key: _one(types[key], x) for key, x in values([name], typed, classes)[name].items()}


def several_of(names: Sequence[str], typed: Typed, classes: Classes) -> list[dict[str, Any]]:
    """For each of these entries of a registry a table as in a file: its name, and the parameters that were typed.

    Each of them is a value, or a list of several. Several words for a text in lines are its lines, but where each names
    one, as "dyna" and "my.txt" do, texts.
    """
    given = values(names, typed, classes)
    return [{"name": name} | _several_of(name, given[name], classes) for name in names]


def _several_of(name: str, given: Mapping[str, list[Any]], classes: Classes) -> dict[str, Any]:
    types, found = {p.name: p for p in parameters(classes.registry[name])}, {}
    for key, words in given.items():
        if types[key].type == describe.Lines and len(words) > 1 and all(map(drawing.is_name, words)):
            found[key] = [[word] for word in words]
        elif len(words) < 2 or _is_several(types[key]):
            found[key] = _one(types[key], words)
        elif types[key].type == describe.Plain:
            raise InputError(
                f"{key} of {name} takes one value here; in a file there may be several environments"
            )
        else:
            found[key] = words
    return found


def _one(parameter: describe.Parameter, words: Sequence[Any]) -> Any:
    """The one value that words are, as they were read."""
    if parameter.type == PAIRS:
        return dict(words)
    return tuple(words) if _is_several(parameter) else words[0]


def _values(
    by_flag: Mapping[str, describe.Parameter], typed: Typed, classes: Classes
) -> dict[str, list[Any]]:
    chosen = {
        p.name: list(classes.default(p)) for p in by_flag.values() if classes.default(p) is not p.default
    }
    for flag in typed:
        if parameter := by_flag.get(flag):
            if classes.ranges and (one := _range(flag, typed[flag], parameter)):
                chosen[parameter.name] = [one]
                continue
            read = [_value(flag, text, parameter) for text in typed[flag]]
            chosen[parameter.name] = read or [not parameter.default]  # a switch, or what stands alone
    named = {by_flag[flag].name for flag in typed if flag in by_flag}
    if "alpha" not in named and any(str(x).startswith(PREFIX) for x in chosen.get("optimizer", ())):
        chosen.pop("alpha", None)  # the optimiser has a learning rate of its own
    return chosen


def _range(flag: str, texts: Sequence[str], parameter: describe.Parameter) -> axes.Random | None:
    """What was typed as a range from which values are drawn; None where it is none."""
    matches = [RANGE.fullmatch(text) for text in texts]
    if not any(matches):
        return None
    if len(texts) > 1:
        raise InputError(f"{flag}: a range stands alone, and here are {shown(' '.join(texts))}")
    assert matches[0]
    low, high, log = matches[0].groups()
    kind = describe.kind(parameter)
    if kind not in (int, float):
        raise InputError(f"{flag} takes no range of numbers, such as {texts[0]}")
    if kind is int and log:
        raise InputError(f"{flag} takes a range of whole numbers, such as 1:8, not {texts[0]}")
    cls: Any = axes.Integers if kind is int else axes.LogUniform if log else axes.Uniform
    read = whole_number if kind is int else float
    try:
        ends = [read(text) for text in (low, high)]
    except ValueError:
        raise InputError(
            f"{flag}: {texts[0]} is no range; it is typed 0.01:0.3, 0.01:1:log, or 1:8"
        ) from None
    options.check_words(flag, option_of(parameter, parameter.name, parameter.default), [low, high])
    try:
        return cls(*ends)
    except InputError as error:
        raise error.renamed(flag) from None


def _value(flag: str, text: str, parameter: describe.Parameter) -> Any:
    """A text as a value of the kind that the parameter takes."""
    if parameter.type == describe.Plain:  # as in TOML; a text needs no quotes
        with contextlib.suppress(tomllib.TOMLDecodeError):
            return tomllib.loads(f"value = {text}")["value"]
        return text
    if parameter.type == PAIRS:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{flag} takes KEY=VALUE, not {shown(text)}")
        return key, int(value) if value.isdecimal() and len(value) < 20 else value
    read: Any = text
    if parameter.type == OPTIONAL:
        options.check_words(flag, option_of(parameter, "", False), [text])
        return float(text)
    if (kind := describe.kind(parameter)) in (int, float):
        with contextlib.suppress(ValueError):
            read = (whole_number if kind is int else kind)(text)
    return describe.value(flag, read, parameter)


def parameters(cls: type) -> list[describe.Parameter]:
    """The parameters of a class that can be typed: all but tables, which have no default, and places of words."""
    typed = lambda p: (
        p.default is not None
        or describe.takes_policy(p)
        or p.type == describe.Plain
        or but_none(p.type) in METAVARS
    )
    places = {f.name for f in dataclasses.fields(cls) if "metavar" in f.metadata}
    return [p for p in describe.parameters(cls) if typed(p) and p.name not in places]


def option_of(parameter: describe.Parameter, spelled: str, default: Any) -> Option:
    """A parameter as it is typed, under this name and with this default."""
    switch, plain = _is_switch(parameter), parameter.type == describe.Plain
    own = but_none(parameter.type)
    takes, limits, choices = "", None, ()
    if not switch and not plain and parameter.type != PAIRS:
        is_rate = describe.takes_schedule(parameter)
        kind = float if own == OPTIONAL else describe.kind(parameter)
        takes = "rate" if is_rate else {int: "int", float: "float"}.get(kind, "")
        # A field of another type, as one that holds several numbers, is checked as a whole.
        limits = parameter.limits if own in (int, float, clock.Rate) and own in KINDS else None
        choices = get_args(parameter.type) if get_origin(parameter.type) is Literal else ()
    return Option(
        flag_of(parameter, spelled),
        parameter.name,
        parameter.help,
        words(default),
        "" if switch else METAVARS.get(own, "X"),
        _is_several(parameter),
        takes,
        limits,
        choices,
        own == OPTIONAL,
    )


def flag_of(parameter: describe.Parameter, spelled: str = "") -> str:
    """How a parameter is given on the command line."""
    is_on = _is_switch(parameter) and parameter.default
    return f"--{'no-' if is_on else ''}{(spelled or parameter.name).replace('_', '-')}"


def words(value: Any) -> str:
    """A value as it is typed; a dash where there is none."""
    if value is None or value is dataclasses.MISSING or (isinstance(value, tuple | str) and not value):
        return NONE
    if isinstance(value, bool | np.bool_):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return " ".join(words(x) for x in value)
    if isinstance(value, axes.Uniform):
        return f"{value.low:g}:{value.high:g}{':log' if value.logarithmic else ''}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def about(classes: Classes) -> str:
    """What the options are, and how a schedule and a policy are typed if some parameter takes one."""
    in_it = [p for cls in classes.registry.values() for p in parameters(cls)]
    sentences = [classes.help]
    if any(map(describe.takes_schedule, in_it)):
        sentences.append(f"A schedule is {schedules.forms()}.")
    if any(map(describe.takes_policy, in_it)):
        sentences.append(f"A policy is one of {', '.join(map(policies.form, policies.POLICIES))}.")
    return " ".join(sentences)


def _is_switch(parameter: describe.Parameter) -> bool:
    return isinstance(parameter.default, bool) and parameter.type not in (describe.Plain, OPTIONAL)


def _is_several(parameter: describe.Parameter) -> bool:
    """Whether its value is made of several words."""
    return isinstance(parameter.default, tuple) or parameter.type in (PAIRS, describe.Lines)
