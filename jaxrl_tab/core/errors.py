"""What is said to a person who gave something wrong, and the checks that need nothing but the value.

Neither NumPy nor JAX is imported: what is typed on the command line is refused before that.
"""

import copy
import difflib
import operator
import os
import reprlib
import sys
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any, Self


class InputError(ValueError):
    """Something that the user gave is wrong; the message is one line that says what would be right.

    Attributes:
        problem: the message without the name at its beginning.
        who: what refuses the value, a class or an option; None where the message names neither.
        field: the field, or parameter, that is wrong; None where it is not one.
        wanted: what the field takes, in words; None where it is not the value alone that is wrong.
        value: what was given instead.
        path: the keys and the positions in lists that lead to the value in the tables of an experiment.
    """

    def __init__(
        self,
        problem: str,
        *,
        who: str | None = None,
        field: str | None = None,
        wanted: str | None = None,
        value: Any = None,
    ):
        super().__init__(problem)
        self.problem, self.who, self.field, self.wanted, self.value = problem, who, field, wanted, value
        self.path: tuple[str | int, ...] = ()

    def __str__(self) -> str:
        return self.problem if self.who is None else f"{self.who}: {self.problem}"

    def renamed(self, who: str | None, field: str | None = None) -> Self:
        """The same error under the name `who`; as an error about a part of its `field`, if one is given."""
        error = copy.copy(self)
        error.who = who
        if field is not None:
            error.field, error.problem = field, f"{field}: {self.problem}"
        return error


def unfit(who: str | None, field: str, wanted: str, value: Any, hint: str = "") -> InputError:
    """The error where `field` of `who` must be `wanted`, and is `value`; a `hint` is added to the message."""
    problem = f"{field} must be {wanted}, not {shown(value)}{hint}"
    return InputError(problem, who=who, field=field, wanted=wanted, value=value)


class RunError(RuntimeError):
    """A valid request that could not be completed here; the message is one line that says why."""


_SHORT = reprlib.Repr()

_SHORT.maxstring = _SHORT.maxother = 60

SHOWN = 120  # characters of a value, at most


def shown(value: Any) -> str:
    """`value` as a message names it: in one short line, whatever it is."""
    if getattr(value, "ndim", 0) and (array := _array_in_words(value)):
        return array
    try:
        return one_line(_SHORT.repr(value))
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return f"a number of more than {sys.get_int_max_str_digits()} digits"


def _array_in_words(value: Any) -> str | None:
    """How a message names an array with axes; None where `value` is not one."""
    import jax  # here, for where the libraries of arrays were not imported nobody has an array
    import numpy as np
    from jax.core import Tracer

    if not isinstance(value, np.ndarray | jax.Array):
        return None
    if value.ndim > 1 or isinstance(value, Tracer):
        return f"an array of shape {value.shape}"
    return one_line(np.array2string(np.asarray(value[:9]), max_line_width=1000, threshold=8))


def one_line(text: str) -> str:
    """`text` in one line that is not long: the end is cut off where it would be."""
    line = " ".join(text.split())
    return line if len(line) <= SHOWN else line[: SHOWN - 4] + " ..."


def reason(error: BaseException) -> str:
    """What an error says, in one line; the name of its class where it says nothing."""
    return one_line(getattr(error, "strerror", None) or str(error)) or type(error).__name__


MOST_LISTED, FEW_LISTED = 16, 8  # names in a message


def nearest(name: Any, names: Iterable[str], otherwise: str = "") -> str:
    """Returns "did you mean 'x'?" for the name most like `name`, or one that begins so.

    Where there is none it is `otherwise`, by default all `names` to choose from.
    """
    names, name = list(names), (name if isinstance(name, str) else "").lower().replace("_", "-")
    begins = [x for x in names if name and x.startswith(name)]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5) or begins
    return f"did you mean '{close[0]}'?" if close else otherwise or f"choose one of {listed(names)}"


def listed(names: Iterable[str]) -> str:
    """All names, "a, b, c"; where they are more than a line holds the first ones, and where all are shown."""
    names = list(names)
    if len(names) <= MOST_LISTED:
        return ", ".join(names)
    return f"{', '.join(names[:FEW_LISTED])}, ... (`jaxrl-tab list` shows all {len(names)})"


def check_choice(name: str | None, what: str, value: Any, choices: Iterable[str]) -> None:
    """Raises InputError unless `value` is one of the texts in `choices`; the message names the nearest."""
    if not isinstance(value, str) or value not in choices:
        problem = f"{what} {shown(value)} is unknown; {nearest(value, choices)}"
        wanted = f"one of {', '.join(choices)}"
        raise InputError(problem, who=name, field=what, wanted=wanted, value=value)


def is_whole(value: Any, least: int = 1) -> bool:
    """Whether `value` is a whole number, `least` to 2**31 - 1; True and False are not."""
    return isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) < 2**31


def whole(name: str | None, what: str, value: Any, least: int = 1) -> int:
    """`value` as an int. Raises InputError unless it `is_whole`."""
    if not is_whole(value, least):
        too_large = " and below 2**31" if isinstance(value, Integral) and int(value) >= 2**31 else ""
        raise unfit(name, what, f"a whole number of at least {least}{too_large}", value)
    return int(value)


def as_path(what: str, value: Any) -> Path:
    """`value` as a path. Raises InputError unless it is one that the system can be asked for."""
    try:
        can_be_one = isinstance(value, str | os.PathLike) and b"\0" not in os.fsencode(value)
    except UnicodeEncodeError:
        can_be_one = False
    if not can_be_one:
        raise InputError(f"{what} must be named by a text, or a Path, not {shown(value)}")
    return Path(value)


# --- limits of numbers (see `pytree.field`) ------------------------------------------------------------
LIMITS = {
    "at_least": ("at least", operator.ge),
    "greater_than": ("greater than", operator.gt),
    "at_most": ("at most", operator.le),
    "less_than": ("less than", operator.lt),
}


def in_words(limits: Mapping[str, float]) -> str:
    """What the limits of a field say: "between 0 and 1", "greater than 0"; empty where there are none."""
    if limits.keys() == {"at_least", "at_most"}:
        if limits["at_least"] == limits["at_most"]:
            return f"exactly {limits['at_least']}"
        return f"between {limits['at_least']} and {limits['at_most']}"
    return " and ".join(f"{words} {limits[name]}" for name, (words, _) in LIMITS.items() if name in limits)
