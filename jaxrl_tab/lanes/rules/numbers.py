"""Number by number: arithmetic, comparisons, functions."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax import lax

from jaxrl_tab.lanes.arrays import (
    Array,
    Items,
    Known,
    Lazy,
    Parts,
    Plain,
    is_small,
    made_by,
    size_of,
    stretched,
)
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.functions import FUNCTIONS, Numbers, ordered, round_from_zero, round_to_even
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.scalars import OPERATIONS

# The primitives that are one operation each, and the operations that no primitive has as its name.
NAMES = {name: name for name in OPERATIONS} | {
    "convert_element_type": "convert",
    "bitcast_convert_type": "bitcast",
    "select_n": "select",
}


def impl_of(aval: Any) -> Any:
    """The generator of a key, and None for other numbers. (JAX has no public name for it.)"""
    return getattr(aval.dtype, "_impl", None)


def word_of(aval: Any) -> tuple[np.dtype, int]:
    """The dtype of one word of a number, and how many words it has: see `Parts`."""
    if (impl := impl_of(aval)) is not None:
        return np.dtype(np.uint32), size_of(impl.key_shape)
    return (np.dtype(np.float32), 2) if aval.dtype == np.complex64 else (np.dtype(aval.dtype), 1)


def aval_of(equation: Any) -> tuple[tuple[int, ...], np.dtype]:
    """The shape and the dtype of the result: of each of its words, where a number has two."""
    aval = equation.outvars[0].aval
    return aval.shape, word_of(aval)[0]


def each_number(code: Lowering, equation: Any, write: Callable[..., Value], args: Sequence[Plain]) -> Plain:
    """`write(numbers of the arguments)` for each number of the result."""
    shape, dtype = aval_of(equation)
    args = [x if size_of(x.shape) in (1, size_of(shape)) else stretched(code, shape, x) for x in args]
    # What goes to all places of a large array XLA works out before them.
    alone = (lambda x: x.item(0)) if is_small(shape) else (lambda x: code.rounded(x.item(0)))

    def at(i: Value) -> Value:
        return write(*(alone(x) if size_of(x.shape) == 1 else x.read(i) for x in args))

    single = [x for x in args if size_of(x.shape) == 1]
    in_place = all(isinstance(x, Known | Items) for x in single)
    pointwise = tuple(x for x in args if size_of(x.shape) != 1) if in_place else None
    return made_by(code, shape, dtype, at, args, pointwise)


@rule(*(name for name in NAMES if name not in ("select", "convert", "bitcast", "sign")))
def operation(code: Lowering, equation: Any, first: Plain, *others: Plain) -> Plain:
    name, (shape, dtype), args = NAMES[equation.primitive.name], aval_of(equation), (first, *others)
    if name == "select" and len(args) > 3:
        return _one_of_many(code, equation, *args)
    if first.dtype.kind == "b":
        name = {"max": "or", "min": "and", "mul": "and"}.get(name, name)
    known = OPERATIONS[name].known
    if known is not None and all(isinstance(x, Known) for x in args):
        with np.errstate(all="ignore"):
            numbers = known(dtype, *(x.numbers for x in args if isinstance(x, Known)))
        return Known(np.broadcast_to(numbers, shape).astype(dtype), code)
    if name == "bitcast" and first.dtype.itemsize != dtype.itemsize:
        raise Unsupported(f"the words of {first.dtype.name} as {dtype.name} are not compiled")
    if name == "div" and dtype.kind == "f" and _is_repeated(others[0], shape):
        return each_number(code, equation, lambda x, y: _times_reciprocal(code, x, y), args)
    write = code.choice if name == "select" else lambda *xs: code.op(name, dtype, *xs)
    if name == "pow":  # a whole exponent becomes a real number first
        write = lambda x, y: code.op(name, dtype, x, code.op("convert", dtype, y))
    return each_number(code, equation, write, args)


def _is_repeated(x: Plain, shape: Sequence[int]) -> bool:
    """Whether numbers are used several times each: XLA then multiplies by their reciprocals."""
    return size_of(x.shape) < size_of(shape) or (isinstance(x, Items | Lazy) and x.repeats)


def _times_reciprocal(code: Lowering, x: Value, y: Value) -> Value:
    one = code.const(1, x.dtype)
    return code.op("mul", x.dtype, x, code.op("div", x.dtype, one, y))


def _one_of_many(code: Lowering, equation: Any, which: Plain, *cases: Plain) -> Plain:
    """`cases[which]`, number by number; a number that is out of range is as the nearest that is not."""

    def write(number: Value, *xs: Value) -> Value:
        chosen = xs[0]
        for k, x in enumerate(xs[1:], 1):
            reached = code.op("ge", bool, number, code.const(k, number.dtype))
            chosen = code.op("select", x.dtype, reached, chosen, x)
        return chosen

    return each_number(code, equation, write, (which, *cases))


@rule(*FUNCTIONS)
def function(code: Lowering, equation: Any, *args: Plain) -> Plain:
    formula = FUNCTIONS[equation.primitive.name]
    return each_number(code, equation, lambda *xs: formula(code, *xs), args)


@rule("round")
def round_(code: Lowering, equation: Any, x: Plain) -> Plain:
    to_even = equation.params["rounding_method"] == lax.RoundingMethod.TO_NEAREST_EVEN
    formula = round_to_even if to_even else round_from_zero
    return each_number(code, equation, lambda v: formula(Numbers(code, v)).value, [x])


@rule("add_any")
def add_any(code: Lowering, equation: Any, x: Plain, y: Plain) -> Plain:
    return each_number(code, equation, lambda v, w: code.op("add", v.dtype, v, w), (x, y))


@rule("eq_to", "lt_to", "le_to")
def total_order(code: Lowering, equation: Any, x: Plain, y: Plain) -> Plain:
    """Comparisons in which -0 is below 0, and NaN is above or, with its sign set, below all: those of the words."""

    def key(v: Value) -> Value:
        return ordered(Numbers(code, v)).value if v.dtype.kind == "f" else v

    name = equation.primitive.name.removesuffix("_to")
    return each_number(code, equation, lambda v, w: code.op(name, bool, key(v), key(w)), (x, y))


@rule("square")
def square(code: Lowering, equation: Any, x: Plain) -> Plain:
    return each_number(code, equation, lambda v: code.op("mul", v.dtype, v, v), [x])


@rule("integer_pow")
def integer_power(code: Lowering, equation: Any, x: Plain) -> Plain:
    """By squaring, as XLA does it; 1 / x^n for a power -n."""
    exponent = equation.params["y"]

    def write(v: Value) -> Value:
        power, factor, left = code.const(1, v.dtype), v, abs(exponent)
        first = True
        while left:
            if left & 1:
                power = factor if first else code.op("mul", v.dtype, power, factor)
                first = False
            left >>= 1
            if left:
                factor = code.op("mul", v.dtype, factor, factor)
        return power if exponent >= 0 else code.op("div", v.dtype, code.const(1, v.dtype), power)

    return each_number(code, equation, write, [x])


@rule("clamp")
def clamp(code: Lowering, equation: Any, least: Plain, x: Plain, most: Plain) -> Plain:
    def write(low: Value, v: Value, high: Value) -> Value:
        return code.op("min", v.dtype, code.op("max", v.dtype, low, v), high)

    return each_number(code, equation, write, (least, x, most))


@rule("complex", of_parts=True)
def complex_number(code: Lowering, equation: Any, real: Plain, imag: Plain) -> Parts:
    return Parts((real, imag))


@rule("real", of_parts=True)
def real_part(code: Lowering, equation: Any, x: Parts) -> Array:
    real, _ = x.arrays
    return real


@rule("imag", of_parts=True)
def imaginary_part(code: Lowering, equation: Any, x: Parts) -> Array:
    _, imag = x.arrays
    return imag
