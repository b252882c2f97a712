"""From a jaxpr to scalar code: calls, loops and memory. What single primitives mean stands in `rules`.

Memory is changed in place, as if nobody used the older array any more. Where somebody does, the reading of it
finds out (`Stale`), and all is lowered once more, with a copy made before that one change.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core as jex

from jaxrl_tab.lanes.arrays import (
    Array,
    Items,
    Known,
    Lazy,
    Parts,
    Plain,
    Stored,
    flat,
    is_small,
    is_taken_apart,
    like,
    made_of,
    read_in_place,
    size_of,
)
from jaxrl_tab.lanes.code import Buffer, Builder, Outside, Unsupported, Value
from jaxrl_tab.lanes.outside import is_outside
from jaxrl_tab.lanes.registry import OF_PARTS, RULES

CARRIED = 8  # numbers of an array at most are carried by a loop as they are
UNROLLED = 4  # turns of a loop over the numbers of an array are written one behind the other, in another loop

# The primitives that merely call a jaxpr. For `custom_vmap_call` it is what the function means for one lane.
CALLS = (
    "jit",
    "pjit",
    "closed_call",
    "core_call",
    "custom_vmap_call",
    "custom_jvp_call",
    "custom_vjp_call",
    "remat2",
)


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
        calls: what is called and not compiled.
    """

    def __init__(self, copied: frozenset[int] = frozenset()):
        super().__init__()
        self.copied = copied
        self.inputs: list[Buffer] = []
        self.outputs: list[Buffer] = []
        self.calls: list[Call] = []
        self._sites = 0
        self._own: list[set[Buffer]] = [set()]  # the memory that a loop may change, for each that is written

    # --- jaxprs

    def jaxpr(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[Array]) -> list[Any]:
        """What a jaxpr gives for arrays."""
        env: dict[Any, Any] = {}

        def get(v: Any) -> Array:
            if isinstance(v, jex.Literal):
                aval: Any = v.aval
                return Known(np.asarray(v.val, aval.dtype), self)
            return env[v]

        env |= zip((*jaxpr.constvars, *jaxpr.invars), (*map(self.known, consts), *args), strict=True)
        for equation in jaxpr.eqns:
            results = self.equation(equation, [get(v) for v in equation.invars])
            env |= zip(equation.outvars, results, strict=True)
        return [get(v) for v in jaxpr.outvars]

    def known(self, x: Any) -> Array:
        """An array that is known while compiling."""
        return x if isinstance(x, Plain | Parts) else Known(np.asarray(x), self)

    def closed(self, closed: Any, *args: Array) -> list[Any]:
        return self.jaxpr(closed.jaxpr, closed.consts, args)

    def equation(self, equation: Any, args: Sequence[Array]) -> Sequence[Any]:
        name = equation.primitive.name
        if is_outside(equation):
            return self._outside(equation.params["jaxpr"], args)
        if name in CALLS:
            if name == "custom_vmap_call":  # of `tables`, whose rules are loops over lanes in XLA
                args = self.as_in_memory(args)
            inner = next(equation.params[p] for p in ("jaxpr", "call", "call_jaxpr") if p in equation.params)
            return self.closed(inner, *args) if hasattr(inner, "consts") else self.jaxpr(inner, (), args)
        if name not in RULES:
            raise Unsupported(f"the primitive {name} is not compiled")
        if name not in OF_PARTS and any(isinstance(x, Parts) for x in args):
            return self._by_parts(equation, args)
        results = RULES[name](self, equation, *args)
        results = results if equation.primitive.multiple_results else [results]
        known = [x for x in args if isinstance(x, Known)]
        if len(known) == len(args) and any(isinstance(x, Lazy) for x in results):
            return self._worked_out(equation, known, results)
        return results

    def _worked_out(self, equation: Any, args: Sequence[Known], results: Sequence[Plain]) -> Sequence[Plain]:
        """What large arrays that are known make, known as well.

        Whole numbers are worked out by the rule of the primitive, at all places at once. Real ones are left to
        JAX, for XLA rounds some products and sums together.
        """
        if all(x.dtype.kind in "iub" for x in results):
            folded = [self._at_all_places(x) if isinstance(x, Lazy) else x for x in results]
            known = [x for x in folded if x is not None]
            if len(known) == len(folded):
                return known
        with jax.ensure_compile_time_eval(), equation.ctx.manager:
            numbers = equation.primitive.bind(*(x.numbers for x in args), **equation.params)
        numbers = numbers if equation.primitive.multiple_results else [numbers]
        return [Known(np.asarray(x), self) for x in numbers]

    def _at_all_places(self, x: Lazy) -> Known | None:
        """The numbers of an array; None where its rule takes more than constants, such as a loop."""
        number = x.read(self.const(np.arange(size_of(x.shape)), np.int32))
        if number.op != "const":
            return None
        return Known(np.broadcast_to(number.attr, size_of(x.shape)).reshape(x.shape), self)

    def _outside(self, closed: Any, args: Sequence[Array]) -> list[Stored]:
        """Calls what is not compiled: what it takes is put into buffers, and what it gives is read from others."""
        plain = [x for x in args if not isinstance(x, Parts)]
        if len(plain) < len(args):
            raise Unsupported("a key or a complex number for what is not compiled")
        inputs = [self._handed_on(x) for x in plain if not isinstance(x, Known)]
        outputs = [Buffer(v.aval.dtype, size_of(v.aval.shape), role="outside") for v in closed.jaxpr.outvars]
        self.add(Value("outside", bool, attr=Outside(len(self.calls), inputs, outputs)))
        self.calls.append(Call(closed, [x.numbers if isinstance(x, Known) else None for x in plain]))
        results = zip(closed.jaxpr.outvars, outputs, strict=True)
        return [Stored(v.aval.shape, buffer, 0, self) for v, buffer in results]

    def _handed_on(self, x: Plain) -> Buffer:
        """A buffer with the numbers of `x`, for a call of what is not compiled."""
        if isinstance(x, Stored) and x.buffer.role == "outside":  # it is what another call gave
            return x.buffer
        buffer = Buffer(x.dtype, size_of(x.shape), role="outside")
        self.copy(x, buffer)
        return buffer

    def _by_parts(self, equation: Any, args: Sequence[Array]) -> list[Parts]:
        """What a rule gives for numbers of two words: it puts them elsewhere, each word for itself."""
        count = max(len(x.arrays) for x in args if isinstance(x, Parts))
        each = [
            self.equation(equation, [x.arrays[k] if isinstance(x, Parts) else x for x in args])
            for k in range(count)
        ]
        return [Parts(tuple(parts)) for parts in zip(*each, strict=True)]

    def as_in_memory(self, arrays: Sequence[Array]) -> list[Any]:
        """The same arrays, with numbers that are rounded by themselves, as what XLA puts into memory is."""

        def rounded(x: Plain) -> Plain:
            if isinstance(x, Items):
                return replace(x, values=[*map(self.rounded, x.values)])
            return replace(x, rule=lambda i: self.rounded(x.rule(i))) if isinstance(x, Lazy) else x

        return like(arrays, [rounded(x) for x in flat(arrays)])

    # --- memory

    def each(self, size: int, do: Callable[[Value], None]) -> None:
        """`do(index)` for every index below `size`."""
        # What is done once in a run takes longer to compile than to do.
        together = UNROLLED if self.is_in_loop else 1
        turns = size // together if size > UNROLLED else 0

        def body(turn: Value) -> list[Value]:
            for k in range(together):
                do(self.plus(self.times(turn, together), k))
            return [self.plus(turn, 1)]

        if turns:
            most = self.const(turns, np.int32)
            self.loop([self.const(0, np.int32)], lambda turn: self.op("lt", bool, turn, most), body)
        for i in range(turns * together, size):
            do(self.const(i, np.int32))

    def copy(self, x: Plain, buffer: Buffer) -> None:
        """Puts the numbers of `x` into a buffer."""
        if is_taken_apart(x.shape, [x]):
            numbers = [x.item(i) for i in range(buffer.size)]
            for i, number in enumerate(numbers):
                self.store(buffer, self.const(i, np.int32), number)
        else:
            self.each(buffer.size, lambda i: self.store(buffer, i, x.read(i)))

    def stored(self, x: Plain) -> Stored:
        """A new array in memory with the numbers of `x`."""
        new = self.empty(x.shape, x.dtype)
        self.copy(x, new.buffer)
        return new

    def in_memory(self, x: Plain) -> Plain:
        """A large array whose numbers may be read again and again: they are not worked out each time."""
        return x if is_small(x.shape) or isinstance(x, Known | Stored) else self.stored(x)

    def empty(self, shape: Sequence[int], dtype: Any) -> Stored:
        """An array that will be written before it is read."""
        buffer = Buffer(dtype, size_of(shape))
        self._own[-1].add(buffer)
        return Stored(tuple(shape), buffer, 0, self)

    def to_change(self, x: Plain) -> Stored:
        """`x` in memory of which nobody else uses the present content: its own, or a copy.

        It is copied, too, where it comes from outside of the loop that is written: the next turn wants it anew.
        """
        self._sites += 1
        if isinstance(x, Lazy) and self._sites not in self.copied and (place := self._place_for(x)):
            self.each(place.buffer.size, lambda i: self.store(place.buffer, i, x.read(i)))
            x = Stored(x.shape, place.buffer, place.version, self)
        if not isinstance(x, Stored) or x.buffer not in self._own[-1] or self._sites in self.copied:
            x = self.stored(x)
        else:
            x.check()
        x.buffer.changes.append(self._sites)
        return Stored(x.shape, x.buffer, x.buffer.version, self)

    def _place_for(self, x: Lazy) -> Stored | None:
        """Memory in which the numbers of `x` can replace those that they are made from, place by place."""
        return next((y for y in read_in_place(x) or () if self._may_replace(y, x)), None)

    def _may_replace(self, y: Stored, x: Lazy) -> bool:
        is_current = y.buffer in self._own[-1] and y.version == y.buffer.version
        return is_current and y.dtype == x.dtype and y.buffer.size == size_of(x.shape)

    # --- loops

    def while_loop(
        self,
        first: Sequence[Array],
        condition: Callable[[list[Any]], Value],
        body: Callable[[list[Any]], Sequence[Any]],
    ) -> list[Any]:
        """A loop over arrays: `condition(arrays) -> Value`, `body(arrays) -> arrays`.

        Small arrays are carried as numbers; large ones lie in memory of the loop, and are changed there.
        """
        parts = [x if _carried(x) else self.to_change(x) for x in flat(first)]
        sizes = [size_of(x.shape) if _carried(x) else 0 for x in parts]

        def numbers(arrays: Sequence[Plain]) -> list[Value]:
            return [x.item(i) for x, size in zip(arrays, sizes, strict=True) for i in range(size)]

        def arrays(values: Sequence[Value]) -> list[Array]:
            left = iter(values)
            carried = [
                Stored(x.shape, x.buffer, x.buffer.version, self)
                if isinstance(x, Stored)
                else made_of(self, x.shape, x.dtype, [next(left) for _ in range(size)])
                for x, size in zip(parts, sizes, strict=True)
            ]
            return like(first, carried)

        def once(*values: Value) -> list[Value]:
            self._own.append({x.buffer for x in parts if isinstance(x, Stored)})
            after = flat(body(arrays(values)))
            self._own.pop()
            result = numbers(after)
            memory = [(x, y) for x, y in zip(parts, after, strict=True) if isinstance(x, Stored)]
            self._hand_on([(x.buffer, y) for x, y in memory if not _is_in(y, x)])
            return result

        return arrays(self.loop(numbers(parts), lambda *values: condition(arrays(values)), once))

    def _hand_on(self, moved: Sequence[tuple[Buffer, Plain]]) -> None:
        """Puts arrays into the memory of what a loop carries: all are read before one is written.

        Those whose numbers are made place by place are worked out together, and need no memory between.
        """
        in_place, apart = [], []
        for buffer, y in moved:
            fits = isinstance(y, Lazy) and read_in_place(y) is not None
            (in_place if fits else apart).append((buffer, y))
        copied = [(buffer, self.stored(y)) for buffer, y in apart]
        for size in {buffer.size for buffer, _ in in_place}:
            together = [(buffer, y) for buffer, y in in_place if buffer.size == size]

            def put(i: Value, together: Sequence[tuple[Buffer, Plain]] = together) -> None:
                for buffer, number in [(buffer, y.read(i)) for buffer, y in together]:
                    self.store(buffer, i, number)

            self.each(size, put)
        for buffer, y in copied:
            self.copy(y, buffer)
        for buffer, _ in moved:
            buffer.changes.append(self._sites)


def _carried(x: Plain) -> bool:
    """Whether a loop carries the numbers of an array, and not the array in memory.

    More than a few are better there: an entry that is read or written at an index would be looked for among all.
    """
    return not isinstance(x, Stored) and size_of(x.shape) <= CARRIED


def _is_in(y: Plain, x: Stored) -> bool:
    """Whether `y` is what the memory of `x` holds now."""
    return isinstance(y, Stored) and y.buffer is x.buffer and y.version == y.buffer.version
