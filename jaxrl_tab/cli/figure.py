"""`jaxrl-tab figure`: published figures again, and their numbers checked."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.common import new_folder, prepare, start_jax
from jaxrl_tab.cli.options import checked_name
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import PROG, console, print_json
from jaxrl_tab.cli.typed import parse, word
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.core.version import __version__
from jaxrl_tab.engine.results import save
from jaxrl_tab.experiment import storage
from jaxrl_tab.figures import FIGURES, Check
from jaxrl_tab.figures import Figure as PublishedFigure
from jaxrl_tab.figures.page import cells, page
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

    Prints what was got beside what is expected: from enumeration, or from long simulations with plain loops.
    The exit code is 1 if any number is off by more than four standard errors.

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
                console().print(_check_table(*checked[name]), escape(figure.shows), "", sep="\n")
        if folder and options.all:
            (folder / "index.html").write_text(page(checked, __version__), encoding="utf-8")

    if options.json:
        results = [
            {"figure": name, "numbers": [c._asdict() | {"ok": c.ok} for c in checks]}
            for name, (_, checks) in checked.items()
        ]
        print_json({"figures": results} if options.all else results[0])
    elif options.out:
        say_where(options.out, groups[0])
    return 0 if all(c.ok for _, checks in checked.values() for c in checks) else 1


def _draw_figure(figure: PublishedFigure, datasets: "Mapping[str, xr.Dataset]", file: Path) -> None:
    """As PNG, to look at, and as PDF, which is sharp at any size."""
    from jaxrl_tab.show import plot

    picture = figure.draw(datasets)
    for ending in (".png", ".pdf"):
        plot.save(picture, file.with_suffix(ending))


def _check_table(figure: PublishedFigure, checks: Sequence[Check]) -> Table:
    title = escape(f"{figure.title} ({figure.source})")
    caption = "expected: from long simulations with plain loops; what is exact, from enumeration"
    table = Table("number", "got", "± SE", "expected", "± SE", "SEs apart", title=title, caption=caption)
    for check in checks:
        *row, apart = map(escape, cells(check))
        table.add_row(*row, apart if check.ok else f"[bold red]{apart}, off[/]")
    return table
