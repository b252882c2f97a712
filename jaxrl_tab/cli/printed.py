"""Tables in a window, whatever its width."""

from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text


def print_table(out: Console, table: Table) -> None:
    """Prints a table with a row for each thing, whatever the width of the window: no number and no name is cut.

    Where its columns cannot be as wide as their longest words, the rows come one after another, each cell behind its
    heading.
    """
    columns = [[_plain(text) for text in (column.header, *column.cells)] for column in table.columns]
    longest = lambda parts: max(map(cell_len, parts), default=1)
    widths = [longest([word for text in texts for word in text.split()]) for texts in columns]
    wanted = [longest([line for text in texts for line in text.splitlines()]) for texts in columns]
    room = out.width - 1 - 3 * len(columns)  # a line, and a blank on both sides of it
    if sum(widths) > room:
        _print_rows(out, table, [" ".join(texts[0].split()) for texts in columns])
        return
    for _ in range(min(room, sum(wanted)) - sum(widths)):
        lacking = [most - width for most, width in zip(wanted, widths, strict=True)]
        widths[lacking.index(max(lacking))] += 1
    for column, width in zip(table.columns, widths, strict=True):
        column.width = width
    out.print(table)


def _print_rows(out: Console, table: Table, headings: list[str]) -> None:
    if table.title:
        out.print(table.title)
    for first, *cells in zip(*(column.cells for column in table.columns), strict=True):
        out.print(first)
        for heading, cell in zip(headings[1:], cells, strict=True):
            if _plain(cell):
                out.print(f"  {escape(heading)}: {cell}".replace("\n", " "))
    if table.caption:
        out.print(table.caption)


def _plain(text: Any) -> str:
    return Text.from_markup(str(text), emoji=False).plain  # `harmonic:100:visit` holds none
