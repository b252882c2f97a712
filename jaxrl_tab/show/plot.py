"""Pictures of sweeps and of grids.

A function that draws takes the `Axes` to draw on; `overview` and `save_all` make their own figures. Nothing
here touches pyplot, so it needs no display and leaves no figure open. Bands and bars are 95% intervals of the
mean, each point for itself (pointwise); for whole curves there is `stats.simultaneous_interval`. Colours are
Okabe and Ito's, which people with any colour vision can tell apart; methods also differ in their markers. No
figure is wider than `WIDTH`, a column of text, so that its type can be read where people see it.

Datasets are those of `SweepResult.to_xarray`, one for each method, by the name that the legend shows.
"""

import dataclasses
import itertools
import textwrap
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from jaxrl_tab import stats
from jaxrl_tab.core import describe, memory, policies
from jaxrl_tab.core.checks import InputError
from jaxrl_tab.core.types import Environment, available_actions
from jaxrl_tab.envs.base import COMPASS, Finite, Grid
from jaxrl_tab.exact import planning

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<")  # one more than colours: the pairs repeat after 56
DASHES = ("-", "--", ":", "-.")
INK, GREY, ALARM = "#222222", "#6e6e6e", "#D55E00"
TITLE, TYPE, SMALL, CELL = 10, 9, 8, 7  # font sizes, points; the last is of the hundreds of cells of a table
WIDTH, NARROW = 7.2, 6.0  # inches: of a figure, and of one with a single curve
DPI = 200
LINE, HALF, LABEL = 84, 42, 36  # characters in a line: over a figure, over half of one, in a legend
LONGEST = 60  # characters of a name
MOST_POINTS, LEAST_POINTS = 40, 5  # of a learning curve; halved from the most until it has no late gaps
FEW_TICKS, MOST_TICKS = 8, 25  # values, and states, beyond which not each has its tick on an axis
MOST_MARKS = 24  # kinds of marks in a picture; beyond them nobody can tell which is which
MOST_SEEDS = 0.9  # a learning curve is drawn where so many of the seeds finished an episode

Datasets = Mapping[str, xr.Dataset]


# --- curves ------------------------------------------------------------------------------------------


def episodes_against_steps(ax: Axes, datasets: Datasets, **given: Any) -> None:
    """Episodes finished against time steps, mean and 95% interval over seeds (book, example 6.5).

    The slope is the pace: one episode in so many steps. Where episodes were the budget, the mean and its
    interval are of the time steps that they took, so the band is horizontal.

    Args:
        ax: where to draw.
        datasets: a sweep for each method.
        given: hyperparameters to hold, such as `alpha=0.5`; otherwise each method's best (`stats.best`).

    Raises:
        InputError: no method swept the hyperparameter, or one that did not at this value.
    """
    for (label, ds), style in zip(_chosen(datasets, given), _styles(), strict=False):
        by_steps = "num_steps" in ds.attrs
        spread, exact = ("episodes", "time_steps") if by_steps else ("time_steps", "episodes")
        mean, low, high = (_from_origin(x.clip(min=0)) for x in stats.progress_interval(ds, spread)[:3])
        other = _from_origin(stats.episode_curve(ds.isel(seed=0))[exact])
        points = (other, mean) if by_steps else (mean, other)
        ax.plot(*points, lw=1.8, ms=4.5, markevery=max(1, len(mean) // 8), label=literal(label), **style)
        band = ax.fill_between if by_steps else ax.fill_betweenx
        band(other, low, high, color=style["color"], alpha=0.2, lw=0)
    tidy(ax, "time steps", "episodes finished")
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=0)
    legend(ax, loc="upper left")


def learning_curves(ax: Axes, datasets: Datasets, *, soft: float = np.nan, **given: Any) -> None:
    """Mean return per episode against time steps (or episodes), with 95% interval and the exact optimum.

    Rows of the log are merged to at most `MOST_POINTS`, or fewer where seeds finish few episodes. A point is
    drawn at the end of its rows, and only where `MOST_SEEDS` of the seeds finished an episode in them: at
    first only the quick episodes are over, and their mean would flatter. Of methods of prediction the RMS
    error of V is drawn, at the end of every row. Arguments and errors as in `episodes_against_steps`.
    """
    by_steps = all("num_steps" in ds.attrs for ds in datasets.values())
    if stats.is_prediction(*datasets.values()):
        for (label, ds), style in zip(_chosen(datasets, given), _styles(), strict=False):
            x = (ds.steps if by_steps else ds.episodes).mean("seed").cumsum("row")
            line = {**style, "ms": 5, "markevery": max(1, len(x) // 8)}
            mean_curve(ax, x, ds.v_error, label, **line)
        tidy(ax, "time steps" if by_steps else "episodes", "RMS error of V over states")
        ax.set_xlim(left=0)
        ax.set_ylim(bottom=0)
        legend(ax)
        return
    shown, end = [], 0
    for (label, ds), style in zip(_chosen(datasets, given), _styles(), strict=False):
        points, interval, enough = _readable_curve(ds)
        curve = stats.episode_curve(stats.merge_rows(ds.isel(seed=0), points))
        x = curve["time_steps" if "num_steps" in ds.attrs else "episodes"].values
        mean, low, high = (np.where(enough, part, np.nan) for part in interval[:3])
        ax.plot(x, mean, lw=1.7, ms=3.5, label=literal(label), **style)
        ax.fill_between(x, low, high, color=style["color"], alpha=0.2, lw=0)
        shown += [mean, low, high]
        end = max(end, x[-1])
    if not np.isfinite(np.concatenate(shown)).any():
        ax.text(0.5, 0.3, "too few episodes for a curve", transform=ax.transAxes, ha="center", color=GREY)
    ax.set_xlim(0, 1.03 * end)
    tidy(ax, "time steps" if by_steps else "episodes", "mean return per episode")
    _return_axis(ax, shown, _common_optimum(datasets), soft)
    legend(ax)


def sensitivity(ax: Axes, datasets: Datasets, parameter: str = "alpha", *, soft: float = np.nan) -> None:
    """Mean return of the last tenth against a hyperparameter, with 95% intervals and the exact optimum.

    Of methods of prediction it is the mean RMS error of V over all rows. Other swept hyperparameters stay at
    the method's best combination. The intervals are those of `stats.score_interval`. A point is hollow where
    some runs finished no episode in the last tenth, and so count with what they collected there. A method
    that did not sweep the parameter is drawn at the one value that it had. Schedules and policies, and
    numbers beside them, stand side by side in the order in which they come. Where the parameter was drawn at
    random there is a point for each draw, in which what was drawn with it is another, too.

    Args:
        soft: as in `learning_curves`.

    Raises:
        InputError: no method swept the parameter.
    """
    if not any(parameter in stats.hyperparameters(ds) + stats.drawn(ds) for ds in datasets.values()):
        raise InputError(f"no method swept {parameter!r}")
    prediction = stats.is_prediction(*datasets.values())
    series, drawn = {}, set()
    for name, ds in datasets.items():
        chosen = stats.best(ds)
        if parameter in stats.drawn(ds):
            drawn.add(name)
            del chosen["draw"]
        chosen.pop(parameter, None)
        label = _label(name, stats.named(ds, chosen))
        late = xr.zeros_like(ds.episodes.isel(seed=0, row=0), bool)
        if not prediction:
            late = stats.unfinished(ds).any("seed")
        parts = [part.sel(chosen) for part in (*stats.score_interval(ds), late)]
        ds = ds.sel(chosen)
        if name not in drawn and parameter not in ds.dims:
            if parameter not in stats.fixed(ds):
                continue
            ds = ds.expand_dims({parameter: [stats.fixed(ds)[parameter]]})
            parts = [part.expand_dims(parameter) for part in parts]
        series[name] = label, ds[parameter].values, parts
    place = _places(ax, [x for _, x, _ in series.values()])
    shown, incomplete = [], False
    for name, style in zip(datasets, _styles(), strict=False):
        if name not in series:
            continue
        label, x, parts = series[name]
        x, (*interval, _, late) = place(x), (part.values for part in parts)
        mean, low, high = (
            np.where(np.isfinite(part), part, np.nan) for part in interval
        )  # it may have diverged
        between = x.dtype.kind == "f" and name not in drawn  # nothing lies between two schedules, or draws
        style["ls"] = "-" if between else "none"
        ax.errorbar(
            x, mean, np.nan_to_num([mean - low, high - mean]), ls="none", capsize=3, color=style["color"]
        )
        ax.plot(x, mean, lw=1.8, ms=5.5, label=literal(label), **style)
        late &= np.isfinite(mean)
        ax.plot(x[late], mean[late], ls="none", ms=3, marker=style["marker"], color="white", zorder=5)
        shown += [mean, low, high]
        incomplete |= bool(late.any())
    if incomplete:
        hollow = {"marker": "o", "mfc": "white", "mec": INK, "mew": 1.5}
        ax.plot([], [], ls="none", **hollow, label="hollow: some runs unfinished")
    what = "step size α" if parameter == "alpha" else describe.symbol(parameter)
    if prediction:
        tidy(ax, what, "RMS error of V, mean over the run")
        _error_axis(ax, shown[::3])
    else:
        tidy(ax, what, "mean return, last tenth")
        _return_axis(ax, shown, _common_optimum(datasets), soft)
    legend(ax)


def _places(ax: Axes, tried: list[np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """A function from values of a hyperparameter to where they lie, and the x axis that fits all `tried`.

    Numbers are their own places, float. Where any is text all are ticks side by side, int.
    """
    if all(x.dtype.kind in "fiu" for x in tried):
        x = np.unique(np.concatenate(tried).astype(float))
        if x.min() > 0 and x.max() > 10 * x.min():
            ax.set_xscale("log")
        if len(x) <= FEW_TICKS:
            ax.set_xticks(x, [f"{v:g}" for v in x])
            ax.xaxis.set_minor_locator(NullLocator())
        elif ax.get_xscale() == "log":
            ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            ax.xaxis.set_minor_locator(NullLocator())
        return lambda x: x.astype(float)
    names = list(dict.fromkeys(_text(v) for x in tried for v in x.tolist()))
    tilt = {"rotation": 20, "ha": "right"} if sum(map(len, names)) > 30 else {}
    ax.set_xticks(range(len(names)), [literal(_short(name)) for name in names], **tilt)
    ax.set_xlim(-0.5, len(names) - 0.5)
    return lambda x: np.array([names.index(_text(v)) for v in x.tolist()])


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _error_axis(ax: Axes, means: list[np.ndarray]) -> None:
    """The y axis of errors, from 0. What diverged would hide the rest, and leaves the picture."""
    values = np.concatenate(means)
    values = values[np.isfinite(values)]
    if values.size:
        ax.set_ylim(0, min(1.15 * values.max(), 5 * values.min()))


def mean_curve(ax: Axes, x: Any, values: xr.DataArray, label: str, color: str, **line: Any) -> None:
    """The mean of `values`, [..., seed, ...] with one other dimension, over seeds, and its pointwise 95% interval.

    Args:
        ax: where to draw.
        x: where each lies, as long as the other dimension.
        values: one number for each seed and place.
        label: as the legend shows it.
        color: of the line and of the band.
        line: how the line is drawn, as in `Axes.plot`.
    """
    interval = stats.mean_interval(values)
    ax.plot(x, interval.estimate, label=literal(label), color=color, lw=line.pop("lw", 1.8), **line)
    ax.fill_between(x, interval.low, interval.high, color=color, alpha=0.25, lw=0)


def tidy(ax: Axes, xlabel: str, ylabel: str) -> None:
    """Names the axes, and leaves no more lines than are needed."""
    ax.set_xlabel(literal(xlabel), fontsize=TYPE)
    ax.set_ylabel(literal(ylabel), fontsize=TYPE)
    ax.tick_params(labelsize=SMALL)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(alpha=0.25, lw=0.6)
    ax.set_axisbelow(True)


def legend(ax: Axes, **given: Any) -> None:
    """The legend of what was drawn under a label. Of a curve that cannot be seen it says why.

    One curve alone has its label above the axes, where it hides nothing.

    Args:
        ax: where curves were drawn, with the limits that it is to have.
        given: as in `Axes.legend`.
    """
    handles, labels = ax.get_legend_handles_labels()
    low, high = sorted(ax.get_ylim())
    for i, handle in enumerate(handles):
        y = np.asarray(handle.get_ydata(), float) if isinstance(handle, Line2D) else np.empty(0)
        seen = y[np.isfinite(y)]
        if y.size and not seen.size:
            labels[i] += " (no value)"
        elif y.size and not (seen.min() <= high and seen.max() >= low):
            labels[i] += " (off the scale)"
    labels = [textwrap.fill(label, LABEL, break_on_hyphens=False) for label in labels]
    style = {"fontsize": SMALL, "framealpha": 0.8, "edgecolor": "none", "borderpad": 0.2, "handlelength": 1.8}
    if len(labels) == 1:
        given = {"loc": "lower left", "bbox_to_anchor": (0, 1), "borderaxespad": 0}
    ax.legend(handles, labels, **style | given)


def literal(text: str) -> str:
    """`text` such that Matplotlib shows each of its characters.

    It would take what stands between two dollars for a formula, and leave out of legends what begins with an
    underscore.
    """
    shown = text.replace("$", r"\$")
    return f"\u200b{shown}" if shown.startswith("_") else shown  # a space of no width


def _title(ax: Axes, text: str) -> None:
    """A title over axes of half the width, in as many lines as it needs."""
    lines = (textwrap.wrap(line, HALF, break_on_hyphens=False) for line in text.splitlines())
    ax.set_title(literal("\n".join(itertools.chain(*lines))), fontsize=TYPE)


def color_bar(image: Any, axes: Sequence[Axes], what: str = "value", **given: Any) -> None:
    """A scale that says what the colours of `image` stand for; `axes` make room for it."""
    bar = image.figure.colorbar(image, ax=list(axes), **given)
    bar.set_label(what, fontsize=TYPE)
    bar.ax.tick_params(labelsize=SMALL)


def _short(name: str) -> str:
    """A name of at most `LONGEST` characters, with what may tell it from others: its beginning and its end."""
    half = LONGEST // 2
    return name if len(name) <= LONGEST else f"{name[: half - 1]}…{name[-half:]}"


def _readable_curve(ds: xr.Dataset, points: int = MOST_POINTS) -> tuple[int, stats.Interval, np.ndarray]:
    """At most how many points, the interval of their mean returns, and where enough seeds are, bool [points].

    They are fewer than `points` if that closes gaps in the second half.
    """
    interval = stats.curve_interval(ds, points)
    enough = (interval.n >= MOST_SEEDS * ds.sizes["seed"]).values
    if enough[len(enough) // 2 :].all() or points <= LEAST_POINTS:
        return points, interval, enough
    return _readable_curve(ds, points // 2)


def _chosen(datasets: Datasets, given: Mapping[str, Any]) -> Iterable[tuple[str, xr.Dataset]]:
    """(label, dataset at one combination of hyperparameters) for each method."""
    for name in given:
        if not any(name in stats.hyperparameters(ds) for ds in datasets.values()):
            raise InputError(f"no method swept {name!r}")
    for method, ds in datasets.items():
        own = {name: value for name, value in given.items() if name in stats.hyperparameters(ds)}
        setting = stats.best(ds, **own)
        yield _label(method, stats.named(ds, setting)), ds.sel(setting)


def _label(method: str, setting: Mapping[str, Any]) -> str:
    return ", ".join([_short(describe.title(method)), *in_words(setting)])


def in_words(setting: Mapping[str, Any]) -> list[str]:
    """Each of the hyperparameters with its value as people write it: "α = 0.5"."""
    return [f"{describe.symbol(name)} = {written(value)}" for name, value in setting.items()]


def written(x: Any) -> str:
    """The value of a hyperparameter as people write it."""
    if isinstance(x, bool):
        return "on" if x else "off"
    if isinstance(x, int | float):
        return _number(x, 6 if abs(x) >= 1 else 4)  # what is drawn at random has many digits
    return str(x)


def _styles() -> Iterable[dict[str, Any]]:
    """Colours with markers, and with another dash when all colours have been: no two of the first 56 are alike."""
    for i in itertools.count():
        dash = DASHES[i // len(COLORS) % len(DASHES)]
        yield {"color": COLORS[i % len(COLORS)], "marker": MARKERS[i % len(MARKERS)], "ls": dash}


def _from_origin(x: xr.DataArray) -> np.ndarray:
    return np.concatenate([[0], x.values])


def _common_optimum(datasets: Datasets) -> float:
    """v* from the start if it is one finite number for all, else NaN."""
    values = np.concatenate([stats.optimum(ds).values.ravel() for ds in datasets.values()])
    return float(values[0]) if np.ptp(values) < 1e-6 * max(1, abs(values[0])) else np.nan


def _common_soft_optimum(datasets: Datasets, env: Environment) -> float:
    """What the best policy is worth that explores as the best settings do, if that is one number, else NaN."""
    if stats.is_prediction(*datasets.values()):
        return np.nan
    settings = [stats.fixed(ds) | stats.named(ds, stats.best(ds)) for ds in datasets.values()]
    explored = [{key: setting.get(key) for key in ("epsilon", "gamma", "behaviour")} for setting in settings]
    return stats.soft_optimum(env, explored[0]) if all(x == explored[0] for x in explored) else np.nan


def _return_axis(ax: Axes, shown: list[np.ndarray], optimum: float, soft: float) -> None:
    """The y axis of returns, with the optimum as a dashed line, and the best value of exploring as a dotted one.

    Early returns can be a hundred times the last ones, and the distance from these to the optimum is what
    matters. Where all are negative and differ by more than a factor of five, the axis is one of ratios.
    """
    values = np.concatenate([*shown, [optimum, soft]])
    values = values[np.isfinite(values)]
    lines = (("exact optimum", optimum, (0, (5, 3)), 2, "bottom"), ("best ε-soft", soft, ":", -2, "top"))
    for name, y, style, offset, side in lines:
        if np.isfinite(y):
            ax.axhline(y, color=INK, ls=style, lw=1.3, zorder=1)
            text = f"{name} {_number(y, 4)}"
            at = {"xytext": (0, offset), "xycoords": ax.get_yaxis_transform(), "textcoords": "offset points"}
            label = ax.annotate(text, (0.02, y), **at, va=side, fontsize=SMALL, zorder=6)
            label.set_path_effects([patheffects.withStroke(linewidth=3, foreground="white")])
    if not values.size:
        return
    low, high = values.min(), values.max()
    if high < 0 and low / high > 5:
        bottom, top = low * 1.2, high / 1.35
        ticks = np.outer(10.0 ** np.arange(-6, 12), [1, 2, 5]).ravel()
        ax.set_yscale("symlog", linthresh=-top)
        ax.set_yticks([-t for t in ticks if -top <= t <= -bottom])
        ax.yaxis.set_major_formatter(lambda y, _: _number(y))
        ax.yaxis.set_minor_locator(NullLocator())
    else:
        margin = 0.1 * (high - low) or 1
        bottom, top = low - margin, high + margin
    ax.set_ylim(bottom, top)


def _number(x: float, digits: int = 6) -> str:
    return f"{round(x, 9) + 0.0:.{digits}g}".replace("-", "−")


# --- grids -------------------------------------------------------------------------------------------


def greedy_path(
    ax: Axes, env: Grid, q: np.ndarray, title: str = "greedy path", optimum: float = np.nan
) -> None:
    """The path of the policy that is greedy to `q`, from start to goal, on the grid with its wind below.

    Faint arrows are the greedy actions of all cells in which `q` prefers any; hatched cells cannot be
    reached. Where several actions are greedy the path takes one that leads to the goal soonest, so "goes
    round for ever" is said only where no choice among them gets there. Where chance plays, the path takes
    the most likely outcome (of equally likely ones the middle one).

    Args:
        ax: where to draw.
        env: a grid.
        q: action values, [S, A], learned or exact.
        title: the first line of the title; the second says how long the path is.
        optimum: v* from the start, named beside the length unless NaN.
    """
    moves = _Moves.of(env)
    path, arrives = moves.path(q, env.start_state)
    least = q.min(-1, where=q > policies.UNAVAILABLE, initial=np.inf)
    prefers = (q.max(-1) > least) & ~moves.terminal & moves.reachable
    _draw_grid(ax, env, moves)
    rows, columns = np.divmod(path, env.shape[1])
    arrows = _greedy(q) & prefers[:, None]
    for s, *step in zip(path[:-1], np.diff(rows), np.diff(columns), strict=True):
        arrows[s] &= (np.asarray(COMPASS[: env.num_actions]) != step).any(
            -1
        )  # the path itself shows this one
    _draw_arrows(ax, env, arrows, "#9a9a9a")
    _draw_ends(ax, env)

    color = COLORS[0] if arrives else ALARM
    outline = [patheffects.withStroke(linewidth=4.5, foreground="white")]
    ax.plot(columns, rows, color=color, lw=2.2, zorder=4, path_effects=outline)
    ax.plot(columns, rows, "o", color=color, ms=5, mec="white", mew=0.8, zorder=5)
    length = f"{len(path) - 1} steps to the goal" if arrives else "goes round for ever"
    if moves.stochastic:
        length = f"likeliest outcomes: {length}"
    if not np.isnan(optimum):
        length += f"; optimum v* = {_number(optimum, 4)}"
    _title(ax, f"{title}\n{length}")


def values(ax: Axes, env: Grid, v: np.ndarray, q: np.ndarray) -> None:
    """A heat map of the values `v`, float [S], with the arrows of all greedy actions of `q`, [S, A].

    Hatched cells cannot be reached from the start.
    """
    moves = _Moves.of(env)
    shown = np.isfinite(v) & moves.reachable
    image = ax.imshow(np.ma.masked_array(v, ~shown).reshape(env.shape), cmap="viridis", zorder=1)
    _draw_grid(ax, env, moves)
    _draw_arrows(ax, env, _greedy(q) & (shown & ~moves.terminal)[:, None], "white", raised=0.1)
    _draw_ends(ax, env, aside=True)
    for s in np.flatnonzero(shown & ~moves.terminal):
        row, column = divmod(int(s), env.shape[1])
        text = ax.text(
            column, row + 0.37, _number(v[s], 4), size=SMALL, ha="center", va="center", color="white"
        )
        text.set_path_effects([patheffects.withStroke(linewidth=1.5, foreground=INK)])
    assert ax.figure is not None
    color_bar(image, [ax], shrink=0.75, pad=0.02)


def walk(ax: Axes, env: Grid, states: np.ndarray, title: str) -> None:
    """The way that an episode went, from one of `states`, int [steps + 1], to the next.

    Every arrow is drawn a little to the right of where it goes, so that ways back and forth lie side by side.
    """
    _draw_grid(ax, env, _Moves.of(env))
    rows, columns = np.divmod(np.asarray(states), env.shape[1])
    down, right = np.diff(rows), np.diff(columns)
    moved = (down != 0) | (right != 0)  # against the edge it stays
    x, y = columns[:-1] - 0.12 * down, rows[:-1] + 0.12 * right
    _quiver(ax, x[moved], y[moved], right[moved], down[moved], COLORS[0], width=0.07)
    _draw_ends(ax, env, aside=True)
    _title(ax, title)


def changes(ax: Axes, env: Grid, change: np.ndarray, title: str) -> None:
    """An arrow for each action whose value changed, the fainter the less; `change` is float [S, A]."""
    _draw_grid(ax, env, _Moves.of(env))
    states, actions = np.nonzero(change)
    rows, columns = np.divmod(states, env.shape[1])
    down, right = np.asarray(COMPASS)[actions].T
    size = np.abs(change[states, actions])
    faint = 0.3 + 0.7 * size.astype(float) / size.max(initial=0)
    color = np.column_stack([np.tile(to_rgb(COLORS[1]), (len(size), 1)), faint])
    _quiver(ax, columns + 0.1 * right, rows + 0.1 * down, 0.4 * right, 0.4 * down, color, width=0.065)
    _draw_ends(ax, env, aside=True)
    _title(ax, title)


class _Moves(NamedTuple):
    """Where each action leads, by its most likely outcome.

    Attributes:
        successor: state, int [S, A].
        terminal: bool [S].
        reachable: whether the state can be reached from a start state, bool [S].
        stochastic: whether any action has several outcomes.
    """

    successor: np.ndarray
    terminal: np.ndarray
    reachable: np.ndarray
    stochastic: bool

    @classmethod
    def of(cls, env: Environment) -> "_Moves":
        model = planning.exact_model(env)
        s_next = model.s_next
        same = s_next[..., :, None] == s_next[..., None, :]
        likelihood = (model.prob[..., None, :] * same).sum(-1)  # of the successor, by whichever outcome
        likeliest = np.isclose(likelihood, likelihood.max(-1, keepdims=True))
        rank = likeliest.cumsum(-1)
        middle = (rank[..., -1:] + 1) // 2
        k = ((rank == middle) & likeliest).argmax(-1)[..., None]

        return cls(
            successor=np.take_along_axis(s_next, k, -1)[..., 0],
            terminal=planning.terminal_states(model),
            reachable=planning.reachable(model),
            stochastic=not np.isclose(likelihood.max(-1), 1).all(),
        )

    def distance(self, q: np.ndarray) -> np.ndarray:
        """Steps to a terminal state by greedy actions, float32 [n, S] for `q` [n, S, A]; inf if never."""
        cost = np.where(np.moveaxis(_greedy(q), 0, -1), np.float32(1), np.float32(np.inf))  # [S, A, n]
        cost[self.terminal] = 0
        steps = np.full((len(cost), len(q)), np.float32(np.inf))
        steps[self.terminal] = 0
        while True:
            before, steps = steps, (steps[self.successor] + cost).min(1)
            if (steps == before).all():
                return steps.T

    def path(self, q: np.ndarray, s: int) -> tuple[np.ndarray, bool]:
        """The states of the greedy path from `s`, and whether it ends; else its last state is a repeat."""
        steps, greedy = self.distance(q[None])[0], _greedy(q)
        path = [s]
        while not self.terminal[s] and s not in path[:-1]:
            onward = self.successor[s][greedy[s]]
            s = int(onward[np.argmin(steps[onward])])
            path.append(s)
        return np.array(path), bool(self.terminal[s])


def _tables(ds: xr.Dataset) -> Iterable[np.ndarray]:
    """The tables of all seeds, [n, S, A] for some seeds at a time: what is worked out from them may be larger."""
    q = ds.q.transpose("seed", "state", "action").values
    for block in memory.blocks(len(q), 16 * q[0].nbytes):
        yield q[block]


def _greedy(q: np.ndarray) -> np.ndarray:
    """Which actions are maximal, up to rounding, bool [..., S, A]."""
    q = np.where(np.isnan(q), -np.inf, q)  # a diverged entry is no maximum
    most = q.max(-1, keepdims=True)
    with np.errstate(invalid="ignore"):  # infinities
        return (q == most) | (q >= most - (1e-9 + 1e-6 * abs(most)))


def _draw_grid(ax: Axes, env: Grid, moves: _Moves) -> None:
    """Cells, hatched where nobody gets; where there is wind, its strength as a shade and in numbers below."""
    rows, columns = env.shape
    wind = np.asarray(getattr(env, "wind", np.zeros(columns)))
    strongest = max(1, np.abs(wind).max())
    for column, strength in enumerate(wind):
        shade = mpl.colormaps["Blues"](0.36 * abs(strength) / strongest)
        if strength:
            ax.add_patch(Rectangle((column - 0.5, -0.5), 1, rows, color=shade, lw=0, zorder=0))
        if wind.any():
            ax.text(column, rows - 0.1, _number(strength), ha="center", va="center", color=INK, size=SMALL)
    if wind.any():
        ax.text(-0.65, rows - 0.1, "wind", ha="right", va="center", color=INK, size=SMALL)
    style = {"fc": "#f4f4f4", "ec": "#bdbdbd", "hatch": "////", "lw": 0, "zorder": 1}
    for s in np.flatnonzero(~moves.reachable):
        row, column = divmod(int(s), columns)
        ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, **style))
    if not moves.reachable.all():
        note = {"size": SMALL, "color": GREY, "ha": "right", "va": "top"}
        ax.text(columns - 0.5, rows - 0.4 + 0.6 * wind.any(), "hatched: out of reach from the start", **note)
    lines = {"color": "#c4c4c4", "lw": 0.8, "zorder": 2}
    ax.hlines(np.arange(rows + 1) - 0.5, -0.5, columns - 0.5, **lines)
    ax.vlines(np.arange(columns + 1) - 0.5, -0.5, rows - 0.5, **lines)
    ax.set_xlim(-0.55, columns - 0.45)
    ax.set_ylim(rows - 0.45, -0.55)
    ax.set_aspect("equal")
    ax.axis("off")


def _draw_arrows(ax: Axes, env: Grid, shown: np.ndarray, color: str, raised: float = 0.0) -> None:
    """An arrow for each (s, a) that is `shown`, bool [S, A]; staying is a dot.

    They start in the middle of the cell, or so much above it as they are `raised`.
    """
    states, actions = np.nonzero(shown)
    rows, columns = np.divmod(states, env.shape[1])
    rows = rows - raised
    down, right = np.asarray(COMPASS)[actions].T
    stays = (down == 0) & (right == 0)
    length = (0.4 - raised) / np.maximum(1, np.hypot(down, right))
    if stays.any():
        ax.plot(columns[stays], rows[stays], "o", color=color, ms=4, zorder=3)
    _quiver(ax, columns[~stays], rows[~stays], (right * length)[~stays], (down * length)[~stays], color)


def _quiver(
    ax: Axes,
    x: np.ndarray,
    y: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    color: Any,
    width: float = 0.045,
) -> None:
    """Arrows from (x, y), as long and as wide as they are in cells; `color` is one for all or [arrows, 4]."""
    ax.quiver(
        *(x, y, right, down),
        **{"angles": "xy", "scale_units": "xy", "scale": 1, "units": "xy", "width": width},
        **{
            "headwidth": 4,
            "headlength": 4,
            "headaxislength": 3.6,
            "minlength": 0,
            "color": color,
            "zorder": 3,
        },
    )


def _draw_ends(ax: Axes, env: Grid, aside: bool = False) -> None:
    """The start and the goal; as letters in a corner where arrows need the middle of the cell."""
    disc = None if aside else {"boxstyle": "circle,pad=0.25", "fc": "white", "ec": INK, "lw": 1}
    style = {"size": SMALL, "weight": "bold", "ha": "center", "va": "center", "color": INK, "zorder": 6}
    corner = 0.32 if aside else 0
    for (row, column), letter in ((env.start, "S"), (env.goal, "G")):
        text = ax.text(column - corner, row - corner, letter, bbox=disc, **style)
        text.set_path_effects([patheffects.withStroke(linewidth=2, foreground="white")])


# --- what is no grid ---------------------------------------------------------------------------------


def panels(
    axes: Sequence[Axes],
    env: Finite,
    v: np.ndarray,
    best: np.ndarray | None = None,
    title: str = "",
    limits: tuple[float, float] | None = None,
) -> None:
    """Heat maps of the values `v`, float [S], in the tables in which people see the states.

    States that are terminal or out of reach are left empty.

    Args:
        axes: where to draw, one for each of `env.panels()`.
        env: the environment.
        v: values, [S].
        best: which actions are best, bool [S, A]; named below the values. None: names none.
        title: stands over all, above what the states of each table have in common.
        limits: the values at the ends of the colours, so that pictures compare; by default those of `v`.
    """
    model = planning.exact_model(env)
    shown = np.isfinite(v) & planning.reachable(model) & ~planning.terminal_states(model)
    low, high = limits or (v[shown].min(initial=np.inf), v[shown].max(initial=-np.inf))
    image = None
    for ax, table in zip(axes, env.panels(), strict=True):
        values = np.ma.masked_array(v, ~shown)[table.states]
        image = ax.imshow(values, cmap="viridis", vmin=low, vmax=high)
        for row, column in np.argwhere(shown[table.states]):
            s = table.states[row, column]
            text = _cell(float(v[s]))
            if best is not None:
                text += "\n" + _either([env.action_names[a] for a in np.flatnonzero(best[s])])
            color = (
                INK if v[s] > low + 0.6 * (high - low) else "white"
            )  # on the bright colours, and on the dark
            middle = {"ha": "center", "va": "center", "linespacing": 1}
            ax.text(column, row, literal(text), size=CELL, color=color, **middle)
        ax.set_xticks(range(len(table.columns)), map(literal, table.columns))
        ax.set_yticks(range(len(table.rows)), map(literal, table.rows))
        ax.set_xlabel(literal(table.along), fontsize=TYPE)
        ax.set_ylabel(literal(table.down), fontsize=TYPE)
        ax.tick_params(length=0, labelsize=SMALL)
        ax.spines[:].set_visible(False)
        over = title if ax is axes[0] else ""  # it may be as long as all the tables are wide
        ax.set_title(literal("\n".join(filter(None, [over, table.title]))), fontsize=TYPE, loc="left")
    color_bar(image, axes, location="bottom", shrink=0.5, aspect=40, pad=0.01)


def _cell(x: float) -> str:
    """A value in as few characters as a cell has room for."""
    text = f"{round(x, 2) + 0:.2f}" if abs(x) < 10 else _number(x, 3)
    return (text.replace("0.", ".", 1) if abs(x) < 1 else text).replace("-", "−")


def _either(names: Sequence[str]) -> str:
    """Several actions in a cell: "←↑", or long names one below the other, as far as there is room for them."""
    if all(len(name) == 1 for name in names):
        return "".join(names)
    return "\n".join(names) if len(names) < 3 else f"{len(names)} tied"


def panels_canvas(env: Finite, rows: int) -> tuple[Figure, np.ndarray]:
    """A figure with the axes for so many rows of `panels`, [rows, panels]."""
    tables = env.panels()
    widths = [1.5 + len(table.columns) for table in tables]  # in cells, with the names of the rows
    cell = min(0.5, WIDTH / sum(widths))
    tallest = max(len(table.rows) for table in tables)
    figure = canvas(max(NARROW, cell * sum(widths)), (1.3 + cell * tallest) * rows + 0.5)
    return figure, figure.subplots(rows, len(tables), squeeze=False, width_ratios=widths)


def action_values(ax: Axes, env: Finite, q: np.ndarray) -> None:
    """A mark for the value of each action, `q` [S, A], in each state that is not terminal.

    Where there are more actions than states, the actions lie along the axis and the marks tell the states
    apart. Of more than `MOST_MARKS` kinds of marks two are left: for the largest value and for all others.
    """
    states = np.flatnonzero(~planning.terminal_states(planning.exact_model(env)))
    along, marked = ("state", states.astype(str)), ("action", np.array(env.action_names))
    x, shown = states, q[states].T  # [marks, places]
    if env.num_actions > len(states):
        along, marked = marked, along
        x, shown = np.arange(env.num_actions), q[states]
    style = {"ls": "none", "ms": 5}
    if len(shown) > MOST_MARKS:
        ax.plot(x, shown.T, ".", color="#9a9a9a")[0].set_label(f"any {marked[0]}")
        ax.plot(x, np.nanmax(shown, 0), "o", color=COLORS[0], label=f"the best {marked[0]}", **style)
    else:
        for y, name, mark in zip(shown, marked[1], _styles(), strict=False):
            ax.plot(x, y, label=literal(name), **mark | style)
    if len(x) <= MOST_TICKS:
        ax.set_xticks(x, map(literal, along[1]))
    else:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.margins(0.1)
    tidy(ax, along[0], "value")
    if len(shown) > 1:
        columns = -(-min(len(shown), MOST_MARKS) // 12)
        legend(ax, title=marked[0], loc="center left", bbox_to_anchor=(1, 0.5), ncols=columns)


def state_values(ax: Axes, datasets: Datasets, env: Environment, **given: Any) -> None:
    """The V that methods of prediction learned, mean and 95% interval over seeds, beside the exact v_pi.

    States that are terminal or out of reach are left out. v_pi is drawn where pi is the policy in which all
    actions are equally likely, which is the default. Arguments and errors as in `episodes_against_steps`.
    """
    model = planning.exact_model(env)
    states = np.flatnonzero(planning.reachable(model) & ~planning.terminal_states(model))
    for (label, ds), style in zip(_chosen(datasets, given), _styles(), strict=False):
        mean_curve(ax, states, ds.q[..., 0].isel(state=states), label, **style)
    if (exact := _uniform_values(datasets, env)) is not None:
        ax.plot(states, exact[states], color=INK, ls=(0, (5, 3)), lw=1.3, label="exact", zorder=1)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(ax, "state", "V")
    legend(ax)


def _uniform_values(datasets: Datasets, env: Environment) -> np.ndarray | None:
    """v_pi, float64 [S], where all learned about the uniform policy with one gamma; else None."""
    given = any("pi" in stats.fixed(ds) or "pi" in ds.dims for ds in datasets.values())
    gamma, *others = {stats.fixed(ds).get("gamma", np.nan) for ds in datasets.values()}
    if given or others or np.isnan(gamma):
        return None
    available = available_actions(env)
    there = np.ones((env.num_states, env.num_actions)) if available is None else np.asarray(available, float)
    uniform = there / there.sum(1, keepdims=True)
    try:
        return planning.evaluate(env, uniform, gamma)
    except InputError:  # not finite everywhere
        return None


# --- whole figures -----------------------------------------------------------------------------------


def overview(datasets: Datasets, env: Environment) -> Figure:
    """The curves of `save_all` in one figure; on grids with the greedy path of the method with the best mean.

    Args:
        datasets: a sweep for each method, at least one.
        env: the environment of all of them.
    """
    curves = _curves(datasets, env)
    if isinstance(env, Grid) and not stats.is_prediction(*datasets.values()):
        winner = stats.ranked(datasets)[0]
        curves["greedy_path"] = lambda ax: _median_path(ax, env, winner, datasets[winner])
    columns = min(2, len(curves))
    rows = -(-len(curves) // columns)
    figure = canvas(WIDTH, 2.8 * rows + 0.4)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, draw in zip(grid, curves.values(), strict=False):
        draw(ax)
    for ax in grid[len(curves) :]:
        ax.remove()
    _say_what_ran(figure, datasets, env, intervals=True)
    return figure


def save_all(
    datasets: Datasets, env: Environment, folder: Path | str, kind: Literal["png", "pdf", "svg"] = "png"
) -> list[Path]:
    """Writes the pictures of a sweep into `folder`, which is made if need be.

    `episodes.png`, `learning_curves.png`, `sensitivity.png` and `sensitivity_NAME.png` (where hyperparameters
    were swept), `greedy_path.png` (on grids: every method, and the exact optimum), `values.png` (where people
    see the states in tables: the learned values and best actions, and the exact ones), and `overview.png`.
    Of methods of prediction no `episodes.png` and no path, but always `values.png`.

    Args:
        datasets: a sweep for each method, at least one.
        env: the environment of all of them.
        folder: where to write; files of these names are overwritten.
        kind: of the files. "pdf" and "svg" are sharp at any size, as for a paper, and take longer.

    Returns:
        The files written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    figures = pictures(datasets, env) | {"overview": overview(datasets, env)}
    files = [folder / f"{name}.{kind}" for name in figures]
    for file, figure in zip(files, figures.values(), strict=True):
        save(figure, file)
    return files


def save(figure: Figure, file: Path) -> None:
    """Writes a figure as the ending of `file` says: .png, .pdf or .svg. The same figure gives the same bytes."""
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    # Journals take fonts of kind 42 (TrueType) alone.
    with mpl.rc_context({"svg.hashsalt": "jaxrl_tab", "pdf.fonttype": 42}):
        figure.savefig(file, metadata=undated.get(file.suffix))


def pictures(datasets: Datasets, env: Environment) -> dict[str, Figure]:
    """The figures of `save_all` by their names, but for the overview, in which they are again."""
    prediction = stats.is_prediction(*datasets.values())
    figures = {}
    for name, draw in _curves(datasets, env).items():
        figure = canvas(NARROW, 4.2)
        draw(figure.subplots())
        _say_what_ran(figure, datasets, env, intervals=True)
        figures[name] = figure
    if isinstance(env, Grid) and not prediction:
        figures["greedy_path"] = _all_paths(datasets, env)
    elif isinstance(env, Finite) and env.panels():
        figures["values"] = value_tables(datasets, env)
    return figures


def _curves(datasets: Datasets, env: Environment) -> dict[str, Callable[[Axes], None]]:
    """What draws each picture of one pair of axes, by its name."""
    prediction = stats.is_prediction(*datasets.values())
    curves: dict[str, Callable[[Axes], None]] = {}
    if not prediction:
        curves["episodes"] = lambda ax: episodes_against_steps(ax, datasets)
    soft = _common_soft_optimum(datasets, env)
    curves["learning_curves"] = lambda ax: learning_curves(ax, datasets, soft=soft)
    names = (name for ds in datasets.values() for name in stats.hyperparameters(ds) + stats.drawn(ds))
    swept = dict.fromkeys(name for name in names if name != "draw")
    for i, name in enumerate(sorted(swept, key=lambda name: name != "alpha")):
        key = f"sensitivity_{name}" if i else "sensitivity"
        line = np.nan if name in ("epsilon", "gamma", "behaviour") else soft  # which is another at each point
        curves[key] = lambda ax, name=name, line=line: sensitivity(ax, datasets, name, soft=line)
    if prediction and not (isinstance(env, Finite) and env.panels()):
        curves["values"] = lambda ax: state_values(ax, datasets, env)
    return curves


def value_tables(datasets: Datasets, env: Finite) -> Figure:
    """The panels of the environment: a row for what each method learned, and one for what is exact.

    What a method learned is the mean over seeds of its largest action value, and the action that is greedy
    most often; of prediction the mean of V.
    """
    learned = {}
    for label, ds in _chosen(datasets, {}):
        often = sum(_greedy(q).sum(0) for q in _tables(ds))
        best = often == np.max(often, -1, keepdims=True)
        value = sum(q.max(-1).sum(0, dtype=float) for q in _tables(ds)) / ds.sizes["seed"]
        learned[f"{label}: mean of {_seeds({label: ds})}"] = value, None if stats.is_prediction(ds) else best
    limits = None
    if (exact := _exact_table(datasets, env)) is not None:
        learned["Exact"] = exact
        model = planning.exact_model(env)
        there = exact[0][planning.reachable(model) & ~planning.terminal_states(model)]
        limits = there.min(), there.max()
    figure, grid = panels_canvas(env, len(learned))
    for row, (title, (v, best)) in zip(grid, learned.items(), strict=True):
        panels(row, env, v, best, title, limits)
    _say_what_ran(figure, datasets, env)
    return figure


def _exact_table(datasets: Datasets, env: Finite) -> tuple[np.ndarray, np.ndarray | None] | None:
    """v* and the optimal actions, or of prediction v_pi and None; None where there is no one such answer."""
    if stats.is_prediction(*datasets.values()):
        v = _uniform_values(datasets, env)
        return None if v is None else (v, None)
    if not np.isfinite(_common_optimum(datasets)):
        return None
    v, q = planning.value_iteration(env, stats.fixed(next(iter(datasets.values()))).get("gamma", 1.0))
    return v, _greedy(q)


def _all_paths(datasets: Datasets, env: Grid) -> Figure:
    """The greedy path of every method, and an optimal one where there is a finite optimum."""
    optimum = _common_optimum(datasets)
    count = len(datasets) + bool(np.isfinite(optimum))
    columns, rows = min(2, count), -(-count // 2)
    width = WIDTH * columns / 2
    figure = canvas(width, (0.9 + 0.95 * width / columns * env.shape[0] / env.shape[1]) * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (method, ds) in zip(grid, datasets.items(), strict=False):
        _median_path(ax, env, method, ds)
    if np.isfinite(optimum):
        gamma = stats.fixed(next(iter(datasets.values()))).get("gamma", 1.0)
        _, q = planning.value_iteration(env, gamma)
        greedy_path(grid[len(datasets)], env, q, "An optimal policy", optimum)
    for ax in grid[count:]:
        ax.remove()
    return figure


def _median_path(ax: Axes, env: Grid, method: str, ds: xr.Dataset) -> None:
    """The greedy path that is the median over seeds in length, at the best hyperparameters."""
    setting = stats.best(ds)
    label, ds = _label(method, stats.named(ds, setting)), ds.sel(setting)
    moves = _Moves.of(env)
    lengths = np.concatenate([moves.distance(q)[:, env.start_state].copy() for q in _tables(ds)])
    median = np.argsort(lengths, kind="stable")[(len(lengths) - 1) // 2]
    title = f"{label}\ngreedy path, median of {_seeds({label: ds})}"
    greedy_path(ax, env, ds.q.values[median], title, float(stats.optimum(ds)))


class _Canvas(Figure):
    """A figure in which a character that the font lacks is a box, and nothing else happens."""

    def draw(self, renderer: Any) -> None:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from font")
            super().draw(renderer)


def canvas(width: float, height: float) -> Figure:
    """An empty figure of so many inches."""
    return _Canvas((width, height), dpi=DPI, layout=ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.06))


def head(figure: Figure, text: str) -> None:
    """The title of a whole figure."""
    figure.suptitle(literal(text), fontsize=TITLE)


def _say_what_ran(figure: Figure, datasets: Datasets, env: Environment, *, intervals: bool = False) -> None:
    """The title of a whole figure: what was run, and whether means with `intervals` are shown of it.

    What was run: the environment, what is not as usual in it, the hyperparameters of all, the seeds.
    """
    names = dict.fromkeys(_short(describe.title(str(ds.attrs["environment"]))) for ds in datasets.values())
    first, *others = [stats.fixed(ds) for ds in datasets.values()]
    common = {k: v for k, v in first.items() if all(k in other and other[k] == v for other in others)}
    # Lines that fit the figure, broken between settings and not within.
    settings = [setting.replace(" ", "\xa0") for setting in [*names, *unusual(env), *in_words(common)]]
    line = int(LINE * figure.get_figwidth() / WIDTH)
    lines = textwrap.wrap(", ".join(settings), line, break_on_hyphens=False)
    lines += [f"mean over {_seeds(datasets)}, and its 95% interval at each point"] if intervals else []
    head(figure, "\n".join(lines).replace("\xa0", " "))


def _seeds(datasets: Datasets) -> str:
    """How many seeds there are: "20 seeds"."""
    count = " or ".join(str(n) for n in sorted({ds.sizes["seed"] for ds in datasets.values()}))
    return f"{count} seed{'s' * (count != '1')}"


def unusual(env: Environment) -> list[str]:
    """The parameters of the environment that are not as they are by default, each with its value."""
    return [
        f"{field.name} = {getattr(env, field.name)}"
        for field in dataclasses.fields(env)  # pyright: ignore[reportArgumentType]
        if isinstance(field.default, (str, int, float))
        and np.ndim(getattr(env, field.name)) == 0
        and getattr(env, field.name) != field.default
    ]
