"""Along axes: sums, products, maxima, running sums, sorting."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes.arrays import Plain, is_small, made_of, size_of
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.rules.numbers import aval_of


def _along(code: Lowering, x: Plain, axes: Sequence[int]) -> tuple[list[int], list[list[Value]]]:
    """The numbers of `x` in rows that go along some axes."""
    rest = [axis for axis in range(len(x.shape)) if axis not in axes]
    places = np.arange(size_of(x.shape)).reshape(x.shape).transpose(*rest, *axes)
    rows = places.reshape(size_of([x.shape[axis] for axis in rest]), -1)
    return [x.shape[axis] for axis in rest], [[x.item(int(i)) for i in row] for row in rows]


@rule("reduce_sum", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def reduce(code: Lowering, equation: Any, x: Plain) -> Plain:
    if not is_small(x.shape):
        raise Unsupported("a sum over a large array")
    kind = equation.primitive.name.removeprefix("reduce_")
    shape, rows = _along(code, x, equation.params["axes"])
    return made_of(
        code, shape, x.dtype, [_folded(code, "add" if kind == "sum" else kind, row) for row in rows]
    )


def _folded(code: Lowering, name: str, values: Sequence[Value]) -> Value:
    total = values[0]
    for value in values[1:]:
        total = code.op(name, total.dtype, total, value)
    return total


@rule("cumsum")
def cumsum(code: Lowering, equation: Any, x: Plain) -> Plain:
    if not is_small(x.shape) or len(x.shape) != 1 or equation.params["reverse"]:
        raise Unsupported("sums along a large array")
    totals = [x.item(0)]
    for i in range(1, x.shape[0]):
        totals.append(code.op("add", x.dtype, totals[-1], x.item(i)))
    return made_of(code, x.shape, x.dtype, totals)


@rule("dot_general")
def dot_general(code: Lowering, equation: Any, x: Plain, y: Plain) -> Plain:
    shape, dtype = aval_of(equation)
    if shape != () or len(x.shape) != 1 or not is_small(x.shape):
        raise Unsupported("a product of matrices")
    products = [code.op("mul", dtype, x.item(i), y.item(i)) for i in range(x.shape[0])]
    return made_of(code, (), dtype, [_folded(code, "add", products)])
