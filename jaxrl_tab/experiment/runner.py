"""An experiment in a folder: computed shard by shard, so that no more than one is ever lost.

The folder holds `experiment.toml` as it was given, `resolved.json` with all defaults and draws filled in, copies
of the files that somebody's own classes are in (see `sources`), `provenance.json`, the shards with their manifest
(see `storage`), and, when all are there, `results.nc`, `summary.csv`, pictures and `report.html`. Which runs are in
a shard depends on the experiment alone, and on what it was before it grew (see `growth`); and what a run gives on
its seed and hyperparameters alone: so the results are the same to the last bit, however often it was interrupted, and
however it grew. Where they would not be, as with another version of JAX, nothing is computed: see `Origin`.
"""

import contextlib
import functools
import json
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import jax
import numpy as np

from jaxrl_tab.core import names
from jaxrl_tab.core.errors import InputError, as_path, one_line, shown
from jaxrl_tab.core.memory import Results, free, let_go, size, words
from jaxrl_tab.engine import backend, batch, speeds
from jaxrl_tab.engine.log import LATER, Log
from jaxrl_tab.engine.part import Computed, Part
from jaxrl_tab.engine.results import is_diverged
from jaxrl_tab.engine.room import plan
from jaxrl_tab.engine.sweep import result
from jaxrl_tab.experiment import comparing, growth, shards, sources, storage
from jaxrl_tab.experiment.again import RunAgain, toml_of_settings
from jaxrl_tab.experiment.comparing import Look, Looked
from jaxrl_tab.experiment.executors import Executor, Local
from jaxrl_tab.experiment.files import FORMATS, Format, Outcome, check_formats, drawing, drawn_as, write_files
from jaxrl_tab.experiment.found import Found, find, grow, wished
from jaxrl_tab.experiment.places import Source
from jaxrl_tab.experiment.progress import Meter
from jaxrl_tab.experiment.records import (
    Origin,
    library_versions,
    records_in,
    records_of,
    session,
    settings_of,
)
from jaxrl_tab.experiment.shards import FRESH, Job, runs, shard_runs
from jaxrl_tab.experiment.spec import Experiment
from jaxrl_tab.experiment.storage import AS_WRITTEN, PROVENANCE, RESOLVED, Store, warn
from jaxrl_tab.show.progress import Report

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.show.explained import Explanation


def run(
    experiment: Experiment,
    folder: str | Path | None = None,
    *,
    executor: Executor | None = None,
    memory: int | None = None,
    progress: Report | Literal[False] | None = None,
    ready: Callable[[Outcome], None] | None = None,
    formats: Sequence[Format] = FORMATS[:1],
    command: str | None = None,
    looked: Looked | None = None,
) -> Outcome:
    """Runs an experiment, and leaves everything in a new folder. Where it is interrupted, `resume` goes on.

    Args:
        experiment: what to run.
        folder: a new folder. Without one nothing is left but the outcome.
        executor: where it is computed, see `executors`; by default in this process.
        memory: how many bytes it may take, as in `sweep`; of each worker, where there are several.
        progress: is called with a `Progress` as shards are finished; by default a bar, as in `sweep`.
        ready: is called with the outcome as soon as all is computed, before tables, pictures and report are
            written into the folder, which takes longer than to look at it.
        formats: of the pictures, some of "png", "svg" and "pdf"; none for no pictures.
        command: what was typed, for the records; by default what started this process.
        looked: where methods are compared until all is decided, it is called with the name of the environment and the
            `stats.Verdict` at every look.

    Raises:
        InputError: something given is wrong; nothing was computed.
        RunError: there was not enough memory, or room on the disk. What is finished is kept.
    """
    if not isinstance(experiment, Experiment):
        raise InputError(f"run takes an Experiment, not {shown(experiment)}")
    command, formats = _typed(command), check_formats(formats)
    if folder is None:
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / "experiment"
            found, how = _begin(path, experiment, memory, keep=False), {"keep": False, "looked": looked}
            return _go_on(path, found, executor, memory, progress, ready, formats, command, **how)
    path = _path(folder)
    found = _begin(path, experiment, memory)
    with storage.lock(path):
        return _go_on(path, found, executor, memory, progress, ready, formats, command, looked=looked)


def resume(
    folder: str | Path,
    *,
    executor: Executor | None = None,
    memory: int | None = None,
    progress: Report | Literal[False] | None = None,
    ready: Callable[[Outcome], None] | None = None,
    formats: Sequence[Format] | None = None,
    command: str | None = None,
    mixed: bool = False,
    looked: Looked | None = None,
    experiment: Experiment | None = None,
    seeds: int | None = None,
    steps: int | None = None,
    episodes: int | None = None,
) -> Outcome:
    """Goes on with what `run` left: computes the shards that are missing or damaged, and no others.

    An experiment can also grow: have more seeds, values of hyperparameters, methods, or environments. What is there
    stays, and only the runs that are new are computed; then settings are chosen anew, and tables, pictures and
    report are made anew. All is, to the last bit, what the larger experiment gives that is run at once. Where it is
    interrupted, `resume` goes on with it. Longer runs, `steps` or `episodes`, are computed from their beginning, for
    no folder has the state in which a run ended.

    What is damaged is named in a warning, by a logger below `jaxrl_tab`, and set aside. The settings of JAX that
    change numbers are as in `run` while it computes, and afterwards what they were.

    Args:
        folder: the folder.
        executor, memory, progress, ready, command, looked: as in `run`.
        formats: of the pictures, as in `run`; by default those that there were.
        mixed: go on also with other versions, or on another kind of processor, which may give numbers that
            differ in the last bits. The folder's provenance and report tell of it.
        experiment: what it is to be: all that it was, and more. By default it is what `experiment.toml` in the
            folder says, which may be edited.
        seeds, steps, episodes: these numbers instead. Fresh seeds, where they are as many as seeds, stay so.

    Raises:
        InputError: there is no experiment in the folder, or another process is at work in it, or the
            experiment lacks something that is there, or what is missing would be computed otherwise than the
            rest: the message says in what.
        RunError: as in `run`.
    """
    path = _folder(folder)
    command, formats = _typed(command), formats if formats is None else check_formats(formats)
    given = {"seeds": seeds, "steps": steps, "episodes": episodes}
    more = {key: x for key, x in given.items() if x is not None}
    with storage.lock(path):
        found = find(path, other_source=experiment is not None)
        new = wished(found, experiment, more)
        if new.data() != found.experiment.data():
            found = _grown(path, found, new, memory, command, mixed)
        how = {"mixed": mixed, "looked": looked}
        return _go_on(path, found, executor, memory, progress, ready, formats, command, **how)


def explain(folder: str | Path) -> "Explanation":
    """Where the methods of an experiment in a folder lose what they earn less than the best policy.

    As `Outcome.explain`, of an experiment that has ended. Nothing is written; little or nothing is computed again.

    Raises:
        InputError: there is no experiment in the folder, or something of it is missing or damaged.
    """
    path = _folder(folder)
    with storage.lock(path):
        found = find(path)
        experiment, store = found.experiment, Store(path, found.experiment.fingerprint, found.entries)
        job = Job.of(experiment, None, library_versions(experiment.data()), found.experiments[:-1])
        if missing := _missing(store, job):
            raise InputError(
                f"{len(missing)} of {len(job.shards)} shards are missing in {path}: resume it first"
            )
        datasets, _ = _collect(store, job, list(job.parts), free() // 2)
        envs = {name.partition("/")[0]: part.env for name, part in job.parts.items()}
        with backend.using(experiment.backend), settings_of(store, records_of(store)):
            return Outcome(datasets, {}, envs, job.parts).explain()


def history(folder: str | Path) -> list[tuple[str, str, str]]:
    """With what an experiment in a folder was begun, and what was added to it: when, what, and by which command.

    Raises:
        InputError: as in `explain`.
    """
    path = _folder(folder)
    with storage.lock(path):
        return find(path, other_source=True).history((records_in(path) or {"sessions": []})["sessions"])


def _typed(command: str | None) -> str:
    """What was typed, as text that can be written: names of files need not be text in UTF-8."""
    command = shlex.join(sys.argv) if command is None else command
    return command.encode(errors="backslashreplace").decode()


def _path(folder: Any) -> Path:
    return Path(os.path.normpath(as_path("the folder", folder)))


def _folder(folder: Any) -> Path:
    """The path of a folder with an experiment. Raises InputError where there is none."""
    path = _path(folder)
    if not os.path.isdir(path):
        name = one_line(str(path))
        raise InputError(f"{name} is not a folder" if os.path.exists(path) else f"there is no folder {name}")
    if not os.path.lexists(path / AS_WRITTEN) and not os.path.lexists(path / RESOLVED):
        raise InputError(f"there is no experiment in {path}: neither {AS_WRITTEN} nor {RESOLVED}")
    return path


def _go_on(
    path: Path,
    found: Found,
    executor: Executor | None,
    limit: int | None,
    progress: Report | Literal[False] | None,
    ready: Callable[[Outcome], None] | None,
    formats: Sequence[Format] | None,
    command: str,
    keep: bool = True,
    mixed: bool = False,
    looked: Looked | None = None,
) -> Outcome:
    """All that is still to be done in a folder."""
    experiment, store = found.experiment, Store(path, found.experiment.fingerprint, found.entries)
    _warn_of_damage(store)
    records = records_of(store)
    formats = drawn_as(records) if formats is None else formats
    libraries = library_versions(experiment.data())
    job, meter = Job.of(experiment, limit, libraries, found.experiments[:-1]), Meter()
    with backend.using(experiment.backend), settings_of(store, records):
        with meter.reporting(progress):
            origin = Origin.of(store, records, mixed, libraries)
            if _missing(store, job):
                origin.check(path)
            with session(store, records, command, libraries, formats):
                outcome, new = _results(store, job, experiment, executor or Local(), meter, origin, looked)
        writes = keep and (new or not store.files)
        with drawing(store, outcome, formats if writes else ()) as pictures:
            if ready:
                ready(outcome)  # after the bar, for what is printed beside one is lost in it
            if writes:
                if origin.changed and not new:
                    warn(f"only tables, pictures and report are made now; {'; '.join(origin.changed)}")
                with meter.reporting(progress):
                    meter.show("tables, pictures, report")
                    again, toml = RunAgain(job.parts, limit), toml_of_settings(experiment)
                    history = found.history(records["sessions"])
                    write_files(store, outcome, records, pictures, again, toml, history)
    return outcome


def _grown(path: Path, found: Found, new: Experiment, limit: int | None, command: str, mixed: bool) -> Found:
    """The folder whose experiment is a larger one now.

    Raises:
        InputError: what it has more cannot be computed, or not as the rest was. Then nothing was changed.
    """
    old, libraries = found.experiment, library_versions(new.data())
    store = Store(path, old.fingerprint, found.entries)
    _warn_of_damage(store)
    records = records_of(store)
    with backend.using(new.backend), settings_of(store, records):
        Origin.of(store, records, mixed, libraries).check(path)
        there = sum(file.stat().st_size for file in (path / storage.SHARDS).iterdir())
        _check_room(new.parts(), limit, path, there)
    what = growth.added(old, new)
    if growth.is_anew(old, new):
        what += (
            "; runs of another length are computed from their beginning: those that are there stay in shards/"
        )
    warn(f"{what}; what is there is kept, and what is new is computed now")
    grow(path, found, new, command, store.checksums)
    if new.source and new.source.path.parent != path:
        storage.write_json(path / PROVENANCE, records | {"file": str(new.source.path.resolve())})
    return find(path)


def _results(
    store: Store,
    job: Job,
    experiment: Experiment,
    executor: Executor,
    meter: Meter,
    origin: Origin,
    looked: Looked | None,
) -> tuple[Outcome, bool]:
    """What the experiment gives, of which the missing shards are computed; and whether there were any."""
    fresh_seeds = experiment.select["fresh_seeds"] if experiment.select else 0
    later = {FRESH + name: fresh_seeds for name in job.parts if fresh_seeds}
    new = _compute(store, job, executor, meter, later, origin)
    datasets, room = _collect(store, job, list(job.parts), free() // 2 if job.memory is None else job.memory)
    envs = {name.partition("/")[0]: part.env for name, part in job.parts.items()}
    outcome = Outcome(datasets, {}, envs, job.parts)
    if experiment.until_decided:
        own = comparing.open_store(store.path, experiment, outcome.chosen)

        def computed(look: Look) -> "tuple[dict[str, xr.Dataset], bool]":
            new = _compute(own, look, executor, meter, {}, origin)
            return _collect(own, look, list(look.parts), room)[0], new

        verdicts, fresh, more = comparing.compare(job, experiment, outcome.chosen, computed, looked)
        outcome.verdicts.update(verdicts)
        outcome.fresh.update(fresh)
        new |= more
    elif fresh_seeds:
        job = job._replace(chosen=json.dumps(outcome.chosen))
        new |= _compute(store, job, executor, meter, {}, origin)
        fresh, _ = _collect(store, job, list(later), room)
        outcome.fresh.update((name.removeprefix(FRESH), ds) for name, ds in fresh.items())
    return outcome, new


def _compute(
    store: Store,
    job: Job | Look,
    executor: Executor,
    meter: "Meter",
    later: Mapping[str, int],
    origin: Origin,
) -> bool:
    """Computes the shards that are not there; whether there were any. `later`: see `Meter.begin`."""
    missing, all_shards, parts = _missing(store, job), job.shards, job.parts
    if missing:
        origin.check(store.path)
    for number in missing:
        if number in store.shards and store.shards[number].setting == job.setting(all_shards[number]):
            store.leave_out(number)
    _warn_of_damage(store)
    clock = speeds.Clock()
    meter.begin(store, job, missing, later, clock.known)
    # Where it stops, the workers do.
    with _heard(meter.underway), contextlib.closing(executor.run(job, missing)) as finished:
        for number, arrays in finished:
            shard, sums = all_shards[number], (arrays["returns"], arrays["rewards"])
            part = parts[shard.part]
            largest = part.largest_values[runs(part, shard) // part.num_seeds]
            diverged = int(is_diverged(arrays["q"], *sums, largest=largest).sum())
            store.write(number, arrays, diverged, job.setting(shard), origin.name)
            let_go()
            meter.finished(number, int(arrays["steps"].sum(dtype=np.int64)), diverged)
            if isinstance(executor, Local):  # others may have other machines
                clock.finished(part, shard.program, shard.runs, *map(float, arrays["seconds"]))
    if missing:
        store.write_manifest()
    clock.keep()
    return bool(missing)


@contextlib.contextmanager
def _heard(underway: Callable[[int, int], None]) -> Iterator[None]:
    """Within the block `underway` hears how far the shard is that is computed in this process."""
    token = shards.progress.set(underway)
    try:
        yield
    finally:
        shards.progress.reset(token)


def _missing(store: Store, job: Job | Look) -> list[int]:
    """The numbers of the shards that are to be computed.

    Those that are there are of the setting that is chosen now, and of the shapes that their runs give. They may lack
    what an earlier version did not record.
    """
    parts, missing = job.parts, []
    shapes = functools.cache(lambda part, program, runs: _shapes(parts[part], program, runs))
    for number, shard in job.shards.items():
        if number not in store.shards or store.shards[number].setting != job.setting(shard):
            missing.append(number)
            continue
        expected, found = shapes(shard.part, shard.program, shard.runs), store.shapes(number)
        if found != expected and {**{x: expected[x] for x in LATER & expected.keys()}, **found} != expected:
            missing.append(number)
    return missing


def _shapes(part: Part, program: int, runs: int) -> dict[str, tuple[Any, Any]]:
    """(shape, dtype) of each array of a shard with so many runs of a program."""
    q, log = part.needs[program].results
    shapes = {name: ((runs, *x.shape), x.dtype) for name, x in {"q": q, **log.named()}.items()}
    return shapes | {"seconds": ((2,), np.dtype(float))}


def _collect(
    store: Store, job: Job | Look, names: Sequence[str], room: int
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
        part, results, seconds = job.parts[name], None, np.zeros(2)
        some = next(iter(own.values()))
        # Only these may be lacking: for others no shard is opened twice.
        later = LATER & _shapes(part, some.program, some.runs).keys()
        lacking = {key for key in later if any(key not in store.shapes(number) for number in own)}
        for number, shard in own.items():
            arrays = {key: x for key, x in store.read(number).items() if key not in lacking}
            seconds += arrays.pop("seconds")
            if results is None:
                like = {key: jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for key, x in arrays.items()}
                needed = size(like) * part.runs
                results = Results(like, part.runs, on_disk=needed > room)
                room -= needed if needed <= room else 0
            results.write(runs(part, shard), arrays)
        assert results is not None
        log = Log.of(results.arrays)
        computed = Computed(results.arrays["q"], log, batch.Seconds(*seconds.tolist()))
        datasets[name] = result(part, computed).to_xarray()
    return datasets, room


def _begin(path: Path, experiment: Experiment, limit: int | None, keep: bool = True) -> Found:
    """A new folder with the experiment in it, and no shards. Raises InputError where it cannot be run.

    Where the folder is kept, it gives the experiment with the classes that are in the copies there.
    """
    source = experiment.source
    with storage.new_folder(path) as new:
        if keep:
            sources.write(new, experiment.references)
        # The classes are taken from the copies now, as `resume` will take them.
        if keep and experiment.files:
            names.forget(experiment.files)
            experiment = Experiment(**experiment.data(), source=source)
        _check_room(experiment.parts(), limit, new)
        text = source.text if source else experiment.to_toml()
        storage.write(new / AS_WRITTEN, text)
        storage.write_json(new / RESOLVED, experiment.data())
        records = {"file": str(source.path.resolve()) if source else None, "sessions": []}
        storage.write_json(new / PROVENANCE, records)
        Store.begin(new, experiment.fingerprint)
    return Found(experiment, Source(path / AS_WRITTEN, text))


def _check_room(parts: Mapping[str, Part], limit: int | None, folder: Path, there: int = 0) -> None:
    """Raises InputError where there is not enough memory for a shard, or disk for all but what is `there` already."""
    needed = 0
    for part in parts.values():
        runs = min(part.runs, shard_runs(part))
        planned = plan(part.needs, runs, limit)
        needed += size(planned.results.arrays) // runs * part.runs
    more = max(2 * needed - there, needed)  # the shards, and results.nc
    if more > (room := shutil.disk_usage(folder).free):
        raise InputError(
            f"the results need {words(more)} on the disk, and there is room for {words(room)} in "
            f"{folder.parent}: take fewer seeds, or a larger log_every"
        )


def _warn_of_damage(store: Store) -> None:
    """Warns of what was damaged or missing, once."""
    while store.problems:
        warn(store.problems.pop(0))
