"""What is known of scalar code before machine code is made of it.

live      which values and which stores the outputs need, through loops and memory
same      what a loop carries but never changes: it is what was there before the loop
varies    what differs from lane to lane; all else is worked out once for all of them. Of one lane alone nothing does
ranges    between which bounds a whole number lies: an index that is proved to be in range is not clamped
uses      how often a value is used
"""

from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from jaxrl_tab.lanes.code import Buffer, Loop, Region, Value

TURNS = 3  # of a loop, after which a bound that still moves is given up
USUAL = 100  # turns of a loop of which nothing is known
SOON = 4096  # turns at most of a loop that ends soon


def operations(region: Region) -> Iterator[Value]:
    """All operations, those within loops too."""
    for value in region.ops:
        yield value
        if isinstance(value.attr, Loop):
            yield from operations(value.attr.condition)
            yield from operations(value.attr.body)


def buffer_of(value: Value) -> Buffer | None:
    """The memory that a value is read from."""
    return value.attr if value.op == "load" else value.attr[0] if value.op == "row" else None


class Facts:
    """The facts about the code of a region.

    Attributes:
        alone: whether it is for one lane alone.
    """

    def __init__(self, region: Region, alone: bool = False):
        self.alone = alone
        self._loop_of: dict[
            Value, tuple[Value, int]
        ] = {}  # of what is carried: its loop, and its place there
        self._around: dict[Value, Value] = {}  # of an operation: the loop that it stands in
        self._stores: dict[Buffer, list[Value]] = {}
        self.same: dict[Value, Value] = {}
        self._walk(region, None)
        self.live: set[Any] = set()
        self._mark(region)
        self.uses = self._count(region)
        self.varying: set[Any] = set()
        self.masked: set[Buffer] = set()  # written within a loop that lanes leave one by one
        if not alone:
            self._spread(region)
        self.range: dict[Value, tuple[int, int]] = {}
        self.after: dict[Value, tuple[int, int]] = {}  # of what counts the turns of a loop: when it is over
        self._bound(region)

    def _walk(self, region: Region, around: Value | None) -> None:
        for value in region.ops:
            if around is not None:
                self._around[value] = around
            if value.op == "store":
                self._stores.setdefault(value.attr, []).append(value)
            if value.op == "outside":
                for buffer in value.attr.outputs:
                    self._stores.setdefault(buffer, []).append(value)
            if isinstance(loop := value.attr, Loop):
                for k, param in enumerate(loop.body.params):
                    self._loop_of[param] = value, k
                    if loop.body.results[k] is param:
                        self.same[param] = value.args[k]
                self._walk(loop.condition, value)
                self._walk(loop.body, value)

    def of(self, value: Value) -> Value:
        """The value itself, or that which a loop carries without changing it."""
        while True:
            if value.op == "result" and (param := value.args[0].attr.body.params[value.attr]) in self.same:
                value = param
            if value not in self.same:
                return value
            value = self.same[value]

    def args(self, value: Value) -> list[Value]:
        return [self.of(x) for x in value.args]

    def _mark(self, region: Region) -> None:
        """Marks what the outputs need, from their stores on backwards."""
        stack: list[Any] = [
            store for buffer, stores in self._stores.items() if buffer.role == "output" for store in stores
        ]
        while stack:
            if (value := self.of(stack.pop())) in self.live:
                continue
            self.live.add(value)
            if value in self._around:
                stack.append(self._around[value])
            if value.op == "loop":
                stack.append(value.attr.condition.results[0])
            elif value.op == "result":
                loop = value.args[0]
                stack += [loop, loop.attr.body.params[value.attr]]
            elif value.op == "param":
                loop, k = self._loop_of[value]
                stack += [loop, loop.args[k], loop.attr.body.results[k]]
            else:
                stack += value.args
                buffer = buffer_of(value)
                read = value.attr.inputs if value.op == "outside" else [] if buffer is None else [buffer]
                for buffer in read:
                    stack += self._stores.get(buffer, ())

    def carried(self, loop: Value) -> list[int]:
        """The places of what a loop carries that is needed and changes."""
        return [
            k
            for k, param in enumerate(loop.attr.body.params)
            if param in self.live and param not in self.same
        ]

    def _count(self, region: Region) -> Counter:
        uses: Counter = Counter()
        for value in operations(region):
            if value not in self.live:
                continue
            if value.op == "loop":
                carried = self.carried(value)
                uses.update(self.of(value.args[k]) for k in carried)
                uses.update(self.of(value.attr.body.results[k]) for k in carried)
                uses.update([self.of(value.attr.condition.results[0])])
            else:
                uses.update(self.args(value))
        return uses

    def size(self, loop: Loop) -> int:
        """How many operations a loop has."""
        return sum(value in self.live for part in (loop.condition, loop.body) for value in operations(part))

    def turns(self, value: Value) -> int:
        """How often an operation is done, so far as the loops around it tell."""
        times = 1
        while (loop := self._around.get(value)) is not None:
            times *= self.turns_of(loop)
            value = loop
        return times

    def ends_soon(self, loop: Value) -> bool:
        """Whether a loop has few turns for sure."""
        return self.counter(loop) is not None and self.turns_of(loop) <= SOON

    def is_within_another(self, loop: Value) -> bool:
        """Whether a loop stands in another one."""
        return loop in self._around

    def is_branch(self, loop: Value) -> bool:
        """Whether a loop has one turn at most.

        It goes on while what it carries is True, and that is False then; or it counts up to 1 at most.
        """
        goes_on = loop.attr.condition.results[0]
        if (counted := self._counted(loop)) is not None:
            place, bound = counted
            return self.bounds(bound)[1] - self.bounds(loop.args[place])[0] <= 1
        return any(
            goes_on is param and after.op == "const" and not after.number
            for param, after in zip(loop.attr.condition.params, loop.attr.body.results, strict=True)
        )

    def turns_of(self, loop: Value) -> int:
        """How many turns a loop has: at most, or, if nothing is known, as is usual."""
        if self.is_branch(loop):
            return 1
        if (counter := self.counter(loop)) is None:
            return USUAL
        place, bound = counter
        return max(1, self.bounds(bound)[1] - self.bounds(loop.args[place])[0])

    # --- what differs from lane to lane

    def _spread(self, region: Region) -> None:
        before = -1
        while before < len(self.varying):
            before = len(self.varying)
            self._spread_once(region, False)

    def _spread_once(self, region: Region, within: bool) -> None:
        for value in region.ops:
            if value not in self.live:
                continue
            if value.op == "loop":
                loop = value.attr
                self._spread_once(loop.condition, within)
                alone = self.varies(loop.condition.results[0])  # lanes leave it one by one
                if alone:
                    self.varying.add(value)
                for k in self.carried(value):
                    if alone or self.varies(value.args[k]) or self.varies(loop.body.results[k]):
                        self.varying.add(loop.body.params[k])
                self._spread_once(loop.body, within or alone)
            elif value.op == "outside":
                self.varying |= {value, *value.attr.inputs, *value.attr.outputs}
            elif value.op == "store":
                if within or any(map(self.varies, value.args)) or value.attr.role == "output":
                    self.varying |= {value, value.attr}
                if within:
                    self.masked.add(value.attr)
            elif any(map(self.varies, value.args)) or (
                (buffer := buffer_of(value)) is not None
                and (buffer.role == "input" or buffer in self.varying)
            ):
                self.varying.add(value)
            if value.op == "store" and value.attr in self.varying:
                self.varying.add(value)

    def varies(self, value: Any) -> bool:
        if isinstance(value, Value):
            value = self.of(value)
            if value.op == "result":
                return value.args[0].attr.body.params[value.attr] in self.varying
        return value in self.varying

    # --- ranges of whole numbers

    def bounds(self, value: Value) -> tuple[int, int]:
        """The least and the largest number that a whole number (or a bool) may be."""
        value = self.of(value)
        if value.op == "const":
            return int(value.attr), int(value.attr)
        if value.op == "result":
            param = value.args[0].attr.body.params[value.attr]
            return self.after.get(param, self.bounds(param))
        return self.range.get(value, _every(value.dtype))

    def _bound(self, region: Region) -> None:
        for value in region.ops:
            if value not in self.live:
                continue
            if value.op == "loop":
                self._bound_loop(value)
            elif value.dtype.kind in "iub" and value.op != "store":
                self.range[value] = self._bounds_of(value)

    def _bound_loop(self, value: Value) -> None:
        loop = value.attr
        whole = [k for k in self.carried(value) if loop.body.params[k].dtype.kind in "iub"]
        counter = self.counter(value)
        for k in whole:
            self.range[loop.body.params[k]] = self.bounds(value.args[k])
        for turn in range(TURNS + 1):
            if counter is not None:
                k, bound = counter
                self.range[loop.body.params[k]] = self.bounds(value.args[k])[0], self.bounds(bound)[1] - 1
            self._bound(loop.condition)
            self._bound(loop.body)
            moved = False
            for k in whole:
                if counter is not None and k == counter[0]:
                    continue
                param = loop.body.params[k]
                (low, high), (new_low, new_high) = self.range[param], self.bounds(loop.body.results[k])
                every = _every(param.dtype)
                wide = (
                    low if new_low >= low else every[0] if turn else new_low,
                    high if new_high <= high else every[1] if turn else new_high,
                )
                moved |= wide != (low, high)
                self.range[param] = wide
            if not moved:
                break
        else:
            for k in whole:
                self.range[loop.body.params[k]] = _every(loop.body.params[k].dtype)
            self._bound(loop.condition)
            self._bound(loop.body)
        if counter is not None:
            low, high = self.bounds(value.args[counter[0]])
            self.after[loop.body.params[counter[0]]] = low, max(high, self.bounds(counter[1])[1])

    def counter(self, value: Value) -> tuple[int, Value] | None:
        """Where a loop counts up by one as long as it is below a bound, the same in all lanes: place and bound.

        Where lanes leave a loop one by one, those that are done go on with numbers beyond the bound.
        """
        return None if value in self.varying else self._counted(value)

    def _counted(self, value: Value) -> tuple[int, Value] | None:
        """Where each lane counts up by one as long as it is below a bound of its own: place and bound."""
        loop, test = value.attr, self.of(value.attr.condition.results[0])
        if test.op != "lt":
            return None
        for k, param in enumerate(loop.body.params):
            after = loop.body.results[k]
            counts = (
                after.op == "add"
                and {self.of(x) for x in after.args} >= {param}
                and any(x.number == 1 for x in after.args)
            )
            if test.args[0] is param and counts:
                bound = self.of(test.args[1])
                if bound not in loop.body.params and self.bounds(bound)[1] < _every(bound.dtype)[1]:
                    return k, bound
        return None

    def _bounds_of(self, value: Value) -> tuple[int, int]:
        every = _every(value.dtype)
        if (buffer := buffer_of(value)) is not None:
            known = buffer.known
            return every if known is None or not known.size else (int(known.min()), int(known.max()))
        if value.op == "part":
            return self.bounds(value.args[0])
        if value.op not in _RANGES or any(x.dtype.kind == "f" for x in value.args[-1:]):
            return every
        low, high = _RANGES[value.op](*(self.bounds(x) for x in value.args))
        return (low, high) if every[0] <= low and high <= every[1] else every


@cache
def _every(dtype: np.dtype) -> tuple[int, int]:
    if dtype.kind == "b":
        return 0, 1
    return (int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)) if dtype.kind in "iu" else (0, 0)


def _products(x: tuple[int, int], y: tuple[int, int]) -> tuple[int, int]:
    corners = [a * b for a in x for b in y]
    return min(corners), max(corners)


def _quotients(x: tuple[int, int], y: tuple[int, int]) -> tuple[int, int]:
    if y[0] <= 0:
        raise OverflowError
    corners = [abs(a) // b * (1 if a >= 0 else -1) for a in x for b in y]
    return min(corners), max(corners)


_UNKNOWN = -(2**70), 2**70
_RANGES: dict[str, Any] = {
    "add": lambda x, y: (x[0] + y[0], x[1] + y[1]),
    "sub": lambda x, y: (x[0] - y[1], x[1] - y[0]),
    "mul": _products,
    "neg": lambda x: (-x[1], -x[0]),
    "max": lambda x, y: (max(x[0], y[0]), max(x[1], y[1])),
    "min": lambda x, y: (min(x[0], y[0]), min(x[1], y[1])),
    "select": lambda _, x, y: (min(x[0], y[0]), max(x[1], y[1])),
    "convert": lambda x: x,
    "div": lambda x, y: _quotients(x, y) if y[0] > 0 else _UNKNOWN,
    "rem": lambda x, y: ((0 if x[0] >= 0 else 1 - y[1]), y[1] - 1) if y[0] > 0 else _UNKNOWN,
    "and": lambda x, y: (0, min(v[1] for v in (x, y) if v[0] >= 0)) if max(x[0], y[0]) >= 0 else _UNKNOWN,
    "shift_right_logical": lambda x, y: (
        (x[0] >> y[0], x[1] >> y[0]) if x[0] >= 0 and y[0] == y[1] < 32 else _UNKNOWN
    ),
    "shift_right_arithmetic": lambda x, y: (
        (x[0] >> y[0], x[1] >> y[0]) if 0 <= y[0] == y[1] < 32 else _UNKNOWN
    ),
}
