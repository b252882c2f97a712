"""Many runs at once: devices x lanes. The one place that knows about flags, devices and blocks.

A run is one lane. On a CPU 64 lanes go side by side through `vmap`: enough to fill the vector units, few
enough that their tables stay in the cache. Each device (each core) works through blocks of 64 lanes one after
another, and hands a few of them back at a time, so memory stays bounded and progress can be shown. Every
program has exactly this shape, whatever the number of runs: the last block is filled up with copies. (Where the
memory runs out there are fewer lanes, which gives the same bits: see `FEWEST_LANES`.) That is why a result
depends on neither the batch it was computed in, nor its place there, nor the number of devices, to the last bit.
Any other device is given one block, as wide as there are runs for it and as fits its memory.

How many bytes all this takes is known before anything is compiled: see `memory`, and `plan`.

Two settings must be made before JAX starts its backend:

- `set_flags`, on import: XLA's CPU backend runs a loop's body as a list of small kernels, at a microsecond
  each, unless the loop's data are smaller than a threshold; then the whole loop becomes one kernel. We raise
  that threshold to 16 MiB. Other loops of the process are compiled under it too: small ones gain, one whose
  body multiplies large matrices may lose XLA's parallel matrix product. `JAXRL_TAB_XLA=0` turns it off.
- `use_all_cores`, by the command line, or by you before anything is computed: one JAX device per core.
"""

import functools
import logging
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental import serialize_executable
from jax.extend.core import jaxpr_as_fun
from jax.sharding import AxisType, Mesh, PartitionSpec

from jaxrl_tab.core import memory
from jaxrl_tab.core.checks import InputError, RunError
from jaxrl_tab.core.types import Algorithm, Environment, FiniteEnvironment
from jaxrl_tab.engine import programs, provenance
from jaxrl_tab.engine.train import Record, bytes_of_words, default_log_every, in_full, unchecked
from jaxrl_tab.exact import planning

LANES = 64
BLOCKS = 16  # of a device in one call, at most
FEWEST_LANES = 8  # on a CPU, where memory runs out: with fewer, exact values would differ in the last bit
CALL_BYTES = 2**28  # that it takes on a device, at most, unless one block alone is larger
CALL_SECONDS = 0.2  # about so long a call shall take
_NO_MEMORY = "RESOURCE_EXHAUSTED"  # in the error of JAX
_THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"


def set_flags() -> None:
    """Asks XLA for one kernel per loop, unless the environment already says something about it."""
    flags = os.environ.get("XLA_FLAGS", "")
    if os.environ.get("JAXRL_TAB_XLA") == "0" or _THRESHOLD in flags:
        return
    if _started():
        warnings.warn(
            "JAX had computed something before jaxrl_tab was imported, so its loops run several times slower "
            "(the results are the same): import jaxrl_tab first",
            stacklevel=2,
        )
    else:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={_THRESHOLD}={2**24}".strip()


def use_all_cores() -> bool:
    """Makes one JAX device of each CPU core. Call it before anything is computed with JAX.

    Returns:
        Whether it could be done; False where JAX has already started, or the user has chosen a number.
    """
    chosen = jax.config.jax_num_cpu_devices != -1  # pyright: ignore[reportAttributeAccessIssue]
    if chosen or "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return False
    try:
        cores = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))  # Linux alone has it
        jax.config.update("jax_num_cpu_devices", len(cores(0)))
    except RuntimeError:
        return False
    return True


class Budget(NamedTuple):
    """How long a run is and what it records: the keyword arguments of `train`."""

    num_steps: int | None
    num_episodes: int | None
    log_every: int | None
    exact: bool
    record: Record | None = None


class Plan(NamedTuple):
    """Where the memory of a sweep goes.

    Attributes:
        results: where the results of its runs are written.
        room: the bytes that a call may take on each device.
    """

    results: memory.Results
    room: int


class Forecast(NamedTuple):
    """What running some runs of one program will take, known from shapes alone.

    Attributes:
        blocks: how many blocks of runs there are, on all devices together.
        results: the bytes of what the runs give.
        working: the bytes of the largest call, on all devices together.
    """

    blocks: int
    results: int
    working: int


class Seconds(NamedTuple):
    """Time spent running, and time spent compiling: 0 where the program was there already."""

    running: float
    compiling: float


def plan(
    env: Environment,
    algorithms: Sequence[Algorithm],
    root: jax.Array,
    runs: int,
    budget: Budget,
    limit: int | None = None,
    devices: Sequence[Any] | None = None,
) -> Plan:
    """Shares out the memory among results and calls. What does not fit beside a call is written to disk.

    Args:
        env, root, budget, devices: as in `run`.
        algorithms: an instance for each program.
        runs: how many there are of all programs together.
        limit: the bytes to share out, in the machine and on each device with memory of its own; by default
            half of what is free there.

    Raises:
        InputError: there is not enough memory for a call, or room on the disk; nothing was compiled.
    """
    devices = tuple(devices or jax.local_devices())
    needs = [_needs(budget, _signature(_given(budget, root, np.uint32(0), x, env))) for x in algorithms]
    results = needs[0].results
    if any(other.results != results for other in needs):
        raise InputError("what record gives must be of the same shape in all runs")

    least = max(one.call.bytes(_least_lanes(devices), blocks=1) for one in needs)
    machine, device = (memory.free(x) // 2 if limit is None else limit for x in ((), devices))
    needed = runs * memory.size(results)
    if _on_cpu(devices):  # whose memory is the machine's
        on_disk = needed + len(devices) * least > machine
        device = (machine if on_disk else machine - needed) // len(devices)
    else:
        on_disk = needed > machine
    if least > device:
        raise InputError(
            f"{_least_lanes(devices)} runs at a time on each device ({len(devices)}) need "
            f"{memory.words(least * len(devices))}, more than the {memory.words(device * len(devices))} that "
            "they may take: give more memory, or take a larger log_every"
        )
    if on_disk:
        folder, there = memory.disk()
        room = f"there is room for {memory.words(machine)} in memory"
        said = f"the results of {runs} runs need {memory.words(needed)}; {room}"
        if needed > there:
            raise InputError(
                f"{said} and {memory.words(there)} in {folder}: take fewer seeds, or a larger log_every"
            )
        logging.getLogger(__name__).warning("%s, so they are kept in files in %s", said, folder)
    return Plan(memory.Results(results, runs, on_disk), device)


def gives(env: Environment, algorithm: Algorithm, root: jax.Array, budget: Budget) -> Any:
    """The shapes of what a run gives: its table, and its Log. Nothing is compiled."""
    return _needs(budget, _signature(_given(budget, root, np.uint32(0), algorithm, env))).results


def forecast(
    env: Environment,
    algorithm: Algorithm,
    root: jax.Array,
    runs: int,
    budget: Budget,
    limit: int | None = None,
    devices: Sequence[Any] | None = None,
) -> Forecast:
    """What so many runs of one program will take; arguments as in `plan`. Nothing is compiled."""
    devices = tuple(devices or jax.local_devices())
    one = _needs(budget, _signature(_given(budget, root, np.uint32(0), algorithm, env)))
    room = memory.free(devices) // 2 if limit is None else limit
    lanes, most = _width(one.call, runs, room // len(devices) if _on_cpu(devices) else room, devices)
    blocks = -(-runs // lanes)
    working = len(devices) * one.call.bytes(lanes, min(most, -(-blocks // len(devices))))
    return Forecast(blocks, runs * memory.size(one.results), working)


def run(
    env: Environment,
    algorithms: Algorithm,
    root: jax.Array,
    seeds: np.ndarray,
    budget: Budget,
    keep: Callable[[np.ndarray, Any], None],
    progress: Callable[[int], None] = lambda done: None,
    room: int = sys.maxsize,
    devices: Sequence[Any] | None = None,
    runs: np.ndarray | None = None,
) -> Seconds:
    """Trains every run of a batch, or some of them.

    Args:
        env: the environment, the same for all.
        algorithms: one method whose leaves are NumPy arrays, whose leading axes broadcast to `seeds`.
        root: JAX key; a run uses `fold_in(root, its seed)`.
        seeds: the number of each run's seed, int [...]; runs are numbered in C order.
        budget: what to do in each run.
        keep: is called with the places in `runs` of some, int [n], and what they gave: their tables, float
            [n, S, A], and the Log of them, [n, rows] each. It must copy what it wants to keep.
        progress: is called with the number of runs finished so far.
        room: the bytes that a call may take on each device.
        devices: the JAX devices to use; all of this process by default.
        runs: the numbers of the runs to train, int [n]; all by default.

    Raises:
        RunError: the memory runs out, even with the smallest call. Calls that are too large are made smaller.
    """
    devices = tuple(devices or jax.local_devices())
    seeds = np.asarray(seeds, np.uint32)
    runs = np.arange(seeds.size) if runs is None else runs

    def of(run: np.ndarray) -> Any:
        """The seed and the algorithm of these runs."""
        place = np.unravel_index(runs[np.minimum(run, len(runs) - 1)], seeds.shape)
        broadcast = lambda x: np.broadcast_to(x, seeds.shape + x.shape[seeds.ndim :])
        return jax.tree.map(lambda x: broadcast(x)[place], (seeds, algorithms))

    def arguments(first: int, blocks: int) -> tuple:
        """For each device `blocks` blocks, from run `first` on: [devices, most, lanes]. Copies fill it up."""
        run = first + np.arange(len(devices) * blocks * lanes).reshape(len(devices), blocks, lanes)
        seed, algorithm = of(run[:, np.minimum(np.arange(most), blocks - 1)])
        return _given(budget, root, seed, algorithm, env)

    begun = time.perf_counter()
    one_seed, one_algorithm = of(np.array(0))
    call = _needs(budget, _signature(_given(budget, root, one_seed, one_algorithm, env))).call
    lanes, most = _width(call, len(runs), room, devices)
    program = _compiled(devices, budget, _signature(arguments(0, 1)))
    compiled = time.perf_counter()

    done, blocks = 0, 1
    while done < len(runs):
        called = time.perf_counter()
        blocks = min(blocks, -(-(len(runs) - done) // (len(devices) * lanes)))
        try:
            output = jax.block_until_ready(program(np.int32(blocks), *arguments(done, blocks)))
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            if isinstance(error, jax.errors.JaxRuntimeError) and _NO_MEMORY not in str(error):
                raise
            lanes, most = _smaller(call, lanes, most, devices)
            blocks, program = 1, _compiled(devices, budget, _signature(arguments(0, 1)))
            continue
        for i in range(len(devices)):
            finished = np.arange(done, min(done + blocks * lanes, len(runs)))
            part = lambda x, i=i: np.asarray(x.addressable_shards[i].data)[0].reshape(-1, *x.shape[3:])
            keep(finished, jax.tree.map(lambda x: part(x)[: len(finished)], output))  # noqa: B023
            done += len(finished)
        del output  # before the next is made
        progress(done)
        blocks = max(1, min(most, int(blocks * CALL_SECONDS / (time.perf_counter() - called))))
    return Seconds(time.perf_counter() - compiled, compiled - begun)


def _started() -> bool:
    """Whether JAX's backend runs, so that flags come too late: it then refuses another number of devices."""
    chosen = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", max(chosen, 0) + 1)
        jax.config.update("jax_num_cpu_devices", chosen)
    except RuntimeError:
        return True
    return False


def _on_cpu(devices: Sequence[Any]) -> bool:
    return devices[0].platform == "cpu"


def _least_lanes(devices: Sequence[Any]) -> int:
    return LANES if _on_cpu(devices) else 1


def _width(call: memory.Call, runs: int, room: int, devices: Sequence[Any]) -> tuple[int, int]:
    """How many lanes go side by side, and how many blocks of them a call takes at most."""
    if _on_cpu(devices):
        fits = [n for n in range(1, BLOCKS + 1) if call.bytes(LANES, n) <= min(room, CALL_BYTES)]
        return LANES, max(fits, default=1)
    lanes = 2 ** (-(-runs // len(devices)) - 1).bit_length()
    while lanes > 1 and call.bytes(lanes, 1) > room:
        lanes //= 2
    return lanes, 1


def _smaller(call: memory.Call, lanes: int, most: int, devices: Sequence[Any]) -> tuple[int, int]:
    """Half as many blocks of a call, or, where it is one, half as many lanes.

    Raises:
        RunError: it cannot be smaller.
    """
    if most > 1:
        smaller = lanes, most // 2
    elif lanes > (FEWEST_LANES if _on_cpu(devices) else 1):
        smaller = lanes // 2, 1
    else:
        raise RunError(
            f"there is not enough memory for {lanes} runs at a time on each device ({len(devices)}), the "
            f"fewest there can be, which need {memory.words(len(devices) * call.bytes(lanes, 1))}: take a "
            "larger log_every, or a smaller environment"
        )
    said = f"{lanes} runs at a time, {most} times a call"
    logging.getLogger(__name__).warning("out of memory with %s; trying again with half", said)
    return smaller


def _given(budget: Budget, root: Any, seed: Any, algorithm: Any, env: Any) -> tuple:
    """The arguments of a program; for exact values with the numbers of method and environment in full."""
    full = in_full if budget.exact else lambda _: None
    return root, seed, (algorithm, full(algorithm)), (env, full(env))


class _Signature(NamedTuple):
    """What, beside the budget, makes a program another one.

    Attributes:
        treedef, avals: the arguments.
        settings: of JAX, under which it is traced.
    """

    treedef: Any
    avals: tuple
    settings: tuple

    @property
    def arguments(self) -> Any:
        """The arguments, with the kind of each array in its place."""
        return jax.tree.unflatten(self.treedef, self.avals)

    @property
    def name(self) -> Any:
        """The arguments, as `programs` names them."""
        return jax.tree.unflatten(self.treedef, [f"{x} {x.weak_type}" for x in self.avals])


def _signature(args: Any) -> _Signature:
    leaves, treedef = jax.tree.flatten(args)
    return _Signature(treedef, tuple(jax.typeof(x) for x in leaves), tuple(provenance.settings().values()))


class _Needs(NamedTuple):
    """What a run needs of memory.

    Attributes:
        results: the shapes of its table and its Log.
        call: the bytes of a call.
    """

    results: Any
    call: memory.Call


@functools.lru_cache(maxsize=64)
def _needs(budget: Budget, signature: _Signature) -> _Needs:
    def make(_: str) -> _Needs:
        traced = _traced(budget, signature)
        root, seed, algorithm, given_env = signature.arguments
        env, _ = given_env
        results, _ = traced.out_info
        # The table once, where it is in the state.
        carried = {id(x): x.aval for x in traced.jaxpr.jaxpr.outvars}
        call = memory.Call(
            shared=memory.size((root, given_env)) + _tables(env),
            kept=memory.size((seed, algorithm, results)),
            working=_working(env, budget, memory.size(carried)),
        )
        return _Needs(jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), results), call)

    same = lambda x: x
    return programs.kept(("needs", budget, signature.name), make, pack=same, unpack=same)


@functools.lru_cache(maxsize=64)
def _traced(budget: Budget, signature: _Signature) -> Any:
    """One run, traced: what `_given` gives -> ((table, Log), state of the learner)."""

    def one(root, seed, given_algorithm, given_env):
        (algorithm, exact_algorithm), (env, exact_env) = given_algorithm, given_env
        full = (exact_algorithm, exact_env) if budget.exact else None
        length = budget.num_steps, budget.num_episodes, budget.log_every
        state, log = unchecked(jax.random.fold_in(root, seed), algorithm, env, full, *length, budget.record)
        return (state.q, log), state

    return jax.jit(one).trace(*signature.arguments)


def _tables(env: Environment) -> int:
    """The bytes of all outcomes of a finite environment, which its step reads from tables."""
    if not isinstance(env, FiniteEnvironment):
        return 0
    model = jax.eval_shape(planning.enumerate_model, env)
    return memory.size((model.prob, model.reward, model.s_next))


def _working(env: Environment, budget: Budget, carried: int) -> int:
    """The bytes with which one run works: what its loop carries, random words, and exact values."""
    if budget.num_episodes:  # a chunk of steps may have to be taken back: see `train._run_until`
        carried *= 2
    carried += bytes_of_words(budget.num_steps, budget.log_every)
    if not budget.exact:
        return carried
    # In float64: the matrix [S, S] that is solved, the weights of all outcomes four times, and three tables.
    with planning.doubled():
        weight = jax.eval_shape(planning.enumerate_model, env).prob
    table = weight.dtype.itemsize * env.num_states * env.num_actions
    matrix = weight.dtype.itemsize * env.num_states**2
    log_every = budget.log_every or default_log_every(budget.num_steps)
    if budget.num_steps and budget.num_steps % log_every:  # a last, shorter row has its own
        matrix *= 2
    return carried + matrix + 4 * memory.size(weight) + 3 * table


@functools.lru_cache(maxsize=64)
def _compiled(devices: tuple[Any, ...], budget: Budget, signature: _Signature):
    """The program for one call: every device trains so many blocks of its own, one after another."""
    return programs.kept(
        ("program", [d.id for d in devices], budget, signature.name),
        lambda called: _compile(called, devices, budget, signature),
        pack=_pack,
        unpack=functools.partial(_unpack, devices=devices),
    )


# What a program may call outside of itself and still be kept: what XLA has, and what JAX registers on import.
_OUTSIDE = re.compile(r"__.*|lapack_.*|cusolver_.*|cu_.*")


def _pack(program: Any) -> Any:
    """A program as plain data, and what it calls outside of itself."""
    called = set(re.findall(r'custom_call_target="([^"]*)"', program.as_text()))
    if strange := [name for name in called if not _OUTSIDE.fullmatch(name)]:
        raise ValueError(f"in another process there may be no {strange[0]}")
    return called, serialize_executable.serialize(program)


def _unpack(packed: Any, devices: Sequence[Any]) -> Any:
    called, serialized = packed
    if any(name.startswith("lapack_") for name in called):
        # JAX finds LAPACK when it first lowers a call of it, and this one was lowered in another process.
        traced = jax.jit(lax.linalg.cholesky).trace(jax.ShapeDtypeStruct((1, 1), np.float32))
        traced.lower(lowering_platforms=("cpu",))
    return serialize_executable.deserialize_and_load(*serialized, execution_devices=devices)


def _compile(called: str, devices: tuple[Any, ...], budget: Budget, signature: _Signature):
    root, seeds, algorithms, env = signature.arguments
    of_one = jax.tree.map(lambda x: x.update(shape=x.shape[3:]), (seeds, algorithms))
    avals = tuple(jax.tree.leaves((root, *of_one, env)))
    traced = _traced(budget, signature._replace(avals=avals))  # not traced again
    results, _ = traced.out_info

    def one(*args):
        outputs = jaxpr_as_fun(traced.jaxpr)(*jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(traced.out_info), outputs)[0]

    def device(blocks, root, seeds, algorithms, env):
        seeds, algorithms = jax.tree.map(lambda x: x[0], (seeds, algorithms))
        empty = jax.tree.map(lambda x: jnp.zeros((*seeds.shape, *x.shape), x.dtype), results)

        def put(i, outputs):
            seed, algorithm = jax.tree.map(lambda x: x[i], (seeds, algorithms))
            block = jax.vmap(one, in_axes=(None, 0, 0, None))(root, seed, algorithm, env)
            return jax.tree.map(lambda all_blocks, x: all_blocks.at[i].set(x), outputs, block)

        return jax.tree.map(lambda x: x[None], lax.fori_loop(0, blocks, put, empty))

    device.__name__ = called
    split, shared = PartitionSpec("devices"), PartitionSpec()
    program = jax.shard_map(
        device,
        mesh=Mesh(np.array(devices), ("devices",), axis_types=(AxisType.Auto,)),
        in_specs=(shared, shared, split, split, shared),
        out_specs=split,
        check_vma=False,
    )
    return jax.jit(program).lower(jnp.int32(0), root, seeds, algorithms, env).compile()


set_flags()
