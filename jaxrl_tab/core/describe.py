"""What an environment or a method says about itself: its parameters, from its fields.

And what a person may give for one of them: a number, or text such as "glie" and "softmax:0.5".
"""

import contextlib
import dataclasses
import inspect
import sys
import typing
from fractions import Fraction
from numbers import Integral, Real
from typing import Any, NamedTuple

from jaxrl_tab.core import clock, policies, schedules
from jaxrl_tab.core.checks import InputError, explained, shown

Plain = bool | int | float | str | list | tuple | None  # of a parameter that another library checks


class Parameter(NamedTuple):
    """A field of an environment or a method.

    Attributes:
        name: of the field.
        type: its annotation, as written.
        default: its value if it is not given; `dataclasses.MISSING` where it must be.
        help: what it is and what it takes, in one line.
    """

    name: str
    type: Any
    default: Any
    help: str


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
        Parameter(f.name, types.get(f.name, f.type), f.default, explained(f)) for f in dataclasses.fields(cls)
    ]


def takes_schedule(parameter: Parameter) -> bool:
    """Whether it may be a schedule instead of a number."""
    return parameter.type == clock.Rate


def takes_policy(parameter: Parameter) -> bool:
    """Whether it is a policy."""
    return parameter.type == policies.Policy | None


def kind(parameter: Parameter) -> type:
    """The type of its value, or of the entries of its value: that of its default; float for a schedule."""
    if takes_schedule(parameter):
        return float
    if parameter.default is dataclasses.MISSING:  # it must be given
        return parameter.type if parameter.type in _KINDS else float
    entry = parameter.default
    while isinstance(entry, tuple):
        entry = entry[0] if entry else 0.0
    return type(entry)


def value(what: str, given: Any, parameter: Parameter) -> Any:
    """`given` as a value of a parameter, or as an entry of one that is a tuple.

    Args:
        what: what the person calls the parameter.
        given: a number, a switch or a text, as it is typed: "glie", "softmax:0.5"; schedules and policies
            stay as they are.
        parameter: which parameter it is for.

    Raises:
        InputError: it is of the wrong type, or a text that means nothing.
    """
    if parameter.type == Plain:
        return given
    rate, policy = takes_schedule(parameter), takes_policy(parameter)
    try:
        if policy:
            return given if isinstance(given, policies.Policy) else policies.parse(given)
        if rate and isinstance(given, str):
            given = schedules.read(given)
    except InputError as error:
        raise error.renamed(what) from None
    if rate and isinstance(given, clock.Schedule):
        return given
    wanted, fits = _KINDS[kind(parameter)]
    wrong = not isinstance(given, fits) or (isinstance(given, bool) and fits is not bool)
    if wrong or (isinstance(given, int | Fraction) and abs(given) > sys.float_info.max):
        wanted += f" or a schedule ({schedules.forms()})" if rate else ""
        problem = f"{what} takes {wanted}, not {shown(given)}"
        raise InputError(problem, field=what, wanted=wanted, value=given)
    return kind(parameter)(given)


_KINDS: dict[type, tuple[str, type]] = {
    bool: ("true or false", bool),
    int: ("a whole number", Integral),
    float: ("a number", Real),
    str: ("text", str),
}
