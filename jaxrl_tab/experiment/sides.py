"""Results that are to be compared, from wherever they are: a folder, a file, or what `run` returned.

A folder is only looked at: nothing in it is changed, set aside or locked, so it may be somebody else's, or one in
which a sweep is under way.
"""

import dataclasses
import itertools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jaxrl_tab.core.errors import InputError, as_path, one_line, shown
from jaxrl_tab.core.memory import Results, free, size
from jaxrl_tab.engine import batch
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.log import Log
from jaxrl_tab.engine.part import Computed, Part
from jaxrl_tab.engine.results import SweepResult
from jaxrl_tab.engine.room import results_of
from jaxrl_tab.engine.sweep import result
from jaxrl_tab.experiment import disk, scores, sources, storage
from jaxrl_tab.experiment.files import Outcome
from jaxrl_tab.experiment.found import HISTORY
from jaxrl_tab.experiment.reading import TABLES, Readings, is_of_runs, read
from jaxrl_tab.experiment.records import library_versions, mixture, recorded, records_in
from jaxrl_tab.experiment.shards import END, Job, runs
from jaxrl_tab.experiment.spec import Experiment
from jaxrl_tab.experiment.storage import AS_WRITTEN, DATA, FRESH_DATA, PROVENANCE, RESOLVED

if TYPE_CHECKING:
    import xarray as xr


class Side(NamedTuple):
    """Results that are to be compared.

    Attributes:
        name: what people know them by, such as the folder.
        datasets, fresh: as those of an `Outcome`, by "ENVIRONMENT/METHOD".
        experiment: the data of the experiment; None where they are not known.
        session: the record of the session that computed them, with its `surroundings`; None where it is not known.
        notes: what a reader must know, a sentence each.
        complete: whether all is there that belongs to the experiment.
    """

    name: str
    datasets: "dict[str, xr.Dataset]"
    fresh: "dict[str, xr.Dataset]"
    experiment: dict[str, Any] | None
    session: dict[str, Any] | None
    notes: list[str]
    complete: bool = True


def side(results: Any) -> Side:
    """What is in a folder of results, in a file of them, or in what `run`, `resume`, `sweep` or `read` returned.

    Raises:
        InputError: it is none of these, or nothing in it can be read; the message says what would help.
    """
    if isinstance(results, Outcome):
        return Side(repr(results), results.datasets, results.fresh, None, None, [])
    if isinstance(results, SweepResult):
        name = f"{results.environment}/{results.algorithm}"
        return Side(repr(results), {name: results.to_xarray()}, {}, None, None, [])
    if isinstance(results, Readings):
        return _of_others(repr(results), results)
    if not isinstance(results, str | os.PathLike):
        raise InputError(
            "compare takes folders of results, results.nc, scores (.npz), tables, or what run, resume and read return, "
            f"not {shown(results)}"
        )
    path = Path(os.path.normpath(as_path("the folder", results)))
    name = one_line(str(path))
    if path.suffix in TABLES and path.is_file():
        return _of_others(name, read(path))
    if path.suffix == scores.SUFFIX and path.is_file():
        return _of_scores(path, name)
    if path.is_file():
        return Side(name, in_file(path, None), {}, None, None, [])
    if not path.is_dir():
        raise InputError(f"there is no folder {name}")
    return _in_folder(path, name)


def _of_others(name: str, found: Readings) -> Side:
    datasets = {
        f"{label}/{own}": ds for label, methods in found.methods.items() for own, ds in methods.items()
    }
    return Side(name, datasets, {}, None, None, found.notes)


def _of_scores(path: Path, name: str) -> Side:
    fresh, experiment, session = scores.load(path)
    if not _is_experiment(experiment):
        raise InputError(f"{name} is damaged: it does not say what was computed")
    own = session if session and isinstance(session.get("surroundings"), dict) else None
    return Side(name, {}, fresh, experiment, own, [])


def _in_folder(path: Path, name: str) -> Side:
    if not any(os.path.lexists(path / file) for file in (AS_WRITTEN, RESOLVED)):
        raise InputError(f"there is no experiment in {name}: neither {AS_WRITTEN} nor {RESOLVED}")
    manifest, experiment = storage.read_manifest(path), disk.read_json(path / RESOLVED)
    for file, damaged in ((storage.MANIFEST, manifest is None), (RESOLVED, not _is_experiment(experiment))):
        if damaged:
            raise InputError(
                f"{path / file} is missing or damaged: `jaxrl-tab resume {name}` makes it again of what is left"
            )
    assert manifest is not None
    history = experiment.pop(HISTORY, [])
    session, notes = _session(path, manifest)
    labels = [table["label"] for table in experiment["environment"]]
    alone = labels[0] if len(labels) == 1 else None
    # Where it has just grown, the files are still those of what it was.
    read, found = {}, manifest["files"] if manifest.get(HISTORY, []) == history else {}
    for file in (DATA, FRESH_DATA):
        if file in found and storage.has_checksum(path / file, found[file]):
            read[file] = in_file(path / file, alone)
        elif file in found:
            notes.append(f"{file} is missing or damaged")
    complete = not experiment.get("select") or FRESH_DATA in read
    if DATA in read:
        return Side(name, read[DATA], read.get(FRESH_DATA, {}), experiment, session, notes, complete)
    datasets, missing = _in_shards(path, manifest, experiment, history)
    notes += missing or ([] if complete else ["not finished: the runs on fresh seeds are not all there"])
    if not datasets:
        raise InputError(
            f"nothing is finished in {name} that could be compared: `jaxrl-tab resume {name}` goes on"
        )
    return Side(name, datasets, {}, experiment, session, notes, complete and not missing)


def _is_experiment(data: Any) -> bool:
    """Whether data are what `Experiment.data` gives, as far as they are looked at here."""
    tables = [data.get(kind) for kind in ("environment", "method")] if isinstance(data, dict) else [None]
    return all(
        isinstance(of, list)
        and of
        and all(isinstance(table, dict) and isinstance(table.get("label"), str) for table in of)
        for of in tables
    )


def _session(path: Path, manifest: Mapping[str, Any]) -> tuple[dict[str, Any] | None, list[str]]:
    """The first session that computed something in a folder, and what to know of others."""
    records = records_in(path)
    if records is None:
        return None, [f"{PROVENANCE} is missing or damaged, so what it was computed with is not known"]
    origins = {facts.get("surroundings") for facts in manifest["shards"].values()}
    sessions = [x for x in records["sessions"] if isinstance(x.get("surroundings"), dict)]
    computed = recorded({"sessions": sessions}, origins) or sessions
    mixed = mixture(computed) if len(origins) > 1 else ""
    notes = [f"computed in different surroundings: {mixed}"] if mixed else []
    return (computed[0] if computed else None), notes


def in_file(file: Path, environment: str | None) -> "dict[str, xr.Dataset]":
    """The datasets in a netCDF file; in memory, unless there is not enough of it.

    Names without an environment get that which is given, or that of the dataset.
    """
    from jaxrl_tab.stats import export

    datasets = {}
    for name, ds in export.load(file).items():
        if not is_of_runs(ds):
            raise InputError(f"{one_line(str(file))}: {name} is not what a sweep writes")
        label = environment or ds.attrs.get("environment", "")
        datasets[name if "/" in name else f"{label}/{name}"] = ds.load() if ds.nbytes < free() // 8 else ds
    if not datasets:
        raise InputError(f"{one_line(str(file))} has no results of runs in it")
    return datasets


# --- of a sweep that is not finished -----------------------------------------------------------------
def _in_shards(
    path: Path, manifest: Mapping[str, Any], data: dict[str, Any], history: Any
) -> "tuple[dict[str, xr.Dataset], list[str]]":
    """What the whole shards have, and a sentence on what is missing, if anything is."""
    try:
        sources.read(path, data)
        experiment = Experiment.from_data(data)
        before = [Experiment.from_data(entry["experiment"]) for entry in history]
        job = Job.of(experiment, None, library_versions(data), before)
        parts = job.parts
    except Exception as error:  # there is no end to what another version, or somebody's own class, may raise
        what = one_line(str(error))
        raise InputError(
            f"{path / DATA} is not there, and its shards cannot be understood here: {what}; "
            f"`jaxrl-tab resume` makes {DATA}, with the version that began it"
        ) from None
    sums = {int(Path(name).stem): facts["sha256"] for name, facts in manifest["shards"].items()}
    datasets, there, left = {}, 0, []
    for name, part in parts.items():
        own = {number: shard for number, shard in job.shards.items() if shard.part == name}
        found = np.zeros(part.runs, bool)
        results = None
        for number, shard in own.items():
            arrays = storage.peek(path, number, sums[number]) if number in sums else None
            if arrays is None:
                continue
            arrays = {key: x for key, x in arrays.items() if key != "seconds" and not key.startswith(END)}
            if results is None:
                like = {key: jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for key, x in arrays.items()}
                like["q"] = results_of(part.needs)[0]  # of all programs
                results = Results(like, part.runs, on_disk=size(like) * part.runs > free() // 8)
            at = runs(part, shard)
            results.write(at, arrays)
            found[at] = True
            there += 1
        if results is not None and (ds := _finished(part, results.arrays, found)) is not None:
            datasets[name] = ds
        else:
            left.append(name)
    if there == len(job.shards):
        return datasets, []
    nothing = f"; nothing of {', '.join(left)}" if left else ""
    return datasets, [f"not finished: {there} of {len(job.shards)} shards are there{nothing}"]


def _finished(part: Part, arrays: Mapping[str, np.ndarray], found: np.ndarray) -> "xr.Dataset | None":
    """A dataset of the runs that are `found`: of all settings those seeds that all of them have, or of those settings
    all seeds that have them, whichever is more; None where neither is anything.
    """
    runs_of = found.reshape(len(part.configs), part.num_seeds)  # in the order of the settings
    settings, seeds = np.flatnonzero(runs_of.all(1)), np.flatnonzero(runs_of.all(0))
    if len(seeds) * len(part.configs) >= len(settings) * part.num_seeds:
        if not len(seeds):
            return None
        return _dataset(part, arrays).isel(seed=seeds)
    points = _points(part)
    some = dataclasses.replace(
        part, axes={DRAW: tuple(points[i] for i in settings)}, configs=[part.configs[i] for i in settings]
    )
    at = np.flatnonzero(np.isin(np.arange(part.runs) // part.num_seeds, settings))
    return _dataset(some, {key: x[at] for key, x in arrays.items()})


def _points(part: Part) -> list[dict[str, Any]]:
    """The swept hyperparameters of each configuration."""
    points = []
    for values in itertools.product(*part.axes.values()):
        point = dict(zip(part.axes, values, strict=True))
        points.append(point.pop(DRAW, {}) | point)
    return points


def _dataset(part: Part, arrays: Mapping[str, np.ndarray]) -> "xr.Dataset":
    arrays = dict(arrays)
    computed = Computed(arrays.pop("q"), Log.of(arrays), batch.Seconds(np.nan, np.nan))
    return result(part, computed).to_xarray()
