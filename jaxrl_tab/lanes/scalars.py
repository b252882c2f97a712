"""The operations on single numbers: what they mean where the numbers are known, and how LLVM writes them.

Their meaning at the edges is XLA's, on all platforms: whole numbers wrap; x / 0 is -1 and x % 0 is x; a shift by
the width or more gives 0, or the sign; max and min give NaN where either is; a real number that no int holds
becomes the nearest one, and NaN becomes 0.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

DTYPES = ("bool", "int32", "uint32", "float32")  # the numbers that are compiled


@dataclass(frozen=True)
class Operation:
    """One operation.

    Attributes:
        known: (dtype of the result, numbers) -> the result, in NumPy; None where it is left to the machine.
        simplify: (builder, dtype, arguments) -> a value that is the same at once, or None.
    """

    known: Callable[..., Any] | None
    simplify: Callable[..., Any] | None = None


def _divided(_: Any, x: Any, y: Any) -> Any:
    if x.dtype.kind == "f":
        return x / y
    quotient = np.abs(x.astype(object)) // np.abs(np.where(y == 0, 1, y).astype(object))
    signed = np.where((x < 0) == (y < 0), quotient, -quotient)
    return np.where(y == 0, -1, signed).astype(np.int64).astype(x.dtype)


def _remainder(_: Any, x: Any, y: Any) -> Any:
    return np.fmod(x, y) if x.dtype.kind == "f" else np.where(y == 0, x, np.fmod(x, np.where(y == 0, 1, y)))


def _shift(shift: Callable, beyond: Callable) -> Callable:
    def known(_: Any, x: Any, by: Any) -> Any:
        bits = 8 * x.dtype.itemsize
        inside = (by >= 0) & (by < bits)
        return np.where(inside, shift(x, np.where(inside, by, 0).astype(x.dtype)), beyond(x, bits))

    return known


def _logical(x: Any, by: Any) -> Any:
    unsigned = np.dtype(f"u{x.dtype.itemsize}")
    return (x.astype(unsigned) >> by.astype(unsigned)).astype(x.dtype)


def _converted(dtype: np.dtype, x: Any) -> Any:
    if dtype.kind == "b":
        return x != 0
    if dtype.kind in "iu" and x.dtype.kind == "f":
        info, wide = (
            np.iinfo(dtype),
            np.nan_to_num(np.trunc(x.astype(np.float64)), nan=0, posinf=1e300, neginf=-1e300),
        )
        inside = np.clip(wide, info.min, info.max)
        return np.where(wide >= info.max, info.max, inside.astype(np.int64)).astype(dtype)
    return x.astype(dtype)


def _rounded(function: Callable[[Any], Any]) -> Callable[..., Any]:
    """A function by its float64, rounded: NumPy's own of float32 is another one than that of the C library."""
    return lambda dtype, x: function(x.astype(np.float64)).astype(dtype)


def _same_dtype(_: Any, dtype: np.dtype, args: Any) -> Any:
    return args[0] if args[0].dtype == dtype else None


def _selected(_: Any, dtype: np.dtype, args: Any) -> Any:
    which, no, yes = args
    if no is yes:
        return no
    return None if which.number is None else (yes if which.number else no)


def _by_constant(code: Any, dtype: np.dtype, args: Any) -> Any:
    """XLA multiplies by the reciprocal of a constant."""
    x, y = args
    if dtype.kind != "f" or y.op != "const" or x.op == "const":
        return None
    with np.errstate(all="ignore"):
        return code.op("mul", dtype, x, code.const(1 / y.number, dtype))


def _of_one_choice(name: str) -> Callable[..., Any]:
    """Two numbers that are chosen by the same condition are added before it, if one of the sums is known.

    LLVM does that in XLA's code, and a product among them is then fused with the sum.
    """

    def simplify(code: Any, dtype: np.dtype, args: Any) -> Any:
        if dtype.kind != "f" or not all(x.op == "select" for x in args):
            return None
        (which, no, yes), (other, no_more, yes_more) = (x.args for x in args)
        if which is not other or not any(
            x.op == y.op == "const" for x, y in ((no, no_more), (yes, yes_more))
        ):
            return None
        either = (code.op(name, dtype, no, no_more), code.op(name, dtype, yes, yes_more))
        return code.op("select", dtype, which, *either)

    return simplify


OPERATIONS: dict[str, Operation] = {
    **{
        name: Operation(
            lambda _, *x, f=function: f(*x), _of_one_choice(name) if name in ("add", "sub") else None
        )
        for name, function in {
            "add": np.add,
            "sub": np.subtract,
            "mul": np.multiply,
            "neg": np.negative,
            "and": np.bitwise_and,
            "or": np.bitwise_or,
            "xor": np.bitwise_xor,
            "not": np.invert,
            "eq": np.equal,
            "ne": np.not_equal,
            "lt": np.less,
            "le": np.less_equal,
            "gt": np.greater,
            "ge": np.greater_equal,
            "max": np.maximum,
            "min": np.minimum,
            "sign": np.sign,
            "abs": np.abs,
            "floor": np.floor,
            "ceil": np.ceil,
            "sqrt": np.sqrt,
            "is_finite": np.isfinite,
        }.items()
    },
    "div": Operation(_divided, _by_constant),
    "rem": Operation(_remainder),
    "shift_left": Operation(_shift(np.left_shift, lambda x, _: x.dtype.type(0))),
    "shift_right_logical": Operation(_shift(_logical, lambda x, _: x.dtype.type(0))),
    "shift_right_arithmetic": Operation(_shift(np.right_shift, lambda x, bits: x >> x.dtype.type(bits - 1))),
    "select": Operation(
        lambda _, which, no, yes: np.where(which, yes, no), _selected
    ),  # no where it is False
    "convert": Operation(_converted, _same_dtype),
    "bitcast": Operation(lambda dtype, x: x.view(dtype), _same_dtype),
    "pow": Operation(lambda dtype, x, y: np.power(x, np.asarray(y, dtype))),
    **{name: Operation(_rounded(function)) for name, function in (("sin", np.sin), ("cos", np.cos))},
}
