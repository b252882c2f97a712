"""`jaxrl-tab figure`: published figures again, and their numbers checked."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.common import new_folder, prepare, start_jax
from jaxrl_tab.cli.options import checked_name
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import PROG, console, print_json
from jaxrl_tab.cli.typed import parse, word
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.netcdf import save
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.core.version import __version__
from jaxrl_tab.experiment import storage
from jaxrl_tab.figures import FIGURES, Check
from jaxrl_tab.figures import Figure as PublishedFigure
from jaxrl_tab.figures.page import cells, differing, page
from jaxrl_tab.show.progress import reporting

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.figures.figure import Run


def make_runs(
    runs: "Mapping[str, Run]", folder: Path | None, command: Sequence[str], quiet: bool, within: str = ""
) -> "dict[str, xr.Dataset]":
    """Makes one run after another, with a bar for each, and saves the data of each when it is done.

    In the file and on the screen its name is that in `runs` after `within`.
    """
    import xarray  # noqa: F401  Now, because later a Ctrl-C in the second that it takes would lose a run's data.

    about = {"command": shlex.join([PROG, *command]), "version": __version__}
    datasets = {}
    for name, run in runs.items():
        group = within + name
        with reporting(False if quiet else None) as report:
            datasets[name] = run(lambda state, group=group: report(state._replace(label=group)))
        if folder:
            save(datasets[name], group, folder / storage.DATA, about)
    return datasets


@checked_dataclass
class Figure:
    """Runs the setting of a published figure again, draws it, and checks its numbers; or of all figures.

    Prints what was got beside what is expected, from enumeration or from long simulations with plain loops, and what
    the source printed, where that does not come out as well. With --all, a table of all figures is the end. The exit
    code is 1 if any number is off what is expected by more than four standard errors.

    Examples:
      jaxrl-tab figure windy-gridworld --out runs/windy-figure
      jaxrl-tab figure cliff-walking --json
      jaxrl-tab figure --all --out runs/figures

    Attributes:
        name: Name of the figure; see `jaxrl-tab list`.
        all: Make all figures; with --out, also index.html, which shows them.
        out: New folder for the picture, as PNG and as PDF, and the data.
        json: Print the numbers as JSON.
        quiet: Show no progress.
    """

    name: str = word("NAME")
    all: bool = False
    out: Path | None = None
    json: bool = False
    quiet: bool = False


def figure_command(argv: list[str]) -> int:
    prepare()
    options, _ = parse(Figure, argv)
    if options.all and options.name:
        raise InputError("name a figure or give --all, not both")
    names = tuple(FIGURES) if options.all else (checked_name("a figure", options.name, FIGURES),)
    start_jax()
    checked, groups = {}, []
    with new_folder(options.out) as folder:
        for name in names:
            figure = FIGURES[name]
            within = f"{name}/" if options.all else ""
            datasets = make_runs(figure.experiment(), folder, ["figure", *argv], options.quiet, within)
            groups += [within + run for run in datasets]
            with busy(f"{name}: numbers and picture", options.quiet):
                checked[name] = figure, [number.check(datasets) for number in figure.numbers]
                if folder:
                    _draw_figure(figure, datasets, folder / name)
            if not options.json:
                print_table(console(), _check_table(*checked[name]))
                console().print(escape(figure.shows), "", sep="\n")
        if folder and options.all:
            (folder / "index.html").write_text(page(checked, __version__), encoding="utf-8")

    if options.all and not options.json:
        for part in _all_tables(checked):
            if isinstance(part, str):
                console().print(part)
            else:
                print_table(console(), part)
    if options.json:
        results = [
            {"figure": name, "numbers": [_as_json(check) for check in checks]}
            for name, (_, checks) in checked.items()
        ]
        print_json({"figures": results} if options.all else results[0])
    elif options.out:
        say_where(options.out, groups[0])
    return 0 if all(c.ok for _, checks in checked.values() for c in checks) else 1


def _as_json(check: Check) -> dict[str, Any]:
    return check._asdict() | {"ok": check.ok, "reproduces": check.reproduces}


def _draw_figure(figure: PublishedFigure, datasets: "Mapping[str, xr.Dataset]", file: Path) -> None:
    """As PNG, to look at, and as PDF, which is sharp at any size."""
    from jaxrl_tab.show import plot

    picture = figure.draw(datasets)
    for ending in (".png", ".pdf"):
        plot.save(picture, file.with_suffix(ending))


def _check_table(figure: PublishedFigure, checks: Sequence[Check]) -> Table:
    title = escape(f"{figure.title} ({figure.source})")
    caption = "expected: from long simulations with plain loops; what is exact, from enumeration"
    printed = any(check.published for check in checks)
    columns = ("number", *(["published"] if printed else []), "got", "± SE", "expected", "± SE", "SEs apart")
    table = Table(*columns, title=title, caption=caption)
    for check in checks:
        what, published, *row, apart = map(escape, cells(check))
        published = f"[yellow]{published}[/]" if check.reproduces is False else published
        apart = apart if check.ok else f"[bold red]{apart}, off[/]"
        table.add_row(what, *([published] if printed else []), *row, apart)
    return table


def _all_tables(checked: Mapping[str, tuple[PublishedFigure, Sequence[Check]]]) -> Iterator[Table | str]:
    """What all figures came to: of each how many numbers are right; what was published and does not come out."""
    table = Table("figure", "source", "numbers", "published", title="All figures")
    for name, (figure, checks) in checked.items():
        right, count = _counted([check.ok for check in checks])
        published = [check.reproduces for check in checks if check.published]
        row = (escape(name), escape(figure.source), f"{right} of {count}")
        table.add_row(*row, "{} of {}".format(*_counted(published)) if published else "")
    table.caption = "numbers: as expected; published: those that the source prints, which come out"
    yield table
    if not (differ := differing(checked)):
        yield "All numbers that the sources print come out."
        return
    table = Table("figure", "number", "published", "here", "± SE", title="Published, and does not come out")
    for name, check in differ:
        what, published, got, error, *_ = cells(check)
        table.add_row(*map(escape, (name, what, published, got, error)))
    yield table


def _counted(good: Sequence[bool | None]) -> tuple[int, int]:
    return sum(map(bool, good)), len(good)
