"""Choices between two sums, or products, with an operand in common: XLA's code chooses between the others.

`where(c, a b + k, d e + k)` becomes `where(c, a b, d e) + k`, as LLVM has it in XLA's code (its InstCombine): so the
products are rounded by themselves, and not fused with the addition. Only what the jaxpr chooses itself is meant
(`Builder.choice`): an entry at an index of a small array is chosen among all by `lanes` alone.
"""

from jaxrl_tab.lanes.analysis import Facts, operations
from jaxrl_tab.lanes.code import Loop, Region, Value

COMMUTE = ("add", "mul")


def choose_operands(region: Region) -> None:
    """Chooses between operands, where nobody else uses what is chosen from."""
    if any(_common(value) for value in operations(region)):
        _rewrite(region, Facts(region))


def _rewrite(region: Region, facts: Facts) -> None:
    ops: list[Value] = []
    for value in region.ops:
        if isinstance(value.attr, Loop):
            _rewrite(value.attr.condition, facts)
            _rewrite(value.attr.body, facts)
        _choose(value, facts, ops)
    region.ops = ops


def _choose(value: Value, facts: Facts, ops: list[Value]) -> None:
    """Adds an operation to `ops`, and before it what it takes."""
    common = _common(value)
    if common is not None and all(facts.uses[x] == 1 for x in value.args[1:]):
        (which, no, yes), (place, other) = value.args, common
        operand = no.args[place]
        chosen = Value("select", value.dtype, (which, no.args[1 - place], yes.args[1 - other]), True)
        _choose(chosen, facts, ops)
        value.op, value.attr = no.op, None
        value.args = (chosen, operand) if place else (operand, chosen)
    ops.append(value)


def _common(value: Value) -> tuple[int, int] | None:
    """Where a choice is one between two operations with an operand in common: its place in each."""
    if value.op != "select" or value.attr is None or value.dtype.kind != "f":
        return None
    _, no, yes = value.args
    if no.op != yes.op or no.op not in (*COMMUTE, "sub") or no is yes:
        return None
    pairs = [(0, 0), (1, 1), *([(0, 1), (1, 0)] if no.op in COMMUTE else [])]
    return next(((i, j) for i, j in pairs if no.args[i] is yes.args[j]), None)
