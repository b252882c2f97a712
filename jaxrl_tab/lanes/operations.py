"""How each operation of `scalars` is written in LLVM's language, for one number or for a vector over lanes.

Where LLVM leaves open what an instruction does (a shift beyond the width, a division by zero), so much is written
around it that it does what `scalars` says; and nothing where the ranges of the numbers show that it cannot happen.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.lanes.analysis import Facts
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.text import Writer
from jaxrl_tab.lanes.types import every, is_bool, literal, type_of, vector


class Site(NamedTuple):
    """Where an operation is written.

    Attributes:
        writer: writes it.
        facts: what is known of the numbers.
        value: the operation.
        args: the names of its arguments.
        width: of the vectors; 0 for one number.
    """

    writer: Writer
    facts: Facts
    value: Value
    args: list[str]
    width: int

    def kind(self, dtype: Any) -> str:
        return vector(self.width, type_of(dtype))

    @property
    def type(self) -> str:
        """Of the result."""
        return self.kind(self.value.dtype)

    @property
    def argument(self) -> np.dtype:
        """The dtype of the arguments; of `select`, of the two that it chooses from."""
        return self.value.args[-1].dtype

    def all(self, number: Any, dtype: Any = None) -> str:
        """A number in all lanes, by default of the arguments' dtype."""
        dtype = np.dtype(dtype or self.argument)
        return every(self.width, type_of(dtype), literal(np.asarray(number).astype(dtype)[()]))

    def instruction(self, name: str, *args: str, of: Any = None) -> str:
        """An instruction whose arguments are of one type, by default that of the arguments."""
        return self.writer.value(f"{name} {self.kind(of or self.argument)} {', '.join(args)}")

    def intrinsic(self, name: str, *args: str, dtype: Any = None) -> str:
        """A function of LLVM whose arguments and result are of one type, by default that of the result."""
        dtype = np.dtype(dtype or self.value.dtype)
        kind = self.kind(dtype)
        return self.writer.call(f"llvm.{name}.{self.suffix(dtype)}", kind, *((kind, x) for x in args))

    def suffix(self, dtype: Any) -> str:
        """Of the name of a function of LLVM for such numbers."""
        dtype = np.dtype(dtype)
        return (
            f"{f'v{self.width}' if self.width else ''}{'f' if dtype.kind == 'f' else 'i'}{8 * dtype.itemsize}"
        )

    def select(self, which: str, yes: str, no: str, dtype: Any = None) -> str:
        kind = self.kind(dtype or self.value.dtype)
        return self.writer.value(f"select {self.kind(bool)} {which}, {kind} {yes}, {kind} {no}")


def write(site: Site) -> str:
    """Writes an operation; the name of what it gives."""
    if site.value.op not in WRITERS:
        raise Unsupported(f"the operation {site.value.op}")
    return WRITERS[site.value.op](site)


def write_fused(site: Site, place: int, product: tuple[str, str]) -> str:
    """An addition or subtraction of a product (its argument at `place`), rounded once; the site has the other one."""
    (a, b), (other,) = product, site.args
    if site.value.op == "sub":
        a, other = (a, _negated(site, other)) if place == 0 else (_negated(site, a), other)
    return site.intrinsic("fma", a, b, other)


def _negated(site: Site, x: str) -> str:
    return site.instruction("fneg", x)


def _is_float(site: Site) -> bool:
    return site.argument.kind == "f"


def _is_signed(site: Site) -> bool:
    return site.argument.kind == "i"


def _arithmetic(name: str) -> Callable[[Site], str]:
    def write(site: Site) -> str:
        return site.instruction(f"f{name}" if _is_float(site) else name, *site.args)

    return write


def _bitwise(name: str) -> Callable[[Site], str]:
    return lambda site: site.instruction(name, *site.args)


def _not(site: Site) -> str:
    return site.instruction("xor", site.args[0], site.all(True if is_bool(site.argument) else -1))


def _negative(site: Site) -> str:
    return (
        _negated(site, site.args[0]) if _is_float(site) else site.instruction("sub", site.all(0), *site.args)
    )


def _comparison(name: str) -> Callable[[Site], str]:
    def write(site: Site) -> str:
        if _is_float(site):  # with NaN all but `ne` are false
            return site.instruction(f"fcmp {'u' if name == 'ne' else 'o'}{name}", *site.args)
        sign = "" if name in ("eq", "ne") else "s" if _is_signed(site) else "u"
        return site.instruction(f"icmp {sign}{name}", *site.args)

    return write


def _extreme(name: str) -> Callable[[Site], str]:
    def write(site: Site) -> str:
        if _is_float(site):
            return site.intrinsic("maximum" if name == "max" else "minimum", *site.args)
        (low, high), (other_low, other_high) = (site.facts.bounds(x) for x in site.value.args)
        if high <= other_low if name == "min" else low >= other_high:
            return site.args[0]  # an index that is in range, mostly
        return site.intrinsic(("s" if _is_signed(site) else "u") + name, *site.args)

    return write


def _select(site: Site) -> str:
    which, no, yes = site.args
    return site.select(which, yes, no)


def _bitcast(site: Site) -> str:
    before, after = site.kind(site.argument), site.type
    return (
        site.args[0] if before == after else site.writer.value(f"bitcast {before} {site.args[0]} to {after}")
    )


def _sign(site: Site) -> str:
    (x,), dtype = site.args, site.argument
    if dtype.kind == "u":
        return site.writer.value(
            f"zext {site.kind(bool)} {site.instruction('icmp ne', x, site.all(0))} to {site.type}"
        )
    if dtype.kind == "i":
        more, less = (site.instruction(f"icmp {name}", x, site.all(0)) for name in ("sgt", "slt"))
        more, less = (site.writer.value(f"zext {site.kind(bool)} {y} to {site.type}") for y in (more, less))
        return site.instruction("sub", more, less)
    one = site.intrinsic("copysign", site.all(1), x)
    as_it_is = site.instruction("fcmp ueq", x, site.all(0))  # -0, 0 and NaN
    return site.select(as_it_is, x, one)


def _absolute(site: Site) -> str:
    if _is_float(site):
        return site.intrinsic("fabs", *site.args)
    if not _is_signed(site):
        return site.args[0]
    name = f"llvm.abs.{site.suffix(site.argument)}"
    return site.writer.call(name, site.type, (site.type, site.args[0]), ("i1", "false"))


def _is_finite(site: Site) -> str:
    size = site.intrinsic("fabs", site.args[0], dtype=site.argument)
    return site.instruction("fcmp one", size, site.all(np.inf))


def _shift(name: str) -> Callable[[Site], str]:
    """Of a shift by the width or more LLVM says nothing."""

    def write(site: Site) -> str:
        (x, by), (low, high) = site.args, site.facts.bounds(site.value.args[1])
        bits = 8 * site.argument.itemsize
        if low >= 0 and high < bits:
            return site.instruction(name, x, by)
        inside = site.instruction("icmp ult", by, site.all(bits))
        shifted = site.instruction(name, x, site.select(inside, by, site.all(bits - 1), site.argument))
        return shifted if name == "ashr" else site.select(inside, shifted, site.all(0))

    return write


def _division(name: str) -> Callable[[Site], str]:
    """Of whole numbers a processor stops at a divisor 0, and at the least number by -1."""

    def write(site: Site) -> str:
        if _is_float(site):
            return site.instruction(f"f{name}", *site.args)
        (x, y), (low, high) = site.args, site.facts.bounds(site.value.args[1])
        instruction = f"{'s' if _is_signed(site) else 'u'}{name}"
        if low > 0 or high < (-1 if _is_signed(site) else 0):
            return site.instruction(instruction, x, y)
        unsafe = is_zero = site.instruction("icmp eq", y, site.all(0))
        if _is_signed(site):
            by_minus_one = site.instruction("icmp eq", y, site.all(-1))
            least = site.instruction("icmp eq", x, site.all(np.iinfo(site.argument).min))
            overflows = site.instruction("and", by_minus_one, least, of=bool)
            unsafe = site.instruction("or", is_zero, overflows, of=bool)
        # By 1 the least number stays what it is, as it does by -1 where whole numbers wrap; and nothing remains.
        divided = site.instruction(instruction, x, site.select(unsafe, site.all(1), y))
        return site.select(is_zero, site.all(-1) if name == "div" else x, divided)

    return write


def _convert(site: Site) -> str:
    (x,), before, after = site.args, site.argument, site.value.dtype
    kind, to = site.kind(before), site.type

    def cast(name: str) -> str:
        return site.writer.value(f"{name} {kind} {x} to {to}")

    if is_bool(after):
        return site.instruction("fcmp une" if before.kind == "f" else "icmp ne", x, site.all(0))
    if is_bool(before):
        return cast("uitofp" if after.kind == "f" else "zext")
    if before.kind == after.kind == "f":
        return cast("fpext" if before.itemsize < after.itemsize else "fptrunc")
    if after.kind == "f":
        return cast("sitofp" if before.kind == "i" else "uitofp")
    if before.kind == "f":
        if site.width and after.kind == "i":
            return _whole(site)
        name = f"llvm.fpto{'s' if after.kind == 'i' else 'u'}i.sat.{site.suffix(after)}.{site.suffix(before)}"
        return site.writer.call(name, to, (kind, x))
    if before.itemsize == after.itemsize:
        return x
    if before.itemsize > after.itemsize:
        return cast("trunc")
    return cast("sext" if before.kind == "i" else "zext")


def _whole(site: Site) -> str:
    """Real numbers as signed whole ones, the nearest that there is; NaN as 0. LLVM's own function goes lane by lane."""
    (x,), before, after = site.args, site.argument, site.value.dtype
    ends = np.iinfo(after)
    above = -float(ends.min)  # the least number that is too large; exact in either type
    fits = site.instruction("fcmp olt", x, site.all(above))
    number = lambda text: site.select(text, x, site.all(0), before)
    is_low = site.instruction("fcmp olt", x, site.all(float(ends.min)))
    inside = site.instruction(
        "and", fits, site.instruction("xor", is_low, site.all(True, bool), of=bool), of=bool
    )
    whole = site.writer.value(f"fptosi {site.kind(before)} {number(inside)} to {site.type}")
    whole = site.select(is_low, site.all(ends.min, after), whole)
    is_high = site.instruction("fcmp oge", x, site.all(above))
    return site.select(is_high, site.all(ends.max, after), whole)


def _function(name: str) -> Callable[[Site], str]:
    return lambda site: site.intrinsic(name, *site.args)


WRITERS: dict[str, Callable[[Site], str]] = {
    **{name: _arithmetic(name) for name in ("add", "sub", "mul")},
    **{name: _bitwise(name) for name in ("and", "or", "xor")},
    **{name: _comparison(name) for name in ("eq", "ne", "lt", "le", "gt", "ge")},
    **{name: _extreme(name) for name in ("max", "min")},
    **{name: _division(name) for name in ("div", "rem")},
    **{name: _function(name) for name in ("sqrt", "floor", "ceil", "pow", "sin", "cos")},
    "shift_left": _shift("shl"),
    "shift_right_logical": _shift("lshr"),
    "shift_right_arithmetic": _shift("ashr"),
    "not": _not,
    "neg": _negative,
    "select": _select,
    "convert": _convert,
    "bitcast": _bitcast,
    "sign": _sign,
    "abs": _absolute,
    "is_finite": _is_finite,
}
