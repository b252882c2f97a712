"""What the report shows of a search: which settings were tried, who was left, and what the found ones are worth."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from jaxrl_tab.show import searched
from jaxrl_tab.show.searched import Way, Ways, in_words, seeds_in_words
from jaxrl_tab.show.words import symbol, title_of

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 340, 240, 46, 14, 12, 48  # of a drawing, and around its axes


class Mark(NamedTuple):
    """A setting in a drawing.

    Attributes:
        kind: "found", "on" or "out": how far it came.
        about: what it is, in words.
        places: (x, y) of each rung that it reached; one where all settings lie in the plane of two hyperparameters.
        size: of its points.
    """

    kind: str
    about: str
    places: list[tuple[float, float]]
    size: float


class Drawing(NamedTuple):
    """A drawing without numbers of its own: where what is drawn.

    Attributes:
        title, along, down: what it shows, and the names of its axes.
        across, up: the places on the axes that have names: each with its lines of text.
        marks: the settings; the one that was found is the last.
    """

    title: str
    along: str
    down: str
    across: list[tuple[float, list[str]]]
    up: list[tuple[float, str]]
    marks: list[Mark]


class Method(NamedTuple):
    """A method: its title, drawings, and a row for each setting."""

    title: str
    drawings: list[Drawing]
    head: list[str]
    rows: list[list[str]]


class Search(NamedTuple):
    """The section of a search: a table of rungs, sentences, what was found on fresh seeds, and each method."""

    head: list[str]
    rows: list[list[str]]
    notes: list[str]
    found_head: list[str]
    found_rows: list[list[str]]
    methods: list[Method]


def section(tried: Sequence[Any], unit: str, fresh: Mapping[str, str], seeds: int, what: str) -> Search:
    """What the report shows of a search.

    Args:
        tried: as `Outcome.tried` has it, and not empty.
        unit: of the length of runs, "steps" or "episodes".
        fresh: what the setting that was found is worth on fresh seeds, with its interval, by method.
        seeds: how many of these there are.
        what: what is measured, such as "mean return".
    """
    searches = searched.ways(tried)
    logarithmic = searched.wide(searches)
    return Search(
        searched.head(tried),
        [[title_of(method), *cells] for method, *cells in searched.rows(tried)],
        list(searched.notes(tried)),
        ["method", "found", "its score in the search", f"{what} (95% interval), {seeds:,} fresh seeds"],
        [
            [title_of(one.method), in_words(way.setting), way.scores[-1], fresh.get(one.method, "–")]
            for one in searches
            for way in one.all[:1]
        ],
        [_method(one, unit, logarithmic) for one in searches],
    )


def _method(one: Ways, unit: str, logarithmic: set[str]) -> Method:
    drawings = [*([_plane(one, logarithmic)] if one.axes else []), _ranks(one, unit)]
    head = ["setting", *(f"{length:,} {unit}, {seeds_in_words(seeds)}" for length, seeds, *_ in one.rungs)]
    gaps = len(one.rungs)
    rows = [
        [
            f"{'★ ' if way.found else ''}{in_words(way.setting)}",
            *way.scores,
            *["" for _ in range(gaps - len(way.scores))],
        ]
        for way in one.all
    ]
    return Method(title_of(one.method), drawings, head, rows)


def _plane(one: Ways, logarithmic: set[str]) -> Drawing:
    """Where the settings lie, by their first two hyperparameters."""
    scales = [_scale([way.setting[name] for way in one.all], name in logarithmic) for name in one.axes]
    (across, along), (up, down) = scales
    x, y = one.axes
    marks = [
        _mark(way, one, [(_x(across(way.setting[x])), _y(up(way.setting[y])))], 3 + 1.5 * len(way.ranks))
        for way in reversed(one.all)
    ]
    return Drawing(
        "Where the settings lie",
        symbol(x),
        symbol(y),
        [(_x(across(value)), [f"{value:g}"]) for value in along],
        [(_y(up(value)), f"{value:g}") for value in down],
        marks,
    )


def _ranks(one: Ways, unit: str) -> Drawing:
    """How good the settings were in each rung: the best at the top."""
    last, most = max(1, len(one.rungs) - 1), math.log(max(2, one.rungs[0][2]))
    place = lambda k, rank: (_x(k / last), _y(1 - math.log(rank) / most))
    marks = [
        _mark(way, one, [place(k, rank) for k, rank in enumerate(way.ranks)], 3) for way in reversed(one.all)
    ]
    across = [
        (_x(k / last), [f"{length:,} {unit}", seeds_in_words(seeds)])
        for k, (length, seeds, *_) in enumerate(one.rungs)
    ]
    counts = sorted({1, *(count for _, _, count, _ in one.rungs)})
    return Drawing(
        "Who was left, rung after rung",
        "",
        "place",
        across,
        [(place(0, n)[1], str(n)) for n in counts],
        marks,
    )


def _mark(way: Way, one: Ways, places: list[tuple[float, float]], size: float) -> Mark:
    kind = "found" if way.found else "on" if len(way.ranks) > 1 else "out"
    steps = ", ".join(
        f"{place} of {count} ({score})"
        for place, (_, _, count, _), score in zip(way.ranks, one.rungs, way.scores, strict=False)
    )
    return Mark(kind, f"{in_words(way.setting)}: {steps}", places, size)


def _scale(values: Sequence[float], is_logarithmic: bool) -> tuple[Callable[[float], float], list[float]]:
    """From values to places from 0 to 1, and which values have their numbers on the axis."""
    low, high = min(values), max(values)
    if is_logarithmic:
        start, length = math.log(low), max(math.log(high / low), 1e-9)
        return lambda x: (math.log(x) - start) / length, searched.decades(low, high) or [low, high]
    length = high - low or 1
    size = 10.0 ** math.floor(math.log10(length))
    step = next(size * x for x in (0.2, 0.5, 1, 2) if length / (size * x) <= 5)
    numbers = [step * n for n in range(math.ceil(low / step), math.floor(high / step) + 1)]
    return lambda x: (x - low) / length, [round(x, 12) for x in numbers]


def _x(part: float) -> float:
    return round(LEFT + 8 + part * (WIDTH - LEFT - RIGHT - 16), 1)


def _y(part: float) -> float:
    return round(HEIGHT - BOTTOM - 8 - part * (HEIGHT - TOP - BOTTOM - 16), 1)
