"""What a loop of one lane alone works out ahead: many numbers at once, of which it then reads one.

Where lanes go side by side there is always something to do. One lane alone waits, each operation for the one before.
Some numbers need not be waited for:

- what the number of the turn decides, such as random words: it is worked out for the next turns at once;
- what a few conditions decide, such as the probabilities of actions of which some are the best: for all cases, before
  the loop;
- what both decide, such as the action that a word takes by these probabilities: for the next turns in all cases.

Each is a `Table`. The operations are the same as without it, in vectors: so the numbers have the same bits. What was
worked out for turns that do not come, and for cases that cannot be, is never read.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from jaxrl_tab.lanes import scalars
from jaxrl_tab.lanes.code import Loop, Value
from jaxrl_tab.lanes.layout import LINE
from jaxrl_tab.lanes.names import Names
from jaxrl_tab.lanes.segment import operation
from jaxrl_tab.lanes.text import Function
from jaxrl_tab.lanes.types import bytes_of, every, in_memory, is_bool, literal, type_of, vector

AT_ONCE = 64  # numbers, a power of two: of a value for so many turns, or for fewer turns in all their cases
CONDITIONS = 5  # at most decide a case
OFTEN = 8  # turns at least of a loop for which it pays
LONG = 12  # cycles at least, about, that are not waited for: more than it takes to read a number
CYCLES = {
    "div": 11,
    "sqrt": 15,
}  # that an operation on real numbers takes, about; others take 4, on whole ones 1


CALLED = ("pow", "sin", "cos")  # functions of the C library, which take long


class Depends(NamedTuple):
    """What a value depends on that changes from turn to turn.

    Attributes:
        turn: whether it depends on the number of the turn.
        conditions: which conditions decide it.
        cycles: how long it takes from when these are known; and without any, how long at all.
    """

    turn: bool = False
    conditions: frozenset[Value] = frozenset()
    cycles: int = 0


@dataclass
class Table:
    """Values for some turns, and in all cases.

    Attributes:
        turns: for how many; 1 where they are the same in all.
        conditions: that decide a case. Their bits make its number, the first being the lowest.
        values: what is worked out.
        places: where it lies, case after case, and turn after turn.
    """

    turns: int
    conditions: list[Value]
    values: list[Value] = field(default_factory=list)
    places: dict[Value, str] = field(default_factory=dict)

    @property
    def cases(self) -> int:
        return 2 ** len(self.conditions)

    @property
    def size(self) -> int:
        return self.turns * self.cases


class Ahead:
    """What is worked out ahead in one loop: nothing where lanes go side by side, or it has few turns.

    Attributes:
        values: that are not worked out in their turn.
        turn: the name of the number of the turn.
    """

    def __init__(self, names: Names, function: Function, loop: Value):
        self.names, self.facts, self.function, self.loop = names, names.facts, function, loop.attr
        pays = self.facts.alone and self.facts.turns_of(loop) >= OFTEN
        self.turn = function.fresh("turn")
        self._ops = [x for x in self.loop.body.ops if pays and x in self.facts.live]
        self._own = {*self._ops, *self.loop.body.params}
        self._steps = dict(self._counters())
        self._depends: dict[Value, Depends] = {}
        for x in self._ops:
            if (depends := self._found(x)) is not None:
                self._depends[x] = depends
        self.values = {x for x, depends in self._depends.items() if _pays(depends)}
        self._tables: dict[tuple[bool, frozenset[Value]], Table] = {}
        self._plan()

    # --- what depends on what

    def _counters(self) -> Iterator[tuple[Value, int]]:
        """What the loop carries to which a constant is added in each turn, and the constant."""
        for param, after in zip(self.loop.body.params, self.loop.body.results, strict=True):
            if param.dtype.kind in "iu" and after.op == "add":
                x, y = self.facts.args(after)
                if x is param and y.op == "const":
                    yield param, int(y.attr)

    def _of(self, x: Value) -> Depends | None:
        """What a value depends on; None where that is more than the turn and a few conditions."""
        if x in self._depends:
            return self._depends[x]
        if x in self._steps:
            return Depends(turn=True)
        if x.op == "result" and x.args[0] in self._own:
            return None
        return _itself(x) if x in self._own else Depends()

    def _found(self, x: Value) -> Depends | None:
        """The same of an operation of the loop. What is a condition depends on itself, if on nothing that pays."""
        real = "f" in (x.dtype.kind, *(y.dtype.kind for y in x.args[-1:]))
        # A division of whole numbers stops the program where one by 0 is worked out, although nobody wants it.
        if x.op not in scalars.OPERATIONS or x.op in CALLED or (x.op in ("div", "rem") and not real):
            return _itself(x)
        args = [depends for y in self.names.operands(x) if (depends := self._of(y)) is not None]
        conditions = frozenset[Value]().union(*(y.conditions for y in args))
        if len(args) < len(self.names.operands(x)) or len(conditions) > CONDITIONS:
            return _itself(x)
        before = max((y.cycles for y in args if bool(y.conditions) == bool(conditions)), default=0)
        cycles = before + (CYCLES.get(x.op, 4) if real else 1)
        found = Depends(any(y.turn for y in args), conditions, cycles)
        return found if _pays(found) or not conditions else _itself(x) or found

    def _plan(self) -> None:
        """Makes the tables of what is used by what is not worked out ahead, and of what they take."""
        used = {self.facts.of(x) for x in self._used(self.loop)}
        for x in self._ops:
            if x in self.values and x in used:
                self._table(self._depends[x].turn, self._depends[x].conditions).values.append(x)
        for (turn, conditions), table in list(self._tables.items()):
            if turn and conditions:
                for x in self._inputs(table):
                    depends = self._depends[x]
                    of = self._table(depends.turn, conditions if depends.conditions else frozenset())
                    of.values += [x] if x not in of.values else []

    def _used(self, loop: Loop) -> Iterator[Value]:
        """What is used in a loop by what is not worked out ahead."""
        for region in (loop.condition, loop.body):
            yield from region.results
            for x in region.ops:
                if x in self.facts.live and x not in self.values:
                    yield from (*x.args, *self.names.operands(x))
                    if isinstance(x.attr, Loop):
                        yield from self._used(x.attr)

    def _table(self, turn: bool, conditions: frozenset[Value]) -> Table:
        if (turn, conditions) not in self._tables:
            in_order = [x for x in (*self.loop.body.params, *self._ops) if x in conditions]
            in_order.sort(key=_is_equality, reverse=True)
            turns = AT_ONCE >> len(in_order) if turn else 1
            self._tables[turn, conditions] = Table(turns, in_order)
        return self._tables[turn, conditions]

    def _is_input(self, x: Value, table: Table) -> bool:
        """Whether it is read from another table where this one is worked out."""
        both = table.turns > 1 and bool(table.conditions)
        return both and x in self.values and not (self._depends[x].turn and self._depends[x].conditions)

    def _inputs(self, table: Table) -> list[Value]:
        needed = self._needed(table)
        return [x for x in self._ops if x in needed and self._is_input(x, table)]

    def _needed(self, table: Table) -> set[Value]:
        """The operations that lead to the values of a table, and its inputs."""
        needed: set[Value] = set()
        stack = list(table.values)
        while stack:
            x = self.facts.of(stack.pop())
            if x in self._own and x not in needed and x not in table.conditions:
                needed.add(x)
                if not self._is_input(x, table) and x not in self._steps:
                    stack += self.names.operands(x)
        return needed

    # --- how it is written

    def before(self) -> None:
        """Before the loop: what is the same in all turns."""
        for (turn, _), table in self._tables.items():
            if not turn:
                self._work_out(table)

    def begin(self) -> None:
        """At the beginning of a turn: what is wanted in it and the next ones, if it is time."""
        f = self.function
        # Words before what is made of them.
        for table in sorted(self._tables.values(), key=lambda x: x.cases):
            if table.turns == 1:
                continue
            first, after = f.label("ahead"), f.label("ready")
            is_first = f.value(f"icmp eq i32 {self._turn_in(table)}, 0")
            f.line(f"br i1 {is_first}, label %{first}, label %{after}")
            f.begin(first)
            self._work_out(table)
            f.line(f"br label %{after}")
            f.begin(after)

    def read(self, x: Value) -> None:
        """Where a value would be worked out: it is read, if somebody uses it."""
        depends = self._depends[x]
        table = self._tables.get((depends.turn, depends.conditions))
        if table is not None and x in table.places:
            of_turn = f"mul i32 {self._turn_in(table)}, {table.cases}"
            place = self.function.value(f"add i32 {self.function.value(of_turn)}, {self._case(table)}")
            self.names.scalars[x] = self._loaded(table, x, place, 0)

    def _turn_in(self, table: Table) -> str:
        """The place of this turn among those of a table."""
        return self.function.value(f"and i32 {self.turn}, {table.turns - 1}") if table.turns > 1 else "0"

    def _case(self, table: Table) -> str:
        """The number of the case that is there."""
        f, names = self.function, self.names
        case, alike = "0", [x for x in table.conditions if _is_equality(x)]
        if alike:  # several numbers are compared at once: fewer bits to put together
            sides = []
            for side in range(2):
                sides.append("poison")
                for k, x in enumerate(alike):
                    of = f"<{len(alike)} x float> {sides[-1]}, float {names.scalar(x.args[side])}, i32 {k}"
                    sides[-1] = f.value(f"insertelement {of}")
            bits = f.value(f"fcmp oeq <{len(alike)} x float> {sides[0]}, {sides[1]}")
            bits = f.value(f"bitcast <{len(alike)} x i1> {bits} to i{len(alike)}")
            case = f.value(f"zext i{len(alike)} {bits} to i32")
        for k, x in enumerate(table.conditions[len(alike) :], len(alike)):
            bit = f.value(f"zext i1 {names.scalar(x)} to i32")
            case = f.value(f"or i32 {case}, {f.value(f'shl i32 {bit}, {k}')}")
        return case

    def _work_out(self, table: Table) -> None:
        f, size = self.function, table.size
        needed, vectors = self._needed(table), {}

        def name(x: Value) -> str:
            if (x := self.facts.of(x)) not in vectors:
                vectors[x] = self._leaf(x, table)
            return vectors[x]

        for x in self._ops:
            if x in needed and not self._is_input(x, table):
                vectors[x] = operation(self.names, f, x, name, size)
        for x in table.values:
            kind, numbers = vector(size, in_memory(x.dtype)), vectors[x]
            if is_bool(x.dtype):
                numbers = f.value(f"zext {vector(size, 'i1')} {numbers} to {kind}")
            table.places[x] = self.names.layout.room(size * bytes_of(x.dtype))
            f.line(f"store {kind} {numbers}, ptr {table.places[x]}, align {LINE}")

    def _leaf(self, x: Value, table: Table) -> str:
        """The vector of a value that is there before a table is worked out."""
        f, size, kind = self.function, table.size, type_of(x.dtype)
        if x.op == "const":
            return every(size, kind, literal(x.attr))
        if x in table.conditions:
            place = table.conditions.index(x)
            return _vector("i1", ["true" if k >> place & 1 else "false" for k in range(size)])
        if x in self._depends and self._is_input(x, table):
            depends = self._depends[x]
            other = self._table(
                depends.turn, frozenset(table.conditions) if depends.conditions else frozenset()
            )
            count = table.cases if depends.conditions else table.turns
            some = self._loaded(other, x, self._turn_in(other), count)
            places = [k % count if depends.conditions else k // table.cases for k in range(size)]
        else:
            some, count, places = self.names.scalar(x), 1, [0] * size
            some = f.value(f"insertelement {vector(1, kind)} poison, {kind} {some}, i32 0")
        mask, of = _vector("i32", places), vector(count, kind)
        some = f.value(f"shufflevector {of} {some}, {of} poison, {vector(size, 'i32')} {mask}")
        if x not in self._steps:
            return some
        later = [(k // table.cases * self._steps[x] + 2**31) % 2**32 - 2**31 for k in range(size)]
        return f.value(f"add {vector(size, kind)} {some}, {_vector(kind, later)}")

    def _loaded(self, table: Table, x: Value, place: str, count: int) -> str:
        """So many numbers of a value from a place of its table on, as a vector; or, for 0, the one number there."""
        f, kind = self.function, in_memory(x.dtype)
        at = f.value(f"zext i32 {place} to i64")
        at = f.value(f"getelementptr {kind}, ptr {table.places[x]}, i64 {at}")
        numbers = f.value(f"load {vector(count, kind)}, ptr {at}, align {bytes_of(x.dtype)}")
        if not is_bool(x.dtype):
            return numbers
        return f.value(f"trunc {vector(count, kind)} {numbers} to {vector(count, 'i1')}")


def _pays(depends: Depends) -> bool:
    return (depends.turn or bool(depends.conditions)) and depends.cycles >= LONG


def _itself(x: Value) -> Depends | None:
    """What a condition depends on, if it is nothing else."""
    return Depends(conditions=frozenset([x])) if is_bool(x.dtype) else None


def _is_equality(x: Value) -> bool:
    """Whether it says that two real numbers are equal."""
    return x.op == "eq" and x.args[0].dtype.kind == "f"


def _vector(kind: str, numbers: list) -> str:
    """A vector of known numbers."""
    return f"<{', '.join(f'{kind} {x}' for x in numbers)}>"
