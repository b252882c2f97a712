"""What a chapter of the report says: its rows, notes and tables."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core.types import Environment
from jaxrl_tab.show import plot, words
from jaxrl_tab.show.words import counted, counts_in_words, number
from jaxrl_tab.stats.along import Datasets

AT_ONCE, AT_MOST = 12, 1000  # rows of a table that are not folded away, and rows that are there at all


class Table(NamedTuple):
    """A table as text: the first column to the left. `stars` says which rows are in bold."""

    head: list[str]
    rows: list[list[str]]
    stars: list[bool]


class Row(NamedTuple):
    """One setting of a method in numbers; NaN where there is none.

    Attributes:
        method: its name.
        setting: all its hyperparameters, swept and fixed.
        mean, low, high: mean of the score and its 95% interval, as `stats.score_interval` has them.
        run_low, run_high: where at least nine of ten runs lie, with confidence 95%.
        middle: median and interquartile mean, each with its 95% interval, where the mean is doubtful.
        seeds, unfinished, diverged: how many seeds it was run on, how many of these finished no episode in
            the last tenth, and how many diverged.
        wanted: how many seeds it takes until the mean's interval can be trusted.
        episodes: finished in a run, mean; NaN where their number was given.
        end: exact value of the greedy policy at the end, median; of prediction the error at the end, mean.
        optimum: v* from the start, of prediction v_pi.
        soft: what the best policy earns that explores as this setting does.
        star: whether it is the best of its method.
        tied: whether it cannot be told apart from that.
        edges: the hyperparameters that have the largest or the smallest value that was tried, if it is best.
    """

    method: str
    setting: dict[str, Any]
    mean: float
    low: float
    high: float
    run_low: float
    run_high: float
    middle: dict[str, tuple[float, float, float]]
    seeds: int
    unfinished: int
    diverged: int
    wanted: int
    episodes: float
    end: float
    optimum: float
    soft: float
    star: bool
    tied: bool
    edges: dict[str, str]

    @property
    def doubtful(self) -> bool:
        """Whether the mean rests on few bad runs."""
        return self.wanted > self.seeds


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


def rows_of(method: str, ds: xr.Dataset, env: Environment) -> list[Row]:
    """All settings of a method, in the order of its axes."""
    names, constant = stats.hyperparameters(ds), stats.fixed(ds)
    score, diverged, prediction = stats.score(ds), ds.diverged, stats.is_prediction(ds)
    known = lambda _: score
    mean, low, high, _ = stats.score_interval(ds, by=known)
    runs = stats.possible(stats.tolerance_interval(score), score, ds)
    if prediction:
        end = ds.v_error.isel(row=-1).astype(float).where(~diverged).mean("seed")
    elif "greedy_value" in ds:
        end = ds.greedy_value.isel(row=-1).where(~diverged).median("seed")
    else:
        end = xr.full_like(mean, np.nan)
    numbers = {
        "mean": mean,
        "low": low,
        "high": high,
        "run_low": runs.low,
        "run_high": runs.high,
        "unfinished": xr.zeros_like(mean, int) if prediction else stats.unfinished(ds).sum("seed"),
        "diverged": diverged.sum("seed"),
        "wanted": stats.seeds_wanted(score, higher_is_better=not prediction),
        # Where episodes were the budget all have the same.
        "episodes": ds.episodes.sum("row").where(~diverged & ("num_steps" in ds.attrs)).mean("seed"),
        "end": end,
        "optimum": stats.optimum(ds).broadcast_like(mean),
        "tied": stats.tied(ds, known),
    }
    flat = {name: x.transpose(*names).values.ravel().tolist() for name, x in numbers.items()}
    best = stats.best(ds, known)
    rows = []
    for i, values in enumerate(product(*(ds[name].values.tolist() for name in names))):
        place = dict(zip(names, values, strict=True))
        setting, star = stats.named(ds, place) | constant, place == best
        rows.append(
            Row(
                method=method,
                setting=setting,
                middle={},
                seeds=ds.sizes["seed"],
                soft=stats.soft_optimum(env, setting) if star and not prediction else np.nan,
                star=star,
                edges=stats.at_edge(ds, best) if star else {},
                **{name: x[i] for name, x in flat.items()},
            )
        )
        if star and rows[i].doubtful:
            own = score.sel(place)
            found = {"median": stats.median_interval(own), "interquartile mean": stats.iqm_interval(own)}
            middle = {name: tuple(float(x) for x in interval[:3]) for name, interval in found.items()}
            rows[i] = rows[i]._replace(middle=middle)
    return rows


def rank(row: Row, prediction: bool) -> tuple[bool, int, float]:
    """The best first, as `stats.best` has it: the fewest that diverged, and then the mean."""
    merit = row.mean if prediction else -row.mean
    return np.isnan(merit), row.diverged, merit


def varied(rows: Sequence[Row]) -> list[str]:
    """The hyperparameters that are not the same in all rows that have them."""
    values: dict[str, set[str]] = {}
    for row in rows:
        for name, value in row.setting.items():
            values.setdefault(name, set()).add(plot.written(value))
    return [name for name, found in values.items() if len(found) > 1]


def runs_in_words(ds: xr.Dataset) -> str:
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    return f"{counted(int(ds.attrs[f'num_{unit}']), unit)} in each of {counted(ds.sizes['seed'], 'runs')} (seeds)"


def finding(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> str:
    """The best method in a sentence, by what was found on fresh seeds where all were run on some."""
    on_fresh = len(again) == len(stars)
    row = min(again.values() if on_fresh else stars, key=lambda row: rank(row, view.prediction))
    if np.isnan(row.mean):
        return "no run has a result to compare"
    setting = setting_of(next(star for star in stars if star.method == row.method), view)
    optimum = (
        "" if view.prediction or np.isnan(row.optimum) else f"; the exact optimum is {number(row.optimum)}"
    )
    seeds = " on fresh seeds" if on_fresh else ""
    return f"best: {setting}, with a {view.what} of {number(row.mean, view.decimals)}{seeds}{optimum}"


def difference_cells(datasets: Datasets, view: View) -> dict[str, list[str]]:
    """How each method differs from the best: the mean with its interval, and p. See `stats.differences`."""
    found = stats.differences(datasets)
    cells = {method: ["–", "–"] for method in datasets} if found else {}
    for method, (interval, p, _) in found.items():
        by = _of([float(x) for x in interval[:3]], view)
        cells[method] = [by, _unbroken("< 0.001") if p < 0.001 else number(float(p), 3)]
    return cells


def notes(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> list[str]:
    """What a reader of the methods' table must know of single rows, in sentences."""
    notes = []
    for row in [*stars, *(again[star.method] for star in stars if star.method in again)]:
        where = " on fresh seeds" if row is again.get(row.method) else ""
        name = setting_of(row, view)
        if row.doubtful:
            middle = "; ".join(f"{kind} {_of(found, view)}" for kind, found in row.middle.items())
            notes.append(
                f"! The mean of {name}{where} rests on few bad runs and may be worse than it looks: {row.seeds} seeds "
                f"were run, and {row.wanted} would be needed. The middle of the runs is sure: {middle}."
            )
        if row.unfinished:
            notes.append(
                f"{row.unfinished} of {row.seeds} runs of {name}{where} finished no episode in the last tenth: they "
                "score the rewards that they collected there, as if the episode had been cut off at the end."
            )
        for parameter, end in row.edges.items():
            notes.append(words.edge_warning(parameter, row.method, end))
    return notes


def chosen_table(
    stars: Sequence[Row],
    again: Mapping[str, Row],
    differences: Mapping[str, Sequence[str]],
    view: View,
) -> Table:
    """The setting chosen for each method, and what it gave: on fresh seeds where it was run on them, too."""
    last = [again.get(row.method, row) for row in stars]
    columns = _columns(last, view)
    if not np.isnan([row.soft for row in last]).all():
        columns["best ε-soft"] = lambda row: number(row.soft)
    columns["exact value" if view.prediction else "exact optimum"] = lambda row: number(row.optimum)
    seeds = counts_in_words(row.seeds for row in again.values())
    mean = f"{view.what} (95% interval)"
    head = ["method", "setting", f"{mean}, seeds of the choice" if again else mean]
    head += [f"{mean}, {seeds} fresh seeds"] if again else []
    head += ["difference from the first", "p"] if differences else []
    rows = [
        [
            words.title_of(row.method),
            _setting(row, view) or "as given",
            _mean_cell(row, view),
            *([_mean_cell(again[row.method], view) if row.method in again else "–"] if again else []),
            *differences.get(row.method, []),
            *(cell(shown) for cell in columns.values()),
        ]
        for row, shown in zip(stars, last, strict=True)
    ]
    return Table([*head, *columns], rows, [False] * len(rows))


def settings_table(ranked: Sequence[Row], view: View) -> Table:
    """All settings in the order given: the best of each method has a star."""
    settings = Counter(row.method for row in ranked)
    stars = [row.star and settings[row.method] > 1 for row in ranked[:AT_MOST]]
    columns = _columns(ranked, view)
    if not np.isnan([row.episodes for row in ranked]).all():
        columns["episodes"] = lambda row: number(row.episodes, 1 if row.episodes < 1000 else 0)
    if len({number(row.optimum) for row in ranked}) > 1:
        columns["exact optimum"] = lambda row: number(row.optimum)
    head = [
        "method",
        *map(words.symbol, view.varied),
        view.what,
        "95% interval",
        *columns,
    ]
    rows = [
        [
            f"{words.title_of(row.method)}{' ★' if star else ' ≈' if row.tied and not row.star else ''}",
            *(plot.written(row.setting[name]) if name in row.setting else "–" for name in view.varied),
            number(row.mean, view.decimals),
            _between(row.low, row.high, view) + _doubt(row),
            *(cell(row) for cell in columns.values()),
        ]
        for row, star in zip(ranked, stars, strict=False)
    ]
    return Table(head, rows, stars)


def _columns(rows: Sequence[Row], view: View) -> dict[str, Callable[[Row], str]]:
    """What both tables tell after mean and interval, as far as there is anything to tell."""
    columns: dict[str, Callable[[Row], str]] = {
        "9 of 10 runs": lambda row: _between(row.run_low, row.run_high, view)
    }
    if any(row.unfinished for row in rows):
        columns["unfinished"] = lambda row: str(row.unfinished)
    if any(row.diverged for row in rows):
        columns["diverged"] = lambda row: str(row.diverged)
    if not np.isnan([row.end for row in rows]).all():
        of_end = "error at the end" if view.prediction else "worth of the greedy policy"
        columns[of_end] = lambda row: number(row.end, view.decimals if view.prediction else None)
    return columns


def _mean_cell(row: Row, view: View) -> str:
    return _of((row.mean, row.low, row.high), view) + _doubt(row)


def _doubt(row: Row) -> str:
    return _unbroken(" !") if row.doubtful else ""


def _of(found: Sequence[float], view: View) -> str:
    """An estimate with its interval."""
    estimate, low, high = found
    return f"{number(estimate, view.decimals)} ({_between(low, high, view)})"


def _between(low: float, high: float, view: View) -> str:
    """An interval; where there is no room for all of it, a line may begin with "to"."""
    return " to\xa0".join(number(x, view.decimals) for x in (low, high)) if low <= high else "–"


def _unbroken(text: str) -> str:
    return text.replace(" ", "\xa0")


def decimals(rows: Iterable[Row]) -> int:
    """How many decimals show two digits of the usual width of an interval, on its shorter side, from 0 to 5."""
    widths = np.array([min(row.high - row.mean, row.mean - row.low) for row in rows])
    widths = widths[np.isfinite(widths) & (widths > 0)]
    return int(np.clip(1 - np.floor(np.log10(np.median(widths))), 0, 5)) if widths.size else 2


def _setting(row: Row, view: View) -> str:
    shown = {name: row.setting[name] for name in view.varied if name in row.setting}
    return ", ".join(map(_unbroken, plot.in_words(shown)))


def setting_of(row: Row, view: View) -> str:
    return ", ".join(filter(None, [words.title_of(row.method), _setting(row, view)]))
