"""From the parameters of registered classes to command-line options, and from what was typed back to values.

A parameter `max_steps` is the option `--max-steps`, a switch `stochastic` is `--stochastic`, and one that is
on by default is `--no-...`. Options of all entries of a registry stand side by side in one parser; which of
them the chosen entry has is checked afterwards, so the error can say who has what.
"""

import contextlib
import dataclasses
import inspect
import io
import itertools
import os
import re
import shutil
import tomllib
import typing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from jaxrl_tab.core import describe, memory, names, policies, schedules
from jaxrl_tab.core.checks import InputError, nearest, one_line, shown


class Group(NamedTuple):
    """Options for the parameters of the classes of a registry.

    Attributes:
        registry: name -> class.
        help: what they are, one line.
        kind: of the classes.
        grids: whether every option takes any number of values, to be tried one by one.
        defaults: parameter -> values, instead of the one number that the classes have.
        parts: what people call parts of the registry -> the names in it.
    """

    registry: Mapping[str, type]
    help: str
    kind: names.Kind
    grids: bool = False
    defaults: Mapping[str, tuple[Any, ...]] = MappingProxyType({})
    parts: Mapping[str, Collection[str]] = MappingProxyType({})

    def default(self, parameter: describe.Parameter) -> Any:
        """The value of a parameter that is not given; a tuple of several where they make a grid."""
        is_number = isinstance(parameter.default, int | float)
        return self.defaults.get(parameter.name, parameter.default) if is_number else parameter.default

    def owners(self, names: Sequence[str]) -> str:
        """Names of the registry in few words: the name of a part instead of all that are in it."""
        left, found = list(names), []
        for part, members in self.parts.items():
            if set(members) <= set(left):
                found.append(part)
                left = [name for name in left if name not in members]
        return ", ".join(found + left)


def whole(least: int) -> Any:
    """An annotation of an option that takes a whole number, from `least` to 2**31 - 1."""
    return _number(int, lambda x: least <= x < 2**31, "N", f"a whole number from {least} to {2**31 - 1}")


def real(low: float, high: float) -> Any:
    """An annotation of an option that takes a number between `low` and `high`."""
    return _number(float, lambda x: low <= x <= high, "X", f"a number between {low} and {high}")


def size() -> Any:
    """An annotation of an option that takes a number of bytes, such as 4GB."""
    return _option(int, memory.parse, "SIZE")


def word(metavar: str) -> Any:
    """An annotation of an option that takes any text as it is. (tyro takes None for an option not given.)"""
    return _option(str, str, metavar)


def place(metavar: str) -> Any:
    """An annotation of an option that takes a file or a folder."""
    return _option(Path, Path, metavar)


def _number(kind: type, fits: Callable[[Any], bool], metavar: str, wanted: str) -> Any:
    def read(token: str) -> Any:
        with contextlib.suppress(ValueError):
            if fits(value := kind(token)):
                return value
        raise ValueError(f"must be {wanted}, not {shown(token)}")

    return _option(kind, read, metavar)


def _option(kind: type, read: Callable[[str], Any], metavar: str) -> Any:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda tokens: read(tokens[0]),
        is_instance=lambda x: isinstance(x, kind),
        str_from_instance=lambda x: [str(x)],
    )


def _words(many: bool) -> Any:
    """An annotation of an option that takes one word, or any number."""
    return PrimitiveConstructorSpec(
        nargs="*" if many else 1,
        metavar="X ..." if many else "X",
        instance_from_str=tuple,
        is_instance=lambda x: x is None or isinstance(x, tuple),
        str_from_instance=lambda x: list(x or ()),
    )


NARROWEST = 40  # columns; in fewer than ten tyro looks for a place to break a line, and never ends


@contextlib.contextmanager
def _wide_enough() -> Iterator[None]:
    """Inside, the terminal is not said to be narrower than what tyro can write in."""
    before, columns = os.environ.get("COLUMNS"), shutil.get_terminal_size().columns
    os.environ["COLUMNS"] = str(max(NARROWEST, columns))
    try:
        yield
    finally:
        del os.environ["COLUMNS"]
        os.environ |= {} if before is None else {"COLUMNS": before}


def parse(prog: str, command: type, argv: Sequence[str], **groups: Group) -> Any:
    """An instance of the dataclass `command` from `argv`, with a dict of what was typed for each group.

    The dict has the options given, each with its tokens (an empty tuple for a switch).

    Raises:
        InputError: `argv` cannot be understood.
        SystemExit: help was asked for, and printed.
    """
    types = {name: _options(name, group) for name, group in groups.items()}
    whole = dataclasses.make_dataclass(
        command.__name__,
        [
            (name, Annotated[cls, arg(help=about(groups[name]))], dataclasses.field(default_factory=cls))
            for name, cls in types.items()
        ],
        bases=(command,),
    )
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint), _wide_enough():
            parsed, unknown = tyro.cli(
                whole,
                prog=prog,
                description=inspect.cleandoc(command.__doc__ or ""),
                args=argv,
                return_unknown_args=True,
                config=(OmitArgPrefixes,),
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        raise InputError(f"{one_line(_plain(complaint.getvalue()))} (see `{prog} --help`)") from None
    for token in unknown:
        if not token.startswith("-"):
            raise InputError(f"unexpected argument {shown(token)}")
        hints = [typing.get_type_hints(cls, include_extras=True) for cls in (command, *types.values())]
        known = [_spell(f) for h in hints for f, kind in h.items() if Positional not in _notes(kind)]
        raise InputError(f"there is no option {one_line(token)}; {nearest(token.partition('=')[0], known)}")
    for name, cls in types.items():
        values = {_spell(f.name): getattr(getattr(parsed, name), f.name) for f in dataclasses.fields(cls)}
        given = {option: value for option, value in values.items() if value not in (None, False)}
        setattr(parsed, name, {option: () if v is True else v for option, v in given.items()})
    return parsed


def values(
    names: Sequence[str], given: Mapping[str, tuple[str, ...]], group: Group
) -> dict[str, dict[str, list[Any]]]:
    """For each of these entries of a registry the parameters that are not left alone, with their values.

    An option goes to all of them that have it.

    Raises:
        InputError: none of them has such a parameter, or what was typed is of the wrong kind.
    """
    known = {name: {option_of(p): p for p in parameters(group.registry[name])} for name in names}
    for option in given:
        if not any(option in owned for owned in known.values()):
            owners = [other for other, cls in group.registry.items() if option in _spelled(cls)]
            who, *others = names
            has_no = f"none of {', '.join(names)} has" if others else f"{who} has no"
            hint = "" if others else f"; {who} has {', '.join(known[who])}"
            raise InputError(f"{has_no} {option}, which belongs to {group.owners(owners)}{hint}")
    return {name: _values(owned, given, group) for name, owned in known.items()}


def _values(
    known: Mapping[str, describe.Parameter], given: Mapping[str, tuple[str, ...]], group: Group
) -> dict[str, list[Any]]:
    found = {p.name: list(group.default(p)) for p in known.values() if group.default(p) is not p.default}
    for option, tokens in given.items():
        if (parameter := known.get(option)) is None:
            continue
        if _is_switch(parameter):
            found[parameter.name] = [not parameter.default]
        elif not tokens:
            raise InputError(f"{option} needs a value")
        else:
            found[parameter.name] = [_value(option, token, parameter) for token in tokens]
    return found


def parameters(cls: type) -> list[describe.Parameter]:
    """The parameters of a class that can be typed: all but tables, which have no default."""
    typed = lambda p: p.default is not None or describe.takes_policy(p) or p.type == describe.Plain
    return [p for p in describe.parameters(cls) if typed(p)]


def option_of(parameter: describe.Parameter) -> str:
    """How a parameter is given on the command line."""
    return _spell(_field(parameter))


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
    known = [p for cls in group.registry.values() for p in parameters(cls)]
    parts = [group.help]
    if any(map(describe.takes_schedule, known)):
        parts.append(f"A schedule is {schedules.forms()}.")
    if any(map(describe.takes_policy, known)):
        parts.append(f"A policy is one of {_policies()}.")
    return " ".join(parts)


def _policies() -> str:
    return ", ".join(map(policies.form, policies.POLICIES))


def _options(name: str, group: Group) -> type:
    """A dataclass with a field for each option of the group; None or False where it is not given."""
    owners: dict[str, dict[str, describe.Parameter]] = {}
    for entry, cls in group.registry.items():
        for parameter in parameters(cls):
            owners.setdefault(_field(parameter), {})[entry] = parameter
    fields = []
    for field, owned in owners.items():
        parameter = next(iter(owned.values()))
        hint = _hint(owned, group)
        if _is_switch(parameter):
            note = arg(help=parameter.help, help_behavior_hint=hint)
            fields.append((field, Annotated[bool, FlagCreatePairsOff, note], False))
        else:
            many = group.grids or isinstance(parameter.default, tuple)
            note = arg(help=parameter.help, help_behavior_hint=hint, metavar="X ..." if many else "X")
            fields.append((field, Annotated[tuple[str, ...] | None, _words(many), note], None))
    return dataclasses.make_dataclass(name, fields)


def _hint(owned: Mapping[str, describe.Parameter], group: Group) -> str:
    """Whose parameter it is where not all have it, and its defaults: the most usual first."""
    notes = [] if len(owned) == len(group.registry) else [f"of {group.owners(list(owned))}"]
    entries: dict[str, list[str]] = {}
    for entry, parameter in owned.items():
        entries.setdefault(words(group.default(parameter)), []).append(entry)
    usual, *others = sorted(entries, key=lambda default: -len(entries[default]))
    if usual != words(None):
        notes += [f"default: {usual}", *(f"{other} for {group.owners(entries[other])}" for other in others)]
    return f"({'; '.join(notes)})" if notes else ""


def _value(option: str, token: str, parameter: describe.Parameter) -> Any:
    """`token` as a value of the kind that the parameter's default is."""
    given: Any = token
    if parameter.type == describe.Plain:  # as in TOML; a text needs no quotes
        with contextlib.suppress(tomllib.TOMLDecodeError):
            given = tomllib.loads(f"value = {token}")["value"]
        return given
    if (kind := describe.kind(parameter)) in (int, float):
        with contextlib.suppress(ValueError):
            given = kind(token)
    return describe.value(option, given, parameter)


def _is_switch(parameter: describe.Parameter) -> bool:
    return isinstance(parameter.default, bool) and parameter.type != describe.Plain


def _field(parameter: describe.Parameter) -> str:
    return f"no_{parameter.name}" if _is_switch(parameter) and parameter.default else parameter.name


def _spell(field: str) -> str:
    return "--" + field.replace("_", "-")


def _spelled(cls: type) -> list[str]:
    return [option_of(p) for p in parameters(cls)]


def _notes(kind: Any) -> tuple[Any, ...]:
    return getattr(kind, "__metadata__", ())


def _plain(box: str) -> str:
    """The first paragraph below the title of one of tyro's error boxes, as one line."""
    lines = [line.strip("│ ") for line in re.sub(r"\x1b\[[\d;]*m", "", box).splitlines()[1:]]
    text = itertools.dropwhile(_is_rule, lines)
    paragraph = " ".join(itertools.takewhile(lambda line: not _is_rule(line), text))
    return re.sub(r"^Error parsing (\S+):", r"\1", paragraph)


def _is_rule(line: str) -> bool:
    return not line.strip("─-╰╯")  # which of them depends on the terminal
