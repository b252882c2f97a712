"""Functions that no instruction gives, in terms of those that do: the same steps as XLA's CPU backend takes.

So they have the same bits. The approximations are those of Cephes (Moshier): `exp`, `log`, `log1p`; and of Giles
(2012, Approximating the erfinv function). All are of 32 bits; numbers of 64 bits are not compiled.
"""

from collections.abc import Callable

import numpy as np

from jaxrl_tab.lanes.code import Builder, Unsupported, Value

FUNCTIONS: dict[str, Callable[[Builder, Value], Value]] = {}


class Numbers:
    """A value with the operators of Python, so that a formula reads like one. Other operands are constants."""

    def __init__(self, code: Builder, value: Value):
        self.code, self.value = code, value

    def _with(
        self, name: str, other: "Numbers | float", turned: bool = False, dtype: type | None = None
    ) -> "Numbers":
        y = other.value if isinstance(other, Numbers) else self.code.const(other, self.value.dtype)
        args = (y, self.value) if turned else (self.value, y)
        return Numbers(self.code, self.code.op(name, dtype or self.value.dtype, *args))

    def __add__(self, y: "Numbers | float") -> "Numbers":
        return self._with("add", y)

    def __radd__(self, y: float) -> "Numbers":
        return self._with("add", y, turned=True)

    def __sub__(self, y: "Numbers | float") -> "Numbers":
        return self._with("sub", y)

    def __mul__(self, y: "Numbers | float") -> "Numbers":
        return self._with("mul", y)

    def __rmul__(self, y: float) -> "Numbers":
        return self._with("mul", y, turned=True)

    def __truediv__(self, y: "Numbers | float") -> "Numbers":
        return self._with("div", y)

    def __and__(self, y: "Numbers | int") -> "Numbers":
        return self._with("and", y)

    def __or__(self, y: "Numbers | int") -> "Numbers":
        return self._with("or", y)

    def __xor__(self, y: "Numbers | int") -> "Numbers":
        return self._with("xor", y)

    def __lshift__(self, y: "Numbers | int") -> "Numbers":
        return self._with("shift_left", y)

    def __rshift__(self, y: "Numbers | int") -> "Numbers":
        return self._with("shift_right_logical", y)

    def __neg__(self) -> "Numbers":
        return self.apply("neg")

    def compare(self, name: str, y: "Numbers | float") -> "Numbers":
        return self._with(name, y, dtype=bool)

    def apply(self, name: str, dtype: type | None = None) -> "Numbers":
        return Numbers(self.code, self.code.op(name, dtype or self.value.dtype, self.value))

    def where(self, yes: "Numbers | float", no: "Numbers | float") -> "Numbers":
        """`yes` where this is True, and else `no`."""
        like = next(x.value.dtype for x in (yes, no) if isinstance(x, Numbers))
        yes, no = (
            x if isinstance(x, Numbers) else Numbers(self.code, self.code.const(x, like)) for x in (yes, no)
        )
        return Numbers(self.code, self.code.op("select", like, self.value, no.value, yes.value))

    def at_least(self, least: float) -> "Numbers":
        """NaN stays NaN."""
        return (self.compare("lt", least)).where(least, self)

    def at_most(self, most: float) -> "Numbers":
        return (self.compare("gt", most)).where(most, self)


def function(name: str) -> Callable[[Callable[[Numbers], Numbers]], Callable[[Numbers], Numbers]]:
    def register(formula: Callable[[Numbers], Numbers]) -> Callable[[Numbers], Numbers]:
        def write(code: Builder, x: Value) -> Value:
            if x.dtype != np.float32:
                raise Unsupported(f"{name} of {x.dtype}")
            return formula(Numbers(code, x)).value

        FUNCTIONS[name] = write
        return formula

    return register


def _bits(word: int) -> float:
    """The number with these bits."""
    return float(np.uint32(word).view(np.float32))


def _polynomial(x: Numbers, first: "Numbers | float", *rest: int) -> Numbers:
    """((first x + rest[0]) x + rest[1]) ..., the coefficients given by their bits."""
    total = x * first if not isinstance(first, Numbers) else first * x
    for k, coefficient in enumerate(rest):
        total = _bits(coefficient) + total
        if k + 1 < len(rest):
            total = total * x
    return total


@function("exp")
def exp(x: Numbers) -> Numbers:
    x = x.at_least(-87.8).at_most(88.8)
    n = (0.5 + x * _bits(0x3FB8AA3B)).apply("floor").at_least(-127.0).at_most(127.0)
    r = x - _bits(0x3F318000) * n - _bits(0xB95E8083) * n
    series = _polynomial(r, _bits(0x39506967), 0x3AB743CE, 0x3C088908, 0x3D2AA9C1, 0x3E2AAAAA, 0x3F000000)
    power = 1.0 + (r + series * (r * r))
    scale = Numbers(
        x.code,
        x.code.op(
            "shift_left", np.int32, (n.apply("convert", np.int32) + 127).value, x.code.const(23, np.int32)
        ),
    )
    return power * scale.apply("bitcast", np.float32)


@function("log")
def log(x: Numbers) -> Numbers:
    code = x.code
    tiny = _bits(0x00800000)
    positive = x.compare("gt", tiny).where(x, tiny)
    word = positive.apply("bitcast", np.int32)
    half = ((word & -2139095041) | 1056964608).apply("bitcast", np.float32)
    exponent = Numbers(code, code.op("shift_right_logical", np.int32, word.value, code.const(23, np.int32)))
    e = 1.0 + (exponent - 127).apply("convert", np.float32)
    small = half.compare("lt", _bits(0x3F3504F3))
    z = (half - 1.0) + small.where(half, 0.0)
    e = e - small.where(Numbers(code, code.const(1.0, np.float32)), 0.0)
    z2 = z * z
    z3 = z2 * z
    a = _polynomial(z, _bits(0x3D9021BB), 0xBDEBD1B8, 0x3DEF251A)
    b = _polynomial(z, _bits(0xBDFE5D4F), 0x3E11E9BF, 0xBE2AAE50)
    c = _polynomial(z, _bits(0x3E4CCEAC), 0xBE7FFFFC, 0x3EAAAAAA)
    series = (c + (b + a * z3) * z3) * z3 + _bits(0xB95E8083) * e
    found = ((z - 0.5 * z2) + series) + _bits(0x3F318000) * e
    found = x.compare("lt", 0.0).where(np.nan, found)
    found = x.compare("eq", 0.0).where(-np.inf, found)
    found = x.compare("eq", np.inf).where(np.inf, found)
    return x.compare("ne", x).where(x, found)


@function("log1p")
def log1p(x: Numbers) -> Numbers:
    square = x * x
    nothing = x * 0.0
    below = _polynomial(
        x, nothing + 1.0, 0x417101AD, 0x42A6185B, 0x435DC32D, 0x439A8CA3, 0x43586D8A, 0x42707982
    )
    first = nothing + _bits(0x383DE04B)
    above = _polynomial(x, first, 0x3EFF40C5, 0x40D284FA, 0x41EF4B9C, 0x4273CC76, 0x426473AD, 0x41A05101)
    near = x + (square * -0.5 + (x * square) * (above / below))
    return x.apply("abs").compare("lt", _bits(0x3ED413CD)).where(near, log(x + 1.0))


@function("erf_inv")
def erf_inv(x: Numbers) -> Numbers:
    w = -log1p(x * -x)
    middle = w.compare("lt", 5.0)
    at = middle.where(w + -2.5, w.apply("sqrt") + -3.0)
    pairs = [
        (0x32F16588, 0xB951F09B), (0x34B84B36, 0x38D3B56B), (0xB66C7357, 0x3AB0DC72), (0xB6935AC1, 0xBB70BDE7),
        (0x396532DB, 0x3BBC127B), (0xBAA45408, 0xBBF9C5D7), (0xBB88E4EF, 0x3C1AA57E), (0x3E7C8F63, 0x3F8036DB),
        (0x3FC02E2F, 0x40354F7E),
    ]  # fmt: skip
    either = [middle.where(Numbers(x.code, x.code.const(_bits(a), np.float32)), _bits(b)) for a, b in pairs]
    total = either[0]
    for coefficient in either[1:]:
        total = coefficient + total * at
    return x.apply("abs").compare("eq", 1.0).where(x * np.inf, total * x)
