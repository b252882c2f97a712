"""Along axes: sums, products, maxima, the place of the largest, running sums.

Sums of real numbers are taken in the order in which XLA takes them for few lanes: one after another; of more
than 32, in windows of 32. (For many lanes XLA sums in another order, so that bits may differ there.)
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes.arrays import (
    SMALL,
    Plain,
    along_axes,
    flat_index,
    is_small,
    made_by,
    made_of,
    size_of,
)
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.rules.numbers import aval_of

WINDOW = 32  # so many numbers XLA sums one after another
CHUNK = 16  # and so many in running sums
OPERATION = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_and": "and",
    "reduce_or": "or",
    "reduce_xor": "xor",
    "cumsum": "add",
    "cumprod": "mul",
    "cummax": "max",
    "cummin": "min",
}


def _neutral(name: str, dtype: np.dtype) -> Any:
    """What changes nothing."""
    if name in ("add", "or", "xor"):
        return 0
    if name == "mul":
        return 1
    if name == "and":
        return True if dtype.kind == "b" else -1 if dtype.kind == "i" else np.iinfo(dtype).max
    if dtype.kind == "b":
        return name == "min"
    low, high = (-np.inf, np.inf) if dtype.kind == "f" else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    return low if name == "max" else high


def _turns(
    code: Lowering, begin: Value, end: Value, first: Sequence[Value], turn: Callable[..., Sequence[Value]]
) -> list[Value]:
    """`values = turn(i, *values)` for each i from `begin` to before `end`."""
    if begin.op == end.op == "const" and end.number - begin.number <= SMALL:
        values = list(first)
        for i in range(int(begin.number), int(end.number)):
            values = list(turn(code.const(i, np.int32), *values))
        return values

    def goes_on(i: Value, *values: Value) -> Value:
        return code.op("lt", bool, i, end)

    def body(i: Value, *values: Value) -> list[Value]:
        return [code.plus(i, 1), *turn(i, *values)]

    return code.loop([begin, *first], goes_on, body)[1:]


def _fold(code: Lowering, name: str, dtype: np.dtype, count: int, term: Callable[[Value], Value]) -> Value:
    """The sum of `count` terms, or what else the operation `name` makes of them."""
    start = code.const(_neutral(name, dtype), dtype)

    def add(i: Value, total: Value) -> list[Value]:
        return [code.op(name, dtype, total, term(i))]

    if count <= WINDOW or dtype.kind != "f" or name not in ("add", "mul"):
        return _turns(code, code.const(0, np.int32), code.const(count, np.int32), [start], add)[0]
    windows = -(-count // WINDOW)
    before = (windows * WINDOW - count) // 2  # so much of the first window is empty

    def window(k: Value) -> Value:
        begin = code.plus(code.times(k, WINDOW), -before)
        end = code.op("min", np.int32, code.plus(begin, WINDOW), code.const(count, np.int32))
        begin = code.op("max", np.int32, begin, code.const(0, np.int32))
        return _turns(code, begin, end, [start], add)[0]

    return _fold(code, name, dtype, windows, window)


def _kept(code: Lowering, x: Plain) -> Plain:
    """A result of which each number takes long: large ones are worked out once, and stored."""
    return x if is_small(x.shape) else code.stored(x)


@rule("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "reduce_xor")
def reduce(code: Lowering, equation: Any, x: Plain) -> Plain:
    (shape, dtype), axes = (
        aval_of(equation),
        [int(axis) for axis in equation.params["axes"]],
    )  # `vmap` has NumPy's
    sizes = [x.shape[axis] for axis in axes]
    if len(axes) > 1 and max(sizes) > WINDOW and dtype.kind == "f":
        raise Unsupported("a sum along several long axes is not compiled")

    def at(i: Value) -> Value:
        rest = along_axes(code, i, shape)

        def term(k: Value) -> Value:
            return x.read(flat_index(code, _merged(rest, axes, along_axes(code, k, sizes)), x.shape))

        return _fold(code, OPERATION[equation.primitive.name], dtype, size_of(sizes), term)

    return _kept(code, made_by(code, shape, dtype, at))


def _merged(rest: Sequence[Value], axes: Sequence[int], index: Sequence[Value]) -> list[Value]:
    """The index along all axes: `index` along some of them, `rest` along the others."""
    others, own = iter(rest), dict(zip(axes, index, strict=True))
    return [own[axis] if axis in own else next(others) for axis in range(len(rest) + len(axes))]


@rule("argmax", "argmin")
def place_of_extreme(code: Lowering, equation: Any, x: Plain) -> Plain:
    """The first place of the largest, or least, number; of the first NaN, where there is one."""
    (shape, dtype), (axis,) = aval_of(equation), equation.params["axes"]
    name = "max" if equation.primitive.name == "argmax" else "min"
    better = "gt" if name == "max" else "lt"
    count = code.const(x.shape[axis], np.int32)
    start = [code.const(_neutral(name, x.dtype), x.dtype), code.const(0, np.int32)]

    def at(i: Value) -> Value:
        rest = along_axes(code, i, shape)

        def turn(k: Value, best: Value, place: Value) -> list[Value]:
            new = x.read(flat_index(code, _merged(rest, (axis,), [k]), x.shape))
            stays = code.op("or", bool, code.op(better, bool, best, new), code.op("ne", bool, best, best))
            ties = code.op("and", bool, code.op("eq", bool, best, new), code.op("lt", bool, place, k))
            return [
                code.op("select", x.dtype, stays, new, best),
                code.op("select", np.int32, code.op("or", bool, stays, ties), k, place),
            ]

        return code.op("convert", dtype, _turns(code, code.const(0, np.int32), count, start, turn)[1])

    return _kept(code, made_by(code, shape, dtype, at))


@rule("cumsum", "cumprod", "cummax", "cummin")
def running(code: Lowering, equation: Any, x: Plain) -> Plain:
    """Each number and those before it along an axis, or after it.

    XLA sums real numbers within chunks of 16, and adds the sum of the chunks before.
    """
    p, name = equation.params, OPERATION[equation.primitive.name]
    axis, reverse, count = p["axis"], p["reverse"], x.shape[p["axis"]]
    chunk = CHUNK if name in ("add", "mul") and x.dtype.kind == "f" else max(count, 1)
    if count > chunk * CHUNK:
        raise Unsupported(f"running sums of more than {CHUNK**2} real numbers are not compiled")
    rest = [n for k, n in enumerate(x.shape) if k != axis]
    start = code.const(_neutral(name, x.dtype), x.dtype)

    def number(row: Value, k: Value) -> Value:
        return x.read(place(row, k))

    def place(row: Value, k: Value) -> Value:
        return flat_index(code, _merged(along_axes(code, row, rest), (axis,), [k]), x.shape)

    def fold(begin: Value, end: Value, term: Callable[[Value], Value]) -> Value:
        def turn(k: Value, total: Value) -> list[Value]:
            return [code.op(name, x.dtype, total, term(k))]

        return _turns(code, begin, end, [start], turn)[0]

    def of_the_rest(i: Value) -> Value:
        """The sum from the i-th number on, in the order of the numbers."""
        index = along_axes(code, i, x.shape)
        row = flat_index(code, [*index[:axis], *index[axis + 1 :]], rest)
        own = code.op("div", np.int32, index[axis], code.const(chunk, np.int32))

        def end_of(c: Value) -> Value:
            return code.op("min", np.int32, code.times(code.plus(c, 1), chunk), code.const(count, np.int32))

        def of_chunk(c: Value) -> Value:
            return fold(code.times(c, chunk), end_of(c), lambda k: number(row, k))

        after = fold(code.plus(own, 1), code.const(-(-count // chunk), np.int32), of_chunk)
        return code.op(name, x.dtype, fold(index[axis], end_of(own), lambda k: number(row, k)), after)

    if reverse and chunk == CHUNK:
        return _kept(code, made_by(code, x.shape, x.dtype, of_the_rest))

    def turn(k: Value, own: Value, before: Value, row: Value) -> tuple[Value, Value, Value]:
        """The place of the k-th number, the sum of its chunk so far, and that of the chunks before."""
        at = place(row, code.op("sub", np.int32, code.const(count - 1, np.int32), k) if reverse else k)
        first = code.op("rem", np.int32, k, code.const(chunk, np.int32))
        begins = code.op("eq", bool, first, code.const(0, np.int32))
        before = code.op("select", x.dtype, begins, before, code.op(name, x.dtype, before, own))
        own = code.op("select", x.dtype, begins, own, start)
        return at, code.op(name, x.dtype, own, x.read(at)), before

    if is_small(x.shape):
        values = [start] * size_of(x.shape)
        for row in range(size_of(rest)):
            own, before = start, start
            for k in range(count):
                at, own, before = turn(code.const(k, np.int32), own, before, code.const(row, np.int32))
                values[int(at.number)] = code.op(name, x.dtype, own, before)
        return made_of(code, x.shape, x.dtype, values)
    to = code.empty(x.shape, x.dtype)

    def run(row: Value) -> None:
        def store(k: Value, own: Value, before: Value) -> list[Value]:
            at, own, before = turn(k, own, before, row)
            code.store(to.buffer, at, code.op(name, x.dtype, own, before))
            return [own, before]

        _turns(code, code.const(0, np.int32), code.const(count, np.int32), [start, start], store)

    code.each(size_of(rest), run)
    return to


@rule("dot_general")
def dot_general(code: Lowering, equation: Any, x: Plain, y: Plain) -> Plain:
    """Sums of products; each product is added and rounded at once."""
    (shape, dtype), (contracted, batch) = aval_of(equation), equation.params["dimension_numbers"]
    free = [
        [axis for axis in range(len(z.shape)) if axis not in (*contracted[k], *batch[k])]
        for k, z in enumerate((x, y))
    ]
    sizes = [x.shape[axis] for axis in contracted[0]]

    def at(i: Value) -> Value:
        index = along_axes(code, i, shape)
        n = len(batch[0])
        own = [index[n : n + len(free[0])], index[n + len(free[0]) :]]

        def factor(z: Plain, k: int, inner: list[Value]) -> Value:
            places = dict(
                zip((*batch[k], *free[k], *contracted[k]), (*index[:n], *own[k], *inner), strict=True)
            )
            number = z.read(flat_index(code, [places[axis] for axis in range(len(z.shape))], z.shape))
            return code.op("convert", dtype, number)

        def term(k: Value) -> Value:
            inner = along_axes(code, k, sizes)
            return code.product(factor(x, 0, inner), factor(y, 1, inner))

        return _fold(code, "add", dtype, size_of(sizes), term)

    return _kept(code, made_by(code, shape, dtype, at))
