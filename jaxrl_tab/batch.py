"""Many runs at once: devices x lanes. The one place that knows about flags, devices and blocks.

A run is one lane. 64 lanes go side by side through `vmap`: enough to fill the vector units, few enough that
their tables stay in the cache. Each device (on a CPU: each core) works through blocks of 64 lanes one after
another, and hands a few of them back at a time, so memory stays bounded and progress can be shown. Every
program has exactly this shape, whatever the number of runs: the last block is filled up with copies. That is
why a result depends on neither the batch it was computed in, nor its place there, nor the number of devices,
to the last bit.

Two settings must be made before JAX starts its backend:

- `set_flags`, on import: XLA's CPU backend runs a loop's body as a list of small kernels, at a microsecond
  each, unless the loop's data are smaller than a threshold; then the whole loop becomes one kernel. We raise
  that threshold to 16 MiB. Other loops of the process are compiled under it too: small ones gain, one whose
  body multiplies large matrices may lose XLA's parallel matrix product. `JAXRL_TAB_XLA=0` turns it off.
- `use_all_cores`, by the command line, or by you before anything is computed: one JAX device per core.
"""

import functools
import os
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import AxisType, Mesh, PartitionSpec

from jaxrl_tab.train import Log, Record, default_log_every, train
from jaxrl_tab.types import Algorithm, Environment, InputError

LANES = 64
BLOCKS = 16  # of a device in one call, at most
CALL_BYTES = 2**28  # that they hand back, at most, unless one block alone is larger
CALL_SECONDS = 0.2  # about so long a call shall take
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


class Batch(NamedTuple):
    """What many runs gave.

    Attributes:
        q: the final tables, float [runs, S, A].
        log: the logs, [runs, rows] each.
        seconds: time spent running, compilation apart.
        compile_seconds: time spent compiling; 0 where the program was there already.
    """

    q: np.ndarray
    log: Log
    seconds: float
    compile_seconds: float


def run(
    env: Environment,
    algorithms: Algorithm,
    root: jax.Array,
    seeds: np.ndarray,
    budget: Budget,
    progress: Callable[[int], None] = lambda done: None,
    devices: Sequence[Any] | None = None,
) -> Batch:
    """Trains every run of a batch.

    Args:
        env: the environment, the same for all.
        algorithms: one method whose leaves are NumPy arrays with a leading axis of runs.
        root: JAX key; run i uses `fold_in(root, seeds[i])`.
        seeds: the number of each run's seed, int [runs].
        budget: what to do in each run.
        progress: is called with the number of runs finished so far.
        devices: the JAX devices to use; all by default.
    """
    devices = tuple(devices or jax.devices())
    runs, width = len(seeds), LANES * len(devices)
    most = max(1, min(BLOCKS, CALL_BYTES // (LANES * _bytes_of_a_run(env, budget))))

    def arguments(first: int, blocks: int) -> tuple:
        """`blocks` blocks from run `first` on, [devices, most, LANES]; what lacks is filled with copies."""
        lane = np.arange(blocks * width).reshape(blocks, len(devices), LANES).swapaxes(0, 1)
        lane = np.pad(lane, ((0, 0), (0, most - blocks), (0, 0)), mode="edge")
        run = np.minimum(first + lane, runs - 1)
        return root, np.asarray(seeds, np.uint32)[run], jax.tree.map(lambda x: x[run], algorithms), env

    begun = time.perf_counter()
    program = _compiled(devices, budget, *_signature(arguments(0, 1)))
    compiled = time.perf_counter()

    outputs, done, blocks = [], 0, 1
    while done < runs:
        called = time.perf_counter()
        blocks = min(blocks, -(-(runs - done) // width))
        output = program(np.int32(blocks), *arguments(done, blocks))
        outputs.append(jax.tree.map(lambda x: _in_order(np.asarray(x), blocks), output))  # noqa: B023
        done = min(done + blocks * width, runs)
        progress(done)
        blocks = max(1, min(most, int(blocks * CALL_SECONDS / (time.perf_counter() - called))))
    q, log = jax.tree.map(lambda *parts: np.concatenate(parts)[:runs], *outputs)
    return Batch(q, log, time.perf_counter() - compiled, compiled - begun)


def _in_order(x: np.ndarray, blocks: int) -> np.ndarray:
    """[devices, most, LANES, ...] -> [runs, ...], without the blocks that were not asked for."""
    x = x[:, :blocks].swapaxes(0, 1)
    return x.reshape(-1, *x.shape[3:])


def _started() -> bool:
    """Whether JAX's backend runs, so that flags come too late: it then refuses another number of devices."""
    chosen = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", max(chosen, 0) + 1)
        jax.config.update("jax_num_cpu_devices", chosen)
    except RuntimeError:
        return True
    return False


def check_memory(env: Environment, runs: int, budget: Budget) -> None:
    """Raises InputError where the results of so many runs, held twice while put together, do not fit."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return  # not known on this system
    if (needed := 2 * runs * _bytes_of_a_run(env, budget)) > memory:
        raise InputError(
            f"the results of {runs} runs need {needed / 2**30:.0f} GiB, and this machine has "
            f"{memory / 2**30:.0f}: take fewer seeds, or a larger log_every"
        )


def _bytes_of_a_run(env: Environment, budget: Budget) -> int:
    """About what one run hands back: its table and its log."""
    length = budget.num_steps or budget.num_episodes or 0
    rows = -(-length // (budget.log_every or default_log_every(budget.num_steps)))
    return 4 * (env.num_states * env.num_actions + len(Log._fields) * rows)


def _signature(args: Any) -> tuple[Any, tuple]:
    leaves, treedef = jax.tree.flatten(args)
    return treedef, tuple(jax.typeof(x) for x in leaves)


@functools.lru_cache(maxsize=64)
def _compiled(devices: tuple[Any, ...], budget: Budget, treedef: Any, avals: tuple):
    """The program for one call: every device trains so many blocks of its own, one after another."""

    def one(root, seed, algorithm, env):
        key = jax.random.fold_in(root, seed)
        state, log = train(key, algorithm, env, **budget._asdict())
        return state.q, log

    def device(blocks, root, seeds, algorithms, env):
        seeds, algorithms = jax.tree.map(lambda x: x[0], (seeds, algorithms))

        def block(i):
            seed, algorithm = jax.tree.map(lambda x: x[i], (seeds, algorithms))
            return jax.vmap(one, in_axes=(None, 0, 0, None))(root, seed, algorithm, env)

        def put(i, outputs):
            return jax.tree.map(lambda all_blocks, x: all_blocks.at[i].set(x), outputs, block(i))

        empty = jax.tree.map(lambda x: jnp.zeros((len(seeds), *x.shape), x.dtype), jax.eval_shape(block, 0))
        return jax.tree.map(lambda x: x[None], lax.fori_loop(0, blocks, put, empty))

    split, shared = PartitionSpec("devices"), PartitionSpec()
    program = jax.shard_map(
        device,
        mesh=Mesh(np.array(devices), ("devices",), axis_types=(AxisType.Auto,)),
        in_specs=(shared, shared, split, split, shared),
        out_specs=split,
        check_vma=False,
    )
    arguments = jax.tree.unflatten(treedef, avals)
    return jax.jit(program).lower(jnp.int32(0), *arguments).compile()


set_flags()
