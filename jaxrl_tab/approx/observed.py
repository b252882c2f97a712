"""What all features of a state have in common: their range, and how they become those of the states of a task.

Features are the numbers of which approximate values are a linear function (book, section 9.5; `features` has them).
Called with what is observed of a state, they give what `linear` reads and changes values by: the few features that are
1 where all others are 0, or all n of them.

What is observed of a state are the numbers that it is; in a grid its row and its column; and else, where states are
counted, the number of the state (`declared.OfEnvironment`). They lie in a range, which the environment knows, and from
which features are made: `fitted` fills it in. Where states are counted, `fitted` also works out the features of all of
them, once, in float64.
"""

import dataclasses
import functools
import hashlib
import math
from numbers import Real
from typing import Any, ClassVar, Literal, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrl_tab.core import tables
from jaxrl_tab.core.checks import as_array, assign, is_list
from jaxrl_tab.core.declared import name_of, of_environment
from jaxrl_tab.core.errors import InputError, is_whole, unfit
from jaxrl_tab.core.linear import Active, X
from jaxrl_tab.core.pytree import checked_dataclass, static

MOST = 2**24  # features: more are surely a mistake
RANGE = "of each number that is observed; by default those of the environment."
OF_RANGE = ("low", "high", "outside")


class Features:
    """What all features share.

    A class says how many there are (`size`), what they are (`__call__`), and how many are 1 at once where the others
    are 0 (`active`).
    """

    name: ClassVar[str]
    active: int | None = None  # of features that are all numbers there is no such count
    needs_range: bool = True

    @property
    def size(self) -> int:
        """n, how many features there are."""
        raise NotImplementedError

    def __call__(self, observed: Float[Array, " d"]) -> X:
        """x(s), from what is observed of s."""
        raise NotImplementedError

    @property
    def unit(self) -> Float[np.ndarray, " n"] | None:
        """Weights with which the value of every state is 1; None where none are known."""
        return np.full(self.size, 1 / self.active) if self.active else None

    @property
    def nowhere(self) -> X:
        """x(s) of no state in particular."""
        return self(jnp.zeros(len(getattr(self, "low", None) or (0,)), float))

    def fitted(self, env: Any) -> "Features":
        """These features, of the states of an environment.

        Raises:
            InputError: they are not features of what is observed there.
        """
        own = self.ranged(*observed_range(env)) if self.needs_range else self
        if own.size > MOST:
            problem = f"{self} are {own.size:,} features, and at most {MOST:,} are possible: take fewer along a number"
            raise InputError(problem, who=type(self).__name__)
        return Rows.of(own, env) if env.num_states else own

    def ranged(self, low: tuple[float, ...], high: tuple[float, ...]) -> Self:
        """The same, with the range of what is observed where none was given.

        Raises:
            InputError: a range was given that does not fit this one.
        """
        own: Any = self
        who = type(self).__name__
        given = {"low": own.low or low, "high": own.high or high}
        for name, least in given.items():
            if len(least) != len(low):
                problem = f"{name} are {len(least)} numbers, and {len(low)} are observed of a state"
                raise InputError(problem, who=who, field=name)
            if (i := next((i for i, x in enumerate(least) if not math.isfinite(x)), None)) is not None:
                problem = f"number {i} of what is observed of a state has no bounds: give {name}, and outside='clip'"
                raise InputError(problem, who=who, field=name)
        for i, (a, b) in enumerate(zip(given["low"], given["high"], strict=True)):
            if a == b:
                problem = (
                    f"number {i} of what is observed of a state is always {a:g}: give low and high around it"
                )
                raise InputError(problem, who=who, field="low")
        if own.outside == "error":
            for i, (a, b, least, most) in enumerate(zip(given["low"], given["high"], low, high, strict=True)):
                if least < a or most > b:
                    raise InputError(
                        f"number {i} of what is observed of a state is between {least:g} and {most:g}, and the range "
                        f"that was given is {a:g} to {b:g}: give a larger one, or outside='clip'",
                        who=who,
                        field="low" if least < a else "high",
                    )
        return dataclasses.replace(own, **given)

    def __str__(self) -> str:
        """As it is typed: its own numbers, and of its range what was given."""
        fields: Any = dataclasses.fields(self)  # pyright: ignore[reportArgumentType]
        own = [_plain(getattr(self, f.name)) for f in fields if f.name not in OF_RANGE]
        given = [(f.name, getattr(self, f.name)) for f in fields if f.name in OF_RANGE]
        words = own + [f"{name}={_plain(x)}" for name, x in given if x not in (None, "error")]
        return f"{self.name}({', '.join(words)})" if words else self.name


def _plain(x: Any) -> str:
    """A number, or a tuple of them, as it is typed."""
    return repr(x[0] if isinstance(x, tuple) and len(x) == 1 else x).replace(", ", ",")


def observed_range(env: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The least and the largest that each observed number may be."""
    declared = of_environment(env)
    if declared.low is not None and declared.high is not None:
        return tuple(map(float, declared.low)), tuple(map(float, declared.high))
    return (0.0,), (float(env.num_states - 1),)


def observations(env: Any) -> Float[np.ndarray, "S d"]:
    """What is observed of each state of a task whose states are counted, float64 [S, d]."""
    states = np.arange(env.num_states)
    if (observe := of_environment(env).observation) is None:
        return states[:, None].astype(float)
    with jax.ensure_compile_time_eval(), jax.enable_x64():
        return np.asarray(jax.vmap(observe)(jnp.asarray(states, jnp.int32)), float)


def check_tuple(obj: Any, name: str, wanted: str, least: int | None = None) -> None:
    """Keeps a field as a tuple of floats; or of whole numbers, where they must be at least `least`."""
    if (value := getattr(obj, name)) is None:
        return
    items = list(value) if is_list(value) or isinstance(value, np.ndarray) else [value]

    def fits(x: Any) -> bool:
        return is_whole(x, least) if least is not None else isinstance(x, Real) and math.isfinite(x)

    if not items or not all(map(fits, items)):
        raise unfit(type(obj).__name__, name, wanted, value)
    assign(obj, **{name: tuple(map(float if least is None else int, items))})


@checked_dataclass
class Ranged(Features):
    """Features of numbers in a range."""

    low: tuple[float, ...] | float | None = static(default=None, kw_only=True, help=f"The least {RANGE}")
    high: tuple[float, ...] | float | None = static(default=None, kw_only=True, help=f"The largest {RANGE}")
    outside: Literal["error", "clip"] = static(
        default="error",
        kw_only=True,
        help="What is done with states outside: they are refused, or moved to an end.",
    )

    def __post_init__(self):
        for name in ("low", "high"):
            check_tuple(self, name, "finite numbers")
        low: Any = self.low  # a tuple now, where it is given
        high: Any = self.high
        if low and high:
            who = type(self).__name__
            if len(low) != len(high):
                problem = f"low are {len(low)} numbers, and high are {len(high)}"
                raise InputError(problem, who=who, field="high")
            for i, (a, b) in enumerate(zip(low, high, strict=True)):
                if a >= b:
                    problem = f"high must be above low, and number {i} is {b:g}, not above {a:g}"
                    raise InputError(problem, who=who, field="high")

    @property
    def ends(self) -> list[tuple[float, float]]:
        """The least and the largest of each number."""
        low: Any = self.low
        high: Any = self.high
        if low is None or high is None:
            problem = "which numbers are observed is not known: give low and high"
            raise InputError(problem, who=type(self).__name__)
        return list(zip(low, high, strict=True))

    @property
    def dimensions(self) -> int:
        """d, how many numbers are observed."""
        return len(self.ends)

    def scaled(self, observed: Any) -> list[Any]:
        """Each number, moved so that its range is [0, 1]; one outside is moved to the end of it."""
        # Rounding may carry a number over an end, so all are clipped.
        return [jnp.clip((observed[i] - a) * (1 / (b - a)), 0, 1) for i, (a, b) in enumerate(self.ends)]


class Rows(Features):
    """The features of every state of a task whose states are counted, worked out beforehand.

    Attributes:
        numbers: all features of all states, float64 [S, n]; or, where a few are 1 and the others 0, which these are,
            int32 [S, k].
        size: n, how many features there are.
        active: k; None where all features are given.
    """

    needs_range = False

    def __init__(self, numbers: Any, size: int | None = None, made_of: Features | None = None):
        given = as_array(numbers)
        if given is None or given.ndim != 2 or given.dtype.kind not in "biuf" or not given.size:
            raise unfit("Rows", "numbers", "features of all states, numbers in rows of equal length", numbers)
        with np.errstate(over="ignore"):
            held = given.astype(jax.dtypes.canonicalize_dtype(float)) if size is None else given
        if not np.isfinite(held).all():
            raise unfit("Rows", "numbers", f"features that are finite in {held.dtype}", numbers)
        self.numbers = np.array(given, float if size is None else np.int32)
        self.numbers.flags.writeable = False
        self.active = None if size is None else given.shape[1]
        self._size = given.shape[1] if size is None else size
        self._made_of = made_of
        # All of them, for a program that is kept has this name: other features are another program.
        self._digest = hashlib.sha256(f"{given.shape} {size}".encode() + self.numbers.tobytes()).hexdigest()

    @classmethod
    def of(cls, features: Features, env: Any) -> "Rows":
        """The features of the states of a task."""
        observed = observations(env)
        return _worked_out(features, observed.tobytes(), observed.shape)

    @property
    def size(self) -> int:
        return self._size

    @property
    def matrix(self) -> Float[np.ndarray, "S n"]:
        """All features of all states, float64 [S, n]."""
        if self.active is None:
            return self.numbers
        matrix = np.zeros((len(self.numbers), self.size))
        np.put_along_axis(matrix, self.numbers, 1.0, 1)
        return matrix

    @property
    def unit(self) -> Float[np.ndarray, " n"] | None:
        return super().unit if self.active or self._made_of is None else self._made_of.unit

    def fitted(self, env: Any) -> Features:
        if not env.num_states:
            problem = f"they are given state by state, and those of {name_of(env)} cannot be counted"
            raise InputError(problem, who="Rows", field="numbers")
        if len(self.numbers) != env.num_states:
            problem = f"features of {len(self.numbers)} states were given, and the task has {env.num_states}"
            raise InputError(problem, who="Rows", field="numbers")
        return self

    @property
    def nowhere(self) -> X:
        return self(jnp.int32(0))

    def __call__(self, observed: Any) -> X:
        """x(s) from the number of a state."""
        if self.active is None:
            return tables.row(jnp.asarray(self.numbers, float), observed)
        ones = tables.row(jnp.asarray(self.numbers), observed)
        return ones[0] if self.active == 1 else Active(ones)

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Rows) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def __str__(self) -> str:
        shape = "x".join(map(str, self.numbers.shape))
        return f"rows {shape}:{self._digest[:8]}" if self._made_of is None else str(self._made_of)

    def __repr__(self) -> str:
        return f"Rows({self}, {self._digest})"


@functools.lru_cache(maxsize=64)  # a sweep has the same in all settings but those of its features
def _worked_out(features: Features, observed: bytes, shape: tuple[int, int]) -> Rows:
    """The features of states, from what is observed of each, float64 [S, d] as bytes."""
    with jax.ensure_compile_time_eval(), jax.enable_x64():
        rows = jax.vmap(features)(jnp.asarray(np.frombuffer(observed).reshape(shape)))
        if isinstance(rows, Active):
            return Rows(np.asarray(rows.ones), features.size, features)
        rows = np.asarray(rows)
        return Rows(rows[:, None], features.size, features) if rows.ndim == 1 else Rows(rows, None, features)
