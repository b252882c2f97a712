"""Pictures of a search: where its settings lie, and which of them were left, rung by rung."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from jaxrl_tab.show import style
from jaxrl_tab.show.searched import Way, Ways, decades, in_words, seeds_in_words, wide
from jaxrl_tab.show.words import symbol, title_of

GIVEN_UP, WENT_ON, FOUND = style.GREY, style.COLORS[0], style.COLORS[1]


def search(searches: Sequence[Ways], unit: str, width: float = style.WIDTH) -> Figure:
    """A row for each method: its settings by their values, and by how good they were in each rung.

    Args:
        searches: as `searched.ways` gives them.
        unit: of the length of runs: "steps" or "episodes".
        width: inches.
    """
    columns = 1 + any(one.axes for one in searches)
    figure = style.canvas(width if columns == 2 else min(width, style.NARROW))
    style.head(figure, "What was searched: settings, and which of them went on")
    axes: Any = figure.subplots(len(searches), columns, squeeze=False)
    logarithmic = wide(searches)
    for row, one in zip(axes, searches, strict=True):
        if one.axes:
            _settings(row[0], one, logarithmic)
        elif columns == 2:
            row[0].set_axis_off()
        _ranks(row[-1], one, unit)
    return figure


def _settings(ax: Axes, one: Ways, logarithmic: set[str]) -> None:
    """Where the settings lie."""
    x, y = one.axes
    last = len(one.rungs) - 1
    for way in reversed(one.all):
        size = 14 + 26 * (len(way.ranks) - 1) / max(last, 1)
        how = {"marker": "*", "s": 150, "zorder": 4} if way.found else {"marker": "o", "s": size, "zorder": 3}
        ax.scatter(
            [way.setting[x]], [way.setting[y]], color=_color(way), edgecolors="white", linewidths=0.6, **how
        )
    style.tidy(ax, symbol(x), symbol(y))
    for name, axis, scale in ((x, ax.xaxis, ax.set_xscale), (y, ax.yaxis, ax.set_yscale)):
        if name in logarithmic:
            scale("log")
            _number(axis, numbers := decades(*sorted(axis.get_view_interval())), [f"{x:g}" for x in numbers])
    style.axes_title(ax, f"{title_of(one.method)}: {len(one.all)} settings")


def _ranks(ax: Axes, one: Ways, unit: str) -> None:
    """How good they were in each rung: the best at the top."""
    for way in reversed(one.all):
        style_of = (
            {"lw": 2.2, "zorder": 4} if way.found else {"lw": 1.2, "zorder": 3 if len(way.ranks) > 1 else 2}
        )
        ax.plot(range(len(way.ranks)), way.ranks, color=_color(way), marker="o", ms=3.5, **style_of)
    # For the legend, where each kind stands once.
    for label, color, there in (
        (f"found: {in_words(one.all[0].setting)}", FOUND, True),
        ("went on", WENT_ON, any(len(way.ranks) > 1 and not way.found for way in one.all)),
        ("given up at once", GIVEN_UP, any(len(way.ranks) == 1 and not way.found for way in one.all)),
    ):
        if there:
            ax.plot([], [], color=color, marker="o", ms=3.5, label=label)
    ax.set_yscale("log")
    most = one.rungs[0][2]
    ax.set_ylim(1.25 * most, 0.8)
    ax.set_xlim(-0.15, len(one.rungs) - 0.85)
    style.tidy(ax, "rung after rung", "place among those left")
    ticks = sorted({1, *(count for _, _, count, _ in one.rungs)})
    _number(ax.yaxis, ticks, [str(x) for x in ticks])
    names = [f"{length:,} {unit}\n{seeds_in_words(seeds)}" for length, seeds, *_ in one.rungs]
    _number(ax.xaxis, range(len(names)), names)
    style.legend(ax)


def _number(axis: Axis, places: Sequence[float], names: Sequence[str]) -> None:
    """Gives an axis these numbers, and no others."""
    axis.set_major_locator(FixedLocator(places))
    axis.set_major_formatter(FixedFormatter(names))
    axis.set_minor_locator(NullLocator())


def _color(way: Way) -> str:
    return FOUND if way.found else WENT_ON if len(way.ranks) > 1 else GIVEN_UP
