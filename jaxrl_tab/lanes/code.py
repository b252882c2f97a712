"""Scalar code: what a jaxpr is lowered to, and what machine code is made from.

It is the program of one lane. Every value is one number; arrays that are not taken apart into numbers lie in
buffers, which `load` reads and `store` changes. Loops carry numbers. There are few operations: a rule for a
primitive says what it means in terms of them (`rules`), and `emit` says how each is done for many lanes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from jaxrl_tab.lanes import scalars


class Unsupported(Exception):
    """The jaxpr holds something that is not compiled; the message says what."""


@cache
def _compiled(dtype: Any) -> np.dtype:
    """The dtype, if numbers of that kind are compiled."""
    dtype = np.dtype(dtype)
    if dtype.name not in scalars.DTYPES:
        raise Unsupported(f"numbers of the type {dtype.name} are not compiled")
    return dtype


class Value:
    """One number of the program.

    Attributes:
        op: the operation that gives it: "const", "param" (carried by a loop), "load", "store", "row" (several
            numbers of a buffer), "part" (of a row), "loop", "result" (of a loop), or the name of an operation
            in `scalars`. A constant may be an array: then an operation is worked out for all its numbers at once.
        dtype: bool, int32, uint32 or float32; a constant may have any.
        args: the values that the operation takes.
        attr: what else it needs: the number of a constant, the Buffer of a load, the Loop of a loop; of a select
            True where the jaxpr itself chooses (`Builder.choice`).
    """

    __slots__ = ("args", "attr", "dtype", "op")

    def __init__(self, op: str, dtype: Any, args: Sequence["Value"] = (), attr: Any = None):
        self.op, self.dtype, self.args, self.attr = op, np.dtype(dtype), tuple(args), attr

    def __repr__(self) -> str:
        return f"{self.op}:{self.dtype}"

    @property
    def number(self) -> Any:
        """The number of a constant, and None otherwise."""
        return self.attr if self.op == "const" and not self.attr.ndim else None


class Buffer:
    """Memory for an array: of each lane, or, where its numbers are `known`, of all of them together.

    Attributes:
        size: how many numbers it holds.
        known: the numbers, where they are known while compiling; such a buffer is only read.
        role: "scratch"; "input" and "output": arrays of the caller, with a leading axis of lanes; or "outside":
            of a call of what is not compiled.
        changes: while lowering, the sites at which it has been changed so far.
    """

    __slots__ = ("changes", "dtype", "known", "role", "size")

    def __init__(self, dtype: Any, size: int, known: np.ndarray | None = None, role: str = "scratch"):
        self.dtype = np.dtype(dtype) if role == "outside" else _compiled(dtype)
        self.size, self.known, self.role = size, known, role
        self.changes: list[int] = []

    @property
    def version(self) -> int:
        """How often it was changed. A reference to an older version is stale."""
        return len(self.changes)


@dataclass
class Region:
    """Operations in the order in which they are done, and the values that they lead to."""

    params: list[Value] = field(default_factory=list)
    ops: list[Value] = field(default_factory=list)
    results: list[Value] = field(default_factory=list)


@dataclass
class Loop:
    """`while condition(carried): carried = body(carried)`; the arguments of its Value are what is carried first.

    Attributes:
        condition: gives one bool; its parameters are what is carried.
        body: gives what is carried next.
    """

    condition: Region
    body: Region


@dataclass(frozen=True)
class Outside:
    """A call of what is not compiled.

    Attributes:
        number: which of the program's such calls it is.
        inputs, outputs: the buffers that it reads and writes; those of all lanes lie one behind the other.
    """

    number: int
    inputs: list[Buffer]
    outputs: list[Buffer]


class Builder:
    """Writes scalar code. Constants are folded, and what was worked out already is not worked out again."""

    def __init__(self) -> None:
        self.region = Region()
        self._done: list[dict[Any, Value]] = [{}]  # one for each region that is being written
        self._tables: dict[Any, Buffer] = {}

    def const(self, number: Any, dtype: Any = None) -> Value:
        number = np.asarray(number, dtype)[()]
        key = "const", number.dtype, number.tobytes()
        return self.once(key, lambda: Value("const", number.dtype, attr=number))

    def op(self, name: str, dtype: Any, *args: Value) -> Value:
        """The result of an operation of `scalars`."""
        operation, dtype = scalars.OPERATIONS[name], np.dtype(dtype)
        if operation.simplify is not None and (same := operation.simplify(self, dtype, args)) is not None:
            return same
        if operation.known is not None and all(x.op == "const" for x in args):
            with np.errstate(all="ignore"):
                return self.const(operation.known(dtype, *(x.attr for x in args)), dtype)
        key = name, dtype, *map(id, args)
        return self.once(key, lambda: self.add(Value(name, _compiled(dtype), args)))

    def choice(self, which: Value, no: Value, yes: Value) -> Value:
        """A select that XLA has as well, unlike that of an entry which it reads from memory: see `choices`."""
        chosen = self.op("select", no.dtype, which, no, yes)
        if chosen.args == (which, no, yes):
            chosen.attr = True
        return chosen

    def load(self, buffer: Buffer, index: Value) -> Value:
        if buffer.known is not None and index.op == "const":
            return self.const(buffer.known[index.attr])
        key = "load", id(buffer), buffer.version, id(index)
        return self.once(key, lambda: self.add(Value("load", buffer.dtype, (index,), buffer)))

    def row(self, buffer: Buffer, first: Value, count: int) -> list[Value]:
        """Numbers that lie side by side, read together."""

        def read() -> list[Value]:
            row = self.add(Value("row", buffer.dtype, (first,), (buffer, count)))
            return [self.add(Value("part", buffer.dtype, (row,), k)) for k in range(count)]

        return self.once(("row", id(buffer), buffer.version, id(first), count), read)

    def store(self, buffer: Buffer, index: Value, x: Value) -> None:
        self.add(Value("store", buffer.dtype, (index, x), buffer))

    def store_apart(self, buffer: Buffer, index: Value, x: Value) -> None:
        """The same where nothing else is stored at this index in this version: what is loaded from there is `x`."""
        self.store(buffer, index, x)
        self.once(("load", id(buffer), buffer.version, id(index)), lambda: x)

    def table(self, numbers: np.ndarray) -> Buffer:
        """The buffer of an array that is known, one for all equal ones."""
        key = numbers.dtype, numbers.size, numbers.tobytes()
        if key not in self._tables:
            self._tables[key] = Buffer(numbers.dtype, numbers.size, np.ascontiguousarray(numbers).ravel())
        return self._tables[key]

    def add(self, value: Value) -> Value:
        self.region.ops.append(value)
        return value

    @property
    def is_in_loop(self) -> bool:
        """Whether the body of a loop is being written."""
        return len(self._done) > 1

    def write(self, params: list[Value], body: Callable[..., Sequence[Value]]) -> Region:
        """A region of its own, whose results are those of `body(*params)`."""
        outer, self.region = self.region, Region(params)
        self._done.append({})
        try:
            self.region.results = list(body(*params))
            return self.region
        finally:
            self._done.pop()
            self.region = outer

    def loop(
        self, first: Sequence[Value], condition: Callable[..., Value], body: Callable[..., Sequence[Value]]
    ) -> list[Value]:
        """The values that a loop leaves."""
        params = [Value("param", x.dtype) for x in first]
        parts = Loop(self.write(params, lambda *p: [condition(*p)]), self.write(params, body))
        made = self.add(Value("loop", bool, first, parts))
        return [Value("result", x.dtype, (made,), k) for k, x in enumerate(first)]

    def plus(self, x: Value, k: int) -> Value:
        """x + k."""
        return self.op("add", x.dtype, x, self.const(k, x.dtype)) if k else x

    def times(self, x: Value, k: int) -> Value:
        """x k."""
        return self.op("mul", x.dtype, x, self.const(k, x.dtype)) if k != 1 else x

    def product(self, x: Value, y: Value) -> Value:
        """x y, for one addition alone, which is fused with it: both are rounded at once."""
        known = x.op == y.op == "const"
        return self.op("mul", x.dtype, x, y) if known else self.add(Value("mul", x.dtype, (x, y)))

    def rounded(self, x: Value) -> Value:
        """`x`, rounded by itself: an addition that takes it is not fused with the product that it is."""
        if x.dtype.kind != "f" or x.op not in ("mul", "select"):  # of which `choices` may make a product
            return x
        return self.op("bitcast", x.dtype, self.op("bitcast", np.int32, x))

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What `make` writes, or has written under this key before, here or in a region around."""
        for done in self._done:
            if key in done:
                return done[key]
        self._done[-1][key] = value = make()
        return value
