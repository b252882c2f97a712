"""What an experiment will take: runs, shards, memory."""

import heapq
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax

from jaxrl_tab.core import memory
from jaxrl_tab.engine import room, speeds
from jaxrl_tab.engine.part import Part
from jaxrl_tab.experiment.shards import Job


class PartPlan(NamedTuple):
    """What a part will take.

    Attributes:
        programs: how many programs are compiled for it: what shapes the program, such as the n of n-step
            methods, makes one of its own.
        runs: how many runs there are, of all programs.
        blocks: in how many blocks they go.
        work: how many steps, or episodes, they are in all.
        results: the bytes of what they give.
        working: the bytes that are needed beside, at most, while they are computed.
        seconds: how long computing it will take, about; None where nobody knows, as on a GPU that is new.
        is_measured: whether just this was run here before, so that one may rely on the seconds.
    """

    programs: int
    runs: int
    blocks: int
    work: int
    results: int
    working: int
    seconds: float | None = None
    is_measured: bool = True


class Plan(NamedTuple):
    """What an experiment will take: what is known before anything is compiled.

    Attributes:
        parts: what each of its parts will take, by their labels.
        unit: "steps" or "episodes": what their work is counted in.
        devices: on what it is computed, in words.
    """

    parts: dict[str, PartPlan]
    unit: str
    devices: str

    def text(self) -> str:
        """The plan for people: a line for each part, and the sums."""
        parts = list(self.parts.values())
        times = [x.seconds for x in parts if x.seconds is not None]
        total = PartPlan(
            programs=sum(x.programs for x in parts),
            runs=sum(x.runs for x in parts),
            blocks=sum(x.blocks for x in parts),
            work=sum(x.work for x in parts),
            results=sum(x.results for x in parts),
            working=max(x.working for x in parts),
            seconds=sum(times) if len(times) == len(parts) else None,
            is_measured=all(x.is_measured for x in parts),
        )
        rows = [["", "programs", "runs", "blocks", self.unit, "results", "working memory", "time"]]
        for name, x in [*self.parts.items(), *([("all together", total)] if len(parts) > 1 else [])]:
            counts = [f"{n:,}" for n in x[:4]]
            about = "about " if not x.is_measured else ""
            time = "unknown" if x.seconds is None else about + _duration(x.seconds)
            rows.append([name, *counts, memory.words(x.results), memory.words(x.working), time])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
            for row in rows
        ]
        notes = [f"on {self.devices}"]
        if times:
            notes[0] += (
                "; the time is that of computing: tables, pictures and the report take some seconds more"
            )
        if total.seconds is not None and not total.is_measured:
            notes.append(
                "about: it was hardly run here yet, and is judged by what is usual and by what else was run here: "
                "it may take twice as long, or half"
            )
        return "\n".join([*lines, *notes])


def plan(parts: Mapping[str, Part], limit: int | None = None, devices: Sequence[Any] | None = None) -> Plan:
    """What these parts of an experiment will take; nothing is compiled.

    Args:
        parts: as `Experiment.parts` gives them.
        limit: how many bytes may be taken; by default half of what is free.
        devices: the JAX devices to use; all by default.
    """
    devices = tuple(devices or jax.devices())
    kind = "core" if devices[0].platform == "cpu" else devices[0].device_kind
    plans, known = {}, speeds.read()
    for name, part in parts.items():
        forecasts = [
            room.forecast(needs, len(members) * part.num_seeds, limit, devices)
            for needs, members in zip(part.needs, part.programs, strict=True)
        ]
        plans[name] = PartPlan(
            programs=len(forecasts),
            runs=part.runs,
            blocks=sum(x.blocks for x in forecasts),
            work=part.runs * (part.budget.num_steps or part.budget.num_episodes or 0),
            results=sum(x.results for x in forecasts),
            working=max(x.working for x in forecasts),
        )
        if time := speeds.forecast(part, known):
            plans[name] = plans[name]._replace(seconds=time.seconds, is_measured=time.is_measured)
    unit = "steps" if next(iter(parts.values())).budget.num_steps else "episodes"
    return Plan(plans, unit, f"{len(devices)} {kind}{'s' if len(devices) > 1 else ''}")


STARTING = 4.0  # seconds until a worker has imported all
# The process that hands out shards fetches, checks and writes them, about so fast (docs/scaling.md).
HANDING, WRITING = 2e-3, 3e8  # seconds of each, and bytes in a second


class OnWorkers(NamedTuple):
    """How long shards take that are handed out to workers, to each the next one as soon as it has none.

    Attributes:
        workers: how many there are.
        cores: of each.
        shards: how many there are.
        seconds: until all are done, about; None where nobody knows.
        computing: of these seconds, those that a worker computes, on average; else it starts, compiles or waits.
        writing: the seconds in which the results are fetched and written, one after another, in the meantime.
        busy: how many workers have something to do at all.
    """

    workers: int
    cores: int
    shards: int
    seconds: float | None
    computing: float
    writing: float
    busy: int

    def text(self) -> str:
        """For people: a line, and one where there are more workers than work, or more work than one can write."""
        head = f"{_count(self.shards, 'shard')} on {_count(self.workers, 'worker')} of {_count(self.cores, 'core')}"
        if self.seconds is None:
            return f"{head}: nobody knows how long such a worker takes"
        share = f"{100 * self.computing / self.seconds:.0f} % of it is computing"
        lines = [f"{head}: about {_duration(self.seconds)}; {share}"]
        if self.busy < self.workers:
            lines.append(f"there are shards for {_count(self.busy, 'worker')} only: more have nothing to do")
        elif self.writing >= self.seconds:
            lines.append(
                f"the workers wait for the process that writes: {_duration(self.writing)} for all shards"
            )
        return "\n".join(lines)


def on_workers(job: Job, workers: int, cores: int) -> OnWorkers:
    """How long all shards of an experiment take on workers that are as fast as this machine; nothing is computed."""
    known, parts = speeds.read(), job.parts
    paces = {name: speeds.pace(part, known) for name, part in parts.items()}
    if any(pace is None for pace in paces.values()):
        return OnWorkers(workers, cores, len(job.shards), None, 0.0, 0.0, min(workers, len(job.shards)))
    free = [(STARTING, i) for i in range(workers)]  # when each worker has nothing to do
    made, computing, writing, end = set(), 0.0, 0.0, 0.0
    for shard in job.shards.values():
        begin, worker = heapq.heappop(free)
        pace, program = paces[shard.part], (shard.part, shard.program)
        assert pace
        running = pace.running(shard.runs, cores)
        ready = pace.ready(was_made=False) if (worker, program) not in made else 0.0
        made.add((worker, program))
        heapq.heappush(free, (begin + ready + running, worker))
        computing, end = computing + running, max(end, begin + ready + running)
        writing += (
            HANDING + memory.size(parts[shard.part].needs[shard.program].results) * shard.runs / WRITING
        )
    busy = len({worker for worker, _ in made})
    return OnWorkers(workers, cores, len(job.shards), max(end, writing), computing / busy, writing, busy)


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _duration(seconds: float) -> str:
    """As people say it: in one unit, and not more exact than it can be known."""
    if seconds < 0.095:
        return "under 0.1 s"
    unit = "s"
    for size, larger in ((60, "min"), (60, "h"), (24, "days")):
        if seconds < 1.5 * size:
            break
        seconds, unit = seconds / size, larger
    return f"{float(f'{seconds:.2g}'):g} {unit}"
