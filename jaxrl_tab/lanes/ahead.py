"""What a loop of one lane alone works out ahead: many numbers at once, which it then reads one by one.

Where lanes go side by side, a processor always has something to do. One lane alone waits, as each operation waits
for the one before. Two kinds of numbers need not be waited for:

- What the number of the turn decides, such as random words: worked out for the next turns at once.
- What a few conditions decide, such as the probabilities of actions of which some are the best: worked out for all
  cases before the loop. There are no more than `CASES` of them.

They are the same operations on the same numbers, in vectors: so they have the same bits.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jaxrl_tab.lanes import scalars
from jaxrl_tab.lanes.code import Loop, Value
from jaxrl_tab.lanes.layout import LINE
from jaxrl_tab.lanes.names import Names
from jaxrl_tab.lanes.segment import operation
from jaxrl_tab.lanes.text import Function
from jaxrl_tab.lanes.types import every, in_memory, is_bool, literal, type_of, vector

TURNS = 64  # for so many turns at once
CONDITIONS = 4  # at most decide a case
OFTEN = 32  # turns at least of a loop in which it pays
LONG = 12  # cycles at least, about, that are not waited for: more than it takes to read a number
CYCLES = {"div": 11, "rem": 11, "sqrt": 15}  # of operations, about; of others on real numbers 4, and else 1

Leaves: TypeAlias = "frozenset[Value] | None"  # what a value depends on that changes from turn to turn; None: much


class _Slice(NamedTuple):
    """Operations of a loop's body that depend on few leaves.

    Attributes:
        leaves: of each value that depends on few.
        ahead: the values that are worked out ahead.
        read: those of them that are used by others.
    """

    leaves: dict[Value, frozenset[Value]]
    ahead: set[Value]
    read: list[Value]


class Ahead:
    """What is worked out ahead in one loop."""

    def __init__(self, names: Names, function: Function, value: Value):
        self.names, self.facts, self.function, self.loop = names, names.facts, function, value.attr
        self.ops = [x for x in self.loop.body.ops if x in self.facts.live]
        self._own = {*self.ops, *self.loop.body.params}
        self._place: dict[Value, str] = {}
        self._index: dict[Any, str] = {}
        often = self.facts._turns_of(value) >= OFTEN
        counters = self._counters() if often else {}
        self._steps = counters
        self.by_turn = self._slice(lambda x: x in counters, len(counters))
        self.by_case = self._slice(lambda x: often and is_bool(x.dtype), CONDITIONS)
        self.values = self.by_turn.ahead | self.by_case.ahead

    def _counters(self) -> dict[Value, Value]:
        """What the loop carries to which a constant is added in each turn, and the constant."""
        found = {}
        for param, after in zip(self.loop.body.params, self.loop.body.results, strict=True):
            if param in self.facts.live and after.op == "add" and param.dtype.kind in "iu":
                x, y = self.facts.args(after)
                x, y = (x, y) if x is param else (y, x)
                if x is param and y.op == "const":
                    found[param] = y
        return found

    def _slice(self, is_leaf: Callable[[Value], bool], most: int) -> _Slice:
        leaves: dict[Value, Leaves] = {}
        cycles: dict[Value, int] = {}

        def of(x: Value) -> Leaves:
            if x in leaves:
                return leaves[x]
            if x.op == "result" and x.args[0] in self._own or x in self._own:
                return frozenset([x]) if is_leaf(x) else None
            return frozenset()

        for value in self.ops:
            each = [of(x) for x in self.facts.args(value)] if value.op in scalars.OPERATIONS and value.op != "pow" else [None]
            few = None if None in each else frozenset().union(*each)
            if few is None or len(few) > most or (few and value.dtype == bool and is_leaf(value)):
                few = frozenset([value]) if is_leaf(value) else None
            leaves[value] = few
            cycles[value] = 0
            if few is not None and few != {value}:
                own = CYCLES.get(value.op, 4) if value.args[-1].dtype.kind == "f" or value.dtype.kind == "f" else 1
                cycles[value] = own + max(cycles.get(x, 0) for x in self.facts.args(value))
        ahead = {x for x in self.ops if leaves[x] and cycles[x] >= LONG}
        if hasattr(self, "by_turn"):
            ahead -= self.by_turn.ahead
        used = {self.facts.of(x) for x in self._used(self.loop, ahead)}
        return _Slice({k: v for k, v in leaves.items() if v is not None}, ahead, [x for x in self.ops if x in ahead & used])

    def _used(self, loop: Loop, ahead: set[Value]) -> Iterable[Value]:
        """What is used by all but `ahead`."""
        yield from loop.body.results
        yield from loop.condition.results
        for region in (loop.condition, loop.body):
            for value in region.ops:
                if value in self.facts.live and value not in ahead:
                    yield from value.args
                    if isinstance(value.attr, Loop):
                        yield from self._used(value.attr, ahead)

    def before(self) -> None:
        """Before the loop: all cases."""
        f = self.function
        for leaves in {self.by_case.leaves[x]: None for x in self.by_case.read}:
            width = 2 ** len(leaves)
            known = {}
            for k, leaf in enumerate(self._ordered(leaves)):
                bits = ", ".join(f"i1 {'true' if case >> k & 1 else 'false'}" for case in range(width))
                known[leaf] = f"<{bits}>"
            self._work_out([x for x in self.by_case.read if self.by_case.leaves[x] == leaves], known, width)

    def _ordered(self, leaves: frozenset[Value]) -> list[Value]:
        return [x for x in (*self.loop.body.params, *self.ops) if x in leaves]

    def turn(self, number: str) -> None:
        """At the beginning of a turn with this number."""
        if not self.by_turn.read:
            return
        f = self.function
        place = f.value(f"and i32 {number}, {TURNS - 1}")
        self._index[None] = f.value(f"zext i32 {place} to i64")
        first, after = f.label("ahead"), f.label("ready")
        f.line(f"br i1 {f.value(f'icmp eq i32 {place}, 0')}, label %{first}, label %{after}")
        f.begin(first)
        known = {}
        for counter, step in self._steps.items():
            kind = type_of(counter.dtype)
            by = int(step.attr)
            later = ", ".join(f"{kind} {(k * by + 2**31) % 2**32 - 2**31}" for k in range(TURNS))
            now = self._splat(kind, self.names.scalars[counter], TURNS)
            known[counter] = f.value(f"add {vector(TURNS, kind)} {now}, <{later}>")
        self._work_out(self.by_turn.read, known, TURNS)
        f.line(f"br label %{after}")
        f.begin(after)

    def _splat(self, kind: str, x: str, width: int) -> str:
        if not x.startswith("%"):
            return every(width, kind, x)
        whole = vector(width, kind)
        one = self.function.value(f"insertelement {whole} poison, {kind} {x}, i32 0")
        return self.function.value(f"shufflevector {whole} {one}, {whole} poison, <{width} x i32> zeroinitializer")

    def _work_out(self, values: list[Value], known: dict[Value, str], width: int) -> None:
        f = self.function
        wanted, stack = set(), list(values)
        while stack:
            x = self.facts.of(stack.pop())
            if x in self._own and x not in known and x not in wanted:
                wanted.add(x)
                stack += x.args

        def name(x: Value) -> str:
            x = self.facts.of(x)
            if x not in known:
                known[x] = self._splat(type_of(x.dtype), self.names.scalar(x), width)
            return known[x]

        for x in self.ops:
            if x in wanted:
                known[x] = operation(self.names, f, x, name, width)
        for x in values:
            kind = in_memory(x.dtype)
            self._place[x] = f.entry(f"alloca [{width} x {kind}], align {LINE}")
            numbers = known[x]
            if is_bool(x.dtype):
                numbers = f.value(f"zext {vector(width, 'i1')} {numbers} to {vector(width, 'i8')}")
            f.line(f"store {vector(width, kind)} {numbers}, ptr {self._place[x]}, align {LINE}")

    def read(self, value: Value) -> None:
        """Where a value would be worked out: what was worked out of it ahead."""
        if value not in self._place:
            return
        f = self.function
        kind = in_memory(value.dtype)
        index = self._index[None] if value in self.by_turn.ahead else self._case(self.by_case.leaves[value])
        at = f.value(f"getelementptr {kind}, ptr {self._place[value]}, i64 {index}")
        x = f.value(f"load {kind}, ptr {at}")
        self.names.scalars[value] = f.value(f"trunc i8 {x} to i1") if is_bool(value.dtype) else x

    def _case(self, leaves: frozenset[Value]) -> str:
        if leaves not in self._index:
            f = self.function
            total = "0"
            for k, leaf in enumerate(self._ordered(leaves)):
                bit = f.value(f"zext i1 {self.names.scalar(leaf)} to i64")
                bit = f.value(f"shl i64 {bit}, {k}") if k else bit
                total = f.value(f"or i64 {total}, {bit}") if k else bit
            self._index[leaves] = total
        return self._index[leaves]
