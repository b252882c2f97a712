"""Features of a state: the numbers of which approximate values are a linear function (book, section 9.5).

Each is a frozen object, given as it is or as text: `TileCoding(8, 8)`, "tile-coding(8, 8)". Sweeps, files and results
have the text. Several together are written with a plus between them: "fourier(3) + tile-coding(8, 8)".
"""

import dataclasses
import inspect
import itertools
import math
import re
from collections.abc import Sequence
from functools import reduce
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.approx.observed import MOST, Features, Ranged, Rows, check_tuple
from jaxrl_tab.core.checks import assign, is_list
from jaxrl_tab.core.declared import name_of, of_environment
from jaxrl_tab.core.errors import InputError, nearest, reason, shown, unfit
from jaxrl_tab.core.linear import Active, X, all_of
from jaxrl_tab.core.optax import read_call
from jaxrl_tab.core.pytree import checked_dataclass, static

ROUNDING = 1e-9  # parts of a range: as little as no two states are apart


@checked_dataclass
class OneHot(Features):
    """The table itself: a feature for each state, which is 1 there and 0 elsewhere."""

    name = "one-hot"

    active = 1
    needs_range = False

    def fitted(self, env: Any) -> Features:
        if not env.num_states:
            raise InputError(
                f"the states of {name_of(env)} cannot be counted: take other features, such as tile-coding",
                who=type(self).__name__,
            )
        return self

    def __call__(self, observed: Any) -> X:
        """The number of a state stands for its features."""
        return observed

    @property
    def unit(self) -> Float[np.ndarray, " 1"]:
        return np.ones(1)  # as many as there are states, which the method is told

    @property
    def nowhere(self) -> X:
        return jnp.int32(0)


@checked_dataclass
class Observation(Ranged):
    """The numbers that are observed themselves, each scaled to [-1, 1]; none of them is 1 everywhere."""

    name = "observation"

    @property
    def size(self) -> int:
        return self.dimensions

    def __call__(self, observed: Float[Array, " d"]) -> X:
        return 2 * jnp.stack(self.scaled(observed)) - 1


@checked_dataclass
class Own(Features):
    """The features that the task itself states, such as those of a counterexample."""

    name = "own"

    needs_range = False

    def fitted(self, env: Any) -> Features:
        if (given := of_environment(env).features) is None:
            problem = f"{name_of(env)} has no features of its own: take others, such as tile-coding"
            raise InputError(problem, who=type(self).__name__)
        return Rows(given, None, self).fitted(env)


@checked_dataclass
class Aggregation(Ranged):
    """Groups of neighbouring states with one value each: the range of each number in equal parts (section 9.3)."""

    name = "aggregation"

    groups: tuple[int, ...] | int = static(default=10, help="How many groups; or how many along each number.")

    active = 1

    def __post_init__(self):
        super().__post_init__()
        check_tuple(self, "groups", "whole numbers of at least 1", 1)

    @property
    def size(self) -> int:
        return math.prod(_along(self, "groups"))

    def __call__(self, observed: Float[Array, " d"]) -> X:
        index = jnp.int32(0)
        for u, n in zip(self.scaled(observed), _along(self, "groups"), strict=True):
            index = index * n + jnp.minimum(_part(u, n), n - 1)
        return index


def _part(u: Float[Array, ""], n: int) -> Int[Array, ""]:
    """In which of n equal parts of [0, 1] a number is, counted from 0; n at the end itself.

    A border belongs to the part above it. The states that are counted lie on borders, and are worked out in float64: so
    there rounding carries none below its border. In float32, in which numbers that are observed are rounded anyway,
    nothing is added.
    """
    parts = u * n
    return jnp.floor(parts + ROUNDING if parts.dtype == np.float64 else parts).astype(jnp.int32)


def _along(features: Any, name: str) -> tuple[int, ...]:
    """Whole numbers along each number that is observed: one goes for all of them."""
    counts = getattr(features, name)
    if len(counts) not in (1, features.dimensions):
        problem = f"{name} are {len(counts)} numbers, and {features.dimensions} are observed of a state"
        raise InputError(problem, who=type(features).__name__, field=name)
    return counts if len(counts) == features.dimensions else counts * features.dimensions


@checked_dataclass
class TileCoding(Ranged):
    """Grids of tiles, each moved a little against the others: in each of them one tile is 1 (section 9.5.4).

    A tile of a tiling is as wide as the range of a number divided by `tiles`. Tiling t = 0, 1, ... is moved by t times
    the odd numbers 1, 3, 5, ... along the first, second, third number, in units of a tile's width divided by the number
    of tilings, which is asymmetric as in the book. So that a moved tiling still covers the range, it has a tile more
    along each number. Each tile has an index of its own; nothing is hashed.
    """

    name = "tile-coding"

    tilings: int = static(default=8, at_least=1, help="How many tilings.")
    tiles: tuple[int, ...] | int = static(
        default=8, help="How many tiles there are along the range of a number; or for each of them."
    )

    def __post_init__(self):
        super().__post_init__()
        check_tuple(self, "tiles", "whole numbers of at least 1", 1)

    @property
    def active(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.tilings

    @property
    def size(self) -> int:
        return self.tilings * math.prod(n + 1 for n in _along(self, "tiles"))

    def __call__(self, observed: Float[Array, " d"]) -> X:
        # In units of a tile's width divided by the number of tilings, so that a shift is a whole number.
        fine = [
            _part(u, n * self.tilings)
            for u, n in zip(self.scaled(observed), _along(self, "tiles"), strict=True)
        ]
        ones = []
        for tiling in range(self.tilings):
            index = jnp.int32(tiling)
            for i, (x, n) in enumerate(zip(fine, _along(self, "tiles"), strict=True)):
                shift = tiling * (2 * i + 1) % self.tilings
                index = index * (n + 1) + (x + shift) // self.tilings
            ones.append(index)
        return Active(jnp.stack(ones))


@checked_dataclass
class OfOrders(Ranged):
    """A function of the numbers for each choice of a whole number 0 to `order` along each: (order + 1)^d of them.

    The first, with 0 along all, is 1 everywhere.
    """

    order: int = static(
        default=5, at_least=0, help="n, the largest power, or the most half waves, along a number."
    )

    @property
    def size(self) -> int:
        return (self.order + 1) ** self.dimensions

    @property
    def unit(self) -> Float[np.ndarray, " n"]:
        return np.eye(1, self.size)[0]

    @property
    def orders(self) -> list[tuple[int, ...]]:
        """The whole numbers along each number, of each function."""
        return list(itertools.product(range(self.order + 1), repeat=self.dimensions))


@checked_dataclass
class Polynomial(OfOrders):
    """Products of powers of the numbers, each scaled to [0, 1]: (n + 1)^d of them (equation 9.17)."""

    name = "polynomial"

    def __call__(self, observed: Float[Array, " d"]) -> X:
        u = self.scaled(observed)
        powers = [jnp.stack([jnp.ones_like(x), *(x**k for k in range(1, self.order + 1))]) for x in u]
        return reduce(lambda before, these: (before[:, None] * these[None]).ravel(), powers)


@checked_dataclass
class Fourier(OfOrders):
    """Cosines of the numbers, each scaled to [0, 1]: cos(pi s . c), (n + 1)^d of them (equation 9.18)."""

    name = "fourier"

    def __call__(self, observed: Float[Array, " d"]) -> X:
        u, along = self.scaled(observed), np.array(self.orders).T
        return jnp.cos(
            np.pi * sum((c.astype(u[0].dtype) * x for c, x in zip(along, u, strict=True)), 0 * u[0])
        )


@checked_dataclass
class RadialBasis(Ranged):
    """Bells around the points of a grid: exp(-|s - c|^2 / (2 width^2)), numbers scaled to [0, 1] (section 9.5.5)."""

    name = "radial-basis"

    centres: tuple[int, ...] | int = static(
        default=5, help="How many points along each number, its ends among them."
    )
    width: float = static(default=0.25, greater_than=0, help="sigma, in units of the range.")

    def __post_init__(self):
        super().__post_init__()
        check_tuple(self, "centres", "whole numbers of at least 2", 2)

    @property
    def size(self) -> int:
        return math.prod(_along(self, "centres"))

    def __call__(self, observed: Float[Array, " d"]) -> X:
        u = self.scaled(observed)
        points = itertools.product(*(np.linspace(0, 1, n) for n in _along(self, "centres")))
        away = [x - c.astype(x.dtype) for x, c in zip(u, np.array(list(points)).T, strict=True)]
        return jnp.exp(sum(d * d for d in away) * (-0.5 / self.width**2))


@checked_dataclass
class Concatenate(Features):
    """Several features of one observation, one after another: values are the sum of what is linear in each.

    As text "fourier(3) + tile-coding(8, 8)". Where a few of each are 1 and the others 0, that is so of all together.
    """

    parts: tuple[Any, ...] = static(help="The features, as objects or as text; or matrices of them [S, n].")

    name = "concatenate"

    def __post_init__(self):
        if not is_list(self.parts) or not len(self.parts):
            raise unfit("Concatenate", "parts", "a tuple of features", self.parts)
        parts = [read(part) for part in self.parts]
        flat = [own for part in parts for own in (part.parts if isinstance(part, Concatenate) else [part])]
        assign(self, parts=tuple(flat))

    @property
    def size(self) -> int:
        return sum(part.size for part in self.parts)

    @property
    def active(self) -> int | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        counts = [part.active for part in self.parts]
        return None if None in counts else sum(counts)

    @property
    def unit(self) -> Float[np.ndarray, " n"] | None:
        """Where a few features are 1, all of these have a share; else the first part that can be 1 everywhere is."""
        if self.active:
            return np.full(self.size, 1 / self.active)
        units = [part.unit for part in self.parts]
        if (known := next((i for i, unit in enumerate(units) if unit is not None), None)) is None:
            return None
        of = lambda i, part: units[known] if i == known else np.zeros(part.size)
        return np.concatenate([of(i, part) for i, part in enumerate(self.parts)])

    @property
    def nowhere(self) -> X:
        return self._together([part.nowhere for part in self.parts])

    def __call__(self, observed: Float[Array, " d"]) -> X:
        return self._together([part(observed) for part in self.parts])

    def _together(self, xs: Sequence[Any]) -> X:
        if self.active is None:
            return jnp.concatenate(
                [all_of(x, part.size, jnp.result_type(float)) for x, part in zip(xs, self.parts, strict=True)]
            )
        first = itertools.accumulate([part.size for part in self.parts], initial=0)
        ones = [(x.ones if isinstance(x, Active) else x[None]) + n for x, n in zip(xs, first, strict=False)]
        return Active(jnp.concatenate(ones))

    def fitted(self, env: Any) -> Features:
        parts = [part.fitted(env) for part in self.parts]
        if not env.num_states:
            return _not_too_many(dataclasses.replace(self, parts=tuple(parts)))
        numbers = np.arange(env.num_states)[:, None]  # of the states, which are the features of `OneHot`
        rows = [Rows(numbers, env.num_states, part) if isinstance(part, OneHot) else part for part in parts]
        together = _not_too_many(Concatenate(tuple(rows)))
        if together.active is None:
            return Rows(np.concatenate([part.matrix for part in rows], 1), None, together)
        first = itertools.accumulate([part.size for part in rows], initial=0)
        ones = [part.numbers + n for part, n in zip(rows, first, strict=False)]
        return Rows(np.concatenate(ones, 1), together.size, together)

    def __str__(self) -> str:
        return " + ".join(map(str, self.parts))


def _not_too_many(features: Concatenate) -> Concatenate:
    if features.size > MOST:
        problem = f"{features} are {features.size:,} features, and at most {MOST:,} are possible"
        raise InputError(problem, who="Concatenate")
    return features


FEATURES: dict[str, type[Features]] = {
    cls.name: cls
    for cls in (OneHot, Own, Observation, Aggregation, TileCoding, Polynomial, Fourier, RadialBasis)
}
PLUS = re.compile(r"\+(?![^()]*\))")  # between features; within parentheses it belongs to a number


def read(written: Any) -> Features:
    """Features from what is written.

    That is themselves; their name with their numbers, "tile-coding(8, tiles=8)"; several of these with a plus between
    them; or a matrix.

    Raises:
        InputError: they are none; the message says what would be right.
    """
    if isinstance(written, Features):
        return written
    if not isinstance(written, str):
        return Rows(written)
    parts = [part.strip() for part in PLUS.split(written)]
    if "" in parts[len(parts) == 1 :]:
        raise InputError(f"{shown(written)}: a plus stands between two features")
    return _read_one(parts[0]) if len(parts) == 1 else Concatenate(tuple(map(_read_one, parts)))


def _read_one(written: str) -> Features:
    text = written if written.endswith(")") else f"{written}()"
    what = "features with their numbers in parentheses, such as tile-coding(8, tiles=8)"
    plain = text.replace("-", "_", text.partition("(")[0].count("-"))
    name, numbers, keywords = read_call(plain, what, takes_more=True, typed=written)
    name = name.replace("_", "-")
    if name not in FEATURES:
        raise InputError(f"there are no features {shown(name)}; {nearest(name, FEATURES)}")
    try:
        return FEATURES[name](*numbers, **keywords)
    except TypeError as error:
        takes = ", ".join(inspect.signature(FEATURES[name]).parameters)
        raise InputError(f"{shown(written)}: {reason(error)}; {name} takes {takes}") from None


def matrix(written: Any, env: Any) -> Float[np.ndarray, "S n"]:
    """All features of all states of a task, float64 [S, n]: `matrix("aggregation(10)", env)`; see `read`.

    Raises:
        InputError: they are not features of that task, or its states cannot be counted.
    """
    if not env.num_states:
        raise InputError(
            f"the states of {name_of(env)} cannot be counted, so there is no list of their features"
        )
    features: Any = read(written).fitted(env)
    return np.eye(env.num_states) if isinstance(features, OneHot) else features.matrix
