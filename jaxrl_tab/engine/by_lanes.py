"""Runs on a CPU that `lanes` compiles: threads, each with blocks of lanes.

A run is one lane. Each thread works through blocks of lanes, and hands some of them back at a time, so memory stays
bounded and progress can be shown. Which runs are in a block, in which thread it is done, and how wide the vectors
are changes no bit of what a run gives.
"""

import functools
import hashlib
import os
import time
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

import jax
import numpy as np

from jaxrl_tab.core import memory, rng
from jaxrl_tab.core.cores import cores
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.errors import RunError
from jaxrl_tab.core.types import Algorithm, Environment, fitted, init_learner
from jaxrl_tab.engine import backend, programs, provenance
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.log import Log
from jaxrl_tab.engine.onward import split
from jaxrl_tab.engine.room import (
    CALL_BYTES,
    LANES,
    Signature,
    is_no_memory,
    needs_of_program,
    program_arguments,
    signature,
    traced_program,
)
from jaxrl_tab.engine.runs import Runs
from jaxrl_tab.lanes import machine
from jaxrl_tab.lanes.code import Unsupported
from jaxrl_tab.lanes.kernel import Kernel, Stop
from jaxrl_tab.lanes.program import MANY, Program, compile
from jaxrl_tab.lanes.target import Target, host

TASK_SECONDS = 0.1  # about so long a thread works before it hands results back
MEASURED_ROWS = 1000  # of a run alone: what XLA measures at the end of a row is a call, of some 0.14 ms
ASK_SECONDS = 0.2  # after so long at most the main thread sees that it is interrupted


def check(method: Any) -> None:
    """Raises Unsupported where a method says that XLA does better what it does."""
    if why := of_method(method).left_to_xla:
        raise Unsupported(why)


def threads(devices: Sequence[Any] | None = None) -> int:
    """How many threads work: as many as there are devices, where their number was chosen; else one for each core."""
    if devices is not None:
        return len(devices)
    number = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    if number > 0:
        return number
    if "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return len(jax.local_devices(backend="cpu"))
    return cores()


def target() -> Target:
    """This processor. Where XLA does not round a product and a sum at once, `lanes` does not do it either.

    That is so where XLA is told not to use such instructions, or not to optimise; then LLVM does not, either.
    """
    unoptimised = jax.config.read(provenance.UNOPTIMISED)
    apart = unoptimised or provenance.is_left_out("fma")
    found = host().without("fma") if apart else host()
    return found._replace(effort=0) if unoptimised else found


class ByLanes:
    """A batch of runs, compiled.

    Attributes:
        threads: how many work.
        most: how many blocks of lanes a thread does before it hands them back, at most.
    """

    def __init__(self, runs: Runs, room: int, devices: Sequence[Any] | None):
        """Compiles. Raises Unsupported where the program holds something for which there is no rule."""
        check(split(runs.algorithms).method)
        # `room` is that of a device. There may be more threads, but no more than there is memory for.
        on_all = room * len(devices or jax.local_devices())
        self.runs = runs
        self.threads = max(1, min(threads(devices), on_all // runs.needs.call.bytes(LANES, blocks=1)))
        results, self._tree = jax.tree.flatten(runs.needs.results)
        arguments = runs.arguments(np.array(0))
        program, lanes = signature(arguments), lanes_for(-(-len(runs) // self.threads))
        self._kernel = kernel(runs.budget, program, Shared(arguments[-1], program), len(results), lanes)
        self.lanes, scratch = self._kernel.program.lanes, self._kernel.program.scratch
        # While a thread works on some blocks, what it gave before may still wait to be kept.
        left = min(on_all // self.threads, CALL_BYTES) - scratch
        self.most = max(1, left // (2 * self.lanes * runs.needs.call.kept))

    def results(self) -> Generator[tuple[np.ndarray, Any]]:
        """The places of some runs, int [n], and what they gave: their tables and the Log, [n, ...] each."""
        first, blocks = 0, 1
        again: list[tuple[int, int]] = []  # tasks for which there was not enough memory, cut in two
        pending: dict[Future, tuple[int, int, Stop]] = {}
        with ThreadPoolExecutor(self.threads) as pool:
            try:
                while first < len(self.runs) or again or pending:
                    # One task more than there are threads, so that none ever waits for this one.
                    while (first < len(self.runs) or again) and len(pending) <= self.threads:
                        task = *(again.pop() if again else (first, blocks)), Stop()
                        pending[pool.submit(self._run, *task)] = task
                        first = max(first, task[0] + task[1] * self.lanes)
                    for future in wait(pending, ASK_SECONDS, FIRST_COMPLETED).done:
                        begin, size, _ = pending.pop(future)
                        try:
                            places, output, seconds = future.result()
                        except (MemoryError, jax.errors.JaxRuntimeError) as error:
                            if not is_no_memory(error):
                                raise
                            again += self._halves(begin, size)
                            blocks = 1
                            continue
                        yield places, output
                        # The last tasks are small, so that all threads end at about the same time.
                        left = -(-(len(self.runs) - first) // (2 * self.threads * self.lanes))
                        blocks = max(1, min(self.most, int(size * TASK_SECONDS / seconds), left))
            finally:  # also where it is interrupted, or nobody wants the rest
                for *_, stop in pending.values():
                    stop.set()

    def _halves(self, first: int, blocks: int) -> list[tuple[int, int]]:
        """A task in two. Raises RunError where it is too small for that."""
        if blocks == 1:
            needed = self.runs.needs.call.bytes(self.lanes, 1)
            raise RunError(
                f"there is not enough memory for {self.lanes} runs at a time in each thread ({self.threads}), "
                f"the smallest number possible, which need {memory.words(self.threads * needed)}: take a "
                "larger log_every, or a smaller environment"
            ) from None
        self.most = half = blocks // 2
        return [(first, half), (first + half * self.lanes, blocks - half)]

    def _run(self, first: int, blocks: int, stop: Stop) -> tuple[np.ndarray, Any, float]:
        """What so many blocks of runs from place `first` on give, and how many seconds it took."""
        begun = time.perf_counter()
        places = first + np.arange(blocks * self.lanes)
        outputs = self._kernel(*_inputs(self.runs.arguments(places), len(places)), stop=stop)
        there = places[places < len(self.runs)]
        output = jax.tree.unflatten(self._tree, [x[: len(there)] for x in outputs])
        return there, output, time.perf_counter() - begun


def alone(key: Any, algorithm: Algorithm, env: Environment, budget: Budget) -> tuple[Any, Log] | None:
    """What a single run gives, as `train`; None where it is not compiled by `lanes`.

    That is so, too, where nobody asked for a backend and more than `MEASURED_ROWS` rows would each call XLA: then XLA
    does the whole run sooner.

    Raises:
        InputError: `lanes` was asked for, and does not compile this.
    """
    if backend.chosen() != "lanes" or not rng.is_threefry(key):
        return None
    rows = (budget.num_steps or budget.num_episodes or 0) // budget.row
    if backend.asked() == "auto" and (budget.record or budget.exact) and rows > MEASURED_ROWS:
        return None
    arguments = program_arguments(budget, key, None, algorithm, env)
    program = signature(arguments)
    kinds, structure = gives(budget, program)
    try:
        check(algorithm)
        of_one = kernel(budget, program, Shared(arguments[-1], program), len(kinds), 1)
    except Unsupported as reason:
        backend.fall_back(algorithm, env, reason)
        return None
    inputs = [np.broadcast_to(x, (of_one.program.lanes, *x.shape)) for x in _of_run(arguments, program)]
    # As many steps take as long as they took before; nobody knows how long episodes are.
    is_quick = budget.num_steps is not None and of_one.seconds < ASK_SECONDS / 2
    outputs = of_one(*inputs) if is_quick else _called(of_one, *inputs)
    # The table comes first, and is the learner's as well, or made of what the learner has.
    (_, log), learner = jax.tree.unflatten(structure, [None, *_as_jax(*(x[0] for x in outputs[1:]))])
    return learner, log


@jax.jit
def _as_jax(*arrays: Any) -> tuple[Any, ...]:
    """Arrays of NumPy as JAX has them: all at once that takes a fifth of what it takes one by one."""
    return arrays


@functools.lru_cache(maxsize=64)
def gives(budget: Budget, signature: Signature) -> tuple[list[Any], Any]:
    """The kinds of all arrays that a run gives, and their structure: ((table, Log), state of the learner)."""
    _, _, (algorithm, _), (env, _) = signature.arguments

    def learner(algorithm: Algorithm, env: Environment) -> Any:
        return init_learner(fitted(algorithm, env), env)

    results = needs_of_program(budget, signature).results
    return jax.tree.flatten((results, jax.eval_shape(learner, algorithm, env)))


def _called(kernel: Kernel, *inputs: np.ndarray) -> list[np.ndarray]:
    """What a kernel gives; it can be interrupted. To start a thread and to wake up takes some 0.2 to 0.5 ms."""
    stop = Stop()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(kernel, *inputs, stop=stop)
        try:
            while not future.done():
                wait([future], ASK_SECONDS)
        finally:
            stop.set()
        return future.result()


class Shared:
    """What is the same for all runs of a program: the leaves of the environment. Two that are equal are one key."""

    def __init__(self, env: Any, program: Signature):
        leaves = jax.tree.leaves(env)
        self.leaves = _plain(leaves, program.avals[len(program.avals) - len(leaves) :])
        self._hash = hash(tuple((x.dtype.str, x.shape, x.tobytes()) for x in self.leaves))

    @functools.cached_property
    def digest(self) -> str:
        """A name of them, the same in every process."""
        parts = (f"{x.dtype} {x.shape} ".encode() + x.tobytes() for x in self.leaves)
        return hashlib.sha256(b"".join(parts)).hexdigest()

    def __eq__(self, other: object) -> bool:
        if (
            not isinstance(other, Shared)
            or self._hash != other._hash
            or len(self.leaves) != len(other.leaves)
        ):
            return False
        return all(x is y or _are_same(x, y) for x, y in zip(self.leaves, other.leaves, strict=True))

    def __hash__(self) -> int:
        return self._hash


def _are_same(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether two arrays have the same bits."""
    return x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()


def _of_run(arguments: tuple, program: Signature) -> list[np.ndarray]:
    """What differs from run to run: what names its random numbers, and its hyperparameters."""
    leaves = jax.tree.leaves(arguments[:-1])
    return _plain(leaves, program.avals[: len(leaves)])


def _plain(leaves: list[Any], kinds: Sequence[Any]) -> list[np.ndarray]:
    """Leaves in the dtypes in which JAX takes them."""
    return [np.asarray(x, kind.dtype) for x, kind in zip(leaves, kinds, strict=True)]


def _inputs(arguments: tuple, lanes: int) -> list[np.ndarray]:
    """The same of so many runs, [lanes, ...] each."""
    root, *of_runs = _of_run(arguments, signature(arguments))
    return [np.broadcast_to(root, (lanes, *root.shape)), *of_runs]


def lanes_for(runs: int) -> int:
    """How many lanes a program for so many runs in a thread has: one of three numbers, so that few are made."""
    return next((size for size in (1, target().width) if runs <= size), MANY)


@functools.lru_cache(maxsize=64)
def kernel(budget: Budget, signature: Signature, shared: Shared, results: int, lanes: int) -> Kernel:
    """The program for so many lanes. It gives the first `results` of the arrays that a run gives."""

    def make() -> Program:
        closed = traced_program(budget, signature).jaxpr
        inputs = len(closed.jaxpr.invars) - len(shared.leaves)
        varying = [True] * inputs + [False] * len(shared.leaves)
        return compile(
            closed, varying, [*[None] * inputs, *shared.leaves], results, lanes=lanes, target=target()
        )

    name = "lanes", machine.version(), target(), budget, signature.name, shared.digest, results, lanes
    return Kernel(programs.kept(name, make, Program.to_bytes, Program.from_bytes))
