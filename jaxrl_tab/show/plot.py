"""Pictures of sweeps and of grids.

A function that draws takes the `Axes` to draw on; `overview` and `save_all` make their own figures. Nothing
here touches pyplot, so it needs no display and leaves no figure open. Bands and bars are 95% intervals of the
mean, each point for itself (pointwise); for whole curves there is `stats.simultaneous_interval`. Colours are
Okabe and Ito's, which people with any colour vision can tell apart; methods also differ in their markers. No
figure is wider than `WIDTH`, a column of text, so that its type can be read where people see it.

Datasets are those of `SweepResult.to_xarray`, one for each method, by the name that the legend shows.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxrl_tab import stats
from jaxrl_tab.core.declared import Learns
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.types import Environment
from jaxrl_tab.envs.base import Grid
from jaxrl_tab.exact import planning
from jaxrl_tab.show.curves import (
    Labels,
    at_setting,
    common_optimum,
    common_soft_optimum,
    episodes_against_steps,
    learning_curves,
    mean_curve,
    sensitivity,
)
from jaxrl_tab.show.diagrams import backups, bridge
from jaxrl_tab.show.exact_curves import exact_curves
from jaxrl_tab.show.grids import (
    amounts,
    changes,
    greedy_path,
    median_path,
    values,
    walk,
)
from jaxrl_tab.show.iterated import iterates, zigzag
from jaxrl_tab.show.maps import score_map, swept_pair
from jaxrl_tab.show.moves import greedy_actions, tables_of_seeds
from jaxrl_tab.show.panels import (
    action_values,
    panels,
    panels_canvas,
    state_values,
    values_limits,
)
from jaxrl_tab.show.places import dimensions
from jaxrl_tab.show.rate_curves import schedules
from jaxrl_tab.show.style import (
    ALARM,
    CELL,
    COLORS,
    DASHES,
    DPI,
    GREY,
    INK,
    MARKERS,
    NARROW,
    SMALL,
    TITLE,
    TYPE,
    WIDTH,
    axes_title,
    canvas,
    color_bar,
    exact_line,
    head,
    lay_out,
    legend,
    literal,
    tidy,
)
from jaxrl_tab.show.surfaces import function, surfaces
from jaxrl_tab.show.tasks import tables_of, uniform_values
from jaxrl_tab.show.words import in_words, label_of, seeds_in_words, shortened, title_of, unusual, written
from jaxrl_tab.stats.along import Datasets
from jaxrl_tab.stats.columns import Methods

Kind: TypeAlias = Literal["png", "pdf", "svg"]
LEAST_OF_TWO = 4.8  # inches: the width of a figure in which two axes lie side by side

__all__ = [
    "ALARM",
    "CELL",
    "COLORS",
    "DASHES",
    "DPI",
    "GREY",
    "INK",
    "MARKERS",
    "NARROW",
    "SMALL",
    "TITLE",
    "TYPE",
    "WIDTH",
    "action_values",
    "amounts",
    "backups",
    "bridge",
    "canvas",
    "changes",
    "color_bar",
    "episodes_against_steps",
    "exact_curves",
    "exact_line",
    "greedy_path",
    "head",
    "in_words",
    "iterates",
    "learning_curves",
    "legend",
    "literal",
    "mean_curve",
    "overview",
    "panels",
    "panels_canvas",
    "pictures",
    "save",
    "save_all",
    "schedules",
    "score_map",
    "sensitivity",
    "solutions",
    "state_values",
    "tidy",
    "unusual",
    "value_tables",
    "values",
    "walk",
    "written",
    "zigzag",
]


def overview(
    datasets: Datasets, env: Environment | None = None, *, width: float = WIDTH, labels: Labels | None = None
) -> Figure:
    """The curves of `save_all` in one figure; on grids with the greedy path of the method with the best mean.

    Args:
        datasets: a sweep for each method, at least one.
        env: the environment of all of them; None where it is not known, as of what `rl.read` read.
        width: of the figure, inches.
        labels: what methods are called instead of their names; of some of them, or of all.

    Raises:
        InputError: a label is of no method, or two are the same.
    """
    methods = Methods.of(datasets, env).renamed(labels or {})
    curves = _curves(methods, env)
    if isinstance(env, Grid) and not stats.is_prediction(*methods.values()):
        winner = stats.ranked(methods.settings)[0]
        curves["greedy_path"] = lambda ax: median_path(ax, env, winner, methods.settings[winner])
    figure, grid = _squares(len(curves), width)
    for ax, draw in zip(grid, curves.values(), strict=False):
        draw(ax)
    _say_what_ran(figure, methods, env, intervals=True)
    return figure


def save_all(
    datasets: Datasets,
    env: Environment | None,
    folder: Path | str,
    kind: Kind | Sequence[Kind] = "png",
    *,
    width: float = WIDTH,
    labels: Labels | None = None,
) -> list[Path]:
    """Writes the pictures of a sweep into `folder`, which is made if need be.

    `episodes.png`, `learning_curves.png`, `sensitivity.png` and `sensitivity_NAME.png` (where hyperparameters
    were swept), `greedy_path.png` (on grids: every method, and the exact optimum), `values.png` (where people
    see the states in tables: the learned values and best actions, and the exact ones), `score_map.png` (of methods
    that swept two hyperparameters: heat maps over the first two, the step size along the axis), and `overview.png`.
    Of methods of prediction no `episodes.png` and no path, but always `values.png`. Where states cannot be counted
    `values.png` is a curve, or a map, of what was learned of states that are one number, or two.

    Args:
        datasets: a sweep for each method, at least one.
        env: the environment of all of them, or None.
        folder: where to write; files of these names are overwritten.
        kind: of the files, or several kinds. "pdf" and "svg" are sharp at any size, as for a paper.
        width: of the widest figure, inches: that of the text of a page, or of one of its columns, such as 3.3.
        labels, errors: as in `overview`.

    Returns:
        The files written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    methods = Methods.of(datasets, env).renamed(labels or {})
    figures = pictures(methods, env, width=width) | {"overview": overview(methods, env, width=width)}
    files = {
        folder / f"{name}.{one}": figure
        for name, figure in figures.items()
        for one in ([kind] if isinstance(kind, str) else kind)
    }
    for file, figure in files.items():
        save(figure, file)
    return list(files)


def save(figure: Figure, file: Path | str) -> None:
    """Writes a figure as the ending of `file` says: .png, .pdf or .svg. The same figure gives the same bytes."""
    file = Path(file)
    lay_out(figure)
    if file.suffix == ".png":
        # Drawn once: `savefig` does it twice. Compressed quicker than by the usual level, and a tenth larger.
        FigureCanvasAgg(figure).print_png(file, pil_kwargs={"compress_level": 1})
        return
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    # Journals take fonts of kind 42 (TrueType) alone.
    with mpl.rc_context({"svg.hashsalt": "jaxrl_tab", "pdf.fonttype": 42}):
        figure.savefig(file, metadata=undated.get(file.suffix))


def pictures(
    datasets: Datasets, env: Environment | None = None, *, width: float = WIDTH, labels: Labels | None = None
) -> dict[str, Figure]:
    """The figures of `save_all` by their names, but for the overview, in which they are again."""
    methods, figures = Methods.of(datasets, env).renamed(labels or {}), {}
    for name, draw in _curves(methods, env).items():
        figure = canvas(min(width, NARROW))
        draw(figure.subplots())
        _say_what_ran(figure, methods, env, intervals=True)
        figures[name] = figure
    if isinstance(env, Grid) and not stats.is_prediction(*methods.values()):
        figures["greedy_path"] = _all_paths(methods, env, width)
    elif env is not None and tables_of(env) and _with_values(methods):
        figures["values"] = value_tables(methods, env, width=width)
    elif env is not None and dimensions(env, methods) == 2:
        figures["values"] = figure = surfaces(methods, env, width=width)
        _say_what_ran(figure, methods, env)
    if maps := {name: pair for name, ds in methods.items() if (pair := swept_pair(ds))}:
        figures["score_map"] = figure = _all_maps(methods, maps, width)
        _say_what_ran(figure, methods, env)
    return figures


def _all_maps(methods: Methods, maps: Mapping[str, tuple[str, str]], width: float) -> Figure:
    """The map of each method that swept two hyperparameters, over this pair of them."""
    figure, grid = _squares(len(maps), width if len(maps) > 1 else min(width, NARROW))
    scores = np.concatenate([methods.settings[name].interval.estimate.values.ravel() for name in maps])
    scores = scores[np.isfinite(scores)]
    limits = (float(scores.min()), float(scores.max())) if scores.size else None
    for ax, (name, pair) in zip(grid, maps.items(), strict=True):
        own = methods.settings[name]
        held = {key: value for key, value in own.best.items() if key not in pair and own.ds.sizes[key] > 1}
        title = f"{label_of(name, stats.named(own.ds, held))}: mean of {seeds_in_words({name: own.ds})}"
        score_map(ax, own, *pair, title=title, limits=limits)
    return figure


def _curves(methods: Methods, env: Environment | None) -> dict[str, Callable[[Axes], None]]:
    """What draws each picture of one pair of axes, by its name."""
    curves: dict[str, Callable[[Axes], None]] = {}
    if not stats.is_prediction(*methods.values()) and all("lengths" in ds for ds in methods.values()):
        curves["episodes"] = lambda ax: episodes_against_steps(ax, methods)
    soft = common_soft_optimum(methods)
    if env is not None or any(ds.sizes["row"] > 1 for ds in methods.values()):
        curves["learning_curves"] = lambda ax: learning_curves(ax, methods, soft=soft)
    names = (name for ds in methods.values() for name in stats.hyperparameters(ds) + stats.drawn(ds))
    swept = dict.fromkeys(name for name in names if name != "draw")
    for i, name in enumerate(sorted(swept, key=lambda name: name != "alpha")):
        key = f"sensitivity_{name}" if i else "sensitivity"
        line = np.nan if name in ("epsilon", "gamma", "behaviour") else soft  # which is another at each point
        curves[key] = lambda ax, name=name, line=line: sensitivity(ax, methods, name, soft=line)
    if stats.is_prediction(*methods.values()) and env is not None and env.num_states and not tables_of(env):
        curves["values"] = lambda ax: state_values(ax, methods, env)
    if env is not None and dimensions(env, methods) == 1:
        curves["values"] = lambda ax: function(ax, methods, env)
    return curves


def value_tables(
    datasets: Datasets, env: Environment, *, width: float = WIDTH, labels: Labels | None = None
) -> Figure:
    """The panels of the environment: a row for what each method learned, and one for what is exact.

    What a method learned is the mean over seeds of its largest action value, and the action that is greedy
    most often; of prediction the mean of V. Methods that learn preferences are left out. All rows have one scale of
    colours: from the smallest to the largest of the exact values, or else of all that were learned. Arguments and
    errors are as in `overview`.
    """
    learned = {}
    for label, own in at_setting(_with_values(datasets), {}, labels):
        ds = own.ds
        often = sum(greedy_actions(q).sum(0) for q in tables_of_seeds(ds))
        best = often == np.max(often, -1, keepdims=True)
        value = sum(q.max(-1).sum(0, dtype=float) for q in tables_of_seeds(ds)) / ds.sizes["seed"]
        learned[f"{label}: mean of {seeds_in_words({label: ds})}"] = (
            value,
            None if stats.is_prediction(ds) else best,
        )
    tables = [v for v, _ in learned.values()]
    if (exact := _exact_table(datasets, env)) is not None:
        learned["Exact"] = exact
        tables = [exact[0]]
    figure, grid = panels_canvas(env, len(learned), width)
    _panels_in_rows(grid, env, learned, tables)
    _say_what_ran(figure, datasets, env)
    return figure


def _with_values(datasets: Datasets) -> Datasets:
    """Those of methods that learned values."""
    return {name: ds for name, ds in datasets.items() if ds.attrs.get("learns") != Learns.PREFERENCES}


def solutions(
    env: Environment, solved: Mapping[str, tuple[np.ndarray, np.ndarray]], *, width: float = WIDTH
) -> Figure:
    """Exact values and best actions, one solution below the other, in one scale of colours.

    On grids with arrows, or in the tables in which people see the states; else a mark for each action.

    Args:
        env: the environment.
        solved: (v [S], q [S, A]) by what stands over them, such as `planning.value_iteration` gives; at least one.
        width: of the figure, inches; of a picture that needs less, at most.
    """
    if tables_of(env) and not isinstance(env, Grid):
        figure, grid = panels_canvas(env, len(solved), width)
        named = {title: (v, greedy_actions(q)) for title, (v, q) in solved.items()}
        _panels_in_rows(grid, env, named, [v for v, _ in solved.values()])
        return figure
    figure = canvas(width if isinstance(env, Grid) else min(width, NARROW))
    limits = values_limits(env, [v for v, _ in solved.values()])
    for ax, (title, (v, q)) in zip(np.ravel(figure.subplots(len(solved))), solved.items(), strict=True):
        if isinstance(env, Grid):
            values(ax, env, v, q, limits)
        else:
            action_values(ax, env, np.where(q == UNAVAILABLE, np.nan, q))
        axes_title(ax, title)
    return figure


def _panels_in_rows(
    grid: np.ndarray,
    env: Environment,
    rows: Mapping[str, tuple[np.ndarray, np.ndarray | None]],
    tables: Sequence[np.ndarray],
) -> None:
    """(v, best) by what stands over them, one below the other; one scale of colours, that of some `tables`, for all."""
    limits, last = values_limits(env, tables), len(rows) - 1
    for i, (row, (title, (v, best))) in enumerate(zip(grid, rows.items(), strict=True)):
        panels(row, env, v, best, title, limits, scale=i == last)


def _exact_table(datasets: Datasets, env: Environment) -> tuple[np.ndarray, np.ndarray | None] | None:
    """v* and the optimal actions, or of prediction v_pi and None; None where there is no one such answer."""
    if stats.is_prediction(*datasets.values()):
        v = uniform_values(datasets, env)
        return None if v is None else (v, None)
    if not np.isfinite(common_optimum(datasets)):
        return None
    v, q = planning.value_iteration(env, stats.fixed(next(iter(datasets.values()))).get("gamma", 1.0))
    return v, greedy_actions(q)


def _all_paths(methods: Methods, env: Grid, width: float) -> Figure:
    """The greedy path of every method, and an optimal one where there is a finite optimum."""
    optimum = common_optimum(methods)
    count = len(methods) + bool(np.isfinite(optimum))
    figure, grid = _squares(count, width if count > 1 else width / 2)
    for ax, (name, own) in zip(grid, methods.settings.items(), strict=False):
        median_path(ax, env, name, own)
    if np.isfinite(optimum):
        gamma = stats.fixed(next(iter(methods.values()))).get("gamma", 1.0)
        _, q = planning.value_iteration(env, gamma)
        greedy_path(grid[len(methods)], env, q, "An optimal policy", optimum)
    return figure


def _squares(count: int, width: float) -> tuple[Figure, np.ndarray]:
    """A figure with so many axes, two in a row where it is wide enough for them."""
    columns = 2 if count > 1 and width >= LEAST_OF_TWO else 1
    figure = canvas(width)
    grid = figure.subplots(-(-count // columns), columns, squeeze=False).ravel()
    for ax in grid[count:]:
        ax.remove()
    return figure, grid[:count]


def _say_what_ran(
    figure: Figure, datasets: Datasets, env: Environment | None, *, intervals: bool = False
) -> None:
    """The title of a whole figure: what was run, and whether means with `intervals` are shown of it.

    What was run: the environment, what is not as usual in it, the hyperparameters of all, the seeds.
    """
    names = dict.fromkeys(shortened(title_of(str(ds.attrs["environment"]))) for ds in datasets.values())
    first, *others = [stats.fixed(ds) for ds in datasets.values()]
    common = {k: v for k, v in first.items() if all(k in other and other[k] == v for other in others)}
    what = ", ".join([*names, *([] if env is None else unusual(env)), *in_words(common)])
    over = f"mean over {seeds_in_words(datasets)}, and its 95% interval at each point" if intervals else ""
    head(figure, f"{what}\n{over}")


def __dir__() -> list[str]:
    return __all__
