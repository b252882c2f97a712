"""How far something is: one kind of report everywhere, and a bar where a person looks on.

`sweep`, `run`, `resume` and the commands report in the same way. A person looks on where stderr is a terminal,
and in a notebook.
"""

import contextlib
import datetime
import html
import sys
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple, TypeAlias

from jaxrl_tab.core.errors import InputError, shown


class Progress(NamedTuple):
    """How far a sweep or an experiment is.

    Attributes:
        label: what is under way: a method in an environment, or what is written.
        done, total: runs.
        steps: steps taken since it began, or was resumed.
        seconds: the time since then.
        left: how many more seconds it will take, about; None where nothing can be said yet.
        diverged: runs in which a number became infinite or NaN, or grew beyond any possible return; of a sweep
            they are counted when it is over.
    """

    label: str
    done: int = 0
    total: int = 0
    steps: int = 0
    seconds: float = 0.0
    left: float | None = None
    diverged: int = 0

    @property
    def details(self) -> str:
        """The numbers beside a bar, in words."""
        parts = ["runs"]
        if self.steps:
            parts.append(f"{self.steps / self.seconds / 1e6:.1f} million steps/s")
        if self.left and self.done < self.total:
            parts.append(f"{datetime.timedelta(seconds=round(self.left))} left")
        if self.diverged:
            parts.append(f"{self.diverged} diverged")
        return ", ".join(parts)


Report: TypeAlias = Callable[[Progress], None]


@contextlib.contextmanager
def reporting(progress: Report | Literal[False] | None) -> Iterator[Report]:
    """A function to call with each `Progress`, within the block.

    Args:
        progress: that function itself; None for a bar where a person looks on; False for neither.

    Raises:
        InputError: it is something else.
    """
    if callable(progress):
        yield progress
    elif progress is not None and progress is not False:
        raise InputError(
            f"progress must be a function of a Progress, or False for no bar, not {shown(progress)}"
        )
    elif progress is None and _in_notebook():
        with _notebook_bar() as report:
            yield report
    elif progress is None and sys.stderr is not None and sys.stderr.isatty():
        with _terminal_bar() as report:
            yield report
    else:
        yield lambda state: None


def _in_notebook() -> bool:
    """Whether this is the kernel of a notebook. (A terminal with IPython is a terminal.)"""
    ipython = sys.modules.get("IPython")
    shell = ipython and ipython.get_ipython()  # pyright: ignore[reportAttributeAccessIssue]
    return shell is not None and hasattr(shell, "kernel")


@contextlib.contextmanager
def _notebook_bar() -> Iterator[Report]:
    """A bar below the cell, which the browser draws. It goes away at the end, and is not saved with the notebook."""
    from IPython.display import HTML, display

    handle: Any = display(HTML(""), display_id=True)

    def report(state: Progress) -> None:
        bar = f'<progress value="{state.done}" max="{max(state.total, 1)}"></progress>'
        text = html.escape(f"{state.label} {state.done}/{state.total} {state.details}")
        handle.update(HTML(f"{bar} {text}"))

    try:
        yield report
    finally:
        handle.update(HTML(""))


@contextlib.contextmanager
def _terminal_bar() -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[details]}", markup=False),
        TimeElapsedColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        bar = bars.add_task("planning", total=None, details="runs")
        yield lambda state: bars.update(
            bar,
            description=state.label,
            completed=state.done,
            total=state.total or None,
            details=state.details,
        )
