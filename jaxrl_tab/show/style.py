"""How pictures look: colours, markers, sizes, axes, legends."""

import contextlib
import itertools
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<")  # one more than colours: the pairs repeat after 56
DASHES = ("-", "--", ":", "-.")
INK, GREY, ALARM = "#222222", "#6e6e6e", "#D55E00"
TITLE, TYPE, SMALL, CELL = 10, 9, 8, 7  # font sizes, points; the last is of the hundreds of cells of a table
WIDTH, NARROW = 7.2, 6.0  # inches: of a figure, and of one with a single curve
DPI = 200
LINE, HALF, LABEL = 84, 42, 36  # characters in a line: over a figure, over half of one, in a legend


def tidy(ax: Axes, xlabel: str, ylabel: str) -> None:
    """Names the axes, and leaves no more lines than are needed."""
    ax.set_xlabel(literal(xlabel), fontsize=TYPE)
    ax.set_ylabel(literal(ylabel), fontsize=TYPE)
    ax.tick_params(labelsize=SMALL)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(alpha=0.25, lw=0.6)
    ax.set_axisbelow(True)


def legend(ax: Axes, **options: Any) -> None:
    """The legend of what was drawn under a label. Of a curve that cannot be seen it says why.

    One curve alone has its label above the axes, where it hides nothing.

    Args:
        ax: where curves were drawn, with the limits that it is to have.
        options: as in `Axes.legend`.
    """
    handles, labels = ax.get_legend_handles_labels()
    low, high = sorted(ax.get_ylim())
    for i, handle in enumerate(handles):
        y = np.asarray(handle.get_ydata(), float) if isinstance(handle, Line2D) else np.empty(0)
        seen = y[np.isfinite(y)]
        if y.size and not seen.size:
            labels[i] += " (no value)"
        elif y.size and not (seen.min() <= high and seen.max() >= low):
            labels[i] += " (off the scale)"
    labels = [textwrap.fill(label, LABEL, break_on_hyphens=False) for label in labels]
    style = {"fontsize": SMALL, "framealpha": 0.8, "edgecolor": "none", "borderpad": 0.2, "handlelength": 1.8}
    if len(labels) == 1:
        options = {"loc": "lower left", "bbox_to_anchor": (0, 1), "borderaxespad": 0}
    ax.legend(handles, labels, **style | options)


def literal(text: str) -> str:
    """`text` such that Matplotlib shows each of its characters.

    It would take what stands between two dollars for a formula, and leave out of legends what begins with an
    underscore.
    """
    shown = text.replace("$", r"\$")
    return f"\u200b{shown}" if shown.startswith("_") else shown  # a space of no width


def axes_title(ax: Axes, text: str) -> None:
    """A title over axes of half the width, in as many lines as it needs."""
    lines = (textwrap.wrap(line, HALF, break_on_hyphens=False) for line in text.splitlines())
    ax.set_title(literal("\n".join(itertools.chain(*lines))), fontsize=TYPE)


def color_bar(image: Any, axes: Sequence[Axes] | np.ndarray, what: str = "value", **options: Any) -> None:
    """A scale that says what the colours of `image` stand for; `axes` make room for it."""
    bar = image.figure.colorbar(image, ax=list(axes), **options)
    bar.set_label(what, fontsize=TYPE)
    bar.ax.tick_params(labelsize=SMALL)


def line_styles() -> Iterable[dict[str, Any]]:
    """Colours with markers, and with another dash when all colours have been: no two of the first 56 are alike."""
    for i in itertools.count():
        dash = DASHES[i // len(COLORS) % len(DASHES)]
        yield {"color": COLORS[i % len(COLORS)], "marker": MARKERS[i % len(MARKERS)], "ls": dash}


class _Canvas(Figure):
    """A figure in which a character that the font lacks is a box, and nothing else happens."""

    def draw(self, renderer: Any) -> None:
        with _any_character():
            super().draw(renderer)


@contextlib.contextmanager
def _any_character() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def canvas(width: float, height: float) -> Figure:
    """An empty figure of so many inches."""
    return _Canvas((width, height), dpi=DPI, layout=ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.06))


def lay_out(figure: Figure) -> None:
    """Gives everything in a figure its place, once: saving it would draw it all to find the places, and again."""
    if engine := figure.get_layout_engine():
        with _any_character():
            engine.execute(figure)
        figure.set_layout_engine("none")


def head(figure: Figure, text: str, seeds: int | None = None) -> None:
    """The title of a whole figure; in a line of its own over how many seeds its means and intervals are."""
    over = "" if seeds is None else f"\nmean and pointwise 95% interval over {seeds} seeds"
    figure.suptitle(literal(text + over), fontsize=TITLE)


def exact_line(ax: Axes, value: float, label: str, **line: Any) -> None:
    """A level line for what is exact, named in the legend; it is drawn as `line` says, dashed by default."""
    ax.axhline(value, label=label, **{"color": INK, "ls": "--", "lw": 1.2} | line)
