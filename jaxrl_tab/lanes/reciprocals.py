"""Quotients whose divisor is the same in all lanes: XLA multiplies by its reciprocal, worked out once for all."""

import numpy as np

from jaxrl_tab.lanes.analysis import Facts, operations
from jaxrl_tab.lanes.code import Loop, Region, Value


def use_reciprocals(region: Region) -> None:
    """Writes `x / y` as `x (1 / y)` where x differs from lane to lane and y does not."""
    if any(_is_quotient(value) for value in operations(region)):
        _rewrite(region, Facts(region))


def _is_quotient(value: Value) -> bool:
    return value.op == "div" and value.dtype.kind == "f"


def _rewrite(region: Region, facts: Facts) -> None:
    ops: list[Value] = []
    reciprocals: dict[Value, Value] = {}
    for value in region.ops:
        if isinstance(value.attr, Loop):
            _rewrite(value.attr.condition, facts)
            _rewrite(value.attr.body, facts)
        elif _is_quotient(value) and value in facts.live and facts.varies(value.args[0]):
            x, y = value.args
            if not facts.varies(y):
                if y not in reciprocals:
                    one = Value("const", value.dtype, attr=np.ones((), value.dtype)[()])
                    reciprocals[y] = Value("div", value.dtype, (one, y))
                    ops.append(reciprocals[y])
                value.op, value.args = "mul", (x, reciprocals[y])
        ops.append(value)
    region.ops = ops
