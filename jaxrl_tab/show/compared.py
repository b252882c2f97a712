"""Results beside other results, in numbers, in words, and as a page."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.version import __version__
from jaxrl_tab.show import ranked
from jaxrl_tab.show.words import counted, decimals_for, in_words, number, title_of
from jaxrl_tab.stats.ranking import Ranking
from jaxrl_tab.stats.versus import FEWEST, Compared

if TYPE_CHECKING:
    from jaxrl_tab.show.report import Page

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
VERDICTS = {
    "same": "the same bits",
    "better": "better",
    "worse": "WORSE",
    "open": "no difference shown",
    "none": "too few runs",
}
OF_SETTINGS = {
    "setting": "",
    "chosen": "chosen: ",
    "fresh": "chosen, on fresh seeds: ",
}


@dataclass(frozen=True)
class Beside:
    """Results beside the first ones.

    Attributes:
        letter: what they are called in tables: "B", "C", ...
        name: what they are: their folder.
        differs: what is not as it was in the first, a line each: in the "experiment", "versions", "settings" (of JAX,
            XLA and the backend) and the "machine"; what is not known of both is left out.
        alone: the names "ENVIRONMENT/METHOD" that only the first have, and that only these have.
        not_alike: names that both have, but not of the same task, or one of control and one of prediction.
        rows: what was compared.
        notes: what a reader must know of these results, a sentence each.
        complete: whether all is there that belongs to their experiment.
        ranking: methods that only these have, among those of the first; or why there is no such ranking; None where
            there is nothing to rank.
    """

    letter: str
    name: str
    differs: dict[str, list[str]]
    alone: tuple[list[str], list[str]]
    not_alike: list[str]
    rows: list[Compared]
    notes: list[str]
    complete: bool
    ranking: Ranking | str | None = None

    @property
    def ranked(self) -> Ranking | None:
        return None if isinstance(self.ranking, str) else self.ranking

    @property
    def whole(self) -> bool:
        """Whether all that the first results have could be compared."""
        uncertain = any(row.verdict == "none" for row in self.rows)
        return self.complete and not (self.alone[0] or self.not_alike or uncertain)

    def of(self, verdict: str) -> list[Compared]:
        return [row for row in self.rows if row.verdict == verdict]

    @property
    def by_environment(self) -> dict[str, list[Compared]]:
        """What was compared in each environment."""
        labels = dict.fromkeys(row.name.partition("/")[0] for row in self.rows)
        return {label: [row for row in self.rows if row.name.startswith(f"{label}/")] for label in labels}

    def sentences(self) -> Iterator[str]:
        """What was found, in whole sentences."""
        rows, it = self.rows, self.letter
        if isinstance(self.ranking, str):
            yield f"No ranking: {self.ranking}."
        elif self.ranking:
            yield from ranked.sentences(self.ranking)
        if not rows:
            if not self.ranked:
                yield f"{it} has nothing that can be compared with A."
            return
        if len(same := self.of("same")) == len(rows):
            runs = sum(row.same or 0 for row in rows)
            what = "the setting" if len(rows) == 1 else f"all {len(rows)} settings"
            yield f"{it} is the same as A, to the last bit, in {what} that both have: {counted(runs, 'runs')}."
        else:
            count = counted(len(rows), "comparisons")
            parts = [
                f"{len(found)} {said}"
                for said, found in (
                    ("the same to the last bit", same),
                    ("WORSE", self.of("worse")),
                    ("better", self.of("better")),
                    ("without a difference that the seeds show", self.of("open")),
                    ("of too few runs", self.of("none")),
                )
                if found
            ]
            yield f"{it} beside A, in {count}: {', '.join(parts)}."
        for row in self.of("worse"):
            yield f"{it} is worse than A: {said_of(row)}."
        for what, names in zip(("A has", f"{it} has"), self.alone, strict=True):
            if names and not self.ranked:
                yield f"Only {what} {', '.join(map(title_of_part, names))}."
        if self.not_alike:
            names = ", ".join(map(title_of_part, self.not_alike))
            yield f"Not compared, for it is another task, or is measured by something else: {names}."
        if unpaired := sum(not row.paired and row.verdict != "same" for row in rows):
            yield f"Unpaired, for fewer than {FEWEST} seeds are in both: {counted(unpaired, 'comparisons')}."
        if any(row.kind == "chosen" for row in rows):
            yield (
                "Where other values were tried, the best setting of each is compared; it was chosen on these very "
                "seeds, which its p and its interval are corrected for."
            )


@dataclass(frozen=True)
class Comparison:
    """Results beside others: what differs, what is the same to the last bit, and what is better or worse.

    Attributes:
        name: what the first results are, A in tables.
        notes: what a reader must know of them, a sentence each.
        others: what was laid beside them.
        confidence: of all comparisons together.
        complete: whether all is there that belongs to the experiment of the first.
    """

    name: str
    notes: list[str]
    others: list[Beside]
    confidence: float
    complete: bool

    @property
    def worse(self) -> list[Compared]:
        """All comparisons in which others are worse than the first."""
        return [row for other in self.others for row in other.of("worse")]

    @property
    def whole(self) -> bool:
        """Whether all that the first results have could be compared with all others."""
        return self.complete and all(other.whole for other in self.others)

    @property
    def sentences(self) -> list[str]:
        """The findings, in whole sentences."""
        return [sentence for other in self.others for sentence in other.sentences()]

    def __str__(self) -> str:
        lines = [f"A: {self.name}", *(f"{other.letter}: {other.name}" for other in self.others)]
        return "\n".join([*lines, *self.sentences])

    def __repr__(self) -> str:
        return f"<Comparison of {self.name} with {', '.join(other.name for other in self.others)}: str() says what>"

    def _repr_html_(self) -> str:
        tables = [
            table(f"{label}: A, {self.name}, and {other.letter}, {other.name}", head(other), map(cells, rows))
            for other in self.others
            for label, rows in other.by_environment.items()
        ]
        return "\n".join([*tables, *(f"<p>{_escaped(line)}</p>" for line in self.sentences)])

    def to_dict(self) -> dict[str, Any]:
        """All of it in types that JSON knows; null where there is no number."""
        others = [
            {
                "letter": other.letter,
                "name": other.name,
                "differs": other.differs,
                "only_first": other.alone[0],
                "only_here": other.alone[1],
                "not_alike": other.not_alike,
                "notes": other.notes,
                "complete": other.complete,
                "ranking": None if other.ranked is None else ranked.to_dict(other.ranked),
                "comparisons": [_plain(asdict(row) | {"first": _place(row)}) for row in other.rows],
            }
            for other in self.others
        ]
        about = {
            "first": self.name,
            "notes": self.notes,
            "confidence": self.confidence,
            "complete": self.complete,
        }
        found = {"worse": len(self.worse), "whole": self.whole, "sentences": self.sentences}
        return about | found | {"others": others}

    def page(self) -> "Page":
        """A page that needs nothing else: a notebook shows it, and its `save` writes it into a file."""
        from jaxrl_tab.show.html import render
        from jaxrl_tab.show.report import Page

        title = f"{self.name} beside {' and '.join(other.name for other in self.others)}"
        rendered = render(
            "compare.html",
            styles=["report.css", "compare.css"],
            title=title,
            comparison=self,
            chapters=[_chapter(other) for other in self.others],
            percent=f"{100 * self.confidence:g}%",
            version=__version__,
        )
        return Page(title, rendered)


# --- a row in words ----------------------------------------------------------------------------------
def title_of_part(name: str) -> str:
    environment, _, method = name.partition("/")
    return f"{title_of(method)} in {title_of(environment)}"


def setting_of(row: Compared) -> str:
    """The settings that are compared, in words."""
    one, other = (", ".join(in_words(setting)) for setting in (row.setting, row.other))
    both = one if one == other else f"{one} → {other}"
    return f"{OF_SETTINGS[row.kind]}{both}" if both else OF_SETTINGS[row.kind].rstrip(": ")


def said_of(row: Compared) -> str:
    """What was found of a setting, in one line."""
    digits = decimals([row])
    what = "mean error" if row.prediction else "mean return"
    setting = setting_of(row)
    means = " and ".join(number(x, digits) for x in row.means)
    lost = f", {row.lost[0]} and {row.lost[1]} runs diverged" if row.lost[0] != row.lost[1] else ""
    interval = (
        ""
        if math.isnan(row.low)
        else f", difference {number(row.difference, digits)} ({interval_of(row, digits)})"
    )
    return f"{title_of_part(row.name)}{', ' if setting else ''}{setting}: {what} {means}{interval}{lost}"


def interval_of(row: Compared, digits: int) -> str:
    return "–" if math.isnan(row.low) else f"{number(row.low, digits)} to {number(row.high, digits)}"


def same_of(row: Compared) -> str:
    """How many of the runs that both have are the same."""
    if row.same is None or not row.common:
        return "–"
    return f"{row.same} of {row.common}"


def where(row: Compared) -> str:
    """Where the runs begin to differ, in words; empty where they do not, or are not of the same seeds."""
    if (place := row.first) is None:
        return ""
    row_of_log = (
        "in what was learned in the end" if place.row is None else f"from row {place.row} of the log on"
    )
    numbers = f"{place.variable} {_exactly(place.before)}, and {_exactly(place.after)}"
    return f"first in seed {place.seed}, {row_of_log}: {numbers}"


def _exactly(x: float) -> str:
    """A number of a run with as many digits as float32 has."""
    return f"{x:.9g}".replace("-", "−")


def decimals(rows: Sequence[Compared]) -> int:
    widths = np.array([(row.high - row.low) / 2 for row in rows])
    digits = decimals_for(widths, 2)
    means = np.array([row.means for row in rows if row.prediction])
    return max(digits, decimals_for(means, 3)) if means.size else digits


def head(other: Beside) -> list[str]:
    """The heads of the columns of `cells`."""
    what = "error" if all(row.prediction for row in other.rows) else "return"
    return [
        "method",
        "setting",
        "same runs",
        f"mean {what} of A",
        f"of {other.letter}",
        "difference",
        "interval",
        "p (Holm)",
        "verdict",
    ]


def cells(row: Compared, digits: int | None = None) -> list[str]:
    """A comparison as a row of a table."""
    digits = decimals([row]) if digits is None else digits
    tested = row.verdict != "same"
    return [
        title_of(row.name.partition("/")[2]),
        setting_of(row) or "–",
        same_of(row),
        *(number(x, digits) for x in row.means),
        number(row.difference, digits) if tested else "0",
        interval_of(row, digits) if tested else "–",
        p_of(row.corrected) if tested else "–",
        VERDICTS[row.verdict] + (f" ({row.lost[0]}, {row.lost[1]} diverged)" if any(row.lost) else ""),
    ]


def p_of(p: float) -> str:
    return "–" if math.isnan(p) else "<\xa00.0001" if p < 0.0001 else f"{p:.2g}"


# --- the page ----------------------------------------------------------------------------------------
def _chapter(other: Beside) -> dict[str, Any]:
    """What the page tells of one of the others."""
    tables = []
    for environment, rows in other.by_environment.items():
        digits = decimals(rows)
        reach = (
            max((abs(x) for row in rows for x in (row.low, row.high) if np.isfinite(x)), default=0.0) or 1.0
        )
        tables.append(
            {
                "title": title_of(environment),
                "head": [*head(other)[:-1], "", head(other)[-1]],
                "rows": [
                    {
                        "cells": cells(row, digits),
                        "verdict": row.verdict,
                        "where": where(row),
                        "mark": _mark(row, reach),
                    }
                    for row in rows
                ],
                "prediction": all(row.prediction for row in rows),
            }
        )
    about = {"other": other, "sentences": [*other.sentences()], "tables": tables}
    return about | {"ranking": ranked.chapter(other.ranked) if other.ranked else None}


def _mark(row: Compared, reach: float) -> dict[str, float] | None:
    """Where an interval is drawn, from 0 to 160 about 80; None where there is none."""
    at = lambda x: 80 + 76 * float(np.clip(x / reach, -1, 1))
    if row.verdict == "same" or not all(map(math.isfinite, (row.low, row.high, row.difference))):
        return None
    return {"low": at(row.low), "high": at(row.high), "middle": at(row.difference)}


# --- JSON --------------------------------------------------------------------------------------------
def _place(row: Compared) -> dict[str, Any] | None:
    return None if row.first is None else row.first._asdict()


def _plain(x: Any) -> Any:
    """Numbers that JSON has not as null, or as words."""
    if isinstance(x, Mapping):
        return {key: _plain(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_plain(value) for value in x]
    if isinstance(x, float) and not math.isfinite(x):
        return None if math.isnan(x) else "infinite" if x > 0 else "-infinite"
    return x


def _escaped(text: str) -> str:
    import html

    return html.escape(text)
