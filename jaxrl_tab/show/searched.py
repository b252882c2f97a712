"""What a search tried, in words: a row for each rung, and what was found."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from jaxrl_tab.show.words import symbol

BY = {"score": "score", "return": "return", "episodes": "episodes", "steps": "minus steps", "error": "error"}


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
        score = "–" if best.score is None else f"{best.score:.4g}"
        where = "" if best.by in ("score", "error") else ", second half"
        yield [
            method,
            *([str(number + 1)] if several else []),
            str(len(own)),
            f"{own[0].length:,}",
            str(own[0].seeds),
            in_words(best.setting),
            score,
            f"{BY[best.by]}{where}",
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


def _rank(one: Any) -> tuple[int, float]:
    score = float("-inf") if one.score is None else one.score
    return one.lost, score if one.by == "error" else -score


def _several_rounds(tried: Sequence[Any]) -> bool:
    return any(one.round for one in tried)
