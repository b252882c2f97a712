"""Methods over several tasks, whose scores are made comparable by what is known of each exactly."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.core.checks import FRACTION, check_within
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.values import any_action
from jaxrl_tab.stats.along import Interval, blocks, check_dims, name_list
from jaxrl_tab.stats.bootstrap import RESAMPLES, bootstrap_interval, iqm_interval, percentile_bounds
from jaxrl_tab.stats.columns import Methods
from jaxrl_tab.stats.measures import optimum

CUT_OFF = 1e-3  # how much what comes after the time limit of a task without an end may count, gamma^max_steps


class Tasks(NamedTuple):
    """Methods over several tasks, each at its best setting in each.

    Attributes:
        scores: 0 is what the policy earns that takes any action, 1 the optimum: float64 [method, environment, seed].
        iqm: the interquartile mean of all runs in all tasks, [method].
        mean_rank: the rank among the methods, 1 is the best: see the function of this name, [method].
        improvement: how probable it is that a run of `method` is better than one of `other` in a task that is drawn
            at random, [method, other]; 0.5 on the diagonal.
        left_out: what is not in these numbers, and why: by the names of environments, or "ENVIRONMENT/METHOD".
    """

    scores: xr.DataArray
    iqm: Interval
    mean_rank: Interval
    improvement: Interval
    left_out: dict[str, str]

    def __repr__(self) -> str:
        methods, environments = (
            ", ".join(map(str, self.scores[dim].values)) for dim in ("method", "environment")
        )
        return f"<Tasks: {methods} over {environments}>"

    def _repr_html_(self) -> str:
        rows = []
        for name in self.scores["method"].values:
            parts = [
                [float(x.sel({"method": name})) for x in part[:3]] for part in (self.iqm, self.mean_rank)
            ]
            rows.append([str(name), *(f"{x:.4g} ({low:.4g} to {high:.4g})" for x, low, high in parts)])
        return table(repr(self)[1:-1], ("method", "interquartile mean", "mean rank"), rows)


def random_value(env: Environment, gamma: float = 1.0) -> float:
    """What the policy earns from the start, on average, that takes any action: exact; NaN where that is not known.

    −∞ where it may go round for ever, and pays for it. Time limits are not looked at.
    """
    try:
        return planning.policy_value(env, any_action(planning.exact_model(env)), gamma)
    except InputError:
        return np.nan


def normalised(x: xr.DataArray, random: float, optimal: float) -> xr.DataArray:
    """Scores on the scale on which `random` is 0 and `optimal` is 1, float64; below 0 is worse than random.

    Raises:
        InputError: the two are no finite numbers, or the optimum is not above what is random.
    """
    if not (np.isfinite([random, optimal]).all() and optimal > random):
        raise InputError(
            f"no scale has {random:g}, which is random, at 0 and {optimal:g}, which is optimal, at 1"
        )
    return (x.astype(float) - random) / (optimal - random)


def across_tasks(methods: Mapping[str, Methods], confidence: float = 0.95) -> Tasks:
    """What is said of methods over several tasks (Agarwal et al. 2021, "Deep reinforcement learning at the edge of the
    statistical precipice"), with intervals from a bootstrap of the seeds within each task (stratified).

    The tasks are those that there are, and not drawn from any: intervals tell of other seeds, not of other tasks. The
    settings were chosen on these seeds, which flatters methods with many of them; of fresh seeds (`select`) they are
    not. What is called random is exact, as the optimum is. `performance_profile(tasks.scores, thresholds,
    within="environment")` has the whole distribution. Of a task that does not end the return is that of an episode up
    to its time limit, where what comes later hardly counts: gamma^max_steps is at most a thousandth.

    Args:
        methods: the methods of each environment, such as `Outcome.methods` or `Outcome.fresh_methods`.
        confidence: of each interval.

    Raises:
        InputError: fewer than two tasks, or no method, are left; the seeds are not as many everywhere.
    """
    check_within("confidence", confidence, FRACTION)
    scores: dict[str, dict[str, xr.DataArray]] = {}
    left_out = {}
    for label, own in methods.items():
        if (env := own.env) is None or own.prediction:
            left_out[label] = "it has no returns from the start to an end, or is not known"
            continue
        if why := _cut_off(own, env):
            left_out[label] = why
            continue
        for name, settings in own.settings.items():
            best = float(optimum(settings.ds.sel(settings.best)))
            random = random_value(env, float(settings.chosen.get("gamma", 1.0)))
            try:
                scaled = normalised(settings.score.sel(settings.best), random, best)
            except InputError as error:
                left_out[label] = str(error)
                scores.pop(label, None)
                break
            scores.setdefault(label, {})[name] = scaled.reset_coords(drop=True)
    names = [name for name in next(iter(scores.values()), {}) if all(name in of for of in scores.values())]
    for label, of in scores.items():
        left_out |= {f"{label}/{name}": "it is not in all tasks" for name in of if name not in names}
    if len(scores) < 2 or not names:
        why = "".join(f"; {label}: {reason}" for label, reason in left_out.items())
        raise InputError(
            f"two tasks or more are needed that the same method was run in; there are {name_list(scores)}{why}"
        )
    if len({of[name].sizes["seed"] for of in scores.values() for name in names}) > 1:
        raise InputError("the seeds must be as many in all tasks")
    x = xr.concat(
        [
            xr.concat([of[name].drop_vars("seed", errors="ignore") for name in names], "method")
            for of in scores.values()
        ],
        "environment",
    ).assign_coords(method=names, environment=list(scores))
    x = x.transpose("method", "environment", "seed")
    return Tasks(
        x,
        iqm_interval(x, "seed", "environment", confidence),
        mean_rank(x, "seed", "environment", confidence),
        mean_improvement(x, "seed", "environment", confidence),
        left_out,
    )


def _cut_off(own: Methods, env: Environment) -> str | None:
    """Why the exact values of the start are no scale for the returns of a task without an end; None where they are."""
    gammas = [float(settings.chosen.get("gamma", 1.0)) for settings in own.settings.values()]
    if not own.continuing or max(gammas, default=1.0) ** env.max_steps <= CUT_OFF:
        return None
    return (
        f"it has no end, and what comes after its {env.max_steps} steps counts: take a smaller gamma, or larger "
        "max_steps"
    )


def mean_rank(
    x: xr.DataArray, dim: str = "seed", within: str = "environment", confidence: float = 0.95
) -> Interval:
    """The rank of each method among the runs with the same seed in the same task, on average; 1 is the best.

    Ties share their ranks. A NaN is a run without a score, worse than any other. The interval is that of
    `bootstrap_interval`: whole seeds are resampled, task by task, so it knows that a seed is luck for all methods.

    Args:
        x: scores, higher is better, [method, within, dim].
        dim, within, confidence: as in `bootstrap_interval`.

    Returns:
        Mean and bounds, [method].
    """
    from scipy import stats  # here, because it takes half a second

    check_dims(x, ["method", within, dim])
    ordered = x.fillna(-np.inf).transpose("method", within, dim)
    ranks = ordered.copy(data=stats.rankdata(-ordered.values, axis=0))
    found = bootstrap_interval(ranks, np.mean, dim, within, confidence)
    return found._replace(low=found.low.clip(min=1), high=found.high.clip(max=x.sizes["method"]))


def mean_improvement(
    x: xr.DataArray, dim: str = "seed", within: str = "environment", confidence: float = 0.95
) -> Interval:
    """How probable it is that a run of a method is better than one of another, in a task drawn from these.

    The mean over tasks of what `probability_of_improvement` has in each: ties count half, a NaN is worse than any. The
    interval is from a bootstrap of whole seeds, task by task, as `bootstrap_interval` has it.

    Args:
        x: scores, higher is better, [method, within, dim].
        dim, within, confidence: as in `bootstrap_interval`.

    Returns:
        Probability and bounds, [method, other], and the number of runs of each.
    """
    check_within("confidence", confidence, FRACTION)
    check_dims(x, ["method", within, dim])
    values = x.fillna(-np.inf).transpose("method", within, dim).values.astype(float)
    count, tasks, n = values.shape
    estimate = np.full((count, count), 0.5)
    bounds = np.full((2, count, count), 0.5)
    draws = [np.random.default_rng((0, task)) for task in range(tasks)]
    weights = [rng.multinomial(n, np.full(n, 1 / n), RESAMPLES) / n for rng in draws]
    for i in range(count):
        for j in range(i):
            wins = _wins(values[i], values[j])  # [tasks, n, n]
            estimate[i, j] = wins.mean()
            resampled = np.mean([_mean_wins(*pair) for pair in zip(weights, wins, strict=True)], axis=0)
            low, high = percentile_bounds(resampled[None], n * tasks, tasks, confidence)[:, 0]
            bounds[:, i, j] = np.clip([low, high], 0, 1)
            estimate[j, i], bounds[:, j, i] = 1 - estimate[i, j], 1 - bounds[::-1, i, j]
    coords = {"method": x.method.values, "other": x.method.values} if "method" in x.coords else {}
    mean, low, high = (xr.DataArray(part, coords, ("method", "other")) for part in (estimate, *bounds))
    return Interval(mean, low, high, xr.full_like(mean, n * tasks, dtype=int))


def _mean_wins(weights: np.ndarray, wins: np.ndarray) -> np.ndarray:
    """The share of pairs that are won, of resamples with these weights [resamples, n], from `wins` [n, n]."""
    parts = [((weights[some] @ wins) * weights[some]).sum(1) for some in blocks(len(weights), wins.shape[0])]
    return np.concatenate(parts)


def _wins(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """1 where a run of x is better than one of y, 0.5 where it is as good: [tasks, runs of x, runs of y]."""
    x, y = x[:, :, None], y[:, None, :]
    return (x > y) + 0.5 * (x == y)
