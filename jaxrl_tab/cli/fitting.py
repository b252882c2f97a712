"""Tables that a narrow window has no room for: some of their columns are left out, and named."""

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.printed import print_table

if TYPE_CHECKING:
    from jaxrl_tab.stats.tasks import Tasks


def print_fitting(
    out: Console, table: Callable[[list[int]], Table], names: Sequence[str], narrow: Sequence[int]
) -> None:
    """Prints a table with as many columns as there is room for.

    Args:
        out: where to.
        table: makes it of the columns of these numbers.
        names: of all columns.
        narrow: the columns that a narrow window leaves out, in this order.
    """
    shown, left_out = list(range(len(names))), []
    for column in narrow:
        if table(shown).__rich_measure__(out, out.options).maximum <= out.width:
            break
        shown.remove(column)
        left_out.append(names[column])
    print_table(out, table(shown))
    if left_out:
        out.print(f"In a wider window the table has: {'; '.join(dict.fromkeys(left_out))}.", markup=False)


def print_over_tasks(
    out: Console, tasks: "Tasks", beside: str | None = None, new: Collection[str] = ()
) -> None:
    """Prints methods over several environments; those that are `new` stand out.

    Args:
        out: where to.
        tasks: the methods.
        beside: the method with which the others are compared, or the first.
        new: the names of methods, as they are shown.
    """
    from jaxrl_tab.show import over_tasks  # here, for it imports xarray and the statistics

    names, rows = over_tasks.head(tasks, beside), over_tasks.rows(tasks, beside)

    def table(shown: list[int]) -> Table:
        view = Table(*(names[i] for i in shown))
        for column in view.columns[1:]:
            column.justify = "right"
        for row in rows:
            view.add_row(*(escape(row[i]) for i in shown), style="bold" if row[0] in new else None)
        return view

    out.print(f"[bold]over {tasks.scores.sizes['environment']} environments[/]")
    print_fitting(out, table, names, (6, 2, 4))
