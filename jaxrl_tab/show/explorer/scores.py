"""One number for each setting: how a run did as a whole, with an interval over seeds."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core.errors import check_choice
from jaxrl_tab.show.explorer.measures import POINTS, Flat, Kind, Measure, measures_of
from jaxrl_tab.show.words import significant
from jaxrl_tab.stats.settings import Settings

Middle = Literal["mean", "median"]
SHARES = (0.02, 0.1, 0.3)  # of the way from the worst to the best, so much is left at a threshold


@dataclass(frozen=True)
class Score:
    """A number for each run, and so for each setting its mean, or its median, with an interval.

    Attributes:
        key: its name in the address of the page.
        title: its name for people.
        kind: how its axis is, see `Measure`.
        middle: the statistic.
        code: the lines of Python that work it out, as `x`, from all settings `ds`.
        of: works it out: a number for each run of a sweep, float64 [*hyperparameters, seed].
    """

    key: str
    title: str
    kind: Kind
    middle: Middle
    code: str
    of: Callable[[Flat], xr.DataArray]


def scores_of(ds: xr.Dataset, measures: Sequence[Measure], levels: Sequence[float]) -> list[Score]:
    """The scores for which a dataset has the numbers. The first is the one that settings are chosen by."""
    first = measures[0]
    by_steps = "num_steps" in ds.attrs
    unit = "steps" if by_steps else "episodes"
    lower = first.kind == "cost"
    name, kind = ("mean RMS error, whole run", "cost") if lower else ("mean return, last tenth", "return")
    shown = [
        Score("score", name, kind, "mean", "x = stats.score(ds)", lambda flat: stats.score(flat.ds)),
        Score("interim", "mean return, whole run (interim)", "return", "mean", "x = stats.interim_return(ds)",
              lambda flat: stats.interim_return(flat.ds)),
        Score("area", "area under the curve of returns", "return", "mean",
              f"merged = stats.merge_rows(ds, {POINTS})\n"
              "x = stats.area_under_curve(stats.learning_curve(merged), merged.steps)",
              lambda flat: stats.area_under_curve(flat.returns, flat.merged.steps)),
        Score("early", f"{name.partition(',')[0]}, first tenth", kind, "mean", "x = stats.early_score(ds)",
              lambda flat: stats.early_score(flat.ds)),
        Score("early steps", "steps an episode, first tenth", "cost", "median",
              "x = stats.steps_per_episode(ds, stats.first_tenth(ds))",
              lambda flat: stats.steps_per_episode(flat.ds, stats.first_tenth(flat.ds))),
    ]  # fmt: skip
    word = "an error of" if lower else "a mean return of"
    for level in levels:
        shown.append(
            Score(f"until {level:g}", f"{unit} until {word} {significant(level)}", "cost", "median",
                  _time_code(level, lower, by_steps), partial(_time_to, level=level, lower=lower))
        )  # fmt: skip
    ends: dict[str, tuple[Kind, Middle]] = {
        "greedy_value": ("return", "median"),
        "policy_value": ("return", "median"),
        "q_error": ("cost", "mean"),
        "v_error": ("cost", "mean"),
        "value_error": ("cost", "mean"),
        "bellman_error": ("cost", "mean"),
        "projected_bellman_error": ("cost", "mean"),
    }
    titles = {measure.key: measure.title for measure in measures}
    for name, (kind, middle) in ends.items():
        if name in ds and name in titles:  # not where another method, beside it, lacks it
            shown.append(
                Score(f"{name} end", f"{titles[name]}, at the end", kind, middle,
                      f'x = ds["{name}"].isel(row=-1)', partial(_at_end, name=name))
            )  # fmt: skip
    count, title = (
        ("episodes", "episodes finished in all") if by_steps else ("steps", "time steps taken in all")
    )
    code = f'x = ds.{count}.sum("row")'
    return [*shown, Score(count, title, "count", "mean", code, partial(_sum, name=count))]


def levels_of(middles: np.ndarray, cost: bool) -> list[float]:
    """Thresholds of the first measure between the worst and the best of its curves, [..., points]."""
    finite = middles[np.isfinite(middles)]
    if finite.size == 0 or np.ptp(finite) == 0:
        return []
    best, worst = (finite.min(), finite.max()) if cost else (finite.max(), finite.min())
    left = [best + share * (worst - best) for share in SHARES]
    digits = 2 - int(np.ceil(np.log10(np.ptp(finite))))
    return list(dict.fromkeys(float(round(x, digits)) + 0.0 for x in left))


def score_named(ds: xr.Dataset, key: str) -> Score:
    """The score of this name in the address of the report, or "until -20", with any threshold.

    Raises:
        InputError: the dataset has no such score.
    """
    levels = []
    if key.startswith("until "):
        with contextlib.suppress(ValueError):
            levels = [float(key.removeprefix("until "))]
    scores = {score.key: score for score in scores_of(ds, measures_of(ds), levels)}
    key = f"until {levels[0]:g}" if levels else key
    check_choice(None, "the measure", key, scores)
    return scores[key]


def interval_of(flat: Flat, score: Score, own: Settings) -> stats.Interval:
    """A score with its 95% interval over seeds, [*hyperparameters]. Runs that diverged are in no mean but of the first.

    Args:
        flat: a sweep.
        score: of what.
        own: its settings.
    """
    if score.key == "score":
        return own.interval
    x = score.of(flat)
    if score.middle == "median":
        return stats.median_interval(x)
    return stats.mean_interval(x.where(~flat.ds.diverged) if "diverged" in flat.ds else x)


def intervals(flat: Flat, scores: Sequence[Score], own: Settings) -> np.ndarray:
    """The estimate, the bounds of its 95% interval, and the number of seeds: float64 [settings, scores, 4]."""
    axes = stats.hyperparameters(flat.ds)
    shown = np.full((flat.count, len(scores), 4), np.nan)
    for i, score in enumerate(scores):
        for k, part in enumerate(interval_of(flat, score, own)):
            shown[:, i, k] = np.asarray(part.transpose(*axes)).reshape(-1)
    return shown


def _time_to(flat: Flat, level: float, lower: bool) -> xr.DataArray:
    merged, curve = (flat.ds, flat.ds.v_error) if lower else (flat.merged, flat.returns)
    time = merged.steps if "num_steps" in flat.ds.attrs else merged.episodes
    return stats.time_to_threshold(curve, level, time.cumsum("row"), at_most=lower)


def _at_end(flat: Flat, name: str) -> xr.DataArray:
    return flat.ds[name].isel(row=-1).astype(float)


def _sum(flat: Flat, name: str) -> xr.DataArray:
    return flat.ds[name].sum("row").astype(float)


def _time_code(level: float, lower: bool, by_steps: bool) -> str:
    curve = "ds.v_error" if lower else "stats.learning_curve(merged)"
    unit = "time_steps" if by_steps else "episodes"
    merged = "ds" if lower else f"stats.merge_rows(ds, {POINTS})"
    end = ", at_most=True" if lower else ""
    return (
        f"merged = {merged}\n"
        f"x = stats.time_to_threshold({curve}, {level!r}, stats.episode_curve(merged).{unit}{end})"
    )
