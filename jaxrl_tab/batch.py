"""Many runs at once: devices x lanes. The one place that knows about flags, devices and blocks.

A run is one lane. 64 lanes go side by side through `vmap`: enough to fill the vector units, few enough that
their tables stay in the cache. Each device (on a CPU: each core) takes 64 lanes of a block; the blocks follow
one another from the host, so memory stays bounded and progress can be shown. Every program has exactly this
shape, whatever the number of runs: the last block is filled up with copies. That is why a result depends on
neither the batch it was computed in, nor its place there, nor the number of devices, to the last bit.

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
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, PartitionSpec

from jaxrl_tab.train import Log, train
from jaxrl_tab.types import Algorithm, Environment

LANES = 64
_THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"


def set_flags() -> None:
    """Asks XLA for one kernel per loop, unless the environment already says something about it."""
    flags = os.environ.get("XLA_FLAGS", "")
    if os.environ.get("JAXRL_TAB_XLA") != "0" and _THRESHOLD not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={_THRESHOLD}={2**24}".strip()


set_flags()


def use_all_cores() -> bool:
    """Makes one JAX device of each CPU core. Call it before anything is computed with JAX.

    Returns:
        Whether it could be done; False where JAX has already started, or the user has chosen a number.
    """
    chosen = jax.config.jax_num_cpu_devices != -1  # pyright: ignore[reportAttributeAccessIssue]
    if chosen or "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return False
    try:
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))
    except RuntimeError:
        return False
    return True


class Budget(NamedTuple):
    """How long a run is and what it records: the keyword arguments of `train`."""

    num_steps: int | None
    num_episodes: int | None
    log_every: int | None
    exact: bool


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
    devices: Sequence[jax.Device] | None = None,
) -> Batch:
    """Trains every run of a batch.

    Args:
        env: the environment, the same for all.
        algorithms: one method whose leaves are NumPy arrays with a leading axis of runs.
        root: JAX key; run i uses `fold_in(root, seeds[i])`.
        seeds: the number of each run's seed, int [runs].
        budget: what to do in each run.
        progress: is called with the number of runs finished so far.
        devices: the devices to use; all by default.
    """
    devices = tuple(devices or jax.devices())
    width = LANES * len(devices)
    runs = len(seeds)

    def block(first: int):
        lanes = np.minimum(np.arange(first, first + width), runs - 1)
        return root, np.asarray(seeds, np.uint32)[lanes], jax.tree.map(lambda x: x[lanes], algorithms), env

    begun = time.perf_counter()
    program = _compiled(devices, budget, *_signature(block(0)))
    compiled = time.perf_counter()

    # The next block is under way while the one before is copied out.
    outputs: list = []
    pending = None
    for first in range(0, runs, width):
        following = program(*block(first))
        if pending is not None:
            outputs.append(jax.tree.map(np.asarray, pending))
            progress(first)
        pending = following
    outputs.append(jax.tree.map(np.asarray, pending))
    q, log = jax.tree.map(lambda *parts: np.concatenate(parts)[:runs], *outputs)
    progress(runs)
    return Batch(q, log, time.perf_counter() - compiled, compiled - begun)


def _signature(args: Any) -> tuple[Any, tuple]:
    leaves, treedef = jax.tree.flatten(args)
    return treedef, tuple(jax.typeof(x) for x in leaves)


@functools.lru_cache(maxsize=64)
def _compiled(devices: tuple[jax.Device, ...], budget: Budget, treedef: Any, avals: tuple):
    """The program for one block: every device trains its 64 lanes."""

    def one(root, seed, algorithm, env):
        key = jax.random.fold_in(root, seed)
        state, log = train(key, algorithm, env, **budget._asdict())
        return state.q, log

    lanes = PartitionSpec("lanes")
    shared = PartitionSpec()
    program = jax.shard_map(
        jax.vmap(one, in_axes=(None, 0, 0, None)),
        mesh=Mesh(np.array(devices), ("lanes",), axis_types=(AxisType.Auto,)),
        in_specs=(shared, lanes, lanes, shared),
        out_specs=lanes,
        check_vma=False,
    )
    return jax.jit(program).lower(*jax.tree.unflatten(treedef, avals)).compile()
