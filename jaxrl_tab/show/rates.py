"""What a step size or an exploration rate comes to: its values and their sums, what the conditions say, a curve."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.families import SHORT, Family
from jaxrl_tab.core.schedules import is_glie, is_robbins_monro, read, typed

LONGEST = 10**6  # how far it is followed
COUNTS = tuple(10**k for k in range(7))  # the n at which people see its values
MARKS = "ox+*#%@&"  # of curves in a terminal, which is how many there can be
WIDE, NARROW, BESIDE = (
    10,
    5,
    9,
)  # characters of such a curve: of a power of ten, where there is room or not; beside it
LEAST = 1e-6  # the part of the largest value below which nothing is drawn
COUNTED = {
    "step": "steps",
    "episode": "episodes",
    "visit": "visits of the pair (s, a), or for ε of the state",
}


class Told(NamedTuple):
    """What can be said of a condition: whether it holds, None where nobody can tell, and why."""

    holds: bool | None
    why: str

    @property
    def answer(self) -> str:
        return {True: "yes", False: "no", None: "cannot be told"}[self.holds]


class Study(NamedTuple):
    """A step size or an exploration rate for n = 1 to 1,000,000, and what is known of all n.

    Attributes:
        name: how it is typed.
        formula: its value for n, in words.
        clock: what n counts; None for a number.
        values: for each n, float64 [1,000,000].
        sum_is_infinite, squares_are_infinite: whether the sum over all n is, of its values and of their squares; None
            where nobody can tell, for a function is no formula.
        glie: whether epsilon-greedy with it is greedy in the limit with infinite exploration.
        robbins_monro: whether it meets their conditions as a step size.
    """

    name: str
    formula: str
    clock: str | None
    values: np.ndarray
    sum_is_infinite: bool | None
    squares_are_infinite: bool | None
    glie: Told
    robbins_monro: Told

    @property
    def title(self) -> str:
        """What it is, in a line."""
        long = f" ({SHORT[self.name]})" if self.name in SHORT else ""
        counted = f"; n counts {COUNTED[self.clock]}" if self.clock else ""
        return f"{self.name}{long}: {self.formula}{counted}"

    @property
    def sums(self) -> str:
        """What the sums over all n are, in words."""
        if self.sum_is_infinite is None:
            return (
                "Over all n its sums cannot be told: no number of values of a function decides about a limit."
            )
        its, squares = (
            "infinite" if x else "finite" for x in (self.sum_is_infinite, self.squares_are_infinite)
        )
        return f"Over all n its sum is {its}, and that of its squares {squares}."

    def rows(self) -> dict[str, np.ndarray]:
        """At each of `COUNTS`: its value, the sum so far, and that of the squares; float64."""
        at = np.array(COUNTS) - 1
        return {
            "value": self.values[at],
            "sum so far": np.cumsum(self.values)[at],
            "sum of squares so far": np.cumsum(self.values**2)[at],
        }


def study(rate: Any) -> Study:
    """What there is to know of a number or a schedule, also as it is typed: "glie", "harmonic:100:visit", "0.1".

    Raises:
        InputError: it is neither, or a number below 0 or without end, or not one but several; or a function that is no
            number somewhere.
    """
    rate = read(rate) if isinstance(rate, str) else rate
    values, name = _values(rate), typed(rate) or str(rate)
    clock = getattr(rate, "clock", None)
    if is_function := clock is not None and not isinstance(rate, Family):
        formula, infinite, robbins_monro = "a function of n", (None, None), Told(None, "it is a function")
    else:
        order, formula = _known(rate)
        infinite, robbins_monro = (order <= 1, order <= 0.5), Told(*is_robbins_monro(rate))
    if values.max() > 1:
        glie = Told(None, f"it is no exploration rate, for its largest value is {values.max():g}")
    else:
        glie = robbins_monro if is_function else Told(*is_glie(rate))
    return Study(name, formula, clock, values, *infinite, glie, robbins_monro)


def _known(rate: Any) -> tuple[float, str]:
    """The power of 1/n that a number or a schedule of a named family falls with, as `Tail.order`, and its formula."""
    if isinstance(rate, Family):
        return float(rate.tail().order), rate.formula()
    return (0.0 if rate > 0 else math.inf), "the same for all n"


def _values(rate: Any) -> np.ndarray:
    """The value for each n = 1 to `LONGEST`, float64."""
    if not callable(rate):
        number = np.asarray(rate)
        if number.ndim or number.dtype.kind not in "iuf" or not 0 <= number < np.inf:
            raise InputError(
                f"a step size or an exploration rate is a number of at least 0, not {shown(rate)}"
            )
        return np.full(LONGEST, float(number))
    with jax.enable_x64():
        values = np.asarray(jax.vmap(rate)(jnp.arange(1, LONGEST + 1, dtype=jnp.int32)), np.float64)
    if not np.isfinite(values).all():
        n = int(np.isfinite(values).argmin()) + 1
        raise InputError(f"{rate} is no number at n = {n}, but {values[n - 1]}")
    return values


def curve(studies: Sequence[Study], room: int = 100) -> list[str]:
    """The values against n as lines of text, both axes logarithmic; values near 0 are left out.

    It is so wide that it fits into so many characters, where these are not too few.
    """
    largest = max(float(one.values.max()) for one in studies)
    if largest <= 0:
        return []
    decade = next((x for x in (WIDE, NARROW) if BESIDE + x * len(COUNTS) <= room), NARROW)
    width = decade * (len(COUNTS) - 1) + 1
    at = np.unique(np.round(10 ** (np.arange(width) / decade)).astype(int))
    columns = np.round(decade * np.log10(at)).astype(int)
    drawn = np.concatenate([one.values[at - 1] for one in studies])
    smallest = float(drawn[drawn >= LEAST * largest].min())
    top, bottom = int(np.ceil(np.log10(largest) - 1e-9)), int(np.floor(np.log10(smallest) + 1e-9))
    bottom = min(bottom, top - 1)
    rows = 4 if top - bottom <= 2 else 2  # to a power of ten
    marks = [[" "] * width for _ in range(rows * (top - bottom) + 1)]
    for one, mark in zip(studies, MARKS, strict=False):
        for column, value in zip(columns, one.values[at - 1], strict=True):
            if value >= LEAST * largest:
                row = round(rows * (top - np.log10(value)))
                if marks[row][column] == " ":
                    marks[row][column] = mark
    beside = max(len(f"{10.0**k:g}") for k in range(bottom, top + 1))
    names = [f"{10.0 ** (top - row // rows):g}" if row % rows == 0 else "" for row in range(len(marks))]
    lines = [f"{name:>{beside}} │{''.join(row)}".rstrip() for name, row in zip(names, marks, strict=True)]
    axis = "└" + "".join("┴" if column % decade == 0 else "─" for column in range(width))
    names = [f"{n:,}".replace(",", " ") if decade == WIDE else f"1e{k}" for k, n in enumerate(COUNTS)]
    below = "".join(f"{name:<{decade}}" for name in names)
    return [*lines, f"{'':{beside}} {axis}", f"{'':{beside}}  {below}".rstrip() + "  n"]
