"""The same numbers at other places: reshape, slice, concatenate."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes.arrays import (
    Known,
    Plain,
    along_axes,
    flat_index,
    made_by,
    moved,
    reshaped,
    size_of,
    stretched,
)
from jaxrl_tab.lanes.code import Value
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.rules.numbers import aval_of


@rule("reshape", "squeeze", "copy", "stop_gradient", "optimization_barrier")
def reshape(code: Lowering, equation: Any, *xs: Plain) -> Any:
    if equation.primitive.multiple_results:
        return xs
    return reshaped(xs[0], aval_of(equation)[0])


@rule("broadcast_in_dim")
def broadcast_in_dim(code: Lowering, equation: Any, x: Plain, *_: Plain) -> Plain:
    shape, axes = aval_of(equation)[0], equation.params["broadcast_dimensions"]
    if size_of(shape) == size_of(x.shape):
        return reshaped(x, shape)
    middle = [1] * len(shape)
    for axis, n in zip(axes, x.shape, strict=True):
        middle[axis] = n
    return stretched(code, shape, reshaped(x, middle))


@rule("tile")
def tile(code: Lowering, equation: Any, x: Plain) -> Plain:
    shape, times = aval_of(equation)[0], equation.params["reps"]

    def at(index: list[Value]) -> list[Value]:
        return [
            code.op("rem", np.int32, i, code.const(n, np.int32)) for i, n in zip(index, x.shape, strict=True)
        ]

    return moved(code, shape, x, lambda y: np.tile(y, times), at)


@rule("slice")
def slice_(code: Lowering, equation: Any, x: Plain) -> Plain:
    p = equation.params
    strides = p["strides"] or (1,) * len(x.shape)
    cut = tuple(map(slice, p["start_indices"], p["limit_indices"], strides))

    def at(index: list[Value]) -> list[Value]:
        steps = zip(index, strides, p["start_indices"], strict=True)
        return [code.plus(code.times(i, by), first) for i, by, first in steps]

    return moved(code, aval_of(equation)[0], x, lambda y: y[cut], at)


@rule("transpose")
def transpose(code: Lowering, equation: Any, x: Plain) -> Plain:
    axes = equation.params["permutation"]

    def at(index: list[Value]) -> list[Value]:
        return [index[axes.index(axis)] for axis in range(len(axes))]

    return moved(code, aval_of(equation)[0], x, lambda y: np.transpose(y, axes), at)


@rule("rev")
def reverse(code: Lowering, equation: Any, x: Plain) -> Plain:
    axes = equation.params["dimensions"]

    def at(index: list[Value]) -> list[Value]:
        last = [code.const(n - 1, np.int32) for n in x.shape]
        turned = [code.op("sub", np.int32, n, i) for n, i in zip(last, index, strict=True)]
        return [turned[axis] if axis in axes else i for axis, i in enumerate(index)]

    return moved(code, x.shape, x, lambda y: np.flip(y, axes), at)


@rule("empty")
def empty(code: Lowering, equation: Any) -> Plain:
    """An array that is written before it is read."""
    shape, dtype = aval_of(equation)
    return Known(np.zeros(shape, dtype), code)


@rule("iota")
def iota(code: Lowering, equation: Any) -> Plain:
    shape, dtype = aval_of(equation)
    axis = equation.params["dimension"]
    counted = np.arange(shape[axis]).astype(dtype)
    return Known(
        np.broadcast_to(counted.reshape([-1 if i == axis else 1 for i in range(len(shape))]), shape), code
    )


def joined(code: Lowering, shape: Sequence[int], axis: int, xs: Sequence[Plain]) -> Plain:
    """Arrays one after another along an axis."""
    if all(isinstance(x, Known) for x in xs):
        return Known(np.concatenate([x.numbers for x in xs if isinstance(x, Known)], axis), code)
    xs = [x for x in xs if size_of(x.shape)]

    def at(i: Value) -> Value:
        index = along_axes(code, i, shape)
        first, found = 0, None
        for x in (
            xs
        ):  # each is read at a place that it has, and the last one that begins before the index is taken
            own = code.plus(index[axis], -first)
            if len(xs) > 1:
                own = code.op("max", np.int32, own, code.const(0, np.int32))
                own = code.op("min", np.int32, own, code.const(x.shape[axis] - 1, np.int32))
            number = x.read(flat_index(code, [*index[:axis], own, *index[axis + 1 :]], x.shape))
            reached = code.op("ge", bool, index[axis], code.const(first, np.int32))
            found = number if found is None else code.op("select", x.dtype, reached, found, number)
            first += x.shape[axis]
        assert found is not None
        return found

    return made_by(code, shape, xs[0].dtype, at)


@rule("concatenate")
def concatenate(code: Lowering, equation: Any, *xs: Plain) -> Plain:
    return joined(code, aval_of(equation)[0], equation.params["dimension"], xs)


@rule("stack")
def stack(code: Lowering, equation: Any, *xs: Plain) -> Plain:
    p, shape = equation.params, aval_of(equation)[0]
    axis = p["axis"] if "axis" in p else p["dimension"]
    row = [1 if i == axis else n for i, n in enumerate(shape)]
    return joined(code, shape, axis, [reshaped(x, row) for x in xs])


def cut_out(code: Lowering, x: Plain, axis: int, first: int, shape: Sequence[int]) -> Plain:
    """The part of `x` that begins at `first`, along an axis; `shape` has the axes of `x`."""
    place = tuple(slice(first, first + shape[axis]) if i == axis else slice(None) for i in range(len(shape)))

    def at(index: list[Value]) -> list[Value]:
        return [code.plus(i, first) if k == axis else i for k, i in enumerate(index)]

    return moved(code, shape, x, lambda y: y[place], at)


@rule("split")
def split(code: Lowering, equation: Any, x: Plain) -> list[Plain]:
    p = equation.params
    firsts = np.cumsum([0, *p["sizes"]])[:-1]
    shapes = [v.aval.shape for v in equation.outvars]
    return [cut_out(code, x, p["axis"], int(i), shape) for i, shape in zip(firsts, shapes, strict=True)]


@rule("unstack")
def unstack(code: Lowering, equation: Any, x: Plain) -> list[Plain]:
    axis = equation.params["axis"]
    shape = [1 if i == axis else n for i, n in enumerate(x.shape)]
    rows = [cut_out(code, x, axis, i, shape) for i in range(x.shape[axis])]
    return [reshaped(row, v.aval.shape) for row, v in zip(rows, equation.outvars, strict=True)]


@rule("pad")
def pad(code: Lowering, equation: Any, x: Plain, filler: Plain) -> Plain:
    shape, config = aval_of(equation)[0], equation.params["padding_config"]

    def at(i: Value) -> Value:
        inside, own = code.const(True), []
        for k, n, (low, _, between) in zip(along_axes(code, i, shape), x.shape, config, strict=True):
            k, step = code.plus(k, -low), code.const(between + 1, np.int32)
            place = code.op("div", np.int32, k, step)
            whole = code.op("eq", bool, code.op("rem", np.int32, k, step), code.const(0, np.int32))
            above = code.op("ge", bool, k, code.const(0, np.int32))
            below = code.op("lt", bool, place, code.const(n, np.int32))
            for condition in (whole, above, below):
                inside = code.op("and", bool, inside, condition)
            place = code.op("max", np.int32, place, code.const(0, np.int32))
            own.append(code.op("min", np.int32, place, code.const(n - 1, np.int32)))
        if not size_of(x.shape):
            return filler.item(0)
        return code.op("select", x.dtype, inside, filler.item(0), x.read(flat_index(code, own, x.shape)))

    return made_by(code, shape, x.dtype, at)
