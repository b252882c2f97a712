"""What commands print: tables, JSON, where files are, and that something is under way."""

import contextlib
import json as jsonlib
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.fitting import print_over_tasks
from jaxrl_tab.cli.options import NONE
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import words
from jaxrl_tab.experiment import files, storage
from jaxrl_tab.show import searched
from jaxrl_tab.show.words import (
    DOES_NOT_END,
    cell,
    deadly_triads,
    decimals_for,
    edge_warning,
    six_digits,
    steps_in_words,
    symbol,
    title_of,
    worth,
)

if TYPE_CHECKING:
    import pandas as pd

    from jaxrl_tab.stats.column import Column
    from jaxrl_tab.stats.columns import Methods, Row
    from jaxrl_tab.stats.deciding import Verdict

MOST_ROWS = 100  # of a table for people: of more settings only the best of each method is shown
MOST_CHOSEN = 40  # of the settings that were chosen; of more only the best
PATIENCE = 2.0  # seconds of silence, at most
# Where a window is too narrow, these columns go, one after another, until the others fit.
FIRST_TO_GO = (
    "episodes_within_steps",
    "unfinished",
    "late_steps",
    "early_score",
    "final_v_error",
    "optimum",
    "greedy_arrives",
)
WRITTEN: dict[str, Any] = {
    "exact": six_digits,
    "worth": partial(worth, write=six_digits),
    "count": str,
    "steps": steps_in_words,
    "share": "{:.0%}".format,
    "tenths": "{:.1f}".format,
}


def show_outcome(outcome: files.Outcome, folder: Path | None, options: Any) -> None:
    """Prints what came out: tables for people, or JSON."""
    if options.json:
        summary = {"folder": folder and str(folder), "summary": _records(outcome.summary)}
        chosen = {"selection": _records(outcome.selection)} if outcome.fresh else {}
        decided = {"verdicts": _verdicts(outcome)} if outcome.verdicts else {}
        searched = {"search": _records(outcome.search)} if outcome.tried else {}
        print_json(searched | summary | chosen | decided | _tasks_as_json(outcome))
        return
    if options.quiet:
        return
    if outcome.tried:
        _print_search(outcome)
    for environment, methods in outcome.methods.items():
        with busy("summing up"):
            _work_out(methods)
        print_summary(environment, methods)
    if len(outcome.envs) > 1:
        _print_tasks(outcome)
    if outcome.fresh:
        _print_selection(outcome, folder)
    for environment, verdict in outcome.verdicts.items():
        _print_verdict(environment, verdict, _digits(outcome.fresh_methods[environment]))
    if diverged := sum(int(ds.diverged.sum()) for ds in outcome.datasets.values()):
        runs = sum(ds.diverged.size for ds in outcome.datasets.values())
        why = "a number became infinite, or NaN, or grew beyond any possible return."
        console().print(f"{diverged} of {runs} runs diverged: {why}")
        for methods in outcome.methods.values():
            for line in deadly_triads(methods):
                console().print(line)


def _print_search(outcome: files.Outcome) -> None:
    """What the search tried, rung by rung, and what it found."""
    out, view = console(), Table(*searched.head(outcome.tried))
    for row in searched.rows(outcome.tried):
        view.add_row(*map(escape, row))
    out.print("[bold]search[/]")
    out.print(view)
    for line in searched.notes(outcome.tried):
        out.print(line, markup=False)
    out.print("What was found ran again, on fresh seeds, which had no part in the choice:\n")


def _tasks_as_json(outcome: files.Outcome) -> dict[str, Any]:
    """The methods over all environments, where there are several."""
    if len(outcome.envs) < 2 or (tasks := outcome.tasks) is None:
        return {}
    from jaxrl_tab.show import over_tasks

    return {"over_environments": over_tasks.to_dict(tasks)}


def show_look(environment: str, verdict: "Verdict") -> None:
    """Tells of a look of a comparison that goes on, beside the progress."""
    goes_on = f"; on to {verdict.until} seeds" if verdict.wanted else ""
    print(f"{environment}, {max(verdict.seeds.values())} seeds: {verdict.order}{goes_on}", file=sys.stderr)


def _print_verdict(environment: str, verdict: "Verdict", digits: Any) -> None:
    """What was decided, in a sentence, and what is to be known of it."""
    out = console()
    out.print(f"[bold]{escape(environment)}: {escape(verdict.sentence)}.[/]")
    for note in verdict.notes(digits):
        out.print(note, markup=False)


def _records(table: "pd.DataFrame") -> Any:
    return jsonlib.loads(str(table.to_json(orient="records")))


def _print_tasks(outcome: files.Outcome) -> None:
    """The methods over all environments."""
    from jaxrl_tab.show import over_tasks  # here, for it imports xarray and the statistics

    with busy("summing up"):
        tasks = outcome.tasks
    if tasks is None:
        return
    out = console()
    print_over_tasks(out, tasks)
    for line in over_tasks.notes(tasks, outcome.fresh.keys() == outcome.datasets.keys()):
        out.print(line, markup=False)


def _verdicts(outcome: files.Outcome) -> dict[str, Any]:
    """By the environments: the verdict in a sentence, what is to be known of it, and the pairs."""
    pairs = _records(outcome.verdict)
    return {
        label: {
            "verdict": verdict.sentence,
            "order": list(verdict.names),
            "seeds": dict(verdict.seeds),
            "notes": verdict.notes(),
            "pairs": [pair for pair in pairs if pair["environment"] == label],
        }
        for label, verdict in outcome.verdicts.items()
    }


def _print_selection(outcome: files.Outcome, folder: Path | None) -> None:
    """The settings that were chosen, with what they gave on the seeds of the choice and on fresh ones."""
    every = outcome.selection
    table = _best_of(every, outcome) if len(every) > MOST_CHOSEN else every
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
    print_table(out, view)
    out.print("The choice flatters the first number: report the second.")
    if len(table) < len(every):
        where = "selection.csv, the report and --json have" if folder else "--json has"
        best = "best of each environment is" if several else f"{len(table)} best are"
        out.print(f"Of {len(every)} chosen settings only the {best} shown: {where} all.")


def _best_of(table: "pd.DataFrame", outcome: files.Outcome) -> "pd.DataFrame":
    """The best row of each environment on fresh seeds; the best ones where there is one environment."""
    sign = [-1 if outcome.methods[label].prediction else 1 for label in table["environment"]]
    ranked = table.assign(merit=table["fresh_score"] * sign).sort_values(
        "merit", ascending=False, kind="stable"
    )
    each = 1 if len(outcome.envs) > 1 else MOST_CHOSEN
    return ranked.drop(columns="merit").groupby("environment", sort=False).head(each).sort_index()


def _work_out(methods: "Methods") -> None:
    """What `print_summary` shows, now; it is kept. What only files tell is left for later."""
    from jaxrl_tab.stats.columns import COLUMNS

    shown = [column.name for column in COLUMNS if column.on_screen(methods)]
    for own in methods.settings.values():
        for name in (*shown, "best", "tied", "seeds", "seeds_wanted"):
            own.numbers(name)
    _ = methods.early


def print_summary(environment: str, methods: "Methods") -> None:
    """The summary for people: what all rows share stands above the table, what the marks mean below it."""
    from jaxrl_tab.stats.column import text

    rows, ds = methods.rows, next(iter(methods.values()))
    tried = {
        name: dict.fromkeys(words(_setting_of(row)[name]) for row in rows if name in _setting_of(row))
        for name in methods.hyperparameters
    }
    shared = [
        f"{name} {next(iter(values))}"
        for name, values in tried.items()
        if len(values) == 1 and NONE not in values
    ]
    varied = [name for name, values in tried.items() if len(values) > 1]
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    length = f"{ds.attrs[f'num_{unit}']} {unit}" if "lengths" in ds or unit == "steps" else "one score"
    columns, digits, out = _columns(methods), _digits(methods), console()
    optima = {cell(row["optimum"], six_digits) for row in rows}
    if len(optima) == 1 and "optimum" in columns:
        heading = text(columns.pop("optimum").screen, methods.prediction).replace("\n", " ")
        shared.append(f"{heading} {optima.pop()}")
    out.print(", ".join([f"[bold]{environment}[/]", *shared, f"{ds.sizes['seed']} seeds, {length} each"]))
    view, left_out = _table(methods, varied, columns, digits), []
    for name in FIRST_TO_GO:
        if name in columns and view.__rich_measure__(out, out.options).maximum > out.width:
            left_out.append(text(columns.pop(name).screen, methods.prediction).replace("\n", " "))
            view = _table(methods, varied, columns, digits)
    print_table(out, view)
    if left_out:
        out.print(f"In a wider window the table has: {'; '.join(left_out)}.", markup=False)
    for line in _notes(methods, bool(varied), digits):
        out.print(line, markup=False)


def _setting_of(row: "Row") -> dict[str, Any]:
    return row.setting | row.place


def _columns(methods: "Methods") -> "dict[str, Column]":
    """What the screen shows, by the names of the columns."""
    from jaxrl_tab.stats.columns import COLUMNS

    return {x.name: x for x in COLUMNS if x.on_screen(methods) and x.tells(methods.rows)}


def _digits(methods: "Methods") -> Any:
    """How scores are written: two digits of the narrowest interval; of errors also three of the smallest."""
    scores, low, high = np.array([row["score"] for row in methods.rows]).T
    decimals = decimals_for((high - low) / 2, 2)
    if methods.prediction:
        decimals = max(decimals, decimals_for(scores, 3))
    return f"{{:.{decimals}f}}".format


def _table(methods: "Methods", varied: Sequence[str], columns: "Mapping[str, Column]", digits: Any) -> Table:
    """A row for each setting: what varies, and these columns."""
    from jaxrl_tab.stats.column import text

    view = Table("method", *map(escape, varied))
    for name, column in columns.items():
        view.add_column(text(column.screen, methods.prediction))
        if name == "score":
            view.add_column("95% interval\nof the mean")
    for column in view.columns[1:]:
        column.justify = "right"
    for method in methods:
        own_rows = [row for row in methods.rows if row.method == method]
        choice = _several(own_rows)
        for row in own_rows:
            if len(methods.rows) > MOST_ROWS and not row["best"]:
                continue
            star = choice and row["best"]
            cells = {name: _cells(column, row[name], digits) for name, column in columns.items()}
            cells["score"][1] += " !" if row.doubtful else ""
            view.add_row(
                f"{escape(method)}{' *' if star else ' ~' if choice and row['tied'] else ''}",
                *(escape(cell(_setting_of(row).get(name, np.nan), words)) for name in varied),
                *(part for parts in cells.values() for part in parts),
                style="bold" if star else None,
            )
        view.add_section()
    return view


def _notes(methods: "Methods", choice: bool, digits: Any) -> Iterator[str]:
    """What a reader of the table must know, in sentences; `choice`: whether there is more than one setting."""
    from jaxrl_tab import stats

    rows = methods.rows
    tells = lambda name: any(row.has(name) and row[name] > 0 for row in rows)
    if methods.prediction:
        yield (
            "The RMS error is that of V, over the states: its mean over the first tenth of the rows of the log, over "
            "all of them, and at the end."
        )
    elif methods.by_length:
        yield "Steps an episode: all steps that the runs took there, over all episodes that ended there."
    if len(rows) > MOST_ROWS:
        yield (
            f"Of {len(rows)} settings only the best of each method is shown: summary.csv, the report and --json have "
            "all."
        )
    of_methods = [[row for row in rows if row.method == method] for method in methods]
    if choice and any(map(_several, of_methods)):
        yield (
            "* This setting is the best of its method on these seeds. It was chosen for its mean, which flatters it."
        )
        if len(rows) <= MOST_ROWS and any(row["tied"] and not row["best"] for row in rows):
            yield (
                "~ This setting is not told apart from the best: these seeds do not say which of the two is better."
            )
    if methods.early:
        from jaxrl_tab.show.rows import early_in_words  # here, for it imports xarray and the statistics

        yield early_in_words(methods, digits)
    if methods.continuing:
        yield DOES_NOT_END
    elif tells("unfinished"):
        yield (
            "The unfinished runs end no episode in the last tenth: they score the rewards that they collected there, "
            "as if cut off."
        )
    if any(row.doubtful for row in rows):
        seeds = next(iter(methods.values())).sizes["seed"]
        yield (
            "! This mean rests on few bad runs, and may be worse than it looks: "
            f"{stats.unseen(seeds)} stuck, which {seeds} seeds need not show."
        )
    for row in rows:
        if row.doubtful and row["best"]:
            ends = [
                f"the {kind} is {cell(x[0], digits)} ({_interval(x[1], x[2], digits)})"
                for kind, x in (("median", row["median"]), ("interquartile mean", row["iqm"]))
            ]
            needed = f"{row['seeds_wanted']} seeds would be needed to trust the mean"
            yield f"! {title_of(row.method)}: {', '.join(ends)}; {needed}."
    for method, own in methods.settings.items():
        if _several([row for row in rows if row.method == method]):
            yield from (edge_warning(name, method, end) for name, end in own.edges.items())
    for name, value in _soft_optima(methods).items():
        yield f"With {name}, no policy that goes on exploring is worth more than {six_digits(value)}."
    if any(row.has("greedy_value") for row in rows):
        yield (
            "The worth of a policy is its exact value at the end, without luck and without a time limit, the median "
            "over seeds; –: half of them or more may go round for ever."
        )
    speeds = [(name, ds.attrs.get("steps_per_second", np.nan) / 1e6) for name, ds in methods.items()]
    if not np.isnan([speed for _, speed in speeds]).any():  # of what others computed it is not known
        yield f"Speed in million steps/s: {', '.join(f'{name} {speed:.1f}' for name, speed in speeds)}."


def _several(rows: "Sequence[Row]") -> bool:
    """Whether not all have the same score."""
    return len(np.unique([row["score"][0] for row in rows])) > 1


def _cells(column: "Column", x: Any, digits: Any) -> list[str]:
    """A number as it stands on the screen; of an interval the estimate, and the bounds."""
    if isinstance(x, tuple):
        ends = [] if column.written == "middle" else [_interval(x[1], x[2], digits)]
        return [cell(x[0], digits), *ends]
    write = WRITTEN.get(column.written, digits)
    return [cell(x, write)]


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
