"""Results that other tools computed: `read`."""

import glob
import json
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from jaxrl_tab.core import events
from jaxrl_tab.core.errors import InputError, as_path, listed, nearest, one_line, reason, shown, whole

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.show.report import Page
    from jaxrl_tab.stats.columns import Methods

Table: TypeAlias = Any  # a DataFrame; pandas is imported when something is read
NEEDED = ("steps", "episodes", "returns")  # of a log, to be compared; what others computed has no more
NAMED = r"{[A-Za-z_]\w*}"  # of a pattern: what becomes a column
EVENTS = "tfevents"  # what the names of event files have in them
TABLES = (".csv", ".tsv", ".parquet")
KINDS = f"{', '.join(TABLES)}, .nc, or an event file, whose name has {EVENTS} in it"


class Readings(dict[str, Any]):
    """Datasets by "METHOD", or "ENVIRONMENT/METHOD" where the tables name environments: what `read` gives.

    They go wherever the datasets of sweeps do: `stats`, `plot`, `export`, `compare`. They have what was read and no
    more: scores, as the `returns` of `episodes`, and the hyperparameters that were named.

    Attributes:
        notes: what a reader must know, a sentence each, such as what was left out.
    """

    def __init__(self, datasets: "Mapping[str, xr.Dataset]", notes: Sequence[str] = ()) -> None:
        super().__init__(datasets)
        self.notes = list(notes)

    def __repr__(self) -> str:
        runs = sum(int(ds.episodes.isel(row=0).size) for ds in self.values())
        return f"<Readings of {', '.join(self)}: {runs} runs>"

    @property
    def methods(self) -> "dict[str, Methods]":
        """The methods of each environment, with all that can be worked out of them."""
        from jaxrl_tab.stats.columns import Methods

        own: dict[str, dict[str, xr.Dataset]] = {}
        for name, ds in self.items():
            own.setdefault(str(ds.attrs["environment"]), {})[name.rpartition("/")[2]] = ds
        return {label: Methods(datasets) for label, datasets in own.items()}

    def report(self) -> "Page":
        """A page of these results, which needs nothing else: a notebook shows it, and its `save` writes it."""
        from jaxrl_tab.show.others import page

        return page(self.methods, self.notes)


def read(
    paths: Any,
    *,
    method: str = "method",
    seed: str = "seed",
    step: str = "step",
    score: str = "score",
    environment: str | None = None,
    settings: Sequence[str] = (),
    given: Mapping[str, Any] | None = None,
    every: int | None = None,
    until: int | None = None,
    unpaired: bool = False,
) -> Readings:
    """Reads results that any tool computed, so that tables, statistics, pictures and `compare` work on them.

    Tables are in long form, a row for each score of each run; or there is a file for each run, and a pattern says where
    in its name the method and the seed stand: `"runs/{method}/seed_{seed}.csv"`. A score is a number that is the better
    the higher it is (of a loss take the negative), such as the return of an episode, or the mean of an evaluation. As
    everywhere, methods are compared by the mean of each run's scores in its last tenth.

    Nothing is made up. Runs with other steps than each other are not interpolated, but refused, unless `every` collects
    the scores of so many steps in a row; what is missing, there twice, or no number is refused, too.

    Args:
        paths: a file, or several: tables (.csv, .tsv; .parquet, for which it takes pyarrow), netCDF files (.nc), whose
            scores are a variable with named axes, event files of TensorBoard, or a folder of these; or a pattern with
            names in braces, which become columns, and with * for what does not matter. netCDF files of ours are read as
            they are.
        method, seed, step, score: what the columns are called. In event files `score` is the tag. Seeds and steps are
            whole numbers. Where no column `step` is, a run has one score.
        environment: the column of environments, if there are several; by default "environment", where it is.
        settings: the columns of hyperparameters, if several settings of a method were run.
        given: columns that the files have not, each with its one value: `{"method": "dqn"}`.
        every: how many steps a row of the log sums up; a score at step t is in row (t - 1) // every.
        until: the last step that is read.
        unpaired: take methods that have other seeds than each other, which are refused otherwise.

    Returns:
        A dataset for each method, as `SweepResult.to_xarray` gives it, but for what is not known: dimensions are the
        `settings` of several values, seed and row, and variables `steps`, `episodes` (how many scores), `returns`
        (their sum, float64), and `diverged` (False: scores are finite).

    Raises:
        InputError: files, or columns in them, are missing; runs, or scores of runs, are missing or there twice; numbers
            are none; steps are not the same in all runs, or not evenly spaced. The message says where, and what to do.
    """
    import pandas as pd

    from jaxrl_tab.stats import reading

    every, until = (
        None if x is None else whole("read", name, x) for name, x in (("every", every), ("until", until))
    )
    columns = reading.Columns(method, seed, step, score, tuple(settings), every, until, unpaired)
    notes: list[str] = []
    ours: dict[str, xr.Dataset] = {}
    frames = []
    for path, found in _files(paths, notes):
        name = one_line(str(path))
        if path.suffix == ".nc" and (datasets := _of_ours(path)):
            _add(ours, datasets, name)
            continue
        frame = _frame(path, score, notes)
        for column, value in [*found.items(), *(given or {}).items()]:
            if column in frame:
                raise InputError(
                    f"{name} has a column {shown(column)} already, which cannot be given as well"
                )
            frame[column] = value
        if environment is not None and environment not in frame:
            raise InputError(
                f"{name} has no column {shown(environment)}: there are {listed(map(str, frame))}"
            )
        frame = frame.rename(columns={environment or "environment": reading.ENVIRONMENT})
        reading.check_columns(frame, columns, name)
        if not len(frame):
            raise InputError(f"{name} has no rows")
        frame[reading.WHERE] = [f"{name}, row {i + 1}" for i in range(len(frame))]
        frames.append(frame)
    if frames:
        _check_same_columns(frames, (reading.ENVIRONMENT, step))
        _add(ours, reading.datasets(pd.concat(frames, ignore_index=True), columns, notes), "what was read")
    return Readings(ours, notes)


def _add(to: "dict[str, xr.Dataset]", datasets: "Mapping[str, xr.Dataset]", where: str) -> None:
    if both := to.keys() & datasets.keys():
        raise InputError(f"{where} has {listed(both)}, which was read already")
    to.update(datasets)


def _check_same_columns(frames: Sequence[Table], optional: Sequence[str]) -> None:
    """Raises InputError where some files have one of the optional columns, and others lack it."""
    from jaxrl_tab.stats.reading import WHERE

    first = set(frames[0]) & {*optional}
    for frame in frames[1:]:
        if odd := first ^ (set(frame) & {*optional}):
            names = " and ".join(x[WHERE].iloc[0].rpartition(",")[0] for x in (frames[0], frame))
            raise InputError(f"one of these has a column {shown(min(odd))} and the other has not: {names}")


# --- files -------------------------------------------------------------------------------------------
def _files(paths: Any, notes: list[str]) -> Iterator[tuple[Path, dict[str, str]]]:
    """The files that are named, each with what its name says."""
    several = [paths] if isinstance(paths, str | os.PathLike) else paths
    if not isinstance(several, Sequence) or not several:
        raise InputError(f"read takes a file, a pattern, or a list of these, not {shown(paths)}")
    for named in several:
        path = as_path("a file", named)
        pattern = str(path)
        found = (
            [(path, {})]
            if path.exists()
            else list(_matching(pattern, notes))
            if "{" in pattern or "*" in pattern
            else []
        )
        if not found:
            what = "no file fits the pattern" if "{" in pattern or "*" in pattern else "there is no file"
            raise InputError(f"{what} {one_line(pattern)}")
        for one, fields in found:
            for file in _of_folder(one) if one.is_dir() else [one]:
                yield file, fields


def _of_folder(folder: Path) -> list[Path]:
    files = sorted(x for x in folder.iterdir() if EVENTS in x.name and x.is_file())
    if not files:
        raise InputError(
            f"there is no event file in the folder {one_line(str(folder))}; tables are named one by one, or by a "
            "pattern such as runs/{method}_{seed}.csv"
        )
    return files


def _matching(pattern: str, notes: list[str]) -> Iterator[tuple[Path, dict[str, str]]]:
    """The files that a pattern fits, with the texts that stand for its names in braces; seeds are numbers."""
    names = re.findall(NAMED, pattern)
    if len(set(names)) < len(names):
        raise InputError(f"{one_line(pattern)} has a name in braces twice")
    parts = re.split(rf"({NAMED}|\*+)", pattern)
    expression, wild = "", ""
    for part in parts:
        if re.fullmatch(NAMED, part):
            kind = r"\d+" if part == "{seed}" else "[^/]+"
            expression += f"(?P<{part[1:-1]}>{kind})"
            wild += "*"
        elif part.startswith("*"):
            expression += "[^/]*"
            wild += "*"
        else:
            expression += re.escape(part)
            wild += glob.escape(part)
    unlike = []
    for path in sorted(glob.glob(wild)):
        if match := re.fullmatch(expression, path):
            yield Path(path), match.groupdict()
        else:
            unlike.append(path)
    if unlike:
        notes.append(f"not read, since the pattern does not fit: {one_line(listed(unlike))}")


def _of_ours(path: Path) -> "dict[str, xr.Dataset]":
    """The datasets of a netCDF file that sweeps, or `export.save`, wrote; none where it is of another tool."""
    from jaxrl_tab.stats import export

    try:
        datasets = export.load(path)
    except InputError:  # netCDF of another version, or damaged: that is seen when it is read as a table
        return {}
    ours = {name: ds for name, ds in datasets.items() if "environment" in ds.attrs}
    if damaged := next((name for name, ds in ours.items() if not is_of_runs(ds)), None):
        raise InputError(f"{one_line(str(path))}: {damaged} is not what a sweep writes")
    return {name: ds.load() for name, ds in ours.items()}


def is_of_runs(ds: "xr.Dataset") -> bool:
    """Whether a dataset is what `SweepResult.to_xarray` gives, as far as it is looked at here."""
    attrs = ds.attrs
    try:
        numbers = [
            int(attrs["log_every"]),
            int(attrs["num_steps" if "num_steps" in attrs else "num_episodes"]),
        ]
        texts = [json.loads(attrs.get(key, "{}")) for key in ("fixed", "environment_parameters")]
    except (KeyError, TypeError, ValueError):
        return False
    has_log = all(name in ds and {"seed", "row"} <= set(ds[name].dims) for name in NEEDED)
    return has_log and "seed" in ds.coords and min(numbers) > 0 and all(isinstance(x, dict) for x in texts)


# --- tables ------------------------------------------------------------------------------------------
def _frame(path: Path, score: str, notes: list[str]) -> Table:
    """What a file has, as a table."""
    name = one_line(str(path))
    if EVENTS in path.name:
        return _events(path, score, notes)
    if path.suffix.lower() not in (*TABLES, ".nc"):
        raise InputError(f"{name} is none of the files that can be read: {KINDS}")
    try:
        if path.suffix.lower() == ".nc":
            return _netcdf(path, score)
        return _parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)
    except InputError:
        raise
    except Exception as error:  # pandas, pyarrow and xarray raise whatever they like of damaged files
        raise InputError(f"{name} cannot be read: {reason(error)}") from None


def _csv(path: Path) -> Table:
    """The cells as text, so that what is no number can be told as it stands; "#" begins lines before the heading."""
    import pandas as pd

    comments, heading = 0, ""
    with path.open(encoding="utf-8-sig") as lines:
        for heading in lines:
            if not heading.startswith("#"):
                break
            comments += 1
    separator = next((sign for sign in ",;\t" if sign in heading), ",")
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # that a row has more cells than the heading
        return pd.read_csv(
            path,
            sep=separator,
            dtype=str,
            keep_default_na=False,
            skiprows=comments,
            index_col=False,
            skipinitialspace=True,
            encoding="utf-8-sig",
        )


def _parquet(path: Path) -> Table:
    import importlib.util

    import pandas as pd

    if importlib.util.find_spec("pyarrow") is None:
        raise InputError("Parquet needs pyarrow: python -m pip install 'jaxrl-tab[parquet]'")
    frame = pd.read_parquet(path)
    return frame if frame.index.names == [None] else frame.reset_index()


def _netcdf(path: Path, score: str) -> Table:
    """A variable with named axes, as a table: a row for each of its numbers."""
    import xarray as xr

    with xr.open_dataset(path) as ds:
        if score not in ds:
            raise InputError(
                f"{one_line(str(path))} has no variable {shown(score)}: there are {listed(map(str, ds.data_vars))}; "
                "score= (--score) says what it is called"
            )
        axes = set(ds[score].dims)
        beside = [
            name for name, x in ds.variables.items() if name == score or (x.dims and set(x.dims) <= axes)
        ]
        return ds[beside].load().to_dataframe().reset_index()


def _events(path: Path, tag: str, notes: list[str]) -> Table:
    import pandas as pd

    name = one_line(str(path))
    try:
        tags, damaged = events.scalars(path)
    except OSError as error:
        raise InputError(f"{name} cannot be read: {reason(error)}") from None
    if damaged is not None:
        notes.append(f"{name} is damaged or cut off from byte {damaged} on: what comes before was read")
    if tag not in tags:
        there = (
            f"there are {listed(tags)}; {nearest(tag, tags, ' ')}".rstrip("; ") if tags else "there are none"
        )
        raise InputError(f"{name} has no scalar {shown(tag)}: {there}; score= (--score) names it")
    return pd.DataFrame(tags[tag], columns=pd.Index(["step", tag]))
