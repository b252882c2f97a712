"""What commands print: tables, JSON, where files are, and that something is under way."""

import contextlib
import json as jsonlib
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import words
from jaxrl_tab.experiment import files, storage
from jaxrl_tab.show.words import cell, decimals_for, edge_warning, six_digits, symbol, title_of

if TYPE_CHECKING:
    import pandas as pd

    from jaxrl_tab.stats.column import Column
    from jaxrl_tab.stats.columns import Methods, Row
PATIENCE = 2.0  # seconds of silence, at most


def show_outcome(outcome: files.Outcome, folder: Path | None, options: Any) -> None:
    """Prints what came out: tables for people, or JSON."""
    if options.json:
        summary = {"folder": folder and str(folder), "summary": _records(outcome.summary)}
        chosen = {"selection": _records(outcome.selection)} if outcome.fresh else {}
        print_json(summary | chosen)
        return
    if options.quiet:
        return
    for environment, methods in outcome.methods.items():
        with busy("summing up"):
            _work_out(methods)
        print_summary(environment, methods)
    if outcome.fresh:
        _print_selection(outcome.selection)
    if diverged := sum(int(ds.diverged.sum()) for ds in outcome.datasets.values()):
        runs = sum(ds.diverged.size for ds in outcome.datasets.values())
        why = "a number became infinite, or NaN, or grew beyond any possible return."
        console().print(f"{diverged} of {runs} runs diverged: {why}")


def _records(table: "pd.DataFrame") -> Any:
    return jsonlib.loads(str(table.to_json(orient="records")))


def _print_selection(table: "pd.DataFrame") -> None:
    """The settings that were chosen, with what they gave on the seeds of the choice and on fresh ones."""
    columns = list(table.columns)
    hyperparameters = columns[2 : columns.index("chosen_score")]
    scores = ["on the seeds\nof the choice", "95% interval", "on fresh\nseeds", "95% interval"]
    several = len(set(table["environment"])) > 1
    view = Table(*(["environment"] if several else []), "method", "chosen\nsetting", *scores)
    for column in view.columns[-4:]:
        column.justify = "right"
    for row in table.to_dict("records"):
        # NaN, which is not equal to itself, stands where a method does not have the hyperparameter.
        setting = [f"{h} {words(row[h])}" for h in hyperparameters if row[h] == row[h]]
        cells = []
        for kind in ("chosen", "fresh"):
            mean, low, high = (row[f"{kind}_{what}"] for what in ("score", "low", "high"))
            digits = f"{{:.{decimals_for(np.array([(high - low) / 2]), 2)}f}}".format
            cells += [cell(mean, digits), _interval(low, high, digits)]
        names = (row["environment"], row["method"]) if several else (row["method"],)
        view.add_row(*names, ", ".join(setting) or "–", *cells)
    out = console()
    out.print(view)
    out.print("The choice flatters the first number: report the second.")


def _work_out(methods: "Methods") -> None:
    """What `print_summary` shows, now; it is kept. What only files tell is left for later."""
    from jaxrl_tab.stats.columns import COLUMNS

    shown = [column.name for column in COLUMNS if column.screen]
    for own in methods.settings.values():
        for name in (*shown, "best", "tied", "seeds", "seeds_wanted"):
            own.numbers(name)


def print_summary(environment: str, methods: "Methods") -> None:
    """The summary for people: what all rows share stands above the table, what the marks mean below it."""
    from jaxrl_tab import stats
    from jaxrl_tab.stats.column import text
    from jaxrl_tab.stats.columns import COLUMNS

    rows, prediction, ds = methods.rows, methods.prediction, next(iter(methods.values()))
    setting_of = lambda row: row.setting | row.place
    tried = {
        name: dict.fromkeys(words(setting_of(row)[name]) for row in rows if name in setting_of(row))
        for name in methods.hyperparameters
    }
    shared = [f"{name} {next(iter(values))}" for name, values in tried.items() if len(values) == 1]
    varied = [name for name, values in tried.items() if len(values) > 1]
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    length = f"{ds.attrs[f'num_{unit}']} {unit}"
    columns = {column.name: column for column in COLUMNS if column.screen and column.tells(rows)}
    view = Table("method", *varied)
    for name, column in columns.items():
        view.add_column(text(column.screen, prediction))
        if isinstance(rows[0][name], tuple):
            view.add_column("95% interval\nof the mean" if name == "score" else "95% interval")
    for column in view.columns[1:]:
        column.justify = "right"
    # Two digits of the narrowest interval; of errors also three of the smallest.
    scores, low, high = np.array([row["score"] for row in rows]).T
    decimals = decimals_for((high - low) / 2, 2)
    if prediction:
        decimals = max(decimals, decimals_for(scores, 3))
    digits = f"{{:.{decimals}f}}".format
    notes, edges = [], []
    for method, own in methods.settings.items():
        own_rows = [row for row in rows if row.method == method]
        choice = _several(own_rows)
        for row in own_rows:
            star = choice and row["best"]
            cells = {name: _cells(column, row[name], digits) for name, column in columns.items()}
            cells["score"][1] += " !" if row.doubtful else ""
            view.add_row(
                f"{method}{' *' if star else ' ~' if choice and row['tied'] else ''}",
                *(cell(setting_of(row).get(name, np.nan), words) for name in varied),
                *(part for parts in cells.values() for part in parts),
                style="bold" if star else None,
            )
            if row.doubtful and row["best"]:
                ends = [
                    f"the {kind} is {cell(x[0], digits)} ({_interval(x[1], x[2], digits)})"
                    for kind, x in (("median", row["median"]), ("interquartile mean", row["iqm"]))
                ]
                needed = f"{row['seeds_wanted']} seeds would be needed to trust the mean"
                notes.append(f"! {title_of(method)}: {', '.join(ends)}; {needed}.")
        view.add_section()
        edges += [edge_warning(name, method, end) for name, end in own.edges.items() if choice]
    out = console()
    out.print(", ".join([f"[bold]{environment}[/]", *shared, f"{ds.sizes['seed']} seeds, {length} each"]))
    out.print(view)
    say = lambda line: out.print(line, markup=False)
    if prediction:
        say("The RMS error is that of V, over the states: its mean over the rows of the log, and at the end.")
    if varied and _several(rows):
        say(
            "* This setting is the best of its method on these seeds. It was chosen for its mean, which flatters it."
        )
        if any(row["tied"] and not row["best"] for row in rows):
            say(
                "~ This setting is not told apart from the best: these seeds do not say which of the two is better."
            )
    if "unfinished" in columns:
        say(
            "The unfinished runs end no episode in the last tenth: they score the rewards that they collected there, "
            "as if cut off."
        )
    if any(row.doubtful for row in rows):
        seeds = ds.sizes["seed"]
        say(
            "! This mean rests on few bad runs, and may be worse than it looks: "
            f"{stats.unseen(seeds)} stuck, which {seeds} seeds need not show."
        )
    for line in [*notes, *edges]:
        say(line)
    for name, value in _soft_optima(methods).items():
        say(f"With {name}, no policy that goes on exploring is worth more than {six_digits(value)}.")
    if "greedy_value" in columns:
        say(
            "The worth of a policy is its exact value at the end, without luck and without a time limit, the median "
            "over seeds; -inf: it goes round for ever."
        )


def _several(rows: "Sequence[Row]") -> bool:
    """Whether not all have the same score."""
    return len(np.unique([row["score"][0] for row in rows])) > 1


def _cells(column: "Column", x: Any, digits: Any) -> list[str]:
    """A number as it stands on the screen; of an interval the estimate, and the bounds."""
    if isinstance(x, tuple):
        return [cell(x[0], digits), _interval(x[1], x[2], digits)]
    write = {"exact": six_digits, "count": str, "share": "{:.0%}".format, "tenths": "{:.1f}".format}.get(
        column.written, digits
    )
    return [cell(x * column.scale, write)]


def _soft_optima(methods: "Methods") -> dict[str, float]:
    """What the best policy earns that explores as the best settings do: "ε = 0.1" -> value."""
    optima = {}
    for own in methods.settings.values():
        name = " and ".join(f"{symbol(key)} = {words(value)}" for key, value in own.exploration.items())
        optima[name] = own.soft
    return {name: value for name, value in optima.items() if not np.isnan(value)}


def _interval(low: float, high: float, digits: Any) -> str:
    return cell(low, lambda _: f"{digits(low)} to {digits(high)}")


def say_where(folder: Path, group: str | None = None) -> None:
    out = console()
    files = ", ".join(sorted(file.name for file in folder.iterdir() if not file.name.startswith(".")))
    out.print(f"[bold]{escape(str(folder))}[/]: {files}", soft_wrap=True)
    if group:
        how = f'xarray.open_datatree("{folder / storage.DATA}")["{group}"]'
        out.print(f"Read the data with {how}", markup=False, soft_wrap=True)


@contextlib.contextmanager
def busy(what: str, quiet: bool = False) -> Iterator[None]:
    """A line on the terminal that says `what` is under way, where that lasts longer than `PATIENCE`."""
    stderr = Console(stderr=True)
    if quiet or not stderr.is_terminal:
        yield
        return
    status = stderr.status(what)
    later = threading.Timer(PATIENCE, status.start)
    later.daemon = True
    later.start()
    try:
        yield
    finally:
        later.cancel()
        later.join()
        status.stop()
