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
from jaxrl_tab.engine.part import Computed, Part
from jaxrl_tab.engine.results import parameters
from jaxrl_tab.engine.sweep import result
from jaxrl_tab.experiment import storage
from jaxrl_tab.experiment.growth import Block
from jaxrl_tab.experiment.resolve import as_plain
from jaxrl_tab.experiment.samplers import Optuna, Told
from jaxrl_tab.experiment.search import Halving, Rung, Search
from jaxrl_tab.experiment.shards import Shard, arrays_of, split
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
    """

    name: str
    part: Part
    first: int
    identity: int
    memory: int | None

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
        return arrays_of(self.part, self.shards[number], self.memory)


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
                with storage.as_run_error(leftover, "removed"):
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
        from jaxrl_tab.stats.early import by_length, promise  # here, for they take a second
        from jaxrl_tab.stats.measures import score
        from jaxrl_tab.stats.settings import Settings

        sizes = self.search.halving.sizes(len(one.part.configs))
        left, so_far, before = np.arange(sizes[0]), None, Rung(0, 0)
        scores: list[dict[int, float | None]] = [{} for _ in left]
        best = left
        for k, rung in enumerate(self._ladder):
            last = k == len(self._ladder) - 1
            part = _subset(one.part, left)
            stage = self._stage(one, part, before, rung, so_far)
            now = self._compute(stage)
            self._number += len(stage.shards)
            so_far = now if so_far is None else self._together(so_far, now, len(left))
            budget = _budget(part, rung.length)
            whole = dataclasses.replace(part, budget=budget, num_seeds=rung.seeds, first_seed=FIRST_SEED)
            ds = result(whole, so_far).to_xarray()
            in_the_end = last or not self._in_steps
            settings = Settings(ds, score if in_the_end else promise)
            by = "error" if settings.prediction else "score" if in_the_end else "return"
            if by == "return" and settings.once(by_length):
                by = "episodes" if "num_steps" in ds.attrs else "steps"
            best = np.sort(settings.order[: 1 if last else sizes[k + 1]])
            means = settings.score.mean("seed").values.ravel()
            merits = settings.merit.mean("seed").values.ravel()
            lost = settings.lost.values.ravel()
            for i, place in enumerate(left):
                scores[place][rung.length * rung.seeds] = (
                    None if lost[i] or np.isnan(merits[i]) else float(merits[i])
                )
                self.tried.append(
                    Tried(
                        one.label,
                        one.first + int(place),
                        _plain(part, i),
                        one.number,
                        k,
                        *rung,
                        by,
                        float(means[i]) if np.isfinite(means[i]) else None,
                        int(lost[i]),
                        bool(not last and i in best),
                    )
                )
            if last:
                i = int(best[0])
                rank = int(lost[i]), float(-np.nan_to_num(merits[i], nan=-np.inf)), one.first + int(left[i])
                tried = self.tried[len(self.tried) - len(left) + i]
                told = [Told(x, place in left) for place, x in enumerate(scores)]
                return told, _Place(rank, tried, part.configs[i])
            left, before, so_far = left[best], rung, _of_settings(so_far, best, rung.seeds)
        raise AssertionError("there is a last rung")

    def _stage(self, one: _Round, part: Part, before: Rung, now: Rung, so_far: Computed | None) -> Stage:
        """What is still to be computed of some settings until the end of a rung."""
        what = [one.label, [_plain(part, i) for i in range(len(part.configs))], one.number, *before, *now]
        identity = int(hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:8], 16)
        if self._in_steps:
            part = dataclasses.replace(
                part,
                budget=_budget(part, now.length - before.length),
                first_seed=FIRST_SEED,
                goes_on=True,
                begun=so_far and so_far.ends,
            )
        else:
            seeds, first = now.seeds - before.seeds, FIRST_SEED + before.seeds
            part = dataclasses.replace(
                part, budget=_budget(part, now.length), num_seeds=seeds, first_seed=first
            )
        count = len(part.configs)
        name = f"{self.search.part_name(one.label)}, {count} settings until {now.length:,} on {now.seeds:,} seeds"
        return Stage(name, part, self._number, identity, self._memory)

    @property
    def _in_steps(self) -> bool:
        return self.search.halving.grow == "steps"

    def _together(self, before: Computed, now: Computed, settings: int) -> Computed:
        """What the runs gave until now: longer runs, or more seeds."""
        if self._in_steps:
            log = jax.tree.map(lambda x, y: np.concatenate([x, y], axis=1), before.log, now.log)
            return now._replace(log=log)
        by_setting = lambda x: x.reshape(settings, -1, *x.shape[1:])

        def more(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.concatenate([by_setting(x), by_setting(y)], axis=1).reshape(-1, *x.shape[1:])

        return now._replace(q=more(before.q, now.q), log=jax.tree.map(more, before.log, now.log))


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


def _of_settings(computed: Computed, places: np.ndarray, seeds: int) -> Computed:
    """The runs of some of the settings."""
    some = lambda x: x.reshape(-1, seeds, *x.shape[1:])[places].reshape(-1, *x.shape[1:])
    q, log, ends = jax.tree.map(some, (computed.q, computed.log, computed.ends))
    return Computed(q, log, computed.seconds, ends)


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
    storage.write_json(file, {"data": data, "sha256": _checksum(data)})


def _read(file: Path) -> Any:
    """What `_write` wrote; None where it is damaged or missing."""
    data = storage.read_json(file)
    whole = isinstance(data, dict) and data.keys() == {"data", "sha256"}
    return data["data"] if whole and data["sha256"] == _checksum(data["data"]) else None


def _checksum(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
