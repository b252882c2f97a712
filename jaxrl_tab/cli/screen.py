"""What commands print: tables, JSON, where files are, and that something is under way."""

import contextlib
import json as jsonlib
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.options import words
from jaxrl_tab.core.types import Environment
from jaxrl_tab.experiment import files, storage
from jaxrl_tab.show.words import cell, decimals_for, edge_warning, six_digits, symbol, title_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
PATIENCE = 2.0  # seconds of silence, at most


def show_outcome(outcome: files.Outcome, folder: Path | None, options: Any) -> int:
    """Prints what came out: tables for people, or JSON."""
    if options.json:
        summary = {"folder": folder and str(folder), "summary": _records(files.summary(outcome))}
        chosen = {"selection": _records(files.selection(outcome))} if outcome.fresh else {}
        print_json(summary | chosen)
        return 0
    if options.quiet:
        return 0
    from jaxrl_tab import stats

    for environment in outcome.envs:
        own = outcome.of(environment)
        with busy("summing up"):
            table = stats.summary(own)
        _print_summary(environment, table, own, outcome.envs[environment])
    if outcome.fresh:
        _print_selection(files.selection(outcome))
    if diverged := sum(int(ds.diverged.sum()) for ds in outcome.datasets.values()):
        runs = sum(ds.diverged.size for ds in outcome.datasets.values())
        why = "a number became infinite, or NaN, or grew beyond any possible return."
        console().print(f"{diverged} of {runs} runs diverged: {why}")
    if folder:
        name = next(iter(outcome.datasets))
        say_where(folder, name if len(outcome.envs) > 1 else name.partition("/")[2])
    return 0


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


def _print_summary(
    environment: str, table: "pd.DataFrame", datasets: "Mapping[str, xr.Dataset]", env: Environment
) -> None:
    """The summary for people: what all rows share stands above the table, what the marks mean below it."""
    from jaxrl_tab import stats

    ds = next(iter(datasets.values()))
    columns = list(table.columns)
    hyperparameters = columns[1 : columns.index("episodes")]
    tried = {h: table[h].dropna().drop_duplicates() for h in hyperparameters}  # not all methods have all
    shared = {h: found.iloc[0] for h, found in tried.items() if len(found) == 1}
    varied = [h for h in hyperparameters if h not in shared]
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    length = f"{ds.attrs[f'num_{unit}']} {unit}"
    setting = [f"{h} {words(value)}" for h, value in shared.items()]
    prediction = stats.is_prediction(*datasets.values())
    late = bool(table["unfinished"].any())
    score, kind, score_head = "last_tenth_return", "last_tenth", "mean return,\nlast tenth"
    if prediction:
        score, kind, score_head = "v_error", "v_error", "RMS error,\nwhole run"
    exact = "greedy_value" in columns
    view = Table(
        *["method", *varied, "episodes", score_head, "95% interval\nof the mean"],
        *(["unfinished\nruns"] if late else []),
        *(["RMS error\nat the end"] if prediction else []),
        *["million\nsteps/s"],
        *(["worth of the\ngreedy policy"] if exact else []),
        "value of\nthe policy" if prediction else "exact\noptimum",
    )
    for column in view.columns[1:]:
        column.justify = "right"
    # Two digits of the narrowest interval; of errors also three of the smallest.
    scores, low, high = (table[column].to_numpy(float) for column in (score, f"{kind}_low", f"{kind}_high"))
    decimals = decimals_for((high - low) / 2, 2)
    if prediction:
        decimals = max(decimals, decimals_for(scores, 3))
    digits = f"{{:.{decimals}f}}".format
    notes, edges, few = [], [], False
    for method, rows in table.groupby("method", sort=False):
        choice = len(rows[score].drop_duplicates()) > 1
        for row in rows.to_dict("records"):
            star, doubtful = choice and row["best"], row["seeds_wanted"] > row["seeds"]
            mark = " *" if star else " ~" if choice and row["tied"] else ""
            few |= doubtful
            view.add_row(
                f"{method}{mark}",
                *(cell(row[h], words) for h in varied),
                f"{row['episodes']:.1f}",
                cell(row[score], digits),
                _interval(row[f"{kind}_low"], row[f"{kind}_high"], digits) + (" !" if doubtful else ""),
                *([str(row["unfinished"])] if late else []),
                *([cell(row["final_v_error"], digits)] if prediction else []),
                f"{row['steps_per_second'] / 1e6:.1f}",
                *([cell(row["greedy_value"], six_digits)] if exact else []),
                cell(row["optimum"], six_digits),
                style="bold" if star else None,
            )
            if doubtful and row["best"]:
                ends = [
                    f"the {name} is {cell(row[f'{kind}_{key}'], digits)} ("
                    f"{_interval(row[f'{kind}_{key}_low'], row[f'{kind}_{key}_high'], digits)})"
                    for name, key in (("median", "median"), ("interquartile mean", "iqm"))
                ]
                wanted = f"{row['seeds_wanted']} seeds would be needed to trust the mean"
                notes.append(f"! {title_of(str(method))}: {', '.join(ends)}; {wanted}.")
        view.add_section()
        own = datasets[str(method)]
        at_edge = stats.at_edge(own, stats.best(own)) if choice else {}
        edges += [edge_warning(name, str(method), end) for name, end in at_edge.items()]
    out = console()
    out.print(", ".join([f"[bold]{environment}[/]", *setting, f"{ds.sizes['seed']} seeds, {length} each"]))
    out.print(view)
    say = lambda line: out.print(line, markup=False)
    if prediction:
        say("The RMS error is that of V, over the states: its mean over the rows of the log, and at the end.")
    if varied and len(table[score].drop_duplicates()) > 1:
        say(
            "* This setting is the best of its method on these seeds. It was chosen for its mean, which flatters it."
        )
        if sum(table["tied"]) > sum(table["best"]):
            say(
                "~ This setting is not told apart from the best: these seeds do not say which of the two is better."
            )
    if late:
        say(
            "The unfinished runs end no episode in the last tenth: they score the rewards that they collected there, "
            "as if cut off."
        )
    if few:
        seeds = ds.sizes["seed"]
        say(
            "! This mean rests on few bad runs, and may be worse than it looks: "
            f"{stats.unseen(seeds)} stuck, which {seeds} seeds need not show."
        )
    for line in [*notes, *edges]:
        say(line)
    if not prediction:
        for name, value in _soft_optima(datasets, env).items():
            say(f"With {name}, no policy that goes on exploring is worth more than {six_digits(value)}.")
    if exact:
        say(
            "The worth of the greedy policy is its exact value at the end, the median over seeds; "
            "-inf: it goes round for ever."
        )


def _soft_optima(datasets: "Mapping[str, xr.Dataset]", env: Environment) -> dict[str, float]:
    """What the best policy earns that explores as the best settings do: "ε = 0.1" -> value."""
    from jaxrl_tab import stats

    found = {}
    for ds in datasets.values():
        setting = stats.fixed(ds) | stats.named(ds, stats.best(ds))
        by = "behaviour" if setting.get("behaviour") else "epsilon"
        used = [key for key in (by, "gamma") if key in setting]
        name = " and ".join(f"{symbol(key)} = {words(setting[key])}" for key in used)
        if name not in found:
            found[name] = stats.soft_optimum(env, setting)
    return {name: value for name, value in found.items() if not np.isnan(value)}


def _interval(low: float, high: float, digits: Any) -> str:
    return cell(low, lambda _: f"{digits(low)} to {digits(high)}")


def say_where(folder: Path, group: str | None = None) -> None:
    out = console()
    files = ", ".join(sorted(file.name for file in folder.iterdir() if not file.name.startswith(".")))
    out.print(f"[bold]{escape(str(folder))}[/]: {files}", soft_wrap=True)
    if group:
        how = f'xarray.open_datatree("{folder / storage.DATA}")["{group}"]'
        out.print(f"Read the data with {how}", markup=False, soft_wrap=True)


def console() -> Console:
    """Where tables are printed, :100: as it is; a pipe or a file is wide enough for all of them."""
    return Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else 160)


def print_json(value: Any) -> None:
    utf8 = (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    print(jsonlib.dumps(value, ensure_ascii=not utf8, indent=1))


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
