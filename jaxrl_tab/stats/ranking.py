"""New methods ranked among others over several tasks, on the same seeds."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.stats.along import Datasets
from jaxrl_tab.stats.columns import Methods
from jaxrl_tab.stats.comparisons import holm, paired_difference
from jaxrl_tab.stats.intervals import mean_interval
from jaxrl_tab.stats.measures import fixed
from jaxrl_tab.stats.tasks import Tasks, across_tasks
from jaxrl_tab.stats.versus import FEWEST, LENGTHS, SAME_RUNS, is_same_task


class Place(NamedTuple):
    """How a new method does in one task.

    Attributes:
        method, environment: their names.
        score, low, high: its mean normalised score, 0 random and 1 optimal, and the 95% interval.
        rank: by mean scores, among all methods; 1 is the best.
        better, worse: than how many of the others it is, by paired differences with Holm's correction for all
            comparisons of new methods with others in all tasks.
        first: the best of the others by its mean, and that mean.
    """

    method: str
    environment: str
    score: float
    low: float
    high: float
    rank: int
    better: int
    worse: int
    first: tuple[str, float]


class Ranking(NamedTuple):
    """New methods among others, over all tasks that both were run in.

    Attributes:
        new: the names of the new methods.
        tasks: all methods over the tasks.
        places: of each new method in each task.
        seeds: how many seeds they have in common.
        on_fresh: whether these had no part in the choice of settings.
    """

    new: list[str]
    tasks: Tasks
    places: list[Place]
    seeds: int
    on_fresh: bool


def ranking(
    first: Mapping[str, Datasets],
    second: Mapping[str, Datasets],
    envs: Mapping[str, Environment],
    on_fresh: bool,
    confidence: float = 0.95,
) -> Ranking:
    """Methods that only the second results have, among those of the first, on the seeds that both have.

    Args:
        first, second: the datasets of the methods of each environment, each at its best setting.
        envs: the environments by their names, for what the policy earns there that takes any action.
        on_fresh: whether the seeds had no part in the choice of settings.
        confidence: of each interval, and of the verdicts together.

    Raises:
        InputError: there are not two tasks, or six seeds, that both have; the message says why not.
    """
    together: dict[str, dict[str, xr.Dataset]] = {}
    why: dict[str, str] = {}
    names = sorted(
        {name for label, own in second.items() for name in own if name not in first.get(label, {})}
    )
    for label, own in second.items():
        added = {name: ds for name, ds in own.items() if name in names}
        if not added or label not in first:
            continue
        one, other = (next(iter(of.values())) for of in (first[label], added))
        if reason := _unlike(one, other, label in envs):
            why[label] = reason
        else:
            together[label] = {**first[label], **added}
    common = _common_seeds(together)
    if len(together) > 1 and len(common) < FEWEST:
        raise InputError("they have no seeds in common: take the same `seed`, and as many `fresh_seeds`")
    at_best = {
        label: Methods({name: ds.sel(seed=common) for name, ds in of.items()}, envs[label])
        for label, of in together.items()
    }
    try:
        tasks = across_tasks(at_best, confidence)
    except InputError as error:
        raise InputError("; ".join([str(error), *(f"{label}: {x}" for label, x in why.items())])) from None
    tasks = tasks._replace(left_out=tasks.left_out | why)
    new = [name for name in names if name in tasks.scores.method.values]
    if not new:
        raise InputError(
            "; ".join(f"{name}: {x}" for name, x in tasks.left_out.items()) or "there is no new method"
        )
    return Ranking(new, tasks, _places(tasks.scores, new, confidence), len(common), on_fresh)


def _unlike(one: xr.Dataset, other: xr.Dataset, known: bool) -> str:
    """Why the methods of an environment cannot be ranked together; empty where they can."""
    if not known:
        return "it is no environment of ours, so what is random there is not known"
    if not is_same_task(one, other):
        return "it is not the same task in both"
    for key in (*LENGTHS, *SAME_RUNS):
        if one.attrs.get(key) != other.attrs.get(key):
            words = {"num_steps": "steps", "num_episodes": "episodes"}.get(key, "root seeds")
            return f"the runs have other {words}: {one.attrs.get(key)} and {other.attrs.get(key)}"
    gammas = [fixed(ds).get("gamma") for ds in (one, other)]
    return "" if gammas[0] == gammas[1] else f"gamma is {gammas[0]} and {gammas[1]}"


def _common_seeds(together: Mapping[str, Datasets]) -> np.ndarray:
    every = [ds.seed.values for of in together.values() for ds in of.values()]
    common = every[0] if every else np.array([], int)
    for seeds in every:
        common = np.intersect1d(common, seeds)
    return common


def _places(scores: xr.DataArray, new: Sequence[str], confidence: float) -> list[Place]:
    others = [name for name in scores.method.values.tolist() if name not in new]
    beside = scores.sel({"method": others})
    tests = [
        paired_difference(
            scores.sel({"method": name}, drop=True), beside, confidence=confidence, worst=np.inf
        )
        for name in new
    ]
    p = xr.concat([test.p.fillna(1) for test in tests], "new").transpose("new", "environment", "method")
    corrected = holm(xr.DataArray(p.values.ravel(), dims="comparison")).values.reshape(p.shape)
    means = scores.mean("seed")
    places = []
    for i, name in enumerate(new):
        sign = np.sign(tests[i].interval.estimate.transpose("environment", "method").values)
        told = corrected[i] <= 1 - confidence
        score, low, high, _ = mean_interval(scores.sel({"method": name}, drop=True), confidence=confidence)
        for j, label in enumerate(scores.environment.values.tolist()):
            here, own = means.sel(environment=label), float(means.sel({"method": name, "environment": label}))
            best = max(others, key=lambda other: float(here.sel({"method": other})))
            places.append(
                Place(
                    name,
                    label,
                    float(score[j]),
                    float(low[j]),
                    float(high[j]),
                    1 + int((here > own).sum()),
                    int((told[j] & (sign[j] > 0)).sum()),
                    int((told[j] & (sign[j] < 0)).sum()),
                    (best, float(here.sel({"method": best}))),
                )
            )
    return places
