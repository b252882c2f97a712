"""How runs did while they still learned: their first episode, their first tenth, and the whole of them.

Which method is best in the end says little about which learns fastest. `early_score` is by what settings are compared
early; the rest is what people look at beside the final `score`.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.stats.along import Interval, by_seeds
from jaxrl_tab.stats.column import Column
from jaxrl_tab.stats.comparisons import Difference, paired_difference
from jaxrl_tab.stats.intervals import mean_interval
from jaxrl_tab.stats.measures import (
    Measure,
    diverged_runs,
    earned,
    has_errors,
    last_tenth,
    mean_error,
    only_costs,
    sound_runs,
    standstill,
    unfinished,
    within,
)
from jaxrl_tab.stats.settings import Settings, Sweep, ranked

ROUNDING = 1e-4  # relative, of sums of float32


def first_tenth(ds: xr.Dataset) -> slice:
    """The rows that end in the first tenth of the steps (of the episodes, where these were the budget).

    Where rows are so long that none does, the first row.
    """
    budget = ds.attrs["num_steps"] if "num_steps" in ds.attrs else ds.attrs["num_episodes"]
    return slice(max(1, int(budget) // (10 * int(ds.attrs["log_every"]))))


@by_seeds
def first_episode(ds: xr.Dataset) -> xr.DataArray:
    """Steps until the end of the first episode, float64 [*hyperparameters, seed].

    Where several episodes ended in the same row of the log, until the end of the last of these, for the log does not
    tell them apart. Infinite where no episode ended; NaN where a run diverged.
    """
    ended = ds.episodes > 0
    row = ended.argmax("row")
    steps = ds.lengths.isel(row=row, drop=True).astype(float)
    return sound_runs(steps.where(ended.any("row"), np.inf), ds)


def steps_per_episode(ds: xr.Dataset, rows: slice = slice(None)) -> xr.DataArray:
    """The steps that were taken in `rows` over the episodes that ended there, float64 [*hyperparameters, seed].

    So the steps of an episode that did not end there count as well, and a run that is stuck has no short episodes to
    show for itself. Infinite where none ended ("none yet"); NaN where a run diverged.
    """
    steps, episodes = (_sum(ds, name, rows) for name in ("steps", "episodes"))
    return sound_runs((steps / episodes.where(episodes > 0)).fillna(np.inf), ds)


def reward_per_step(ds: xr.Dataset, rows: slice = slice(None)) -> xr.DataArray:
    """What a step in `rows` earned on average, undiscounted, float64 [*hyperparameters, seed].

    NaN where a run diverged. It is what there is to compare where a task does not end.
    """
    return sound_runs(_sum(ds, "rewards", rows).astype(float) / _sum(ds, "steps", rows), ds)


def steps_of_all(ds: xr.Dataset, rows: slice) -> xr.DataArray:
    """`steps_per_episode` of all runs together, all their steps over all their episodes, [*hyperparameters].

    So settings are in the order of their mean `pace`. Runs that diverged are left out; NaN where all did.
    """
    sound = ~diverged_runs(ds).values
    steps, episodes = ((_sum(ds, name, rows).values * sound).sum(-1) for name in ("steps", "episodes"))
    of_all = np.where(episodes > 0, steps / np.maximum(episodes, 1), np.where(steps > 0, np.inf, np.nan))
    return ds.episodes.isel(seed=0, row=0, drop=True).copy(data=of_all)


@by_seeds
def _sum(ds: xr.Dataset, name: str, rows: slice) -> xr.DataArray:
    return ds[name].isel(row=rows).sum("row")


def by_length(ds: xr.Dataset) -> bool:
    """Whether an episode is worth the more the shorter it is, and nothing else matters: as of ways to a goal.

    That is so where every step costs the same, or nothing, and the end always pays the same; it is seen in the rewards.
    Where nothing is paid before the goal and gamma is 1, returns then cannot tell a quick method from a slow one.
    """
    if has_errors(ds) or "rewards" not in ds:
        return False

    def counts(some: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
        steps, episodes, rewards = (some[name].values.ravel() for name in ("steps", "episodes", "rewards"))
        return np.stack([steps, episodes], -1).astype(float), rewards

    x, rewards = counts(ds.isel(seed=0))
    if not np.isfinite(rewards).all():
        return False
    pay = np.linalg.lstsq(x, rewards, rcond=None)[0]
    step, end = np.where(abs(pay) > ROUNDING * abs(pay).sum(), pay, 0)
    if step > 0 or (step == 0 and end <= 0):
        return False

    @by_seeds
    def as_paid(some: xr.Dataset) -> xr.DataArray:
        x, rewards = counts(some)
        right = abs(rewards - x @ (step, end)) <= ROUNDING * (x @ (abs(step), abs(end)))
        return some.episodes.copy(data=right.reshape(some.episodes.shape)).all("row")

    return bool((as_paid(ds) | diverged_runs(ds)).all())


def pace(ds: xr.Dataset) -> xr.DataArray:
    """How quickly episodes ended in the first tenth, the higher the better, float64 [*hyperparameters, seed].

    How many ended, or, where episodes were the budget, minus the steps that they took: a number for every run, also for
    one in which none ended. NaN where a run diverged.
    """
    return _pace(ds, first_tenth(ds))


def _pace(ds: xr.Dataset, rows: slice) -> xr.DataArray:
    name, sign = ("episodes", 1.0) if "num_steps" in ds.attrs else ("steps", -1.0)
    return sound_runs(sign * _sum(ds, name, rows), ds)


def promise(ds: xr.Dataset) -> xr.DataArray:
    """How well a run did in the second half of it, so that one can tell whether a longer one is worth while.

    Where an episode is worth the more the shorter it is, it is how many ended there, as `pace` has it; else what
    `score` says, of that half: float64 [*hyperparameters, seed], NaN where a run diverged. Of prediction it is `score`.
    In a short run the last tenth, of which `score` is, says little, and flatters runs in which no episode ended there.
    """
    if has_errors(ds):
        return mean_error(ds)
    rows = slice(ds.sizes["row"] // 2, None)
    return _pace(ds, rows) if by_length(ds) else earned(ds, rows)


def early_score(ds: xr.Dataset) -> xr.DataArray:
    """What `score` says of the last tenth, of the first one, float64 [*hyperparameters, seed]; of prediction the error.

    NaN (of prediction infinite) where a run diverged.
    """
    rows = first_tenth(ds)
    return mean_error(ds, rows) if has_errors(ds) else earned(ds, rows)


def interim_return(ds: xr.Dataset) -> xr.DataArray:
    """Interim performance: the mean return of all episodes of the run, float64 [*hyperparameters, seed].

    Every episode weighs the same. (So it is in van Seijen et al. 2009, A theoretical and empirical analysis of Expected
    Sarsa, where runs have a number of episodes.) A run that finished none in all its steps has the rewards that it
    collected, as in `score`. NaN where a run diverged.
    """
    return earned(ds, slice(None))


class Early(NamedTuple):
    """A setting that is better early than the one that wins in the end.

    Attributes:
        quick: the method that is the best early, and its setting, fit for `ds.sel`.
        winner: the method that has the best score, and its setting.
        by: what was compared: `pace` where episodes earn by their length alone, else `early_score`.
        difference: of the two, seed by seed, so that above 0 means that `quick` is better; with the interval that is
            right for all pairs of settings together.
    """

    quick: tuple[str, dict[str, Any]]
    winner: tuple[str, dict[str, Any]]
    by: Measure
    difference: Difference


def better_early(datasets: Mapping[str, Sweep]) -> Early | None:
    """Whether another setting than the one with the best score is better over the first tenth of the run.

    Both were chosen on these seeds, one of them early and one late. So the interval of their difference is corrected
    for all pairs of settings (Bonferroni), and nothing is said where it holds 0: of 2 or 6 settings that are all alike,
    with 10 to 100 seeds, something was said in 0.2 to 1.9% of 800 to 1500 experiments. Stuck runs are accounted for as
    in `differences`.

    Args:
        datasets: for each method a sweep; all of control, or all of prediction.

    Returns:
        The two; None where they are the same, are not surely different, or have not the same seeds.
    """
    methods = {name: Settings.of(ds) for name, ds in datasets.items()}
    by = pace if all(own.once(by_length) for own in methods.values()) else early_score
    first = {name: Settings(own.ds, by) for name, own in methods.items()}
    quick, winner = ranked(first)[0], ranked(methods)[0]
    places = (quick, first[quick].best), (winner, methods[winner].best)
    x, y = (first[name].merit.sel(place).reset_coords(drop=True) for name, place in places)
    if places[0] == places[1] or not np.array_equal(x.seed, y.seed):
        return None
    settings = sum(own.merit.size // own.merit.sizes["seed"] for own in methods.values())
    pairs = settings * (settings - 1) / 2
    worst = 0.0 if by is pace else min(float(own.once(standstill).min()) for own in methods.values())
    difference = paired_difference(x, y, confidence=1 - 0.05 / pairs, worst=worst)
    return Early(*places, by, difference) if difference.interval.low > 0 else None


def _interval(own: Any, x: xr.DataArray) -> Interval:
    """The mean over the runs that did not diverge, with its interval."""
    return within(mean_interval(x.where(np.isfinite(x))), x, own.ds, own.once(only_costs))


def _control(own: Any, of: Callable[[xr.Dataset], Any]) -> Any:
    """Of prediction, where a policy is given, nothing is told of episodes."""
    return None if own.prediction else of(own.ds)


def _of_episodes(own: Any, of: Callable[[xr.Dataset], Any]) -> Any:
    """Where the lengths of episodes are not known, as of what others computed, a score may be of no episode at all."""
    return _control(own, of) if "lengths" in own.ds else None


def _is_over_time(ds: xr.Dataset) -> bool:
    """Whether there is anything early: of what others computed there may be one score for each run."""
    return "lengths" in ds or ds.sizes["row"] > 1


# Of the table of settings, beside the score: see `columns`.
EARLY = [
    Column(
        "reward_per_step",
        lambda own: (
            reward_per_step(own.ds, last_tenth(own.ds)).mean("seed") if own.among.continuing else None
        ),
        screen="reward\na step,\nlast tenth",
        report="reward a step, last tenth",
        written="exact",
        help="what a step there earned on average, undiscounted; the task does not end.",
    ),
    Column(
        "first_episode_steps",
        lambda own: _of_episodes(own, lambda ds: first_episode(ds).median("seed")),
        report="steps until the end of the first episode",
        tables=("early",),
        written="steps",
        help="the median over seeds, known as exactly as the rows of the log are long.",
    ),
    Column(
        "early_steps",
        lambda own: _of_episodes(own, lambda ds: steps_of_all(ds, first_tenth(ds))),
        in_summary="first_tenth_steps",
        screen="steps an\nepisode,\nfirst tenth",
        report="steps an episode, first tenth",
        tables=("early",),
        by_length=True,
        written="steps",
        help="all steps that the runs took in their first tenth, over all episodes that ended there.",
    ),
    Column(
        "late_steps",
        lambda own: _of_episodes(own, lambda ds: steps_of_all(ds, last_tenth(ds))),
        in_summary="last_tenth_steps",
        screen="steps an\nepisode,\nlast tenth",
        report="steps an episode, last tenth",
        tables=("early",),
        by_length=True,
        written="steps",
        help="the same of the last tenth.",
    ),
    Column(
        "early_unfinished",
        lambda own: _of_episodes(own, lambda ds: unfinished(ds, first_tenth(ds)).sum("seed")),
        in_summary="first_tenth_unfinished",
        report="runs without an episode in the first tenth",
        tables=("early",),
        written="count",
        help="how many runs finished no episode in their first tenth.",
    ),
    Column(
        "early_score",
        lambda own: _interval(own, early_score(own.ds)) if _is_over_time(own.ds) else None,
        in_summary=("first_tenth_return", "first_tenth_v_error"),
        screen=("mean return,\nfirst tenth", "RMS error,\nfirst tenth"),
        report=("mean return, first tenth", "mean error, first tenth"),
        tables=("early",),
        by_length=False,
        written="middle",
        help="of the first tenth of the runs, while the most is still to be learned.",
    ),
    Column(
        "interim",
        lambda own: (
            _control(own, lambda ds: _interval(own, interim_return(ds))) if _is_over_time(own.ds) else None
        ),
        in_summary="interim_return",
        report="mean return, whole run",
        tables=("early",),
        written="middle",
        help="of all episodes from the first on: interim performance.",
    ),
]
