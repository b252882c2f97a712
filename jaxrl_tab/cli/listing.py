"""`jaxrl-tab list`: the environments and the methods, with their parameters and their backup diagrams."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.catalogue import Catalogue, everything, of_own
from jaxrl_tab.cli.options import Command, Entry, Option, Place, parse
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.errors import InputError, nearest, shown
from jaxrl_tab.core.modules import is_table

HEADINGS = {
    "environments": "environments",
    "methods": "methods of control",
    "prediction": "methods of prediction, of the policy in which all actions are equally likely",
}
METHODS = ("methods", "prediction")
CONTINUING = (
    "\nTasks that are continuing have no end: take a gamma below 1, or a method of the average reward."
)
HORIZON = "\nfinite-horizon:20:NAME is any of them that ends after 20 steps, or as many as it says."


LIST = Command(
    "list",
    """\
The environments and the methods, with their parameters, defaults, and one line each; the figures.

Of those that are named, also the backup diagram of a method: what its update looks ahead to. Open circles are states,
solid ones are actions, a square is the end of an episode; an arc is a maximum.

Examples:
  jaxrl-tab list
  jaxrl-tab list q-learning
  jaxrl-tab list --backups
  jaxrl-tab list --backups sarsa n-step-sarsa mine.py:MyMethod --out runs/backups
  jaxrl-tab list --json""",
    places=(
        Place(
            "names",
            "[NAME ...]",
            "Those to tell of, one's own included: mine.py:MyMethod. All, if none.",
            True,
        ),
    ),
    options=(
        Option("--backups", "backups", "The backup diagrams of the methods, and no more.", metavar=""),
        Option(
            "--out", "out", "With --backups: new folder for them as a picture (PNG and SVG).", metavar="DIR"
        ),
        Option("--json", "json", "Print JSON.", metavar=""),
    ),
)


def list_command(argv: list[str]) -> int:
    places, typed = parse(LIST, argv, {})
    names, options = places.get("names", ()), typed["options"]
    if "--out" in options and "--backups" not in options:
        raise InputError("--out goes with --backups: it is for their picture")
    catalogue = _of(names) if names else everything()
    if "--backups" in options:
        return _backups(catalogue, names, options)
    if "--json" in options:
        print_json(
            catalogue.facts | {"figures": {name: {"summary": x} for name, x in catalogue.figures.items()}}
        )
        return 0
    out = console()
    for kind, heading, entries in _alike(catalogue.listed):
        out.print(f"[bold]{heading}[/]")
        if shared := _shared(entries) if len(entries) > 1 else []:
            out.print("\n  unless said otherwise, all have")
            out.print(_table(shared))
        for name, entry in entries.items():
            ends = "" if "continuing" not in catalogue.facts[kind][name] else " (continuing)"
            out.print(f"\n  [bold cyan]{escape(name)}[/]  {escape(entry.summary)}{ends}")
            if names and (backup := _backup(catalogue.facts[kind][name])):
                _print_backup(out, backup, "    ")
            if own := [option for option in entry.options if _key(option) not in map(_key, shared)]:
                out.print(_table(own))
            if without := [x.flag for x in shared if x.name not in {option.name for option in entry.options}]:
                out.print(f"    without {', '.join(without)}")
        if any("continuing" in facts for facts in catalogue.facts[kind].values()):
            out.print(CONTINUING, soft_wrap=True)
        if kind == "environments" and not names:
            out.print(HORIZON, highlight=False, soft_wrap=True)
        out.print()
    if not names:
        out.print(escape(catalogue.groups["methods"].help), "\n", soft_wrap=True)
    if catalogue.figures:
        out.print("[bold]figures[/]\n")
    for name, title in catalogue.figures.items():
        out.print(f"  [bold cyan]{name}[/]  {escape(title)}")
    for complaint in catalogue.unavailable:
        out.print(escape(f"\nnot available: {complaint}"), soft_wrap=True)
    return 0


def _of(names: Sequence[str]) -> Catalogue:
    """What there is to know of these names alone, in their order. Raises InputError where one stands for nothing."""
    parts = [everything()]
    known = {*parts[0].figures, *(name for of_kind in parts[0].listed.values() for name in of_kind)}
    for name in names:
        if ":" in name or name.endswith(".py") or is_table(name):
            parts.append(of_own(name))
        elif name not in known:
            hint = nearest(name, sorted(known), otherwise="`jaxrl-tab list` shows what there is")
            raise InputError(f"{shown(name)} is not an environment, a method or a figure; {hint}")

    def chosen(of_kind: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        return {name: one[name] for name in names for one in of_kind if name in one}

    kinds = {kind: [part for part in parts if kind in part.listed] for kind in HEADINGS}
    listed = {kind: chosen([part.listed[kind] for part in there]) for kind, there in kinds.items()}
    facts = {kind: chosen([part.facts[kind] for part in there]) for kind, there in kinds.items()}
    some = lambda by_kind: {kind: entries for kind, entries in by_kind.items() if entries}
    figures = chosen([parts[0].figures])
    return parts[0]._replace(listed=some(listed), facts=some(facts), figures=figures, unavailable=())


# --- backup diagrams -----------------------------------------------------------------------------------
def _backups(catalogue: Catalogue, names: Sequence[str], options: Mapping[str, tuple[str, ...]]) -> int:
    """Shows the diagrams of the methods in the catalogue."""
    facts = {name: x for kind in METHODS for name, x in catalogue.facts.get(kind, {}).items()}
    for name in names:
        if name not in facts:
            raise InputError(f"{name} is no method, and only methods have a backup diagram")
    drawn = {name: backup for name, x in facts.items() if (backup := _backup(x))}
    if "--out" in options:
        _draw(drawn, Path(options["--out"][0]))
    if "--json" in options:
        print_json(
            {
                name: x["backup"] | {"diagram": drawn[name].diagram()}
                for name, x in facts.items()
                if name in drawn
            }
        )
        return 0
    out = console()
    for name, of_one in facts.items():
        out.print(f"[bold cyan]{escape(name)}[/]  {escape(of_one['summary'])}")
        if name in drawn:
            _print_backup(out, drawn[name], "  ")
        else:
            out.print("  It declares no backup diagram.\n")
    if "--out" in options:
        from jaxrl_tab.cli.screen import say_where  # which imports what takes long

        say_where(Path(options["--out"][0]))
    return 0


def _backup(facts: Mapping) -> Backup | None:
    return Backup(**facts["backup"]) if "backup" in facts else None


def _print_backup(out: Console, backup: Backup, indent: str) -> None:
    lines = ["", *str(backup).splitlines(), ""]
    out.print("\n".join(indent + line if line else "" for line in lines), markup=False, soft_wrap=True)


def _draw(drawn: Mapping[str, Backup], folder: Path) -> None:
    """The diagrams as a picture, in two formats, in a new folder."""
    from jaxrl_tab.cli.common import new_folder
    from jaxrl_tab.show import plot
    from jaxrl_tab.show.words import title_of

    with new_folder(folder) as new:
        assert new
        figure = plot.backups({title_of(name): backup for name, backup in drawn.items()})
        for ending in ("png", "svg"):
            plot.save(figure, new / f"backups.{ending}")


def _alike(listed: Mapping[str, Mapping[str, Entry]]) -> Iterator[tuple[str, str, Mapping[str, Entry]]]:
    """The kind, the heading and the entries of what is listed; methods that learn preferences have one of their own."""
    for kind, entries in listed.items():
        of_policy = {
            name: x for name, x in entries.items() if any(option.name == "theta0" for option in x.options)
        }
        if others := {name: x for name, x in entries.items() if name not in of_policy}:
            yield kind, HEADINGS[kind], others
        if of_policy:
            yield kind, f"{HEADINGS[kind]} that learn a policy itself", of_policy


def _shared(entries: Mapping[str, Entry]) -> list[Option]:
    """The options that all entries have, or nearly all, in the form that most of them have."""
    names = Counter(option.name for entry in entries.values() for option in entry.options)
    counts = Counter(_key(option) for entry in entries.values() for option in entry.options)
    options = {_key(option): option for entry in entries.values() for option in entry.options}
    return [
        options[key]
        for key, n in counts.items()
        if 2 * n > len(entries) and 4 * names[options[key].name] > 3 * len(entries)
    ]


def _key(option: Option) -> tuple[str, str, str]:
    return option.flag, option.default, option.help


def _table(shown: Iterable[Option]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for option in shown:
        table.add_row(f"    [green]{option.flag}[/]", escape(option.default), escape(option.help))
    return table
