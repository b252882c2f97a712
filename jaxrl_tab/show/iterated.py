"""Pictures of generalized policy iteration."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxrl_tab.core.types import Environment
from jaxrl_tab.envs.base import Grid
from jaxrl_tab.exact import planning
from jaxrl_tab.show.grids import small_values
from jaxrl_tab.show.moves import greedy_actions
from jaxrl_tab.show.panels import panels, panels_canvas, values_limits
from jaxrl_tab.show.style import (
    COLORS,
    INK,
    NARROW,
    SMALL,
    TYPE,
    WIDTH,
    canvas,
    head,
    legend,
    line_styles,
    tidy,
)
from jaxrl_tab.show.tasks import tables_of
from jaxrl_tab.show.words import significant, some

COLUMNS, MAPS, ROWS, CURVES = 3, 12, 4, 8  # of iterates: maps side by side, and how many are drawn at most
FEW_STATES = 4  # which have a curve each, over the iterates

SLOPE = 0.5  # of the two lines in the picture of the zigzag
POWER = 1 / 3  # distances are drawn by their cube roots, so that the last ones are seen, and 0 has its place


def zigzag(ax: Axes, way: np.ndarray, farthest: float | None = None, **line: Any) -> None:
    """The way of generalized policy iteration between the lines v = v_pi and pi = greedy(v) (Silver, lecture 3).

    A point is a policy and values. Along the axis is the sum of its distances from the two lines, by its cube root, and
    between the lines it lies as one distance is to the other: on the upper one v = v_pi, on the lower one pi is greedy.
    They meet where both distances are 0, at the best policy. A mark is where an improvement follows.

    Args:
        ax: where to draw.
        way: `Iterates.zigzag`, [M, 2]; what is infinitely far is left out.
        farthest: where the lines begin, so that pictures compare; by default a little before the way.
        line: as in `Axes.plot`.
    """
    way = way[np.isfinite(way).all(1)]
    farthest = farthest or 1.1 * float(way.sum(1).max())
    x, y = _placed(way)
    style = {"color": COLORS[0], "lw": 1.4, "marker": "o", "ms": 4, "markevery": 2, "zorder": 3}
    ax.plot(x, y, **style | line)
    begin = -(farthest**POWER)
    for side, name in ((1, "v = $v_\\pi$"), (-1, "π = greedy(v)")):
        ax.plot([begin, 0], [-side * SLOPE * begin, 0], color=INK, lw=1.5, zorder=2)
        at = (0.55 * begin, -side * SLOPE * 0.55 * begin), (4, side * 2)
        place: dict[str, Any] = {"textcoords": "offset points", "va": "bottom" if side > 0 else "top"}
        ax.annotate(name, *at, fontsize=SMALL, color=INK, **place)
    ax.plot(0, 0, "*", color=INK, ms=9, zorder=5)
    ax.annotate("v*, π*", (0, 0), (0, 8), textcoords="offset points", ha="center", fontsize=SMALL, color=INK)
    ticks = [10.0**k for k in range(-9, 9) if 10.0**k <= farthest][-4:]
    ax.set_xticks([-(x**POWER) for x in ticks] + [0], [f"{x:g}" for x in ticks] + ["0"])
    ax.set_yticks([])
    ax.set_xlabel("sum of both distances", fontsize=TYPE)
    ax.tick_params(labelsize=SMALL)
    ax.spines[["top", "left", "right"]].set_visible(False)


def iterates(
    env: Environment, history: planning.Iterates, title: str = "", *, width: float = WIDTH
) -> Figure:
    """The policies and values of generalized policy iteration, iterate by iterate; of many some, the last among them.

    On a grid, or where people see the states in other tables, a map of each with its actions; else a curve of values.
    Colours are of the values from the least to the largest of the last iterate.

    Args:
        env: the environment.
        history: what is drawn.
        title: stands over all.
        width: of the figure, inches; of a picture that needs less, at most.
    """
    if isinstance(env, Grid):
        figure = _maps(env, history, width)
    elif tables_of(env):
        figure = _tables(env, history, width)
    else:
        figure = _curves(env, history, min(width, NARROW))
    head(figure, title)
    return figure


def _maps(env: Grid, history: planning.Iterates, width: float) -> Figure:
    limits = values_limits(env, [history.v[-1]])
    figure, grid, chosen = _in_columns(history, width, COLUMNS)
    for ax, n in zip(grid, chosen, strict=True):
        small_values(ax, env, history.v[n], history.policy[n], limits, _what(history, n))
    return figure


def _tables(env: Environment, history: planning.Iterates, width: float) -> Figure:
    limits = values_limits(env, [history.v[-1]])
    if len(tables_of(env)) == 1:
        figure, axes, chosen = _in_columns(history, width, COLUMNS - 1)
        grid = [[ax] for ax in axes]
    else:
        chosen = some(len(history.v), ROWS)
        figure, grid = panels_canvas(env, len(chosen), width)
    for row, n in zip(grid, chosen, strict=True):
        likeliest = greedy_actions(history.policy[n])
        panels(row, env, history.v[n], likeliest, _what(history, n), limits, scale=n == chosen[-1])
    return figure


def _in_columns(
    history: planning.Iterates, width: float, columns: int
) -> tuple[Figure, Sequence[Axes], list[int]]:
    """A figure with axes for some iterates, so many side by side where it is wide enough; and which they are."""
    chosen = some(len(history.v), MAPS)
    columns = max(1, int(columns * width / WIDTH))
    figure = canvas(width)
    grid = figure.subplots(-(-len(chosen) // columns), columns, squeeze=False).ravel()
    for ax in grid[len(chosen) :]:
        ax.remove()
    return figure, list(grid[: len(chosen)]), chosen


def _curves(env: Environment, history: planning.Iterates, width: float) -> Figure:
    model = planning.exact_model(env)
    states = np.flatnonzero(planning.reachable(model) & ~planning.terminal_states(model))
    figure = canvas(width)
    ax = figure.subplots()
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(states) <= FEW_STATES:
        for s, style in zip(states, line_styles(), strict=False):
            ax.plot(history.v[:, s], label=f"state {s}", ms=4, lw=1.3, **style)
        tidy(ax, "policy", "v")
    else:
        chosen = some(len(history.v), CURVES)
        for n, color in zip(chosen, mpl.colormaps["viridis"](np.linspace(0.9, 0, len(chosen))), strict=True):
            ax.plot(states, history.v[n][states], color=color, marker=".", lw=1.3, label=f"policy {n}")
        tidy(ax, "state", "v")
    legend(ax)
    return figure


def _what(history: planning.Iterates, n: int) -> str:
    """What is said of an iterate over its picture."""
    changed = f": {history.changed[n]} changed" if n else ""
    return f"policy {n}{changed}\nfrom the start {significant(history.start_value[n])}"


def _placed(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the points of a way lie, x and y, [M] each."""
    total = way.sum(1)
    x = -(total**POWER)
    ratio = np.divide(way[:, 1] - way[:, 0], total, out=np.zeros(len(way)), where=total > 0)
    return x, -SLOPE * x * ratio
