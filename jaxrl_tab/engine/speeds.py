"""How fast runs were on this machine, kept beside the programs, so that a plan can say how long it will take.

A speed is that of a method in an environment: the seconds that a block of 64 runs took for a step, or an episode, with
all cores at work, and those of making the program ready. What was never run here gets the mean of all that was.
"""

import json
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from jaxrl_tab.engine import programs
from jaxrl_tab.engine.part import Part
from jaxrl_tab.engine.room import LANES

NAME = "speeds"
SHORTEST = 0.01  # seconds
AT_MOST = 500  # speeds; of more, those that were measured longest ago are forgotten


class Speed(NamedTuple):
    """How fast something was.

    Attributes:
        running: seconds of a block of runs for each step or episode of their budget.
        compiling: seconds for each program.
    """

    running: float
    compiling: float


class Forecast(NamedTuple):
    """How long a part will take, about.

    Attributes:
        seconds: that it is computed.
        is_measured: whether this method was run in this environment here before; else it is the mean of what was.
    """

    seconds: float
    is_measured: bool


def forecast(part: Part, known: Mapping[str, Speed]) -> Forecast | None:
    """How long a part will take, by what is `known`; None where nothing is that is counted in its unit."""
    speed, unit = known.get(_name(part)), f"{_unit(part)} of "
    if speed is None and (others := [x for name, x in known.items() if name.startswith(unit)]):
        # The mean of logarithms: speeds differ by factors.
        mean = lambda values: math.exp(sum(map(math.log, values)) / len(values))
        speed = Speed(mean([x.running for x in others]), mean([max(x.compiling, 1e-3) for x in others]))
    if speed is None:
        return None
    seconds = _work(part, part.runs) * speed.running + len(part.programs) * speed.compiling
    return Forecast(seconds, _name(part) in known)


class Clock:
    """Measures speeds while shards are finished."""

    def __init__(self) -> None:
        self._took: dict[
            str, list[float]
        ] = {}  # by name: work, seconds of running and of compiling, programs compiled

    def finished(self, part: Part, runs: int, running: float, compiling: float) -> None:
        """So many runs of a program of a part took so many seconds, and the program others to be ready."""
        took = self._took.setdefault(_name(part), [0.0] * 4)
        for i, x in enumerate((_work(part, runs), running, compiling, float(compiling > 0))):
            took[i] += x

    def keep(self) -> None:
        """Keeps what was measured. What was over at once tells nothing."""
        new = {
            name: Speed(running / work, compiling / max(compiled, 1))
            for name, (work, running, compiling, compiled) in self._took.items()
            if running >= SHORTEST
        }
        if new:
            known = {name: speed for name, speed in read().items() if name not in new} | new
            programs.note(NAME, _packed(dict(list(known.items())[-AT_MOST:])))


def read() -> dict[str, Speed]:
    """The speeds that are known on this machine; none where nothing is kept."""
    return programs.noted(NAME, _unpacked) or {}


def _unit(part: Part) -> str:
    return "steps" if part.budget.num_steps else "episodes"


def _work(part: Part, runs: int) -> float:
    return -(-runs // LANES) * (part.budget.num_steps or part.budget.num_episodes or 1)


def _name(part: Part) -> str:
    """What has one speed: a method in an environment of so many states; what is measured costs, too."""
    env, budget = part.env, part.budget
    measures = f", exact every {budget.row}" if budget.exact else ", recorded" if budget.record else ""
    where = f"{type(env).__qualname__}, {env.num_states} states{measures}"
    return f"{_unit(part)} of {part.algorithm.__qualname__} in {where}"


def _packed(known: Mapping[str, Speed]) -> bytes:
    return json.dumps(known).encode()


def _unpacked(data: bytes) -> dict[str, Speed]:
    """Raises ValueError where there are no speeds."""
    read: Any = json.loads(data)
    known = {str(name): Speed(*map(float, speed)) for name, speed in read.items()}
    if not all(math.isfinite(x.running) and x.running > 0 and x.compiling >= 0 for x in known.values()):
        raise ValueError("it holds what is no speed")
    return known
