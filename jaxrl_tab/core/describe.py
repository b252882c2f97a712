"""What an environment or a method says about itself: its parameters, from its fields.

`value` makes a parameter of what a person writes for it: of a number, or a text such as "softmax:0.5".
"""

import contextlib
import dataclasses
import inspect
import os
import sys
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from fractions import Fraction
from numbers import Integral, Real
from pathlib import Path
from typing import Any, NamedTuple

from jaxrl_tab.core import clock, policies, schedules
from jaxrl_tab.core.checks import explained, is_list
from jaxrl_tab.core.errors import InputError, one_line, reason, shown

Plain = bool | int | float | str | list | tuple | None  # of a parameter that another library checks

Lines = str | os.PathLike[str] | Sequence[str] | Mapping[str, Any]
"""Of a parameter that is text in lines: a list or a text of them, a file (.txt), or a table, as its class reads it."""


class Parameter(NamedTuple):
    """A field of an environment or a method.

    Attributes:
        name: of the field.
        type: its annotation, as written.
        default: its value if it is not given; `dataclasses.MISSING` where it must be.
        help: what it is and what it takes, in one line.
        limits: those that the field gives to a number; None where it checks nothing.
    """

    name: str
    type: Any
    default: Any
    help: str
    limits: Mapping[str, float] | None = None


def summary(cls: type) -> str:
    """The first line of the docstring of `cls`."""
    return inspect.cleandoc(cls.__doc__ or "").partition("\n")[0]


def parameters(cls: type) -> list[Parameter]:
    """The parameters of a registered class, in their order."""
    types: dict[str, Any] = {}
    if any(isinstance(f.type, str) for f in dataclasses.fields(cls)):  # from __future__ import annotations
        with contextlib.suppress(Exception):  # what they name need not be there
            types = typing.get_type_hints(cls)
    return [
        Parameter(f.name, types.get(f.name, f.type), f.default, explained(f), f.metadata.get("limits"))
        for f in dataclasses.fields(cls)
    ]


def takes_schedule(parameter: Parameter) -> bool:
    """Whether it may be a schedule instead of a number."""
    return parameter.type == clock.Rate


def takes_policy(parameter: Parameter) -> bool:
    """Whether it is a policy."""
    return parameter.type == policies.Policy | None


def kind(parameter: Parameter) -> type:
    """The type in which its value, or each entry of its value, is written; a policy is written as text."""
    if parameter.type == Lines:
        return str
    if takes_schedule(parameter) or takes_policy(parameter):
        return float if takes_schedule(parameter) else str
    empty = isinstance(parameter.default, tuple) and not parameter.default
    if parameter.default is MISSING or parameter.default is None or empty:  # its annotation says it
        named = [x for x in (parameter.type, *typing.get_args(parameter.type)) if x in _KINDS]
        return named[0] if named else float
    entry = parameter.default
    while isinstance(entry, tuple):
        entry = entry[0] if entry else 0.0
    return type(entry)


def value(what: str, written: Any, parameter: Parameter) -> Any:
    """`written` as a value of a parameter, or as an entry of one that is a tuple.

    Args:
        what: what the person calls the parameter.
        written: a number, a switch or a text, as it is typed: "glie", "softmax:0.5"; schedules and policies
            stay as they are.
        parameter: which parameter it is for.

    Raises:
        InputError: it is of the wrong type, or a text that means nothing.
    """
    if parameter.type == Plain:
        return written
    rate, policy = takes_schedule(parameter), takes_policy(parameter)
    try:
        if policy:
            return written if isinstance(written, policies.Policy) else policies.parse(written)
        if rate and isinstance(written, str):
            written = schedules.read(written)
    except InputError as error:
        raise error.renamed(what) from None
    if rate and isinstance(written, clock.Schedule):
        return written
    wanted, fits = _KINDS[kind(parameter)]
    wrong = not isinstance(written, fits) or (isinstance(written, bool) and fits is not bool)
    if wrong or (isinstance(written, int | Fraction) and abs(written) > sys.float_info.max):
        wanted += f" or a schedule ({schedules.forms()})" if rate else ""
        problem = f"{what} takes {wanted}, not {shown(written)}"
        raise InputError(problem, field=what, wanted=wanted, value=written)
    return kind(parameter)(written)


def lines_of(written: Any) -> list[Any] | None:
    """The lines that `written` has as a text or a list; None where it is neither."""
    written = os.fspath(written) if isinstance(written, os.PathLike) else written
    return written.splitlines() if isinstance(written, str) else list(written) if is_list(written) else None


def read_lines(written: Any, base: Path | None = None) -> Any:
    """The lines of a file where `written` is its name, that ends in .txt, alone or in a list; else `written`.

    Args:
        written: what a person gives for `Lines`.
        base: the folder from which the name starts; by default that of the process.

    Raises:
        InputError: the file cannot be read.
    """
    words = lines_of(written) or []
    if len(words) != 1 or not isinstance(words[0], str) or not words[0].endswith(".txt"):
        return written
    try:
        return ((base or Path()) / words[0]).read_text("utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{one_line(words[0])} cannot be read: {reason(error)}") from None


_KINDS: dict[type, tuple[str, type]] = {
    bool: ("true or false", bool),
    int: ("a whole number", Integral),
    float: ("a number", Real),
    str: ("text", str),
    Path: ("the name of a file", str),
}
