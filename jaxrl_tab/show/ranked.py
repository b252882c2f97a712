"""New methods among others over several environments, in tables and in words."""

from collections.abc import Iterator
from typing import Any

from jaxrl_tab.show import over_tasks
from jaxrl_tab.show.words import counted, number, title_of
from jaxrl_tab.stats.ranking import Place, Ranking

HEAD = ["environment", "score", "95% interval", "rank", "better than", "worse than", "best of the others"]
DECIMALS = 3  # of normalised scores


def sentences(ranking: Ranking) -> Iterator[str]:
    """How each new method does, a sentence each."""
    tasks, environments = ranking.tasks, ranking.tasks.scores.sizes["environment"]
    names = over_tasks.order(tasks)
    for name in ranking.new:
        others = [other for other in names if other not in ranking.new]
        beats = [part.sel({"method": name, "other": others}).values for part in tasks.improvement[:3]]
        rank = [float(part.sel({"method": name})) for part in tasks.mean_rank[:3]]
        own = [place for place in ranking.places if place.method == name]
        alone = sum(place.better == len(others) for place in own)
        more, less = int((beats[1] > 0.5).sum()), int((beats[2] < 0.5).sum())
        where = f"number {names.index(name) + 1} of {len(names)} by its mean rank over {environments} environments"
        yield (
            f"{title_of(name)} is {where}: {number(rank[0], 2)} ({number(rank[1], 2)} to {number(rank[2], 2)}). Of two "
            f"runs its own is more often the better one beside {more} of the other {len(others)}, and more often the "
            f"worse one beside {less}. It is better than all of them in {counted(alone, 'environments')}, and worse "
            f"than some in {counted(sum(place.worse > 0 for place in own), 'environments')}."
        )


def notes(ranking: Ranking) -> Iterator[str]:
    """What a reader of the tables must know, in sentences."""
    yield from over_tasks.notes(ranking.tasks, ranking.on_fresh)
    yield (
        f"All have the same {ranking.seeds} seeds. Better and worse: than how many of the others, by differences seed "
        "by seed, corrected for all of them in all environments together (Holm)."
    )


def beside(ranking: Ranking) -> str | None:
    """The method with which all others are compared in the table over all environments; None: with the first."""
    return ranking.new[0] if len(ranking.new) == 1 else None


def rows(ranking: Ranking, method: str) -> list[list[str]]:
    """How a new method does in each environment: the cells below `HEAD`."""
    own = [place for place in ranking.places if place.method == method]
    return [_cells(place) for place in own]


def _cells(place: Place) -> list[str]:
    best, score = place.first
    return [
        title_of(place.environment),
        number(place.score, DECIMALS),
        f"{number(place.low, DECIMALS)} to {number(place.high, DECIMALS)}",
        str(place.rank),
        str(place.better),
        str(place.worse),
        f"{title_of(best)}, {number(score, DECIMALS)}",
    ]


def chapter(ranking: Ranking) -> dict[str, Any]:
    """What the page of a comparison shows."""
    return {
        "head": over_tasks.head(ranking.tasks, beside(ranking)),
        "rows": over_tasks.rows(ranking.tasks, beside(ranking)),
        "new": [title_of(name) for name in ranking.new],
        "head_of_places": HEAD,
        "places": [(title_of(name), rows(ranking, name)) for name in ranking.new],
        "notes": [*notes(ranking)],
    }


def to_dict(ranking: Ranking) -> dict[str, Any]:
    """The numbers in types that JSON knows."""
    places = [{**place._asdict(), "first": list(place.first)} for place in ranking.places]
    about = {"new": ranking.new, "seeds": ranking.seeds, "on_fresh_seeds": ranking.on_fresh}
    return about | {"over_environments": over_tasks.to_dict(ranking.tasks), "places": places}
