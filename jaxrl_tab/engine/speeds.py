"""How fast runs were on this machine, kept beside the programs, so that a plan can say how long it will take.

A speed is that of a method in an environment: the seconds that a block of 64 runs took for a step, or an episode, with
all cores at work, and those of making the program ready: the first time, and when it was kept from an earlier process.
What was never run here gets the mean of all that was.
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
AT_MOST = 500  # speeds, and ten times as many programs; of more, those of longest ago are forgotten
OF_COMPILING = 0.2  # about so much of it a program takes that is kept, where just one of the two was measured


class Speed(NamedTuple):
    """How fast something was.

    Attributes:
        running: seconds of a block of runs for each step or episode of their budget.
        compiling: seconds for each program that is made.
        starting: seconds for each program that was made before.
    """

    running: float
    compiling: float
    starting: float


class Known(NamedTuple):
    """What was measured on this machine.

    Attributes:
        speeds: by the name of a method in an environment.
        programs: the names of those that were made, `Needs.program`.
    """

    speeds: Mapping[str, Speed] = {}
    programs: tuple[str, ...] = ()


class Forecast(NamedTuple):
    """How long a part will take, about.

    Attributes:
        seconds: that it is computed.
        is_measured: whether this method was run in this environment here before; else it is the mean of what was.
    """

    seconds: float
    is_measured: bool


def forecast(part: Part, known: Known) -> Forecast | None:
    """How long a part will take, by what is `known`; None where nothing is that is counted in its unit."""
    speed, unit = known.speeds.get(_name(part)), f"{_unit(part)} of "
    if speed is None and (others := [x for name, x in known.speeds.items() if name.startswith(unit)]):
        # The mean of logarithms: speeds differ by factors.
        speed = Speed(*(math.exp(sum(map(math.log, x)) / len(x)) for x in zip(*others, strict=True)))
    if speed is None:
        return None
    before = sum(needs.program in known.programs for needs in part.needs)
    ready = before * speed.starting + (len(part.needs) - before) * speed.compiling
    return Forecast(_work(part, part.runs) * speed.running + ready, _name(part) in known.speeds)


class _Took(NamedTuple):
    """What some runs took: their work, the seconds, and of programs (made, or made before) how many and the seconds."""

    work: float = 0
    running: float = 0
    made: int = 0
    compiling: float = 0
    before: int = 0
    starting: float = 0

    def speed(self, last: Speed | None) -> Speed:
        compiling = self.compiling / self.made if self.made else last and last.compiling
        starting = self.starting / self.before if self.before else last and last.starting
        if compiling is None:
            compiling = (starting or 0) / OF_COMPILING
        starting = OF_COMPILING * compiling if starting is None else starting
        return Speed(self.running / self.work, max(compiling, 1e-3), max(starting, 1e-3))


class Clock:
    """Measures speeds while shards are finished.

    Attributes:
        known: what was measured before.
    """

    def __init__(self) -> None:
        self.known, self._took, self._made = read(), {}, {}

    def finished(self, part: Part, program: int, runs: int, running: float, compiling: float) -> None:
        """So many runs of a program of a part took so many seconds, and the program others to be ready."""
        took = self._took.get(_name(part), _Took())
        took = took._replace(work=took.work + _work(part, runs), running=took.running + running)
        name = part.needs[program].program
        if compiling and name in self.known.programs:
            took = took._replace(before=took.before + 1, starting=took.starting + compiling)
        elif compiling:
            took = took._replace(made=took.made + 1, compiling=took.compiling + compiling)
        self._took[_name(part)] = took
        self._made[name] = None

    def keep(self) -> None:
        """Keeps what was measured. What was over at once tells nothing."""
        old = self.known.speeds
        new = {
            name: took.speed(old.get(name)) for name, took in self._took.items() if took.running >= SHORTEST
        }
        # What was measured now comes last.
        speeds = [*((name, x) for name, x in old.items() if name not in new), *new.items()]
        made = (*(x for x in self.known.programs if x not in self._made), *self._made)
        known = Known(dict(speeds[-AT_MOST:]), made[-10 * AT_MOST :])
        if known != self.known:
            programs.note(NAME, _packed(known))


def read() -> Known:
    """What is known on this machine; nothing where nothing is kept."""
    return programs.noted(NAME, _unpacked) or Known()


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


def _packed(known: Known) -> bytes:
    return json.dumps(known._asdict()).encode()


def _unpacked(data: bytes) -> Known:
    """Raises ValueError where there are no speeds."""
    read: Any = json.loads(data)
    try:
        speeds = {str(name): Speed(*map(float, speed)) for name, speed in read["speeds"].items()}
        known = Known(speeds, tuple(map(str, read["programs"])))
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError("it holds no speeds") from error
    if not all(math.isfinite(x) and x > 0 for speed in known.speeds.values() for x in speed):
        raise ValueError("it holds what is no speed")
    return known
