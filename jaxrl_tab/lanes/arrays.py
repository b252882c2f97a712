"""What an array of the jaxpr is while it is lowered: numbers that are known, values, memory, or a rule.

Each has a shape, a dtype, `item(i)`, its number at a flat index that is known (C order), and `read(index)`, its
number at a flat index that is a value. Four kinds:

    Known    a NumPy array
    Items    a small array, taken apart: one value for each of its numbers
    Stored   memory of the lane
    Lazy     a large array that is never stored: a rule that gives the number at an index
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
            return self.item(int(index.number))
        if (first := self.numbers.ravel()[:1]).size and np.array_equal(
            self.numbers.ravel().view(np.uint8).reshape(-1, self.dtype.itemsize),
            np.broadcast_to(first.view(np.uint8), (self.numbers.size, self.dtype.itemsize)),
        ):
            return self.item(0)  # all are the same
        return self.code.load(self.code.table(self.numbers), index)


@dataclass(frozen=True)
class Items:
    shape: tuple[int, ...]
    dtype: np.dtype
    values: list[Value]
    code: Builder

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
        self._check()
        return self.code.load(self.buffer, index)

    def row(self, first: Value, count: int) -> list[Value]:
        """Numbers that lie side by side, from index `first` on."""
        self._check()
        return self.code.row(self.buffer, first, count)

    def _check(self) -> None:
        if self.version != self.buffer.version:
            raise Stale(self.buffer.site)


@dataclass(frozen=True)
class Lazy:
    shape: tuple[int, ...]
    dtype: np.dtype
    rule: Callable[[Value], Value]
    code: Builder

    def item(self, i: int) -> Value:
        return self.rule(self.code.const(i, np.int32))

    def read(self, index: Value) -> Value:
        return self.rule(index)


@dataclass(frozen=True)
class Pair:
    """Complex numbers, of which only the parts are used."""

    real: Any
    imag: Any

    @property
    def shape(self) -> tuple[int, ...]:
        return self.real.shape


Array: TypeAlias = Known | Items | Stored | Lazy


def is_taken_apart(shape: Sequence[int], arrays: Sequence[Array]) -> bool:
    """Whether an array of this shape that is made from these is taken apart.

    A small one is; but numbers that lie in memory are worked on when they are read, unless there are very few: else
    all would be read, and most of them for nothing.
    """
    if (size := size_of(shape)) > FEW:
        return size <= SMALL and any(isinstance(x, Items) and size_of(x.shape) > 1 for x in arrays)
    return True


def size_of(shape: Sequence[int]) -> int:
    return int(np.prod(shape, dtype=np.int64))


def reshaped(x: Array, shape: Sequence[int]) -> Array:
    """The same numbers in another shape: nothing is to be done."""
    shape = tuple(shape)
    if isinstance(x, Known):
        return Known(x.numbers.reshape(shape), x.code)
    if isinstance(x, Items):
        return Items(shape, x.dtype, x.values, x.code)
    if isinstance(x, Stored):
        return Stored(shape, x.buffer, x.version, x.code)
    return Lazy(shape, x.dtype, x.rule, x.code)


def made_of(code: Builder, shape: Sequence[int], dtype: Any, values: Sequence[Value]) -> Array:
    """A small array of values, known where all of them are."""
    if all(x.op == "const" for x in values):
        return Known(np.array([x.number for x in values], dtype).reshape(tuple(shape)), code)
    return Items(tuple(shape), np.dtype(dtype), list(values), code)
