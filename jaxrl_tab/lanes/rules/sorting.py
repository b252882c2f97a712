"""Sorting of small arrays: for each number, those that come before it are counted."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes.arrays import SMALL, Plain, is_small, made_of, size_of
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.functions import Numbers, ordered
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule


def _rows(shape: Sequence[int], axis: int) -> np.ndarray:
    """The flat indices of the numbers of each row along an axis."""
    if not is_small(shape):
        raise Unsupported(f"the sorting of more than {SMALL} numbers is not compiled")
    places = np.arange(size_of(shape)).reshape(shape)
    return np.moveaxis(places, axis, -1).reshape(-1, shape[axis])


def _ranks(code: Lowering, keys: Sequence[Any], is_before: Callable[[Any, Any], Value]) -> list[Value]:
    """The place at which each number comes; of two that are alike, the first stays the first."""
    one, nothing = code.const(1, np.int32), code.const(0, np.int32)
    ranks = [nothing] * len(keys)
    for j in range(len(keys)):
        for i in range(j):
            swapped = is_before(keys[j], keys[i])
            behind = (
                code.op("select", np.int32, swapped, nothing, one),
                code.op("select", np.int32, swapped, one, nothing),
            )
            ranks[i] = code.op("add", np.int32, ranks[i], behind[0])
            ranks[j] = code.op("add", np.int32, ranks[j], behind[1])
    return ranks


def _of_rank(code: Lowering, numbers: Sequence[Value], ranks: Sequence[Value], k: int) -> Value:
    """The number that comes at place k."""
    chosen = numbers[0]
    for number, rank in zip(numbers[1:], ranks[1:], strict=True):
        is_it = code.op("eq", bool, rank, code.const(k, np.int32))
        chosen = code.op("select", number.dtype, is_it, chosen, number)
    return chosen


@rule("sort")
def sort(code: Lowering, equation: Any, *xs: Plain) -> list[Plain]:
    """Several arrays by the first of them, or the first few. NaN comes last."""
    p, shape = equation.params, xs[0].shape

    def is_before(a: Sequence[Value], b: Sequence[Value]) -> Value:
        return _is_before(code, a, b)

    results = [[x.item(i) for i in range(size_of(shape))] for x in xs]
    for row in _rows(shape, p["dimension"]):
        numbers = [[x.item(int(i)) for i in row] for x in xs]
        ranks = _ranks(code, list(zip(*numbers[: p["num_keys"]], strict=True)), is_before)
        for own, result in zip(numbers, results, strict=True):
            for k, place in enumerate(row):
                result[int(place)] = _of_rank(code, own, ranks, k)
    return [made_of(code, shape, x.dtype, result) for x, result in zip(xs, results, strict=True)]


def _is_before(code: Lowering, a: Sequence[Value], b: Sequence[Value]) -> Value:
    """Whether the keys of one come before those of another: by the first, where these are alike by the second."""
    before = code.const(False)
    for x, y in zip(reversed(a), reversed(b), strict=True):
        less, same = code.op("lt", bool, x, y), code.op("eq", bool, x, y)
        if x.dtype.kind == "f":
            x_is_nan, y_is_nan = (code.op("ne", bool, v, v) for v in (x, y))
            less = code.op("or", bool, less, code.op("and", bool, y_is_nan, code.op("not", bool, x_is_nan)))
            same = code.op("or", bool, same, code.op("and", bool, y_is_nan, x_is_nan))
        before = code.op("or", bool, less, code.op("and", bool, same, before))
    return before


@rule("top_k")
def top_k(code: Lowering, equation: Any, x: Plain) -> list[Plain]:
    """The largest numbers along an axis, and their places; NaN counts as the largest, and -0 as below 0."""
    axis, count = equation.params["axis"] % len(x.shape), equation.params["k"]
    numbers: list[Value] = []
    places: list[Value] = []

    def is_before(a: Value, b: Value) -> Value:
        return code.op("gt", bool, a, b)

    for row in _rows(x.shape, axis):
        own = [x.item(int(i)) for i in row]
        keys = [ordered(Numbers(code, v)).value for v in own] if x.dtype.kind == "f" else own
        ranks = _ranks(code, keys, is_before)
        indices = [code.const(i, np.int32) for i in range(len(own))]
        numbers += [_of_rank(code, own, ranks, k) for k in range(count)]
        places += [_of_rank(code, indices, ranks, k) for k in range(count)]
    if axis != len(x.shape) - 1:
        raise Unsupported("top_k along another axis than the last is not compiled")
    shape = (*x.shape[:-1], count)
    return [made_of(code, shape, x.dtype, numbers), made_of(code, shape, np.int32, places)]
