"""What docs/suite.md shows of the public results: two tables, as Markdown has them, and two pictures."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.suite import Files
from jaxrl_tab import stats
from jaxrl_tab.experiment import scores
from jaxrl_tab.show import style
from jaxrl_tab.show.words import number, title_of

BESIDE = "q-learning"  # the method that others are said to beat
ROWS, COLUMNS = 5, 4  # of small pictures, one for each method
THRESHOLDS = np.linspace(0, 1, 101)


def draw(files: Files, folder: Path) -> str:
    """Draws suite-scores.png and suite-profiles.png into a folder; gives the tables, a line for each row."""
    table, about = pd.read_csv(files.table), json.loads(files.about.read_text(encoding="utf-8"))
    over_all = about["over_environments"]["methods"]
    order = sorted(over_all, key=lambda method: over_all[method]["mean_rank"][0])
    by_task = table.pivot(index="method", columns="environment", values="normalised").loc[order]
    every = by_task[list(dict.fromkeys(table.environment))]
    _scores(every).savefig(folder / "suite-scores.png", dpi=style.DPI)
    _profiles(files, table, order).savefig(folder / "suite-profiles.png", dpi=style.DPI)
    rows = [*_over_all(over_all, order), "", *_by_task(table, about["tasks"])]
    return "\n".join(rows)


def _over_all(over_all: dict[str, Any], order: list[str]) -> list[str]:
    """A row for each method, with its intervals."""
    rows = [
        f"| method | interquartile mean | mean rank | beats {title_of(BESIDE)} |",
        "|---|---|---|---|",
    ]
    for method in order:
        own = over_all[method]
        beats = _interval(own["improvement"][BESIDE], 3) if method != BESIDE else "–"
        rows.append(
            f"| {title_of(method)} | {_interval(own['iqm'], 3)} | {_interval(own['mean_rank'], 2)} | {beats} |"
        )
    return rows


def _interval(numbers: list[float], decimals: int) -> str:
    mean, low, high = (number(x, decimals) for x in numbers)
    return f"{mean} ({low} to {high})"


def _by_task(table: pd.DataFrame, tasks: dict[str, Any]) -> list[str]:
    """A row for each task, with the method that is best there, and how many more have the same score."""
    rows = [
        "| task | states × actions | steps | γ | any action | optimum | best method and its setting | score |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, task in tasks.items():
        own = table[table.environment == name]
        best = own.loc[own.normalised.idxmax()]
        alike = int((own.normalised == best.normalised).sum()) - 1
        which = f" and {alike} more" if alike else f", {best.setting}"
        cells = [
            title_of(name),
            f"{task['states']} × {task['actions']}",
            number(task["steps"], 0),
            f"{task['gamma']:g}",
            *(number(task[key], 3) for key in ("random", "optimum")),
            title_of(best.method) + which,
            number(best.normalised, 3),
        ]
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def _scores(every: pd.DataFrame) -> Figure:
    """A cell for each method in each task: what it earns, from 0 to 1."""
    figure = Figure(figsize=(style.WIDTH, 5.6), layout="constrained")
    ax = figure.subplots()
    image = ax.imshow(every.clip(0, 1), cmap="viridis", vmin=0, vmax=1, aspect="auto")
    for (i, j), value in np.ndenumerate(every.to_numpy()):
        text = f"{value:.2f}".removeprefix("0") if 0 <= value < 0.995 else "1" if value > 0 else "<0"
        ax.text(
            j, i, text, ha="center", va="center", fontsize=6.5, color="white" if value < 0.6 else style.INK
        )
    ax.set_xticks(
        range(every.shape[1]), [title_of(x) for x in every.columns], rotation=55, ha="right", fontsize=7.5
    )
    ax.set_yticks(range(every.shape[0]), [title_of(x) for x in every.index], fontsize=7.5)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    figure.colorbar(image, ax=ax, shrink=0.4, pad=0.01).ax.tick_params(labelsize=style.SMALL)
    return figure


def _profiles(files: Files, table: pd.DataFrame, order: list[str]) -> Figure:
    """For each method the share of all its runs in all tasks that score more than a threshold, before all others."""
    fresh = scores.load(files.scores)[0]
    scale = table.set_index(["environment", "method"])
    figure = Figure(figsize=(style.WIDTH, 7.4), layout="constrained")
    curves = {}
    for method in order:
        runs = []
        for name, ds in fresh.items():
            label, _, own = name.partition("/")
            if own == method:
                row = scale.loc[(label, own)]
                runs.append(_normalised(stats.score(ds).values, row))
        curves[method] = (np.concatenate(runs)[:, None] > THRESHOLDS).mean(0)
    axes = figure.subplots(ROWS, COLUMNS, sharex=True, sharey=True)
    for ax, (method, curve) in zip(axes.flat, curves.items(), strict=True):
        for other in curves.values():
            ax.plot(THRESHOLDS, other, color="#d0d0d0", lw=0.6)
        ax.plot(THRESHOLDS, curve, color=style.COLORS[0], lw=1.8)
        ax.set_title(title_of(method), fontsize=style.SMALL)
        style.tidy(ax, "", "")
        ax.set_xlim(0, 1)
        ax.set_ylim(0, 1)
    figure.supxlabel("normalised score: 0 any action, 1 the optimum", fontsize=style.TYPE)
    figure.supylabel("share of runs above it", fontsize=style.TYPE)
    return figure


def _normalised(values: np.ndarray, row: pd.Series) -> np.ndarray:
    return (values - row["random"]) / (row["optimum"] - row["random"])
