"""What a loop of one lane alone works out ahead: many numbers at once, which it then reads one by one.

Where lanes go side by side, a processor always has something to do. One lane alone waits, as each operation waits
for the one before. Some numbers need not be waited for:

- What the number of the turn decides, such as random words: worked out for the next turns at once.
- What a few conditions decide, such as the probabilities of actions of which some are the best: worked out for all
  cases before the loop.
- What both decide, such as the action that a word takes by them: worked out for all cases at the beginning of a turn.

They are the same operations on the same numbers, in vectors: so they have the same bits.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.lanes import scalars
from jaxrl_tab.lanes.code import Loop, Value
from jaxrl_tab.lanes.layout import LINE
from jaxrl_tab.lanes.names import Names
from jaxrl_tab.lanes.segment import operation
from jaxrl_tab.lanes.text import Function
from jaxrl_tab.lanes.types import every, in_memory, is_bool, type_of, vector

TURNS = 32
CONDITIONS = 5  # at most decide a case
OFTEN = 32  # turns at least of a loop in which it pays
LONG = 12  # cycles at least, about, that are not waited for: more than it takes to read a number
CYCLES = {"div": 11, "rem": 11, "sqrt": 15}  # of operations, about; of others on real numbers 4, and else 1
BOTH = True
BATCH = 2


class Depends(NamedTuple):
    """What a value depends on that changes from turn to turn.

    Attributes:
        turn: whether it depends on the number of the turn.
        conditions: the conditions that decide it.
        cycles: about how long it takes from these conditions on to work it out; or, without them, at all.
    """

    turn: bool
    conditions: frozenset[Value]
    cycles: int

    @property
    def is_long(self) -> bool:
        return (self.turn or bool(self.conditions)) and self.cycles >= LONG


NOTHING = Depends(False, frozenset(), 0)


class Ahead:
    """What is worked out ahead in one loop."""

    def __init__(self, names: Names, function: Function, value: Value):
        self.names, self.facts, self.function, self.loop = names, names.facts, function, value.attr
        self.most = (2 * names.target.width).bit_length() - 1 
        often = self.facts._turns_of(value) >= OFTEN
        self.ops = [x for x in self.loop.body.ops if x in self.facts.live] if often else []
        self._own = {*self.ops, *self.loop.body.params}
        self._counters = self._found_counters()
        self._depends: dict[Value, Depends] = {}
        for x in self.ops:
            if (depends := self._found(x)) is not None:
                self._depends[x] = depends
        self.values = {x for x, depends in self._depends.items() if depends.is_long}
        used = {self.facts.of(x) for x in self._used(self.loop, self.values)}
        self.both = {}  # of each set of conditions, what they and the turn decide
        self.turns = []
        self.cases = {}
        for x in self.ops:
            if x in self.values:
                d = self._depends[x]
                if d.turn and d.conditions and x in used:
                    self.both.setdefault(d.conditions, []).append(x)
        for conditions, wanted in self.both.items():
            for x in self._cone(wanted, self._is_stop):
                if x in self.values and self._depends[x].turn and self._depends[x].conditions:
                    used |= {self.facts.of(y) for y in x.args}
                    for y in map(self.facts.of, x.args):
                        if y in self.values and not self._depends[y].turn:
                            self.cases.setdefault(conditions, []).append(y)
                else:
                    used |= {self.facts.of(y) for y in x.args}
        self.both_reads = [x for xs in self.both.values() for x in xs]
        for x in self.ops:
            if x in self.values and x in used:
                d = self._depends[x]
                if d.turn and not d.conditions:
                    self.turns.append(x)
        used = {self.facts.of(x) for x in self._used(self.loop, self.values)}
        for x in self.ops:
            if x in self.values and x in used and not self._depends[x].turn:
                self.cases.setdefault(self._depends[x].conditions, []).append(x)
        self.cases = {k: list(dict.fromkeys(v)) for k, v in self.cases.items()}
        self._place: dict[tuple[Any, Value], str] = {}
        self._index: dict[Any, str] = {}

    def _is_stop(self, x):
        return x in self.values and not (self._depends[x].turn and self._depends[x].conditions)

    def _found_counters(self) -> dict[Value, Value]:
        """What the loop carries to which a constant is added in each turn, and the constant."""
        found = {}
        for param, after in zip(self.loop.body.params, self.loop.body.results, strict=True):
            if param in self.facts.live and after.op == "add" and param.dtype.kind in "iu":
                x, y = self.facts.args(after)
                x, y = (x, y) if x is param else (y, x)
                if x is param and y.op == "const":
                    found[param] = y
        return found

    def _of(self, x: Value) -> Depends | None:
        x = self.facts.of(x)
        if x in self._depends:
            return self._depends[x]
        if x in self._counters:
            return Depends(True, frozenset(), 0)
        if x in self._own or (x.op == "result" and x.args[0] in self._own):
            return Depends(False, frozenset([x]), 0) if is_bool(x.dtype) else None
        return NOTHING

    def _found(self, x: Value) -> Depends | None:
        itself = Depends(False, frozenset([x]), 0) if is_bool(x.dtype) else None
        if x.op not in scalars.OPERATIONS or x.op == "pow":
            return itself
        args = [self._of(y) for y in x.args]
        if None in args:
            return itself
        turn = any(y.turn for y in args)
        conditions = frozenset().union(*(y.conditions for y in args))
        if len(conditions) > self.most or (turn and conditions and not BOTH):
            return itself
        own = CYCLES.get(x.op, 4) if x.args[-1].dtype.kind == "f" or x.dtype.kind == "f" else 1
        cycles = own + max((y.cycles for y in args if bool(y.conditions) == bool(conditions)), default=0)
        found = Depends(turn, conditions, cycles)
        return itself if itself and conditions and not found.is_long else found

    def _used(self, loop: Loop, ahead: set[Value]) -> Iterator[Value]:
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
        for conditions, wanted in self.cases.items():
            self._work_out(wanted, self._all_cases(conditions), 2 ** len(conditions), conditions, lambda x: False)

    def _all_cases(self, conditions, times=1):
        known = {}
        for k, leaf in enumerate(self._ordered(conditions)):
            bits = ", ".join(f"i1 {'true' if case >> k & 1 else 'false'}" for case in range(times * 2 ** len(conditions)))
            known[leaf] = f"<{bits}>"
        return known

    def _ordered(self, leaves: frozenset[Value]) -> list[Value]:
        return sorted([x for x in (*self.loop.body.params, *self.ops) if x in leaves], key=lambda x: x.op!="eq" or x.args[0].dtype.kind!="f")

    def turn(self, number: str) -> None:
        """At the beginning of a turn with this number."""
        f = self.function
        if self.turns:
            place = f.value(f"and i32 {number}, {TURNS - 1}")
            self._index[None] = f.value(f"zext i32 {place} to i64")
            first, after = f.label("ahead"), f.label("ready")
            f.line(f"br i1 {f.value(f'icmp eq i32 {place}, 0')}, label %{first}, label %{after}")
            f.begin(first)
            known = {counter: self._next_turns(counter) for counter in self._counters}
            self._work_out(self.turns, known, TURNS, None, lambda x: False)
            f.line(f"br label %{after}")
            f.begin(after)
            for x in self.turns:
                self._read(x, None)
        if not self.both:
            return
        at = f.value(f"and i32 {number}, {BATCH - 1}")
        self._batch = f.value(f"zext i32 {at} to i64")
        first, after = f.label("ahead"), f.label("ready")
        f.line(f"br i1 {f.value(f'icmp eq i32 {at}, 0')}, label %{first}, label %{after}")
        f.begin(first)
        for conditions, wanted in self.both.items():
            n = 2 ** len(conditions)
            known = self._all_cases(conditions, BATCH)
            width = BATCH * n
            for x in self.cases.get(conditions, ()):
                kind = vector(n, in_memory(x.dtype))
                y = f.value(f"load {kind}, ptr {self._place[conditions, x]}, align {LINE}")
                mask = ", ".join(f"i32 {k % n}" for k in range(width))
                y = f.value(f"shufflevector {kind} {y}, {kind} poison, <{width} x i32> <{mask}>")
                known[x] = f.value(f"trunc {vector(width, in_memory(x.dtype))} {y} to {vector(width, 'i1')}") if is_bool(x.dtype) else y
            for x in self.turns:
                kind = vector(BATCH, in_memory(x.dtype))
                y = f.value(f"getelementptr {in_memory(x.dtype)}, ptr {self._place[None, x]}, i64 {self._index[None]}")
                y = f.value(f"load {kind}, ptr {y}, align 4")
                mask = ", ".join(f"i32 {k // n}" for k in range(width))
                y = f.value(f"shufflevector {kind} {y}, {kind} poison, <{width} x i32> <{mask}>")
                known[x] = f.value(f"trunc {vector(width, in_memory(x.dtype))} {y} to {vector(width, 'i1')}") if is_bool(x.dtype) else y
            self._work_out(wanted, known, width, conditions, self._is_stop)
        f.line(f"br label %{after}")
        f.begin(after)

    def _next_turns(self, counter: Value) -> str:
        kind, by = type_of(counter.dtype), int(self._counters[counter].attr)
        later = ", ".join(f"{kind} {(k * by + 2**31) % 2**32 - 2**31}" for k in range(TURNS))
        now = self._splat(kind, self.names.scalars[counter], TURNS)
        return self.function.value(f"add {vector(TURNS, kind)} {now}, <{later}>")

    def _splat(self, kind: str, x: str, width: int) -> str:
        if not x.startswith("%"):
            return every(width, kind, x)
        whole = vector(width, kind)
        one = self.function.value(f"insertelement {whole} poison, {kind} {x}, i32 0")
        return self.function.value(f"shufflevector {whole} {one}, {whole} poison, <{width} x i32> zeroinitializer")

    def _cone(self, values, stop):
        wanted, stack = set(), list(values)
        while stack:
            x = self.facts.of(stack.pop())
            if x in self._own and x not in wanted and not stop(x):
                wanted.add(x)
                stack += x.args
        return [x for x in self.ops if x in wanted]

    def _work_out(self, values: list[Value], known: dict[Value, str], width: int, which, stop) -> None:
        f = self.function

        def name(x: Value) -> str:
            x = self.facts.of(x)
            if x not in known:
                known[x] = self._splat(type_of(x.dtype), self.names.scalar(x), width)
            return known[x]

        for x in self._cone(values, lambda x: x in known or stop(x)):
            known[x] = operation(self.names, f, x, name, width)
        for x in values:
            kind = in_memory(x.dtype)
            self._place[which, x] = f.entry(f"alloca [{width} x {kind}], align {LINE}")
            numbers = known[x]
            if is_bool(x.dtype):
                numbers = f.value(f"zext {vector(width, 'i1')} {numbers} to {vector(width, 'i8')}")
            f.line(f"store {vector(width, kind)} {numbers}, ptr {self._place[which, x]}, align {LINE}")

    def read(self, value: Value) -> None:
        """Where a value would be worked out: what was worked out of it ahead."""
        d = self._depends[value]
        if d.conditions and (d.conditions, value) in self._place:
            self._read(value, d.conditions)

    def _read(self, value, which) -> None:
        f = self.function
        kind = in_memory(value.dtype)
        index = self._case(which) if which else self._index[None]
        place = self._place[which, value]
        if which and self._depends[value].turn:
            place = f.value(f"getelementptr [{2**len(which)} x {kind}], ptr {place}, i64 {self._batch}")
        at = f.value(f"getelementptr {kind}, ptr {place}, i64 {index}")
        x = f.value(f"load {kind}, ptr {at}")
        self.names.scalars[value] = f.value(f"trunc i8 {x} to i1") if is_bool(value.dtype) else x

    def _case(self, leaves: frozenset[Value]) -> str:
        if leaves not in self._index:
            f = self.function
            total = "0"
            ordered = self._ordered(leaves)
            alike = [x for x in ordered if x.op == "eq" and x.args[0].dtype.kind == "f"]
            if len(alike) == 4:
                ordered = [x for x in ordered if x not in alike]
                sides = []
                for side in range(2):
                    whole = "poison"
                    for j, x in enumerate(alike):
                        whole = f.value(f"insertelement <4 x float> {whole}, float {self.names.scalar(x.args[side])}, i32 {j}")
                    sides.append(whole)
                bits = f.value(f"fcmp oeq <4 x float> {sides[0]}, {sides[1]}")
                total = f.value(f"zext i4 {f.value(f'bitcast <4 x i1> {bits} to i4')} to i64")
                for k, leaf in enumerate(ordered, 4):
                    bit = f.value(f"zext i1 {self.names.scalar(leaf)} to i64")
                    bit = f.value(f"shl i64 {bit}, {k}")
                    total = f.value(f"or i64 {total}, {bit}")
            else:
                for k, leaf in enumerate(ordered):
                    bit = f.value(f"zext i1 {self.names.scalar(leaf)} to i64")
                    bit = f.value(f"shl i64 {bit}, {k}") if k else bit
                    total = f.value(f"or i64 {total}, {bit}") if k else bit
            self._index[leaves] = total
        return self._index[leaves]
