"""A page of results that other tools computed: the same tables as in a report, and pictures.

What a report tells of an environment, of its states and of what is exact, is not known here.
"""

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg

from jaxrl_tab import stats
from jaxrl_tab.core.version import __version__
from jaxrl_tab.show import plot, words
from jaxrl_tab.show.html import as_data, render
from jaxrl_tab.show.report import COVERAGE, Page
from jaxrl_tab.show.rows import (
    View,
    chosen_table,
    decimals,
    finding,
    notes,
    rank,
    runs_in_words,
    settings_table,
    varied,
)
from jaxrl_tab.stats.columns import Methods


def page(environments: Mapping[str, Methods], told: Sequence[str]) -> Page:
    """A page of the methods of each environment.

    Args:
        environments: as `Readings.methods` has them.
        told: what a reader must know of all of it, a sentence each.
    """
    chapters = [_chapter(label, methods) for label, methods in environments.items()]
    names = dict.fromkeys(words.title_of(name) for methods in environments.values() for name in methods)
    title = f"{words.listed(list(names), 'methods')} in {words.listed([c['label'] for c in chapters], 'environments')}"
    seeds = [ds.sizes["seed"] for methods in environments.values() for ds in methods.values()]
    rendered = render(
        "others.html",
        styles=["report.css"],
        title=title,
        told=told,
        chapters=chapters,
        coverage=COVERAGE,
        unseen=stats.unseen(min(seeds)),
        version=__version__,
    )
    return Page(title, rendered)


def _chapter(label: str, methods: Methods) -> dict[str, Any]:
    rows = methods.rows
    view = View(methods.prediction, varied(rows), decimals(rows))
    ranked = sorted(rows, key=lambda row: rank(row, methods.prediction))
    stars = [row for row in ranked if row["best"]]
    judged = {row.method: row for row in stars} if methods.differences else {}
    several = len(rows) > len(stars)
    return {
        "label": words.title_of(label),
        "runs": _runs(methods),
        "finding": finding(stars, {}, view),
        "chosen": chosen_table(stars, {}, judged, view),
        "notes": notes(stars, {}, view),
        "settings": settings_table(ranked, [], view) if several else None,
        "picture": _picture(methods),
    }


def _runs(methods: Methods) -> str:
    ds = next(iter(methods.values()))
    if "num_steps" in ds.attrs:
        return runs_in_words(ds)
    return f"One score of each of {words.counted(ds.sizes['seed'], 'runs')} (seeds)"


def _picture(methods: Methods) -> str | None:
    """What `plot.overview` draws, as the address of a picture; None where there is one point, and no curve."""
    if all(ds.sizes["row"] == 1 for ds in methods.values()) and not any(
        map(stats.hyperparameters, methods.values())
    ):
        return None
    figure, file = plot.overview(methods), BytesIO()
    plot.lay_out(figure)
    FigureCanvasAgg(figure).print_png(file)
    return as_data(file.getvalue(), "image/png")
