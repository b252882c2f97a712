"""`jaxrl-tab explain`: where the methods of a finished sweep lose."""

from pathlib import Path

from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.common import new_folder, prepare, start_jax
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import parse, word
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.experiment import runner
from jaxrl_tab.show.explained import HEAD, PLACES, Explanation, places_rows


@checked_dataclass
class Explain:
    """Where the methods of a sweep lose what they earn less than the best policy.

    Of each method, at its best setting, after all that its runs have learned: v* - v_pi from the start, exactly, as a
    sum over the states of how often the policy is there times how much its actions there lose. That is told of the
    policy that acts, and what of it is lost by exploring; and of the greedy policy.

    Examples:
      jaxrl-tab explain runs/cliff
      jaxrl-tab explain runs/cliff --out runs/cliff-explained
      jaxrl-tab explain runs/cliff --json

    Attributes:
        folder: The folder of the sweep: what --out named.
        out: New folder for a heat map of each method (PNG).
        json: Print JSON: all numbers, of all states in which anything is lost.
    """

    folder: str = word("DIR")
    out: Path | None = None
    json: bool = False


def explain_command(argv: list[str]) -> int:
    prepare()
    options, _ = parse(Explain, argv)
    if not options.folder:
        raise InputError("name the folder of a sweep")
    start_jax()
    with new_folder(options.out) as folder, busy("explaining"):
        explanation = runner.explain(options.folder)
        if folder:
            explanation.save(folder)
    if options.json:
        methods = [one.to_dict() for one in explanation.values()]
        print_json({"folder": options.folder, "methods": methods, "left_out": explanation.left_out})
        return 0
    _print(explanation)
    if options.out:
        say_where(options.out)
    return 0


def _print(explanation: Explanation) -> None:
    out = console()
    if explanation:
        summary = Table(*HEAD)
        for column in summary.columns[2:]:
            column.justify = "right"
        for one in explanation.values():
            summary.add_row(*map(escape, one.row()))
        print_table(out, summary)
    for one in explanation.values():
        out.print(
            f"\n[bold]{escape(f'{one.name} in {one.environment}')}[/]: {escape(' '.join(one.sentences))}"
        )
        if places := one.places(one.main):
            table = Table(*PLACES)
            for column in table.columns[1:-1]:
                column.justify = "right"
            for row in places_rows(places):
                table.add_row(*map(escape, row))
            if more := len(places) - len(table.rows):
                table.caption = f"and {more} more states: --json prints them all"
            print_table(out, table)
    for line in explanation.left_out:
        out.print(line, markup=False)
