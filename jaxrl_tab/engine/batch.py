"""Many runs at once. The one place that knows how runs are executed.

On a CPU they are compiled by `lanes` (`by_lanes`), on other devices, and where a program holds something that
`lanes` does not compile, by XLA (`by_xla`); `backend` says which. How many bytes all this takes is known before
anything is compiled: see `room.plan`.
"""

import contextlib
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxrl_tab.core.types import Algorithm, Environment
from jaxrl_tab.engine import backend
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.by_lanes import ByLanes
from jaxrl_tab.engine.by_xla import ByXLA
from jaxrl_tab.engine.loop import Run
from jaxrl_tab.engine.onward import Onward, split
from jaxrl_tab.engine.runs import Runs
from jaxrl_tab.lanes.code import Unsupported


class Seconds(NamedTuple):
    """Time spent running, and time spent compiling: 0 where the program was there already."""

    running: float
    compiling: float


def run(
    env: Environment,
    algorithms: Algorithm | Onward,
    root: jax.Array,
    seeds: np.ndarray,
    budget: Budget,
    keep: Callable[[np.ndarray, Any], None],
    progress: Callable[[int], None] = lambda done: None,
    room: int = sys.maxsize,
    devices: Sequence[Any] | None = None,
    runs: np.ndarray | None = None,
    begun: Run | None = None,
) -> Seconds:
    """Trains every run of a batch, or some of them.

    Args:
        env, algorithms, root, seeds, budget: as in `Runs`.
        keep: is called with the places in `runs` of some, int [n], and what they gave: their tables, float
            [n, S, A], and the Log of them, [n, rows] each. It must copy what it wants to keep.
        progress: is called with the number of runs finished so far.
        room: the bytes that a call may take on each device, or in each thread.
        devices: the JAX devices to use; all of this process by default. `lanes` has a thread for each.
        runs: the numbers of the runs to train, int [n]; all by default.
        begun: where these are, as in `Runs`.

    Raises:
        InputError: `lanes` was asked for, and does not compile this.
        RunError: the memory runs out, even with the smallest call. Calls that are too large are made smaller.
    """
    seeds = np.asarray(seeds, np.uint32)
    numbers = np.arange(seeds.size) if runs is None else runs
    batch = Runs(env, algorithms, root, seeds, budget, numbers, begun)
    started = time.perf_counter()
    compiled_runs = _compiled(batch, room, devices)
    compiled, done = time.perf_counter(), 0
    with contextlib.closing(compiled_runs.results()) as results:
        for places, output in results:
            keep(places, output)
            done += len(places)
            progress(done)
    return Seconds(time.perf_counter() - compiled, compiled - started)


def _compiled(runs: Runs, room: int, devices: Sequence[Any] | None) -> ByLanes | ByXLA:
    """The runs, compiled by the backend that is chosen, or by XLA where `lanes` cannot do it."""
    if backend.chosen() == "lanes":
        try:
            return ByLanes(runs, room, devices)
        except Unsupported as reason:
            backend.fall_back(split(runs.algorithms).method, runs.env, reason)
    elif backend.asked() == "auto" and not backend.is_installed() and jax.default_backend() == "cpu":
        backend.tell(
            "XLA compiles the runs, which makes them slower than lanes, which needs llvmlite: pip install llvmlite"
        )
    return ByXLA(runs, room, devices)
