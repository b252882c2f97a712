"""From a jaxpr to scalar code: loops, calls and memory. What single primitives mean stands in `rules`.

Memory is changed in place, as if nobody used the older array any more. Where somebody does, the reading of it
finds out (`Stale`), and all is lowered once more, with a copy made before that one change.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.extend import core as jex

from jaxrl_tab.lanes.arrays import FEW, SMALL, Array, Items, Known, Lazy, Pair, Stale, Stored, made_of, size_of
from jaxrl_tab.lanes.code import Buffer, Builder, Outside, Unsupported, Value
from jaxrl_tab.lanes.outside import is_outside

class Call(NamedTuple):
    """A call of what is not compiled.

    Attributes:
        closed: the jaxpr of one lane.
        known: of each of its arguments the numbers that are known; None where they differ from lane to lane.
    """

    closed: Any
    known: list[np.ndarray | None]


class Lowering(Builder):
    """The program of one lane, while it is written.

    Attributes:
        copied: the sites of changes before which the memory is copied.
        inputs, outputs: the buffers of what differs from lane to lane and of the results, in their order.
    """

    def __init__(self, copied: frozenset[int] = frozenset()):
        super().__init__()
        self.copied = copied
        self.inputs: list[Buffer] = []
        self.outputs: list[Buffer] = []
        self.calls: list[Call] = []
        self.sites = 0
        self._tables: dict[Any, Buffer] = {}

    # --- memory

    def table(self, numbers: np.ndarray) -> Buffer:
        """The buffer of an array that is known, one for all equal ones."""
        key = numbers.dtype, numbers.size, numbers.tobytes()
        if key not in self._tables:
            self._tables[key] = Buffer(numbers.dtype, numbers.size, np.ascontiguousarray(numbers).ravel())
        return self._tables[key]

    def each(self, size: int, do: Any) -> None:
        """`do(index)` for every index below `size`."""
        one, most = self.const(1, np.int32), self.const(size, np.int32)

        def body(i):
            do(i)
            return [self.op("add", np.int32, i, one)]

        self.loop([self.const(0, np.int32)], lambda i: self.op("lt", bool, i, most), body)

    def stored(self, x: Array) -> Stored:
        """A new array in memory with the numbers of `x`."""
        buffer = Buffer(x.dtype, size_of(x.shape))
        self.fill(buffer, x)
        return Stored(x.shape, buffer, 0, self)

    def to_change(self, x: Array) -> Stored:
        """`x` in memory of which nobody else uses the present content: its own, or a copy."""
        self.sites += 1
        if not isinstance(x, Stored) or x.buffer.role != "scratch" or self.sites in self.copied:
            x = self.stored(x)
        elif x.version != x.buffer.version:
            raise Stale(x.buffer.site)
        x.buffer.version += 1
        x.buffer.site = self.sites
        return Stored(x.shape, x.buffer, x.buffer.version, self)

    # --- jaxprs

    def jaxpr(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[Any]) -> list[Any]:
        """What a jaxpr gives for arrays."""
        env: dict[Any, Any] = {}

        def get(v: Any) -> Any:
            return Known(np.asarray(v.val, v.aval.dtype), self) if isinstance(v, jex.Literal) else env[v]

        env |= zip((*jaxpr.constvars, *jaxpr.invars), (*map(self.known, consts), *args), strict=True)
        for equation in jaxpr.eqns:
            env |= zip(equation.outvars, self.equation(equation, [get(v) for v in equation.invars]), strict=True)
        return [get(v) for v in jaxpr.outvars]

    def known(self, x: Any) -> Any:
        return x if isinstance(x, Known | Items | Stored | Lazy | Pair) else Known(np.asarray(x), self)

    def closed(self, closed: Any, *args: Any) -> list[Any]:
        return self.jaxpr(closed.jaxpr, closed.consts, args)

    def equation(self, equation: Any, args: Sequence[Any]) -> Sequence[Any]:
        from jaxrl_tab.lanes import rules

        name = equation.primitive.name
        if is_outside(equation):
            return self.outside(equation, args)
        if (inner := called(equation)) is not None:
            return self.closed(inner, *args)
        if name not in rules.RULES:
            raise Unsupported(f"the primitive {name}")
        found = rules.RULES[name](self, equation, *args)
        return found if equation.primitive.multiple_results else [found]

    def outside(self, equation: Any, args: Sequence[Any]) -> list[Any]:
        """Calls what is not compiled: what it takes is put into buffers, and what it gives is read from others."""
        closed = equation.params["jaxpr"]
        known = [x.numbers if isinstance(x, Known) else None for x in args]
        inputs = [self.buffer_for(x) for x in args if not isinstance(x, Known)]
        outputs = [Buffer(v.aval.dtype, size_of(v.aval.shape), role="outside") for v in closed.jaxpr.outvars]
        number = len(self.calls)
        self.calls.append(Call(closed, known))
        self.add(Value("outside", bool, attr=Outside(number, inputs, outputs)))
        return [
            Stored(v.aval.shape, buffer, 0, self) for v, buffer in zip(closed.jaxpr.outvars, outputs, strict=True)
        ]

    def buffer_for(self, x: Array) -> Buffer:
        """A buffer with the numbers of `x`, for a call of what is not compiled."""
        if isinstance(x, Stored) and x.buffer.role == "outside":  # it is what another call gave
            return x.buffer
        buffer = Buffer(x.dtype, size_of(x.shape), role="outside")
        self.fill(buffer, x)
        return buffer

    def fill(self, buffer: Buffer, x: Array) -> None:
        """Writes the numbers of `x` into a buffer."""
        if buffer.size <= (SMALL if isinstance(x, Items | Known) else FEW):
            for i in range(buffer.size):
                self.store(buffer, self.const(i, np.int32), x.item(i))
        else:
            self.each(buffer.size, lambda i: self.store(buffer, i, x.read(i)))

    # --- loops

    def while_loop(self, first: Sequence[Any], condition: Any, body: Any) -> list[Any]:
        """A loop over arrays: `condition(arrays) -> Value`, `body(arrays) -> arrays`.

        Small arrays are carried as numbers; large ones lie in memory of the loop, and are changed there.
        """
        first = [x if _is_small(x) else self.to_change(x) for x in first]
        sizes = [size_of(x.shape) if _is_small(x) else 0 for x in first]
        numbers = [x.item(i) for x, size in zip(first, sizes, strict=True) for i in range(size)]

        def arrays(values: Sequence[Value]) -> list[Any]:
            given = iter(values)
            return [
                made_of(self, x.shape, x.dtype, [next(given) for _ in range(size)])
                if _is_small(x)
                else Stored(x.shape, x.buffer, x.buffer.version, self)
                for x, size in zip(first, sizes, strict=True)
            ]

        def once(*values: Value) -> list[Value]:
            after = body(arrays(values))
            numbers = [y.item(i) for y, size in zip(after, sizes, strict=True) for i in range(size)]
            moved = [(x.buffer, y) for x, y in zip(first, after, strict=True) if not _is_small(x) and not _is_in(y, x)]
            for buffer, copy in [(buffer, self.stored(y)) for buffer, y in moved]:  # all are read before one is written
                self.each(buffer.size, lambda i, to=buffer, copy=copy: self.store(to, i, copy.read(i)))
                buffer.version += 1
            return numbers

        return arrays(self.loop(numbers, lambda *values: condition(arrays(values)), once))

    def scan(self, equation: Any, args: Sequence[Any]) -> list[Any]:
        p = equation.params
        consts, first, given = _parts(args, p["num_consts"], p["num_carry"])
        length, closed = p["length"], p["jaxpr"]
        stacked = [self.empty((length, *v.aval.shape), v.aval.dtype) for v in closed.jaxpr.outvars[len(first) :]]
        parts = lambda rows: [part for row in rows for part in ((row.real, row.imag) if isinstance(row, Pair) else (row,))]

        def whole(rows: Sequence[Any]) -> list[Any]:
            part = iter(rows)
            return [Pair(next(part), next(part)) if isinstance(x, Pair) else next(part) for x in stacked]

        def body(carried: list[Any]) -> list[Any]:
            (count, *state), rows = carried[: 1 + len(first)], whole(carried[1 + len(first) :])
            i = count.item(0)
            at = self.op("sub", np.int32, self.const(length - 1, np.int32), i) if p["reverse"] else i
            after = self.closed(closed, *consts, *state, *(self.slice_of(x, at, x.shape[1:]) for x in given))
            rows = [self.put(x, y, at) for x, y in zip(rows, after[len(first) :], strict=True)]
            return [made_of(self, (), np.int32, [self.op("add", np.int32, i, self.const(1, np.int32))]), *after[: len(first)], *parts(rows)]

        least = lambda carried: self.op("lt", bool, carried[0].item(0), self.const(length, np.int32))
        found = self.while_loop([self.known(np.int32(0)), *first, *parts(stacked)], least, body)[1:]
        return [*found[: len(first)], *whole(found[len(first) :])]

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        """An array that will be written before it is read."""
        if dtype == np.complex64:
            return Pair(self.empty(shape, np.float32), self.empty(shape, np.float32))
        return Stored(tuple(shape), Buffer(dtype, size_of(shape)), 0, self)

    def slice_of(self, x: Any, i: Value, shape: Sequence[int]) -> Any:
        """`x[i]`."""
        if isinstance(x, Pair):
            return Pair(self.slice_of(x.real, i, shape), self.slice_of(x.imag, i, shape))
        size = size_of(shape)
        first = i if size == 1 else self.op("mul", np.int32, i, self.const(size, np.int32))
        if size <= SMALL:
            return made_of(self, shape, x.dtype, [x.read(self.plus(first, k)) for k in range(size)])
        return Lazy(tuple(shape), x.dtype, lambda k: x.read(self.op("add", np.int32, first, k)), self)

    def put(self, x: Any, y: Any, i: Value) -> Any:
        """`x` with `x[i] = y`."""
        if isinstance(x, Pair):
            return Pair(self.put(x.real, y.real, i), self.put(x.imag, y.imag, i))
        to, size = self.to_change(x), size_of(y.shape)
        first = i if size == 1 else self.op("mul", np.int32, i, self.const(size, np.int32))
        if size <= SMALL:
            for k in range(size):
                self.store(to.buffer, self.plus(first, k), y.item(k))
        else:
            self.each(size, lambda k: self.store(to.buffer, self.op("add", np.int32, first, k), y.read(k)))
        return to

    def plus(self, x: Value, k: int) -> Value:
        return self.op("add", x.dtype, x, self.const(k, x.dtype)) if k else x


def lower(closed: Any, varying: Sequence[bool], given: Sequence[Any], results: int | None = None) -> Lowering:
    """The program of one lane.

    Args:
        closed: the jaxpr of one run.
        varying: for each of its arguments, whether it differs from lane to lane.
        given: the others, as NumPy arrays (keys as their data), and None for those that differ.
        results: how many of its results are wanted, from the first on; None: all.
    """
    copied: frozenset[int] = frozenset()
    while True:
        code = Lowering(copied)
        try:
            _lower(code, closed, varying, given, results)
            return code
        except Stale as stale:
            copied |= {stale.site}


def _lower(
    code: Lowering, closed: Any, varying: Sequence[bool], given: Sequence[Any], results: int | None
) -> None:
    args = []
    for v, differs, x in zip(closed.jaxpr.invars, varying, given, strict=True):
        if not differs:
            args.append(code.known(x))
            continue
        buffer = Buffer(v.aval.dtype, size_of(v.aval.shape), role="input")
        code.inputs.append(buffer)
        stored = Stored(v.aval.shape, buffer, 0, code)
        small = buffer.size <= SMALL
        args.append(made_of(code, v.aval.shape, v.aval.dtype, [stored.item(i) for i in range(buffer.size)]) if small else stored)
    outputs = code.jaxpr(closed.jaxpr, closed.consts, args)[:results]
    for v, x in zip(closed.jaxpr.outvars[:results], outputs, strict=True):
        buffer = Buffer(v.aval.dtype, size_of(v.aval.shape), role="output")
        code.outputs.append(buffer)
        code.fill(buffer, x)


def called(equation: Any) -> Any:
    """The jaxpr that an equation merely calls, or None. For `custom_vmap` that is what it means for one lane."""
    if equation.primitive.name not in ("jit", "pjit", "closed_call", "core_call", "custom_vmap_call", "custom_jvp_call", "custom_vjp_call"):
        return None
    return next(equation.params[name] for name in ("jaxpr", "call", "call_jaxpr") if name in equation.params)


def _parts(xs: Sequence[Any], *counts: int) -> tuple[list[Any], ...]:
    parts, at = [], 0
    for count in counts:
        parts.append(list(xs[at : at + count]))
        at += count
    return (*parts, list(xs[at:]))


def _is_small(x: Any) -> bool:
    return not isinstance(x, Stored | Lazy) and size_of(x.shape) <= SMALL


def _is_in(y: Any, x: Stored) -> bool:
    """Whether `y` is what the memory of `x` holds now."""
    return isinstance(y, Stored) and y.buffer is x.buffer and y.version == y.buffer.version


