"""What a search tried, in words: a row for each rung, and what was found; and what is drawn of it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from numbers import Real
from typing import Any, NamedTuple

from jaxrl_tab.show.words import symbol

BY = {"score": "score", "return": "return", "episodes": "episodes", "steps": "minus steps", "error": "error"}


WIDE = 10  # times its low end a range has as its high end that is drawn on a logarithmic axis


def seeds_in_words(seeds: int) -> str:
    return f"{seeds:,} seed{'s' if seeds > 1 else ''}"


class Way(NamedTuple):
    """How far a setting came in a search.

    Attributes:
        number: of the setting, among those of its method.
        setting: the hyperparameters that were searched.
        ranks: how good it was in each rung that it reached, among all that reached it: 1 is the best.
        scores: by what it was judged there, as text.
        found: whether it is the one that was found.
    """

    number: int
    setting: Mapping[str, Any]
    ranks: tuple[int, ...]
    scores: tuple[str, ...]
    found: bool


class Ways(NamedTuple):
    """How far each setting of a method came.

    Attributes:
        method: its label.
        rungs: of each rung the length of a run, the number of seeds, how many settings reached it, and by what they
            were judged.
        all: the settings, the one that was found first, and then those that came farthest.
        axes: the names of the first two hyperparameters that are numbers in all settings, if there are two.
    """

    method: str
    rungs: list[tuple[int, int, int, str]]
    all: list[Way]
    axes: list[str]


def ways(tried: Sequence[Any]) -> list[Ways]:
    """How far the settings of each method came; `tried` as `Outcome.tried` has it."""
    return [
        _ways(x, [one for one in tried if one.method == x]) for x in dict.fromkeys(x.method for x in tried)
    ]


def _ways(method: str, own: Sequence[Any]) -> Ways:
    count = 1 + max(one.rung for one in own)
    rungs = [sorted((one for one in own if one.rung == k), key=_rank) for k in range(count)]
    trials: dict[int, list[tuple[int, Any]]] = {}
    for rung in rungs:
        for place, one in enumerate(rung, 1):
            trials.setdefault(one.trial, []).append((place, one))
    every = [
        Way(
            number,
            steps[0][1].setting,
            tuple(place for place, _ in steps),
            tuple(_score(one) for _, one in steps),
            len(steps) == count and steps[-1][1].goes_on,
        )
        for number, steps in trials.items()
    ]
    every.sort(key=lambda way: (not way.found, -len(way.ranks), way.ranks[::-1]))
    is_number = lambda name: all(isinstance(way.setting.get(name), Real) for way in every)
    names = dict.fromkeys(name for way in every for name in way.setting)
    axes = [name for name in names if is_number(name)][:2]
    return Ways(
        method,
        [(rung[0].length, rung[0].seeds, len(rung), _judged_by(rung[0])) for rung in rungs],
        every,
        axes if len(axes) == 2 else [],
    )


def wide(searches: Sequence[Ways]) -> set[str]:
    """The names of the axes that are logarithmic, in all methods."""
    values: dict[str, list[float]] = {}
    for one in searches:
        for name in one.axes:
            values.setdefault(name, []).extend(way.setting[name] for way in one.all)
    return {name for name, x in values.items() if min(x) > 0 and max(x) >= WIDE * min(x)}


def decades(low: float, high: float) -> list[float]:
    """Where a logarithmic axis has its numbers: at 1 and 3 of each power of ten."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [x for power in powers for digit in (1, 3) if low <= (x := digit * 10.0**power) <= high]


def head(tried: Sequence[Any]) -> list[str]:
    """The columns; `tried` as `Outcome.tried` has it. The round stands there where there are several."""
    rounds = ["round"] if _several_rounds(tried) else []
    return ["method", *rounds, "settings", "length", "seeds", "the best of them", "its score", "judged by"]


def rows(tried: Sequence[Any]) -> Iterator[list[str]]:
    """For each rung how many settings there were, for how long, and which was the best."""
    several = _several_rounds(tried)
    for (method, number, _), group in groupby(tried, lambda x: (x.method, x.round, x.rung)):
        own = list(group)
        best = min(own, key=_rank)
        yield [
            method,
            *([str(number + 1)] if several else []),
            str(len(own)),
            f"{own[0].length:,}",
            str(own[0].seeds),
            in_words(best.setting),
            _score(best),
            _judged_by(best),
        ]


def notes(tried: Sequence[Any]) -> Iterator[str]:
    """What was found, and what it took, in sentences."""
    for method in dict.fromkeys(one.method for one in tried):
        own = [one for one in tried if one.method == method]
        last = max(one.rung for one in own)
        found = next(one for one in own if one.rung == last and one.goes_on)
        count = len({one.trial for one in own})
        whole = count * found.length * found.seeds
        yield (
            f"{method}: {in_words(found.setting)} was found among {count} settings, with "
            f"{work(own) / whole:.0%} of what it takes to run all of them to the end."
        )


def work(tried: Sequence[Any]) -> int:
    """How many steps (or episodes) all runs of a method took together."""
    most: dict[int, int] = {}
    for one in tried:
        most[one.trial] = max(most.get(one.trial, 0), one.length * one.seeds)
    return sum(most.values())


def in_words(setting: Mapping[str, Any]) -> str:
    """A setting in a line."""
    number = lambda x: f"{x:.3g}" if isinstance(x, float) else str(x)
    return ", ".join(f"{symbol(name)} {number(x)}" for name, x in setting.items())


def _score(one: Any) -> str:
    return "–" if one.score is None else f"{one.score:.4g}".replace("-", "−")


def _judged_by(one: Any) -> str:
    where = "" if one.by in ("score", "error") else ", second half"
    return f"{BY[one.by]}{where}"


def _rank(one: Any) -> tuple[int, float]:
    score = float("-inf") if one.score is None else one.score
    return one.lost, score if one.by == "error" else -score


def _several_rounds(tried: Sequence[Any]) -> bool:
    return any(one.round for one in tried)
