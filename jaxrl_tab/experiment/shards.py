"""An experiment in pieces that are computed and kept one by one."""

import dataclasses
import functools
import json
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import Any, NamedTuple, ParamSpec, Protocol, TypeVar, runtime_checkable
from weakref import WeakValueDictionary

import jax
import numpy as np

from jaxrl_tab.core import memory, modules
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import batch, provenance, room
from jaxrl_tab.engine.log import Log, recorded_shapes
from jaxrl_tab.engine.loop import Run
from jaxrl_tab.engine.part import Computed, Part, compute
from jaxrl_tab.experiment.growth import Block, Fresh, Generation, generations
from jaxrl_tab.experiment.records import library_versions
from jaxrl_tab.experiment.spec import Experiment

P = ParamSpec("P")
T = TypeVar("T")
SHARD_STEPS = 2**27  # of all runs in a shard together, about: a few seconds on two cores
SHARD_BYTES = 2**26  # of the results in a shard, at most, unless one block of lanes gives more
# Where the runs of a program are in the end is kept where it takes no more than so many bytes, or no more than so many
# times what their results take.
KEPT_BYTES, KEPT_TIMES = 2**24, 4
EPISODE_STEPS = 100  # the assumed length of an episode, where episodes are the budget
FRESH = "fresh seeds/"  # before the name of a part that runs a chosen setting again
END = "end."  # before the number of an array that says where runs are in the end
BEGUN = "begun"  # of runs that went on: how many steps they had in all before; that is not kept
_read: WeakValueDictionary[str, Experiment] = WeakValueDictionary()  # by their data
_to_forget: list[Callable[[], None]] = []


def remembered(function: Callable[P, T]) -> Callable[P, T]:
    """Keeps what a function gives of experiments, until their parts are forgotten."""
    kept: Any = functools.lru_cache(maxsize=16)(function)
    _to_forget.append(kept.cache_clear)
    return kept


class Shard(NamedTuple):
    """Some runs of a part that go together: `first` to `last` - 1 of those of a block."""

    block: Block
    first: int
    last: int

    @property
    def part(self) -> str:
        return self.block.part

    @property
    def program(self) -> int:
        return self.block.program

    @property
    def runs(self) -> int:
        return self.last - self.first


progress: ContextVar[Callable[[int, int], None]] = ContextVar("progress", default=lambda runs, steps: None)
"""Is called with how many runs of the shard that is computed in this process are finished, and their steps."""


class Job(NamedTuple):
    """What is to be computed, as data that any process can do its share of: called with a shard's number.

    Attributes:
        experiment: the data of the experiment, as JSON.
        memory: how many bytes may be taken; None: half of what is free.
        chosen: for each part the number of the configuration that is run again on fresh seeds, as JSON; None
            where nothing is.
        files: what the experiment's own classes and tables are in, which need not be on other machines.
        libraries: the versions of those from which its environments come, where it was started.
        before: the data of the experiments that it grew from, the first one first, as JSON.
    """

    experiment: str
    memory: int | None
    chosen: str | None = None
    files: tuple[modules.File, ...] = ()
    libraries: Mapping[str, str] = {}
    before: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        memory: int | None,
        libraries: Mapping[str, str],
        before: Sequence[Experiment] = (),
    ) -> "Job":
        """All of an experiment, and of those before it. While they live, this process takes their parts from them."""
        forget_parts()
        *earlier, now = (json.dumps(one.data()) for one in (*before, experiment))
        _read.update(zip((*earlier, now), (*before, experiment), strict=True))
        return cls(now, memory, files=experiment.files, libraries=libraries, before=tuple(earlier))

    @property
    def parts(self) -> dict[str, Part]:
        modules.keep(self.files)
        return _parts(self.experiment, self.chosen)

    @property
    def shards(self) -> dict[int, Shard]:
        """By their numbers, in order. Of what each experiment added those of fresh seeds come last."""
        modules.keep(self.files)
        return _shards(self.experiment, self.chosen, self.before)

    def setting(self, shard: Shard) -> int | None:
        """The chosen configuration, of a shard of fresh seeds, by a number that it keeps where others are added."""
        if self.chosen is None or not shard.part.startswith(FRESH):
            return None
        name = shard.part.removeprefix(FRESH)
        return _generations(self.experiment, self.before)[1][name][json.loads(self.chosen)[name]]

    def check_libraries(self) -> None:
        """Raises InputError where this process has another version of a library."""
        if changed := provenance.differences(self.libraries, library_versions(json.loads(self.experiment))):
            raise InputError(f"{'; '.join(changed)} on {platform.node()}: install the same on all machines")

    def __call__(self, number: int) -> dict[str, np.ndarray]:
        """What the runs of a shard give: `q`, what is in the log, where they are in the end, and the `seconds` it took.

        Where they are is left out where it would take much room: see `is_kept`.

        Raises:
            InputError: this process has another version of a library; or as `sweep.compute`.
        """
        self.check_libraries()
        shard = self.shards[number]
        part = self.parts[shard.part]
        numbers = runs(part, shard)
        if is_kept(part, shard.program):
            part, numbers = onward(part, shard.program, numbers)
        return arrays_of(part, numbers, self.memory)


@runtime_checkable
class Sharded(Protocol):
    """What is computed and kept shard by shard: a function of a shard's number, as `Job` is."""

    @property
    def parts(self) -> Mapping[str, Part]: ...

    @property
    def shards(self) -> Mapping[int, Shard]: ...

    def setting(self, shard: Shard) -> int | None: ...

    def __call__(self, number: int) -> Mapping[str, np.ndarray]: ...


def arrays_of(
    part: Part, numbers: np.ndarray, memory: int | None, begun: Run | None = None
) -> dict[str, np.ndarray]:
    """What the runs with these numbers give, by name, and the `seconds` it took; as `part.compute`."""
    computed = compute(part, numbers, begun=begun, memory=memory, progress=progress.get())
    ends = () if computed.ends is None else (computed.ends,)
    return named(computed.q, computed.log, *ends) | {"seconds": np.array(computed.seconds)}


def named(q: Any, log: Log, *ends: Any) -> dict[str, Any]:
    """What runs give, and where they are in the end if that is wanted, by names of which no two are the same."""
    return {"q": q, **log.named()} | {f"{END}{i}": x for i, x in enumerate(jax.tree.leaves(ends))}


def shapes_of(part: Part, program: int, runs: int) -> dict[str, tuple[Any, Any]]:
    """(shape, dtype) of each array of a shard with so many runs of a program."""
    arrays = named(*part.needs[program].results)
    shapes = {name: ((runs, *x.shape), x.dtype) for name, x in arrays.items()}
    return shapes | {"seconds": ((2,), np.dtype(float))}


def is_kept(part: Part, program: int) -> bool:
    """Whether shards keep where the runs of a program of a part are in the end, so that longer runs can go on there."""
    one = part.onward[program]
    table, log, end = one.needs[0].results
    enough = max(KEPT_BYTES, KEPT_TIMES * memory.size((table, log)) * one.runs)
    return part.goes_on or memory.size(end) * one.runs <= enough


def kept_bytes(part: Part) -> int:
    """How many bytes that takes in all shards of a part."""
    sizes = (memory.size(one.needs[0].results[2]) * one.runs for one in part.onward)
    return sum(size for program, size in enumerate(sizes) if is_kept(part, program))


def onward(part: Part, program: int, numbers: np.ndarray) -> tuple[Part, np.ndarray]:
    """The part of one program of a part that gives where its runs are, and the numbers that runs have there."""
    config, place = np.divmod(numbers, part.num_seeds)
    return part.onward[program], np.searchsorted(part.programs[program], config) * part.num_seeds + place


def computed_of(part: Part, arrays: Mapping[str, np.ndarray], seconds: batch.Seconds) -> Computed:
    """What runs of a part gave, from what `named` made of it, but for where they are if that is not wanted here."""
    structure = jax.tree.structure(part.needs[0].results[2:])
    ends = jax.tree.unflatten(structure, [arrays[f"{END}{i}"] for i in range(structure.num_leaves)])
    return Computed(arrays["q"], Log.of(arrays), seconds, *ends)


def experiment_of(data: str) -> Experiment:
    """The experiment that has these data, as JSON."""
    return _read.get(data) or Experiment.from_data(json.loads(data))


@remembered
def _parts(experiment: str, chosen: str | None) -> dict[str, Part]:
    if chosen is None:
        return experiment_of(experiment).parts()
    parts, seeds = _parts(experiment, None), json.loads(experiment)["select"]["fresh_seeds"]
    on_fresh = {FRESH + name: again(parts[name], i, seeds) for name, i in json.loads(chosen).items()}
    return parts | on_fresh


@remembered
def _generations(experiment: str, before: tuple[str, ...]) -> tuple[list[Generation], dict[str, list[int]]]:
    return generations([experiment_of(data) for data in (*before, experiment)])


@remembered
def _shards(experiment: str, chosen: str | None, before: tuple[str, ...] = ()) -> dict[int, Shard]:
    parts, found, number = _parts(experiment, chosen), {}, 0
    for generation in _generations(experiment, before)[0]:
        shards = [shard for block in generation.blocks for shard in split(block)]
        fresh = [x for x in generation.fresh if generation.of_use and chosen is not None]
        shards_of_fresh = [shard for x in fresh for shard in split(_fresh_block(parts[FRESH + x.part], x))]
        if generation.of_use:
            found |= enumerate([*shards, *shards_of_fresh], number)
        # What is added later has numbers that do not depend on what is chosen here.
        number += len(shards) + sum(-(-(x.last - x.first) // room.LANES) for x in generation.fresh)
    return found


def forget_parts() -> None:
    """Forgets all parts, which are then made anew, of classes that were loaded from copies since."""
    _read.clear()
    for forget in _to_forget:
        forget()


def again(part: Part, config: int, seeds: int, first: int = 0) -> Part:
    """One configuration of a part on fresh seeds: numbers from `first` of a root of their own, see `part.Part`."""
    one = [part.configs[config]]
    return dataclasses.replace(part, axes={}, configs=one, num_seeds=seeds, first_seed=first, fresh=True)


def _fresh_block(part: Part, fresh: Fresh) -> Block:
    return Block(FRESH + fresh.part, 0, np.array([0]), fresh.first, fresh.last - fresh.first, part)


def split(block: Block) -> Iterator[Shard]:
    """The shards of a block. They depend on nothing but its part: neither on the machine nor on the time."""
    most = shard_runs(block.planned)
    for first in range(0, block.runs, most):
        yield Shard(block, first, min(first + most, block.runs))


def shard_runs(part: Part) -> int:
    """How many runs make a shard: whole blocks of lanes."""
    budget, states = part.budget, part.env.num_states
    length = budget.num_steps or budget.num_episodes or 0
    rows = -(-length // budget.row)
    steps = budget.num_steps or length * EPISODE_STEPS
    if budget.exact:  # a system of equations in rows, a hundred multiply-adds in the time of a step
        steps += rows // budget.exact_row * states**3 // 300
    recorded = sum(x.size for x in jax.tree.leaves(recorded_shapes(budget.record, part.configs[0], part.env)))
    # A table; and in each row some 7 numbers (sums, and exact values), and those of the recorder. They are 8 with
    # `policy_value`; but what is split otherwise than it was cannot be put together with what folders have.
    bytes_per_run = 4 * (states * part.env.num_actions + rows * (7 + recorded))
    bytes_per_run += max(memory.size(needs.results[2:]) for needs in part.needs) if part.goes_on else 0
    return max(1, min(SHARD_STEPS // steps, SHARD_BYTES // bytes_per_run) // room.LANES) * room.LANES


def runs(part: Part, shard: Shard) -> np.ndarray:
    """The numbers of the runs of a shard, in the part, int [runs]."""
    block = shard.block
    config, place = np.divmod(np.arange(shard.first, shard.last), block.seeds)
    return block.configs[config] * part.num_seeds + block.place + place
