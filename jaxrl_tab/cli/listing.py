"""`jaxrl-tab list`: the environments and the methods, with their parameters."""

from collections import Counter
from collections.abc import Mapping, Sequence

from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.catalogue import everything
from jaxrl_tab.cli.options import Command, Entry, Option, parse
from jaxrl_tab.cli.streams import console, print_json

HEADINGS = {
    "environments": "environments",
    "methods": "methods of control",
    "prediction": "methods of prediction, of the policy in which all actions are equally likely",
}


LIST = Command(
    "list",
    """\
The environments and the methods, with their parameters, defaults, and one line each; the figures.

Examples:
  jaxrl-tab list
  jaxrl-tab list --json""",
    places=(),
    options=(Option("--json", "json", "Print JSON.", metavar=""),),
)


def list_command(argv: list[str]) -> int:
    _, typed = parse(LIST, argv, {})
    catalogue = everything()
    if "--json" in typed["options"]:
        print_json(
            catalogue.facts | {"figures": {name: {"summary": x} for name, x in catalogue.figures.items()}}
        )
        return 0
    out = console()
    for kind, entries in catalogue.listed.items():
        out.print(f"[bold]{HEADINGS[kind]}[/]")
        if shared := _shared(entries):
            out.print("\n  unless said otherwise, all have")
            out.print(_table(shared))
        for name, entry in entries.items():
            out.print(f"\n  [bold cyan]{name}[/]  {escape(entry.summary)}")
            if own := [option for option in entry.options if _key(option) not in map(_key, shared)]:
                out.print(_table(own))
        out.print()
    out.print(escape(catalogue.groups["methods"].help), "\n", soft_wrap=True)
    out.print("[bold]figures[/]\n")
    for name, title in catalogue.figures.items():
        out.print(f"  [bold cyan]{name}[/]  {escape(title)}")
    for complaint in catalogue.unavailable:
        out.print(escape(f"\nnot available: {complaint}"), soft_wrap=True)
    return 0


def _shared(entries: Mapping[str, Entry]) -> list[Option]:
    """The options that all entries have, in the form that most of them have."""
    names = [{option.name for option in entry.options} for entry in entries.values()]
    counts = Counter(_key(option) for entry in entries.values() for option in entry.options)
    options = {_key(option): option for entry in entries.values() for option in entry.options}
    return [
        options[key]
        for key, n in counts.items()
        if 2 * n > len(entries) and all(options[key].name in of_one for of_one in names)
    ]


def _key(option: Option) -> tuple[str, str, str]:
    return option.flag, option.default, option.help


def _table(shown: Sequence[Option]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for option in shown:
        table.add_row(f"    [green]{option.flag}[/]", escape(option.default), escape(option.help))
    return table
