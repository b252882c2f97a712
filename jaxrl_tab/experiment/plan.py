"""What an experiment will take: runs, shards, memory."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax

from jaxrl_tab.core import memory
from jaxrl_tab.engine import room, speeds
from jaxrl_tab.engine.part import Part


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
