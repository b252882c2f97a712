"""`jaxrl-tab list`: the environments and the methods, with their parameters."""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from jaxrl_tab.algorithms import ALGORITHMS
from jaxrl_tab.algorithms.prediction import PREDICTION
from jaxrl_tab.cli.common import HYPERPARAMETERS
from jaxrl_tab.cli.options import about, option_of, parameters, parse, words
from jaxrl_tab.cli.screen import console, print_json
from jaxrl_tab.core import describe, names
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.engine.results import label
from jaxrl_tab.envs import ENVS
from jaxrl_tab.figures import FIGURES


@checked_dataclass
class List:
    """The environments and the methods, with their parameters, defaults, and one line each; the figures.

    Examples:
      jaxrl-tab list
      jaxrl-tab list --json

    Attributes:
        json: Print JSON.
    """

    json: bool = False


def list_command(argv: list[str]) -> int:
    options, _ = parse(List, argv)
    complaints = [line for kind in names.KINDS for line in names.add_entry_points(kind)]
    registries = {"environments": ENVS, "methods": ALGORITHMS, "prediction": PREDICTION}
    figures = {name: f"{figure.title} ({figure.source})" for name, figure in FIGURES.items()}
    if options.json:
        facts = {kind: {name: _facts(cls) for name, cls in r.items()} for kind, r in registries.items()}
        print_json(facts | {"figures": {name: {"summary": text} for name, text in figures.items()}})
        return 0
    out = console()
    headings = {
        "environments": "environments",
        "methods": "methods of control",
        "prediction": "methods of prediction, of the policy in which all actions are equally likely",
    }
    for kind, registry in registries.items():
        out.print(f"[bold]{headings[kind]}[/]")
        if shared := _shared(registry):
            out.print("\n  unless said otherwise, all have")
            out.print(_parameter_table(shared))
        for name, cls in registry.items():
            out.print(f"\n  [bold cyan]{name}[/]  {escape(describe.summary(cls))}")
            if own := [p for p in parameters(cls) if p not in shared]:
                out.print(_parameter_table(own))
        out.print()
    out.print(escape(about(HYPERPARAMETERS)), "\n", soft_wrap=True)
    out.print("[bold]figures[/]\n")
    for name, title in figures.items():
        out.print(f"  [bold cyan]{name}[/]  {escape(title)}")
    for complaint in complaints:
        out.print(escape(f"\nnot available: {complaint}"), soft_wrap=True)
    return 0


def _shared(registry: Mapping[str, type]) -> list[describe.Parameter]:
    """The parameters that all entries have, in the form that most of them have."""
    everywhere = [parameters(cls) for cls in registry.values()]
    names = [{p.name for p in ps} for ps in everywhere]
    counts = Counter(p for ps in everywhere for p in ps)
    return [
        p for p, n in counts.items() if 2 * n > len(registry) and all(p.name in of_one for of_one in names)
    ]


def _parameter_table(shown: Sequence[describe.Parameter]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for p in shown:
        table.add_row(f"    [green]{option_of(p)}[/]", escape(words(p.default)), escape(p.help))
    return table


def _facts(cls: type) -> dict[str, Any]:
    default = lambda p: None if p.default is dataclasses.MISSING else label(p.default)
    facts = {p.name: {"default": default(p), "help": p.help} for p in describe.parameters(cls)}
    return {"summary": describe.summary(cls), "parameters": facts}
