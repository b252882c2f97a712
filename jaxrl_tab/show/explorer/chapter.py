"""All that can be looked at of an environment, within a number of bytes.

What is kept is decided by numbers alone, so that the same data give the same page. All settings have their scores.
Curves have the best setting of each method, those that differ from it in one hyperparameter, and then others, the
best first, as far as there is room; tables have the same settings. Only the best setting of each method has tables
over time, for these come from running it again.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core.declared import Learns
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.show import words
from jaxrl_tab.show.explorer.measures import (
    REFERENCES,
    STATISTICS,
    Flat,
    Measure,
    measures_of,
    statistics,
)
from jaxrl_tab.show.explorer.over_time import RANKS, Again, Block, OverTime, averaged, block, ranks
from jaxrl_tab.show.explorer.packing import as_text, packed_floats
from jaxrl_tab.show.explorer.scene import Scene, scene, scene_of_places
from jaxrl_tab.show.explorer.scores import Score, intervals, levels_of, scores_of
from jaxrl_tab.show.places import Places, absent, learned_at, places_of
from jaxrl_tab.show.tasks import policy_of
from jaxrl_tab.stats.columns import Method, Methods

# Numbers in a page, of all its chapters together: of curves 4 bytes each, of tables about 5 bits.
CURVES, TABLES = 2**19, 2**21
# What the runs of a setting may take together that are run again: those that are shown one by one, and as many more
# of the first seeds, for a mean, as these allow.
MOST_STEPS, MOST_NUMBERS = 2**26, 2**24
MORE_STEPS, MORE_NUMBERS = 2**20, 2**19

T = TypeVar("T", Measure, Score)


class Explorer(NamedTuple):
    """What the scripts of the page draw from.

    Attributes:
        data: as JSON has it; the names in it are those that `explorer.js` asks for.
        blocks: packed numbers, by names that `data` has.
    """

    data: dict[str, Any]
    blocks: dict[str, str]


def explorer(
    label: str,
    methods: Methods,
    *,
    group: str = "",
    again: Again | None = None,
    toml: Mapping[str, str] | None = None,
    chapters: int = 1,
) -> Explorer:
    """What can be looked at of an environment.

    Args:
        label: the name of the environment.
        methods: its methods, with the environment.
        group: what stands before the name of a method in the file of results.
        again: runs a setting again and records its tables; without it tables are those at the end of a run.
        toml: for methods by name an experiment of one setting, without what was swept; its last lines are those of
            the method.
        chapters: how many environments share the page.
    """
    env, toml = methods.env, toml or {}
    assert env is not None
    places = None if env.num_states else places_of(env, methods)
    sweeps = {
        name: _Sweep(own, chapters * len(methods), env, places) for name, own in methods.settings.items()
    }
    measures = _common([measures_of(sweep.flat.ds) for sweep in sweeps.values()])
    curves = {name: sweep.curves(measures) for name, sweep in sweeps.items()}
    middles = np.concatenate([x[:, 0, 0].ravel() for x in curves.values()])
    levels = levels_of(middles, measures[0].kind == "cost")
    scores = _common([scores_of(sweep.flat.ds, measures, levels) for sweep in sweeps.values()])
    first = next(iter(sweeps.values()))
    if env.num_states:
        stage = scene(env, methods, first.shown(first.final(first.best)).mean(0).max(-1))
    else:
        stage = (
            None if places is None else scene_of_places(places, env, stats.is_prediction(*methods.values()))
        )
    blocks, shown = {}, []
    for i, (name, sweep) in enumerate(sweeps.items()):
        blocks[f"curves-{i}"] = as_text(packed_floats(curves[name]))
        numbers = intervals(sweep.flat, scores, sweep.own)
        blocks[f"scores-{i}"] = as_text(packed_floats(numbers))
        tables = {}
        for setting, packed in () if stage is None else sweep.tables(f"{label}/{name}", stage, again):
            blocks[f"tables-{i}-{setting}"] = packed.text
            tables[setting] = packed.data
        code = {"group": group + name, "toml": toml.get(f"{label}/{name}")}
        shown.append(sweep.data(name) | code | {"tables": tables, "missing": sweep.missing})
    if stage and stage.exact is not None:
        blocks["exact"] = as_text(packed_floats(stage.exact))
    optima = {float(x) for ds in methods.values() for x in np.ravel(stats.optimum(ds).values)}
    data = {
        "unit": "steps" if "num_steps" in first.flat.ds.attrs else "episodes",
        "prediction": methods.prediction,
        "optimum": optima.pop() if len(optima) == 1 and np.isfinite([*optima]).all() else None,
        "methods": shown,
        "first": list(sweeps).index(stats.ranked(methods.settings)[0]),
        "statistics": len(STATISTICS),
        "references": [{"measure": "value_error", "title": title} for title in REFERENCES.values()],
        "measures": [_described(measure) for measure in measures],
        "scores": [_described(score) for score in scores],
        "scene": stage.data | {"exact": stage.exact is not None} if stage else None,
        "absent": "" if stage else absent(env, methods),
    }
    return Explorer(data, blocks)


class _Sweep:
    """The settings of a method, and which of them are kept.

    Attributes:
        own: the method.
        flat: its sweep with the settings in one row.
        best: the number of its best setting.
        kept: the numbers of the settings of which curves are kept, int ascending.
        missing: why there are no tables over time; empty where there are.
        env, places: the environment, and what stands for its states where these cannot be counted.
    """

    def __init__(self, own: Method, sharers: int, env: Environment, places: Places | None) -> None:
        self.own, self.flat, self.env, self.places = own, Flat(own.ds), env, places
        lost, mean = own.lost.values.ravel(), own.merit.mean("seed").fillna(-np.inf).values.ravel()
        by_rank = np.lexsort((np.arange(len(mean)), -mean, lost))  # as `stats.best` has it
        self.best = int(by_rank[0])
        coordinates = np.stack(np.unravel_index(np.arange(self.flat.count), own.lost.shape or (1,)), -1)
        near = (coordinates != coordinates[self.best]).sum(-1) <= 1
        order = [self.best, *(i for i in by_rank if near[i]), *by_rank]
        self._order = [int(i) for i in dict.fromkeys(order)]
        self.sharers = sharers
        self.kept: list[int] = []
        self.missing = ""

    def curves(self, measures: list[Measure]) -> np.ndarray:
        """[kept, measures, statistics and single runs, points]: see `statistics`."""
        each = len(measures) * (len(STATISTICS) + len(RANKS)) * len(self.flat.x)
        self.kept = sorted(self._order[: max(1, CURVES // self.sharers // each)])
        return statistics(self.flat, measures, self.kept, [self.singles(i) for i in self.kept])

    def singles(self, setting: int) -> list[int]:
        """The places of the seeds whose runs are shown one by one."""
        return list(self._ranks(setting).values())

    def _ranks(self, setting: int) -> dict[str, int]:
        merit = self.flat.flat(self.own.merit)[setting]
        return ranks(np.argsort(np.nan_to_num(merit, nan=-np.inf), kind="stable").tolist())

    def final(self, setting: int) -> np.ndarray:
        """The tables at the end, [seeds, S, A]; where states cannot be counted, of the places that stand for them."""
        if self.places is None:
            return self.flat.flat(self.own.ds.q)[setting]
        ds = self.own.ds
        axes = stats.hyperparameters(ds)
        place = np.unravel_index(setting, [ds.sizes[axis] for axis in axes])
        of_setting = ds.isel(dict(zip(axes, map(int, place), strict=True)))
        return learned_at(self.places.points, self.env, of_setting)

    def shown(self, tables: np.ndarray) -> np.ndarray:
        """What people see of tables [..., S, A]: of preferences the policy."""
        return policy_of(tables) if self.is_policy else tables

    @property
    def is_policy(self) -> bool:
        return self.own.ds.attrs.get("learns") == Learns.PREFERENCES

    def tables(self, name: str, stage: Scene, again: Again | None) -> Iterator[tuple[int, Block]]:
        """The views of the settings for which there is room, by their numbers."""
        room = TABLES // self.sharers
        for setting in self._order:
            over, places = None, np.arange(self.flat.seeds)
            if setting == self.best and again is not None:
                try:
                    over, places = self._recorded(name, again)
                except (InputError, RunError) as error:
                    self.missing = f"{error}."
            if over is None:
                over = OverTime(self.shown(self.final(setting))[:, None])
            singles = np.searchsorted(places, self.singles(setting))
            packed = block(over, stage.states, singles, averaged(places))
            room -= packed.numbers
            if room < 0 and setting != self.best:
                return
            yield setting, packed

    def _recorded(self, name: str, again: Again) -> tuple[OverTime, np.ndarray]:
        """The best setting run again: what its runs had learned at the points of its curves, and their places.

        Raises:
            InputError, RunError: it takes too long, or too much, or what was learned in the end is not the same.
        """
        ds, flat = self.own.ds, self.flat
        singles = self.singles(self.best)
        steps = int(flat.flat(ds.steps)[self.best].sum(dtype=np.int64)) // flat.seeds
        shape = ds.q.shape[-2:] if self.places is None else (len(self.places.points), ds.sizes["action"])
        numbers = 2 * len(flat.x) * int(np.prod(shape))
        if steps * len(singles) > MOST_STEPS or numbers * len(singles) > MOST_NUMBERS:
            raise RunError("the runs are too long, or their tables too large, to be recorded for this page")
        more = min(flat.seeds, MORE_STEPS // steps, MORE_NUMBERS // numbers)
        places = np.unique([*range(more), *singles])
        points = None if self.places is None else self.places.points
        over = again(name, self.best, places, flat.every, points)
        end, final = over.tables[:, -1], self.final(self.best)[places]
        # Values that are functions of features are sums, which XLA rounds otherwise in another batch.
        rounding = (
            1e-5 * np.nanmax(np.abs(final), initial=0) if "features" in {*stats.fixed(ds), *ds.coords} else 0
        )
        if not np.allclose(end, final, rtol=0, atol=rounding, equal_nan=True):
            raise RunError("the best setting, run again, gave other numbers: this is another kind of machine")
        return over._replace(tables=self.shown(over.tables)), places

    def data(self, name: str) -> dict[str, Any]:
        """What the page must know beside the numbers."""
        ds, seeds = self.own.ds, self.own.ds.seed.values
        axes = stats.hyperparameters(ds)
        return {
            "title": words.title_of(name),
            "seeds": self.flat.seeds,
            "axes": [_axis(ds, axis) for axis in axes],
            "draws": [_axis(ds, drawn) for drawn in stats.drawn(ds)],
            "x": self.flat.x.tolist(),
            "ends": self.flat.ends.tolist(),
            "policy": self.is_policy,
            "best": self.best,
            "kept": self.kept,
            "references": [self._references(name) for name in REFERENCES],
            "ranks": list(self._ranks(self.best)),
            "runs": [seeds[self.singles(i)].tolist() for i in self.kept],
        }

    def _references(self, name: str) -> list[float | None]:
        """What the features of each setting that is kept allow; None where there is no such number."""
        if name not in self.own.ds:
            return [None] * len(self.kept)
        of_settings = self.own.ds[name].values.ravel()[self.kept]
        return [float(x) if np.isfinite(x) else None for x in of_settings]


def _axis(ds: xr.Dataset, name: str) -> dict[str, Any]:
    values = ds[name].values.tolist()
    return {
        "name": name,
        "symbol": words.symbol(name),
        "values": values,
        "texts": [words.written(x) for x in values],
    }


def _common(lists: Sequence[list[T]]) -> list[T]:
    """Those that all methods have."""
    first, *others = lists
    return [x for x in first if all(any(x.key == y.key for y in other) for other in others)]


def _described(x: Measure | Score) -> dict[str, Any]:
    more = {"partial": x.partial} if isinstance(x, Measure) else {}
    return {"key": x.key, "title": x.title, "kind": x.kind, "middle": x.middle, "code": x.code} | more
