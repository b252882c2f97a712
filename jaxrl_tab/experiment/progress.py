"""How far an experiment is, and how long it will go on."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from jaxrl_tab.experiment.plan import PartPlan, Plan
from jaxrl_tab.experiment.shards import Job, Shard
from jaxrl_tab.experiment.storage import Store

Report = Callable[["Progress"], None]


class Progress(NamedTuple):
    """How far an experiment is.

    Attributes:
        label: what is under way: a part of the experiment, or what is written.
        done, total: runs.
        steps: steps taken since it began, or was resumed.
        seconds: the time since then.
        left: how many more seconds it will take, about; None where nothing can be said yet.
        diverged: runs in which a number became infinite or NaN, or grew beyond any possible return.
    """

    label: str
    done: int
    total: int
    steps: int
    seconds: float
    left: float | None
    diverged: int


class Meter:
    """Counts what is finished, and reports it."""

    def __init__(self, report: Report):
        self._report, self._begun = report, time.perf_counter()
        self._last = self._begun
        self._state = Progress("", 0, 0, 0, 0.0, None, 0)
        self._todo: dict[str, int] = {}  # runs of each part
        self._took: dict[str, tuple[int, float]] = {}  # how many of them are done, and in how many seconds
        self._missing: dict[int, Shard] = {}

    def begin(self, store: Store, job: Job, missing: Sequence[int], later: Mapping[str, int]) -> None:
        """Counts what is there already, what is missing, and runs of parts that come later."""
        self._missing = {number: job.shards[number] for number in missing}
        self._todo |= later
        self._todo |= {shard.part: 0 for shard in self._missing.values()}
        for shard in self._missing.values():
            self._todo[shard.part] += shard.runs
        there = [number for number in range(len(job.shards)) if number not in self._missing]
        self._state = self._state._replace(
            done=sum(job.shards[number].runs for number in there),
            total=sum(shard.runs for shard in job.shards) + sum(later.values()),
            diverged=sum(store.shards[number].diverged for number in there),
        )
        self._last = time.perf_counter()
        self.show()

    def finished(self, number: int, steps: int, diverged: int) -> None:
        shard, now = self._missing.pop(number), time.perf_counter()
        runs, seconds = self._took.get(shard.part, (0, 0.0))
        self._took[shard.part] = runs + shard.runs, seconds + now - self._last
        self._last = now
        self._state = self._state._replace(
            done=self._state.done + shard.runs,
            steps=self._state.steps + steps,
            diverged=self._state.diverged + diverged,
        )
        self.show()

    def show(self, label: str | None = None) -> None:
        """Reports; `label` says what is under way where it is not a shard."""
        if label is None:
            label = next((shard.part for shard in self._missing.values()), self._state.label)
        runs = {name: PartPlan(1, n, 1, n, 0, 0) for name, n in self._todo.items() if n}
        left = Plan(runs, "runs", "").seconds_left(self._took)
        self._state = self._state._replace(label=label, seconds=time.perf_counter() - self._begun, left=left)
        self._report(self._state)
