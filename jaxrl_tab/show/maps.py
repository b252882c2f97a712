"""Pictures of a score over two hyperparameters."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, SymLogNorm
from matplotlib.patches import Rectangle

from jaxrl_tab import stats
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.show import words
from jaxrl_tab.show.explorer.measures import Flat
from jaxrl_tab.show.explorer.scores import interval_of, score_named
from jaxrl_tab.show.style import SMALL, InCell, axes_title, color_bar, ink_on, literal, tidy
from jaxrl_tab.show.words import shortened, significant, written
from jaxrl_tab.stats.settings import Settings, Sweep

WIDE = 5.0  # of values of one sign: the largest is so many times the smallest, and colours are of ratios


def swept_pair(ds: xr.Dataset) -> tuple[str, str] | None:
    """The two hyperparameters that a map is over: the first two that were swept, the step size before others."""
    names = [name for name in stats.hyperparameters(ds) if ds.sizes[name] > 1 and name != "draw"]
    across, *others = sorted(names, key=lambda name: name != "alpha") or [""]
    return (across, others[0]) if others else None


def score_map(
    ax: Axes,
    ds: Sweep,
    across: str = "alpha",
    up: str | None = None,
    *,
    measure: str = "score",
    title: str = "",
    limits: tuple[float, float] | None = None,
) -> None:
    """A heat map of the mean score of each setting over two hyperparameters; the best of them has a frame.

    The brighter, the better. Where there is no finite score, the cell is left empty. Other hyperparameters stay
    at the best combination. Where all scores have one sign and differ by more than a factor of `WIDE`, colours are
    those of ratios.

    Args:
        ax: where to draw.
        ds: the sweep of one method.
        across: the hyperparameter along the axis.
        up: the one up the side; by default the first other one that was swept.
        measure: what is drawn, as in `sensitivity`.
        title: stands over it.
        limits: the scores at the ends of the colours, so that pictures compare; by default those that are shown.

    Raises:
        InputError: one of the two was not swept, or there is no such measure.
    """
    own = Settings.of(ds)
    swept = [name for name in stats.hyperparameters(own.ds) if own.ds.sizes[name] > 1]
    up = up if up is not None else next((name for name in swept if name not in (across, "draw")), None)
    for name in (across, up):
        if name not in swept or name == "draw":
            what = "no second hyperparameter" if name is None else f"not {name!r}"
            raise InputError(f"a map is over two hyperparameters that were swept: {what}")
    assert up is not None
    score = score_named(own.ds, measure)
    rest = {name: value for name, value in own.best.items() if name not in (across, up)}
    middle = interval_of(Flat(own.ds), score, own).estimate.sel(rest).transpose(up, across).values
    shown = np.ma.masked_invalid(middle)
    low, high = limits or (float(shown.min()), float(shown.max())) if shown.count() else (0.0, 1.0)
    lower = score.kind == "cost"
    image = ax.imshow(
        shown, origin="lower", aspect="auto", cmap="viridis_r" if lower else "viridis", norm=_norm(low, high)
    )
    texts = {(i, k): _number(x) for (i, k), x in np.ndenumerate(middle) if np.isfinite(x)}
    style = {"longest": max(map(len, texts.values()), default=0), "size": SMALL}
    for (row, column), text in texts.items():
        color = ink_on(image.cmap(image.norm(middle[row, column])))
        ax.add_artist(InCell(column, row, text, (0.9, 0.9), color=color, **style))
    if texts:
        best = np.nanargmin(shown.filled(np.nan)) if lower else np.nanargmax(shown.filled(np.nan))
        row, column = np.unravel_index(best, middle.shape)
        frame = Rectangle(
            (column - 0.5, row - 0.5), 1, 1, fc="none", ec="#D55E00", lw=2.2, clip_on=False, zorder=5
        )
        ax.add_patch(frame)
    tidy(ax, words.symbol(across), words.symbol(up))
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    ax.set_xticks(*_ticks(own.ds[across].values))
    ax.set_yticks(*_ticks(own.ds[up].values))
    what = score.title if score.middle == "mean" else f"{score.title}, median"
    bar = color_bar(image, [ax], what, below=True, length=0.9)
    if isinstance(image.norm, LogNorm | SymLogNorm):
        ticks = np.outer(10.0 ** np.arange(-6, 12), [1, 2, 5]).ravel() * (1 if low > 0 else -1)
        ticks = np.sort(ticks[(ticks >= low) & (ticks <= high)])
        bar.set_ticks(ticks.tolist(), labels=[significant(x) for x in ticks])
        bar.minorticks_off()
    if title:
        axes_title(ax, title)


def _ticks(values: np.ndarray) -> tuple[range, Sequence[str]]:
    return range(len(values)), [literal(shortened(written(x))) for x in values.tolist()]


def _number(x: float) -> str:
    """With three digits; of a large number all before the point."""
    return significant(x, 3) if abs(x) < 1000 else significant(round(x), 6)


def _norm(low: float, high: float) -> Normalize:
    """How values become colours: by their ratios, where these are large."""
    if low > 0 and high / low > WIDE:
        return LogNorm(low, high)
    if high < 0 and low / high > WIDE:
        return SymLogNorm(-high, vmin=low, vmax=high)
    return Normalize(low, high)
