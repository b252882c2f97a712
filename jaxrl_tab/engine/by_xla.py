"""Runs that XLA compiles: devices x lanes.

A run is one lane. On a CPU 64 lanes go side by side through `vmap`: enough to fill the vector units, few
enough that their tables stay in the cache. Each device (each core) works through blocks of 64 lanes one after
another, and hands a few of them back at a time, so memory stays bounded and progress can be shown. Every
program has exactly this shape, whatever the number of runs: the last block is filled up with copies. (Where the
memory runs out there are fewer lanes, which gives the same bits: see `FEWEST_LANES`.) That is why a result
depends on neither the batch it was computed in, nor its place there, nor the number of devices, to the last bit.
Any other device is given one block, as wide as there are runs for it and as fits its memory.

Two settings must be made before JAX starts its backend:

- `core.flags`, on import: XLA's CPU backend runs a loop's body as a list of small kernels, at a microsecond
  each, unless the loop's data are smaller than a threshold; then the whole loop becomes one kernel. We raise
  that threshold to 16 MiB. Other loops of the process are compiled under it too: small ones gain, one whose
  body multiplies large matrices may lose XLA's parallel matrix product. `JAXRL_TAB_XLA=0` turns it off.
- `use_all_cores`, by the command line, or by you before anything is computed: one JAX device per core.
"""

import functools
import math
import os
import time
from collections.abc import Generator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import jaxpr_as_fun
from jax.sharding import AxisType, Mesh, PartitionSpec

from jaxrl_tab.core.cores import cores
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.room import (
    Signature,
    is_no_memory,
    signature,
    smaller_call,
    traced_program,
    width_of_call,
)
from jaxrl_tab.engine.runs import Runs

CALL_SECONDS = 0.2  # about so long a call shall take


def use_all_cores() -> bool:
    """Makes one JAX device of each CPU core. Call it before anything is computed with JAX.

    Returns:
        Whether it could be done; False where JAX has already started, or the user has chosen a number.
    """
    chosen = jax.config.jax_num_cpu_devices != -1  # pyright: ignore[reportAttributeAccessIssue]
    if chosen or "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return False
    try:
        jax.config.update("jax_num_cpu_devices", cores())
    except RuntimeError:
        return False
    return True


class ByXLA:
    """A batch of runs, compiled.

    Attributes:
        lanes: how many runs go side by side on each device.
        most: how many blocks of them a call takes there, at most, one after another.
    """

    def __init__(self, runs: Runs, room: int, devices: Sequence[Any] | None):
        self.runs, self.devices = runs, tuple(devices or jax.local_devices())
        self._bytes = runs.needs.call
        self._resize(*width_of_call(self._bytes, len(runs), room, self.devices))

    def results(self) -> Generator[tuple[np.ndarray, Any]]:
        """The places of some runs, int [n], and what they gave: their tables and the Log, [n, ...] each."""
        done, blocks = 0, 1
        while done < len(self.runs):
            called = time.perf_counter()
            blocks = min(blocks, -(-(len(self.runs) - done) // (len(self.devices) * self.lanes)))
            try:
                output = jax.block_until_ready(
                    self._program(np.int32(blocks), *self._arguments(done, blocks))
                )
            except (MemoryError, jax.errors.JaxRuntimeError) as error:
                if not is_no_memory(error):
                    raise
                self._resize(*smaller_call(self._bytes, self.lanes, self.most, self.devices))
                blocks = 1
                continue
            finished = np.arange(done, min(done + len(self.devices) * blocks * self.lanes, len(self.runs)))
            each = blocks * self.lanes
            for i in range(len(self.devices)):
                of_device = finished[i * each : (i + 1) * each]
                part = lambda x, i=i: np.asarray(x.addressable_shards[i].data)[0].reshape(-1, *x.shape[3:])
                yield of_device, jax.tree.map(lambda x: part(x)[: len(of_device)], output)  # noqa: B023
            del output  # before the next is made
            done += len(finished)
            # The first call has one block, and tells how many of them fill the time that a call shall take.
            blocks = max(1, min(self.most, int(blocks * CALL_SECONDS / (time.perf_counter() - called))))

    def _resize(self, lanes: int, most: int) -> None:
        self.lanes, self.most = lanes, most
        self._program = _compiled(self.devices, self.runs.budget, signature(self._arguments(0, 1)))

    def _arguments(self, first: int, blocks: int) -> tuple:
        """For each device `blocks` blocks, from run `first` on: [devices, most, lanes]. Copies fill it up."""
        shape = len(self.devices), blocks, self.lanes
        places = first + np.arange(math.prod(shape)).reshape(shape)
        return self.runs.arguments(places[:, np.minimum(np.arange(self.most), blocks - 1)])


@functools.lru_cache(maxsize=64)
def _compiled(devices: tuple[Any, ...], budget: Budget, signature: Signature):
    """The program for one call: every device trains so many blocks of its own, one after another."""
    root, seeds, algorithms, env = signature.arguments
    of_one = jax.tree.map(lambda x: x.update(shape=x.shape[3:]), (seeds, algorithms))
    avals = tuple(jax.tree.leaves((root, *of_one, env)))
    traced = traced_program(budget, signature._replace(avals=avals))  # not traced again
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

    split, shared = PartitionSpec("devices"), PartitionSpec()
    program = jax.shard_map(
        device,
        mesh=Mesh(np.array(devices), ("devices",), axis_types=(AxisType.Auto,)),
        in_specs=(shared, shared, split, split, shared),
        out_specs=split,
        check_vma=False,
    )
    return jax.jit(program).lower(jnp.int32(0), root, seeds, algorithms, env).compile()
