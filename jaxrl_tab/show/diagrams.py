"""Pictures of backup diagrams."""

import math
import re
import textwrap
from collections.abc import Mapping
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Rectangle

from jaxrl_tab.algorithms.bridge import TABLE, Row
from jaxrl_tab.core.backups import ACTION, DOTS, END, MAX, STATE, Backup, Tree, labels, tree
from jaxrl_tab.show.style import CELL, CHARACTER, GREY, INK, SMALL, WIDTH, canvas, literal, width_of

# Inches, in which everything in these pictures is measured.
LEAF, LEVEL, RADIUS = 0.2, 0.32, 0.055  # between two leaves, between two levels; of a node
LINE, APART = 0.15, 0.3  # of text, from one to the next; between diagrams
EDGE, GAP = 0.1, 0.1  # around everything; between a diagram and what is over, under or beside it
BOLD = 1.12  # times as wide as other type
WORDS, BELOW = 1.5, 0.125  # how wide words below a diagram are at least; from one line of them to the next
ARC = 0.55  # of the way from a node to its children: where the arc is that says that the largest one counts
FILLS = {STATE: "white", ACTION: INK, END: "#bbbbbb"}


class Piece(NamedTuple):
    """A diagram and the room that it takes, inches.

    Attributes:
        title: its lines, as Matplotlib takes them.
        columns: of each its weight, its tree or None where it is left out, and the place of its root from the left.
        notes: what stands beside its levels; none where there are several columns.
        notes_at: where they begin, from the left.
        words: below it, in lines.
        width, height: of all of it, the words included.
    """

    title: list[str]
    columns: list[tuple[str, Tree | None, float]]
    notes: list[str]
    notes_at: float
    words: list[str]
    width: float
    height: float


def backups(drawn: Mapping[str, Backup], *, width: float = WIDTH) -> Figure:
    """Backup diagrams side by side, in as many rows as they need (book, figures 3.4 to 12.12).

    Open circles are states, solid ones are actions, a square is the end of an episode; an arc says that the largest
    of what is below it counts, branches without an arc that their mean does. Below it is what it does not show.

    Args:
        drawn: the title over each diagram, which may have several lines, and the diagram.
        width: of the figure at most, inches.
    """
    rows: list[list[Piece]] = [[]]
    for piece in (_piece(title, backup) for title, backup in drawn.items()):
        if rows[-1] and sum(other.width + APART for other in rows[-1]) + piece.width > width - 2 * EDGE:
            rows.append([])
        rows[-1].append(piece)
    return _figure(rows)


def bridge() -> Figure:
    """The lecture's table of dynamic programming beside temporal differences: a row for each Bellman equation."""
    pieces = [_sides(row) for row in TABLE]
    widths = [max(piece.width for piece in side) for side in zip(*pieces, strict=True)]
    return _figure(
        [[piece._replace(width=w) for piece, w in zip(row, widths, strict=True)] for row in pieces]
    )


def _sides(row: Row) -> list[Piece]:
    """The full backup and the sample backup of a row."""
    full = _piece(f"{row.equation}\n{row.full}, a full backup\n{row.full_update}", row.full_diagram)
    sample = _piece(f" \n{row.sample}, a sample backup\n{row.sample_update}", row.sample_diagram)
    return [piece._replace(title=list(map(_formula, piece.title))) for piece in (full, sample)]


def _formula(text: str) -> str:
    """A formula of the table as the lecture sets it."""
    symbols = {
        "<-alpha-": r"$\overset{\alpha}{\leftarrow}$",
        "<-": "←",
        "gamma": "γ",
        "_pi": r"$_\pi$",
        "_a'": "$_{a'}$",
        "q*": "q$_*$",
    }
    for typed, symbol in symbols.items():
        text = text.replace(typed, symbol)
    return text


def _figure(rows: list[list[Piece]]) -> Figure:
    """The diagrams in rows, in a figure that is as large as they are."""
    heights = [max(piece.height for piece in row) for row in rows]
    height = sum(heights) + APART * (len(rows) - 1) + 2 * EDGE
    width = max(sum(piece.width + APART for piece in row) for row in rows) - APART + 2 * EDGE
    figure = canvas(width, height)
    figure.set_layout_engine("none")
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, width), ylim=(height, 0))
    ax.set_axis_off()
    y = EDGE
    for row, tallest in zip(rows, heights, strict=True):
        x = EDGE
        for piece in row:
            _draw(ax, piece, x, y)
            x += piece.width + APART
        y += tallest + APART
    return figure


def _piece(title: str, backup: Backup) -> Piece:
    """What there is to draw, and how large it is."""
    columns, at, deepest = [], 0.0, 0
    for weight, levels in backup.levels.items():
        root = tree(levels) if levels else None
        half = max(_reach(root) * LEAF + RADIUS if root else 0, _width(weight) / 2)
        at += half + (GAP if columns else 0)
        columns.append((weight, root, at))
        at, deepest = at + half, max(deepest, len(levels) - 1)
    notes = labels(next(iter(backup.levels.values()))) if len(columns) == 1 else []
    beside = GAP + max(map(_width, notes)) if notes else 0
    lines = title.split("\n")
    width = max(at + GAP + beside, BOLD * _width(lines[0]), *map(_width, lines))
    width = max(width, WORDS if backup.words else 0)
    words = textwrap.wrap(backup.words, int(1.2 * 72 * width / (CHARACTER * CELL)), break_on_hyphens=False)
    above = LINE * (len(lines) + (not notes)) + GAP
    height = above + LEVEL * deepest + 2 * RADIUS + (GAP + BELOW * len(words) if words else 0)
    return Piece(list(map(literal, lines)), columns, notes, at + GAP, words, width, height)


def _draw(ax: Axes, piece: Piece, x: float, y: float) -> None:
    bottom = y + piece.height
    for number, line in enumerate(reversed(piece.words)):
        ax.text(x, bottom - BELOW * number, _words(line), fontsize=CELL, color=GREY, va="bottom")
    for number, line in enumerate(piece.title):
        weight = "bold" if number == 0 else "normal"
        ax.text(x, y + 0.75 * LINE, line, fontsize=SMALL, weight=weight, color=INK)
        y += LINE
    if len(piece.columns) > 1:
        for weight, _, at in piece.columns:
            ax.text(
                x + at, y + LINE / 2, _weight(weight), fontsize=SMALL, color=INK, ha="center", va="center"
            )
        y += LINE
    y += GAP + RADIUS
    for _, root, at in piece.columns:
        if root:
            _tree(ax, root, x + at, y)
    for depth, note in enumerate(piece.notes):
        ax.text(x + piece.notes_at, y + LEVEL * depth, _note(note), fontsize=CELL, color=INK, va="center")


def _tree(ax: Axes, node: Tree, x: float, y: float) -> None:
    """Draws a node and all that is below it; the root is at (x, y)."""
    at, down = x + LEAF * node.x, y + LEVEL * node.depth
    ends = [(x + LEAF * child.x, down + LEVEL) for child in node.children]
    for end, child in zip(ends, node.children, strict=True):
        if DOTS not in (node.node, child.node):
            ax.plot([at, end[0]], [down, end[1]], color=INK, lw=0.9, zorder=1)
        _tree(ax, child, x, y)
    if node.over == MAX:
        left, right = (math.degrees(math.atan2(ey - down, ex - at)) for ex, ey in (ends[0], ends[-1]))
        size = 2 * ARC * LEVEL
        ax.add_patch(Arc((at, down), size, size, theta1=right, theta2=left, color=INK, lw=0.9))
    style: dict[str, Any] = {"ec": INK, "lw": 0.9, "zorder": 2}
    if node.node == DOTS:
        for offset in (-0.07, 0, 0.07):
            ax.add_patch(Circle((at, down + offset), 0.012, fc=INK, ec="none"))
    elif node.node == END:
        ax.add_patch(Rectangle((at - RADIUS, down - RADIUS), 2 * RADIUS, 2 * RADIUS, fc=FILLS[END], **style))
    else:
        ax.add_patch(Circle((at, down), RADIUS, fc=FILLS[node.node], **style))


def _reach(node: Tree) -> float:
    """How far the nodes are from the middle, in distances between leaves."""
    return max([abs(node.x), *map(_reach, node.children)])


def _width(text: str) -> float:
    """How wide a line of text is, inches."""
    return width_of([re.sub(r"[_^]", "", text)]) / 72


def _weight(text: str) -> str:
    """A weight as the book sets it: "λ^(n−1)" has an exponent. Words may stand before it; what else is in it stays."""
    words, formula = re.fullmatch(r"((?:[a-z]{2,} )*)(.*)", text).groups()  # pyright: ignore[reportOptionalMemberAccess]
    if text == DOTS:
        return r"$\cdots$"
    if not re.fullmatch(r"(?:[\w()+−./ ²]|\^\([^()^]*\))+", formula) or "_" in formula:
        return literal(text)
    formula = re.sub(r"\^\(([^)]*)\)", r"^{\1}", formula).replace("²", "^2").replace("λ", r"\lambda ")
    return f"{words}${formula}$"


def _note(text: str) -> str:
    """Symbols and indices as the book sets them: "S_t+1" is an S with an index."""
    return re.sub(r"\b([SARasr])(_\w(?:[+-]\w+)*|'*)(?!\w)", lambda m: f"${m[1]}{_index(m[2])}$", text)


def _words(text: str) -> str:
    return re.sub(r"\b([SAR])(_\w(?:[+-]\w+)*)", lambda m: f"${m[1]}{_index(m[2])}$", literal(text))


def _index(text: str) -> str:
    return f"_{{{text[1:]}}}" if text.startswith("_") else text
