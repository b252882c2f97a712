"""A search, rung after rung: what is computed of each setting, which of them go on, and what was found.

It lies in a folder in that of the experiment which it finds: with an experiment of all settings, the shards of each
rung, and what is told of it. What a rung holds depends on the rungs before it alone, which are read from their shards:
so a search that was interrupted goes on as if nothing had happened.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine.axes import DRAW, swept_names
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.loop import Run
from jaxrl_tab.engine.part import Computed, Part
from jaxrl_tab.engine.results import parameters
from jaxrl_tab.engine.sweep import result
from jaxrl_tab.experiment import disk, storage
from jaxrl_tab.experiment.growth import Block
from jaxrl_tab.experiment.plain import as_plain
from jaxrl_tab.experiment.samplers import Optuna, Told
from jaxrl_tab.experiment.search import Halving, Rung, Search
from jaxrl_tab.experiment.shards import Shard, arrays_of, split
from jaxrl_tab.experiment.shards import runs as numbers_of
from jaxrl_tab.experiment.spec import Experiment

FOLDER, PLAN, HISTORY, STUDIES = "search", "search.json", "history.json", "optuna.log"
AS_WRITTEN = "search.toml"
# The seeds of a search must have no part in what is said of the settings that it finds. Seeds of experiments have
# numbers below 2**31 (and fresh ones a root of their own, see `Part`), so these are seeds of no other runs.
FIRST_SEED = 2**31


class Tried(NamedTuple):
    """How good a setting was at the end of a rung.

    Attributes:
        method: the label of its method.
        trial: its number among the settings of the method.
        setting: the hyperparameters that were searched, as they are written in a file.
        round, rung: in which round it was proposed, and which rung this is, from 0.
        length: how many steps, or episodes, its runs had by then.
        seeds: on how many seeds it ran.
        by: by what settings were compared: "score", or "error" in prediction; or, of the second half of the runs, its
            "episodes", "steps" or "return": see `stats.early.promise`.
        score: the mean of that; None where no run has one.
        lost: how many of its runs diverged.
        goes_on: whether it went on to the next rung; in the last one, whether it is the one that was found.
    """

    method: str
    trial: int
    setting: dict[str, Any]
    round: int
    rung: int
    length: int
    seeds: int
    by: str
    score: float | None
    lost: int
    goes_on: bool


class Stage(NamedTuple):
    """What is computed of some settings in a rung, as work for an executor of this process: see `shards.Sharded`.

    Attributes:
        name: what progress calls it.
        part: the runs.
        first: the number of the first shard.
        identity: a number for what is computed, by which a shard is known that was computed of something else.
        memory: how many bytes may be taken, as in `Job`.
        begun: where the runs are, [runs, ...] each, which go on from there; None: at time 0.
    """

    name: str
    part: Part
    first: int
    identity: int
    memory: int | None
    begun: Run | None = None

    @property
    def parts(self) -> dict[str, Part]:
        return {self.name: self.part}

    @property
    def shards(self) -> dict[int, Shard]:
        """By their numbers."""
        blocks = [
            Block(self.name, i, members, 0, self.part.num_seeds, self.part)
            for i, members in enumerate(self.part.programs)
        ]
        return dict(enumerate((shard for block in blocks for shard in split(block)), self.first))

    def setting(self, shard: Shard) -> int:
        return self.identity

    def __call__(self, number: int) -> dict[str, np.ndarray]:
        """What the runs of a shard give, and what is raised: as `Job` has it."""
        own = numbers_of(self.part, self.shards[number])
        return arrays_of(self.part, own, self.memory, jax.tree.map(lambda x: x[own], self.begun))


Compute = Callable[[Stage], Computed]
"""Gives what all runs of a stage gave, of which the missing shards are computed."""


class Winner(NamedTuple):
    """What was found of a method: an instance of it, with the setting that was the best in the last rung."""

    label: str
    config: Any


class _Round(NamedTuple):
    """Settings of a method that are halved together.

    Attributes:
        label: of the method.
        number: of the round.
        part: all of the settings, each on all seeds.
        first: the number of the first of them among those of the method.
    """

    label: str
    number: int
    part: Part
    first: int


class _Place(NamedTuple):
    """Where a setting is among all of its method: how good, and its instance."""

    rank: tuple[int, float, int]
    tried: Tried
    config: Any


class _Judged(NamedTuple):
    """How good the settings of a rung are.

    Attributes:
        by, scores, lost: as `Tried` has them, of each.
        order: their numbers, from the best to the worst.
        merits: their means, so that higher is better; None where a run diverged.
    """

    by: str
    order: np.ndarray
    scores: list[float | None]
    merits: list[float | None]
    lost: list[int]


class Searching:
    """A search that is under way.

    Attributes:
        search: what is searched, and how.
        tried: what was tried so far, method by method.
        winners: what was found so far.
    """

    def __init__(self, search: Search, folder: Path | None, memory: int | None, compute: Compute):
        """Begins.

        Args:
            folder: in which Optuna keeps what it was told; None: nowhere.
            memory: as in `run`.
            compute: computes a stage.
        """
        self.search, self._memory, self._compute = search, memory, compute
        self._studies = folder and folder / STUDIES
        self.tried: list[Tried] = []
        self.winners: list[Winner] = []
        self._number = 0  # of the next shard
        self._ladder = search.ladder

    def run(self) -> None:
        """Goes on to the end."""
        if self._studies is not None:
            for leftover in (self._studies, self._studies.with_name(f"{STUDIES}.lock")):
                with disk.as_run_error(leftover, "removed"):
                    leftover.unlink(missing_ok=True)  # Optuna is told everything again
        for label in self.search.ranges:
            self._search(label)

    def _search(self, label: str) -> None:
        halving, best = self.search.halving, None
        optuna = None
        if halving.is_optuna:
            seed = self.search.experiment.seed
            optuna = Optuna(label, self.search.ranges[label], seed, self._studies)
        first = 0
        for number, count in enumerate(halving.of_rounds(self.search.settings(label))):
            if optuna is None:
                part = self.search.experiment.parts()[self.search.part_name(label)]
            else:
                part = self.search.part_of(label, optuna.ask(count))
            told, place = self._halve(_Round(label, number, part, first))
            if optuna is not None:
                optuna.tell(told)
            best = place if best is None else min(best, place, key=lambda x: x.rank)
            first += count
        assert best is not None
        self.tried = [one._replace(goes_on=True) if one is best.tried else one for one in self.tried]
        self.winners.append(Winner(label, best.config))

    def _halve(self, one: _Round) -> tuple[list[Told], _Place]:
        """Halves the settings of a round: how good each was, and the best that reached the last rung."""
        sizes = [*self.search.halving.sizes(len(one.part.configs)), 1]  # in the end one is left
        left = np.arange(sizes[0])
        runs: list[Computed] = []
        scores: list[dict[int, float | None]] = [{} for _ in left]
        k, before = 0, Rung(0, 0)
        while True:
            rung, last = self._ladder[k], k == len(self._ladder) - 1
            part = _subset(one.part, left)
            runs = self._run(one, part, before, rung, runs)
            judged = self._judge(part, rung, runs, last)
            best = np.sort(judged.order[: sizes[k + 1]])
            for i, place in enumerate(left):
                scores[place][rung.length * rung.seeds] = judged.merits[i]
                tried = Tried(
                    one.label,
                    one.first + int(place),
                    _plain(part, i),
                    one.number,
                    k,
                    rung.length,
                    rung.seeds,
                    judged.by,
                    judged.scores[i],
                    judged.lost[i],
                    goes_on=bool(i in best and not last),
                )
                self.tried.append(tried)
            if last:
                told = [Told(x, place in left) for place, x in enumerate(scores)]
                return told, self._place(part, judged, int(best[0]))
            left, runs, before, k = left[best], [runs[i] for i in best], rung, k + 1

    def _place(self, part: Part, judged: _Judged, i: int) -> _Place:
        """Where one of the settings is that were judged last."""
        tried, merit = self.tried[len(self.tried) - len(judged.order) + i], judged.merits[i]
        return _Place(
            (judged.lost[i], np.inf if merit is None else -merit, tried.trial), tried, part.configs[i]
        )

    def _judge(self, part: Part, rung: Rung, runs: Sequence[Computed], last: bool) -> _Judged:
        """How good settings are, by all of their runs until the end of a rung."""
        from jaxrl_tab.stats.early import by_length, promise  # here, for they take a second
        from jaxrl_tab.stats.measures import score
        from jaxrl_tab.stats.settings import Settings

        budget = _budget(part, rung.length)
        whole = dataclasses.replace(part, budget=budget, num_seeds=rung.seeds, first_seed=FIRST_SEED)
        q, log = jax.tree.map(lambda *x: np.concatenate(x), *[(one.q, one.log) for one in runs])
        ds = result(whole, Computed(q, log, runs[0].seconds)).to_xarray()
        in_the_end = last or not self._in_steps
        settings = Settings(ds, score if in_the_end else promise)
        by = "error" if settings.prediction else "score" if in_the_end else "return"
        if by == "return" and settings.once(by_length):
            by = "episodes" if "num_steps" in ds.attrs else "steps"
        finite = lambda x: [float(one) if np.isfinite(one) else None for one in x.mean("seed").values.ravel()]
        lost = settings.lost.values.ravel().tolist()
        merits = [None if n else merit for n, merit in zip(lost, finite(settings.merit), strict=True)]
        return _Judged(by, settings.order, finite(settings.score), merits, lost)

    def _run(
        self, one: _Round, part: Part, before: Rung, now: Rung, runs: Sequence[Computed]
    ) -> list[Computed]:
        """What the runs of each setting gave until the end of a rung, of which those before are there.

        The settings of each program are a stage of their own, for where a run is has another shape in each.
        """
        found: list[Computed] = [*runs] or [None] * len(part.configs)  # pyright: ignore[reportAssignmentType]
        for members in part.programs:
            begun = (
                jax.tree.map(lambda *x: np.concatenate(x), *[runs[i].begun for i in members])
                if runs
                else None
            )
            stage = self._stage(one, _subset(part, members), before, now, begun)
            computed = self._compute(stage)
            self._number += len(stage.shards)
            for k, i in enumerate(members):
                own = slice(k * stage.part.num_seeds, (k + 1) * stage.part.num_seeds)
                q, log, ends = jax.tree.map(
                    lambda x, own=own: x[own], (computed.q, computed.log, computed.ends)
                )
                more = Computed(q, log, computed.seconds, ends)
                found[i] = self._together(runs[i], more) if runs else more
        return found

    def _stage(self, one: _Round, part: Part, before: Rung, now: Rung, begun: Run | None) -> Stage:
        """What is still to be computed of some settings until the end of a rung."""
        what = [one.label, [_plain(part, i) for i in range(len(part.configs))], one.number, *before, *now]
        identity = int(hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:7], 16)
        if self._in_steps:
            budget, seeds = _budget(part, now.length - before.length), range(now.seeds)
        else:
            budget, seeds = _budget(part, now.length), range(before.seeds, now.seeds)
        part = dataclasses.replace(
            part,
            budget=budget,
            num_seeds=len(seeds),
            first_seed=FIRST_SEED + seeds.start,
            goes_on=self._in_steps,
        )
        count = len(part.configs)
        name = f"{self.search.part_name(one.label)}, {count} settings until {now.length:,} on {now.seeds:,} seeds"
        return Stage(name, part, self._number, identity, self._memory, begun if self._in_steps else None)

    @property
    def _in_steps(self) -> bool:
        return self.search.halving.grow == "steps"

    def _together(self, before: Computed, now: Computed) -> Computed:
        """What the runs of a setting gave until now: longer runs, or more seeds."""
        axis = 1 if self._in_steps else 0
        log = jax.tree.map(lambda x, y: np.concatenate([x, y], axis=axis), before.log, now.log)
        return now._replace(q=now.q if self._in_steps else np.concatenate([before.q, now.q]), log=log)


def _budget(part: Part, length: int) -> Budget:
    """So many steps, or episodes, in which nothing is recorded but what the score needs."""
    unit = "num_steps" if part.budget.num_steps is not None else "num_episodes"
    exact = of_method(part.algorithm).learns is Learns.STATES
    return dataclasses.replace(part.budget, **{unit: length}, exact=exact, exact_every=None, record=None)


def _subset(part: Part, places: np.ndarray) -> Part:
    """Some settings of a part, as draws."""
    names = swept_names(part.axes)
    configs = [part.configs[i] for i in places]
    draws = tuple({name: parameters(config)[name] for name in names} for config in configs)
    return dataclasses.replace(part, axes={DRAW: draws}, configs=configs)


def _plain(part: Part, i: int) -> dict[str, Any]:
    """What a setting of such a part has, as it is written in a file."""
    return {key: as_plain(key, x) for key, x in part.axes[DRAW][i].items()}


# --- the folder -----------------------------------------------------------------------------------------


def is_unfinished(path: Path) -> bool:
    """Whether a folder has a search, and not yet the experiment that it finds."""
    there = [(path / name).exists() for name in (storage.AS_WRITTEN, storage.RESOLVED)]
    return (path / FOLDER / PLAN).exists() and not any(there)


def begin(folder: Path, search: Search) -> None:
    """Writes how an experiment in a folder is searched."""
    halving = dataclasses.asdict(search.halving)
    _write(folder / PLAN, {"halving": halving, "ranges": {key: dict(x) for key, x in search.ranges.items()}})


def read(folder: Path, experiment: Experiment) -> Search:
    """How the experiment in a folder is searched. Raises InputError where that is damaged or missing."""
    data = _read(folder / PLAN)
    if data is None:
        raise InputError(f"{folder / PLAN} is damaged or missing: put it back, or begin a new search")
    return Search.of(experiment, Halving(**data["halving"]), data["ranges"])


def keep(folder: Path, tried: Sequence[Tried]) -> None:
    """Writes what was tried into the folder of a search."""
    _write(folder / HISTORY, [one._asdict() for one in tried])


def history(path: Path) -> tuple[Tried, ...]:
    """What was tried by the search that found the experiment in a folder; nothing where there was none."""
    file = path / FOLDER / HISTORY
    if not file.exists():
        return ()
    rows = _read(file)
    if rows is None:
        storage.warn(f"{FOLDER}/{HISTORY} is damaged: what the search tried is not shown")
        return ()
    return tuple(Tried(**row) for row in rows)


def _write(file: Path, data: Any) -> None:
    disk.write_json(file, {"data": data, "sha256": _checksum(data)})


def _read(file: Path) -> Any:
    """What `_write` wrote; None where it is damaged or missing."""
    data = disk.read_json(file)
    whole = isinstance(data, dict) and data.keys() == {"data", "sha256"}
    return data["data"] if whole and data["sha256"] == _checksum(data["data"]) else None


def _checksum(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
