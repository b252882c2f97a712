"""What is said of a statistic: where it stands, under which heading, and how it is written."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

import xarray as xr

from jaxrl_tab.stats.along import Interval

Text = str | tuple[str, str]  # the same for control and for prediction, or one for each


def text(of: Text, prediction: bool) -> str:
    """The text for control, or that for prediction."""
    return of if isinstance(of, str) else of[prediction]


@dataclass(frozen=True)
class Column:
    """A statistic of every setting of a method: its one entry.

    Attributes:
        name: its name in a `Row`.
        value: works it out of a `columns.Method`, [*hyperparameters] or less; an `Interval` where it has one;
            None where the method has no such number.
        in_summary: its name in `summary.csv`, by default `name`; "" if it is not there. An interval has two
            columns more, which end in `_low` and `_high`.
        screen, report: its heading on the screen, and in the tables of the report; "" if it is not there.
        tables: which tables of the report have it: of the chosen settings, of their early learning, of all settings.
            That of all settings also has what the screen shows of early learning.
        by_length: whether the screen shows it only where episodes earn by their length alone (`early.by_length`), or
            only elsewhere; None: everywhere.
        continuing: whether it is shown of tasks that do not end, too.
        written: how people read it: with as many decimals as the score has, of an interval also without its
            middle ("range"), or that alone ("middle"); with six significant digits ("exact"), or a dash for −∞
            ("worth"); as a count; as steps, of which there may be none yet; a share in percent; or with one decimal.
        help: what it means, for the readers of the report; a sentence that follows the heading.
    """

    name: str
    value: Callable[[Any], Interval | xr.DataArray | float | None]
    _: KW_ONLY
    in_summary: Text | None = None
    screen: Text = ""
    report: Text = ""
    tables: tuple[Literal["chosen", "early", "all"], ...] = ("chosen", "all")
    by_length: bool | None = None
    continuing: bool = True
    written: Literal["score", "range", "middle", "exact", "worth", "count", "steps", "share", "tenths"] = (
        "score"
    )
    help: str = ""

    def on_screen(self, methods: Any) -> bool:
        """Whether the screen shows it of these `columns.Methods`, if it `tells` anything."""
        return bool(self.screen) and self.fits(methods) and self.by_length in (None, methods.by_length)

    def fits(self, methods: Any) -> bool:
        """Whether it means something in the task of these `columns.Methods`."""
        return self.continuing or not methods.continuing

    def tells(self, rows: Sequence[Any]) -> bool:
        """Whether it has anything to tell of these `columns.Row`s: a number, a count that is not 0, a share below 1."""
        numbers = [row[self.name] for row in rows if row.has(self.name)]
        if self.written == "share":
            return any(share < 1 for share in numbers)
        return any(numbers) if self.written == "count" else bool(numbers)
