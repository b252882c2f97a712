"""An experiment in a folder: computed shard by shard, so that no more than one is ever lost.

The folder holds `experiment.toml` as it was given, `resolved.json` with all defaults and draws filled in, copies
of the files that somebody's own classes are in (see `sources`), `provenance.json`, the shards with their manifest
(see `storage`), and, when all are there, `results.nc`, `summary.csv`, pictures and `report.html`. Which runs are in
a shard depends on the experiment alone, and on what it was before it grew (see `growth`); and what a run gives on
its seed and hyperparameters alone: so the results are the same to the last bit, however often it was interrupted, and
however it grew. Where they would not be, as with another version of JAX, nothing is computed: see `Origin`.
"""

import contextlib
import json
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jaxrl_tab.core import names
from jaxrl_tab.core.errors import InputError, as_path, one_line, shown
from jaxrl_tab.core.memory import free, size, words
from jaxrl_tab.engine import backend
from jaxrl_tab.engine.part import Computed, Part
from jaxrl_tab.engine.room import plan
from jaxrl_tab.experiment import comparing, disk, going_on, growth, searching, sources, storage
from jaxrl_tab.experiment.again import RunAgain, toml_of_settings
from jaxrl_tab.experiment.comparing import Look, Looked
from jaxrl_tab.experiment.computing import collect, collected, compute, missing, warn_of_damage
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
from jaxrl_tab.experiment.samplers import check_installed, versions
from jaxrl_tab.experiment.search import Search
from jaxrl_tab.experiment.shards import FRESH, Job, kept_bytes, shard_runs
from jaxrl_tab.experiment.spec import Experiment
from jaxrl_tab.experiment.storage import AS_WRITTEN, PROVENANCE, RESOLVED, Store, warn
from jaxrl_tab.show.progress import Report

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.show.explained import Explanation
    from jaxrl_tab.show.report import Page


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
    with disk.lock(path):
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
    interrupted, `resume` goes on with it. Longer runs, `steps` or `episodes`, go on from where they ended, where the
    folder has that, and rows are as in the longer runs; else they are computed from their beginning: a warning says
    how many, and why.

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
    if searching.is_unfinished(path):
        if experiment or seeds or steps or episodes:
            raise InputError(f"the search in {path} is not finished: resume it first, and then ask for more")
        with disk.lock(path):
            found = _found(path, memory, progress, command, mixed)
            return _go_on(path, found, executor, memory, progress, ready, formats, command, mixed=mixed)
    given = {"seeds": seeds, "steps": steps, "episodes": episodes}
    more = {key: x for key, x in given.items() if x is not None}
    with disk.lock(path):
        found = find(path, other_source=experiment is not None)
        new = wished(found, experiment, more)
        if new.data() != found.experiment.data():
            found = _grown(path, found, new, memory, command, mixed)
        how = {"mixed": mixed, "looked": looked}
        return _go_on(path, found, executor, memory, progress, ready, formats, command, **how)


def search(
    search: Search,
    folder: str | Path | None = None,
    *,
    memory: int | None = None,
    progress: Report | Literal[False] | None = None,
    ready: Callable[[Outcome], None] | None = None,
    formats: Sequence[Format] = FORMATS[:1],
    command: str | None = None,
) -> Outcome:
    """Searches for the best setting of each method, and runs what it found on fresh seeds.

    In the folder is then the experiment of these settings, as `run` leaves it, and in `search/` what the search
    computed. Where it is interrupted, `resume` goes on with the same bits. The search itself is computed in this
    process.

    Args:
        search: what to search, and how.
        folder, memory, progress, ready, formats, command: as in `run`.

    Raises:
        InputError, RunError: as in `run`.
    """
    if not isinstance(search, Search):
        raise InputError(f"search takes a Search, not {shown(search)}")
    if search.halving.is_optuna:
        check_installed()
    command, formats = _typed(command), check_formats(formats)
    with contextlib.ExitStack() as stack:
        keep = folder is not None
        if folder is None:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "experiment"
        else:
            path = _path(folder)
        with disk.new_folder(path) as new:
            own = new / searching.FOLDER
            own.mkdir()
            _write(own, search.experiment, keep)
            searching.begin(own, search)
            if source := search.experiment.source:
                disk.write(own / searching.AS_WRITTEN, source.text)
        stack.enter_context(disk.lock(path))
        found = _found(path, memory, progress, command)
        return _go_on(path, found, None, memory, progress, ready, formats, command, keep)


def explain(folder: str | Path) -> "Explanation":
    """Where the methods of an experiment in a folder lose what they earn less than the best policy.

    As `Outcome.explain`, of an experiment that has ended. Nothing is written; little or nothing is computed again.

    Raises:
        InputError: there is no experiment in the folder, or something of it is missing or damaged.
    """
    path = _folder(folder)
    with disk.lock(path):
        experiment, store, job = _ended(path)
        datasets, _ = collect(store, job, list(job.parts), free() // 2)
        envs = {name.partition("/")[0]: part.env for name, part in job.parts.items()}
        with backend.using(experiment.backend), settings_of(store, records_of(store)):
            return Outcome(datasets, {}, envs, job.parts).explain()


def report(folder: str | Path) -> "Page":
    """The report of an experiment in a folder, made again where it is missing. Raises InputError as `explain`."""
    from jaxrl_tab.show.report import FILE, Page

    path = _folder(folder)
    with disk.lock(path):
        _, store, _ = _ended(path)
    if FILE not in store.files:
        resume(path, progress=False)
    return Page.read(path / FILE)


def _ended(path: Path) -> tuple[Experiment, Store, Job]:
    """An experiment in a locked folder, of which all was computed. Raises InputError where shards are missing."""
    found = find(path)
    experiment, store = found.experiment, Store(path, found.experiment.fingerprint, found.entries)
    job = Job.of(experiment, None, library_versions(experiment.data()), found.experiments[:-1])
    if lacking := missing(store, job):
        raise InputError(f"{len(lacking)} of {len(job.shards)} shards are missing in {path}: resume it first")
    return experiment, store, job


def history(folder: str | Path) -> list[tuple[str, str, str]]:
    """With what an experiment in a folder was begun, and what was added to it: when, what, and by which command.

    Raises:
        InputError: as in `explain`.
    """
    path = _folder(folder)
    with disk.lock(path):
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
    is_there = [
        os.path.lexists(path / name)
        for name in (AS_WRITTEN, RESOLVED, f"{searching.FOLDER}/{searching.PLAN}")
    ]
    if not any(is_there):
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
    warn_of_damage(store)
    records = records_of(store)
    formats = drawn_as(records) if formats is None else formats
    libraries = library_versions(experiment.data())
    job, meter = Job.of(experiment, limit, libraries, found.experiments[:-1]), Meter()
    with backend.using(experiment.backend), settings_of(store, records):
        with meter.reporting(progress):
            origin = Origin.of(store, records, mixed, libraries)
            if missing(store, job):
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
    store, longer = Store(path, old.fingerprint, found.entries), growth.are_longer(old, new)
    warn_of_damage(store)
    records, what = records_of(store), growth.added(old, new)
    with backend.using(new.backend), settings_of(store, records):
        origin = Origin.of(store, records, mixed, libraries)
        origin.check(path)
        there = sum(file.stat().st_size for file in (path / storage.SHARDS).iterdir())
        _check_room(new.parts(), limit, path, 0 if longer else there)  # of longer runs all shards are new
        if longer:
            what += f"; {going_on.told(store, Job.of(new, limit, libraries, found.experiments), origin)}"
    warn(f"{what}; what is there is kept, and what is new is computed now")
    grow(path, found, new, command, store.checksums)
    if new.source and new.source.path.parent != path:
        disk.write_json(path / PROVENANCE, records | {"file": str(new.source.path.resolve())})
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
    new = compute(store, going_on.longer(store, job, origin), executor, meter, later, origin)
    datasets, room = collect(store, job, list(job.parts), free() // 2 if job.memory is None else job.memory)
    envs = {name.partition("/")[0]: part.env for name, part in job.parts.items()}
    outcome = Outcome(datasets, {}, envs, job.parts, tried=searching.history(store.path))
    if experiment.until_decided:
        own = comparing.open_store(store.path, experiment, outcome.chosen)

        def computed(look: Look) -> "tuple[dict[str, xr.Dataset], bool]":
            new = compute(own, look, executor, meter, {}, origin)
            return collect(own, look, list(look.parts), room)[0], new

        verdicts, fresh, more = comparing.compare(job, experiment, outcome.chosen, computed, looked)
        outcome.verdicts.update(verdicts)
        outcome.fresh.update(fresh)
        new |= more
    elif fresh_seeds:
        job = job._replace(chosen=json.dumps(outcome.chosen))
        new |= compute(store, going_on.longer(store, job, origin), executor, meter, {}, origin)
        fresh, _ = collect(store, job, list(later), room)
        outcome.fresh.update((name.removeprefix(FRESH), ds) for name, ds in fresh.items())
    return outcome, new


def _begin(path: Path, experiment: Experiment, limit: int | None, keep: bool = True) -> Found:
    """A new folder with the experiment in it, and no shards. Raises InputError where it cannot be run.

    Where the folder is kept, it gives the experiment with the classes that are in the copies there.
    """
    source = experiment.source
    with disk.new_folder(path) as new:
        _check_room(experiment.parts(), limit, new)
        experiment, text = _write(new, experiment, keep, source)
    return Found(experiment, Source(path / AS_WRITTEN, text))


def _write(
    folder: Path, experiment: Experiment, keep: bool = True, source: Source | None = None
) -> tuple[Experiment, str]:
    """Writes into a folder what its experiment is, and a manifest without shards.

    Gives the experiment, where the folder is kept with the classes that are in the copies there, and its text.
    """
    if keep:
        sources.write(folder, experiment.references)
    # The classes are taken from the copies now, as `resume` will take them.
    if keep and experiment.files:
        names.forget(experiment.files)
        experiment = Experiment(**experiment.data(), source=source)
    text = source.text if source else experiment.to_toml()
    records = {"file": str(source.path.resolve()) if source else None, "sessions": []}
    disk.write_json(folder / PROVENANCE, records)
    Store.begin(folder, experiment.fingerprint)
    disk.write_json(folder / RESOLVED, experiment.data())
    disk.write(folder / AS_WRITTEN, text)
    return experiment, text


def _found(
    path: Path,
    limit: int | None,
    progress: Report | Literal[False] | None,
    command: str,
    mixed: bool = False,
) -> Found:
    """Goes on with the search in a folder, to its end; the experiment of what it found, which is then in the folder."""
    folder = path / searching.FOLDER
    disk.check_no_link(folder)
    searched = find(folder, other_source=True).experiment
    search, store = searching.read(folder, searched), Store(folder, searched.fingerprint)
    warn_of_damage(store)
    records, libraries = records_of(store), library_versions(searched.data()) | versions(search.halving)
    room = free() // 2 if limit is None else limit
    meter = Meter()
    with backend.using(searched.backend), settings_of(store, records), meter.reporting(progress):
        origin = Origin.of(store, records, mixed, libraries)

        def computed(stage: searching.Stage) -> Computed:
            compute(store, stage, Local(), meter, {}, origin)
            return collected(store, stage.part, stage.shards, room)[0]

        under_way = searching.Searching(search, folder, limit, computed)
        with session(store, records, command, libraries, ()):
            under_way.run()
    searching.keep(folder, under_way.tried)
    found, text = _write(path, search.found({x.label: x.config for x in under_way.winners}))
    return Found(found, Source(path / AS_WRITTEN, text))


def _check_room(parts: Mapping[str, Part], limit: int | None, folder: Path, there: int = 0) -> None:
    """Raises InputError where there is not enough memory for a shard, or disk for all but what is `there` already."""
    needed = kept = 0
    for part in parts.values():
        runs = min(part.runs, shard_runs(part))
        planned = plan(part.needs, runs, limit)
        needed += size(planned.results.arrays) // runs * part.runs
        kept += kept_bytes(part)
    more = max(2 * needed + kept - there, needed)  # the shards, and results.nc
    if more > (room := shutil.disk_usage(folder).free):
        raise InputError(
            f"the results need {words(more)} on the disk, and there is room for {words(room)} in "
            f"{folder.parent}: take fewer seeds, or a larger log_every"
        )
