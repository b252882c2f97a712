"""From the records to ratios, verdicts, a table and JSON."""

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from rich.table import Table
from scipy import stats

from benchmarks import machine
from benchmarks.rounds import Record, Target, Task, cores_in_words

TOLERANCE = 4  # standard errors


class Row(NamedTuple):
    """A comparison of two parties.

    Attributes:
        speed, speed_against: units of work per second, medians over rounds; against nobody None.
        ratio: the median over rounds of the ratio within a round; against nobody the median of the seconds.
        low, high: the smallest and the largest of these ratios.
        verdict: "aim", "met", "missed", or "" where nothing was promised.
    """

    task: str
    cores: int
    unit: str
    party: str
    against: str | None
    speed: float
    speed_against: float | None
    ratio: float
    low: float
    high: float
    least: float | None
    aim: float | None
    times: bool
    verdict: str


def rows(task: Task, records: Iterable[Record]) -> list[Row]:
    """The comparisons of one task, by its own records."""
    seconds = {
        party.name: np.array([r.seconds for r in _of(task, records) if r.party == party.name])
        for party in task.parties
    }
    of = lambda name: None if name is None else seconds[name]
    return [_row(task, target, seconds[target.party], of(target.against)) for target in task.targets]


def _row(task: Task, target: Target, mine: np.ndarray, theirs: np.ndarray | None) -> Row:
    against = 1.0 if theirs is None else theirs  # second
    ratios = mine / against if target.times else against / mine
    ratio = float(np.median(ratios))
    return Row(
        task=task.name,
        cores=task.cores,
        unit=task.unit,
        **target._asdict(),
        speed=task.work / float(np.median(mine)),
        speed_against=None if theirs is None else task.work / float(np.median(theirs)),
        ratio=ratio,
        low=float(ratios.min()),
        high=float(ratios.max()),
        verdict=verdict(target, ratio),
    )


def verdict(target: Target, ratio: float) -> str:
    """Whether the promise was kept: "aim", "met", "missed"; "" where there was none."""
    if target.least is None:
        return ""
    reached = lambda bound: ratio < bound if target.times else ratio >= bound
    if target.aim is not None and reached(target.aim):
        return "aim"
    return "met" if reached(target.least) else "missed"


def _of(task: Task, records: Iterable[Record]) -> list[Record]:
    return [r for r in records if (r.task, r.cores) == (task.name, task.cores)]


# --- do all learn the same? --------------------------------------------------------------------------


class Mean(NamedTuple):
    """A mean over lanes and rounds, with its standard error, of n numbers."""

    mean: float
    error: float
    n: int


def disagreements(task: Task, records: Iterable[Record]) -> list[str]:
    """A line for each pair of parties whose mean outcomes differ by more than 4 standard errors.

    Of few lanes the standard error is itself uncertain: the bound is then as improbable as 4 standard errors
    are for many, by Student's t.
    """
    if task.outcome is None:
        return []
    means = {
        party.name: _pooled([r for r in _of(task, records) if r.party == party.name])
        for party in task.parties
    }
    lines = []
    for (one, x), (other, y) in itertools.combinations(means.items(), 2):
        bound = stats.t.isf(stats.norm.sf(TOLERANCE), min(x.n, y.n) - 1) * np.hypot(x.error, y.error)
        if not abs(x.mean - y.mean) <= bound:
            lines.append(
                f"{task.name}, {cores_in_words(task.cores)}: {task.outcome}: {one} {x.mean:.5g}, "
                f"{other} {y.mean:.5g}; by chance they differ by {bound:.2g} at the most"
            )
    return lines


def _pooled(records: Sequence[Record]) -> Mean:
    """Over all lanes of all rounds, whose random numbers all differ."""
    mean, variance, lanes = np.array([(r.mean, r.variance, r.lanes) for r in records], float).T
    n, centre = lanes.sum(), np.average(mean, weights=lanes)
    spread = np.average(variance + (mean - centre) ** 2, weights=lanes)
    return Mean(float(centre), float(np.sqrt(spread / max(n - 1, 1))), int(n))


# --- to people and programs --------------------------------------------------------------------------


def table(rows: Iterable[Row], rounds: int) -> Table:
    """All comparisons; speeds in millions of steps or episodes per second, or seconds where times are compared."""
    view = Table(
        *("task", "cores", "", "million/s", "against", "million/s", "ratio", "lowest, highest", "target", ""),
        caption=f"{machine.processor()}\nmedians of {rounds} rounds; the ratios are those within a round",
    )
    for i in (1, 3, 5, 6, 7, 8):
        view.columns[i].justify = "right"
    last = None
    for row in rows:
        if (row.task, row.cores) != last:
            view.add_section()
        first, last = (row.task, row.cores) != last, (row.task, row.cores)
        style = {"missed": "bold red", "met": "green", "aim": "bold green"}.get(row.verdict)
        view.add_row(
            f"{row.task}" if first else "",
            str(row.cores) if first else "",
            row.party,
            _speed(row, row.speed),
            row.against or "",
            "" if row.speed_against is None else _speed(row, row.speed_against),
            f"{row.ratio:.3g}{_unit(row)}",
            f"{row.low:.3g}, {row.high:.3g}{_unit(row)}",
            _promise(row),
            f"[{style}]{row.verdict}[/]" if style else "",
        )
    return view


def _speed(row: Row, speed: float) -> str:
    return f"{1 / speed:.3g} s" if row.times else f"{speed / 1e6:.3g}"


def _promise(row: Row) -> str:
    if row.least is None:
        return ""
    aim = "" if row.aim is None else f", aim {row.aim:g}{_unit(row)}"
    return f"{'<' if row.times else '≥'} {row.least:g}{_unit(row)}{aim}"


def _unit(row: Row) -> str:
    """Of its ratio, which against nobody is a time."""
    return " s" if row.against is None else ""
