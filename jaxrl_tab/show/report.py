"""The report of an experiment: one HTML file that holds all there is to see, and needs nothing else.

For each environment the setting chosen for each method, pictures, and all settings, the best first; then how
to read it, and how it was made.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core import describe
from jaxrl_tab.core.checks import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.core.version import __version__
from jaxrl_tab.envs.base import Finite, Grid
from jaxrl_tab.show import plot
from jaxrl_tab.show.html import embedded, render

FILE = "report.html"
AT_ONCE, AT_MOST = 12, 1000  # rows of a table that are not folded away, and rows that are there at all

CAPTIONS = {
    "episodes": "How many episodes are over after so many steps. The steeper the line, the shorter the "
    "episodes; where it is straight, nothing more is learned.",
    "learning_curves": "The mean return of an episode while the method learns, each method with its best "
    "setting. The dashed line is the exact optimum, the dotted one what the best policy earns that explores as "
    "much.",
    "sensitivity": "How much it matters which {0} one takes: the mean return at the end for each that was "
    "tried, with its 95% interval. What else can be set stays where the method did best.",
    "greedy_path": "Where the agent goes if it always takes an action that it learned to be best; of all "
    "seeds the one whose path is the median in length. Faint arrows: greedy actions beside the path; "
    "hatched: out of reach. Last, if all have the same optimum, an optimal policy.",
    "values": "What the methods learned that the states are worth, as a mean over seeds, with the action "
    "that is best most often. Last, if all have the same optimum, the exact values and all optimal actions.",
}
OF_PREDICTION = {
    "learning_curves": "The error of the learned values while the method learns (root of the mean squared "
    "error over states), each method with its best setting.",
    "sensitivity": "How much it matters which {0} one takes: the mean error over the run for each that was "
    "tried, with its 95% interval. What else can be set stays where the method did best.",
    "values": "What the methods learned that the states are worth, as a mean over seeds, beside the exact "
    "values.",
}

# As measured, see `stats.score_interval`; of 10, 30 and 100 seeds.
COVERAGE = (
    "and 10, 30 and 100 seeds, 94 to 96 of 100 such intervals were right; where 1 or 2 runs in 100 get stuck, at "
    "least 82, 94 and 96 were."
)

Datasets = Mapping[str, xr.Dataset]


def write(
    folder: Path | str,
    datasets: Datasets,
    envs: Mapping[str, Environment],
    about: Mapping[str, Any],
    fresh: Datasets | None = None,
) -> Path:
    """Writes `report.html` into `folder`, over one that is there.

    Args:
        folder: an existing folder.
        datasets: sweeps by their names "ENV/METHOD", at least one; those of an environment are either all of
            control or all of prediction.
        envs: the environments by their names.
        about: how the results came about, in the order in which it is told: what it is -> a number, text
            (of several lines: as it is), a list, or a mapping of the same kind.
        fresh: the chosen setting of methods, run again on fresh seeds, by the same names: no sweep.

    Returns:
        The file written.

    Raises:
        InputError: nothing to tell, an environment is missing, or what is fresh is a sweep.
    """
    if not datasets:
        raise InputError("a report needs at least one dataset")
    fresh = fresh or {}
    for name, ds in fresh.items():
        if any(ds.sizes[parameter] > 1 for parameter in stats.hyperparameters(ds)):
            raise InputError(f"what was run on fresh seeds must be one setting, but {name} is a sweep")
    chapters = []
    for label, names in groupby(datasets, lambda name: name.partition("/")[0]):
        if label not in envs:
            raise InputError(f"there is no environment {label!r}; there are {', '.join(envs)}")
        parts = {name: datasets[name] for name in names}
        again = {_method(name): ds for name, ds in fresh.items() if name in parts}
        chapters.append(
            _chapter(label, {_method(name): ds for name, ds in parts.items()}, envs[label], again)
        )
    text = render(
        "report.html",
        title=_title(datasets, chapters),
        chapters=chapters,
        about=about,
        speed=[_speed(name, ds) for name, ds in datasets.items()],
        seeds=_range(ds.sizes["seed"] for ds in datasets.values()),
        fresh=bool(fresh),
        coverage=COVERAGE,
        unseen=stats.unseen(min(ds.sizes["seed"] for ds in datasets.values())),
        at_once=AT_ONCE,
        version=__version__,
    )
    file = Path(folder) / FILE
    file.write_text(text, encoding="utf-8")
    return file


class Picture(NamedTuple):
    """A picture of the page.

    Attributes:
        source: its address, which holds the picture itself.
        alt: what it shows, for who does not see it.
        caption: how to read it.
        large: whether it has the width of the page.
    """

    source: str
    alt: str
    caption: str
    large: bool


class Table(NamedTuple):
    """A table as text: the first column to the left. `stars` says which rows are in bold."""

    head: list[str]
    rows: list[list[str]]
    stars: list[bool]


class Chapter(NamedTuple):
    """What the page tells of one environment."""

    label: str
    about: str
    unusual: str
    methods: list[str]
    runs: str
    common: str
    finding: str
    prediction: bool
    compared: bool
    on_fresh: bool
    notes: list[str]
    chosen: Table
    pictures: list[Picture]
    settings: Table
    num_settings: int
    diverged: list[str]
    num_diverged: int
    unfinished: bool
    doubtful: bool
    tied: bool
    explores: bool
    greedy_worth: bool


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


# --- a chapter ---------------------------------------------------------------------------------------


def _chapter(label: str, datasets: Datasets, env: Environment, fresh: Datasets) -> Chapter:
    prediction = stats.is_prediction(*datasets.values())
    rows = [row for method, ds in datasets.items() for row in _rows(method, ds, env)]
    again = {method: _rows(method, ds, env)[0] for method, ds in fresh.items()}
    ranked = sorted(rows, key=lambda row: _rank(row, prediction))
    stars = [row for row in ranked if row.star]
    if len(again) == len(stars):
        stars.sort(key=lambda row: _rank(again[row.method], prediction))
    view = View(prediction, _varied(rows), _decimals([*stars, *again.values()]))
    judged = fresh if len(fresh) == len(datasets) else datasets
    differences = _differences({row.method: judged[row.method] for row in stars}, view)
    return Chapter(
        label=describe.title(label),
        about=describe.summary(type(env)),
        unusual=", ".join(plot.unusual(env)),
        methods=list(datasets),
        runs=_runs(next(iter(datasets.values()))),
        common=", ".join(
            plot.in_words({k: x for row in rows for k, x in row.setting.items() if k not in view.varied})
        ),
        finding=_finding(stars, again, view),
        prediction=prediction,
        compared=bool(differences),
        on_fresh=judged is fresh,
        notes=_notes(stars, again, view),
        chosen=_chosen_table(stars, again, differences, view),
        pictures=_pictures(label, datasets, env, stars, view),
        settings=_settings_table(ranked, view),
        num_settings=len(rows),
        diverged=[f"{_setting_of(row, view)}: {row.diverged} of {row.seeds}" for row in rows if row.diverged],
        num_diverged=sum(row.diverged for row in rows),
        unfinished=any(row.unfinished for row in rows),
        doubtful=any(row.doubtful for row in [*rows, *again.values()]),
        tied=any(row.tied and not row.star for row in rows),
        explores=not np.isnan([row.soft for row in rows]).all(),
        greedy_worth=not prediction and any("greedy_value" in ds for ds in datasets.values()),
    )


def _rows(method: str, ds: xr.Dataset, env: Environment) -> list[Row]:
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


def _rank(row: Row, prediction: bool) -> tuple[bool, int, float]:
    """The best first, as `stats.best` has it: the fewest that diverged, and then the mean."""
    merit = row.mean if prediction else -row.mean
    return np.isnan(merit), row.diverged, merit


def _varied(rows: Sequence[Row]) -> list[str]:
    """The hyperparameters that are not the same in all rows that have them."""
    values: dict[str, set[str]] = {}
    for row in rows:
        for name, value in row.setting.items():
            values.setdefault(name, set()).add(plot.written(value))
    return [name for name, found in values.items() if len(found) > 1]


def _runs(ds: xr.Dataset) -> str:
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    return (
        f"{_count(int(ds.attrs[f'num_{unit}']), unit)} in each of {_count(ds.sizes['seed'], 'runs')} (seeds)"
    )


def _finding(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> str:
    """The best method in a sentence, by what was found on fresh seeds where all were run on some."""
    on_fresh = len(again) == len(stars)
    row = min(again.values() if on_fresh else stars, key=lambda row: _rank(row, view.prediction))
    if np.isnan(row.mean):
        return "no run has a result to compare"
    setting = _setting_of(next(star for star in stars if star.method == row.method), view)
    optimum = (
        "" if view.prediction or np.isnan(row.optimum) else f"; the exact optimum is {_number(row.optimum)}"
    )
    seeds = " on fresh seeds" if on_fresh else ""
    return f"best: {setting}, with a {view.what} of {_number(row.mean, view.decimals)}{seeds}{optimum}"


# --- tables ------------------------------------------------------------------------------------------


def _differences(datasets: Datasets, view: View) -> dict[str, list[str]]:
    """How each method differs from the best: the mean with its interval, and p. See `stats.differences`."""
    found = stats.differences(datasets)
    cells = {method: ["–", "–"] for method in datasets} if found else {}
    for method, (interval, p, _) in found.items():
        by = _of([float(x) for x in interval[:3]], view)
        cells[method] = [by, _unbroken("< 0.001") if p < 0.001 else _number(float(p), 3)]
    return cells


def _notes(stars: Sequence[Row], again: Mapping[str, Row], view: View) -> list[str]:
    """What a reader of the methods' table must know of single rows, in sentences."""
    notes = []
    for row in [*stars, *(again[star.method] for star in stars if star.method in again)]:
        where = " on fresh seeds" if row is again.get(row.method) else ""
        name = _setting_of(row, view)
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
            notes.append(describe.at_edge(parameter, row.method, end))
    return notes


def _chosen_table(
    stars: Sequence[Row],
    again: Mapping[str, Row],
    differences: Mapping[str, Sequence[str]],
    view: View,
) -> Table:
    """The setting chosen for each method, and what it gave: on fresh seeds where it was run on them, too."""
    last = [again.get(row.method, row) for row in stars]
    columns = _columns(last, view)
    if not np.isnan([row.soft for row in last]).all():
        columns["best ε-soft"] = lambda row: _number(row.soft)
    columns["exact value" if view.prediction else "exact optimum"] = lambda row: _number(row.optimum)
    seeds = _range(row.seeds for row in again.values())
    mean = f"{view.what} (95% interval)"
    head = ["method", "setting", f"{mean}, seeds of the choice" if again else mean]
    head += [f"{mean}, {seeds} fresh seeds"] if again else []
    head += ["difference from the first", "p"] if differences else []
    rows = [
        [
            describe.title(row.method),
            _setting(row, view) or "as given",
            _mean_cell(row, view),
            *([_mean_cell(again[row.method], view) if row.method in again else "–"] if again else []),
            *differences.get(row.method, []),
            *(cell(shown) for cell in columns.values()),
        ]
        for row, shown in zip(stars, last, strict=True)
    ]
    return Table([*head, *columns], rows, [False] * len(rows))


def _settings_table(ranked: Sequence[Row], view: View) -> Table:
    """All settings in the order given: the best of each method has a star."""
    settings = Counter(row.method for row in ranked)
    stars = [row.star and settings[row.method] > 1 for row in ranked[:AT_MOST]]
    columns = _columns(ranked, view)
    if not np.isnan([row.episodes for row in ranked]).all():
        columns["episodes"] = lambda row: _number(row.episodes, 1 if row.episodes < 1000 else 0)
    if len({_number(row.optimum) for row in ranked}) > 1:
        columns["exact optimum"] = lambda row: _number(row.optimum)
    head = [
        "method",
        *map(describe.symbol, view.varied),
        view.what,
        "95% interval",
        *columns,
    ]
    rows = [
        [
            f"{describe.title(row.method)}{' ★' if star else ' ≈' if row.tied and not row.star else ''}",
            *(plot.written(row.setting[name]) if name in row.setting else "–" for name in view.varied),
            _number(row.mean, view.decimals),
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
        columns[of_end] = lambda row: _number(row.end, view.decimals if view.prediction else None)
    return columns


def _mean_cell(row: Row, view: View) -> str:
    return _of((row.mean, row.low, row.high), view) + _doubt(row)


def _doubt(row: Row) -> str:
    return _unbroken(" !") if row.doubtful else ""


def _of(found: Sequence[float], view: View) -> str:
    """An estimate with its interval."""
    estimate, low, high = found
    return f"{_number(estimate, view.decimals)} ({_between(low, high, view)})"


def _between(low: float, high: float, view: View) -> str:
    """An interval; where there is no room for all of it, a line may begin with "to"."""
    return " to\xa0".join(_number(x, view.decimals) for x in (low, high)) if low <= high else "–"


def _unbroken(text: str) -> str:
    return text.replace(" ", "\xa0")


def _decimals(rows: Iterable[Row]) -> int:
    """How many decimals show two digits of the usual width of an interval, on its shorter side, from 0 to 5."""
    widths = np.array([min(row.high - row.mean, row.mean - row.low) for row in rows])
    widths = widths[np.isfinite(widths) & (widths > 0)]
    return int(np.clip(1 - np.floor(np.log10(np.median(widths))), 0, 5)) if widths.size else 2


def _number(x: float, decimals: int | None = None) -> str:
    """`x` with so many decimals, or with six digits; a dash where there is none."""
    if np.isnan(x):
        return "–"
    text = f"{round(x, 9) + 0:.6g}" if decimals is None else f"{round(x, decimals) + 0:,.{decimals}f}"
    return text.replace("-", "−").replace(",", "\xa0").replace("inf", "∞")


def _setting(row: Row, view: View) -> str:
    shown = {name: row.setting[name] for name in view.varied if name in row.setting}
    return ", ".join(map(_unbroken, plot.in_words(shown)))


def _setting_of(row: Row, view: View) -> str:
    return ", ".join(filter(None, [describe.title(row.method), _setting(row, view)]))


# --- pictures ----------------------------------------------------------------------------------------


def _pictures(
    label: str, datasets: Datasets, env: Environment, stars: Sequence[Row], view: View
) -> list[Picture]:
    figures = plot.pictures(datasets, env)
    if isinstance(env, Grid) and not view.prediction:
        figures["values"] = plot.value_tables(datasets, env)
    captions = CAPTIONS | (OF_PREDICTION if view.prediction else {})
    ends = ", ".join(f"{describe.title(row.method)} {_number(row.mean, view.decimals)}" for row in stars)
    what = view.what if view.prediction else f"{view.what} at the end"
    optimum = stars[0].optimum
    known = "" if view.prediction or np.isnan(optimum) else f"; exact optimum {_number(optimum)}"
    pictures = []
    for name, figure in figures.items():
        kind, _, parameter = name.partition("_") if name.startswith("sensitivity") else (name, "", "")
        shown = _parameter(datasets, parameter)
        texts = kind == "values" and isinstance(env, Finite) and bool(env.panels())  # hundreds of them
        title = kind.replace("_", " ") + (f" to {shown}" if kind == "sensitivity" else "")
        pictures.append(
            Picture(
                source=embedded(figure, "png" if texts else "svg"),
                alt=f"{title} in {label}; {what}: {ends}{known}",
                caption=captions[kind].format(shown),
                large=texts or kind == "greedy_path",
            )
        )
    return pictures


def _parameter(datasets: Datasets, name: str) -> str:
    """The hyperparameter of a picture: the first picture of sensitivity has no name in its own."""
    if not name:
        swept = [n for ds in datasets.values() for n in stats.hyperparameters(ds) + stats.drawn(ds)]
        first = sorted((n for n in swept if n != "draw"), key=lambda n: n != "alpha")
        name = first[0] if first else ""
    symbol = describe.symbol(name)
    return name if symbol == name else f"{symbol} ({name})"


# --- words -------------------------------------------------------------------------------------------


def _method(name: str) -> str:
    return name.partition("/")[2] or name


def _title(datasets: Datasets, chapters: Sequence[Chapter]) -> str:
    methods = dict.fromkeys(describe.title(method) for chapter in chapters for method in chapter.methods)
    labels = [chapter.label for chapter in chapters]
    return f"{_list(list(methods), 'methods')} in {_list(labels, 'environments')}"


def _list(names: Sequence[str], what: str) -> str:
    if len(names) > 3:
        return f"{len(names)} {what}"
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _count(n: int, what: str) -> str:
    return f"{n:,} {what if n != 1 else what.removesuffix('s')}".replace(",", " ")


def _range(counts: Iterable[int]) -> str:
    return " or ".join(str(n) for n in sorted(set(counts)))


def _speed(name: str, ds: xr.Dataset) -> list[str]:
    """How long a sweep took: name, steps, seconds, seconds of compiling, and million steps per second."""
    steps = int(ds.steps.sum(dtype=np.int64))
    known = [float(ds.attrs.get(key, np.nan)) for key in ("seconds", "compile_seconds", "steps_per_second")]
    known[2] /= 1e6
    return [name, f"{steps:,}".replace(",", " "), *(_number(x, 1) for x in known)]
