"""Compiled programs, as plain data that can be kept."""

import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.lanes import calls, machine
from jaxrl_tab.lanes.analysis import Facts, operations
from jaxrl_tab.lanes.calls import Exported, Kind
from jaxrl_tab.lanes.code import Unsupported
from jaxrl_tab.lanes.emit import emit
from jaxrl_tab.lanes.layout import lane_after_lane
from jaxrl_tab.lanes.lower import lower
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.target import Target, host

WAITING = 8  # lanes at most that go side by side, where they wait for one another in each step
NARROWEST = 4  # lanes that go side by side, where there are many
CACHE = 24 * 2**10  # bytes, of the 32 KiB or more of a core's first cache
LONG = 32  # numbers; what is shorter does not count there
OFTEN = 8  # nor does what is done so many times less often than the turns of the innermost loop
MANY = 2**31  # lanes, where nobody says how many there are
FEWEST_IN_CALLS = 8  # of fewer lanes XLA works out some numbers otherwise, in the last bit


class Program(NamedTuple):
    """A compiled program.

    Attributes:
        code: the machine code.
        target: the processor for which it is.
        lanes: how many of them it does side by side: the number of runs must be a multiple of it.
        scratch: the bytes with which a thread works.
        inputs, outputs: the shapes and dtypes of what it takes and gives, for one lane.
        tables: the arrays that it reads and that are the same for all.
        calls: what it calls and XLA compiles.
    """

    code: bytes
    target: Target
    lanes: int
    scratch: int
    inputs: list[Kind]
    outputs: list[Kind]
    tables: list[np.ndarray]
    calls: list[Exported]

    def to_bytes(self) -> bytes:
        """All of it: how long the head is, the head, and what is no text, one after another."""
        parts = [self.code, *(x.tobytes() for x in self.tables), *(call.code for call in self.calls)]
        head = {
            "target": list(self.target),
            "lanes": self.lanes,
            "scratch": self.scratch,
            "inputs": [_plain(kind) for kind in self.inputs],
            "outputs": [_plain(kind) for kind in self.outputs],
            "tables": [_plain((x.shape, x.dtype)) for x in self.tables],
            "calls": [[[_plain(kind) for kind in kinds] for kinds in call[1:]] for call in self.calls],
            "sizes": [len(part) for part in parts],
        }
        text = json.dumps(head).encode()
        return b"".join([len(text).to_bytes(8, "little"), text, *parts])

    @staticmethod
    def from_bytes(data: bytes) -> "Program":
        """The program of which `to_bytes` made these bytes."""
        start = 8 + int.from_bytes(data[:8], "little")
        head = json.loads(data[8:start])
        ends = np.cumsum([start, *head["sizes"]]).tolist()
        code, *parts = (data[a:b] for a, b in pairwise(ends))
        tables = [_kind_of(*x) for x in head["tables"]]
        return Program(
            code,
            Target(*head["target"]),
            head["lanes"],
            head["scratch"],
            [_kind_of(*x) for x in head["inputs"]],
            [_kind_of(*x) for x in head["outputs"]],
            [
                np.frombuffer(x, dtype).reshape(shape)
                for x, (shape, dtype) in zip(parts, tables, strict=False)
            ],
            [
                Exported(x, *([_kind_of(*kind) for kind in kinds] for kinds in both))
                for x, both in zip(parts[len(tables) :], head["calls"], strict=True)
            ],
        )


def compile(
    closed: Any,
    varying: Sequence[bool],
    others: Sequence[Any] | None = None,
    results: int | None = None,
    *,
    lanes: int = MANY,
    target: Target | None = None,
) -> Program:
    """Compiles the jaxpr of one run for many of them, each in a lane.

    Args:
        closed: the jaxpr.
        varying: for each of its arguments, whether it differs from lane to lane.
        others: for each of its arguments the array, if it does not; else None.
        results: how many of its results are wanted, from the first on; by default all.
        lanes: how many there are: a few do not go side by side with many that are not wanted.
        target: the processor, by default this one.

    Raises:
        Unsupported: it holds something for which there is no rule, or of which the code is refused by LLVM; the
            message says what.
    """
    target = target or host()
    code = lower(closed, varying, others or [None] * len(varying), results)
    facts = Facts(code.region, alone=lanes == 1 and not code.calls)
    emitted = emit(code, facts, target, *block(code, facts, target, lanes))
    of = lambda variables: [(v.aval.shape, np.dtype(v.aval.dtype)) for v in variables]
    return Program(
        _object_code(emitted.text, target),
        target,
        emitted.lanes,
        emitted.scratch,
        of(v for v, differs in zip(closed.jaxpr.invars, varying, strict=True) if differs),
        of(closed.jaxpr.outvars[:results]),
        emitted.tables,
        [calls.exported(call, emitted.lanes) for call in code.calls],
    )


def _object_code(text: str, target: Target) -> bytes:
    """Machine code. What LLVM refuses is a defect of ours; whoever wants an answer gets it from XLA nevertheless."""
    try:
        return machine.object_code(text, target)
    except RuntimeError as error:
        raise Unsupported(f"LLVM refuses its code: {' '.join(str(error).split())}") from error


def block(code: Lowering, facts: Facts, target: Target, lanes: int) -> tuple[int, int]:
    """The width of the vectors, and how many groups of them are done side by side, for so many lanes.

    There are three sizes for a program, so that few are compiled: for one lane, for as many as a vector of the
    processor holds, and for more. What is best then was measured, see the documentation of performance.
    """
    fewest = FEWEST_IN_CALLS if code.calls else 1
    if lanes == 1:
        return fewest, 1
    width, groups = (target.width, 1) if lanes <= target.width else _of_many(code, facts, target.width)
    return width, max(groups, -(-fewest // width))


def _of_many(code: Lowering, facts: Facts, width: int) -> tuple[int, int]:
    """The width and the groups of a block of many lanes, where a vector of the processor has a width."""
    loops = [value for value in operations(code.region) if value.op == "loop" and facts.varies(value)]
    waiting = [loop for loop in loops if not facts.is_branch(loop)]
    # Where lanes leave loops one by one, the more go side by side, the longer they wait: most of all in each step.
    if waiting:
        return min(width, WAITING) if any(map(facts.is_within_another, waiting)) else width, 1
    if swept := _swept(code, facts, width):
        while width > NARROWEST and swept * width > CACHE:
            width //= 2
        return width, 1
    # Two groups: while one waits for memory, the other is worked on. And two vectors at once, but where there are
    # branches: the fewer lanes go side by side, the more often none of them takes one, and it is left out.
    return width if loops else 2 * width, 2


def _swept(code: Lowering, facts: Facts, width: int) -> int:
    """The bytes of a lane in arrays that are gone through again and again: those of a group should be in the cache."""
    by_lanes = lane_after_lane(facts, code.region, width)
    live = [value for value in operations(code.region) if value in facts.live]
    often = max((facts.turns(value) for value in live), default=0) // OFTEN
    stored = {value.attr for value in live if value.op == "store" and facts.turns(value) >= often}
    swept = [b for b in stored - by_lanes if b.role == "scratch" and b in facts.varying and b.size >= LONG]
    return sum(b.size * b.dtype.itemsize for b in swept)


def _plain(kind: Kind) -> list[Any]:
    """A shape and a dtype as JSON has them."""
    shape, dtype = kind
    return [dtype.name, *shape]


def _kind_of(dtype: str, *shape: int) -> Kind:
    return shape, np.dtype(dtype)
