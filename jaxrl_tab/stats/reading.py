"""From a table in long form, a row for each score of each run, to the datasets that all statistics take.

Nothing is made up: no score is interpolated or repeated, no run is left out unsaid, and what a table does not say, such
as the lengths of episodes or an exact optimum, its datasets have not. `rl.read` finds the tables.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr

from jaxrl_tab.core.errors import InputError, listed, nearest, shown
from jaxrl_tab.stats.measures import NOT_SWEPT, last_tenth

Table: TypeAlias = Any  # a DataFrame, of which it is not known before a program runs what its columns are
Column: TypeAlias = Any  # a Series

ENVIRONMENT = "environment"  # the column of environments, where there is one
UNNAMED = "results"  # what the environment is called where there is none
WHERE = "__where__"  # the column that says where a row was read
MOST = 2**24  # numbers of a variable, if there are not more in the table
TAKEN = {*NOT_SWEPT, "draw", "steps", "episodes", "returns"}  # names that datasets use for something else


@dataclass(frozen=True)
class Columns:
    """What the columns of a table are called, and how their rows become those of a log.

    Attributes:
        method, seed, score: of every row. Of a score higher is better.
        step: the time at which a run had the score; a table without this column has one score for each run.
        settings: hyperparameters, one column each.
        every: how many steps a row of the log sums up; None: the rows of the table are its rows.
        until: the last step that is read; None: all.
        unpaired: whether methods may have other seeds than each other.
    """

    method: str
    seed: str
    step: str
    score: str
    settings: tuple[str, ...] = ()
    every: int | None = None
    until: int | None = None
    unpaired: bool = False


def check_columns(frame: Table, columns: Columns, where: str) -> None:
    """Raises InputError unless a table has the columns that it must have."""
    for name in columns.settings:
        if name in TAKEN or name in (columns.method, columns.seed, columns.step, columns.score, ENVIRONMENT):
            raise InputError(
                f"{shown(name)} cannot be a hyperparameter: the name stands for something else here"
            )
    there = [str(name) for name in frame.columns if name != WHERE]
    for field in ("method", "seed", "score", *columns.settings):
        name = field if field in columns.settings else getattr(columns, field)
        if name not in there:
            how = "" if field in columns.settings else f"; {field}= (--{field}) says what it is called"
            how += (
                f", or {{{field}}} in a pattern where it stands in the path"
                if field in ("method", "seed")
                else ""
            )
            hint = f"{nearest(name, there, ' ')} ".strip() or f"there are {listed(there)}"
            hint = hint if hint.startswith("there") else f"there are {listed(there)}; {hint}"
            raise InputError(f"{where} has no column {shown(name)}: {hint}{how}")


def datasets(frame: Table, columns: Columns, notes: list[str]) -> dict[str, xr.Dataset]:
    """The datasets of a table, by "METHOD", or "ENVIRONMENT/METHOD" where it has a column `ENVIRONMENT`.

    Args:
        frame: the table; its column `WHERE` says where a row was read.
        columns: what is what.
        notes: a sentence is added for all that a reader must know.

    Raises:
        InputError: something is missing, there twice, or no number; the message says where.
    """
    frame = frame.copy()
    has_steps = columns.step in frame
    frame[columns.seed] = _whole(frame, columns.seed)
    frame[columns.score] = _numbers(frame, columns.score)
    if has_steps:
        frame = _in_time(frame, columns, notes)
    several = ENVIRONMENT in frame
    environment = _names(frame, ENVIRONMENT) if several else [UNNAMED] * len(frame)
    keys = [np.array(x, object) for x in (environment, _names(frame, columns.method))]
    found: dict[str, xr.Dataset] = {}
    for (label, method), rows in frame.groupby(keys, sort=False):
        who = f"{method} in {label}" if several else str(method)
        ds = _dataset(rows, columns, has_steps, who)
        ds.attrs |= {"environment": str(label), "algorithm": str(method)}
        found[f"{label}/{method}" if several else str(method)] = ds
    _check_alike(found, columns, notes)
    return found


# --- columns -----------------------------------------------------------------------------------------
def _names(frame: Table, column: str) -> list[str]:
    """Names as keys have them, in which "/" stands between environment and method."""
    values = frame[column].astype(object)
    empty = values.isna() | (values.astype(str).str.strip() == "")
    if empty.any():
        raise InputError(f"{frame[empty].iloc[0][WHERE]}: {column} is empty; {int(empty.sum())} such in all")
    return [str(value).strip().replace("/", "-") for value in values]


def _to_numbers(values: Column) -> Column:
    """Numbers, NaN where there is none."""
    return pd.to_numeric(values, errors="coerce")


def _numbers(frame: Table, name: str) -> Column:
    numbers = _to_numbers(frame[name]).astype(float)
    bad = ~np.isfinite(numbers)
    if bad.any():
        row = frame[bad].iloc[0]
        what = "is empty" if str(row[name]).strip() == "" else f"is {shown(row[name])}, not a finite number"
        raise InputError(f"{row[WHERE]}: {name} {what}; {int(bad.sum())} such in all")
    return numbers


def _whole(frame: Table, name: str) -> Column:
    numbers = _numbers(frame, name)
    bad = (numbers != np.floor(numbers)) | (numbers < 0) | (numbers >= 2**53)
    if bad.any():
        row = frame[bad].iloc[0]
        raise InputError(f"{row[WHERE]}: {name} must be a whole number of at least 0, not {shown(row[name])}")
    return numbers.astype(np.int64)


def _in_time(frame: Table, columns: Columns, notes: list[str]) -> Table:
    """The rows that are read, with their steps as numbers."""
    frame[columns.step] = _whole(frame, columns.step)
    before = frame[columns.step] == 0
    if before.any():
        notes.append(f"{int(before.sum())} scores at step 0, before anything was learned, are left out")
    late = frame[columns.step] > columns.until if columns.until else pd.Series(False, frame.index)
    if late.any():
        notes.append(f"{int(late.sum())} scores after step {columns.until} are left out, as was asked")
    frame = frame[~before & ~late]
    if frame.empty:
        raise InputError("no score is left: all are at step 0, or after the last step that is to be read")
    return frame


# --- a dataset ---------------------------------------------------------------------------------------
def _dataset(rows: Table, columns: Columns, has_steps: bool, who: str) -> xr.Dataset:
    """The scores of a method, as a log: in each row as many episodes as it has scores, which sum up to `returns`."""
    axes, fixed = _settings(rows, columns)
    names = [*axes, columns.seed]
    places, shape = [], []
    coords: dict[str, Any] = {}
    for name, values in [*axes.items(), (columns.seed, rows[columns.seed].to_numpy())]:
        labels, place = np.unique(values, return_inverse=True)
        coords["seed" if name == columns.seed else name] = labels
        places.append(place)
        shape.append(len(labels))
    _check_no_doubles(rows.assign(**axes), [*names, *([columns.step] if has_steps else [])], columns, who)
    missing = math.prod(shape) - len(pd.DataFrame(np.column_stack(places)).drop_duplicates())
    if missing > len(rows):
        raise InputError(
            f"{who} has {len(rows)} scores, fewer than {' x '.join(map(str, shape))} values of {', '.join(names)}: "
            "each combination of settings needs a run of each seed"
        )
    runs = np.asarray(np.ravel_multi_index(places, shape))
    run = lambda i: _run(int(i), [*coords], [*coords.values()], shape, who)
    if missing:
        first = np.setdiff1d(np.arange(math.prod(shape)), runs)[0]
        raise InputError(f"there is no run of {run(first)}; {missing} such in all")
    if has_steps:
        row, length, budget = _rows(rows[columns.step].to_numpy(), runs, columns, run)
    else:
        row, length, budget = np.zeros(len(rows), int), 0, {"num_episodes": 1, "log_every": 1}
    count = int(row.max()) + 1
    whole = (*shape, count)
    if math.prod(whole) > max(MOST, 100 * len(rows)):
        raise InputError(
            f"{who} would have {count} rows in each run, nearly all empty: take a larger every= (--every)"
        )
    at = runs * count + row
    size = math.prod(whole)
    episodes = np.bincount(at, minlength=size).reshape(whole)
    returns = np.bincount(at, weights=rows[columns.score].to_numpy(), minlength=size).reshape(whole)
    dims = (*axes, "seed", "row")
    ds = xr.Dataset(
        {
            "steps": (dims, np.full(whole, length)),
            "episodes": (dims, episodes),
            "returns": (dims, returns),
            "diverged": (dims[:-1], np.zeros(shape, bool)),  # all scores are finite
        },
        coords | {"row": np.arange(count)},
        {"learns": "actions", "fixed": json.dumps(fixed), **budget},
    )
    without = ds.episodes.isel(row=last_tenth(ds)).sum("row").values.ravel() == 0
    if without.any():
        raise InputError(
            f"{run(np.flatnonzero(without)[0])} has no score in the last tenth of the {budget.get('num_steps')} steps, "
            f"by which methods are compared; until= (--until) reads all runs up to a step that they all have"
        )
    return ds


def _settings(rows: Table, columns: Columns) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The hyperparameters of which a method has several values, with that of each row; and those that have one."""
    axes, fixed = {}, {}
    for name in columns.settings:
        values = rows[name]
        if (values.isna() | (values.astype(str).str.strip() == "")).all():
            continue  # this method has no such hyperparameter
        numbers = _to_numbers(values)
        values = (values.astype(str) if numbers.isna().any() else numbers).to_numpy()
        if len(np.unique(values)) > 1:
            axes[name] = values
        else:
            fixed[name] = values.tolist()[0]
    return axes, fixed


def _run(i: int, names: Sequence[str], labels: Sequence[np.ndarray], shape: Sequence[int], who: str) -> str:
    """A run in words."""
    places = np.unravel_index(i, shape)
    of = [f"{name} {values[place]}" for name, values, place in zip(names, labels, places, strict=True)]
    return f"{who}, {', '.join(of)}"


def _check_no_doubles(rows: Table, key: list[str], columns: Columns, who: str) -> None:
    double = rows.duplicated(key, keep=False)
    if not double.any():
        return
    first = rows[double].iloc[0]
    second = rows[double & (rows[key] == first[key]).all(axis=1)].iloc[1]
    what = ", ".join(f"{name} {first[name]}" for name in key)
    if columns.step not in key:
        others = [
            str(n) for n in rows.columns if n not in (*key, ENVIRONMENT, columns.method, columns.score, WHERE)
        ]
        hint = f"; step= (--step) names the column of steps, and settings= those of hyperparameters: {listed(others)}"
    else:
        hint = "; settings= (--settings) names columns of hyperparameters, if that is what differs"
    raise InputError(f"{who}, {what} is there twice: {first[WHERE]}, and {second[WHERE]}{hint}")


def _rows(
    step: np.ndarray, runs: np.ndarray, columns: Columns, run: Any
) -> tuple[np.ndarray, int, dict[str, int]]:
    """For each score the row of the log that it is in; how many steps these have; and what a dataset says of that."""
    if columns.every is not None:
        row = (step - 1) // columns.every
        return row, columns.every, {
            "num_steps": (int(row.max()) + 1) * columns.every, "log_every": columns.every
        }  # fmt: skip
    grid, row = np.unique(step, return_inverse=True)
    have = np.zeros((runs.max() + 1, len(grid)), bool)
    have[runs, row] = True
    collects = "nothing is interpolated: every= (--every) collects the scores of so many steps"
    if not have.all():
        fewest = int(np.argmin(have.sum(1)))
        at = int(grid[np.argmin(have[fewest])])
        if have.sum() > 0.5 * have.size:
            ends = have[fewest, : int(have[fewest].sum())].all()
            how = "it ends there; until= (--until) reads all runs up to an earlier step" if ends else collects
            raise InputError(f"{run(fewest)} has no score at step {at}, and others have: {how}")
        one, other = (", ".join(map(str, grid[have[i]][:3])) for i in (0, min(1, len(have) - 1)))
        raise InputError(f"runs have scores at other steps ({one}, ... and {other}, ...), and {collects}")
    if len(set(np.diff(grid, prepend=0).tolist())) > 1:
        begin = ", ".join(map(str, grid[:4]))
        raise InputError(f"steps are not evenly spaced ({begin}, ...), and {collects}")
    return row, int(grid[0]), {"num_steps": int(grid[-1]), "log_every": int(grid[0])}


# --- methods beside each other -----------------------------------------------------------------------
def _check_alike(found: Mapping[str, xr.Dataset], columns: Columns, notes: list[str]) -> None:
    """Raises InputError unless the methods of each environment can be compared."""
    for first, other in _pairs(found):
        a, b = found[first], found[other]
        ends = [int(ds.attrs.get("num_steps", 0)) for ds in (a, b)]
        if ends[0] != ends[1]:
            raise InputError(
                f"{first} ends at step {ends[0]} and {other} at step {ends[1]}: until={min(ends)} (--until) reads both "
                "up to where both are"
            )
        alone = [np.setdiff1d(x.seed, y.seed) for x, y in ((a, b), (b, a))]
        if not any(map(len, alone)):
            continue
        has = " and ".join(
            f"{name} alone has {listed(map(str, seeds[:5]))}{', ...' if len(seeds) > 5 else ''}"
            for name, seeds in zip((first, other), alone, strict=True)
            if len(seeds)
        )
        what = f"{first} and {other} have other seeds, so their runs are no pairs: {has}"
        if not columns.unpaired:
            raise InputError(f"{what}; unpaired=True (--unpaired) reads them all the same")
        notes.append(f"{what}; stats.unpaired_difference compares them")


def _pairs(found: Mapping[str, xr.Dataset]) -> Iterator[tuple[str, str]]:
    """The first method of each environment with each other one there."""
    first: dict[str, str] = {}
    for name, ds in found.items():
        own = first.setdefault(ds.attrs["environment"], name)
        if own != name:
            yield own, name
