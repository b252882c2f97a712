"""How pictures look: colours, markers, sizes, axes, legends."""

import contextlib
import itertools
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.textpath import text_to_path
from matplotlib.ticker import ScalarFormatter

from jaxrl_tab.show.layout import Layout

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", "*", "p", ">", "h")  # pairs with a colour repeat after 84
DASHES = ("-", "--", ":", "-.")
INK, GREY, ALARM = "#222222", "#6e6e6e", "#D55E00"
TITLE, TYPE, SMALL, CELL = 10, 9, 8, 7  # font sizes, points; the last is of the hundreds of cells of a table
WIDTH, NARROW = 7.2, 6.0  # inches: of a figure, and of one with a single curve
DPI = 200
LEAST = 4.5  # points: of what is in cells, if they are too small for those sizes
LINE, CHARACTER, DIGIT = 84, 0.6, 0.64  # characters in a line over a figure; widths for a font size of 1
MOST_NAMED = 12  # curves in a legend: as many as there are markers


def tidy(ax: Axes, xlabel: str, ylabel: str) -> None:
    """Names the axes, and leaves no more lines than are needed."""
    ax.set_xlabel(literal(xlabel), fontsize=TYPE)
    ax.set_ylabel(literal(ylabel), fontsize=TYPE)
    ax.tick_params(labelsize=SMALL)
    if isinstance(formatter := ax.yaxis.get_major_formatter(), ScalarFormatter):
        # A power of ten would stand above the axis, where the legend begins.
        formatter.set_useOffset(False)
        formatter.set_powerlimits((-6, 9))
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(alpha=0.25, lw=0.6)
    ax.set_axisbelow(True)


def legend(ax: Axes, **options: Any) -> None:
    """The legend of what was drawn under a label, above the axes, where it hides nothing.

    A curve that cannot be seen has no mark there, and the legend says why. Of more than `MOST_NAMED` curves it
    names the first ones, and says how many there are besides.

    Args:
        ax: where curves were drawn, with the limits that it is to have.
        options: as in `Axes.legend`.
    """
    handles, labels = ax.get_legend_handles_labels()
    low, high = sorted(ax.get_ylim())
    blank = Line2D([], [], ls="none")
    for i, handle in enumerate(handles):
        y = np.asarray(handle.get_ydata(), float) if isinstance(handle, Line2D) else np.empty(0)
        seen = y[np.isfinite(y)]
        if y.size and not seen.size:
            handles[i], labels[i] = blank, f"{labels[i]} (no value)"
        elif y.size and not (seen.min() <= high and seen.max() >= low):
            handles[i], labels[i] = blank, f"{labels[i]} (off the scale)"
    if len(labels) > MOST_NAMED:
        more = len(labels) - MOST_NAMED + 1
        handles, labels = [*handles[:-more], blank], [*labels[:-more], f"and {more} more"]
    wide = room(ax)
    longest = max(int(wide / (CHARACTER * SMALL)) - 6, 12)  # characters in a line, beside the mark
    labels = [textwrap.fill(label, longest, break_on_hyphens=False) for label in labels]
    columns = max(1, int(wide / (width_of(labels) + 4.5 * SMALL)))
    columns = -(-len(labels) // -(-len(labels) // columns)) if labels else 1  # of equal height
    style: dict[str, Any] = {"fontsize": SMALL, "frameon": False, "borderpad": 0.2, "borderaxespad": 0}
    spaces: dict[str, Any] = {
        "handlelength": 1.8,
        "handletextpad": 0.6,
        "columnspacing": 1.2,
        "labelspacing": 0.3,
    }
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0, 1.01), "ncols": columns}
    ax.legend(handles, labels, **{**style, **spaces, **place, **options})


def room(ax: Axes) -> float:
    """About how wide axes will be, points: a part of the figure, without the names beside the axes."""
    figure: Any = ax.figure
    width = 72 * figure.get_figwidth()
    if (spec := ax.get_subplotspec()) is None:
        return width * ax.get_position().width
    ratios: Any = spec.get_gridspec().get_width_ratios()
    return width * sum(ratios[i] for i in spec.colspan) / sum(ratios) - 6 * SMALL


def width_of(texts: Iterable[str]) -> float:
    """How wide the widest line of texts of the size `SMALL` is, points."""
    font = FontProperties(size=SMALL)
    lines = {line for text in texts for line in text.split("\n")}
    with _any_character():
        widths = [text_to_path.get_text_width_height_descent(line, font, False)[0] for line in lines]
    return max(widths, default=0)


def literal(text: str) -> str:
    """`text` such that Matplotlib shows each of its characters.

    It would take what stands between two dollars for a formula, and leave out of legends what begins with an
    underscore.
    """
    shown = text.replace("$", r"\$")
    return f"\u200b{shown}" if shown.startswith("_") else shown  # a space of no width


def _wrapped(text: str, longest: int) -> str:
    """`text` in lines of at most so many characters, broken between settings and not within."""
    lines = text.replace(" = ", "\xa0=\xa0").splitlines()
    wrapped = (textwrap.wrap(line, longest, break_on_hyphens=False) for line in lines)
    return "\n".join(itertools.chain(*wrapped)).replace("\xa0", " ")


def axes_title(ax: Axes, text: str) -> None:
    """A title over axes, in as many lines as it needs."""
    longest = int(room(ax) / (CHARACTER * TYPE))
    ax.set_title(literal(_wrapped(text, longest)), fontsize=TYPE)


def color_bar(
    image: Any,
    axes: Sequence[Axes] | np.ndarray,
    what: str = "value",
    below: bool = False,
    length: float = 0.8,
) -> Colorbar:
    """A scale that says what the colours of `image` stand for, beside `axes` or below them."""
    figure, location = image.figure, "bottom" if below else "right"
    if isinstance(layout := figure.get_layout_engine(), Layout):
        bar = figure.colorbar(image, cax=figure.add_axes((0, 0, 1, 1)), location=location)
        layout.bars[bar.ax] = list(axes), location, length
    else:
        bar = figure.colorbar(image, ax=list(axes), location=location, shrink=length)
    bar.set_label(what, fontsize=TYPE)
    bar.ax.tick_params(labelsize=SMALL)
    return bar


def ink_on(color: Any) -> str:
    """The colour of text on a colour (r, g, b, ...), from 0 to 1: that of the two which has more contrast."""
    rgb = np.asarray(color[:3], float)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    light = linear @ (0.2126, 0.7152, 0.0722)  # the relative luminance of WCAG 2.1
    return INK if light > 0.2 else "white"


def line_styles() -> Iterable[dict[str, Any]]:
    """Colours with markers, and with another dash when all colours have been: no two of the first 84 are alike."""
    for i in itertools.count():
        dash = DASHES[i // len(COLORS) % len(DASHES)]
        yield {"color": COLORS[i % len(COLORS)], "marker": MARKERS[i % len(MARKERS)], "ls": dash}


class InCell(Text):
    """A text that keeps to its part of a cell, whatever the size of the figure.

    Cells are squares of the width 1 in the units of the axes. Where the text would be too small to be read it is
    left out.

    Args:
        x, y: its middle.
        text: what it says.
        part: of a cell, which it keeps to: of its width, and of its height.
        longest: how many characters a line of other texts has, which are to be as large.
        style: as of any text.
    """

    def __init__(
        self, x: float, y: float, text: str, part: tuple[float, float], longest: int = 0, **style: Any
    ) -> None:
        super().__init__(x, y, text, ha="center", va="center", **style)
        lines = self.get_text().split("\n")
        # What a font size of 1 point is, of cells of 1 point.
        self._sizes = (part[0] / (DIGIT * max(longest, *map(len, lines))), part[1] / (1.2 * len(lines)))
        self._largest = self.get_fontsize()

    def _fit(self) -> bool:
        """Takes the size that fits, and returns whether it can be read."""
        ax: Any = self.axes
        (x0, y0), (x1, y1) = ax.transData.transform([(0, 0), (1, 1)])
        points = 72 / ax.figure.dpi
        fits = min(self._sizes[0] * abs(x1 - x0), self._sizes[1] * abs(y1 - y0)) * points
        self.set_fontsize(min(self._largest, fits))
        return bool(fits >= LEAST)

    def draw(self, renderer: Any) -> None:
        if self._fit():
            super().draw(renderer)

    def get_window_extent(self, *arguments: Any, **options: Any) -> Any:
        self._fit()
        return super().get_window_extent(*arguments, **options)


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


def canvas(width: float, height: float | None = None) -> Figure:
    """An empty figure of so many inches; by default it will be as high as what is drawn in it needs."""
    return _Canvas((width, height or width), dpi=DPI, layout=Layout(fixed=height is not None))


def lay_out(figure: Figure) -> None:
    """Gives everything in a figure its place, once: saving it would draw it all to find the places, and again."""
    if engine := figure.get_layout_engine():
        with _any_character():
            engine.execute(figure)
        figure.set_layout_engine("none")


def head(figure: Figure, text: str, seeds: int | None = None) -> None:
    """The title of a whole figure; in a line of its own over how many seeds its means and intervals are."""
    over = "" if seeds is None else f"\nmean and pointwise 95% interval over {seeds} seeds"
    longest = int(LINE * figure.get_figwidth() / WIDTH)
    figure.suptitle(literal(_wrapped(text + over, longest)), fontsize=TITLE)


def exact_line(ax: Axes, value: float, label: str, **line: Any) -> None:
    """A level line for what is exact, named in the legend; it is drawn as `line` says, dashed by default."""
    ax.axhline(value, label=label, **{"color": INK, "ls": "--", "lw": 1.2} | line)
