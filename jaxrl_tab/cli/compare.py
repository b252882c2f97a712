"""`jaxrl-tab compare`: results of sweeps side by side."""

import os
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.fitting import print_fitting, print_over_tasks
from jaxrl_tab.cli.screen import busy
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import FILE, parse, word
from jaxrl_tab.core.errors import InputError, one_line
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.experiment import compare, disk
from jaxrl_tab.show import ranked
from jaxrl_tab.show.compared import Beside, Comparison, cells, decimals, head, title_of_part, where
from jaxrl_tab.show.words import title_of
from jaxrl_tab.stats.ranking import Ranking
from jaxrl_tab.stats.versus import Compared

STYLES = {"worse": "bold red", "better": "green", "same": "dim"}
NARROW = (
    2,
    7,
    3,
    4,
    6,
)  # the columns that a narrow window leaves out, in this order: the sentences below tell, too
ROWS = 60  # of a table for people, at most: those that are the same go first


@checked_dataclass
class Compare:
    """Results beside others: what differs, what is the same to the last bit, and what is better or worse.

    Methods that only the others have are ranked among those of A, over the environments that both have. A is the first
    folder; each of the others is compared with it. Of settings that both have it counts the runs that are the same to
    the last bit, as they should be where only the machine, the executor or the backend is another one. Where they are
    not, scores are compared on the seeds that both have, seed by seed, and all comparisons are corrected together
    (Holm). Of a sweep that is not finished what is there is compared. Folders are only looked at.

    Exit code with --fail-if-worse: 1 where anything is worse than in A; else 2 where something of A could not be
    compared; else 0.

    Examples:
      jaxrl-tab compare runs/last-month runs/today
      jaxrl-tab compare runs/last-month runs/today --fail-if-worse
      jaxrl-tab compare runs/a runs/b runs/c --html compared.html
      jaxrl-tab compare runs/a/results.nc runs/b --json
      jaxrl-tab compare benchmarks/suite.npz runs/mine

    Attributes:
        folders: Two or more folders of sweeps: what --out named; their results.nc; tables as `read` takes them; or
            scores that were kept (.npz).
        fail_if_worse: End with exit code 1 where anything is worse than in the first folder.
        html: New file for a page that shows all of it.
        json: Print JSON.
    """

    folders: tuple[str, ...] = word("DIR DIR ...", many=True)
    fail_if_worse: bool = False
    html: FILE = None
    json: bool = False


def compare_command(argv: list[str]) -> int:
    options, _ = parse(Compare, argv)
    if len(options.folders) < 2:
        raise InputError("name two or more folders of sweeps: the first is what the others are compared with")
    page = new_file(options.html)
    with busy("comparing"):
        comparison = compare.compare(*options.folders)
        if page:
            disk.write(page, comparison.page().html)
    if options.json:
        print_json(comparison.to_dict())
    else:
        _print(comparison)
        if page:
            print(f"{page} shows all of it")
    if not options.fail_if_worse:
        return 0
    return 1 if comparison.worse else 0 if comparison.whole else 2


def new_file(file: str | Path | None) -> Path | None:
    """The path of a file that can be written. Raises InputError where it cannot."""
    if file is None:
        return None
    path = Path(file)
    if os.path.lexists(path):
        raise InputError(f"{one_line(str(path))} exists already; name a new file")
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {one_line(str(path.parent))} for {path.name}")
    return path


def _print(comparison: Comparison) -> None:
    out = console()
    out.print(f"[bold]A[/]  {escape(comparison.name)}", soft_wrap=True)
    for other in comparison.others:
        out.print(f"[bold]{other.letter}[/]  {escape(other.name)}", soft_wrap=True)
    for letter, notes in [("A", comparison.notes), *((x.letter, x.notes) for x in comparison.others)]:
        for note in notes:
            out.print(f"[yellow]{letter}: {escape(note)}[/]", soft_wrap=True)
    for other in comparison.others:
        out.print()
        for line in _differs(other):
            out.print(line, markup=False, soft_wrap=True)
        if other.ranked:
            _print_ranking(out, other.ranked)
        for environment, rows in other.by_environment.items():
            out.print(f"[bold]{escape(title_of(environment))}[/]")
            _print_table(out, head(other), rows)
        for line in _first_places(other):
            out.print(line, markup=False, soft_wrap=True)
        for line in other.sentences():
            style = "bold red" if "WORSE" in line or "is worse" in line else None
            out.print(line, markup=False, style=style, soft_wrap=True)


def _differs(other: Beside) -> Iterator[str]:
    """What is not as in A, a line for each kind."""
    if not any(other.differs.values()):
        yield f"Nothing else differs between A and {other.letter} that is known of both."
    for what, lines in other.differs.items():
        if lines:
            yield f"{what}: {'; '.join(lines)}"


def _print_ranking(out: Console, ranking: "Ranking") -> None:
    """New methods among the others: over all environments, and in each."""
    tasks, beside = ranking.tasks, ranked.beside(ranking)
    print_over_tasks(out, tasks, beside, [title_of(name) for name in ranking.new])
    for name in ranking.new:
        out.print(f"[bold]{escape(title_of(name))}[/]")
        rows = ranked.rows(ranking, name)
        print_fitting(
            out, lambda shown, rows=rows: _plain_table(ranked.HEAD, rows, shown), ranked.HEAD, (2, 6)
        )
    for line in ranked.notes(ranking):
        out.print(line, markup=False)


def _plain_table(names: list[str], rows: list[list[str]], shown: list[int]) -> Table:
    table = Table(*(names[i] for i in shown))
    for column in table.columns[1:]:
        column.justify = "right"
    for row in rows:
        table.add_row(*(escape(row[i]) for i in shown))
    return table


def _print_table(out: Console, names: list[str], rows: list[Compared]) -> None:
    print_fitting(out, lambda shown: _table(names, rows, shown), names, NARROW)


def _table(names: list[str], every: list[Compared], shown: list[int]) -> Table:
    rows = every
    if len(every) > ROWS:
        rows = sorted(every, key=lambda row: row.verdict == "same")[:ROWS]
    table, digits = Table(*(names[i] for i in shown)), decimals(rows)
    for column in table.columns[2:-1]:
        column.justify = "right"
    for row in rows:
        *texts, verdict = map(escape, cells(row, digits))
        style = STYLES.get(row.verdict)
        texts.append(f"[{style}]{verdict}[/]" if style else verdict)
        table.add_row(*(texts[i] for i in shown))
    if more := len(every) - len(rows):
        table.caption = f"and {more} more: --json prints them all"
    return table


def _first_places(other: Beside) -> Iterator[str]:
    """Where the runs of each method begin to differ; of its first setting in which they do."""
    told = set()
    for row in other.rows:
        if (place := where(row)) and row.name not in told:
            told.add(row.name)
            yield f"{title_of_part(row.name)} differs {place}."
