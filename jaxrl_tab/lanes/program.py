"""Compiled programs, as plain data that can be kept."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.lanes import calls, machine
from jaxrl_tab.lanes.calls import Exported
from jaxrl_tab.lanes.emit import emit
from jaxrl_tab.lanes.lower import lower
from jaxrl_tab.lanes.target import Target, host

GROUPS = 4  # of as many lanes as a vector holds, that a processor works on in turn
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
    inputs: list[tuple[tuple[int, ...], np.dtype]]
    outputs: list[tuple[tuple[int, ...], np.dtype]]
    tables: list[np.ndarray]
    calls: list[Exported]


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
        Unsupported: it holds something for which there is no rule; the message says what.
    """
    target = target or host()
    code = lower(closed, varying, others or [None] * len(varying), results)
    width, groups = block(target, lanes)
    if code.calls:
        groups = max(groups, -(-FEWEST_IN_CALLS // width))
    emitted = emit(code, target, width, groups)
    of = lambda variables: [(v.aval.shape, np.dtype(v.aval.dtype)) for v in variables]
    return Program(
        machine.object_code(emitted.text, target),
        target,
        emitted.lanes,
        emitted.scratch,
        of(v for v, differs in zip(closed.jaxpr.invars, varying, strict=True) if differs),
        of(closed.jaxpr.outvars[:results]),
        emitted.tables,
        [calls.exported(call, emitted.lanes) for call in code.calls],
    )


def block(target: Target, lanes: int) -> tuple[int, int]:
    """The width of the vectors, and how many groups of them are done side by side, for so many lanes.

    There are three sizes, so that few programs are compiled: for one lane, for a vector, and for as many vectors
    as suit a processor.
    """
    if lanes == 1:
        return 1, 1
    return target.width, 1 if lanes <= target.width else GROUPS
