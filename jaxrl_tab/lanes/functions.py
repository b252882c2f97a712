"""Functions that no instruction gives, in terms of those that do: the same steps as XLA's CPU backend takes.

So they have the same bits; where a version of jaxlib takes other steps, those are here as well. The approximations are
those of Cephes (Moshier): `exp`, `log`, `log1p`; and of Giles (2012, Approximating the erfinv function). All are of 32
bits; numbers of 64 bits are not compiled.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from jaxrl_tab.lanes.code import Builder, Unsupported, Value
from jaxrl_tab.lanes.versions import JAXLIB

FUNCTIONS: dict[str, Callable[[Builder, Value], Value]] = {}

Formula: TypeAlias = "Callable[[Numbers], Numbers]"


class Numbers:
    """A value with the operators of Python, so that a formula reads like one. Other operands are constants."""

    def __init__(self, code: Builder, value: Value):
        self.code, self.value = code, value

    def _with(
        self, name: str, other: "Numbers | float", turned: bool = False, dtype: type | None = None
    ) -> "Numbers":
        y = (other if isinstance(other, Numbers) else self.const(other)).value
        args = (y, self.value) if turned else (self.value, y)
        return Numbers(self.code, self.code.op(name, dtype or self.value.dtype, *args))

    def const(self, number: float) -> "Numbers":
        """A constant of the same dtype."""
        return Numbers(self.code, self.code.const(number, self.value.dtype))

    def __add__(self, y: "Numbers | float") -> "Numbers":
        return self._with("add", y)

    def __radd__(self, y: float) -> "Numbers":
        return self._with("add", y, turned=True)

    def __sub__(self, y: "Numbers | float") -> "Numbers":
        return self._with("sub", y)

    def __rsub__(self, y: float) -> "Numbers":
        return self._with("sub", y, turned=True)

    def __mul__(self, y: "Numbers | float") -> "Numbers":
        return self._with("mul", y)

    def __rmul__(self, y: float) -> "Numbers":
        return self._with("mul", y, turned=True)

    def __truediv__(self, y: "Numbers | float") -> "Numbers":
        return self._with("div", y)

    def __rtruediv__(self, y: float) -> "Numbers":
        return self._with("div", y, turned=True)

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
        like = next(x for x in (yes, no) if isinstance(x, Numbers))
        one, other = (x if isinstance(x, Numbers) else like.const(x) for x in (yes, no))
        chosen = self.code.op("select", like.value.dtype, self.value, other.value, one.value)
        return Numbers(self.code, chosen)

    def with_sign_of(self, y: "Numbers") -> "Numbers":
        """The real number of this size with the sign of `y`."""
        size = self.apply("bitcast", np.uint32) & 0x7FFFFFFF
        return (size | y.apply("bitcast", np.uint32) & 0x80000000).apply("bitcast", np.float32)

    def at_least(self, least: float) -> "Numbers":
        """NaN stays NaN."""
        return (self.compare("lt", least)).where(least, self)

    def at_most(self, most: float) -> "Numbers":
        return (self.compare("gt", most)).where(most, self)


def function(name: str, kinds: str = "f") -> Callable[[Formula], Formula]:
    """Makes a formula the meaning of a primitive, for numbers of some kinds (as NumPy calls them)."""

    def register(formula: Formula) -> Formula:
        def write(code: Builder, x: Value) -> Value:
            if x.dtype.kind not in kinds:
                raise Unsupported(f"{name} of numbers of the type {x.dtype.name} is not compiled")
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
    most, log_2, rest = (
        (128.0, 0x3F317200, 0x35BFBE8E) if JAXLIB >= (0, 11) else (127.0, 0x3F318000, 0xB95E8083)
    )
    x = x.at_least(-87.8).at_most(88.8)
    n = (0.5 + x * _bits(0x3FB8AA3B)).apply("floor").at_least(-127.0).at_most(most)
    r = x - _bits(log_2) * n - _bits(rest) * n
    series = _polynomial(r, _bits(0x39506967), 0x3AB743CE, 0x3C088908, 0x3D2AA9C1, 0x3E2AAAAA, 0x3F000000)
    power = 1.0 + (r + series * (r * r))
    scale = (n.apply("convert", np.int32) + 127) << 23
    if JAXLIB >= (0, 11):  # 2^128 is not a number: 2^127, and the power twice, in its bits
        below = scale.at_most(0x7F000000)
        power = (power.apply("bitcast", np.int32) + (scale - below)).apply("bitcast", np.float32)
        scale = below
    return power * scale.apply("bitcast", np.float32)


@function("log")
def log(x: Numbers) -> Numbers:
    tiny = _bits(0x00800000)
    positive = x.compare("gt", tiny).where(x, tiny)
    word = positive.apply("bitcast", np.int32)
    half = ((word & ~0x7F800000) | 0x3F000000).apply("bitcast", np.float32)
    e = 1.0 + ((word >> 23) - 127).apply("convert", np.float32)
    small = half.compare("lt", _bits(0x3F3504F3))
    z = (half - 1.0) + small.where(half, 0.0)
    e = e - small.where(x.const(1.0), 0.0)
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
    either = [middle.where(x.const(_bits(a)), _bits(b)) for a, b in pairs]
    total = either[0]
    for coefficient in either[1:]:
        total = coefficient + total * at
    return x.apply("abs").compare("eq", 1.0).where(x * np.inf, total * x)


@function("tanh")
def tanh(x: Numbers) -> Numbers:
    size = x.apply("abs")
    near = x.at_least(_bits(0xC0FFF644)).at_most(_bits(0x40FFF644))
    square = near * near
    above = _polynomial(
        square, _bits(0xA59F25C0), 0x2A61337E, 0xAEBD37FF, 0x335C0041, 0x3779434A, 0x3A270DED, 0x3BA059DC
    )
    below = _polynomial(square, _bits(0x35A0D3D8), 0x38F895D6, 0x3B14AA05, 0x3BA059DD)
    found = size.compare("lt", 4e-4).where(x, (near * above) / below)
    return size.compare("ge", 20.0).where(x.const(1.0).with_sign_of(x), found)


@function("logistic")
def logistic(x: Numbers) -> Numbers:
    return 1.0 / (exp(-x) + 1.0)


@function("exp2")
def exp2(x: Numbers) -> Numbers:
    return exp(x * _bits(0x3F317218))


@function("expm1")
def expm1(x: Numbers) -> Numbers:
    if JAXLIB >= (0, 12):
        raise Unsupported("expm1 of jaxlib 0.12 or newer is not compiled")
    half, power = x * 0.5, exp(x)
    found = x.apply("abs").compare("gt", 0.5).where(power - 1.0, tanh(half) * (power + 1.0))
    return half.compare("eq", 0.0).where(x, found)


@function("erf")
def erf(x: Numbers) -> Numbers:
    square = x * x
    above = _polynomial(square, _bits(0x39702D51), 0x3B5F5DA2, 0x3D50B6EB, 0x3E3DA740, 0x3F906EBA)
    below = _polynomial(
        square, _bits(0xB3FD3906), 0x37C588DF, 0x3A856D28, 0x3C6687D4, 0x3DE34C21, 0x3EFEB44A, 0x3F800000
    )
    beyond = x.apply("abs").compare("ge", _bits(0x407547CB))
    return beyond.where(x.const(1.0).with_sign_of(x), (x * above) / below)


@function("sign", kinds="iuf")
def sign(x: Numbers) -> Numbers:
    """NaN for NaN, and 0 with its sign for 0."""
    nothing = x * 0 if x.value.dtype.kind == "f" else x.const(0)
    below = nothing if x.value.dtype.kind == "u" else x.compare("lt", 0).where(x.const(-1), nothing)
    return x.compare("gt", 0).where(x.const(1), below)


@function("population_count", kinds="iu")
def population_count(x: Numbers) -> Numbers:
    """The number of bits that are set: of pairs of bits, of groups of four, of bytes, of the word."""
    word = x.apply("bitcast", np.uint32)
    word = word - ((word >> 1) & 0x55555555)
    word = (word & 0x33333333) + ((word >> 2) & 0x33333333)
    word = (word + (word >> 4)) & 0x0F0F0F0F
    return ((word * 0x01010101) >> 24).apply("bitcast", x.value.dtype.type)


@function("clz", kinds="iu")
def leading_zeros(x: Numbers) -> Numbers:
    """The number of bits before the first that is set: all bits below it are set, and those that are not counted."""
    for shift in (1, 2, 4, 8, 16):
        x = x | x >> shift
    return population_count(x.apply("not"))


def ordered(x: Numbers) -> Numbers:
    """The whole number that stands where a real number does in the order of all words, also of NaN and -0."""
    word = x.apply("bitcast", np.int32)
    return word.compare("lt", 0).where(word ^ 0x7FFFFFFF, word)


def round_to_even(x: Numbers) -> Numbers:
    """The nearest whole number, of two the even one: real numbers above 2^23 have no fractions."""
    size = x.apply("abs")
    rounded = (size + 2.0**23) - 2.0**23
    return size.compare("lt", 2.0**23).where(rounded.with_sign_of(x), x)


def round_from_zero(x: Numbers) -> Numbers:
    """The nearest whole number, of two the one that is farther from 0."""
    size = x.apply("abs")
    whole = size.apply("floor")
    rounded = whole + (size - whole).compare("ge", 0.5).where(x.const(1.0), 0.0)
    return size.compare("lt", 2.0**23).where(rounded.with_sign_of(x), x)
