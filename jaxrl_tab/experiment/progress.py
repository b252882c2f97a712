"""How far an experiment is, and how long it will go on."""

import contextlib
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

from jaxrl_tab.engine import speeds
from jaxrl_tab.experiment.shards import Shard, Sharded
from jaxrl_tab.experiment.storage import Store
from jaxrl_tab.show.progress import Progress, Report, reporting

SURE = 1.0  # seconds of computing that count as much as the forecast


def seconds_left(
    runs: Mapping[str, int],
    took: Mapping[str, tuple[int, float]],
    expected: Mapping[str, float] | None = None,
) -> float | None:
    """How much longer an experiment will take, judged by what is finished; None where nothing can be said yet.

    A part goes on as fast as it went. One that has not begun takes what is expected, corrected as what is finished
    was off; or else it is as fast as the others on average, per run.

    Args:
        runs: for each part, how many runs are to be done in all.
        took: for each part that has begun, how many of them are finished, and in how many seconds.
        expected: the seconds of a run of some parts, from a forecast.
    """
    finished = {part: (n, seconds) for part, (n, seconds) in took.items() if n}
    expected = dict(expected or {})
    foreseen = {part: n * expected[part] for part, (n, _) in finished.items() if part in expected}
    # What was over at once tells little.
    off = (SURE + sum(finished[part][1] for part in foreseen)) / (SURE + sum(foreseen.values()))
    pace = {part: off * seconds for part, seconds in expected.items()}
    pace |= {part: seconds / n for part, (n, seconds) in finished.items()}
    if finished:
        all_runs, all_seconds = map(sum, zip(*finished.values(), strict=True))
        pace = dict.fromkeys(runs, all_seconds / all_runs) | pace
    if not pace.keys() >= {part for part, total in runs.items() if total}:
        return None
    return sum(
        (total - finished.get(part, (0, 0.0))[0]) * pace.get(part, 0.0) for part, total in runs.items()
    )


class Meter:
    """Counts what is finished, and reports it."""

    def __init__(self):
        self._report: Report = lambda state: None
        self._last = self._begun = time.perf_counter()
        self._state = Progress("planning")
        self._todo: dict[str, int] = {}  # runs of each part
        self._expected: dict[str, float] = {}  # seconds of a run of each part
        self._took: dict[str, tuple[int, float]] = {}  # how many of them are done, and in how many seconds
        self._missing: OrderedDict[int, Shard] = (
            OrderedDict()
        )  # whose first is found at once after many have gone

    @contextlib.contextmanager
    def reporting(self, progress: Report | Literal[False] | None) -> Iterator[None]:
        """Within the block what it counts is reported, as `progress` says: see `show.progress.reporting`."""
        with reporting(progress) as self._report:
            yield

    def begin(
        self,
        store: Store,
        job: Sharded,
        missing: Sequence[int],
        later: Mapping[str, int],
        known: speeds.Known,
    ) -> None:
        """Counts what is there already, what is missing, and runs of parts that come later.

        What is `known` of their speeds says how long the parts will take that have not begun.
        """
        for name, part in job.parts.items():
            if time_of_all := speeds.forecast(part, known):
                self._expected[name] = time_of_all.seconds / part.runs
        all_shards = job.shards
        self._missing = OrderedDict((number, all_shards[number]) for number in missing)
        self._todo |= later
        self._todo |= {shard.part: 0 for shard in self._missing.values()}
        for shard in self._missing.values():
            self._todo[shard.part] += shard.runs
        finished = [number for number in all_shards if number not in self._missing]
        self._state = self._state._replace(
            done=sum(all_shards[number].runs for number in finished),
            total=sum(shard.runs for shard in all_shards.values()) + sum(later.values()),
            diverged=sum(store.shards[number].diverged for number in finished),
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

    def underway(self, runs: int, steps: int) -> None:
        """Reports what is finished of the shard that this process computes, the first that is missing."""
        shard, now = next(iter(self._missing.values())), time.perf_counter()
        before, seconds = self._took.get(shard.part, (0, 0.0))
        took = self._took | {shard.part: (before + runs, seconds + now - self._last)}
        self._report(
            self._state._replace(
                done=self._state.done + runs,
                steps=self._state.steps + steps,
                seconds=now - self._begun,
                left=seconds_left(self._todo, took, self._expected),
            )
        )

    def show(self, label: str | None = None) -> None:
        """Reports; `label` says what is under way where it is not a shard."""
        if label is None:
            label = next((shard.part for shard in self._missing.values()), self._state.label)
        left = seconds_left(self._todo, self._took, self._expected)
        self._state = self._state._replace(label=label, seconds=time.perf_counter() - self._begun, left=left)
        self._report(self._state)
