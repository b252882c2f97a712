"""Longer runs that go on where shorter ones ended, of which the shards keep where that was.

A shard of longer runs is what it always is: it has the same runs, and they have the same bits, from wherever they are
computed. So a run goes on where it can, and else begins at time 0: where the shard that has its beginning is damaged,
or has not where it ended, or lies on a disk that a worker does not see.
"""

import contextlib
import dataclasses
import functools
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxrl_tab.core import modules
from jaxrl_tab.engine.batch import Seconds
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.part import Part
from jaxrl_tab.experiment import growth, shards, storage
from jaxrl_tab.experiment.computing import missing
from jaxrl_tab.experiment.records import Origin
from jaxrl_tab.experiment.shards import (
    BEGUN,
    END,
    FRESH,
    Job,
    Shard,
    arrays_of,
    computed_of,
    experiment_of,
    is_kept,
    onward,
    progress,
    remembered,
    shapes_of,
)
from jaxrl_tab.experiment.spec import Experiment
from jaxrl_tab.experiment.storage import Store

NOT_KEPT = "where they ended was not kept"
OTHERWISE = "they were computed with other versions"


class Source(NamedTuple):
    """Where the beginnings of a part's runs are, which was computed when runs were shorter.

    Attributes:
        name, part: the shorter part.
        configs: for each configuration of the longer part its number there, int [n]; -1 where it is new.
        shard, place: of each run of the shorter part, the number of the shard that has it, and its place there.
        unfit: why they cannot go on; None where they can, or are as long as now.
    """

    name: str
    part: Part
    configs: np.ndarray
    shard: np.ndarray
    place: np.ndarray
    unfit: str | None

    def numbers(self, part: Part, longer: np.ndarray) -> np.ndarray:
        """The numbers that runs of the longer part have in the shorter one, int [n]; -1 where they are new."""
        config, place = np.divmod(longer, part.num_seeds)
        config, place = self.configs[config], place + part.first_seed - self.part.first_seed
        there = (config >= 0) & (place >= 0) & (place < self.part.num_seeds)
        return np.where(there, config * self.part.num_seeds + place, -1)

    def shards(self, part: Part, longer: np.ndarray) -> np.ndarray:
        """The numbers of the shards that may have the beginnings of runs of the longer part; -1 where none has."""
        numbers = self.numbers(part, longer)
        return np.where(numbers >= 0, self.shard[numbers], -1)


class Length(NamedTuple):
    """What was computed when runs had a certain length.

    Attributes:
        job: the experiment as it was last.
        sources: for each part of the longer experiment that it had.
    """

    job: Job
    sources: dict[str, Source]


class Beginning(NamedTuple):
    """The beginnings of some runs of a shard, which all are equally long.

    Attributes:
        at: their places in the shard, int [n].
        arrays: what they gave, and where they ended, as in a shard.
        budget: how long they were.
    """

    at: np.ndarray
    arrays: Mapping[str, np.ndarray]
    budget: Budget


class Longer(NamedTuple):
    """The shards of an experiment whose runs go on where they can: as `Job`, of which it is made.

    Attributes:
        job: the experiment.
        folder: in which the shards of shorter runs lie.
        checksums: of those that are of use, by their numbers.
    """

    job: Job
    folder: str
    checksums: Mapping[int, str]

    @property
    def parts(self) -> dict[str, Part]:
        return self.job.parts

    @property
    def shards(self) -> dict[int, Shard]:
        return self.job.shards

    def setting(self, shard: Shard) -> int | None:
        return self.job.setting(shard)

    def __call__(self, number: int) -> dict[str, np.ndarray]:
        """What the runs of a shard give, and what is raised: as `Job` has it."""
        self.job.check_libraries()
        shard = self.shards[number]
        part = self.parts[shard.part]
        one, numbers = onward(part, shard.program, shards.runs(part, shard))
        found, left = [], np.ones(shard.runs, bool)
        for beginning in self._beginnings(part, shard):
            with _after(int((~left).sum())):
                found.append((beginning.at, _gone_on(one, numbers[beginning.at], beginning, self.job.memory)))
            left[beginning.at] = False
        if not found:
            return self.job(number)
        if left.any():
            with _after(int((~left).sum())):
                found.append((np.flatnonzero(left), arrays_of(one, numbers[left], self.job.memory)))
        arrays, keeps = _together(shard.runs, found), is_kept(part, shard.program)
        return {name: x for name, x in arrays.items() if keeps or not name.startswith(END)}

    def _beginnings(self, part: Part, shard: Shard) -> Iterator[Beginning]:
        """The beginnings of the runs of a shard, of each run the longest one."""
        longer = shards.runs(part, shard)
        left = np.ones(len(longer), bool)
        for length in _lengths(*_key(self.job)):
            if (source := length.sources.get(shard.part)) is None:
                continue
            numbers, of_shards, pieces = source.numbers(part, longer), source.shards(part, longer), []
            of_shards[~left] = -1
            for number in np.unique(of_shards[of_shards >= 0]).tolist():
                at = np.flatnonzero(of_shards == number)
                if (arrays := self._read(number, source.place[numbers[at]])) is not None:
                    pieces.append((at, arrays))
                    left[at] = False
            if pieces:
                at = np.sort(np.concatenate([at for at, _ in pieces]))
                arrays = _together(len(at), [(np.searchsorted(at, own), x) for own, x in pieces])
                yield Beginning(at, arrays, source.part.budget)

    def _read(self, number: int, places: np.ndarray) -> dict[str, np.ndarray] | None:
        """What the runs at these places of a shorter shard gave; None where it is of no use."""
        if (sha256 := self.checksums.get(number)) is None:
            return None
        if (arrays := _loaded(self.folder, number, sha256)) is None:
            return None
        own = {name: x[places] for name, x in arrays.items() if name != "seconds"}
        return own | {"seconds": arrays["seconds"] * [len(places) / len(arrays["q"]), 0]}


def longer(store: Store, job: Job, origin: Origin) -> Job | Longer:
    """The shards of an experiment, whose runs go on where the folder has how they begin, and where that ended."""
    if not _lengths(*_key(job)) or not missing(store, job):
        return job
    unfit = _unfit(store, job, origin)
    checksums = {number: store.shards[number].sha256 for number, reason in unfit.items() if reason is None}
    return Longer(job, str(store.path.resolve()), checksums) if checksums else job


def told(store: Store, job: Job, origin: Origin) -> str:
    """How many runs go on, in words, and why others do not of which the folder has the beginnings; no fresh seeds."""
    unfit, counts = _unfit(store, job, origin), Counter()
    fit = [number for number, reason in unfit.items() if reason is None]
    for name, part in job.parts.items():
        best = np.full(part.runs, -1)  # the shard with the beginning of each run
        for source in (x.sources[name] for x in reversed(_lengths(*_key(job))) if name in x.sources):
            own = source.shards(part, np.arange(part.runs))
            best = np.where(np.isin(own, fit) | ((best < 0) & np.isin(own, list(unfit))), own, best)
        for number, runs in zip(*np.unique(best[best >= 0], return_counts=True), strict=True):
            counts[unfit[int(number)]] += int(runs)
    lines = [f"{_runs(n)} begin anew, for {reason}" for reason, n in counts.items() if reason]
    lines = ([f"{_runs(counts[None])} go on where they ended"] if counts[None] else []) + lines
    return "; ".join([*lines, "the shorter runs stay in shards/"])


def _runs(count: int) -> str:
    return f"{count:,} run{'' if count == 1 else 's'}"


def _unfit(store: Store, job: Job, origin: Origin) -> dict[int, str | None]:
    """Why the runs of each shorter shard that is there cannot go on; None where they can."""
    found = {}
    for shorter, sources in _lengths(*_key(job)):
        of_parts, parts = {x.name: x for x in sources.values()}, shorter.parts
        whole = functools.cache(
            lambda name, program, n, parts=parts: shapes_of(parts[name].onward[program], 0, n)
        )
        for number, shard in shorter.shards.items():
            source, facts = of_parts.get(shard.part), store.shards.get(number)
            if source is None or facts is None or facts.setting != shorter.setting(shard):
                continue
            shapes, of = store.shapes(number), (shard.part, shard.program, shard.runs)
            if facts.surroundings != origin.name:
                found[number] = OTHERWISE
            elif source.unfit:
                found[number] = source.unfit
            else:
                found[number] = None if shapes == whole(*of) else NOT_KEPT
    return found


def _key(job: Job) -> tuple[str, str | None, tuple[str, ...]]:
    modules.keep(job.files)
    return job.experiment, job.chosen, job.before


@remembered
def _lengths(experiment: str, chosen: str | None, before: tuple[str, ...]) -> list[Length]:
    """What was computed when runs were shorter, from the longest to the shortest."""
    job, found = Job(experiment, None, chosen, before=before), []
    last = experiment_of(experiment)
    for i in reversed(range(len(before))):
        was = experiment_of(before[i])
        if growth.are_longer(was, last):
            found.append(_length(job, was, i))
        last = was
    return found


def _length(job: Job, was: Experiment, i: int) -> Length:
    """What was computed until an experiment, which was the one with this number then, got longer runs."""
    known = growth.shared(was, experiment_of(job.experiment))
    chosen = json.loads(job.chosen) if job.chosen and was.select else {}
    there = {name: known[name][1][config] for name, config in chosen.items() if name in known}
    there = {name: config for name, config in there.items() if config >= 0}
    # Of the others, whose fresh seeds are of no use here, it does not matter which setting was chosen.
    settings = dict.fromkeys(was.parts(), 0) | {known[name][0]: config for name, config in there.items()}
    shorter = Job(job.before[i], None, json.dumps(settings) if chosen else None, before=job.before[:i])
    pairs = known | {FRESH + name: (FRESH + known[name][0], [0]) for name in there}
    parts, places = shorter.parts, _places(shorter)
    return Length(
        shorter,
        {
            name: Source(
                old, parts[old], np.array(configs), *places[old], _why_unfit(parts[old], job.parts[name])
            )
            for name, (old, configs) in pairs.items()
        },
    )


def _places(job: Job) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """For each part the number of the shard that has each run, -1 where none has, and the place of the run there."""
    found = {name: (np.full(part.runs, -1), np.zeros(part.runs, int)) for name, part in job.parts.items()}
    for number, shard in job.shards.items():
        own, (of_run, place) = shards.runs(job.parts[shard.part], shard), found[shard.part]
        of_run[own], place[own] = number, np.arange(len(own))
    return found


def _why_unfit(old: Part, new: Part) -> str | None:
    """Why runs of a part cannot go on as those of a longer one; None where its rows are the first rows of that."""
    was, now = old.budget, new.budget
    unit = "steps" if was.num_steps else "episodes"
    rows, rest = divmod(_length_of(was), was.row)
    if was.row != now.row:
        return f"their rows are of {was.row:,} {unit}, and are to be of {now.row:,}"
    if _length_of(was) == _length_of(now):
        return None
    if rest:
        return f"their last row is of {rest:,} {unit}, and not of {was.row:,}"
    if was.exact and rows % was.exact_row:
        return "their last row has exact values, which that of longer runs has not"
    return None


def _length_of(budget: Budget) -> int:
    return budget.num_steps or budget.num_episodes or 0


def _gone_on(
    part: Part, numbers: np.ndarray, beginning: Beginning, memory: int | None
) -> dict[str, np.ndarray]:
    """What runs of a part give, of which there is the beginning."""
    arrays, unit = beginning.arrays, "num_steps" if part.budget.num_steps else "num_episodes"
    before = {BEGUN: arrays["steps"].sum(dtype=np.int64)}
    left = _length_of(part.budget) - _length_of(beginning.budget)
    if not left:
        return {**arrays, **before}
    begun = computed_of(part, arrays, Seconds(0.0, 0.0)).begun
    rest = dataclasses.replace(part, budget=dataclasses.replace(part.budget, **{unit: left}))
    more = arrays_of(rest, numbers, memory, begun)
    rows = {name: np.concatenate([arrays[name], x], 1) for name, x in more.items() if _has_rows(name)}
    return more | rows | before | {"seconds": arrays["seconds"] + more["seconds"]}


def _has_rows(name: str) -> bool:
    """Whether an array of a shard has a row of the log for each row of a run."""
    return name not in ("q", "seconds") and not name.startswith(END)


def _together(
    count: int, pieces: Sequence[tuple[np.ndarray, Mapping[str, np.ndarray]]]
) -> dict[str, np.ndarray]:
    """The arrays of so many runs, of those of some at these places."""
    found = {}
    for name, first in pieces[0][1].items():
        if first.ndim == 0 or name == "seconds":
            found[name] = sum(x[name] for _, x in pieces if name in x)
        else:
            found[name] = np.empty((count, *first.shape[1:]), first.dtype)
            for at, arrays in pieces:
                found[name][at] = arrays[name]
    return found


@contextlib.contextmanager
def _after(done: int) -> Iterator[None]:
    """Within the block what is told of progress is told of runs that come after so many others."""
    tell = progress.get()
    token = progress.set(lambda runs, steps: tell(done + runs, steps))
    try:
        yield
    finally:
        progress.reset(token)


@functools.lru_cache(maxsize=2)
def _loaded(folder: str, number: int, sha256: str) -> dict[str, np.ndarray] | None:
    return storage.peek(Path(folder), number, sha256)
