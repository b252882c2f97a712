"""Runs of `train` within a program of somebody's own, on a CPU: under `jit` and `vmap` they are done by `lanes`, too.

There a run is one primitive. `vmap` makes a batch of it; when the program is made for a CPU, the size of the batch is
known, `lanes` compiles the run, and XLA's program calls Python, which has all runs of the batch done at once, by a
thread for each core. For other devices, for derivatives, and where `lanes` does not compile the run, it is what XLA
makes of it.
"""

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray, Tracer
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

from jaxrl_tab.core import rng
from jaxrl_tab.core.types import Algorithm, Environment, fitted, table_of
from jaxrl_tab.engine import backend, by_lanes
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.log import Log
from jaxrl_tab.engine.room import Signature, program_arguments, signature
from jaxrl_tab.engine.traced import unchecked
from jaxrl_tab.lanes.code import Unsupported
from jaxrl_tab.lanes.kernel import Kernel

TASKS = 4  # of a thread, so that all end at about the same time
_TRACED = object()  # stands for a traced argument


def train(key: Any, algorithm: Algorithm, env: Environment, budget: Budget) -> tuple[Any, Log] | None:
    """What `train` gives within a program, where `lanes` may do it there; None where XLA has to.

    That is so where the environment is traced, whose numbers are constants of a kernel, and where something is
    measured at the ends of rows: that is a program of XLA, and one cannot wait for another.
    """
    measures = budget.exact or budget.record is not None
    if measures or backend.chosen() != "lanes" or not rng.is_threefry(key):
        return None
    arguments = program_arguments(budget, key, None, algorithm, env)
    *of_run, of_env = arguments
    if any(isinstance(x, Tracer) for x in jax.tree.leaves(of_env)):
        return None
    leaves, tree = jax.tree.flatten(of_run)
    program = signature(arguments)
    # Of a tracer only the place is kept: it is nothing any more when its program has been traced.
    known = [_TRACED if isinstance(x, Tracer) else x for x in leaves]
    kinds, structure = by_lanes.gives(budget, program)
    run = _Run(env, budget, program, by_lanes.Shared(of_env, program), known, tree, kinds)

    @jax.custom_jvp
    def outputs(*traced: Any) -> tuple[Any, ...]:
        return tuple(_runs.bind(*traced, run=run, batch=()))

    @outputs.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        return jax.jvp(run.by_xla, primals, tangents)

    given = outputs(*(x for x in leaves if isinstance(x, Tracer)))
    (_, log), learner = jax.tree.unflatten(structure, given)
    return learner, log


@dataclasses.dataclass(frozen=True, eq=False)
class _Run:
    """A run, of which some arguments are traced.

    Attributes:
        env, budget, program, shared: as in `by_lanes.kernel`.
        known, tree: the leaves of its arguments but the environment's, and their structure.
        gives: the kinds of the arrays that it gives.
    """

    env: Environment
    budget: Budget
    program: Signature
    shared: by_lanes.Shared
    known: list[Any]
    tree: Any
    gives: list[Any]

    def arguments(self, traced: Sequence[Any]) -> list[Any]:
        """The leaves of its arguments but the environment's."""
        rest = iter(traced)
        return [next(rest) if x is _TRACED else x for x in self.known]

    def by_xla(self, *traced: Any) -> tuple[Any, ...]:
        """What it gives, as JAX traces it."""
        data, _, (algorithm, _) = jax.tree.unflatten(self.tree, self.arguments(traced))
        learner, log = unchecked(rng.from_data(data), algorithm, self.env, None, self.budget)
        table = table_of(fitted(algorithm, self.env), self.env.num_states, learner)
        return tuple(jax.tree.leaves(((table, log), learner)))

    def kernel(self, runs: int) -> Kernel | None:
        """By which threads do so many of it; None where `lanes` does not compile it.

        Raises:
            InputError: `lanes` was asked for, and does not.
        """
        lanes = by_lanes.lanes_for(-(-runs // _threads(runs)))
        _, _, (algorithm, _) = jax.tree.unflatten(self.tree, self.known)
        try:
            by_lanes.check(algorithm)
            return by_lanes.kernel(self.budget, self.program, self.shared, len(self.gives), lanes)
        except Unsupported as reason:
            backend.fall_back(algorithm, self.env, reason)
            return None


def _threads(runs: int) -> int:
    return max(1, min(by_lanes.threads(), runs))


# --- the primitive -----------------------------------------------------------------------------------

_runs = Primitive(
    "jaxrl_tab_runs"
)  # (traced arguments of `run`, [*batch, ...] each) -> what it gives, likewise
_runs.multiple_results = True


@_runs.def_abstract_eval
def _kinds(*traced: Any, run: _Run, batch: tuple[int, ...]) -> list[Any]:
    return [ShapedArray((*batch, *x.shape), x.dtype) for x in run.gives]


def _batched(traced: Sequence[Any], axes: Sequence[int | None], *, run: _Run, batch: tuple[int, ...]) -> Any:
    """By `vmap`: the batch has one more axis, which comes first."""
    size = next(x.shape[axis] for x, axis in zip(traced, axes, strict=True) if axis is not None)
    first = [
        jnp.broadcast_to(x, (size, *x.shape)) if axis is None else jnp.moveaxis(x, axis, 0)
        for x, axis in zip(traced, axes, strict=True)
    ]
    outputs = _runs.bind(*first, run=run, batch=(size, *batch))
    return outputs, [0] * len(outputs)


def _by_xla(*traced: Any, run: _Run, batch: tuple[int, ...]) -> tuple[Any, ...]:
    runs = run.by_xla
    for _ in batch:
        runs = jax.vmap(runs)
    return runs(*traced)


def _by_lanes(*traced: Any, run: _Run, batch: tuple[int, ...]) -> tuple[Any, ...]:
    if (kernel := run.kernel(math.prod(batch))) is None:
        return _by_xla(*traced, run=run, batch=batch)
    kinds = [jax.ShapeDtypeStruct((*batch, *x.shape), x.dtype) for x in run.gives]
    return tuple(jax.pure_callback(partial(_done, run, kernel, batch), kinds, *traced))


@_runs.def_impl
def _at_once(*traced: Any, run: _Run, batch: tuple[int, ...]) -> Sequence[Any]:
    """Under `vmap` alone there is no program."""
    if (kernel := run.kernel(math.prod(batch))) is None:
        return _by_xla(*traced, run=run, batch=batch)
    return [jnp.asarray(x) for x in _done(run, kernel, batch, *traced)]


def _done(run: _Run, kernel: Kernel, batch: tuple[int, ...], *traced: Any) -> list[np.ndarray]:
    """What a batch of runs gives. XLA's program calls it, and waits: so nothing is done by JAX here."""
    number, lanes = math.prod(batch), kernel.program.lanes
    threads = _threads(number)
    kinds = run.program.avals[: len(run.known)]
    inputs = [
        np.broadcast_to(np.asarray(x, kind.dtype), (*batch, *kind.shape)).reshape((number, *kind.shape))
        for x, kind in zip(run.arguments(traced), kinds, strict=True)
    ]
    outputs = [np.empty((number, *x.shape), x.dtype) for x in run.gives]
    of_task = max(1, -(-number // (TASKS * threads * lanes))) * lanes

    def do(first: int) -> None:
        # The last run fills up what is left of the last lanes.
        places = np.minimum(np.arange(first, first + of_task), number - 1)
        for output, x in zip(outputs, kernel(*(x[places] for x in inputs)), strict=True):
            output[first : first + of_task] = x[: number - first]

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(do, range(0, number, of_task)))
    return [x.reshape((*batch, *x.shape[1:])) for x in outputs]


batching.primitive_batchers[_runs] = _batched
mlir.register_lowering(_runs, mlir.lower_fun(_by_xla))
mlir.register_lowering(_runs, mlir.lower_fun(_by_lanes), platform="cpu", cacheable=False)
