"""Pictures of tasks that are no grids: panels of values and actions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxrl_tab import stats
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning
from jaxrl_tab.show.curves import MOST_TICKS, Labels, at_setting, interval_curve
from jaxrl_tab.show.style import (
    CELL,
    COLORS,
    INK,
    MOST_NAMED,
    NARROW,
    SMALL,
    TYPE,
    WIDTH,
    InCell,
    canvas,
    color_bar,
    ink_on,
    legend,
    line_styles,
    literal,
    tidy,
)
from jaxrl_tab.show.tasks import tables_of, uniform_values
from jaxrl_tab.show.words import significant
from jaxrl_tab.stats.along import Datasets

NARROWEST, MOST_CELL = 0.25, 0.5  # inches: the width of a cell


def panels(
    axes: Sequence[Axes] | np.ndarray,
    env: Environment,
    v: np.ndarray,
    best: np.ndarray | None = None,
    title: str = "",
    limits: tuple[float, float] | None = None,
    *,
    what: str = "value",
    colors: str = "viridis",
    scale: bool = True,
) -> None:
    """Heat maps of the values `v`, float [S], in the tables in which people see the states.

    States that are terminal or out of reach are left empty.

    Args:
        axes: where to draw, one for each of `tables_of(env)`.
        env: the environment.
        v: values, [S].
        best: which actions are best, bool [S, A]; named below the values. None: names none.
        title: stands over all, above what the states of each table have in common.
        limits: the values at the ends of the colours, so that pictures compare; by default those of `v`.
        what: what they are called beside the scale of colours.
        colors: the name of the scale in Matplotlib.
        scale: whether it is drawn, below them.
    """
    model = planning.exact_model(env)
    shown = np.isfinite(v) & planning.reachable(model) & ~planning.terminal_states(model)
    low, high = limits or (v[shown].min(initial=np.inf), v[shown].max(initial=-np.inf))
    image = None
    names = of_environment(env).action_names
    for ax, table in zip(axes, tables_of(env), strict=True):
        values = np.ma.masked_array(v, ~shown)[table.states]
        image = ax.imshow(values, cmap=colors, vmin=low, vmax=high)
        cells = [(row, column, table.states[row, column]) for row, column in np.argwhere(shown[table.states])]
        texts = [_cell(float(v[s])) for *_, s in cells]
        if best is not None:
            chosen = [_either([names[a] for a in np.flatnonzero(best[s])]) for *_, s in cells]
            texts = [f"{value}\n{action}" for value, action in zip(texts, chosen, strict=True)]
        longest = max((len(line) for text in texts for line in text.split("\n")), default=0)
        style = {"longest": longest, "size": CELL, "linespacing": 1}
        for (row, column, s), text in zip(cells, texts, strict=True):
            color = ink_on(image.cmap(image.norm(v[s])))
            ax.add_artist(InCell(column, row, literal(text), (0.94, 0.94), color=color, **style))
        ax.set_xticks(range(len(table.columns)), map(literal, table.columns))
        ax.set_yticks(range(len(table.rows)), map(literal, table.rows))
        ax.set_xlabel(literal(table.along), fontsize=TYPE)
        ax.set_ylabel(literal(table.down), fontsize=TYPE)
        ax.tick_params(length=0, labelsize=SMALL)
        ax.spines[:].set_visible(False)
        over = title if ax is axes[0] else ""  # it may be as long as all the tables are wide
        ax.set_title(literal("\n".join(filter(None, [over, table.title]))), fontsize=TYPE, loc="left")
    if scale:
        color_bar(image, axes, what, below=True, length=0.5)


def _cell(x: float) -> str:
    """A value in as few characters as a cell has room for."""
    text = f"{round(x, 2) + 0:.2f}" if abs(x) < 10 else significant(x, 3)
    return (text.replace("0.", ".", 1) if abs(x) < 1 else text).replace("-", "−")


def _either(names: Sequence[str]) -> str:
    """Several actions in a cell: "←↑", or long names one below the other, as far as there is room for them."""
    if all(len(name) == 1 for name in names):
        return "".join(names)
    return "\n".join(names) if len(names) < 3 else f"{len(names)} tied"


def panels_canvas(env: Environment, rows: int, width: float = WIDTH) -> tuple[Figure, np.ndarray]:
    """A figure with the axes for so many rows of `panels`, [rows, panels].

    It is at most so many inches wide. Where cells would be too narrow for their texts the panels of a row lie in
    several lines.
    """
    tables = tables_of(env)
    widths = [1.5 + len(table.columns) for table in tables]  # in cells, with the names of the rows
    if width / sum(widths) < NARROWEST:
        in_line = max(1, int(width / NARROWEST / max(widths)))
        lines = -(-len(tables) // in_line)
        figure = canvas(min(width, MOST_CELL * in_line * max(widths)))
        grid = figure.subplots(rows * lines, in_line, squeeze=False).reshape(rows, -1)
        for spare in grid[:, len(tables) :].flat:
            spare.remove()
        return figure, grid[:, : len(tables)]
    figure = canvas(min(width, max(NARROW, MOST_CELL * sum(widths))))
    return figure, figure.subplots(rows, len(tables), squeeze=False, width_ratios=widths)


def values_limits(env: Environment, tables: Sequence[np.ndarray]) -> tuple[float, float]:
    """The smallest and the largest finite value [S] of the states that can be reached and are not terminal."""
    model = planning.exact_model(env)
    shown = np.concatenate([v[planning.reachable(model) & ~planning.terminal_states(model)] for v in tables])
    shown = shown[np.isfinite(shown)]
    return float(shown.min(initial=np.inf)), float(shown.max(initial=-np.inf))


def action_values(ax: Axes, env: Environment, q: np.ndarray) -> None:
    """A mark for the value of each action, `q` [S, A], in each state that is not terminal.

    Where there are more actions than states, the actions lie along the axis and the marks tell the states
    apart. Of more than `MOST_NAMED` kinds of marks two are left: for the largest value and for all others.
    """
    states = np.flatnonzero(~planning.terminal_states(planning.exact_model(env)))
    along, marked = ("state", states.astype(str)), ("action", np.array(of_environment(env).action_names))
    x, shown = states, q[states].T  # [marks, places]
    if env.num_actions > len(states):
        along, marked = marked, along
        x, shown = np.arange(env.num_actions), q[states]
    style = {"ls": "none", "ms": 5}
    if len(shown) > MOST_NAMED:
        ax.plot(x, shown.T, ".", color="#9a9a9a")[0].set_label(f"any {marked[0]}")
        ax.plot(x, np.nanmax(shown, 0), "o", color=COLORS[0], label=f"the best {marked[0]}", **style)
    else:
        for y, name, mark in zip(shown, marked[1], line_styles(), strict=False):
            ax.plot(x, y, label=literal(name), **mark | style)
    if len(x) <= MOST_TICKS:
        ax.set_xticks(x, map(literal, along[1]))
    else:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.margins(0.1)
    tidy(ax, along[0], "value")
    if len(shown) > 1:
        legend(ax, title=marked[0], title_fontsize=SMALL, alignment="left")


def state_values(
    ax: Axes, datasets: Datasets, env: Environment, *, labels: Labels | None = None, **setting: Any
) -> None:
    """The V that methods of prediction learned, mean and 95% interval over seeds, beside the exact v_pi.

    States that are terminal or out of reach are left out. v_pi is drawn where pi is the policy in which all
    actions are equally likely, which is the default. Arguments and errors as in `episodes_against_steps`.
    """
    model = planning.exact_model(env)
    states = np.flatnonzero(planning.reachable(model) & ~planning.terminal_states(model))
    many = {"marker": "none"} if len(states) > MOST_TICKS else {}  # which would run together
    for (label, own), style in zip(at_setting(datasets, setting, labels), line_styles(), strict=False):
        style |= many
        interval_curve(ax, states, own.once(_values_learned, tuple(states.tolist())), label, **style)
    if (exact := uniform_values(datasets, env)) is not None:
        ax.plot(
            states, exact[states], color=INK, ls=(0, (5, 3)), lw=1.3, label="exact", zorder=3 if many else 1
        )
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(ax, "state", "V")
    legend(ax)


def _values_learned(ds: xr.Dataset, states: tuple[int, ...]) -> stats.Interval:
    """The mean V of these states, and its interval over seeds, [state]."""
    return stats.mean_interval(ds.q[..., 0].isel(state=list(states)))
