"""What an array of the jaxpr is while it is lowered: numbers that are known, values, memory, or a rule.

Each has a shape, a dtype, `item(i)`, its number at a flat index that is known (C order), and `read(index)`, its
number at a flat index that is a value, which is in range. Four kinds:

    Known    a NumPy array
    Items    a small array, taken apart: one value for each of its numbers
    Stored   memory of the lane
    Lazy     a large array that is never stored: a rule that gives the number at an index

Where one number takes several words, there is an array for each of them: `Parts`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from jaxrl_tab.lanes.code import Buffer, Builder, Value

SMALL = 32  # arrays of so many numbers at most are taken apart
FEW = 4  # also where they lie in memory


class Stale(Exception):
    """An array is read after the memory that it lies in was changed at `site`: there it must be copied."""

    def __init__(self, site: int):
        self.site = site


@dataclass(frozen=True)
class Known:
    numbers: np.ndarray
    code: Builder

    @property
    def shape(self) -> tuple[int, ...]:
        return self.numbers.shape

    @property
    def dtype(self) -> np.dtype:
        return self.numbers.dtype

    def item(self, i: int) -> Value:
        return self.code.const(self.numbers.ravel()[i])

    def read(self, index: Value) -> Value:
        if index.op == "const":
            return self.code.const(self.numbers.ravel()[index.attr])
        words = self.numbers.ravel().view(np.uint8).reshape(self.numbers.size, -1)
        if np.array_equal(words, np.broadcast_to(words[:1], words.shape)):
            return self.item(0)  # all are the same
        return self.code.load(self.code.table(self.numbers), index)

    def row(self, first: Value, count: int) -> list[Value]:
        """Numbers that lie side by side, from index `first` on."""
        return self.code.row(self.code.table(self.numbers), first, count)


@dataclass(frozen=True)
class Items:
    shape: tuple[int, ...]
    dtype: np.dtype
    values: list[Value]
    code: Builder
    repeats: bool = False  # whether some of its numbers stand at several places, because of its shape

    def item(self, i: int) -> Value:
        return self.values[i]

    def read(self, index: Value) -> Value:
        if index.op == "const":
            return self.values[int(index.number)]
        chosen = self.values[0]
        for i, value in enumerate(self.values[1:], 1):
            is_it = self.code.op("eq", bool, index, self.code.const(i, index.dtype))
            chosen = self.code.op("select", self.dtype, is_it, chosen, value)
        return chosen


@dataclass(frozen=True)
class Stored:
    shape: tuple[int, ...]
    buffer: Buffer
    version: int
    code: Builder

    @property
    def dtype(self) -> np.dtype:
        return self.buffer.dtype

    def item(self, i: int) -> Value:
        return self.read(self.code.const(i, np.int32))

    def read(self, index: Value) -> Value:
        self.check()
        return self.code.load(self.buffer, index)

    def read_anew(self, index: Value) -> Value:
        """The number that lies there now, while the memory is being written."""
        return self.code.add(Value("load", self.dtype, (index,), self.buffer))

    def row(self, first: Value, count: int) -> list[Value]:
        """Numbers that lie side by side, from index `first` on."""
        self.check()
        return self.code.row(self.buffer, first, count)

    def check(self) -> None:
        """Raises Stale where the memory has been changed since."""
        if self.version < self.buffer.version:
            raise Stale(self.buffer.changes[self.version])


@dataclass(frozen=True)
class Lazy:
    """A rule that gives the number at an index.

    Attributes:
        pointwise: the arrays of the same size from whose numbers at the same index, and from no other memory, it
            makes its own; None where that is not so.
        repeats: whether some of its numbers stand at several places, because of its shape.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    rule: Callable[[Value], Value]
    code: Builder
    pointwise: tuple["Plain", ...] | None = None
    repeats: bool = False

    def item(self, i: int) -> Value:
        return self.read(self.code.const(i, np.int32))

    def read(self, index: Value) -> Value:
        # Once: where each array is made of the one before, twice, the first would be read 2^n times.
        return self.code.once(("read", self.rule, index), lambda: self.rule(index))


Plain: TypeAlias = Known | Items | Stored | Lazy


@dataclass(frozen=True)
class Parts:
    """Numbers of two words: the real and the imaginary part, or the two words of a Threefry key."""

    arrays: tuple[Plain, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.arrays[0].shape


Array: TypeAlias = Plain | Parts


def is_taken_apart(shape: Sequence[int], arrays: Sequence[Array]) -> bool:
    """Whether an array of this shape that is made from these is taken apart.

    A small one is; but numbers that lie in memory are worked on when they are read, unless there are very few: else
    all would be read, and most of them for nothing.
    """
    if (size := size_of(shape)) > FEW:
        return size <= SMALL and any(isinstance(x, Items) and size_of(x.shape) > 1 for x in arrays)
    return True


def size_of(shape: Sequence[int]) -> int:
    return math.prod(shape)


def is_small(shape: Sequence[int]) -> bool:
    return size_of(shape) <= SMALL


def made_of(code: Builder, shape: Sequence[int], dtype: Any, values: Sequence[Value]) -> Known | Items:
    """A small array of values, known where all of them are."""
    if all(x.op == "const" for x in values):
        return Known(np.array([x.number for x in values], dtype).reshape(tuple(shape)), code)
    return Items(tuple(shape), np.dtype(dtype), list(values), code)


def made_by(
    code: Builder,
    shape: Sequence[int],
    dtype: Any,
    rule: Callable[[Value], Value],
    of: Sequence["Plain"] = (),
    pointwise: tuple["Plain", ...] | None = None,
) -> "Plain":
    """The array of the numbers that a rule gives at each flat index.

    Args:
        of: the arrays that it reads.
        pointwise: as in `Lazy`.
    """
    if is_taken_apart(shape, of) if of else is_small(shape):
        return made_of(code, shape, dtype, [rule(code.const(i, np.int32)) for i in range(size_of(shape))])
    return Lazy(tuple(shape), np.dtype(dtype), rule, code, pointwise)


def read_in_place(x: Plain) -> list[Stored] | None:
    """The arrays in memory from whose numbers at the same index, and from no others, those of `x` are made; or None."""
    if isinstance(x, Stored):
        return [x]
    if not isinstance(x, Lazy):
        return []
    parts = None if x.pointwise is None else [read_in_place(y) for y in x.pointwise]
    if parts is None or None in parts:
        return None
    return [y for part in parts if part for y in part]


def reshaped(x: Plain, shape: Sequence[int]) -> Plain:
    """The same numbers in another shape: nothing is to be done."""
    shape = tuple(shape)
    if isinstance(x, Known):
        return Known(x.numbers.reshape(shape), x.code)
    if isinstance(x, Items):
        return Items(shape, x.dtype, x.values, x.code, x.repeats)
    if isinstance(x, Stored):
        return Stored(shape, x.buffer, x.version, x.code)
    return Lazy(shape, x.dtype, x.rule, x.code, x.pointwise, x.repeats)


def flat(arrays: Sequence[Array]) -> list[Plain]:
    """The arrays, each part for itself."""
    return [part for x in arrays for part in (x.arrays if isinstance(x, Parts) else (x,))]


def like(arrays: Sequence[Array], parts: Sequence[Plain]) -> list[Array]:
    """`parts`, put together as they were before `flat`."""
    left = iter(parts)
    return [
        Parts(tuple(next(left) for _ in x.arrays)) if isinstance(x, Parts) else next(left) for x in arrays
    ]


# --- numbers at other places


def along_axes(code: Builder, index: Value, shape: Sequence[int]) -> list[Value]:
    """The index along each axis, of a flat index."""
    found: list[Value] = []
    for n in reversed(shape[1:]):
        size = code.const(n, np.int32)
        found.append(code.op("rem", np.int32, index, size) if n > 1 else code.const(0, np.int32))
        index = code.op("div", np.int32, index, size) if n > 1 else index
    return [index, *reversed(found)] if shape else []


def flat_index(code: Builder, axes: Sequence[Value], shape: Sequence[int]) -> Value:
    """The flat index, of the index along each axis."""
    total = code.const(0, np.int32)
    for i, n in zip(axes, shape, strict=True):
        total = code.times(total, n) if total.number is None else code.const(int(total.number) * n, np.int32)
        total = i if total.number == 0 else total if i.number == 0 else code.op("add", np.int32, total, i)
    return total


def moved(
    code: Builder,
    shape: Sequence[int],
    x: Plain,
    move: Callable[[np.ndarray], np.ndarray],
    at: Callable[[list[Value]], list[Value]],
) -> Plain:
    """The numbers of `x` at other places.

    Args:
        code, shape, x: the code that is written, the shape of the result, and the array.
        move: moves the numbers of a NumPy array.
        at: the index along each axis of the result -> along each axis of `x`; for large arrays.
    """
    if isinstance(x, Known):
        return Known(move(x.numbers), code)
    if is_taken_apart(shape, [x]):
        places = move(np.arange(size_of(x.shape)).reshape(x.shape)).ravel()
        return made_of(code, shape, x.dtype, [x.item(int(i)) for i in places])
    return made_by(
        code, shape, x.dtype, lambda i: x.read(flat_index(code, at(along_axes(code, i, shape)), x.shape))
    )


def stretched(code: Builder, shape: Sequence[int], x: Plain) -> Plain:
    """`x` as often as it takes along each axis that has the size 1."""

    def at(index: list[Value]) -> list[Value]:
        return [i if n > 1 else code.const(0, np.int32) for i, n in zip(index, x.shape, strict=True)]

    y = moved(code, shape, x, lambda y: np.broadcast_to(y, tuple(shape)), at)
    return replace(y, repeats=True) if isinstance(y, Items | Lazy) else y
