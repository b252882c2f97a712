"""Reading and writing at an index.

An index is never trusted: it is moved into the array as XLA moves it, or what it asks for is left out, as XLA
leaves it out. (Where its range is known, `emit` drops what is done for that.)
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax import lax

from jaxrl_tab.lanes.arrays import (
    SMALL,
    Known,
    Plain,
    Stored,
    along_axes,
    flat_index,
    is_small,
    made_by,
    made_of,
    size_of,
)
from jaxrl_tab.lanes.code import Value
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.rules.numbers import aval_of


def clamped(code: Lowering, i: Value, most: int) -> Value:
    """The number between 0 and `most` that is nearest to `i`, int32."""
    i = code.op("min", i.dtype, i, code.const(most, i.dtype))
    if i.dtype.kind == "i":
        i = code.op("max", i.dtype, i, code.const(0, i.dtype))
    return code.op("convert", np.int32, i)


def _starts(code: Lowering, x: Plain, index: Sequence[Plain], sizes: Sequence[int]) -> list[Value]:
    """Where a slice begins, along each axis: it is moved into the array."""
    places = zip(index, x.shape, sizes, strict=True)
    return [clamped(code, i.item(0), n - size) for i, n, size in places]


def _offsets(x: Plain, sizes: Sequence[int]) -> np.ndarray:
    """The flat indices of the numbers of a slice, from its first number on."""
    return np.arange(size_of(x.shape)).reshape(x.shape)[tuple(map(slice, sizes))].ravel()


@rule("dynamic_slice")
def dynamic_slice(code: Lowering, equation: Any, x: Plain, *index: Plain) -> Plain:
    sizes = equation.params["slice_sizes"]
    if tuple(sizes) == x.shape:
        return x
    starts = _starts(code, x, index, sizes)
    if isinstance(x, Known) and all(i.op == "const" for i in starts):
        places = (slice(int(i.number), int(i.number) + n) for i, n in zip(starts, sizes, strict=True))
        return Known(x.numbers[tuple(places)], code)
    if is_small(sizes):
        first, offsets = flat_index(code, starts, x.shape), _offsets(x, sizes)
        if isinstance(x, Stored | Known) and 1 < len(offsets) == offsets[-1] + 1:
            return made_of(code, sizes, x.dtype, x.row(first, len(offsets)))
        return made_of(code, sizes, x.dtype, [x.read(code.plus(first, int(k))) for k in offsets])

    def at(i: Value) -> Value:
        steps = zip(starts, along_axes(code, i, sizes), strict=True)
        return x.read(flat_index(code, [code.op("add", np.int32, a, b) for a, b in steps], x.shape))

    return made_by(code, sizes, x.dtype, at)


@rule("dynamic_update_slice")
def dynamic_update_slice(code: Lowering, equation: Any, x: Plain, new: Plain, *index: Plain) -> Plain:
    if new.shape == x.shape:
        return new
    starts = _starts(code, x, index, new.shape)
    first = flat_index(code, starts, x.shape)
    if not is_small(new.shape):
        new = code.in_memory(new)
        to = code.to_change(x)

        def put(i: Value) -> None:
            steps = zip(starts, along_axes(code, i, new.shape), strict=True)
            place = flat_index(code, [code.op("add", np.int32, a, b) for a, b in steps], x.shape)
            code.store(to.buffer, place, new.read(i))

        code.each(size_of(new.shape), put)
        return to
    numbers = [new.item(i) for i in range(size_of(new.shape))]
    places = [code.plus(first, int(k)) for k in _offsets(x, new.shape)]
    if not isinstance(x, Stored) and is_small(x.shape):
        values = [x.item(i) for i in range(size_of(x.shape))]
        for place, number in zip(places, numbers, strict=True):
            values = _replaced(code, values, place, number)
        return made_of(code, x.shape, x.dtype, values)
    to = code.to_change(x)
    for place, number in zip(places, numbers, strict=True):
        code.store_apart(to.buffer, place, number)
    return to


def _replaced(
    code: Lowering, values: Sequence[Value], place: Value, number: Value, inside: Value | None = None
) -> list[Value]:
    """The values with `number` at a place; as they are where `inside` is False."""
    new = []
    for i, old in enumerate(values):
        is_it = code.op("eq", bool, place, code.const(i, place.dtype))
        is_it = is_it if inside is None else code.op("and", bool, is_it, inside)
        new.append(code.op("select", old.dtype, is_it, old, number))
    return new


# --- several places at once -----------------------------------------------------------------------------------


def _split_index(
    code: Lowering, index: list[Value], window_axes: Sequence[int]
) -> tuple[list[Value], list[Value]]:
    """The index along the axes of a window, and along the others."""
    window = [index[axis] for axis in window_axes]
    return window, [i for axis, i in enumerate(index) if axis not in window_axes]


def _window_starts(
    code: Lowering,
    x: Plain,
    index: Plain,
    batch: list[Value],
    axes: Sequence[int],
    batches: Sequence[tuple[int, int]],
) -> list[Value | None]:
    """Where a window begins along each axis of `x`, as it is asked for; None where it is 0.

    Args:
        code, x, index: the code that is written, the array, and the indices: their last axis is one window's.
        batch: which of the windows it is.
        axes: the axes of `x` that the entries of an index belong to.
        batches: the axes of `x` that go along with an axis of `index`: pairs of them.
    """
    starts: list[Value | None] = [None] * len(x.shape)
    for k, axis in enumerate(axes):
        at = flat_index(code, [*batch, code.const(k, np.int32)], index.shape)
        starts[axis] = index.read(at)
    for axis, other in batches:
        starts[axis] = batch[other]
    return starts


def _is_inside(
    code: Lowering, starts: Sequence[Value | None], shape: Sequence[int], sizes: Sequence[int]
) -> Value:
    """Whether a window lies in the array."""
    inside = code.const(True)
    for start, n, size in zip(starts, shape, sizes, strict=True):
        if start is not None:
            below = code.op("le", bool, start, code.const(n - size, start.dtype))
            inside = code.op("and", bool, inside, below)
            if start.dtype.kind == "i":
                above = code.op("ge", bool, start, code.const(0, start.dtype))
                inside = code.op("and", bool, inside, above)
    return inside


def _place(
    code: Lowering,
    starts: Sequence[Value | None],
    offsets: Sequence[Value],
    shape: Sequence[int],
    sizes: Sequence[int],
) -> Value:
    """The flat index of a number of a window, which is moved into the array."""
    axes = []
    for start, offset, n, size in zip(starts, offsets, shape, sizes, strict=True):
        first = code.const(0, np.int32) if start is None else clamped(code, start, n - size)
        if first.number == 0 or offset.number == 0:
            axes.append(offset if first.number == 0 else first)
        else:
            axes.append(code.op("add", np.int32, first, offset))
    return flat_index(code, axes, shape)


def _with_zeros(code: Lowering, window: Sequence[Value], rank: int, left_out: Sequence[int]) -> list[Value]:
    """The index within a window along all axes: 0 along those that it does not have."""
    left = iter(window)
    return [code.const(0, np.int32) if axis in left_out else next(left) for axis in range(rank)]


@rule("gather")
def gather(code: Lowering, equation: Any, x: Plain, index: Plain) -> Plain:
    p, (shape, dtype) = equation.params, aval_of(equation)
    numbers, sizes, mode = p["dimension_numbers"], p["slice_sizes"], p["mode"]
    batches = list(zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True))
    left_out = (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)
    axes = [int(axis) for axis in numbers.start_index_map]  # `vmap` has NumPy's
    filled = mode == lax.GatherScatterMode.FILL_OR_DROP
    filler = code.const(_filler(dtype) if p["fill_value"] is None else p["fill_value"], dtype)
    x, index = code.in_memory(x), code.in_memory(index)

    def at(i: Value) -> Value:
        window, batch = _split_index(code, along_axes(code, i, shape), numbers.offset_dims)
        starts = _window_starts(code, x, index, batch, axes, batches)
        offsets = _with_zeros(code, window, len(x.shape), left_out)
        found = x.read(_place(code, starts, offsets, x.shape, sizes))
        if not filled:
            return found
        return code.op("select", dtype, _is_inside(code, starts, x.shape, sizes), filler, found)

    return made_by(code, shape, dtype, at)


def _filler(dtype: np.dtype) -> Any:
    """What JAX gives for what lies outside: NaN, True, the least number with a sign, the largest without."""
    if dtype.kind in "fb":
        return np.nan if dtype.kind == "f" else True
    return np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max


def _second(code: Lowering, old: Value, new: Value) -> Value:
    return new


def _by(name: str) -> Callable[[Lowering, Value, Value], Value]:
    # XLA adds in a loop of its own, so that a product that is added has been rounded before.
    return lambda code, old, new: code.op(name, old.dtype, code.rounded(old), code.rounded(new))


UPDATES = {
    "scatter": _second,
    "scatter-add": _by("add"),
    "scatter-sub": _by("sub"),
    "scatter-mul": _by("mul"),
    "scatter-max": _by("max"),
    "scatter-min": _by("min"),
}


@rule(*UPDATES)
def scatter(code: Lowering, equation: Any, x: Plain, index: Plain, new: Plain) -> Plain:
    """One number after another: where several have the same place, the last one is written, or all are added."""
    p, update = equation.params, UPDATES[equation.primitive.name]
    numbers, clips = p["dimension_numbers"], p["mode"] == lax.GatherScatterMode.CLIP
    batches = list(zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True))
    left_out = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
    window_sizes = iter([new.shape[axis] for axis in numbers.update_window_dims])
    sizes = [1 if axis in left_out else next(window_sizes) for axis in range(len(x.shape))]

    def target(i: Value) -> tuple[Value, Value]:
        """Where the i-th number goes, and whether it is written at all."""
        window, batch = _split_index(code, along_axes(code, i, new.shape), numbers.update_window_dims)
        starts = _window_starts(code, x, index, batch, numbers.scatter_dims_to_operand_dims, batches)
        place = _place(code, starts, _with_zeros(code, window, len(x.shape), left_out), x.shape, sizes)
        return place, code.const(True) if clips else _is_inside(code, starts, x.shape, sizes)

    count = size_of(new.shape)
    if not size_of(x.shape) or not count:
        return x
    if not isinstance(x, Stored) and is_small(x.shape) and count <= SMALL:
        values = [x.item(i) for i in range(size_of(x.shape))]
        for k in range(count):
            place, inside = target(code.const(k, np.int32))
            changed = [update(code, old, new.item(k)) for old in values]
            values = [
                _replaced(code, [old], code.plus(place, -i), number, inside)[0]
                for i, (old, number) in enumerate(zip(values, changed, strict=True))
            ]
        return made_of(code, x.shape, x.dtype, values)
    index, new = code.in_memory(index), code.in_memory(new)
    to = code.to_change(x)

    def put(i: Value) -> None:
        place, inside = target(i)
        old = to.read_anew(place)
        changed = update(code, old, new.read(i))
        code.store(to.buffer, place, code.op("select", old.dtype, inside, old, changed))

    if count <= SMALL:
        for k in range(count):
            put(code.const(k, np.int32))
    else:
        code.each(count, put)
    return to
