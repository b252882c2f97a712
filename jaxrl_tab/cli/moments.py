"""`jaxrl-tab moments`: exact learning curves of prediction, without a single run."""

import csv
import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.algorithms.moments import METHODS, SWEPT, Best, LearningCurve, best_alpha, learning_curve
from jaxrl_tab.algorithms.prediction import OffPolicyPrediction
from jaxrl_tab.cli.common import ALPHAS, ENVIRONMENT, build_named, named_in, new_folder, start_jax, with_own
from jaxrl_tab.cli.options import Typed, checked_name
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import Classes, parameters, parse, values, word, words
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.methods import PREDICTION
from jaxrl_tab.show.words import cell, counted, in_words, title_of, unusual

PARTS = ("mse", "squared_bias", "variance")
# Those of whose tables there is an exact recursion.
EXACT = Classes(
    {
        name: cls
        for name, cls in PREDICTION.items()
        if issubclass(cls, METHODS)
        and not issubclass(cls, OffPolicyPrediction)
        and not hasattr(cls, "features")
    },
    "Of the method; several values of alpha, lam and n make a grid.",
    grids=True,
    defaults={"alpha": ALPHAS},
    noun="a method with exact learning curves",
)


@checked_dataclass
class Moments:
    """The exact learning curves of a method of prediction: no runs, no seeds, no luck.

    Of V after each episode the mean squared error over the states, which is squared bias (what is systematically off)
    plus variance (what is luck), for each alpha, lambda and n. The policy is that in which all actions are equally
    likely.

    Examples:
      jaxrl-tab moments random-walk td --states 5 --left-reward 0 --v0 0.5 --episodes 100
      jaxrl-tab moments random-walk n-step-td --n 1 2 4 --alpha 0.1 0.2 0.4 0.8 --episodes 10 --out runs/exact
      jaxrl-tab moments random-walk td-lambda --offline --lam 0 0.5 0.9 --alpha 0.02 0.05 0.1 --episodes 10
      jaxrl-tab moments random-walk monte-carlo-prediction --alpha 0.02 0.05 --episodes 10 --best

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv, mdp.npz,
            gymnasium:NAME.
        method: td, n-step-td, td-lambda (with --offline), or monte-carlo-prediction (with a number for alpha).
        episodes: After how many episodes.
        best: Also look for the best alpha for each lambda or n, whatever --alpha says.
        whole_run: The best is that with the least mean error over all episodes, as in figures 7.2 and 12.3 of the
            book, and not that with the least error after the last one.
        out: New folder for a picture (PNG), and for the numbers of all episodes (CSV, netCDF).
        json: Print JSON; a number that is infinite is null there.
    """

    env: str = word("ENV")
    method: str = word("METHOD")
    episodes: int = field(default=100, at_least=1)
    best: bool = False
    whole_run: bool = False
    out: Path | None = None
    json: bool = False


class Found(NamedTuple):
    """What was worked out.

    Attributes:
        method: with the values that are the same in all settings.
        curve: of all settings.
        judged: the error by which one setting is better than another, [*grid].
        best: for each lambda and n its values, the best alpha, and the error by which it is the best; if asked for.
    """

    method: Any
    curve: LearningCurve
    judged: np.ndarray
    best: list[dict[str, float]]

    @property
    def fixed(self) -> dict[str, Any]:
        """The hyperparameters that are the same in all settings."""
        names = [p.name for p in parameters(type(self.method)) if p.name not in self.curve.grid]
        return {name: getattr(self.method, name) for name in names}

    @property
    def settings(self) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
        """The place of each setting in the grid, and its values."""
        places = np.ndindex(*self.judged.shape)
        return list(zip(places, itertools.product(*self.curve.grid.values()), strict=True))

    @property
    def is_best(self) -> np.ndarray:
        """Which of several settings has the least error, bool [*grid]."""
        errors = np.where(np.isnan(self.judged), np.inf, self.judged)
        return np.asarray((errors == errors.min()) & np.isfinite(errors) & (errors.size > 1))


def moments_command(argv: list[str]) -> int:
    groups = {"hyperparameters": EXACT, "environment": with_own(ENVIRONMENT, named_in(argv)[0])}
    options, typed = parse(Moments, argv, **groups)
    (env,) = build_named(groups, typed, environment=options.env)
    method, grid = _method(options.method, typed["hyperparameters"])
    start_jax()
    with new_folder(options.out) as folder, busy("working out"):
        found = _work_out(env, method, grid, options)
        if folder:
            _save(found, env, options, folder)
    if options.json:
        print_json(_data(found, options))
        return 0
    _print(found, options)
    if options.out:
        say_where(options.out)
    return 0


def _method(name: str, typed: Typed) -> tuple[Any, dict[str, list[Any]]]:
    """The method, and what has several values."""
    checked_name(EXACT.noun, name, EXACT.registry)
    given = values([name], typed, EXACT)[name]
    grid = {key: x for key, x in given.items() if len(x) > 1}
    for key in grid:
        if key not in SWEPT:
            raise InputError(f"{name}: {key} has one value here; only alpha, lam and n may have several")
    return build(EXACT.registry[name], name, {key: x[0] for key, x in given.items()}), grid


def _work_out(env: Any, method: Any, grid: Mapping[str, list[Any]], options: Moments) -> Found:
    num_episodes, best = options.episodes, []
    curve = learning_curve(env, method, num_episodes=num_episodes, **grid)
    if options.best:
        others = {
            name: grid.get(name, [getattr(method, name)]) for name in SWEPT[1:] if hasattr(method, name)
        }
        for point in itertools.product(*others.values()):
            setting = dict(zip(others, point, strict=True))
            own = replace(method, **setting)
            found = best_alpha(env, own, num_episodes=num_episodes, whole_run=options.whole_run)
            best.append(setting | found._asdict())
    judged = curve.mse[..., 1:].mean(-1) if options.whole_run else curve.mse[..., -1]
    return Found(method, curve, judged, best)


# --- what people see ---------------------------------------------------------------------------------


def _print(found: Found, options: Moments) -> None:
    out, curve = console(), found.curve
    shared = [f"{name} {words(x)}" for name, x in found.fixed.items()]
    out.print(f"[bold]{escape(options.env)}[/]: {', '.join([options.method, *shared])}", soft_wrap=True)
    _print_table(found, options)
    say = lambda line: out.print(line, markup=False)
    first, states = curve.mse.reshape(-1, curve.mse.shape[-1])[0, 0], counted(len(curve.states), "states")
    say(
        f"The mean squared error of V, over {states}: exact, without runs. Before the first episode it is "
        f"{_number(first)}. It is squared bias, what is systematically off, plus variance, what is luck."
    )
    judged = (
        "mean error over all episodes" if options.whole_run else f"error after episode {options.episodes}"
    )
    if found.is_best.any():
        say(f"* This setting has the least {judged}.")
    if found.best:
        print_table(out, _best_table(found.best))
        say(f"Between 0 and 1 the best alpha is that with the least {judged}.")


def _print_table(found: Found, options: Moments) -> None:
    """A row for each setting. Where the window is too narrow, columns go; that by which settings are judged stays."""
    out, columns, left_out = console(), _columns(found, options), []
    *earlier, last = [name for name in columns if name.startswith("error")]
    parts = [name for name in columns if name.endswith(("bias", "variance"))]
    for name in [*earlier, *parts, *([last] if options.whole_run else [])]:
        if _table(found, columns).__rich_measure__(out, out.options).maximum > out.width:
            left_out.append(" ".join(name.split()))
            del columns[name]
    print_table(out, _table(found, columns))
    if left_out:
        out.print(f"In a wider window the table has: {'; '.join(left_out)}.", markup=False)


def _columns(found: Found, options: Moments) -> dict[str, list[str]]:
    """What stands in each column, by its heading; by the last of the errors settings are judged."""
    curve, places = found.curve, [place for place, _ in found.settings]
    written = lambda x: [cell(x[place], _number) for place in places]
    values = zip(*([words(x) for x in setting] for _, setting in found.settings), strict=True)
    columns = dict(zip(curve.grid, map(list, values), strict=False))
    episodes = [k for k in (options.episodes // 100, options.episodes // 10, options.episodes) if k]
    columns |= {f"error after\nepisode {k}": written(curve.mse[..., k]) for k in episodes}
    last = f"error after\nepisode {options.episodes}"
    columns["of which\nsquared bias"] = written(curve.squared_bias[..., -1])
    columns["\nvariance"] = written(curve.variance[..., -1])
    if options.whole_run:
        columns[last := "mean over\nall episodes"] = written(found.judged)
    columns[last] = [
        f"{x} *" if found.is_best[place] else x for x, place in zip(columns[last], places, strict=True)
    ]
    return columns


def _table(found: Found, columns: Mapping[str, list[str]]) -> Table:
    view = Table(*columns)
    for column in view.columns:
        column.justify = "right"
    for cells, (place, _) in zip(zip(*columns.values(), strict=True), found.settings, strict=True):
        view.add_row(*cells, style="bold" if found.is_best[place] else None)
    return view


def _best_table(best: list[dict[str, float]]) -> Table:
    names = [name for name in best[0] if name not in Best._fields]
    view = Table(*names, "best alpha", "its error")
    for column in view.columns:
        column.justify = "right"
    for row in best:
        view.add_row(*(words(row[name]) for name in names), _number(row["alpha"]), _number(row["mse"]))
    return view


def _number(x: float) -> str:
    return f"{x:.4g}"


# --- what programs read ------------------------------------------------------------------------------


def _data(found: Found, options: Moments) -> dict[str, Any]:
    curve = found.curve
    return {
        "environment": options.env,
        "method": options.method,
        "fixed": {
            name: x if isinstance(x, int | float | str) else words(x) for name, x in found.fixed.items()
        },
        "grid": {name: list(x) for name, x in curve.grid.items()},
        "num_episodes": options.episodes,
        "states": curve.states.tolist(),
        "true_values": curve.true_values.tolist(),
        **{part: _finite(getattr(curve, part)) for part in PARTS},
        "best": [{name: x if np.isfinite(x) else None for name, x in row.items()} for row in found.best],
    }


def _finite(x: np.ndarray) -> list[Any]:
    """Numbers for JSON, which has no infinite ones."""
    return np.where(np.isfinite(x), x.astype(object), np.array(None)).tolist()


def _save(found: Found, env: Any, options: Moments, folder: Path) -> None:
    """The picture, all that is known (netCDF), and the curves as a table (CSV)."""
    from jaxrl_tab.show import plot

    curve, fixed = found.curve, found.fixed
    data = curve.to_xarray().assign_attrs({name: words(x) for name, x in fixed.items()})
    data.attrs |= {"environment": options.env, "method": options.method}
    data.to_netcdf(folder / "moments.nc", engine="h5netcdf")
    with (folder / "moments.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow([*curve.grid, "episode", *PARTS])
        for place, setting in found.settings:
            parts = [getattr(curve, part)[place].tolist() for part in PARTS]
            rows.writerows([*setting, k, *numbers] for k, numbers in enumerate(zip(*parts, strict=True)))
    task = " with ".join(filter(None, [title_of(options.env), ", ".join(unusual(env))]))
    title = f"{task}: the exact errors of {', '.join([title_of(options.method), *in_words(fixed)])}"
    plot.save(plot.exact_curves(curve, title), folder / "moments.png")
