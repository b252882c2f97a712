"""Pictures of grids: values, greedy paths, and what changes from grid to grid."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from jaxrl_tab import stats
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.envs.base import COMPASS, Grid
from jaxrl_tab.show.moves import Moves, greedy_actions, preferring, tables_of_seeds
from jaxrl_tab.show.style import COLORS, GREY, INK, SMALL, InCell, axes_title, color_bar
from jaxrl_tab.show.words import label_of, seeds_in_words, significant
from jaxrl_tab.stats.settings import Settings

# The outline of an arrow around its middle, in widths of a cell: (along, across).
ARROW = np.array([(-5, -1), (0, -1), (0, -3), (5, 0), (0, 3), (0, 1), (-5, 1)]) * 0.092

WALL = "#4d4d4d"  # the colour of walls
MOST_STARTS = 4  # from which paths are drawn


def greedy_path(
    ax: Axes, env: Grid, q: np.ndarray, title: str = "greedy path", optimum: float = np.nan
) -> None:
    """The path of the policy that is greedy to `q`, from start to goal, on the grid with its wind below.

    It is a band, from each start where there are at most `MOST_STARTS`. Arrows are the greedy actions of all cells
    in which `q` prefers any, faint beside the path; walls are dark, and hatched cells cannot be reached. Where
    several actions are greedy the path takes one that leads to the goal soonest, so "goes round for ever" is said
    only where no choice among them gets there. Where chance plays, the path takes the most likely outcome (of equally
    likely ones the middle one).

    Args:
        ax: where to draw.
        env: a grid.
        q: action values, [S, A], learned or exact.
        title: the first line of the title; the second says how long the path is.
        optimum: v* from the start, named beside the length unless NaN.
    """
    moves = Moves.of(env)
    ends = (moves.terminal & moves.reachable).any()  # a task without an end has no paths
    starts = env.start_states if ends else []
    paths = [moves.path(q, s) for s in starts] if len(starts) <= MOST_STARTS else []
    prefers = preferring(q) & ~moves.terminal & moves.reachable
    _draw_grid(ax, env, moves)
    for path, arrives in paths:
        _draw_path(ax, env, path, COLORS[5] if arrives else COLORS[4])
    on_path = np.isin(np.arange(env.num_states), [s for path, _ in paths for s in path])
    for some, ink in ((~on_path, "#9a9a9a"), (on_path, INK)):
        _draw_arrows(ax, env, greedy_actions(q) & (prefers & some)[:, None], ink)
    _draw_letters(ax, env, moves)
    length = _length(moves.distance(q[None])[0][starts]) if starts else ""
    if length and moves.stochastic:
        length = f"likeliest outcomes: {length}"
    best = "" if np.isnan(optimum) else f"optimum v* = {significant(optimum, 4)}"
    axes_title(ax, "\n".join(filter(None, [title, "; ".join(filter(None, [length, best]))])))


def _draw_path(ax: Axes, env: Grid, path: np.ndarray, color: str) -> None:
    """A band along some states, dotted where it goes further than a move and the wind can carry anybody."""
    outline = [patheffects.withStroke(linewidth=8, foreground="white")]
    round_ends: dict[str, Any] = {"solid_capstyle": "round", "solid_joinstyle": "round"}
    cells = np.stack(np.divmod(path, env.shape[1]), -1)
    wind = of_environment(env).wind
    furthest = 1 + (0 if wind is None else np.abs(wind).max())
    jumps = np.flatnonzero(np.abs(np.diff(cells, axis=0)).max(-1) > furthest)
    for piece in np.split(cells, jumps + 1):
        ax.plot(*piece.T[::-1], color=color, lw=5.5, zorder=2.5, path_effects=outline, **round_ends)
    for i in jumps:
        ax.plot(*cells[i : i + 2].T[::-1], ":", color=color, lw=2.5, zorder=2.5)


def _length(steps: np.ndarray) -> str:
    """How long greedy paths are: `steps` from each start, inf where the path does not arrive."""
    endless = np.isinf(steps)
    if endless.any():
        return "goes round for ever" + (
            f" from {endless.sum()} of {len(steps)} starts" if len(steps) > 1 else ""
        )
    low, high = (significant(float(x)) for x in (steps.min(), steps.max()))
    return f"{low if low == high else f'{low} to {high}'} steps to the goal"


def values(
    ax: Axes,
    env: Grid,
    v: np.ndarray,
    q: np.ndarray | None,
    limits: tuple[float | None, float | None] = (None, None),
    *,
    what: str = "value",
    colors: str = "viridis",
) -> None:
    """A heat map of the values `v`, float [S], with the arrows of all greedy actions of `q`, [S, A].

    Walls are dark, and hatched cells cannot be reached from the start; the goal has no value, as nothing is done there.

    Args:
        ax: where to draw.
        env: a grid.
        v: values, [S].
        q: action values, [S, A]; None: there are no arrows.
        limits: the values at the ends of the colours, so that pictures compare; by default those of `v`.
        what: what they are called beside the scale of colours.
        colors: the name of the scale in Matplotlib.
    """
    moves = Moves.of(env)
    shown = np.isfinite(v) & moves.reachable & ~moves.terminal
    low, high = limits
    cells = np.ma.masked_array(v, ~shown).reshape(env.shape)
    image = ax.imshow(cells, cmap=colors, vmin=low, vmax=high, zorder=1)
    _draw_grid(ax, env, moves)
    if q is not None:
        _draw_arrows(ax, env, greedy_actions(q) & shown[:, None], "white", raised=0.12)
    _draw_letters(ax, env, moves)
    numbers = {int(s): significant(v[s], 4) for s in np.flatnonzero(shown)}
    style = {
        "longest": max(map(len, numbers.values()), default=0),
        "size": SMALL,
        "color": "white",
        "zorder": 4,
    }
    for s, number in numbers.items():
        row, column = divmod(s, env.shape[1])
        text = InCell(column, row + 0.33, number, (0.9, 0.26), **style)
        text.set_path_effects([patheffects.withStroke(linewidth=1.5, foreground=INK)])
        ax.add_artist(text)
    color_bar(image, [ax], what)


def small_values(
    ax: Axes, env: Grid, v: np.ndarray, policy: np.ndarray, limits: tuple[float, float], title: str
) -> None:
    """The colours of `values`, with the arrows of the likeliest actions of a policy [S, A], and no numbers."""
    moves = Moves.of(env)
    shown = np.isfinite(v) & moves.reachable & ~moves.terminal
    low, high = limits
    ax.imshow(np.ma.masked_array(v, ~shown).reshape(env.shape), vmin=low, vmax=high, zorder=1)
    _draw_grid(ax, env, moves, note=False)
    _draw_arrows(ax, env, greedy_actions(policy) & (moves.reachable & ~moves.terminal)[:, None], "white")
    _draw_letters(ax, env, moves)
    axes_title(ax, title)


def walk(ax: Axes, env: Grid, states: np.ndarray, title: str) -> None:
    """The way that an episode went, from one of `states`, int [steps + 1], to the next.

    Every arrow is drawn a little to the right of where it goes, so that ways back and forth lie side by side.
    """
    moves = Moves.of(env)
    _draw_grid(ax, env, moves)
    rows, columns = np.divmod(np.asarray(states), env.shape[1])
    down, right = np.diff(rows), np.diff(columns)
    moved = (down != 0) | (right != 0)  # against the edge it stays
    x, y = columns[:-1] - 0.12 * down, rows[:-1] + 0.12 * right
    _quiver(ax, x[moved], y[moved], right[moved], down[moved], COLORS[0], width=0.07)
    _draw_letters(ax, env, moves, reached=True)
    axes_title(ax, title)


def changes(ax: Axes, env: Grid, change: np.ndarray, title: str) -> None:
    """An arrow for each action whose value changed, the fainter the less; `change` is float [S, A]."""
    moves = Moves.of(env)
    _draw_grid(ax, env, moves)
    states, actions = np.nonzero(change)
    rows, columns = np.divmod(states, env.shape[1])
    down, right = np.asarray(COMPASS)[actions].T
    size = np.abs(change[states, actions])
    faint = 0.3 + 0.7 * size.astype(float) / size.max(initial=0)
    color = np.column_stack([np.tile(to_rgb(COLORS[1]), (len(size), 1)), faint])
    _quiver(ax, columns + 0.1 * right, rows + 0.1 * down, 0.4 * right, 0.4 * down, color, width=0.065)
    _draw_letters(ax, env, moves)
    axes_title(ax, title)


def amounts(ax: Axes, env: Grid, change: np.ndarray, whole: float, title: str) -> None:
    """An arrow for each action whose value changed, by its area how much: `change` is float [S, A].

    The arrow of a change of `whole` is as long as a cell is wide, but for a little.
    """
    moves = Moves.of(env)
    _draw_grid(ax, env, moves)
    states, actions = np.nonzero(change)
    rows, columns = np.divmod(states, env.shape[1])
    down, right = np.asarray(COMPASS)[actions].T
    size = np.sqrt(np.abs(change[states, actions]).astype(float) / whole)
    along, across = (size[:, None] * part for part in ARROW.T)
    x = columns[:, None] + along * right[:, None] - across * down[:, None]
    y = rows[:, None] + along * down[:, None] + across * right[:, None]
    outlines = list(np.stack([x, y], -1))
    ax.add_collection(PolyCollection(outlines, facecolor=COLORS[1], lw=0, zorder=3))
    _draw_letters(ax, env, moves, reached=True)
    axes_title(ax, title)


def _draw_grid(ax: Axes, env: Grid, moves: Moves, note: bool = True) -> None:
    """Cells, dark where walls are, hatched where nobody gets otherwise (a note says so); wind, its strength below."""
    rows, columns = env.shape
    wind = of_environment(env).wind
    wind = np.zeros(columns) if wind is None else np.asarray(wind)
    strongest = max(1, np.abs(wind).max())
    for column, strength in enumerate(wind):
        shade = mpl.colormaps["Blues"](0.36 * abs(strength) / strongest)
        if strength:
            ax.add_patch(Rectangle((column - 0.5, -0.5), 1, rows, color=shade, lw=0, zorder=0))
        if wind.any():
            text = InCell(column, rows - 0.1, significant(strength), (0.9, 0.6), color=INK, size=SMALL)
            ax.add_artist(text).set_clip_on(False)
    if wind.any():
        ax.text(-0.65, rows - 0.1, "wind", ha="right", va="center", color=INK, size=SMALL)
    walls = set(env.walls)
    apart = [divmod(int(s), columns) for s in np.flatnonzero(~moves.reachable)]
    apart = [cell for cell in apart if cell not in walls]
    hatched: dict[str, Any] = {"fc": "#f4f4f4", "ec": "#bdbdbd", "hatch": "////"}
    solid: dict[str, Any] = {"fc": WALL}
    for cells, style in ((apart, hatched), (walls, solid)):
        for row, column in cells:
            ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, lw=0, zorder=1, **style))
    if note and apart:
        style = {"size": SMALL, "color": GREY, "ha": "right", "va": "top"}
        ax.text(columns - 0.5, rows - 0.4 + 0.6 * wind.any(), "hatched: out of reach from the start", **style)
    lines = {"color": "#c4c4c4", "lw": 0.8, "zorder": 2}
    ax.hlines(np.arange(rows + 1) - 0.5, -0.5, columns - 0.5, **lines)
    ax.vlines(np.arange(columns + 1) - 0.5, -0.5, rows - 0.5, **lines)
    ax.set_xlim(-0.55, columns - 0.45)
    ax.set_ylim(rows - 0.45, -0.55)
    ax.set_aspect("equal")
    ax.axis("off")


def _draw_arrows(ax: Axes, env: Grid, shown: np.ndarray, color: str, raised: float = 0.0) -> None:
    """An arrow for each (s, a) that is `shown`, bool [S, A]; staying is a dot.

    They start in the middle of the cell, or so much above it as they are `raised`.
    """
    states, actions = np.nonzero(shown)
    rows, columns = np.divmod(states, env.shape[1])
    rows = rows - raised
    down, right = np.asarray(COMPASS)[actions].T
    stays = (down == 0) & (right == 0)
    length = (0.4 - raised) / np.maximum(1, np.hypot(down, right))
    if stays.any():
        ax.plot(columns[stays], rows[stays], "o", color=color, ms=4, zorder=3)
    edge = (
        {"edgecolor": INK, "linewidth": 0.5} if color == "white" else {}
    )  # so that it is seen on any colour
    _quiver(
        ax, columns[~stays], rows[~stays], (right * length)[~stays], (down * length)[~stays], color, **edge
    )


def _quiver(
    ax: Axes,
    x: np.ndarray,
    y: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    color: Any,
    width: float = 0.045,
    **edge: Any,
) -> None:
    """Arrows from (x, y), as long and as wide as they are in cells; `color` is one for all or [arrows, 4].

    `edge`: how they are outlined.
    """
    size = {"angles": "xy", "scale_units": "xy", "scale": 1, "units": "xy", "width": width, "minlength": 0}
    head = {"headwidth": 4, "headlength": 4, "headaxislength": 3.6}
    ax.quiver(x, y, right, down, **size, **head, facecolor=color, zorder=3, **edge)


def _draw_letters(ax: Axes, env: Grid, moves: Moves, reached: bool = False) -> None:
    """The letters of start, goal and others; in a corner of a cell whose middle has an arrow, or may be `reached`."""
    style = {"size": SMALL, "weight": "bold", "color": INK, "zorder": 6}
    for s, letter in env.letters.items():
        in_middle = not moves.reachable[s] or (moves.terminal[s] and not reached)
        corner, part = (0.0, 0.5) if in_middle else (0.27, 0.5)
        row, column = divmod(s, env.shape[1])
        text = InCell(column - corner, row - corner, letter, (part, part), **style)
        text.set_path_effects([patheffects.withStroke(linewidth=2, foreground="white")])
        ax.add_artist(text)


def median_path(ax: Axes, env: Grid, name: str, own: Settings) -> None:
    """The greedy path that is the median over seeds in length, at the best setting of the method of this name."""
    label, ds = label_of(name, stats.named(own.ds, own.best)), own.at_best.ds
    moves = Moves.of(env)
    starts = env.start_states
    lengths = np.concatenate([moves.distance(q)[:, starts].mean(-1) for q in tables_of_seeds(ds)])
    median = np.argsort(lengths, kind="stable")[(len(lengths) - 1) // 2]
    title = f"{label}\ngreedy path, median of {seeds_in_words({label: ds})}"
    greedy_path(ax, env, ds.q.values[median], title, float(stats.optimum(ds)))
