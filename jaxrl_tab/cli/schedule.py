"""`jaxrl-tab schedule`: what a step size or an exploration rate comes to."""

from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.common import new_folder, start_jax
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import say_where
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import parse, word
from jaxrl_tab.core import schedules
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.show.rates import COUNTS, MARKS, Study, curve, study


@checked_dataclass
class Schedule:
    """What step sizes and exploration rates come to, and whether they meet the conditions of the theorems.

    Of each: its formula, its values, their sums and those of the squares, a curve, whether it is GLIE as an exploration
    rate (greedy in the limit with infinite exploration), and whether it meets the conditions of Robbins and Monro as a
    step size; and why. Several are shown side by side.

    Examples:
      jaxrl-tab schedule glie
      jaxrl-tab schedule harmonic:100:visit power:0.5:step linear:1:0.05:500:episode 0.1
      jaxrl-tab schedule "optax:cosine_decay_schedule(0.5, 8000)"
      jaxrl-tab schedule glie 0.1 --out runs/schedules

    Attributes:
        schedules: Schedules and numbers, as they are typed for --alpha and --epsilon.
        out: New folder for the curves as a picture (PNG).
        json: Print JSON.
    """

    schedules: tuple[str, ...] = word("SCHEDULE ...", many=True)
    out: Path | None = None
    json: bool = False


def schedule_command(argv: list[str]) -> int:
    options, _ = parse(Schedule, argv)
    if not options.schedules:
        raise InputError(f"name a schedule: {schedules.forms()}")
    if len(options.schedules) > len(MARKS):
        raise InputError(f"at most {len(MARKS)} schedules stand side by side, not {len(options.schedules)}")
    start_jax()  # a schedule of optax is tried when it is read
    rates = [schedules.read(text) for text in options.schedules]
    studies = list({one.name: one for one in map(study, rates)}.values())
    with new_folder(options.out) as folder:
        if folder:
            _draw(studies, folder)
    if options.json:
        print_json({"schedules": list(map(_data, studies))})
        return 0
    _print(studies)
    if options.out:
        say_where(options.out)
    return 0


def _print(studies: list[Study]) -> None:
    out, table = console(), _table(studies)
    if table.__rich_measure__(out, out.options).maximum <= out.width:
        print_table(out, table)
    else:
        for one in studies:
            print_table(out, _upright(one))
    if lines := curve(studies, out.width):
        names = "   ".join(f"{mark} {one.name}" for mark, one in zip(MARKS, studies, strict=False))
        out.print("\n".join(["", *lines, "", f"  {names}"]), markup=False, soft_wrap=True)
    for one in studies:
        out.print(f"\n[bold]{escape(one.title)}[/]", soft_wrap=True)
        out.print(f"  {one.sums}", markup=False, soft_wrap=True)
        for question, told in (("As ε, GLIE", one.glie), ("As α, Robbins and Monro", one.robbins_monro)):
            out.print(f"  {question}: [bold]{told.answer}[/]: {escape(told.why)}.", soft_wrap=True)


def _table(studies: list[Study]) -> Table:
    """A column for each n."""
    table = Table("", "n =", *(f"{n:,}".replace(",", " ") for n in COUNTS))
    for column in table.columns[2:]:
        column.justify = "right"
    for one in studies:
        for number, (what, values) in enumerate(one.rows().items()):
            table.add_row(escape(one.name) if number == 0 else "", what, *(f"{x:.4g}" for x in values))
        table.add_section()
    return table


def _upright(one: Study) -> Table:
    """A row for each n, of one schedule: where a window is narrow."""
    rows = one.rows()
    table = Table("n", *rows, title=escape(one.name))
    for column in table.columns:
        column.justify = "right"
    for n, *values in zip(COUNTS, *rows.values(), strict=True):
        table.add_row(str(n), *(f"{x:.4g}" for x in values))
    return table


def _data(one: Study) -> dict[str, Any]:
    told: Any = lambda x: x._asdict()
    keys = {"value": "values", "sum so far": "sums", "sum of squares so far": "sums_of_squares"}
    return {
        "schedule": one.name,
        "formula": one.formula,
        "clock": one.clock,
        "n": list(COUNTS),
        **{keys[what]: values.tolist() for what, values in one.rows().items()},
        "sum_is_infinite": one.sum_is_infinite,
        "sum_of_squares_is_infinite": one.squares_are_infinite,
        "glie": told(one.glie),
        "robbins_monro": told(one.robbins_monro),
    }


def _draw(studies: list[Study], folder: Path) -> None:
    from jaxrl_tab.show import plot

    plot.save(plot.schedules(studies), folder / "schedules.png")
