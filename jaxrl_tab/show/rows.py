"""The tables, notes and sentences of a chapter of the report, from the rows of its settings."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.show import words
from jaxrl_tab.show.words import counted, counts_in_words, number
from jaxrl_tab.stats.column import Column, text
from jaxrl_tab.stats.columns import COLUMNS, Methods, Row

AT_ONCE, AT_MOST = 12, 1000  # rows of a table that are shown unfolded, and rows that are shown at all


class Table(NamedTuple):
    """A table as text: the first column to the left.

    Attributes:
        head, rows: the cells.
        stars: which rows are in bold.
        keys: by what the scripts of the page know the rows; none where they do not.
    """

    head: list[str]
    rows: list[list[str]]
    stars: list[bool]
    keys: Sequence[str] = ()


class View(NamedTuple):
    """How the numbers of a chapter are shown.

    Attributes:
        prediction: whether they are errors, the lower the better, or returns.
        varied: the hyperparameters that are not the same in all settings.
        decimals: of returns and errors.
    """

    prediction: bool
    varied: list[str]
    decimals: int

    @property
    def what(self) -> str:
        return "mean error" if self.prediction else "mean return"


def rank(row: Row, prediction: bool) -> tuple[bool, int, float]:
    """The best first, as `stats.best` has it: the fewest that diverged, and then the mean."""
    mean = row["score"][0]
    return bool(np.isnan(mean)), row["diverged"], mean if prediction else -mean


def varied(rows: Sequence[Row]) -> list[str]:
    """The hyperparameters that are not the same in all rows that have them."""
    values: dict[str, set[str]] = {}
    for row in rows:
        for name, value in row.setting.items():
            values.setdefault(name, set()).add(words.written(value))
    return [name for name, texts in values.items() if len(texts) > 1]


def runs_in_words(ds: xr.Dataset) -> str:
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    return f"{counted(int(ds.attrs[f'num_{unit}']), unit)} in each of {counted(ds.sizes['seed'], 'runs')} (seeds)"


def finding(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> str:
    """The best method in a sentence, by what was found on fresh seeds where all were run on some."""
    on_fresh = len(again) == len(stars)
    row = min(again.values() if on_fresh else stars, key=lambda row: rank(row, view.prediction))
    mean, optimum = row["score"][0], row["optimum"]
    if np.isnan(mean):
        return "no run has a result to compare"
    setting = setting_of(next(star for star in stars if star.method == row.method), view)
    optimum_text = "" if view.prediction or np.isnan(optimum) else f"; the exact optimum is {number(optimum)}"
    seeds = " on fresh seeds" if on_fresh else ""
    return f"best: {setting}, with a {view.what} of {number(mean, view.decimals)}{seeds}{optimum_text}"


def early_in_words(methods: Methods, write: Callable[[float], str]) -> str:
    """That another setting is better early than the one that wins in the end; only where there is one.

    Args:
        methods: whose `early` is not None.
        write: how returns and errors are written.
    """
    assert methods.early
    view = View(methods.prediction, varied(methods.rows), 0)
    quick, winner = (setting_of(row, view) for row in methods.early)
    if methods.by_length:
        what, they, write = "steps an episode are", "they are", words.steps_in_words
        early, late = (row["early_steps"] for row in methods.early)
    else:
        what, they = f"{view.what} is", "it is"
        early, late = (row["early_score"][0] for row in methods.early)
    end = "over the whole run" if methods.prediction else "at the end"
    then = "no episode ends" if np.isposinf(late) else f"{they} {write(late)}"
    return (
        f"Early on another is better: over the first tenth of the run the {what} {write(early)} with {quick}; with "
        f"{winner}, the best {end}, {then}."
    )


def _difference_cells(row: Row, view: View) -> list[str]:
    """How the best setting of a method differs from that of the best: the mean with its interval, and p."""
    difference, p = row["difference"], row["p"]
    if np.isnan(p):
        return ["–", "–"]
    return [_of(difference, view), _unbroken("< 0.001") if p < 0.001 else number(p, 3)]


def notes(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> list[str]:
    """What a reader of the methods' table must know of single rows, in sentences."""
    notes = [words.DOES_NOT_END] if any(row.own.among.continuing for row in stars) else []
    for row in [*stars, *(again[star.method] for star in stars if star.method in again)]:
        where = " on fresh seeds" if row is again.get(row.method) else ""
        name = setting_of(row, view)
        if row.doubtful:
            middle = f"median {_of(row['median'], view)}; interquartile mean {_of(row['iqm'], view)}"
            notes.append(
                f"! The mean of {name}{where} rests on few bad runs and may be worse than it looks: {row['seeds']} "
                f"seeds were run, and {row['seeds_wanted']} would be needed. The middle of the runs is sure: {middle}."
            )
        if row["unfinished"] and not row.own.among.continuing:
            notes.append(
                f"{row['unfinished']} of {row['seeds']} runs of {name}{where} finished no episode in the last tenth: "
                "they score the rewards that they collected there, as if the episode had been cut off at the end."
            )
        for parameter, end in row.own.edges.items():
            notes.append(words.edge_warning(parameter, row.method, end))
    return notes


def chosen(methods: Methods, fresh: Methods | None) -> Table:
    """The best setting of each method, with its number on fresh seeds where it was run on some; the best first."""
    again = {row.method: row for row in fresh.rows} if fresh else {}
    stars = [row for row in methods.rows if row["best"]]
    stars.sort(key=lambda row: rank(row, methods.prediction))
    view = View(methods.prediction, varied(methods.rows), decimals([*stars, *again.values()]))
    return chosen_table(stars, again, {}, view)


def chosen_table(
    stars: Sequence[Row], again: Mapping[str, Row], judged: Mapping[str, Row], view: View
) -> Table:
    """The setting chosen for each method, and what it gave: on fresh seeds where it was run on them, too.

    `judged` are the rows that tell how the methods differ; none where they cannot be compared.
    """
    last = [again.get(row.method, row) for row in stars]
    columns = columns_of("chosen", last)
    seeds = counts_in_words(row["seeds"] for row in again.values())
    mean = f"{view.what} (95% interval)"
    head = ["method", "setting", f"{mean}, seeds of the choice" if again else mean]
    head += [f"{mean}, {seeds} fresh seeds"] if again else []
    head += ["difference from the first", "p"] if judged else []
    rows = [
        [
            words.title_of(row.method),
            _setting(row, view) or "as given",
            mean_in_words(row, view),
            *([mean_in_words(again[row.method], view) if row.method in again else "–"] if again else []),
            *(_difference_cells(judged[row.method], view) if judged else []),
            *(_cell(column, shown, view) for column in columns),
        ]
        for row, shown in zip(stars, last, strict=True)
    ]
    return Table(
        [*head, *(text(column.report, view.prediction) for column in columns)], rows, [False] * len(rows)
    )


def early_table(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> Table:
    """How the chosen settings learned early; no rows where there is nothing to tell."""
    last = [again.get(row.method, row) for row in stars]
    columns = columns_of("early", last)
    rows = [
        [
            words.title_of(row.method),
            _setting(row, view) or "as given",
            *(_cell(column, shown, view) for column in columns),
        ]
        for row, shown in zip(stars, last, strict=True)
    ]
    head = ["method", "setting", *(text(column.report, view.prediction) for column in columns)]
    return Table(head, rows if columns else [], [False] * len(rows))


def settings_table(ranked: Sequence[Row], keys: Sequence[str], view: View) -> Table:
    """All settings in the order given: the best of each method has a star. `keys`: see `Table`."""
    settings = Counter(row.method for row in ranked)
    stars = [row["best"] and settings[row.method] > 1 for row in ranked[:AT_MOST]]
    columns = columns_of("all", ranked)
    head = [
        "method",
        *map(words.symbol, view.varied),
        view.what,
        "95% interval",
        *(text(column.report, view.prediction) for column in columns),
    ]
    rows = [
        [
            f"{words.title_of(row.method)}{' ★' if star else ' ≈' if row['tied'] and not row['best'] else ''}",
            *(words.written(row.setting[name]) if name in row.setting else "–" for name in view.varied),
            number(row["score"][0], view.decimals),
            _between(row["score"], view) + _doubt(row),
            *(_cell(column, row, view) for column in columns),
        ]
        for row, star in zip(ranked, stars, strict=False)  # `stars` ends after AT_MOST rows
    ]
    return Table(head, rows, stars, keys)


def columns_of(table: str, rows: Sequence[Row]) -> list[Column]:
    """The columns of a table of the report, besides the score and the difference, that have anything to tell."""
    also = lambda x: table == "all" and "early" in x.tables and x.on_screen(rows[0].own.among)
    wanted = lambda x: x.report and (table in x.tables or also(x)) and x.tells(rows)
    columns = [x for x in COLUMNS if wanted(x) and x.fits(rows[0].own.among)]
    if table == "all" and len({number(row["optimum"]) for row in rows}) == 1:  # the other table says it
        columns = [column for column in columns if column.name != "optimum"]
    return columns


def _cell(column: Column, row: Row, view: View) -> str:
    x = row[column.name]
    if column.written == "range":
        return _between(x, view)
    if column.written == "middle":
        return number(x[0], view.decimals)
    if column.written == "worth":
        return words.worth(x)
    if column.written == "steps":
        return words.steps_in_words(x)
    if isinstance(x, tuple):
        return _of(x, view)
    if column.written == "count":
        return str(x)
    if column.written == "share":
        return f"{x:.0%}"
    if column.written == "tenths":
        return number(x, 1 if x < 1000 else 0)
    return number(x, view.decimals if column.written == "score" else None)


def mean_in_words(row: Row, view: View) -> str:
    return _of(row["score"], view) + _doubt(row)


def _doubt(row: Row) -> str:
    return _unbroken(" !") if row.doubtful else ""


def _of(interval: Sequence[float], view: View) -> str:
    """An estimate with its interval."""
    return f"{number(interval[0], view.decimals)} ({_between(interval, view)})"


def _between(interval: Sequence[float], view: View) -> str:
    """The bounds of an interval; where there is no room for all of it, a line may begin with "to"."""
    _, low, high = interval
    return " to\xa0".join(number(x, view.decimals) for x in (low, high)) if low <= high else "–"


def _unbroken(text: str) -> str:
    return text.replace(" ", "\xa0")


def decimals(rows: Iterable[Row]) -> int:
    """How many decimals show two digits of the usual width of an interval, on its shorter side, from 0 to 5."""
    scores = [row["score"] for row in rows]
    widths = np.array([min(high - mean, mean - low) for mean, low, high in scores])
    widths = widths[np.isfinite(widths) & (widths > 0)]
    return int(np.clip(1 - np.floor(np.log10(np.median(widths))), 0, 5)) if widths.size else 2


def _setting(row: Row, view: View) -> str:
    shown = {name: row.setting[name] for name in view.varied if name in row.setting}
    return ", ".join(map(_unbroken, words.in_words(shown)))


def setting_of(row: Row, view: View) -> str:
    return ", ".join(filter(None, [words.title_of(row.method), _setting(row, view)]))
