"""Pictures of where methods lose what they earn less than the best policy."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from jaxrl_tab.envs.base import Grid
from jaxrl_tab.exact.losses import Losses
from jaxrl_tab.show import plot
from jaxrl_tab.show.explained import LISTED, Explained, Explanation, Place
from jaxrl_tab.show.tasks import tables_of
from jaxrl_tab.show.words import significant

LEAST = 0.005  # the share of all that is lost, below which a state is left empty
COLORS = "YlOrRd"


def save(explanation: Explanation, folder: Path) -> list[Path]:
    """Writes the picture of each method, "METHOD.png"; of several environments each into a folder of its own."""
    several = len({one.environment for one in explanation.values()}) > 1
    files = []
    for one in explanation.values():
        place = folder / one.environment if several else folder
        place.mkdir(parents=True, exist_ok=True)
        files.append(place / f"{one.method}.png")
        plot.save(figure(one), files[-1])
    return files


def figure(one: Explained) -> Figure:
    """A heat map of what is lost in each state, with the actions that lose the most there.

    On a grid, or in the tables in which people see the states; elsewhere bars for the states that lose the most.
    States in which next to nothing is lost are left empty.
    """
    losses = one.main
    title = f"{one.name}: {_what(one, losses)}"
    if not one.loses(losses):
        return _bars([], title)
    if isinstance(one.env, Grid):
        drawn = plot.canvas(plot.WIDTH)
        ax = drawn.subplots()
        lost, by_action = _shown(losses)
        plot.values(ax, one.env, lost, by_action, (0, None), what="lost", colors=COLORS)
        plot.head(drawn, title)
        return drawn
    if tables_of(one.env):
        drawn, grid = plot.panels_canvas(one.env, 1)
        lost, by_action = _shown(losses)
        worst = (by_action == by_action.max(1, keepdims=True)) & (by_action > 0)
        limits = 0.0, float(np.nanmax(lost))
        plot.panels(grid[0], one.env, lost, worst, "", limits, what="lost", colors=COLORS)
        plot.head(drawn, title)
        return drawn
    return _bars(one.places(losses)[:LISTED], title)


def _shown(losses: Losses) -> tuple[np.ndarray, np.ndarray]:
    """What is lost in each state, float [S], and by which actions; NaN where it is next to nothing."""
    lost = losses.by_state
    return np.where(lost >= LEAST * lost.sum(), lost, np.nan), losses.by_action


def _what(one: Explained, losses: Losses) -> str:
    kind = "greedy policies" if losses is one.greedy else "policies that act"
    ended = len(losses.lost) - losses.endless
    return f"{kind} lose {significant(float(losses.by_action.sum()), 4)}, mean over {ended} seeds"


def _bars(places: list[Place], title: str) -> Figure:
    drawn = plot.canvas(plot.NARROW)
    ax: Any = drawn.subplots()
    ax.barh(
        [plot.literal(place.name) for place in places],
        [place.share for place in places],
        color=plot.COLORS[1],
    )
    ax.invert_yaxis()
    ax.xaxis.set_major_formatter(PercentFormatter(1))
    plot.tidy(ax, "share of what is lost", "state")
    plot.head(drawn, title)
    return drawn
