"""Pictures of exact learning curves: the mean squared error, and what of it is bias and what is variance."""

from collections.abc import Mapping
from itertools import repeat
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from jaxrl_tab.algorithms.moments import LearningCurve
from jaxrl_tab.show.style import INK, TYPE, WIDTH, canvas, head, legend, line_styles, tidy
from jaxrl_tab.show.words import in_words, symbol

MOST = 7  # settings that are drawn, at most
LONG = 20  # episodes, from which on their axis is logarithmic
PARTS = {"mse": "mean squared error", "squared_bias": "squared bias", "variance": "variance"}
BEYOND = 10  # times the first error, and a part of the least: what is beyond is off the scale
OF_PARTS: list[dict[str, Any]] = [
    {"color": INK, "ls": ls, "marker": marker} for ls, marker in (("-", "o"), ("--", "s"), (":", "^"))
]

Setting = Mapping[str, int]  # the place of its value on each axis of the grid


def exact_curves(curve: LearningCurve, title: str) -> Figure:
    """The error after each episode, its squared bias and its variance on one scale, and the error against alpha.

    The first three have a curve for each alpha; where lambda or n vary as well, for each of these at its alpha that is
    the best after the last episode. Of more than `MOST` some are drawn. Where alpha does not vary, the last is missing.
    """
    drawn = canvas(WIDTH)
    axes = drawn.subplots(2, 2, sharey=True).ravel()
    shown = _settings(curve)
    for ax, part in zip(axes, PARTS, strict=False):
        _over_episodes(ax, curve, shown, part)
    axes[0].set(yscale="log", ylim=_limits(curve, shown))
    legend(axes[0])
    if "alpha" in curve.grid:
        _over_alpha(axes[3], curve, shown)
    else:
        axes[3].axis("off")
    head(drawn, title)
    return drawn


def _settings(curve: LearningCurve) -> list[dict[str, int]]:
    """Those that are drawn over the episodes, at most `MOST`."""
    others = [name for name in curve.grid if name != "alpha"]
    shape = [len(curve.grid[name]) for name in others]
    if not others:
        settings = [{"alpha": i} for i in range(len(curve.grid.get("alpha", ())))] or [{}]
    else:
        settings = [dict(zip(others, place, strict=True)) for place in np.ndindex(*shape)]
        if "alpha" in curve.grid:
            last = np.where(np.isnan(curve.mse), np.inf, curve.mse)[..., -1]
            settings = [{"alpha": int(last[(slice(None), *one.values())].argmin())} | one for one in settings]
    some = np.linspace(0, len(settings) - 1, min(MOST, len(settings)))
    return [settings[round(i)] for i in some]


def _at(x: np.ndarray, curve: LearningCurve, setting: Setting) -> np.ndarray:
    """`x` [*grid, ...] at a setting; an axis that it does not name stays."""
    return x[tuple(setting.get(name, slice(None)) for name in curve.grid)]


def _limits(curve: LearningCurve, shown: list[dict[str, int]]) -> tuple[float, float]:
    """The scale of errors: what grows without bound leaves it, and so does a bias that is nearly gone."""
    errors = np.stack([_at(curve.mse, curve, setting) for setting in shown])
    seen = errors[np.isfinite(errors) & (errors > 0)]
    if not seen.size:
        return 0.1, 1
    return seen.min() / BEYOND, min(seen.max(), BEYOND * (errors[0, 0] or np.inf)) * 1.3


def _over_episodes(ax: Axes, curve: LearningCurve, shown: list[dict[str, int]], part: str) -> None:
    y = getattr(curve, part)
    episodes = np.arange(y.shape[-1])
    first = 1 if len(episodes) > LONG else 0
    for setting, style in zip(shown, line_styles(), strict=False):
        values = {name: curve.grid[name][i] for name, i in setting.items()}
        line: dict[str, Any] = {"lw": 1.5, "ms": 4, "markevery": max(1, (len(episodes) - first) // 5)} | style
        ax.plot(
            episodes[first:],
            _drawn(_at(y, curve, setting)[first:]),
            label=", ".join(in_words(values)),
            **line,
        )
    ax.set_title(PARTS[part], fontsize=TYPE)
    tidy(ax, "episodes", "")
    if first:
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(ScalarFormatter())


def _over_alpha(ax: Axes, curve: LearningCurve, shown: list[dict[str, int]]) -> None:
    """After the last episode: the error and its parts, or the error for each lambda and n."""
    alpha = np.array(curve.grid["alpha"], float)
    order = np.argsort(alpha)
    alone = len(curve.grid) == 1
    if alone:
        lines = [getattr(curve, part)[:, -1] for part in PARTS]
    else:
        of_others = [{name: i for name, i in setting.items() if name != "alpha"} for setting in shown]
        lines = [_at(curve.mse, curve, setting)[:, -1] for setting in of_others]
    styles = (
        zip(OF_PARTS, PARTS.values(), strict=True)
        if alone
        else zip(line_styles(), repeat(None), strict=False)
    )
    for y, (style, name) in zip(lines, styles, strict=False):
        ax.plot(alpha[order], _drawn(y)[order], lw=1.5, ms=4, label=name, **style)
    after = f"after episode {curve.mse.shape[-1] - 1}"
    ax.set_title(after if alone else f"{PARTS['mse']} {after}", fontsize=TYPE)
    tidy(ax, f"step size {symbol('alpha')}", "")
    legend(ax)


def _drawn(y: np.ndarray) -> np.ndarray:
    """What a logarithmic scale has a place for."""
    return np.where(np.isfinite(y) & (y > 0), y, np.nan)
