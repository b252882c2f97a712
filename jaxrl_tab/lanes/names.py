"""Under which name each value is known, where code is written that uses it."""

from typing import Any

import numpy as np

from jaxrl_tab.lanes.analysis import Facts
from jaxrl_tab.lanes.code import Value
from jaxrl_tab.lanes.layout import LINE, Layout
from jaxrl_tab.lanes.target import Target
from jaxrl_tab.lanes.types import in_memory, literal
from jaxrl_tab.lanes.vectors import Vectors


class Names:
    """The names of values.

    Attributes:
        scalars: of what is the same in all lanes.
        slots: where values wait that one segment hands to another, or a loop to its next turn.
    """

    def __init__(self, facts: Facts, layout: Layout, target: Target):
        self.facts, self.layout, self.target = facts, layout, target
        self.scalars: dict[Value, str] = {}
        self.slots: dict[Value, str] = {}
        self._vectors: dict[Vectors, dict[Value, str]] = {}
        self._homes: dict[Value, Vectors] = {}  # the segment in which it was worked out

    def scalar(self, value: Value) -> str:
        """Of a value that is the same in all lanes."""
        value = self.facts.of(value)
        return literal(value.attr) if value.op == "const" else self.scalars[_carried(value)]

    def vector(self, value: Value, segment: Vectors) -> str:
        """Of a value as a vector in a segment, where it is brought if it is not there."""
        value, names = self.facts.of(value), self._vectors.setdefault(segment, {})
        if not self.facts.varies(value):
            return segment.splat(value.dtype, self.scalar(value))
        value = _carried(value)
        if value not in names:
            if value not in self.slots:
                home = self._homes[value]
                self.slots[value] = self.slot(value.dtype)
                home.store_slot(self.slots[value], value.dtype, self._vectors[home][value])
            names[value] = segment.load_slot(self.slots[value], value.dtype)
        return names[value]

    def set_vector(self, value: Value, segment: Vectors, name: str, leaves: bool = True) -> None:
        """Says where a value was worked out; `leaves`: whether its name is known to the end of the segment."""
        self._vectors.setdefault(segment, {})[value] = name
        if leaves:
            self._homes[value] = segment

    def slot(self, dtype: Any) -> str:
        """A new slot: memory for one number of each lane of the block."""
        return self.layout.function.entry(
            f"alloca [{self.layout.lanes} x {in_memory(np.dtype(dtype))}], align {LINE}"
        )

    def operands(self, value: Value) -> list[Value]:
        """What an operation takes: of a product that is fused with it, the factors."""
        args = self.facts.args(value)
        if (product := self.product_in(value)) is not None:
            place, factors = product
            args[place : place + 1] = self.facts.args(factors)
        return args

    def product_in(self, value: Value) -> tuple[int, Value] | None:
        """Where an addition takes a product that nobody else uses: its place, and the product.

        The two are rounded once, as XLA has it, where the processor can do that.
        """
        if not self.target.fuses or value.op not in ("add", "sub") or value.dtype.kind != "f":
            return None
        for place, x in enumerate(self.facts.args(value)):
            if x.op == "mul" and self.facts.uses[x] == 1:
                return place, x
        return None


def _carried(value: Value) -> Value:
    """What a loop leaves is known by the name of what it carries."""
    return value.args[0].attr.body.params[value.attr] if value.op == "result" else value
