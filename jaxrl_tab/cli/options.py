"""From the fields of classes to command-line options, and from what was typed back to values.

The options of a command are the fields of its class; those of environments, methods and executors are the
parameters of theirs. A parameter `max_steps` is the option `--max-steps`, a switch `stochastic` is
`--stochastic`, and one that is on by default is `--no-...`. The options of all entries of a registry stand side
by side in one parser; which of them the chosen entry has is checked afterwards, so the error can say who has
what.
"""

import argparse
import contextlib
import dataclasses
import inspect
import re
import shutil
import textwrap
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core import describe, names, policies, schedules
from jaxrl_tab.core.checks import InputError, build, but_none, nearest, one_line, shown

Typed = dict[str, tuple[str, ...]]
"""The options that were typed, each with its words; none for a switch."""
PAIRS = Mapping[str, Any]  # the type of a parameter that is typed as KEY=VALUE ...
FILE = str | Path | None  # the type of a parameter that names a file
METAVARS = {int: "N", float: "X", str: "X", Path: "DIR", FILE: "FILE", PAIRS: "KEY=VALUE"}


class Group(NamedTuple):
    """Options for the parameters of the classes of a registry.

    Attributes:
        registry: name -> class.
        help: what they are, one line.
        kind: of the classes, where they can come from outside.
        grids: whether every option takes any number of values, to be tried one by one.
        defaults: parameter -> values, instead of the one number that the classes have.
        parts: what people call parts of the registry -> the names in it.
        spelled: parameter -> what it is called on the command line, where that is not its name.
    """

    registry: Mapping[str, type]
    help: str
    kind: names.Kind | None = None
    grids: bool = False
    defaults: Mapping[str, tuple[Any, ...]] = MappingProxyType({})
    parts: Mapping[str, Collection[str]] = MappingProxyType({})
    spelled: Mapping[str, str] = MappingProxyType({})

    def options(self, name: str) -> dict[str, describe.Parameter]:
        """The options of an entry of the registry, with the parameters that they are for."""
        owned = parameters(self.registry[name])
        return {option_of(p._replace(name=self.spelled.get(p.name, p.name))): p for p in owned}

    def default(self, parameter: describe.Parameter) -> Any:
        """The value of a parameter that is not given; a tuple of several where they make a grid."""
        is_number = isinstance(parameter.default, int | float)
        return self.defaults.get(parameter.name, parameter.default) if is_number else parameter.default

    def owners(self, names: Sequence[str]) -> str:
        """Names of the registry in few words: the name of a part instead of all that are in it."""
        remaining, in_words = list(names), []
        for part, members in self.parts.items():
            if set(members) <= set(remaining):
                in_words.append(part)
                remaining = [name for name in remaining if name not in members]
        return ", ".join(in_words + remaining)


def word(metavar: str, many: bool = False) -> Any:
    """A field of a command that is not an option: a word, or any number of words, in its place."""
    return dataclasses.field(default=() if many else "", metadata={"metavar": metavar})


def parse(command: type, argv: Sequence[str], **groups: Group) -> tuple[Any, dict[str, Typed]]:
    """An instance of the class `command` from `argv`, and for each group the options that were typed.

    What was typed for the command itself is there as well, under "options".

    Raises:
        InputError: `argv` cannot be understood, or a value of the command's own is wrong.
        SystemExit: help was asked for, and printed.
    """
    name = command.__name__.lower()
    own = {"options": Group({name: command}, "")}
    parser, flags = _parser(name, command, own | groups)
    # As people type them: --log_every=10 is --log-every 10.
    spelled = [re.sub("^--[^=]*", lambda flag: flag[0].replace("_", "-"), word) for word in argv]
    try:
        namespace, rest = parser.parse_known_intermixed_args(spelled)
    except argparse.ArgumentError as error:
        raise InputError(f"{error.argument_name}: {one_line(error.message)}") from None
    if "--help" in namespace:
        print(parser.format_help(), end="")
        raise SystemExit(0)
    for unknown in rest:
        if not unknown.startswith("-"):
            raise InputError(f"unexpected argument {shown(unknown)}")
        hint = nearest(unknown.partition("=")[0], [flag for of_group in flags.values() for flag in of_group])
        raise InputError(f"there is no option {one_line(unknown)}; {hint}")
    read = vars(namespace)
    as_words = lambda x: (x,) if isinstance(x, str) else tuple(x or ())
    typed = {
        group: {flag: as_words(read[flag]) for flag in of_group if flag in read}
        for group, of_group in flags.items()
    }
    places = {key: tuple(x) if isinstance(x, list) else x for key, x in read.items() if "-" not in key}
    return build(command, name, places | values_of(name, typed["options"], own["options"])), typed


class _Help(argparse.RawDescriptionHelpFormatter):
    """Help in which names such as q-learning are not broken at their hyphens."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(text, width, break_on_hyphens=False)


def _parser(
    name: str, command: type, groups: Mapping[str, Group]
) -> tuple[argparse.ArgumentParser, dict[str, list[str]]]:
    """The parser of a command, and the options of each group. Whatever is typed stays text, in words."""
    places = [f for f in dataclasses.fields(command) if "metavar" in f.metadata]
    parser = argparse.ArgumentParser(
        prog=f"jaxrl-tab {name}",
        usage=" ".join(["%(prog)s [OPTIONS]", *(f.metadata["metavar"] for f in places)]),
        description=inspect.cleandoc(command.__doc__ or "").partition("\n\nAttributes:")[0],
        formatter_class=_Help,
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
        exit_on_error=False,
        add_help=False,  # which would hide that its reader has gone away
    )
    parser.add_argument("-h", "--help", dest="--help", action="store_true", help="Show this text, and stop.")
    # A word such as -1e5 or -inf is a value. argparse itself would take only -1 and -0.5 for numbers.
    parser._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)")
    for f in places:
        count = "*" if f.default == () else "?"
        parser.add_argument(f.name, nargs=count, metavar=f.metadata["metavar"], help=f.metadata.get("help"))
    width = max(40, shutil.get_terminal_size().columns - 4)
    flags: dict[str, list[str]] = {}
    for title, group in groups.items():
        about_it = textwrap.fill(about(group), width, break_on_hyphens=False)
        section = parser.add_argument_group(title, about_it) if group.help else parser
        owners: dict[str, dict[str, describe.Parameter]] = {}
        for entry in group.registry:
            for option, parameter in group.options(entry).items():
                owners.setdefault(option, {})[entry] = parameter
        for option, owned in owners.items():
            try:
                section.add_argument(option, dest=option, **_argument(owned, group))
            except argparse.ArgumentError:
                raise InputError(
                    f"{group.owners(list(owned))} cannot have {option} on the command line, where it means "
                    "something else: set it in a file"
                ) from None
        flags[title] = list(owners)
    return parser, flags


def _argument(owned: Mapping[str, describe.Parameter], group: Group) -> dict[str, Any]:
    """How argparse takes an option that these entries have."""
    parameter = next(iter(owned.values()))
    help = " ".join(filter(None, [parameter.help, _hint(owned, group)])).replace("%", "%%")
    if _is_switch(parameter):
        return {"action": "store_const", "const": (), "help": help}
    count = {"nargs": "+"} if group.grids or _is_several(parameter) else {}
    return count | {"metavar": METAVARS.get(but_none(parameter.type), "X"), "help": help}


def _hint(owned: Mapping[str, describe.Parameter], group: Group) -> str:
    """Whose parameter it is where not all have it, and its defaults: the most usual first."""
    notes = [] if len(owned) == len(group.registry) else [f"of {group.owners(list(owned))}"]
    entries: dict[str, list[str]] = {}
    for entry, parameter in owned.items():
        default = "" if _is_switch(parameter) else words(group.default(parameter))
        entries.setdefault(default, []).append(entry)
    usual, *others = sorted(entries, key=lambda default: -len(entries[default]))
    if usual not in ("", words(None)):
        notes += [f"default: {usual}", *(f"{other} for {group.owners(entries[other])}" for other in others)]
    return f"({'; '.join(notes)})" if notes else ""


def values(names: Sequence[str], typed: Typed, group: Group) -> dict[str, dict[str, list[Any]]]:
    """For each of these entries of a registry the parameters that are not left alone, with their values.

    An option goes to all of them that have it.

    Raises:
        InputError: none of them has such a parameter, or what was typed is of the wrong kind.
    """
    options = {name: group.options(name) for name in names}
    for option in typed:
        if not any(option in of_entry for of_entry in options.values()):
            owners = [other for other in group.registry if option in group.options(other)]
            who, *others = names
            has_no = f"none of {', '.join(names)} has" if others else f"{who} has no"
            hint = "" if others or not options[who] else f"; {who} has {', '.join(options[who])}"
            raise InputError(f"{has_no} {option}, which belongs to {group.owners(owners)}{hint}")
    return {name: _values(of_entry, typed, group) for name, of_entry in options.items()}


def values_of(name: str, typed: Typed, group: Group) -> dict[str, Any]:
    """The parameters of one entry of a registry that were typed, each with its value."""
    types = {p.name: p for p in parameters(group.registry[name])}
    return {
        key: dict(x) if types[key].type == PAIRS else tuple(x) if _is_several(types[key]) else x[0]
        for key, x in values([name], typed, group)[name].items()
    }


def _values(options: Mapping[str, describe.Parameter], typed: Typed, group: Group) -> dict[str, list[Any]]:
    chosen = {p.name: list(group.default(p)) for p in options.values() if group.default(p) is not p.default}
    for option in typed:
        if parameter := options.get(option):
            read = [_value(option, text, parameter) for text in typed[option]]
            chosen[parameter.name] = [not parameter.default] if _is_switch(parameter) else read
    return chosen


def _value(option: str, text: str, parameter: describe.Parameter) -> Any:
    """A text as a value of the kind that the parameter takes."""
    if parameter.type == describe.Plain:  # as in TOML; a text needs no quotes
        with contextlib.suppress(tomllib.TOMLDecodeError):
            return tomllib.loads(f"value = {text}")["value"]
        return text
    if parameter.type == PAIRS:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{option} takes KEY=VALUE, not {shown(text)}")
        return key, int(value) if value.isdecimal() and len(value) < 20 else value
    read: Any = text
    if (kind := describe.kind(parameter)) in (int, float):
        with contextlib.suppress(ValueError):
            read = kind(text)
    return describe.value(option, read, parameter)


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


def option_of(parameter: describe.Parameter) -> str:
    """How a parameter is given on the command line."""
    is_on = _is_switch(parameter) and parameter.default
    return f"--{'no-' if is_on else ''}{parameter.name.replace('_', '-')}"


def words(value: Any) -> str:
    """A value as it is typed; a dash where there is none."""
    if value is None or value is dataclasses.MISSING:
        return "–"
    if isinstance(value, bool | np.bool_):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return " ".join(words(x) for x in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def about(group: Group) -> str:
    """What the group is, and how a schedule and a policy are typed if some parameter takes one."""
    in_it = [p for cls in group.registry.values() for p in parameters(cls)]
    sentences = [group.help]
    if any(map(describe.takes_schedule, in_it)):
        sentences.append(f"A schedule is {schedules.forms()}.")
    if any(map(describe.takes_policy, in_it)):
        sentences.append(f"A policy is one of {', '.join(map(policies.form, policies.POLICIES))}.")
    return " ".join(sentences)


def _is_switch(parameter: describe.Parameter) -> bool:
    return isinstance(parameter.default, bool) and parameter.type != describe.Plain


def _is_several(parameter: describe.Parameter) -> bool:
    """Whether its value is made of several words."""
    return isinstance(parameter.default, tuple) or parameter.type == PAIRS
