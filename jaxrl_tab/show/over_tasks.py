"""Methods over several environments, in a table and in words."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxrl_tab.show.words import decimals_for, number, title_of
from jaxrl_tab.stats.along import Interval
from jaxrl_tab.stats.tasks import Tasks

HEAD = ["method", "interquartile mean", "95% interval", "mean rank", "95% interval"]


def head(tasks: Tasks, beside: str | None = None) -> list[str]:
    """The heads of the columns of `rows`."""
    if tasks.scores.sizes["method"] < 2:
        return HEAD
    return [*HEAD, f"beats {title_of(beside or order(tasks)[0])}", "95% interval"]


def rows(tasks: Tasks, beside: str | None = None) -> list[list[str]]:
    """A row for each method, that with the best mean rank first.

    The last two cells compare the others with `beside`, or with the first.
    """
    names = order(tasks)
    scores, ranks = (_cells(part, names) for part in (tasks.iqm, tasks.mean_rank))
    found = [[title_of(name), *scores[i], *ranks[i]] for i, name in enumerate(names)]
    if len(names) > 1:
        one = beside or names[0]
        others = [name for name in names if name != one]
        beats = _cells(Interval(*(x.sel(other=one) for x in tasks.improvement)), others)
        beats.insert(names.index(one), ["–", "–"])
        found = [[*row, *pair] for row, pair in zip(found, beats, strict=True)]
    return found


def notes(tasks: Tasks, on_fresh: bool) -> Iterator[str]:
    """What a reader of the table must know, in sentences."""
    chosen = "on fresh seeds" if on_fresh else "chosen on these seeds, which flatters it"
    yield (
        "Scores are normalised in each environment: 0 is what the policy earns that takes any action, 1 the optimum, "
        f"both exact. Of each method its best setting there is taken, {chosen}."
    )
    yield (
        "Ranks are among the runs with the same seed in the same environment, 1 is the best. Intervals tell of other "
        "seeds, not of other environments (stratified bootstrap)."
    )
    for name, why in tasks.left_out.items():
        yield f"Left out: {name}, for {why}."


def to_dict(tasks: Tasks) -> dict[str, Any]:
    """The numbers in types that JSON knows: of each mean and bounds."""
    names = tasks.scores.method.values.tolist()
    plain = lambda interval, **at: [float(part.sel(at)) for part in interval[:3]]
    numbers = {
        name: {
            "iqm": plain(tasks.iqm, method=name),
            "mean_rank": plain(tasks.mean_rank, method=name),
            "improvement": {o: plain(tasks.improvement, method=name, other=o) for o in names if o != name},
        }
        for name in names
    }
    return {"methods": numbers, "left_out": tasks.left_out}


def order(tasks: Tasks) -> list[str]:
    """The names of the methods, that with the best mean rank first."""
    places = np.argsort(tasks.mean_rank.estimate.values, kind="stable")
    return [str(tasks.scores.method.values[i]) for i in places]


def _cells(interval: Interval, names: list[str]) -> list[list[str]]:
    """For each method a number, and its interval."""
    means, lows, highs = (part.sel({"method": names}).values for part in interval[:3])
    digits = decimals_for((highs - lows) / 2, 2)
    return [
        [number(mean, digits), f"{number(low, digits)} to {number(high, digits)}"]
        for mean, low, high in zip(means, lows, highs, strict=True)
    ]
