"""Where everything in a figure lies: worked out from the sizes of its texts, without Matplotlib's own engine.

That solves equations for figures of any kind, and takes several times as long.
"""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator
from matplotlib.transforms import Bbox

EDGE, GAP = 0.05, 0.14  # inches: around everything, and between neighbours
BAR = 0.1  # inches: how thick the scale of colours is
SHAPE, TALLEST = 0.68, 8.0  # of axes: their height for a width of 1, and their height in inches at most
APART = 3.0  # points between the texts of an axis


class Need(NamedTuple):
    """The room on each side of axes for what belongs to them, inches."""

    left: float
    right: float
    below: float
    above: float


USUAL = Need(left=0.55, right=0.1, below=0.45, above=0.4)


class Layout(LayoutEngine):
    """Axes in the rows and columns of one grid, below the title of the whole figure.

    Axes in which both units are as long keep their shape. What belongs to the axes, such as titles, legends and
    the names of ticks, gets as much room as it needs. Names of ticks that would run into one another are left out.

    Attributes:
        fixed: whether the figure keeps its height; by default it is as high as its rows need.
        bars: the scales of colours by their axes: beside or below which axes they lie, how long they are.
    """

    _adjust_compatible = False
    _colorbar_gridspec = False

    def __init__(self, fixed: bool) -> None:
        super().__init__()
        self.fixed = fixed
        self.bars: dict[Axes, tuple[Sequence[Axes], str, float]] = {}

    def execute(self, fig: Figure) -> None:  # the name of the argument is Matplotlib's
        axes = [ax for ax in fig.axes if ax.get_subplotspec() and ax not in self.bars]
        if not axes:
            return
        for ax in axes:
            _lift_title(ax, fig)
        renderer = fig._get_renderer()  # pyright: ignore[reportAttributeAccessIssue]
        self._place(fig, axes, renderer, dict.fromkeys((*axes, *self.bars), USUAL))
        for _ in range(2):  # what texts need depends a little on what is left for the axes
            before = [ax.get_position(original=True).size * fig.get_size_inches() for ax in axes]
            self._place(fig, axes, renderer, {ax: _need(ax, renderer, fig) for ax in (*axes, *self.bars)})
            after = [ax.get_position(original=True).size * fig.get_size_inches() for ax in axes]
            wrapped = [_wrap_label(ax, size[1], renderer) for ax, size in zip(axes, after, strict=True)]
            if not any(wrapped) and np.allclose(before, after, rtol=0.1):
                break
        for ax in (*axes, *self.bars):
            if ax.axison and ax.name == "rectilinear":
                for axis in (ax.xaxis, ax.yaxis):
                    _thin_out(axis, fig)

    def _place(self, figure: Figure, axes: Sequence[Axes], renderer: Any, needs: Mapping[Axes, Need]) -> None:
        """Gives all axes their places, with the room that what belongs to them needs."""
        width, height = figure.get_size_inches()
        spec: Any = axes[0].get_subplotspec()
        shape = spec.get_gridspec().get_geometry()
        left, right = np.zeros((2, shape[1]))
        top, bottom = np.zeros((2, shape[0]))
        for ax in axes:
            rows, columns = _span(ax)
            left[columns.start] = max(left[columns.start], needs[ax].left)
            right[columns.stop - 1] = max(right[columns.stop - 1], needs[ax].right)
            bottom[rows.stop - 1] = max(bottom[rows.stop - 1], needs[ax].below)
            top[rows.start] = max(top[rows.start], needs[ax].above)
        for bar, (beside, location, _) in self.bars.items():
            rows, columns = zip(*map(_span, beside), strict=True)
            if location == "bottom":
                bottom[max(rows, key=lambda span: span.stop).stop - 1] += GAP / 2 + BAR + needs[bar].below
            else:
                right[max(columns, key=lambda span: span.stop).stop - 1] += GAP / 2 + BAR + needs[bar].right
        head = sum(_size(text, renderer, figure)[1] + GAP / 2 for text in figure.texts)

        widths = _shares(spec.get_gridspec().get_width_ratios(), width - 2 * EDGE, left + right)
        if self.fixed:
            heights = _shares(spec.get_gridspec().get_height_ratios(), height - head - 2 * EDGE, top + bottom)
        else:
            heights = np.zeros(shape[0])
            for ax in axes:
                rows, columns = _span(ax)
                own = sum(widths[columns]) * (ax.get_data_ratio() if ax.get_aspect() == 1 else SHAPE)
                heights[rows] = np.maximum(heights[rows], min(own, TALLEST) / (rows.stop - rows.start))
            height = head + 2 * EDGE + float((top + heights + bottom).sum()) + GAP * (len(heights) - 1)
            figure.set_size_inches(width, height)
        x = EDGE + np.cumsum(np.append(0, (left + widths + right + GAP)[:-1])) + left
        y = height - head - EDGE - np.cumsum(np.append(0, (top + heights + bottom + GAP)[:-1])) - top
        for ax in axes:
            rows, columns = _span(ax)
            high, low = y[rows.start], y[rows.stop - 1] - heights[rows.stop - 1]
            first, last = x[columns.start], x[columns.stop - 1] + widths[columns.stop - 1]
            box: Any = Bbox([[first / width, low / height], [last / width, high / height]])
            ax.set_position(box)
            ax.set_anchor("N")
            ax.apply_aspect()
        for bar, (beside, location, length) in self.bars.items():
            # Three dimensions are drawn in a square, but their texts are measured from the whole place.
            box = Bbox.union([ax.get_position(original=ax.get_aspect() != 1) for ax in beside])
            if location == "bottom":
                low = box.y0 - (max(needs[ax].below for ax in beside) + GAP / 2 + BAR) / height
                at: Any = [box.x0 + (1 - length) / 2 * box.width, low, length * box.width, BAR / height]
            else:
                first = box.x1 + (max(needs[ax].right for ax in beside) + GAP / 2) / width
                at = [first, box.y0 + (1 - length) / 2 * box.height, BAR / width, length * box.height]
            bar.set_position(at)
        down = EDGE
        for text in figure.texts:
            text.set(x=0.5, y=1 - down / height, va="top", ha="center")
            down += _size(text, renderer, figure)[1] + GAP / 2


def _lift_title(ax: Axes, figure: Figure) -> None:
    """Puts the title of axes above their legend, if that is above the axes."""
    if ax.get_title() and (legend := ax.get_legend()):
        box = legend.get_window_extent()
        if box.y0 >= ax.get_window_extent().y1:
            lifted = 72 * box.height / figure.dpi + 4
            ax.set_title(ax.get_title(), pad=lifted, fontsize=ax.title.get_fontsize())


def _need(ax: Axes, renderer: Any, figure: Figure) -> Need:
    """How far what belongs to axes goes beyond their place."""
    outer = ax.get_tightbbox(renderer)
    assert outer is not None
    place = ax.get_position(original=True).transformed(figure.transSubfigure)
    beyond = place.x0 - outer.x0, outer.x1 - place.x1, place.y0 - outer.y0, outer.y1 - place.y1
    return Need(*(max(0, float(x)) / figure.dpi for x in beyond))


def _span(ax: Axes) -> tuple[slice, slice]:
    """The rows and the columns in which axes lie."""
    spec: Any = ax.get_subplotspec()
    return slice(spec.rowspan.start, spec.rowspan.stop), slice(spec.colspan.start, spec.colspan.stop)


def _shares(ratios: Sequence[float], length: float, taken: np.ndarray) -> np.ndarray:
    """What is left of a length for each of some neighbours, by their ratios."""
    left = length - taken.sum() - GAP * (len(ratios) - 1)
    return max(left, 0.1) * np.asarray(ratios) / sum(ratios)


def _size(text: Text, renderer: Any, figure: Figure) -> np.ndarray:
    """Width and height, inches."""
    return np.asarray(text.get_window_extent(renderer).size) / figure.dpi


def _wrap_label(ax: Axes, height: float, renderer: Any) -> bool:
    """Breaks the name of the y axis in lines where it is longer than the axis; whether it did so."""
    label: Any = ax.yaxis.label
    text, figure = label.get_text(), ax.figure
    assert figure is not None
    lines = label.get_window_extent(renderer).height / figure.dpi / height if text and ax.axison else 0
    if "\n" in text or lines <= 1:
        return False
    label.set_text("\n".join(textwrap.wrap(text, max(12, int(len(text) / lines)), break_long_words=False)))
    return "\n" in label.get_text()


def _thin_out(axis: Axis, figure: Figure) -> None:
    """Leaves out names of ticks that run into one another."""
    locator = axis.get_major_locator()
    for _ in range(6):
        labels = [label for label in axis.get_ticklabels() if label.get_text() and label.get_visible()]
        hidden = set(_overlapping(axis, labels, figure))
        if not hidden:
            return
        if isinstance(locator, MaxNLocator):
            locator.set_params(nbins=max(1, len(labels) - 2))
        elif isinstance(locator, LogLocator):
            locator.set_params(subs=(1.0,))
        elif isinstance(locator, FixedLocator):
            names = ["" if label in hidden else label.get_text() for label in axis.get_ticklabels()]
            axis.set_ticks(axis.get_ticklocs(), labels=names)


def _overlapping(axis: Any, labels: Sequence[Text], figure: Figure) -> Iterable[Text]:
    """Those of the names of ticks that come too near to the last one that is not left out."""
    side = 0 if axis.axis_name == "x" else 1
    low, high = sorted(axis.get_view_interval())
    shown = [
        label for label in labels if low <= label.get_position()[side] <= high and not label.get_rotation()
    ]
    spans = [(label.get_window_extent().get_points()[:, side], label) for label in shown]
    end = -np.inf
    for (first, last), label in sorted(spans, key=lambda span: span[0][0]):
        if first < end:
            yield label
        else:
            end = last + (APART / 72 * figure.dpi if side == 0 else 0)
