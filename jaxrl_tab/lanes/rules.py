"""What each primitive of JAX means: one rule for each, in terms of single numbers.

A rule takes the code that is written, the equation and its arguments as `arrays`, and gives the result. To add a
primitive: say which number of the result comes from which numbers of the arguments. Its test compares it with XLA.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax

from jaxrl_tab.core import rng
from jaxrl_tab.lanes.arrays import (
    SMALL,
    Known,
    Lazy,
    Pair,
    Stored,
    is_taken_apart,
    made_of,
    reshaped,
    size_of,
)
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.functions import FUNCTIONS
from jaxrl_tab.lanes.lower import Lowering
from jaxrl_tab.lanes.scalars import OPERATIONS

RULES: dict[str, Callable[..., Any]] = {}


def rule(*names: str) -> Callable[[Callable], Callable]:
    def register(function: Callable) -> Callable:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


def _aval(equation: Any) -> tuple[tuple[int, ...], np.dtype]:
    """The shape and the dtype of the result. A key of one word is that word."""
    aval = equation.outvars[0].aval
    return aval.shape, np.dtype(np.uint32) if jax.dtypes.issubdtype(aval.dtype, jax.dtypes.prng_key) else np.dtype(aval.dtype)


# --- number by number ------------------------------------------------------------------------------------

ELEMENTWISE = {
    **{name: name for name in OPERATIONS},
    "convert_element_type": "convert",
    "bitcast_convert_type": "bitcast",
    "select_n": "select",
}


@rule(*(name for name in ELEMENTWISE if name not in ("select", "convert", "bitcast")))
def elementwise(code: Lowering, equation: Any, *args: Any) -> Any:
    shape, dtype = _aval(equation)
    name = ELEMENTWISE[equation.primitive.name]
    if name == "select" and len(args) > 3:
        raise Unsupported("select_n with more than two cases")
    return number_by_number(code, name, shape, dtype, args)


def number_by_number(code: Lowering, name: str, shape: Sequence[int], dtype: Any, args: Sequence[Any]) -> Any:
    shape, dtype = tuple(shape), np.dtype(dtype)
    known = OPERATIONS[name].known
    if known is not None and all(isinstance(x, Known) for x in args):
        with np.errstate(all="ignore"):
            numbers = np.broadcast_to(known(dtype, *(x.numbers for x in args)), shape)
        return Known(numbers.astype(dtype), code)
    args = [x if size_of(x.shape) in (1, size_of(shape)) else _stretched(code, x, shape) for x in args]
    pick = lambda x, i: x.item(0 if size_of(x.shape) == 1 else i)
    read = lambda x, i: x.item(0) if size_of(x.shape) == 1 else x.read(i)
    if is_taken_apart(shape, args):
        values = [code.op(name, dtype, *(pick(x, i) for x in args)) for i in range(size_of(shape))]
        return made_of(code, shape, dtype, values)
    return Lazy(shape, dtype, lambda i: code.op(name, dtype, *(read(x, i) for x in args)), code)


@rule(*FUNCTIONS)
def function(code: Lowering, equation: Any, x: Any) -> Any:
    (shape, dtype), write = _aval(equation), FUNCTIONS[equation.primitive.name]
    if is_taken_apart(shape, [x]):
        return made_of(code, shape, dtype, [write(code, x.item(i)) for i in range(size_of(shape))])
    return Lazy(shape, dtype, lambda i: write(code, x.read(i)), code)


@rule("square")
def square(code: Lowering, equation: Any, x: Any) -> Any:
    return number_by_number(code, "mul", *_aval(equation), (x, x))


@rule("integer_pow")
def integer_power(code: Lowering, equation: Any, x: Any) -> Any:
    shape, dtype = _aval(equation)
    if (power := equation.params["y"]) < 1:
        raise Unsupported("a power below 1")
    found = None
    while power:  # by squaring, as XLA does it
        if power & 1:
            found = x if found is None else number_by_number(code, "mul", shape, dtype, (found, x))
        power >>= 1
        if power:
            x = number_by_number(code, "mul", shape, dtype, (x, x))
    return found


@rule("complex")
def complex_(code: Lowering, equation: Any, real: Any, imag: Any) -> Any:
    return Pair(real, imag)


@rule("real")
def real(code: Lowering, equation: Any, x: Any) -> Any:
    return x.real


@rule("imag")
def imag(code: Lowering, equation: Any, x: Any) -> Any:
    return x.imag


# --- the same numbers at other places ------------------------------------------------------------------------


def moved(code: Lowering, shape: Sequence[int], x: Any, move: Callable[[np.ndarray], np.ndarray], at: Callable) -> Any:
    """The numbers of `x` at other places: `move` does it in NumPy, `at(index) -> index in x` for one number."""
    shape = tuple(shape)
    if isinstance(x, Known):
        return Known(move(x.numbers), code)
    if is_taken_apart(shape, [x]):
        places = move(np.arange(size_of(x.shape)).reshape(x.shape)).ravel()
        return made_of(code, shape, x.dtype, [x.item(int(i)) for i in places])
    return Lazy(shape, x.dtype, lambda i: x.read(at(i)), code)


def _axes(code: Lowering, index: Value, shape: Sequence[int]) -> list[Value]:
    """The index along each axis of a flat index."""
    found = []
    for n in reversed(shape[1:]):
        size = code.const(n, np.int32)
        found.append(code.op("rem", np.int32, index, size) if n > 1 else code.const(0, np.int32))
        index = code.op("div", np.int32, index, size) if n > 1 else index
    return [index, *reversed(found)]


def _flat(code: Lowering, axes: Sequence[Value], shape: Sequence[int]) -> Value:
    flat = code.const(0, np.int32)
    for i, n in zip(axes, shape, strict=True):
        if flat.number is None or flat.number:
            flat = code.op("mul", np.int32, flat, code.const(n, np.int32))
        flat = i if flat.number == 0 else flat if i.number == 0 else code.op("add", np.int32, flat, i)
    return flat


@rule("reshape", "squeeze", "expand_dims", "copy", "stop_gradient")
def reshape(code: Lowering, equation: Any, x: Any) -> Any:
    return reshaped(x, _aval(equation)[0])


@rule("broadcast_in_dim")
def broadcast(code: Lowering, equation: Any, x: Any, *_: Any) -> Any:
    shape, axes = _aval(equation)[0], equation.params["broadcast_dimensions"]
    if size_of(shape) == size_of(x.shape):
        return reshaped(x, shape)
    middle = [1] * len(shape)
    for axis, n in zip(axes, x.shape, strict=True):
        middle[axis] = n
    return _stretched(code, reshaped(x, middle), shape)


def _stretched(code: Lowering, x: Any, shape: Sequence[int]) -> Any:
    """`x` as often as it takes along each axis that has the size 1."""

    def at(i: Value) -> Value:
        if size_of(x.shape) == 1:
            return code.const(0, np.int32)
        axes = zip(_axes(code, i, shape), x.shape, strict=True)
        return _flat(code, [k if n > 1 else code.const(0, np.int32) for k, n in axes], x.shape)

    return moved(code, shape, x, lambda y: np.broadcast_to(y, tuple(shape)), at)


@rule("slice")
def slice_(code: Lowering, equation: Any, x: Any) -> Any:
    shape, p = _aval(equation)[0], equation.params
    strides = p["strides"] or (1,) * len(shape)
    cut = tuple(map(slice, p["start_indices"], p["limit_indices"], strides))

    def at(i: Value) -> Value:
        axes = _axes(code, i, shape)
        scaled = [code.op("mul", np.int32, k, code.const(by, np.int32)) if by > 1 else k for k, by in zip(axes, strides, strict=True)]
        return _flat(code, [code.plus(k, first) for k, first in zip(scaled, p["start_indices"], strict=True)], x.shape)

    return moved(code, shape, x, lambda y: y[cut], at)


@rule("transpose")
def transpose(code: Lowering, equation: Any, x: Any) -> Any:
    shape, axes = _aval(equation)[0], equation.params["permutation"]

    def at(i: Value) -> Value:
        found = dict(zip(axes, _axes(code, i, shape), strict=True))
        return _flat(code, [found[axis] for axis in range(len(shape))], x.shape)

    return moved(code, shape, x, lambda y: np.transpose(y, axes), at)


@rule("iota")
def iota(code: Lowering, equation: Any) -> Any:
    shape, dtype = _aval(equation)
    axis = equation.params["dimension"]
    counted = np.arange(shape[axis]).astype(dtype).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return Known(np.broadcast_to(counted, shape), code)


def _joined(code: Lowering, shape: Sequence[int], dtype: Any, xs: Sequence[Any], join: Callable) -> Any:
    """Several arrays in one, as `join` does it with NumPy arrays."""
    if all(isinstance(x, Known) for x in xs):
        return Known(join([x.numbers for x in xs]), code)
    if size_of(shape) > SMALL:
        raise Unsupported("large arrays that are put together")
    first = np.cumsum([0, *(size_of(x.shape) for x in xs)])
    places = join([start + np.arange(size_of(x.shape)).reshape(x.shape) for start, x in zip(first, xs, strict=False)])
    values = [x.item(i) for x in xs for i in range(size_of(x.shape))]
    return made_of(code, shape, dtype, [values[i] for i in places.ravel()])


@rule("concatenate")
def concatenate(code: Lowering, equation: Any, *xs: Any) -> Any:
    return _joined(code, *_aval(equation), xs, lambda ys: np.concatenate(ys, equation.params["dimension"]))


@rule("stack")
def stack(code: Lowering, equation: Any, *xs: Any) -> Any:
    axis = next(equation.params[name] for name in ("axis", "dimension") if name in equation.params)
    return _joined(code, *_aval(equation), xs, lambda ys: np.stack(ys, axis))


@rule("split")
def split(code: Lowering, equation: Any, x: Any) -> Any:
    axis, ends = equation.params["axis"], np.cumsum(equation.params["sizes"])
    cut = [lambda y, i=i: np.split(y, ends[:-1], axis)[i] for i in range(len(ends))]
    if size_of(x.shape) > SMALL and not isinstance(x, Known):
        raise Unsupported("a large array that is split")
    return [moved(code, v.aval.shape, x, take, _nowhere) for v, take in zip(equation.outvars, cut, strict=True)]


def _nowhere(index: Value) -> Value:
    raise AssertionError("small arrays have no index that is not known")


# --- reading and writing at an index ---------------------------------------------------------------------------


def _first(code: Lowering, x: Any, index: Sequence[Any], sizes: Sequence[int]) -> Value:
    """The flat index of the first number of a slice, which is moved into the array as XLA does it."""
    axes = []
    for i, n, m in zip(index, x.shape, sizes, strict=True):
        value = i.item(0)
        value = code.op("min", value.dtype, value, code.const(n - m, value.dtype))
        if value.dtype.kind == "i":
            value = code.op("max", value.dtype, value, code.const(0, value.dtype))
        axes.append(code.op("convert", np.int32, value))
    return _flat(code, axes, x.shape)


@rule("dynamic_slice")
def dynamic_slice(code: Lowering, equation: Any, x: Any, *index: Any) -> Any:
    sizes = equation.params["slice_sizes"]
    first = _first(code, x, index, sizes)
    if isinstance(x, Known) and first.number is not None:
        at = np.unravel_index(int(first.number), x.shape) if x.shape else ()
        return Known(x.numbers[tuple(slice(i, i + n) for i, n in zip(at, sizes, strict=True))], code)
    offsets = np.arange(size_of(x.shape)).reshape(x.shape)[tuple(map(slice, sizes))].ravel()
    if size_of(sizes) <= SMALL:
        side_by_side = isinstance(x, Stored) and 1 < len(offsets) == offsets[-1] + 1
        return made_of(code, sizes, x.dtype, x.row(first, len(offsets)) if side_by_side else [x.read(code.plus(first, int(k))) for k in offsets])
    if not np.array_equal(offsets, np.arange(len(offsets))):
        raise Unsupported("a large slice of which the numbers do not lie side by side")
    return Lazy(tuple(sizes), x.dtype, lambda k: x.read(code.op("add", np.int32, first, k)), code)


@rule("dynamic_update_slice")
def dynamic_update_slice(code: Lowering, equation: Any, x: Any, new: Any, *index: Any) -> Any:
    first = _first(code, x, index, new.shape)
    if size_of(new.shape) > SMALL:
        raise Unsupported("a large slice that is written")
    offsets = np.arange(size_of(x.shape)).reshape(x.shape)[tuple(map(slice, new.shape))].ravel()
    numbers = [new.item(i) for i in range(len(offsets))]
    if not isinstance(x, Stored) and size_of(x.shape) <= SMALL:
        values = [x.item(i) for i in range(size_of(x.shape))]
        for k, number in zip(offsets, numbers, strict=True):
            at = code.plus(first, int(k))
            values = [code.op("select", x.dtype, code.op("eq", bool, at, code.const(i, np.int32)), old, number) for i, old in enumerate(values)]
        return made_of(code, x.shape, x.dtype, values)
    to = code.to_change(x)
    for k, number in zip(offsets, numbers, strict=True):
        code.store(to.buffer, code.plus(first, int(k)), number)
    return to


@rule("gather")
def gather(code: Lowering, equation: Any, x: Any, index: Any) -> Any:
    if not (isinstance(x, Known) and isinstance(index, Known)):
        raise Unsupported("a gather from what is not known")
    return _by_jax(code, equation, x, index)


def _by_jax(code: Lowering, equation: Any, *args: Any) -> Any:
    """What JAX gives for arrays that are known."""
    return Known(np.asarray(equation.primitive.bind(*(jax.numpy.asarray(x.numbers) for x in args), **equation.params)), code)


# --- sums ------------------------------------------------------------------------------------------------------


def _along(code: Lowering, x: Any, axes: Sequence[int]) -> tuple[list[int], list[list[Value]]]:
    """The numbers of `x` in rows that go along some axes."""
    rest = [axis for axis in range(len(x.shape)) if axis not in axes]
    places = np.arange(size_of(x.shape)).reshape(x.shape).transpose(*rest, *axes)
    rows = places.reshape(size_of([x.shape[axis] for axis in rest]), -1)
    return [x.shape[axis] for axis in rest], [[x.item(int(i)) for i in row] for row in rows]


@rule("reduce_sum", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def reduce(code: Lowering, equation: Any, x: Any) -> Any:
    if size_of(x.shape) > SMALL:
        raise Unsupported("a sum over a large array")
    name = {"sum": "add"}.get(kind := equation.primitive.name.removeprefix("reduce_"), kind)
    shape, rows = _along(code, x, equation.params["axes"])
    return made_of(code, shape, x.dtype, [_folded(code, name, x.dtype, row) for row in rows])


def _folded(code: Lowering, name: str, dtype: Any, values: Sequence[Value]) -> Value:
    total = values[0]
    for value in values[1:]:
        total = code.op(name, dtype, total, value)
    return total


@rule("cumsum")
def cumsum(code: Lowering, equation: Any, x: Any) -> Any:
    if size_of(x.shape) > SMALL or len(x.shape) != 1 or equation.params["reverse"]:
        raise Unsupported("sums along a large array")
    totals = [x.item(0)]
    for i in range(1, x.shape[0]):
        totals.append(code.op("add", x.dtype, totals[-1], x.item(i)))
    return made_of(code, x.shape, x.dtype, totals)


@rule("dot_general")
def dot_general(code: Lowering, equation: Any, x: Any, y: Any) -> Any:
    shape, dtype = _aval(equation)
    if shape != () or len(x.shape) != 1 or x.shape[0] > SMALL:
        raise Unsupported("a product of matrices")
    return made_of(code, (), dtype, [_folded(code, "add", dtype, [code.op("mul", dtype, x.item(i), y.item(i)) for i in range(x.shape[0])])])


# --- loops -----------------------------------------------------------------------------------------------------


@rule("while")
def while_(code: Lowering, equation: Any, *args: Any) -> Any:
    p = equation.params
    of_condition, of_body = args[: p["cond_nconsts"]], args[p["cond_nconsts"] :][: p["body_nconsts"]]
    first = args[p["cond_nconsts"] + p["body_nconsts"] :]
    return code.while_loop(
        first,
        lambda carried: code.closed(p["cond_jaxpr"], *of_condition, *carried)[0].item(0),
        lambda carried: code.closed(p["body_jaxpr"], *of_body, *carried),
    )


@rule("scan")
def scan(code: Lowering, equation: Any, *args: Any) -> Any:
    return code.scan(equation, args)


# --- random numbers ----------------------------------------------------------------------------------------------

_traced: dict[Any, Any] = {}


def _by_tracing(code: Lowering, name: Any, function: Callable, *args: Any) -> Any:
    """What a function of JAX arrays gives, from its own jaxpr."""
    shapes = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in args)
    key = name, tuple((x.shape, x.dtype.name) for x in shapes)
    if key not in _traced:
        _traced[key] = jax.make_jaxpr(function)(*shapes)
    return code.closed(_traced[key], *args)[0]


def _generator(key: Any) -> Any:
    return jax.random.key_impl(jax.random.wrap_key_data(np.zeros(2, np.uint32), impl="threefry2x32")) if key is None else key


@rule("random_wrap")
def random_wrap(code: Lowering, equation: Any, data: Any) -> Any:
    return reshaped(data, data.shape[:-1]) if data.shape[-1] == 1 else data


@rule("random_unwrap")
def random_unwrap(code: Lowering, equation: Any, key: Any) -> Any:
    return reshaped(key, equation.outvars[0].aval.shape)


def _keys(equation: Any) -> Any:
    return equation.invars[0].aval.dtype._impl


@rule("random_bits")
def random_bits(code: Lowering, equation: Any, key: Any) -> Any:
    width, shape = equation.params["bit_width"], tuple(equation.params["shape"])
    impl = _keys(equation)
    if equation.invars[0].aval.shape:
        raise Unsupported("random bits for several keys at once")
    return _by_tracing(code, ("bits", impl.name, width, shape), lambda k: impl.random_bits(k, width, shape), reshaped(key, impl.key_shape))


@rule("random_split")
def random_split(code: Lowering, equation: Any, key: Any) -> Any:
    impl, shape = _keys(equation), tuple(equation.params["shape"])
    keys = _by_tracing(code, ("split", impl.name, shape), lambda k: impl.split(k, shape), reshaped(key, impl.key_shape))
    return reshaped(keys, keys.shape[:-1]) if impl.key_shape == (1,) else keys


@rule("random_fold_in")
def random_fold_in(code: Lowering, equation: Any, key: Any, data: Any) -> Any:
    impl = _keys(equation)
    folded = _by_tracing(code, ("fold", impl.name), impl.fold_in, reshaped(key, impl.key_shape), data)
    return reshaped(folded, ()) if impl.key_shape == (1,) else folded


@rule("threefry2x32")
def threefry(code: Lowering, equation: Any, *args: Any) -> Any:
    """JAX's own primitive is the same function as `rng.threefry`."""
    shape = equation.outvars[0].aval.shape
    shapes = tuple(jax.ShapeDtypeStruct(x.shape, np.uint32) for x in args)
    closed = jax.make_jaxpr(lambda k0, k1, x0, x1: tuple(lax.broadcast_in_dim(y, shape, range(len(shape))) for y in rng.threefry((k0, k1), x0, x1)))(*shapes)
    return code.closed(closed, *args)





@rule("iota_2x32_shape")
def counts(code: Lowering, equation: Any) -> Any:
    """How JAX counts for its generator: 0, 1, ... in two words, the upper and the lower."""
    shape = tuple(equation.params["shape"])
    counted = np.arange(size_of(shape), dtype=np.uint64).reshape(shape)
    return [Known((counted >> np.uint64(32)).astype(np.uint32), code), Known(counted.astype(np.uint32), code)]
