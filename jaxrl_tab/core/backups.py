"""Backup diagrams: what an update of a method looks ahead to, as data and as text (book, sections 3.5 to 12.1).

Open circles are states, solid ones are actions, a square is the end of an episode. A method declares its own:

    backup = Backup("action, state, max action")      # of Q-learning: print(QLearning.backup)

Neither NumPy nor JAX is imported: the command line shows the diagrams before that.
"""

import textwrap
from collections.abc import Mapping
from typing import NamedTuple

from jaxrl_tab.core.errors import InputError, check_choice, shown

STATE, ACTION, END, DOTS = "state", "action", "end", "..."
NODES = {STATE: "○", ACTION: "●", END: "□", DOTS: "⋮"}
EACH, MAX = "each", "max"
SLOT = 4  # characters between two leaves
WIDEST = 88  # characters of a line of words


class Level(NamedTuple):
    """A level of a diagram.

    Attributes:
        node: what stands there: "state", "action", "end", or "..." for steps that are left out.
        over: how many there are: one that is drawn (empty), or all of them, of which the update takes the mean by
            their probabilities ("each") or the largest value ("max").
    """

    node: str
    over: str = ""


class Tree(NamedTuple):
    """A node of a diagram with all that is below it.

    Attributes:
        node: as in `Level`.
        over: as in the level of its children; empty where it has none.
        x: where it is from left to right, in distances between leaves; the root is at 0.
        depth: how many levels are above it.
        children: from left to right.
    """

    node: str
    over: str
    x: float
    depth: int
    children: tuple["Tree", ...]


class Backup(NamedTuple):
    """A backup diagram.

    Attributes:
        columns: the levels from the root down, separated by commas: "state", "action", or "end", with "each" before it
            where the update takes the mean over all of them by their probabilities, and "max" where it takes the
            largest value; what has neither is drawn. "..." stands for steps that are left out. After "each" or "max"
            all branches go on where the next level is for all of them again, as in dynamic programming; else only the
            one that was taken does. Of several columns, of which a method takes a weighted mean, a mapping from the
            weight of each, in words, to its levels; "..." to "" for columns that are left out.
        words: what the diagram does not show, in whole sentences.
    """

    columns: str | Mapping[str, str]
    words: str = ""

    @property
    def levels(self) -> dict[str, tuple[Level, ...]]:
        """The levels of each column by its weight, which is empty for the only one; those left out have none.

        Raises:
            InputError: the columns are not written as they should be.
        """
        columns = self.columns if isinstance(self.columns, Mapping) else {"": self.columns}
        return {weight: () if weight == DOTS else _levels(text) for weight, text in columns.items()}

    def __str__(self) -> str:
        words = textwrap.wrap(self.words, WIDEST, break_on_hyphens=False)
        return "\n".join([*self.diagram(), *[""] * bool(words), *words])

    def diagram(self) -> list[str]:
        """The lines of the diagram as text, without its words."""
        columns = self.levels
        if len(columns) == 1:
            (levels,) = columns.values()
            lines = _drawn(levels)
            width = max(map(len, lines)) + 3
            notes = dict(zip(_rows(levels), labels(levels), strict=True))
            return [f"{line:{width}}{notes.get(row, '')}".rstrip() for row, line in enumerate(lines)]
        blocks = [[weight, "", *(_drawn(levels) if levels else [])] for weight, levels in columns.items()]
        widths = [max(map(len, block)) for block in blocks]
        height = max(map(len, blocks))
        for block, width in zip(blocks, widths, strict=True):
            drawn = max(map(len, block[1:]))
            block[0] = f"{block[0]:^{width}}"
            block[1:] = [" " * ((width - drawn) // 2) + line for line in block[1:]]
            block += [""] * (height - len(block))
        rows = zip(*blocks, strict=True)
        return ["   ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def lambda_return(first: str, step: str, last: str = "") -> dict[str, str]:
    """The columns of a mean over all n-step returns, with the weights (1 - lambda) lambda^(n-1).

    Args:
        first: the root.
        step: the levels of one step more.
        last: those of the last step before a value is looked up, where that is not like the others.
    """
    weights, more = ("1 − λ", "(1 − λ) λ", "(1 − λ) λ²"), f"{first}, {step}"
    columns = {w: ", ".join([first, *[step] * k, last or step]) for k, w in enumerate(weights)}
    return columns | {DOTS: "", "λ^(T−t−1)": f"{more}, {DOTS}, {END}"}


def checked(who: str, backup: "Backup | str | None") -> Backup | None:
    """What the method `who` declares as its diagram. Raises InputError where it is none."""
    backup = Backup(backup) if isinstance(backup, str) else backup
    if backup is None:
        return None
    if not isinstance(backup, Backup):
        raise InputError(f"backup must be a Backup, or its levels as text, not {shown(backup)}", who=who)
    try:
        _ = backup.levels
    except InputError as error:
        raise error.renamed(who, "backup") from None
    return backup


def _levels(text: str) -> tuple[Level, ...]:
    levels = []
    for part in text.split(","):
        over, _, node = part.strip().rpartition(" ")
        check_choice(None, "the level", node, NODES)
        if over:
            check_choice(None, f"before {node!r}", over, (EACH, MAX))
        levels.append(Level(node, over))
    nodes = [level.node for level in levels]
    follows = {STATE: (ACTION, DOTS), ACTION: (STATE, END, DOTS), DOTS: (STATE, ACTION, END), END: ()}
    for before, node in zip([None, *nodes], [*nodes, None], strict=False):
        wrong = node not in (STATE, ACTION) if before is None else node and node not in follows[before]
        if wrong or (node is None and before == DOTS):
            raise InputError(f"in {shown(text)} states and actions must take turns, and begin and end it")
    singles = [levels[0], *(level for level in levels if level.node in (END, DOTS))]
    if any(level.over for level in singles) or nodes.count(DOTS) > 1:
        raise InputError(f"in {shown(text)} there can be one root, one end, and one '...' only")
    if len(levels) == 1:
        raise InputError(f"{shown(text)} is the root alone: what does it look ahead to?")
    return tuple(levels)


# --- what stands beside it -----------------------------------------------------------------------------
def labels(levels: tuple[Level, ...]) -> list[str]:
    """What each level is, in the symbols of the book: "S, A", "R, S'", "max over a'"; "_t+1" is an index."""
    steps = [level.node in (STATE, END) for level in levels]
    steps[0] = False  # how it begins is no step
    is_full = all(level.over for level in levels[1:])
    dots = [level.node for level in levels].index(DOTS) if Level(DOTS) in levels else None
    found = []
    for i, level in enumerate(levels):
        after = sum(steps[: i + 1])
        if sum(steps) <= 1 and dots is None:
            index = "'" * after
        elif level.node == END:
            index = "_T"
        elif dots is not None and i > dots:
            back = sum(steps[i + 1 :])
            index = "_t+n" + (f"-{back}" if back else "")
        else:
            index = f"_t+{after}" if after else "_t"
        found.append(_label(level, index, i == 0, is_full))
    return found


def _label(level: Level, index: str, is_root: bool, is_full: bool) -> str:
    if level.node == DOTS:
        return ""
    if level.node == END:
        return f"R{index}, the end"
    if is_root:
        root = f"S{index}" if level.node == STATE else f"S{index}, A{index}"
        return root.lower() if is_full else root
    if level.node == STATE:
        reward = f"R{index.replace(chr(39), '')}"  # the book writes R, S'
        text = f"{reward}, S{index}"
    else:
        text = f"A{index}"
    if level.over:
        by = "" if level.over == MAX else ", by π" if level.node == ACTION else ", by p"
        return f"{'max' if level.over == MAX else 'mean'} over {text.lower()}{by}"
    return text


# --- where everything is -------------------------------------------------------------------------------
def tree(levels: tuple[Level, ...]) -> Tree:
    """The nodes of a column, each in its place."""
    return _grow(levels, 0.0, 0)


def _grow(levels: tuple[Level, ...], x: float, depth: int) -> Tree:
    head, *rest = levels
    if not rest:
        return Tree(head.node, "", x, depth, ())
    below = tuple(rest)
    count, apart = _fan(below)
    children = []
    for i in range(count):
        goes_on = count == 1 or _all_go_on(below) or i == count // 2
        offset = (i - (count - 1) / 2) * apart
        children.append(_grow(below if goes_on else below[:1], x + offset, depth + 1))
    return Tree(head.node, rest[0].over, x, depth, tuple(children))


def _all_go_on(levels: tuple[Level, ...]) -> bool:
    """Whether below each node of the first of these levels there is the next one."""
    return len(levels) > 1 and bool(levels[1].over)


def _fan(levels: tuple[Level, ...]) -> tuple[int, float]:
    """How many nodes of the first of these levels are side by side, and how far apart."""
    if not levels[0].over:
        return 1, 0
    return (2, _extent(levels[1:])) if _all_go_on(levels) else (3, 1)


def _extent(levels: tuple[Level, ...]) -> float:
    """How much room is needed for what is at these levels and below."""
    if not levels:
        return 1
    count, apart = _fan(levels)
    return max(count * apart, _extent(levels[1:]))


# --- as text -------------------------------------------------------------------------------------------
def _rows(levels: tuple[Level, ...]) -> list[int]:
    """The line of each level."""
    rows = [0]
    for i in range(1, len(levels)):
        count, apart = _fan(levels[i:])
        between = 0 if DOTS in (levels[i - 1].node, levels[i].node) else 1
        if count > 1 and (apart == 1 or levels[i].over == MAX):
            between = 2
        rows.append(rows[-1] + between + 1)
    return rows


def _drawn(levels: tuple[Level, ...]) -> list[str]:
    """The lines of a column."""
    root, rows = tree(levels), _rows(levels)
    marks: dict[tuple[int, int], str] = {}
    _paint(root, rows, marks)
    left = min(column for _, column in marks)
    lines = [""] * (rows[-1] + 1)
    for (row, column), mark in sorted(marks.items()):
        lines[row] = lines[row].ljust(column - left) + mark
    return lines


def _paint(node: Tree, rows: list[int], marks: dict[tuple[int, int], str]) -> None:
    """Puts a node, and all below it, into `marks`: (line, column) -> character."""

    def put(row: int, column: int, text: str) -> None:
        marks.update({(row, column + i): mark for i, mark in enumerate(text) if mark != " "})

    at, below = round(SLOT * node.x), rows[node.depth] + 1
    put(rows[node.depth], at, NODES[node.node])
    columns = [round(SLOT * child.x) for child in node.children]
    first, last = (columns[0], columns[-1]) if columns else (at, at)
    if len(columns) == 1 and DOTS not in (node.node, node.children[0].node):
        put(below, at, "│")
    elif len(columns) == 3:
        put(below, at - 2, "╱ │ ╲")
        put(below + 1, at - 3, "╱╰─┼─╯╲" if node.over == MAX else "╱  │  ╲")
    elif columns:
        put(below, first, "┌" + "─" * (last - first - 1) + "┐" if last > first else "")
        put(below, at, "┴" if last > first else "")
        if node.over == MAX:
            put(below + 1, first, "│╰" + "─" * (last - first - 3) + "╯│")
    for child in node.children:
        _paint(child, rows, marks)
