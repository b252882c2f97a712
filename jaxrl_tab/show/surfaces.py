"""Pictures of what was learned where states cannot be counted: a function of one number, or of two."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxrl_tab import stats
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.types import Environment
from jaxrl_tab.show.curves import Labels, at_setting, interval_curve
from jaxrl_tab.show.places import ends_of, grid, learned_at, middles
from jaxrl_tab.show.style import (
    INK,
    NARROW,
    WIDTH,
    axes_title,
    canvas,
    color_bar,
    legend,
    line_styles,
    tidy,
)
from jaxrl_tab.show.words import seeds_in_words
from jaxrl_tab.stats.along import Datasets

POINTS, CELLS = 400, 60  # along a number: of a curve, and of a map
ACROSS = 2  # maps in a row


def function(
    ax: Axes, datasets: Datasets, env: Environment, *, labels: Labels | None = None, **setting: Any
) -> None:
    """What was learned of states that are one number, mean and 95% interval over seeds; beside what is known of it.

    Of methods of control it is the largest action value. Arguments and errors as in `episodes_against_steps`.
    """
    x = middles(*ends_of(env)[0], POINTS)
    for (label, own), style in zip(at_setting(datasets, setting, labels), line_styles(), strict=False):
        worth = xr.DataArray(learned_at(x[:, None], env, own.ds).max(-1), dims=("seed", "x"))
        interval_curve(ax, x, stats.mean_interval(worth), label, **style | {"marker": "none"})
    if (known := of_environment(env).known_values) is not None:
        states, values = map(np.asarray, known())
        ax.plot(states[:, 0], values, color=INK, ls=(0, (5, 3)), lw=1.3, label="exact", zorder=3)
    tidy(
        ax, of_environment(env).observed_names[0], "V" if stats.is_prediction(*datasets.values()) else "max Q"
    )
    legend(ax)


def surfaces(
    datasets: Datasets, env: Environment, *, width: float = WIDTH, labels: Labels | None = None
) -> Figure:
    """A figure with what was learned of states that are two numbers: a map for each method, at its best setting.

    It is the mean over seeds of the largest action value, or of V. Where that is nowhere above 0, as where all rewards
    are costs, its sign is turned: that is the cost to go (book, figure 10.1). Arguments as in `plot.overview`.
    """
    places = grid(env, CELLS, CELLS)
    maps = {}
    for label, own in at_setting(datasets, {}, labels):
        worth = learned_at(places.points, env, own.ds).max(-1).mean(0, dtype=float)
        maps[f"{label}:\nmean of {seeds_in_words({label: own.ds})}"] = worth.reshape(CELLS, CELLS)
    shown = np.concatenate([x[np.isfinite(x)] for x in maps.values()])
    symbol = "V" if stats.is_prediction(*datasets.values()) else "max q(s, a)"
    is_cost = shown.size and shown.max() <= -0.05 * shown.min()  # what was learned overshoots 0 a little
    sign, what = (-1, f"cost to go, −{symbol}") if is_cost else (1, symbol)
    limits = (sign * shown).min(initial=np.inf), (sign * shown).max(initial=-np.inf)
    columns = ACROSS if len(maps) > 1 else 1
    figure = canvas(width if columns > 1 else min(width, NARROW))
    axes = figure.subplots(-(-len(maps) // columns), columns, squeeze=False)
    extent: Any = np.ravel(ends_of(env))
    image = None
    for ax, (title, worth) in zip(axes.ravel(), maps.items(), strict=False):
        image = ax.imshow(sign * worth, extent=extent, aspect="auto", vmin=limits[0], vmax=limits[1])
        axes_title(ax, title)
        tidy(ax, *of_environment(env).observed_names)
        ax.grid(visible=False)
    for spare in axes.ravel()[len(maps) :]:
        spare.remove()
    color_bar(image, axes.ravel()[: len(maps)], what, below=True, length=0.5)
    return figure
