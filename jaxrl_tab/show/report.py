"""The report of an experiment: one HTML file that holds all there is to see, and needs nothing else.

For each environment the setting chosen for each method, what one can look around in, and all settings, the best
first; then how to read it, and how it was made. Pictures are drawn in the browser, from data in the page (`explorer`).
"""

import dataclasses
import html
import re
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core import describe
from jaxrl_tab.core.errors import InputError, one_line
from jaxrl_tab.core.types import Environment
from jaxrl_tab.core.version import __version__
from jaxrl_tab.show import over_tasks, search_page, words
from jaxrl_tab.show.explained import Explained
from jaxrl_tab.show.explorer.chapter import Explorer, explorer
from jaxrl_tab.show.explorer.measures import POINTS
from jaxrl_tab.show.explorer.over_time import Again
from jaxrl_tab.show.heat import Heat, heats
from jaxrl_tab.show.html import EXPLORER, as_json, render
from jaxrl_tab.show.rows import (
    AT_ONCE,
    Table,
    View,
    chosen_table,
    columns_of,
    decimals,
    early_in_words,
    early_table,
    finding,
    mean_in_words,
    notes,
    rank,
    runs_in_words,
    setting_of,
    settings_table,
    varied,
)
from jaxrl_tab.show.words import counts_in_words, listed, number
from jaxrl_tab.stats.along import Datasets
from jaxrl_tab.stats.column import text
from jaxrl_tab.stats.columns import Methods, by_environment

__all__ = ["write"]

FILE = "report.html"

# As measured, see `stats.score_interval`; of 10, 30 and 100 seeds.
COVERAGE = (
    "and 10, 30 and 100 seeds, 94 to 96 of 100 such intervals were right; where 1 or 2 runs in 100 get stuck, at "
    "least 82, 94 and 96 were."
)


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
    return write_methods(Path(folder), by_environment(datasets, envs), about, by_environment(fresh, envs))


def write_methods(
    folder: Path,
    methods: Mapping[str, Methods],
    about: Mapping[str, Any],
    fresh: Mapping[str, Methods],
    again: Again | None = None,
    toml: Mapping[str, str] | None = None,
    explained: Mapping[str, Explained] | None = None,
    verdicts: Mapping[str, stats.Verdict] | None = None,
    tried: Sequence[Any] = (),
) -> Path:
    """`write`, of the methods of each environment, of which something may have been worked out already.

    Args:
        again, toml: see `explorer`; without `again` there are tables at the end of the runs alone.
        explained: where the methods lose, by "ENV/METHOD"; of those that are in it.
        verdicts: what was decided in each environment, where methods were compared until all was.
        tried: what a search tried, where one found the settings.
        Others: as in `write`.
    """
    return page(methods, about, fresh, again, toml, explained, verdicts, tried).save(folder / FILE)


@dataclasses.dataclass(frozen=True)
class Page:
    """A report that is not in a folder: a notebook shows it.

    Attributes:
        title: what it is about.
        html: the page.
    """

    title: str
    html: str

    def __repr__(self) -> str:
        return f"<Page {one_line(self.title)!r}: save('report.html') writes it>"

    def _repr_html_(self) -> str:
        title, page = html.escape(self.title), html.escape(self.html)
        return (
            f'<iframe title="{title}" srcdoc="{page}" style="width: 100%; height: 60rem; border: 0"></iframe>'
        )

    @classmethod
    def read(cls, file: Path) -> "Page":
        """A page that was saved."""
        text = file.read_text(encoding="utf-8")
        title = re.search("<title>(.*?)</title>", text, re.DOTALL)
        return cls(html.unescape(title[1]) if title else file.name, text)

    def save(self, file: Path | str) -> Path:
        """Writes the page into a file, over one that is there."""
        file = Path(file)
        file.write_text(self.html, encoding="utf-8")
        return file


def page(
    methods: Mapping[str, Methods],
    about: Mapping[str, Any],
    fresh: Mapping[str, Methods],
    again: Again | None = None,
    toml: Mapping[str, str] | None = None,
    explained: Mapping[str, Explained] | None = None,
    verdicts: Mapping[str, stats.Verdict] | None = None,
    tried: Sequence[Any] = (),
) -> Page:
    """The report; arguments as in `write_methods`."""
    several = len(methods) > 1
    chapters = []
    for label, own in methods.items():
        group = f"{label}/" if several else ""
        seen = explorer(label, own, group=group, again=again, toml=toml, chapters=len(methods))
        losing = heats(explained or {}, label)
        chapter = _chapter(label, own, fresh.get(label, Methods({})), seen, losing)
        if tried and not chapters:  # a search is of one environment, and others may have been added
            chapter = chapter._replace(search=_searched(tried, own))
        chapters.append(chapter if verdicts is None else _decided(chapter, verdicts.get(label), own))
    sweeps = {f"{label}/{name}": ds for label, own in methods.items() for name, ds in own.items()}
    seeds = [ds.sizes["seed"] for ds in sweeps.values()]
    title = _title(chapters)
    rendered = render(
        "report.html",
        styles=["report.css", "heat.css", *(["search.css"] if tried else [])],
        scripts=EXPLORER,
        points=f"at most {POINTS}",
        title=title,
        chapters=chapters,
        over_tasks=_over_tasks(methods, fresh) if several else None,
        explained=dict(item for chapter in chapters for item in chapter.explained.items()),
        about=about,
        speed=[_speed(name, ds) for name, ds in sweeps.items()],
        seeds=counts_in_words(seeds),
        fresh=bool(fresh),
        coverage=COVERAGE,
        unseen=stats.unseen(min(seeds)),
        at_once=AT_ONCE,
        version=__version__,
    )
    return Page(title, rendered)


def _over_tasks(methods: Mapping[str, Methods], fresh: Mapping[str, Methods]) -> dict[str, Any] | None:
    """What is told of the methods over all environments; None where there are not two in which they are compared."""
    on_fresh = all(fresh.get(label, {}).keys() == own.keys() for label, own in methods.items())
    try:
        tasks = stats.across_tasks(fresh if on_fresh else methods)
    except InputError:
        return None
    return {
        "head": over_tasks.head(tasks),
        "rows": over_tasks.rows(tasks),
        "notes": [*over_tasks.notes(tasks, on_fresh)],
        "count": tasks.scores.sizes["environment"],
    }


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
    early: Table
    better_early: str
    settings: Table
    num_settings: int
    diverged: list[str]
    num_diverged: int
    triads: list[str]
    doubtful: bool
    tied: bool
    explores: bool
    explained: dict[str, str]
    losing: list[Heat]
    data: Any
    blocks: dict[str, str]
    verdict: str = ""
    verdict_notes: Sequence[str] = ()
    search: search_page.Search | None = None


# --- a chapter ---------------------------------------------------------------------------------------
def _chapter(label: str, methods: Methods, fresh: Methods, seen: Explorer, losing: list[Heat]) -> Chapter:
    env, prediction, rows = methods.env, methods.prediction, methods.rows
    assert env is not None
    again = {row.method: row for row in fresh.rows}
    numbers = {name: count() for name in methods}
    keys = {id(row): f"{[*methods].index(row.method)}-{next(numbers[row.method])}" for row in rows}
    ranked = sorted(rows, key=lambda row: rank(row, prediction))
    stars = [row for row in ranked if row["best"]]
    on_fresh = len(again) == len(stars)
    if on_fresh:
        stars.sort(key=lambda row: rank(again[row.method], prediction))
    view = View(prediction, varied(rows), decimals([*stars, *again.values()]))
    differences = (fresh if on_fresh else methods).differences
    judged = again if on_fresh else {row.method: row for row in stars}
    last = [*stars, *again.values()]
    columns = dict.fromkeys(
        [*columns_of("chosen", last), *columns_of("early", last), *columns_of("all", rows)]
    )
    return Chapter(
        label=words.title_of(label),
        about=describe.summary(type(env)),
        unusual=", ".join(words.unusual(env)),
        methods=list(methods),
        runs=runs_in_words(next(iter(methods.values()))),
        common=", ".join(
            words.in_words({k: x for row in rows for k, x in row.setting.items() if k not in view.varied})
        ),
        finding=finding(stars, again, view),
        prediction=prediction,
        compared=bool(differences),
        on_fresh=on_fresh,
        notes=notes(stars, again, view),
        chosen=chosen_table(stars, again, judged if differences else {}, view),
        early=early_table(stars, again, view),
        better_early=early_in_words(methods, lambda x: number(x, view.decimals)) if methods.early else "",
        settings=settings_table(ranked, [keys[id(row)] for row in ranked], view),
        num_settings=len(rows),
        diverged=[
            f"{setting_of(row, view)}: {row['diverged']} of {row['seeds']}" for row in rows if row["diverged"]
        ],
        num_diverged=sum(row["diverged"] for row in rows),
        triads=list(words.deadly_triads(methods)),
        doubtful=any(row.doubtful for row in [*rows, *again.values()]),
        tied=any(row["tied"] and not row["best"] for row in rows),
        explores=not np.isnan([row["soft"] for row in rows]).all(),
        explained={_sentence(text(x.report, prediction)): x.help for x in columns if x.help},
        losing=losing,
        data=as_json(seen.data),
        blocks=seen.blocks,
    )


def _decided(chapter: Chapter, verdict: stats.Verdict | None, methods: Methods) -> Chapter:
    """The chapter with what was decided between its methods."""
    if verdict is None:
        return chapter
    verdict = verdict.renamed(words.title_of)
    digits = decimals(methods.rows)
    return chapter._replace(
        finding=f"{verdict.sentence}; {chapter.finding}",
        verdict=verdict.sentence,
        verdict_notes=verdict.notes(lambda x: number(x, digits)),
    )


def _searched(tried: Sequence[Any], methods: Methods) -> search_page.Search:
    """What a search tried that found the settings of a chapter, whose seeds are the fresh ones."""
    ds, rows = next(iter(methods.values())), methods.rows
    view = View(methods.prediction, [], decimals(rows))
    worth = {row.method: mean_in_words(row, view) for row in rows if row["best"]}
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    return search_page.section(tried, unit, worth, ds.sizes["seed"], view.what)


# --- words -------------------------------------------------------------------------------------------
def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _title(chapters: Sequence[Chapter]) -> str:
    methods = dict.fromkeys(words.title_of(method) for chapter in chapters for method in chapter.methods)
    labels = [chapter.label for chapter in chapters]
    return f"{listed(list(methods), 'methods')} in {listed(labels, 'environments')}"


def _speed(name: str, ds: xr.Dataset) -> list[str]:
    """How long a sweep took: name, steps, seconds, seconds of compiling, and million steps per second."""
    steps = int(ds.steps.sum(dtype=np.int64))
    timings = [float(ds.attrs.get(key, np.nan)) for key in ("seconds", "compile_seconds", "steps_per_second")]
    timings[2] /= 1e6
    return [name, f"{steps:,}".replace(",", " "), *(number(x, 1) for x in timings)]


def __dir__() -> list[str]:
    return __all__
