"""Pictures of learning curves and of sensitivity to hyperparameters."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator
from matplotlib.transforms import ScaledTranslation, Transform

from jaxrl_tab import stats
from jaxrl_tab.core.errors import InputError, check_choice, nearest
from jaxrl_tab.show import words
from jaxrl_tab.show.explorer.measures import REFERENCES, STATISTICS, Flat, measures_of, statistics
from jaxrl_tab.show.explorer.scores import interval_of, score_named
from jaxrl_tab.show.style import (
    DASHES,
    GREY,
    INK,
    MARKERS,
    SMALL,
    legend,
    line_styles,
    literal,
    room,
    tidy,
    width_of,
)
from jaxrl_tab.show.words import label_of, shortened, significant, text_of, written
from jaxrl_tab.stats.along import Datasets
from jaxrl_tab.stats.columns import Methods
from jaxrl_tab.stats.measures import error_interval, has_errors
from jaxrl_tab.stats.settings import Settings

Labels: TypeAlias = Mapping[str, str]  # what methods are called instead of their names

MOST_POINTS, LEAST_POINTS = 40, 5  # of a learning curve; halved from the most until it has no late gaps
FEW_TICKS, MOST_TICKS = 8, 25  # values, and states, beyond which not each has its tick on an axis
MOST_SEEDS = 0.9  # a learning curve is drawn where so many of the seeds finished an episode


def episodes_against_steps(
    ax: Axes,
    datasets: Datasets,
    *,
    labels: Labels | None = None,
    color_by: str | None = None,
    **setting: Any,
) -> None:
    """Episodes finished against time steps, mean and 95% interval over seeds (book, example 6.5).

    The slope is the pace: one episode in so many steps. Where episodes were the budget, the mean and its
    interval are of the time steps that they took, so the band is horizontal.

    Args:
        ax: where to draw.
        datasets: a sweep for each method.
        labels: what methods are called instead of their names; of some of them, or of all.
        color_by: a hyperparameter that was swept; there is a curve for each of its values.
        setting: hyperparameters to hold, such as `alpha=0.5`; otherwise each method's best (`stats.best`).

    Raises:
        InputError: no method swept the hyperparameter, or one that did not at this value; or there is no such
            method as a label names.
    """
    lines, styles = _lines(datasets, labels, color_by)
    for (label, own), style in zip(at_setting(lines, setting), styles, strict=True):
        by_steps = "num_steps" in own.ds.attrs
        spread, exact = ("episodes", "time_steps") if by_steps else ("time_steps", "episodes")
        interval = own.once(stats.progress_interval, spread)
        mean, low, high = (_from_origin(x.clip(min=0)) for x in interval[:3])
        other = _from_origin(stats.episode_curve(own.ds.isel(seed=0))[exact])
        points = (other, mean) if by_steps else (mean, other)
        ax.plot(*points, lw=1.8, ms=4.5, markevery=max(1, len(mean) // 8), label=literal(label), **style)
        band = ax.fill_between if by_steps else ax.fill_betweenx
        band(other, low, high, color=style["color"], alpha=0.2, lw=0)
    tidy(ax, "time steps", "episodes finished")
    ax.set_xlim(left=0)
    ax.set_ylim(bottom=0)
    legend(ax)


def learning_curves(
    ax: Axes,
    datasets: Datasets,
    *,
    soft: float = np.nan,
    measure: str | None = None,
    labels: Labels | None = None,
    color_by: str | None = None,
    **setting: Any,
) -> None:
    """Mean return per episode against time steps (or episodes), with 95% interval and the exact optimum.

    Rows of the log are merged to at most `MOST_POINTS`, or fewer where seeds finish few episodes. A point is
    drawn at the end of its rows, and only where `MOST_SEEDS` of the seeds finished an episode in them: at
    first only the quick episodes are over, and their mean would flatter. Of methods of prediction the RMS
    error of V is drawn, at the end of every row. Other arguments and errors as in `episodes_against_steps`.

    Args:
        soft: what the best policy is worth that explores as much; a dotted line unless NaN.
        measure: what is drawn instead, by its name in the address of the report: "length" of episodes,
            "reward" per step, or what was recorded, such as "greedy_value" or "q_error". Where it may be
            infinite, its median is drawn.
    """
    by_steps = all("num_steps" in ds.attrs for ds in datasets.values())
    datasets, styles = _lines(datasets, labels, color_by)
    if measure not in (None, "v_error" if has_errors(*datasets.values()) else "return"):
        _curves_of(ax, measure, at_setting(datasets, setting), styles)
        ax.set_xlabel("time steps" if by_steps else "episodes")
        legend(ax)
        return
    if has_errors(*datasets.values()):
        for (label, own), style in zip(at_setting(datasets, setting), styles, strict=True):
            x = (own.ds.steps if by_steps else own.ds.episodes).mean("seed").cumsum("row")
            line = {**style, "ms": 5, "markevery": max(1, len(x) // 8)}
            interval_curve(ax, x, own.once(error_interval), label, **line)
        tidy(ax, "time steps" if by_steps else "episodes", "RMS error of V over states")
        ax.set_xlim(left=0)
        ax.set_ylim(bottom=0)
        legend(ax)
        return
    known = all(
        "lengths" in ds for ds in datasets.values()
    )  # of what others computed a score may be of no episode
    shown, end = [], 0
    for (label, own), style in zip(at_setting(datasets, setting), styles, strict=True):
        points, interval, enough = _readable_curve(own)
        curve = stats.episode_curve(stats.merge_rows(own.ds.isel(seed=0), points))
        x = curve["time_steps" if "num_steps" in own.ds.attrs else "episodes"].values
        mean, low, high = (np.where(enough, part, np.nan) for part in interval[:3])
        ax.plot(x, mean, lw=1.7, ms=3.5, label=literal(label), **style)
        ax.fill_between(x, low, high, color=style["color"], alpha=0.2, lw=0)
        shown += [mean, low, high]
        end = max(end, x[-1])
    if not np.isfinite(np.concatenate(shown)).any():
        ax.text(0.5, 0.3, "too few episodes for a curve", transform=ax.transAxes, ha="center", color=GREY)
    ax.set_xlim(0, 1.03 * end)
    tidy(ax, "time steps" if by_steps else "episodes", "mean return per episode" if known else "mean score")
    _return_axis(ax, shown, common_optimum(datasets), soft)
    legend(ax)


def _curves_of(
    ax: Axes, measure: str, settings: Iterable[tuple[str, Settings]], styles: Sequence[dict[str, Any]]
) -> None:
    """The curve of a measure for each of some settings, as the report has it."""
    settings, least, title = list(settings), 0.0, ""
    if measure == "value_error":
        _reference_lines(ax, [own for _, own in settings], styles)
    for (label, own), style in zip(settings, styles, strict=True):
        measures = {one.key: one for one in measures_of(own.ds)}
        check_choice(None, "the measure", measure, measures)
        flat, one = Flat(own.ds), measures[measure]
        numbers = dict(zip(STATISTICS, statistics(flat, [one], [0], [[]])[0, 0], strict=True))
        bounds = ("low", "high") if one.middle == "mean" else ("median_low", "median_high")
        low, high = (np.where(np.isfinite(x), x, np.nan) for x in (numbers[bound] for bound in bounds))
        ax.plot(flat.x, numbers[one.middle], lw=1.7, ms=3.5, label=literal(label), **style)
        ax.fill_between(flat.x, low, high, color=style["color"], alpha=0.2, lw=0)
        title = one.title if one.middle == "mean" else f"{one.title}, median"
        least = min(least, np.nanmin(numbers[one.middle], initial=0))
    tidy(ax, "", title)
    ax.set_xlim(left=0)
    if least >= 0:
        ax.set_ylim(bottom=0)


def _reference_lines(ax: Axes, settings: Sequence[Settings], styles: Sequence[dict[str, Any]]) -> None:
    """What the features of each setting allow at best, and where TD ends: each in the colour of its curve."""
    for (name, label), dash in zip(REFERENCES.items(), ((0, (5, 3)), ":"), strict=True):
        heights = [float(own.ds[name]) for own in settings if name in own.ds]
        same = len({f"{y:.6g}" for y in heights}) == 1
        for i, (y, style) in enumerate(zip(heights[: 1 if same else None], styles, strict=False)):
            color = INK if same else style["color"]
            ax.axhline(y, color=color, ls=dash, lw=1.3, zorder=1, label=label if i == 0 else None)


def sensitivity(
    ax: Axes,
    datasets: Datasets,
    parameter: str = "alpha",
    *,
    soft: float = np.nan,
    measure: str = "score",
    labels: Labels | None = None,
    color_by: str | None = None,
) -> None:
    """Mean return of the last tenth against a hyperparameter, with 95% intervals and the exact optimum.

    Of methods of prediction it is the mean RMS error of V over all rows. Other swept hyperparameters stay at
    the method's best combination. The intervals are those of `stats.score_interval`. A point is hollow where
    some runs finished no episode in the last tenth, and so count with what they collected there. A method
    that did not sweep the parameter is drawn at the one value that it had. Schedules and policies, and
    numbers beside them, stand side by side in the order in which they come. Where the parameter was drawn at
    random there is a point for each draw; what was drawn together with it differs from point to point, too.

    Args:
        soft: as in `learning_curves`.
        measure: what is drawn instead, by its name in the address of the report: "interim" (the mean return of the
            whole run), "area", "until -20" (steps until a mean return of -20), "episodes", or what was recorded, as
            it is at the end: "greedy_value end", "q_error end". Other hyperparameters stay at the best setting by
            the usual score.
        labels, color_by: as in `episodes_against_steps`.

    Raises:
        InputError: no method swept the parameter, or `color_by`; or there is no such method as a label names, or
            no such measure.
    """
    if not any(parameter in stats.hyperparameters(ds) + stats.drawn(ds) for ds in datasets.values()):
        raise InputError(f"no method swept {parameter!r}")
    datasets, styles = _lines(datasets, labels, color_by)
    prediction = has_errors(*datasets.values())
    series, drawn, score = {}, set(), None
    for name, own in Methods.of(datasets).settings.items():
        ds, chosen = own.ds, dict(own.best)
        if parameter in stats.drawn(ds):
            drawn.add(name)
            del chosen["draw"]
        chosen.pop(parameter, None)
        label = label_of(name, stats.named(ds, chosen))
        score = score_named(ds, measure)
        interval = interval_of(Flat(ds), score, own)
        cut_off = (
            score.key == "score" and not own.among.continuing
        )  # a task that does not end ends no episode
        parts = [part.sel(chosen) for part in (*interval, (own.unfinished > 0) & cut_off)]
        ds = ds.sel(chosen)
        if name not in drawn and parameter not in ds.dims:
            if parameter not in stats.fixed(ds):
                continue
            ds = ds.expand_dims({parameter: [stats.fixed(ds)[parameter]]})
            parts = [part.expand_dims(parameter) for part in parts]
        series[name] = label, ds[parameter].values, parts
    place = _places(ax, [x for _, x, _ in series.values()])
    few = len(np.unique(np.concatenate([place(x) for _, x, _ in series.values()]))) <= FEW_TICKS
    shown, incomplete = [], False
    for name, style in zip(datasets, styles, strict=True):
        if name not in series:
            continue
        label, x, parts = series[name]
        if few:
            style["transform"] = _aside(ax, list(series).index(name), len(series))
        x, (*interval, _, late) = place(x), (part.values for part in parts)
        # Where runs diverged the interval may be infinite, and its bar would have no end.
        mean, low, high = (np.where(np.isfinite(part), part, np.nan) for part in interval)
        between = x.dtype.kind == "f" and name not in drawn  # nothing lies between two schedules, or draws
        style["ls"] = "-" if between else "none"
        alike = {key: style[key] for key in ("color", "transform") if key in style}
        if between and not few:
            ax.fill_between(x, low, high, alpha=0.2, lw=0, **alike)
        else:
            ax.errorbar(x, mean, np.nan_to_num([mean - low, high - mean]), ls="none", capsize=3, **alike)
        ax.plot(x, mean, lw=1.8, ms=5.5, label=literal(label), **style)
        late &= np.isfinite(mean)
        hollow = {**style, "ls": "none", "color": "white"}
        ax.plot(x[late], mean[late], ms=3, zorder=5, **hollow)
        shown += [mean, low, high]
        incomplete |= bool(late.any())
    if incomplete:
        hollow = {"marker": "o", "mfc": "white", "mec": INK, "mew": 1.5}
        ax.plot([], [], ls="none", **hollow, label="hollow: some runs unfinished")
    what = "step size α" if parameter == "alpha" else words.symbol(parameter)
    if score is not None and score.key != "score":
        tidy(ax, what, score.title if score.middle == "mean" else f"{score.title}, median")
        if score.kind == "return":
            of_episodes = score.key in ("interim", "greedy_value end")
            _return_axis(ax, shown, common_optimum(datasets) if of_episodes else np.nan, np.nan)
        else:
            seen = np.concatenate(shown)
            ax.set_ylim(0, 1.08 * seen[np.isfinite(seen)].max(initial=0) or 1)
    elif prediction:
        tidy(ax, what, "RMS error of V, mean over the run")
        _error_axis(ax, shown[::3])  # the means alone, without the ends of the intervals
    else:
        tidy(ax, what, "mean return, last tenth")
        _return_axis(ax, shown, common_optimum(datasets), soft)
    legend(ax)


def _lines(
    datasets: Datasets, labels: Labels | None, color_by: str | None
) -> tuple[Methods, list[dict[str, Any]]]:
    """What there is a line for, by its name, and how each is drawn: each method, or each value of `color_by`."""
    methods = Methods.of(datasets).renamed(labels or {})
    if color_by is None:
        return methods, list(itertools.islice(line_styles(), len(methods)))
    swept = {name: None for ds in methods.values() for name in stats.hyperparameters(ds)}
    if color_by not in swept:
        hint = f"; {nearest(color_by, swept)}" if swept else ""
        raise InputError(f"no method swept {color_by!r}{hint}")
    having = [ds for ds in methods.values() if color_by in ds.dims]
    values = list(dict.fromkeys(v for ds in having for v in ds[color_by].values.tolist()))
    values = values if any(isinstance(v, str) for v in values) else sorted(values)
    colors = mpl.colormaps["viridis"](np.linspace(0, 0.9, len(values)))
    parts, styles = {}, []
    for i, (name, ds) in enumerate(methods.items()):
        dash = DASHES[i % len(DASHES)]
        if color_by not in ds.dims:
            parts[name] = ds
            styles.append({"color": GREY, "marker": MARKERS[i % len(MARKERS)], "ls": dash})
            continue
        for value in ds[color_by].values.tolist():
            j = values.index(value)
            parts[f"{name}, {words.symbol(color_by)} = {written(value)}"] = ds.sel({color_by: value})
            styles.append({"color": colors[j], "marker": MARKERS[(i + j) % len(MARKERS)], "ls": dash})
    return Methods(parts, methods.env), styles


def _places(ax: Axes, tried: list[np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """A function from values of a hyperparameter to where they lie, and the x axis that fits all `tried`.

    Numbers are their own places, float. Where any is text all are ticks side by side, int.
    """
    if all(x.dtype.kind in "fiu" for x in tried):
        x = np.unique(np.concatenate(tried).astype(float))
        if x.min() > 0 and x.max() > 10 * x.min():
            ax.set_xscale("log")
            margin = (x.max() / x.min()) ** 0.06
            ax.set_xlim(x.min() / margin, x.max() * margin)
        else:
            margin = 0.06 * np.ptp(x) or 0.5
            ax.set_xlim(x.min() - margin, x.max() + margin)
        if len(x) <= FEW_TICKS:
            ax.set_xticks(x, [f"{v:g}" for v in x])
            ax.xaxis.set_minor_locator(NullLocator())
        elif ax.get_xscale() == "log":
            ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            ax.xaxis.set_minor_locator(NullLocator())
        return lambda x: x.astype(float)
    names = list(dict.fromkeys(text_of(v) for x in tried for v in x.tolist()))
    shown = [shortened(name) for name in names]
    # Longer names would run into one another.
    tilt = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"}
    too_long = (width_of(shown) + SMALL) * len(names) > room(ax)
    ax.set_xticks(range(len(names)), map(literal, shown), **tilt if too_long else {})
    ax.set_xlim(-0.5, len(names) - 0.5)
    return lambda x: np.array([names.index(text_of(v)) for v in x.tolist()])


def _aside(ax: Axes, i: int, count: int) -> Transform:
    """Data, moved to the side by some points: so that marks at the same place, of methods 0, 1 ..., can be seen."""
    assert ax.figure is not None
    step = min(4, 24 / count)
    points = ScaledTranslation((i - (count - 1) / 2) * step / 72, 0, ax.figure.dpi_scale_trans)
    return ax.transData + points


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
    interval_curve(ax, x, stats.mean_interval(values), label, color, **line)


def interval_curve(ax: Axes, x: Any, interval: stats.Interval, label: str, color: str, **line: Any) -> None:
    """`mean_curve`, from an interval that was worked out before."""
    ax.plot(x, interval.estimate, label=literal(label), color=color, lw=line.pop("lw", 1.8), **line)
    ax.fill_between(x, interval.low, interval.high, color=color, alpha=0.25, lw=0)


def _readable_curve(own: Settings, points: int = MOST_POINTS) -> tuple[int, stats.Interval, np.ndarray]:
    """At most how many points, the interval of the mean return at each, and if seeds suffice, bool [points].

    They are fewer than `points` if that closes gaps in the second half.
    """
    interval = own.once(stats.curve_interval, min(points, own.ds.sizes["row"]))
    enough = (interval.n >= MOST_SEEDS * own.ds.sizes["seed"]).values
    if enough[len(enough) // 2 :].all() or points <= LEAST_POINTS:
        return points, interval, enough
    return _readable_curve(own, points // 2)


def at_setting(
    datasets: Datasets, held: Mapping[str, Any], labels: Labels | None = None
) -> Iterable[tuple[str, Settings]]:
    """(label, one combination of hyperparameters) for each method: what is `held`, and else its best."""
    for name in held:
        if not any(name in stats.hyperparameters(ds) for ds in datasets.values()):
            raise InputError(f"no method swept {name!r}")
    for name, own in Methods.of(datasets).renamed(labels or {}).settings.items():
        own_held = {key: value for key, value in held.items() if key in stats.hyperparameters(own.ds)}
        setting = stats.best(own.ds, **own_held) if own_held else own.best
        yield (
            label_of(name, stats.named(own.ds, setting)),
            Settings(own.ds.sel(setting)) if own_held else own.at_best,
        )


def _from_origin(x: xr.DataArray) -> np.ndarray:
    return np.concatenate([[0], x.values])


def common_optimum(datasets: Datasets) -> float:
    """v* from the start if it is one finite number for all, else NaN."""
    values = np.concatenate([stats.optimum(ds).values.ravel() for ds in datasets.values()])
    return float(values[0]) if np.ptp(values) < 1e-6 * max(1, abs(values[0])) else np.nan


def common_soft_optimum(methods: Methods) -> float:
    """What the best policy is worth that explores as the best settings do, if all explore alike; else NaN."""
    first, *others = methods.settings.values()
    return first.soft if all(own.exploration == first.exploration for own in others) else np.nan


def _return_axis(ax: Axes, shown: list[np.ndarray], optimum: float, soft: float) -> None:
    """The y axis of returns, with the optimum as a dashed line, and the best value of exploring as a dotted one.

    Early returns can be a hundred times the last ones, and the distance from these to the optimum is what
    matters. Where all are negative and differ by more than a factor of five, the axis is one of ratios.
    """
    values = np.concatenate([*shown, [optimum, soft]])
    values = values[np.isfinite(values)]
    if np.isclose(soft, optimum):
        soft = np.nan
    for name, y, style in (("exact optimum", optimum, (0, (5, 3))), ("best ε-soft", soft, ":")):
        if np.isfinite(y):
            ax.axhline(y, color=INK, ls=style, lw=1.3, zorder=1, label=f"{name} {significant(y, 4)}")
    if not values.size:
        return
    low, high = values.min(), values.max()
    if high < 0 and low / high > 5:
        bottom, top = low * 1.2, high / 1.35
        ticks = np.outer(10.0 ** np.arange(-6, 12), [1, 2, 5]).ravel()
        # All values are beyond the threshold, so this is a logarithmic axis of negative numbers.
        ax.set_yscale("symlog", linthresh=-top)
        ax.set_yticks([-t for t in ticks if -top <= t <= -bottom])
        ax.yaxis.set_major_formatter(lambda y, _: significant(y))
        ax.yaxis.set_minor_locator(NullLocator())
    else:
        margin = 0.1 * (high - low) or 1
        bottom, top = low - margin, high + margin
    ax.set_ylim(bottom, top)
