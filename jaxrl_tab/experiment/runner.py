"""An experiment in a folder: computed shard by shard, so that no more than one is ever lost.

The folder holds `experiment.toml` as it was given, `resolved.json` with all defaults and draws filled in,
`provenance.json`, the shards with their manifest (see `storage`), and, when all are there, `results.nc`,
`summary.csv`, pictures and `report.html`. Which runs are in a shard depends on the experiment alone, and what
a run gives on its seed and hyperparameters alone: so the results are the same to the last bit, however often
it was interrupted. Where they would not be, as with another version of JAX, nothing is computed: see `Origin`.
"""

import contextlib
import dataclasses
import datetime
import functools
import json
import logging
import os
import platform
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jaxrl_tab.core.checks import InputError, RunError, as_path, one_line, shown
from jaxrl_tab.core.memory import Results, free, let_go, size, words
from jaxrl_tab.core.types import Environment
from jaxrl_tab.core.version import __version__
from jaxrl_tab.engine import batch, provenance, room
from jaxrl_tab.engine.results import is_diverged, save
from jaxrl_tab.engine.room import plan
from jaxrl_tab.engine.sweep import Computed, Part, compute, leaves_as_arrays, result
from jaxrl_tab.engine.train import Log
from jaxrl_tab.experiment import storage
from jaxrl_tab.experiment.executors import Executor, Local
from jaxrl_tab.experiment.spec import Experiment, PartPlan, Plan, difference
from jaxrl_tab.experiment.storage import Store

if TYPE_CHECKING:  # these take their time to import
    import pandas as pd
    import xarray as xr

GIVEN, RESOLVED, PROVENANCE = "experiment.toml", "resolved.json", "provenance.json"
DATA, FRESH_DATA, SUMMARY, SELECTION = "results.nc", "fresh.nc", "summary.csv", "selection.csv"
SHARD_STEPS = 2**27  # of the runs in a shard, about: a few seconds on two cores
SHARD_BYTES = 2**26  # that its runs give, at most, unless one block of lanes gives more
EPISODE_STEPS = 100  # so long an episode is taken to be, where episodes are the budget
FRESH = "fresh seeds/"  # before the name of a part that runs a chosen setting again
NOT_RECORDED = "what it was computed with is not recorded"

Report = Callable[["Progress"], None]


class Shard(NamedTuple):
    """Some runs of a part that go together: `first` to `last` - 1 of those of one of its programs."""

    part: str
    program: int
    first: int
    last: int

    @property
    def runs(self) -> int:
        return self.last - self.first


class Progress(NamedTuple):
    """How far an experiment is.

    Attributes:
        label: what is under way: a part of the experiment, or what is written.
        done, total: runs.
        steps: steps taken since it began, or was resumed.
        seconds: the time since then.
        left: how many more seconds it will take, about; None where nothing can be said yet.
        diverged: runs in which a number became infinite or NaN, or grew beyond any possible return.
    """

    label: str
    done: int
    total: int
    steps: int
    seconds: float
    left: float | None
    diverged: int


class Outcome(NamedTuple):
    """What an experiment gave.

    Attributes:
        datasets: `SweepResult.to_xarray` of each part, by its name "ENVIRONMENT/METHOD".
        fresh: the same of the setting chosen for each part, on fresh seeds; empty without selection.
        envs: the environments by their names.
        by: the function of `stats` that the settings were chosen by, if they were.
    """

    datasets: "dict[str, xr.Dataset]"
    fresh: "dict[str, xr.Dataset]"
    envs: dict[str, Environment]
    by: str | None = None

    def of(self, label: str) -> "dict[str, xr.Dataset]":
        """The datasets of one environment, by the names of the methods."""
        own = {name.partition("/"): ds for name, ds in self.datasets.items()}
        return {method: ds for (environment, _, method), ds in own.items() if environment == label}


def run(
    experiment: Experiment,
    folder: str | Path | None = None,
    *,
    executor: Executor | None = None,
    memory: int | None = None,
    progress: Report = lambda state: None,
    command: str | None = None,
) -> Outcome:
    """Runs an experiment, and leaves everything in a new folder. Where it is interrupted, `resume` goes on.

    Args:
        experiment: what to run.
        folder: a new folder. Without one nothing is left but the outcome.
        executor: where it is computed, see `executors`; by default in this process.
        memory: how many bytes it may take, as in `sweep`; of each worker, where there are several.
        progress: is called as shards are finished.
        command: what was typed, for the records; by default what started this process.

    Raises:
        InputError: something given is wrong; nothing was computed.
        RunError: there was not enough memory, or room on the disk. What is finished is kept.
    """
    if not isinstance(experiment, Experiment):
        raise InputError(f"run takes an Experiment, not {shown(experiment)}")
    command = _typed(command)
    if folder is None:
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / "experiment"
            _begin(path, experiment, memory)
            return _go_on(path, experiment, executor, memory, progress, command, keep=False)
    path = _path(folder)
    _begin(path, experiment, memory)
    with storage.lock(path):
        return _go_on(path, experiment, executor, memory, progress, command)


def resume(
    folder: str | Path,
    *,
    executor: Executor | None = None,
    memory: int | None = None,
    progress: Report = lambda state: None,
    command: str | None = None,
    mixed: bool = False,
) -> Outcome:
    """Goes on with what `run` left: computes the shards that are missing or damaged, and no others.

    What is damaged is named in a warning of the logger `jaxrl_tab.experiment.runner`, and set aside. The settings
    of JAX that change numbers are as in `run` while it computes, and afterwards what they were.

    Args:
        folder: the folder.
        executor, memory, progress, command: as in `run`.
        mixed: go on also with other versions, or on another kind of processor, which may give numbers that
            differ in the last bits. The folder's provenance and report tell of it.

    Raises:
        InputError: there is no experiment in the folder, or another process is at work in it, or the
            experiment was changed, or what is missing would be computed otherwise than the rest: the message
            says in what.
        RunError: as in `run`.
    """
    path = _path(folder)
    if not os.path.isdir(path):
        name = one_line(str(path))
        raise InputError(f"{name} is no folder" if os.path.exists(path) else f"there is no folder {name}")
    if not os.path.lexists(path / GIVEN) and not os.path.lexists(path / RESOLVED):
        raise InputError(f"there is no experiment in {path}: neither {GIVEN} nor {RESOLVED}")
    command = _typed(command)
    with storage.lock(path):
        return _go_on(path, _experiment_in(path), executor, memory, progress, command, mixed=mixed)


def _typed(command: str | None) -> str:
    """What was typed, as text that can be written: names of files need not be text in UTF-8."""
    command = shlex.join(sys.argv) if command is None else command
    return command.encode(errors="backslashreplace").decode()


def _path(folder: Any) -> Path:
    return Path(os.path.normpath(as_path("the folder", folder)))


def _go_on(
    path: Path,
    experiment: Experiment,
    executor: Executor | None,
    limit: int | None,
    report: Report,
    command: str,
    keep: bool = True,
    mixed: bool = False,
) -> Outcome:
    """All that is still to be done in a folder."""
    store = Store(path, experiment.fingerprint)
    _warn_of_what_was(store)
    records = _records(store)
    job, meter, select = Job(json.dumps(experiment.data()), limit), _Meter(report), experiment.select
    with _settings_of(store, records):
        origin = Origin.of(store, records, mixed)
        if _missing(store, job):
            origin.check(path)
        with _session(store, records, command):
            later = {FRESH + name: select["fresh_seeds"] for name in job.parts} if select else {}
            executor = executor or Local()
            new = _compute(store, job, executor, meter, later, origin)
            datasets, room = _collect(store, job, list(job.parts), free() // 2 if limit is None else limit)
            envs = {name.partition("/")[0]: part.env for name, part in job.parts.items()}
            fresh = {}
            if select:
                job = job._replace(
                    chosen=json.dumps({name: _chosen(ds, select["by"]) for name, ds in datasets.items()})
                )
                new |= _compute(store, job, executor, meter, {}, origin)
                fresh, _ = _collect(store, job, list(later), room)
                fresh = {name.removeprefix(FRESH): ds for name, ds in fresh.items()}
            outcome = Outcome(datasets, fresh, envs, select["by"] if select else None)
            if keep and (new or not store.files):
                if origin.changed and not new:
                    _warn(f"only tables, pictures and report are made now; {'; '.join(origin.changed)}")
                meter.show("tables, pictures, report")
                _write_files(store, outcome, records)
    return outcome


# --- what numbers depend on --------------------------------------------------------------------------


class Origin(NamedTuple):
    """What the numbers of shards depend on beside the experiment, see `provenance`.

    Attributes:
        name: of the surroundings of this process; each shard that it computes keeps it.
        changed: what was otherwise where shards were computed that are there; empty where nothing was.
        mixed: whether it is allowed to go on nevertheless.
    """

    name: str
    changed: list[str]
    mixed: bool

    @staticmethod
    def of(store: Store, records: Mapping[str, Any], mixed: bool) -> "Origin":
        now = provenance.surroundings()
        name = provenance.digest(now)
        others = _origins(store) - {name}
        if not others:
            return Origin(name, [], mixed)
        was = _recorded(records, others)
        lines = provenance.differences(was[0]["surroundings"], now) if was else [NOT_RECORDED]
        return Origin(name, lines, mixed)

    def check(self, path: Path) -> None:
        """Raises InputError where what is computed now would be numbers of another kind."""
        if self.changed and not self.mixed:
            raise InputError(
                f"what is missing in {path} would not be computed as the rest was: {'; '.join(self.changed)}; "
                f"go on with what it was, or begin a new folder with {path / GIVEN}, or allow it with --mixed "
                "(mixed=True): the report then says so"
            )


def _origins(store: Store) -> set[str | None]:
    """The names of the surroundings in which the shards were computed."""
    return {facts.surroundings for facts in store.shards.values()}


def _recorded(records: Mapping[str, Any], origins: Collection[str | None]) -> list[dict[str, Any]]:
    """The sessions in which shards of these origins were computed, in order."""
    named = [(provenance.digest(x.get("surroundings", {})), x) for x in records["sessions"]]
    return [session for name, session in named if name in origins]


def _mixture(sessions: Sequence[Mapping[str, Any]]) -> str:
    """What was not the same in all of them."""
    first, *others = [session["surroundings"] for session in sessions] or [{}]
    lines = [line for other in others for line in provenance.differences(first, other)]
    return "; ".join(dict.fromkeys(lines)) or NOT_RECORDED


def _settings_of(store: Store, records: Mapping[str, Any]) -> contextlib.AbstractContextManager[None]:
    """Gives JAX the settings that the shards were computed with, within the block."""
    sessions = _recorded(records, _origins(store))
    was = sessions[0]["surroundings"] if sessions else {}
    return provenance.using({name: was[name] for name in provenance.settings() if name in was})


# --- shards ------------------------------------------------------------------------------------------


class Job(NamedTuple):
    """What is to be computed, as data that any process can do its share of: called with a shard's number.

    Attributes:
        experiment: the data of the experiment, as JSON.
        memory: how many bytes may be taken; None: half of what is free.
        chosen: for each part the number of the configuration that is run again on fresh seeds, as JSON; None
            where nothing is.
    """

    experiment: str
    memory: int | None
    chosen: str | None = None

    @property
    def parts(self) -> dict[str, Part]:
        return _parts(self.experiment, self.chosen)

    @property
    def shards(self) -> list[Shard]:
        """In the order of their numbers. Those of fresh seeds come last."""
        return _shards(self.experiment, self.chosen)

    def setting(self, shard: Shard) -> int | None:
        """The chosen configuration, of a shard of fresh seeds."""
        if self.chosen is None or not shard.part.startswith(FRESH):
            return None
        return json.loads(self.chosen)[shard.part.removeprefix(FRESH)]

    def __call__(self, number: int) -> dict[str, np.ndarray]:
        """What the runs of a shard give: `q`, the fields of the log, and the `seconds` it took."""
        shard = self.shards[number]
        part = self.parts[shard.part]
        computed = compute(part, _runs(part, shard), memory=self.memory)
        log = {name: x for name, x in computed.log._asdict().items() if x is not None}
        return {"q": computed.q, **log, "seconds": np.array(computed.seconds)}


@functools.lru_cache(maxsize=4)
def _parts(experiment: str, chosen: str | None) -> dict[str, Part]:
    if chosen is None:
        return Experiment.from_data(json.loads(experiment)).parts()
    parts, seeds = _parts(experiment, None), json.loads(experiment)["select"]["fresh_seeds"]
    again = {FRESH + name: _again(parts[name], i, seeds) for name, i in json.loads(chosen).items()}
    return parts | again


@functools.lru_cache(maxsize=4)
def _shards(experiment: str, chosen: str | None) -> list[Shard]:
    return [shard for name, part in _parts(experiment, chosen).items() for shard in _split(name, part)]


def _again(part: Part, config: int, seeds: int) -> Part:
    """One configuration of a part on fresh seeds: numbers from 0 of a root of their own, see `sweep.Part`."""
    one = [part.configs[config]]
    return dataclasses.replace(part, axes={}, configs=one, num_seeds=seeds, first_seed=0, fresh=True)


def _split(name: str, part: Part) -> Iterator[Shard]:
    """The shards of a part. They depend on nothing but the part: neither on the machine nor on the time."""
    most = _shard_runs(part)
    for program, members in enumerate(part.programs):
        total = len(members) * part.num_seeds
        for first in range(0, total, most):
            yield Shard(name, program, first, min(first + most, total))


def _shard_runs(part: Part) -> int:
    """How many runs make a shard: whole blocks of lanes."""
    budget, states = part.budget, part.env.num_states
    length = budget.num_steps or budget.num_episodes or 0
    rows = -(-length // (budget.log_every or 1))
    steps = budget.num_steps or length * EPISODE_STEPS
    if (
        budget.exact
    ):  # solves a system of equations in each row, about a hundred multiply-adds in a step's time
        steps += rows * states**3 // 300
    given = 4 * (states * part.env.num_actions + 7 * rows)  # a table, and at most 7 numbers in a row
    return max(1, min(SHARD_STEPS // steps, SHARD_BYTES // given) // room.LANES) * room.LANES


def _runs(part: Part, shard: Shard) -> np.ndarray:
    """The numbers of the runs of a shard, in the part, int [runs]."""
    config, place = np.divmod(np.arange(shard.first, shard.last), part.num_seeds)
    return part.programs[shard.program][config] * part.num_seeds + place


def _compute(
    store: Store, job: Job, executor: Executor, meter: "_Meter", later: Mapping[str, int], origin: Origin
) -> bool:
    """Computes the shards that are not there; whether there were any. `later`: see `_Meter.begin`."""
    missing = _missing(store, job)
    if missing:
        origin.check(store.path)
    meter.begin(store, job, missing, later)
    with contextlib.closing(executor.run(job, missing)) as finished:  # where it stops, the workers do
        for number, arrays in finished:
            part, sums = job.parts[job.shards[number].part], (arrays["returns"], arrays["rewards"])
            largest = part.largest_values[_runs(part, job.shards[number]) // part.num_seeds]
            diverged = int(is_diverged(arrays["q"], *sums, largest=largest).sum())
            setting = job.setting(job.shards[number])
            store.write(number, arrays, diverged, setting, origin.name)
            let_go()
            meter.finished(number, int(arrays["steps"].sum(dtype=np.int64)), diverged)
    return bool(missing)


def _missing(store: Store, job: Job) -> list[int]:
    """The numbers of the shards that are to be computed."""
    missing = [number for number, shard in enumerate(job.shards) if not _is_there(store, job, number, shard)]
    _warn_of_what_was(store)
    return missing


def _is_there(store: Store, job: Job, number: int, shard: Shard) -> bool:
    """Whether a shard is there, of the setting that is chosen now, and of the shapes that its runs give."""
    if number not in store.shards or store.shards[number].setting != job.setting(shard):
        return False
    return store.keep_if(number, _shapes(job.parts[shard.part], shard))


def _shapes(part: Part, shard: Shard) -> dict[str, tuple[Any, Any]]:
    """(shape, dtype) of each array of a shard."""
    method = leaves_as_arrays(part.configs[part.programs[shard.program][0]])
    q, log = room.gives(part.env, method, part.root, part.budget)
    of_one = {"q": q, **{name: x for name, x in log._asdict().items() if x is not None}}
    shapes = {name: ((shard.runs, *x.shape), x.dtype) for name, x in of_one.items()}
    return shapes | {"seconds": ((2,), np.dtype(float))}


def _collect(store: Store, job: Job, names: Sequence[str], room: int) -> "tuple[dict[str, xr.Dataset], int]":
    """The results of some parts from their shards, which are all there; and how much of `room` is left.

    What does not fit in `room`, in bytes, is in temporary files; see `memory.Results`.
    """
    datasets = {}
    for name in names:
        part, results, seconds = job.parts[name], None, np.zeros(2)
        for number, shard in enumerate(job.shards):
            if shard.part != name:
                continue
            arrays = store.read(number)
            seconds += arrays.pop("seconds")
            if results is None:
                like = {key: jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for key, x in arrays.items()}
                needed = size(like) * part.runs
                results = Results(like, part.runs, on_disk=needed > room)
                room -= needed if needed <= room else 0
            results.write(_runs(part, shard), arrays)
        assert results is not None
        log = {key: x for key, x in results.arrays.items() if key != "q"}
        computed = Computed(results.arrays["q"], Log(**log), batch.Seconds(*seconds.tolist()))
        datasets[name] = result(part, computed).to_xarray()
    return datasets, room


def _chosen(ds: "xr.Dataset", by: str) -> int:
    """The number of the configuration that did best, by a function of `stats`."""
    from jaxrl_tab import stats

    best = stats.best(ds, getattr(stats, by))
    axes = [str(dim) for dim in ds.diverged.dims if dim != "seed"]
    place = [ds[axis].values.tolist().index(best[axis]) for axis in axes]
    return int(np.ravel_multi_index(place, [ds.sizes[axis] for axis in axes])) if axes else 0


class _Meter:
    """Counts what is finished, and reports it."""

    def __init__(self, report: Report):
        self._report, self._begun = report, time.perf_counter()
        self._last = self._begun
        self._state = Progress("", 0, 0, 0, 0.0, None, 0)
        self._todo: dict[str, int] = {}  # runs of each part
        self._took: dict[str, tuple[int, float]] = {}  # how many of them are done, and in how many seconds
        self._missing: dict[int, Shard] = {}

    def begin(self, store: Store, job: Job, missing: Sequence[int], later: Mapping[str, int]) -> None:
        """Counts what is there already, what is missing, and runs of parts that come later."""
        self._missing = {number: job.shards[number] for number in missing}
        self._todo |= later
        self._todo |= {shard.part: 0 for shard in self._missing.values()}
        for shard in self._missing.values():
            self._todo[shard.part] += shard.runs
        there = [number for number in range(len(job.shards)) if number not in self._missing]
        self._state = self._state._replace(
            done=sum(job.shards[number].runs for number in there),
            total=sum(shard.runs for shard in job.shards) + sum(later.values()),
            diverged=sum(store.shards[number].diverged for number in there),
        )
        self._last = time.perf_counter()
        self.show()

    def finished(self, number: int, steps: int, diverged: int) -> None:
        shard, now = self._missing.pop(number), time.perf_counter()
        runs, seconds = self._took.get(shard.part, (0, 0.0))
        self._took[shard.part] = runs + shard.runs, seconds + now - self._last
        self._last = now
        self._state = self._state._replace(
            done=self._state.done + shard.runs,
            steps=self._state.steps + steps,
            diverged=self._state.diverged + diverged,
        )
        self.show()

    def show(self, label: str | None = None) -> None:
        """Reports; `label` says what is under way where it is not a shard."""
        if label is None:
            label = next((shard.part for shard in self._missing.values()), self._state.label)
        runs = {name: PartPlan(1, n, 1, n, 0, 0) for name, n in self._todo.items() if n}
        left = Plan(runs, "runs", "").seconds_left(self._took)
        self._state = self._state._replace(label=label, seconds=time.perf_counter() - self._begun, left=left)
        self._report(self._state)


# --- the files ---------------------------------------------------------------------------------------


def _begin(path: Path, experiment: Experiment, limit: int | None) -> None:
    """A new folder with the experiment in it, and no shards. Raises InputError where it cannot be run."""
    source = experiment.source
    with storage.new_folder(path) as new:
        _check_room(experiment.parts(), limit, new)
        storage.write(new / GIVEN, source.text if source else experiment.to_toml())
        storage.write_json(new / RESOLVED, experiment.data())
        records = {"file": str(source.path.resolve()) if source else None, "sessions": []}
        storage.write_json(new / PROVENANCE, records)
        Store.begin(new, experiment.fingerprint)


def _check_room(parts: Mapping[str, Part], limit: int | None, folder: Path) -> None:
    """Raises InputError where there is not enough memory for a shard, or disk for all."""
    needed = 0
    for part in parts.values():
        instances = [leaves_as_arrays(part.configs[members[0]]) for members in part.programs]
        runs = min(part.runs, _shard_runs(part))
        planned = plan(part.env, instances, part.root, runs, part.budget, limit)
        needed += size(planned.results.arrays) // runs * part.runs
    if 2 * needed > (room := shutil.disk_usage(folder).free):  # shards, and the whole
        raise InputError(
            f"the results need {words(2 * needed)} on the disk, and there is room for {words(room)} in "
            f"{folder.parent}: take fewer seeds, or a larger log_every"
        )


def _experiment_in(path: Path) -> Experiment:
    """The experiment that a folder was made for.

    It is there twice, and its fingerprint is in the manifest: where one of the two is missing or damaged, it is
    made again of the other. Nobody edits `resolved.json`, so what differs from the fingerprint in it is damage;
    in `experiment.toml` it may be a wish.

    Raises:
        InputError: what the folder says of it, or the file that it was read from, is not what it was.
    """
    manifest = storage.read_manifest(path)
    begun_with = manifest and manifest["fingerprint"]
    data = storage.read_json(path / RESOLVED)
    resolved = _understood(lambda: Experiment.from_data(data)) if isinstance(data, dict) else None
    given = None
    if storage.is_file(path / GIVEN):
        with storage.said(path / GIVEN, "read"):
            (path / GIVEN).read_bytes()
        given = _understood(lambda: Experiment.load(path / GIVEN))
    if resolved and begun_with in (None, resolved.fingerprint):
        experiment = resolved
        if given is None:
            _warn_of_a_new(path / GIVEN, f"made again, of {RESOLVED}")
            storage.write(path / GIVEN, experiment.to_toml())
        elif changed := difference(experiment.data(), given.data()):
            raise InputError(f"{path / GIVEN} was changed since: {'; '.join(changed)}; put it back to go on")
    elif given and begun_with in (None, given.fingerprint):
        experiment = given
        _warn_of_a_new(path / RESOLVED, f"made again, of {GIVEN}")
        storage.write_json(path / RESOLVED, experiment.data())
    elif resolved or given:
        raise InputError(
            f"{path} was begun with another experiment: {GIVEN} and {RESOLVED} were changed or damaged since"
        )
    else:
        raise InputError(f"there is no experiment in {path} any more: {GIVEN} and {RESOLVED} are damaged")
    source = (_records_in(path) or {}).get("file")
    if source and Path(source).is_file() and (changed := _changed(source, experiment.data())):
        raise InputError(
            f"{source} was changed since: {changed}; put it back, or rename it to go on with what it was"
        )
    return experiment


def _understood(read: Callable[[], Experiment]) -> Experiment | None:
    """The experiment, or None where what is read is none."""
    try:
        return read()
    except Exception:  # there is no end to what a flipped bit makes of data
        return None


def _warn_of_a_new(file: Path, then: str) -> None:
    """Says that a file is made again; what is there now is set aside."""
    if os.path.lexists(file):
        _warn(storage.set_aside(file, file.parent, then))
    else:
        _warn(f"{file.name} is missing: it is {then}")


def _records_in(path: Path) -> dict[str, Any] | None:
    """The records of all sessions in a folder; None where they are missing or damaged."""
    records = storage.read_json(path / PROVENANCE)
    if not isinstance(records, dict) or records.keys() != {"file", "sessions"}:
        return None
    if not isinstance(records["file"], str | None) or not isinstance(records["sessions"], list):
        return None
    return records if all(map(_is_session, records["sessions"])) else None


def _is_session(found: Any) -> bool:
    """Whether data are the record of a session, with what is looked at later."""
    return (
        isinstance(found, dict)
        and isinstance(found.get("command"), str)
        and isinstance(found.get("started"), str)
    )


def _changed(source: str, data: Mapping[str, Any]) -> str:
    """What a file says otherwise than the data of the experiment that was once read from it."""
    try:
        return "; ".join(difference(data, Experiment.load(source).data()))
    except InputError as error:
        return str(error)


def _records(store: Store) -> dict[str, Any]:
    """The records of the processes that computed."""
    records = _records_in(store.path)
    if records is None:
        _warn_of_a_new(store.path / PROVENANCE, "begun anew")
        records = {"file": None, "sessions": []}
    return records


@contextlib.contextmanager
def _session(store: Store, records: dict[str, Any], command: str) -> Iterator[None]:
    """Keeps records of this process, which computes."""
    file = store.path / PROVENANCE
    session = {"command": command, "started": _now(), "ended": None, **_machine()}
    records["sessions"].append(session)
    storage.write_json(file, records)
    try:
        yield
    finally:
        session["ended"] = _now()
        with contextlib.suppress(RunError):  # the disk may be full, which somebody else says
            storage.write_json(file, records)


def _machine() -> dict[str, Any]:
    """What numbers depend on, and more about this process."""
    devices = jax.devices()
    processor = provenance.cpu("model name") or platform.processor() or platform.machine()
    return {
        "surroundings": provenance.surroundings(),
        "python": platform.python_version(),
        "processor": devices[0].device_kind if devices[0].platform != "cpu" else processor,
        "devices": len(devices),
        "platform": platform.platform(),
        "git_commit": provenance.git_commit(),
    }


def _write_files(store: Store, outcome: Outcome, records: Mapping[str, Any]) -> None:
    """Tables, pictures and the report, each a whole file or none."""
    from jaxrl_tab.show import plot, report

    folder = store.path
    about = {"command": records["sessions"][0]["command"], "version": __version__}
    files = [_write_data(folder / DATA, outcome.datasets, outcome, about)]
    files.append(_write_table(folder / SUMMARY, summary(outcome)))
    if outcome.fresh:
        files.append(_write_data(folder / FRESH_DATA, outcome.fresh, outcome, about))
        files.append(_write_table(folder / SELECTION, selection(outcome)))
    scratch = folder / f".{storage.PICTURES}{storage.UNFINISHED}"
    names = storage.file_names(outcome.envs)
    try:
        with storage.said(folder):
            for label, env in outcome.envs.items():
                place = scratch / storage.PICTURES / names[label] if len(outcome.envs) > 1 else scratch
                plot.save_all(outcome.of(label), env, place)
            report.write(scratch, outcome.datasets, outcome.envs, _about(store, records), outcome.fresh)
        for file in sorted(path for path in scratch.rglob("*") if path.is_file()):
            goal = folder / file.relative_to(scratch)
            with storage.said(goal):
                goal.parent.mkdir(parents=True, exist_ok=True)
            with storage.writing(goal) as unfinished:
                file.replace(unfinished)
            files.append(goal)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    store.keep_files(str(file.relative_to(folder)) for file in files)


def _write_data(file: Path, datasets: "Mapping[str, xr.Dataset]", outcome: Outcome, about: Any) -> Path:
    """A netCDF file with a group for each part: ENVIRONMENT/METHOD; METHOD where there is one environment."""
    needed = sum(ds.nbytes + 2**14 for ds in datasets.values())  # if it cannot be compressed
    if needed > (room := shutil.disk_usage(file.parent).free):  # HDF5 may crash where the disk becomes full
        raise RunError(
            f"{file} could not be written: it may need {words(needed)} on the disk, and there is room for "
            f"{words(room)}"
        )
    with storage.writing(file) as unfinished:
        for name, ds in datasets.items():
            save(ds, name if len(outcome.envs) > 1 else name.partition("/")[2], unfinished, about)
    return file


def _write_table(file: Path, table: "pd.DataFrame") -> Path:
    with storage.writing(file) as unfinished:
        table.to_csv(unfinished, index=False)
    return file


def summary(outcome: Outcome) -> "pd.DataFrame":
    """`stats.summary` of all environments; their names are a column where there are several."""
    import pandas as pd

    from jaxrl_tab import stats

    tables = {label: stats.summary(outcome.of(label)) for label in outcome.envs}
    if len(tables) > 1:
        for label, table in tables.items():
            table.insert(0, "environment", label)
    return pd.concat(tables.values(), ignore_index=True)


def selection(outcome: Outcome) -> "pd.DataFrame":
    """The setting chosen for each part: its score on the seeds that it was chosen on, and on fresh ones.

    Returns:
        A frame with the columns `environment`, `method`, the hyperparameters that were swept, `chosen_score`
        with `chosen_low` and `chosen_high`, which flatter it, and `fresh_score` with `fresh_low` and
        `fresh_high`, which do not; the intervals are of the mean, 95%.
    """
    import pandas as pd

    from jaxrl_tab import stats

    rows = []
    for name, fresh in outcome.fresh.items():
        environment, _, method = name.partition("/")
        ds = outcome.datasets[name]
        setting, chosen, again, _ = stats.selection(ds, fresh, getattr(stats, outcome.by or "score"))
        row = {"environment": environment, "method": method, **stats.named(ds, setting)}
        for kind, found in (("chosen", chosen), ("fresh", again)):
            row |= {f"{kind}_score": float(found.estimate)}
            row |= {f"{kind}_low": float(found.low), f"{kind}_high": float(found.high)}
        rows.append(row)
    names = dict.fromkeys(name for row in rows for name in row)  # not all methods have all hyperparameters
    scores = [name for name in names if name.startswith(("chosen_", "fresh_"))]
    return pd.DataFrame(rows, columns=[*(name for name in names if name not in scores), *scores])


def _about(store: Store, records: Mapping[str, Any]) -> dict[str, Any]:
    """How the results came about, for the report."""
    with storage.said(store.path / GIVEN, "read"):
        given = (store.path / GIVEN).read_text(encoding="utf-8", errors="replace")
    first, last = records["sessions"][0], records["sessions"][-1]
    sessions, origins = len(records["sessions"]), _origins(store)
    computed = _recorded(records, origins)
    one = (computed or [last])[0]  # the last may have made nothing but files
    now = one["surroundings"]
    return {
        "command": first["command"],
        "experiment": given,
        "fingerprint": store.fingerprint,
        "started": first["started"],
        "finished": _now(),
        **({"interrupted": f"{sessions - 1} times"} if sessions > 1 else {}),
        **({"mixed": _mixture(computed)} if len(origins) > 1 else {}),
        "versions": {name: now[name] for name in provenance.installed()} | {"python": one.get("python")},
        "XLA flags": now["XLA_FLAGS"],
        "computed on": f"{one.get('processor')}, {one.get('devices')} devices, {one.get('platform')}",
        **({"git commit": one["git_commit"]} if one.get("git_commit") else {}),
    }


def _warn_of_what_was(store: Store) -> None:
    """Warns of what was damaged or missing, once."""
    while store.found:
        _warn(store.found.pop(0))


def _warn(line: str) -> None:
    logging.getLogger(__name__).warning("%s", line)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
