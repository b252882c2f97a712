"""The shards of an experiment that are missing are computed, and results collected from all of them."""

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxrl_tab.core.memory import Results, let_go, size
from jaxrl_tab.engine import batch, speeds
from jaxrl_tab.engine.log import LATER
from jaxrl_tab.engine.part import Computed, Part
from jaxrl_tab.engine.results import is_diverged
from jaxrl_tab.engine.room import results_of
from jaxrl_tab.engine.sweep import result
from jaxrl_tab.experiment import shards
from jaxrl_tab.experiment.executors import Executor, Local
from jaxrl_tab.experiment.progress import Meter
from jaxrl_tab.experiment.records import Origin
from jaxrl_tab.experiment.shards import BEGUN, END, Shard, Sharded, computed_of, runs, shapes_of
from jaxrl_tab.experiment.storage import Store, warn

if TYPE_CHECKING:
    import xarray as xr


def compute(
    store: Store,
    job: Sharded,
    executor: Executor,
    meter: Meter,
    later: Mapping[str, int],
    origin: Origin,
) -> bool:
    """Computes the shards that are not there; whether there were any. `later`: see `Meter.begin`."""
    lacking, all_shards, parts = missing(store, job), job.shards, job.parts
    if lacking:
        origin.check(store.path)
    for number in lacking:
        if number in store.shards and store.shards[number].setting == job.setting(all_shards[number]):
            store.leave_out(number)
    warn_of_damage(store)
    clock = speeds.Clock()
    meter.begin(store, job, lacking, later, clock.known)
    # Where it stops, the workers do.
    with _heard(meter.underway), contextlib.closing(executor.run(job, lacking)) as finished:
        for number, given in finished:
            arrays = dict(given)
            begun = int(arrays.pop(BEGUN, 0))
            shard, sums = all_shards[number], (arrays["returns"], arrays["rewards"])
            part = parts[shard.part]
            largest = part.largest_values[runs(part, shard) // part.num_seeds]
            diverged = int(is_diverged(arrays["q"], *sums, largest=largest).sum())
            store.write(number, arrays, diverged, job.setting(shard), origin.name)
            let_go()
            meter.finished(number, int(arrays["steps"].sum(dtype=np.int64)) - begun, diverged)
            if isinstance(executor, Local):  # others may have other machines
                clock.finished(part, shard.program, shard.runs, *map(float, arrays["seconds"]))
    if lacking:
        store.write_manifest()
    clock.keep()
    return bool(lacking)


@contextlib.contextmanager
def _heard(underway: Callable[[int, int], None]) -> Iterator[None]:
    """Within the block `underway` hears how far the shard is that is computed in this process."""
    token = shards.progress.set(underway)
    try:
        yield
    finally:
        shards.progress.reset(token)


def missing(store: Store, job: Sharded) -> list[int]:
    """The numbers of the shards that are to be computed.

    Those that are there are of the setting that is chosen now, and of the shapes that their runs give. They may lack
    what an earlier version did not record, and where their runs are in the end.
    """
    parts, lacking = job.parts, []
    shapes = functools.cache(lambda part, program, runs: shapes_of(parts[part], program, runs))
    for number, shard in job.shards.items():
        if number not in store.shards or store.shards[number].setting != job.setting(shard):
            lacking.append(number)
            continue
        expected, found = shapes(shard.part, shard.program, shard.runs), store.shapes(number)
        found = {name: x for name, x in found.items() if name in expected or not name.startswith(END)}
        if found != expected and {**{x: expected[x] for x in LATER & expected.keys()}, **found} != expected:
            lacking.append(number)
    return lacking


def collect(
    store: Store, job: Sharded, names: Sequence[str], room: int
) -> "tuple[dict[str, xr.Dataset], int]":
    """The results of some parts from their shards, which are all there; and how much of `room` is left.

    What some shards of a part lack, which an earlier version wrote, the results lack.
    What does not fit in `room`, in bytes, is in temporary files; see `memory.Results`.
    """
    datasets, shards_of = {}, {name: {} for name in names}
    for number, shard in job.shards.items():
        if shard.part in shards_of:
            shards_of[shard.part][number] = shard
    for name, own in shards_of.items():
        computed, room = collected(store, job.parts[name], own, room)
        datasets[name] = result(job.parts[name], computed).to_xarray()
    return datasets, room


def collected(store: Store, part: Part, own: Mapping[int, Shard], room: int) -> tuple[Computed, int]:
    """What all runs of a part gave, from its shards, which are all there; and how much of `room` is left."""
    results, seconds = None, np.zeros(2)
    some = next(iter(own.values()))
    # Only these may be lacking: for others no shard is opened twice.
    later = LATER & shapes_of(part, some.program, some.runs).keys()
    lacking = {key for key in later if any(key not in store.shapes(number) for number in own)}
    for number, shard in own.items():
        unwanted = () if part.goes_on else (END,)
        arrays = {key: x for key, x in store.read(number, unwanted).items() if key not in lacking}
        seconds += arrays.pop("seconds")
        if results is None:
            like = {key: jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for key, x in arrays.items()}
            like["q"] = results_of(part.needs)[0]  # of all programs
            needed = size(like) * part.runs
            results = Results(like, part.runs, on_disk=needed > room)
            room -= needed if needed <= room else 0
        results.write(runs(part, shard), arrays)
    assert results is not None
    return computed_of(part, results.arrays, batch.Seconds(*seconds.tolist())), room


def warn_of_damage(store: Store) -> None:
    """Warns of what was damaged or missing, once."""
    while store.problems:
        warn(store.problems.pop(0))
