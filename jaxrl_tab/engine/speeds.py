"""How fast runs were on this machine, kept beside the programs, so that a plan can say how long it will take.

A speed is that of a method in an environment, as a multiple of what is usual (see `typical`): that of running, with
all cores at work, and that of making a program ready, the first time, and when it was kept from an earlier process.
What was run here for a short time alone, or never, is judged by what else was run here, the more by what is like it and
took long; and where nothing was, by what is usual.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax

from jaxrl_tab.engine import backend, programs
from jaxrl_tab.engine.by_lanes import threads
from jaxrl_tab.engine.part import Part
from jaxrl_tab.engine.typical import Typical, typical

NAME = "speeds"
SHORTEST = 0.01  # seconds
AT_MOST = 500  # speeds, and ten times as many programs; of more, those of longest ago are forgotten
TOGETHER = 16  # runs, that take as long as one
SURE = 0.2  # seconds of measuring that count as much as all that is known of others
LONGEST = 5.0  # seconds of measuring: more of them count as much
ALIKE = 4  # times as much counts the same method, or the same environment


class Speed(NamedTuple):
    """How long something took, as a multiple of what is usual.

    Attributes:
        running: a run.
        compiling: a program that was made.
        starting: a program that had been made before.
        seconds: for how long it was measured.
    """

    running: float
    compiling: float
    starting: float
    seconds: float


USUAL = Speed(1.0, 1.0, 1.0, SURE)


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
        is_measured: whether this method was run in this environment here before, for long enough.
    """

    seconds: float
    is_measured: bool


def forecast(part: Part, known: Known) -> Forecast | None:
    """How long a part will take, by what is `known`; None where nothing is, and it is not computed on CPUs."""
    if (found := pace(part, known)) is None:
        return None
    return Forecast(
        sum(found.running(len(members) * part.num_seeds, threads()) for members in part.programs)
        + sum(found.ready(needs.program in known.programs) for needs in part.needs),
        found.is_measured,
    )


class Pace(NamedTuple):
    """How fast the runs of a part are: what is usual, and how many times as long they take here.

    Attributes:
        is_measured: as in `Forecast`.
    """

    usual: Typical
    speed: Speed
    is_measured: bool

    def running(self, runs: int, cores: int) -> float:
        """Seconds that so many runs of one program take on so many cores: one after another, or some together."""
        return -(-runs // (TOGETHER * cores)) * TOGETHER * self.usual.running * self.speed.running

    def ready(self, was_made: bool) -> float:
        """Seconds until a program can run that was made before, or was not."""
        if was_made:
            return self.speed.starting * self.usual.starting
        return self.speed.compiling * self.usual.compiling


def pace(part: Part, known: Known) -> Pace | None:
    """How fast the runs of a part are; None as in `forecast`."""
    name = _name(part)
    weighted = [(_alike(name, other) * _weight(x), x) for other, x in known.speeds.items() if other != name]
    if jax.default_backend() == "cpu":
        weighted.append((SURE, USUAL))
    own = known.speeds.get(name)
    if own is not None:  # the others count as much as a short measurement
        weighted = [(_weight(own), own), *([(SURE, _mean(weighted))] if weighted else [])]
    if not weighted:
        return None
    return Pace(typical(part), _mean(weighted), own is not None and own.seconds >= SURE)


def _weight(speed: Speed) -> float:
    return min(speed.seconds, LONGEST)


def _alike(name: str, other: str) -> int:
    """How much another speed counts: more, where it is that of the same method or in the same environment."""
    return ALIKE ** sum(a == b for a, b in zip(name.split(" in "), other.split(" in "), strict=False))


def _mean(weighted: Sequence[tuple[float, Speed]]) -> Speed:
    """The mean of logarithms: speeds differ by factors."""
    total = sum(weight for weight, _ in weighted)
    mean = lambda of: math.exp(sum(weight * math.log(of(x)) for weight, x in weighted) / total)
    return Speed(
        mean(lambda x: x.running), mean(lambda x: x.compiling), mean(lambda x: x.starting), seconds=total
    )


class _Took(NamedTuple):
    """What some runs took: seconds, and those that are usual; of running, and of programs made and made before."""

    running: tuple[float, float] = (0.0, 0.0)
    compiling: tuple[float, float] = (0.0, 0.0)
    starting: tuple[float, float] = (0.0, 0.0)

    def and_of(self, what: str, seconds: float, usual: float) -> "_Took":
        before = getattr(self, what)
        return self._replace(**{what: (before[0] + seconds, before[1] + usual)})

    def speed(self, last: Speed | None) -> Speed:
        ratio = lambda x: max(x[0] / x[1], 1e-3) if x[1] else None
        last = last or USUAL  # for what was not measured now
        running, compiling, starting = (ratio(x) or y for x, y in zip(self, last[:3], strict=True))
        return Speed(running, compiling, starting, self.running[0])


class Clock:
    """Measures speeds while shards are finished.

    Attributes:
        known: what was measured before.
    """

    def __init__(self) -> None:
        self.known, self._took, self._made = read(), {}, {}

    def finished(self, part: Part, program: int, runs: int, running: float, compiling: float) -> None:
        """So many runs of a program of a part took so many seconds, and the program others to be ready."""
        usual = typical(part)
        took = self._took.get(_name(part), _Took())
        took = took.and_of("running", running, Pace(usual, USUAL, True).running(runs, threads()))
        name = part.needs[program].program
        if compiling and name in self.known.programs:
            took = took.and_of("starting", compiling, usual.starting)
        elif compiling:
            took = took.and_of("compiling", compiling, usual.compiling)
        self._took[_name(part)] = took
        self._made[name] = None

    def keep(self) -> None:
        """Keeps what was measured. What was over at once tells nothing."""
        old = self.known.speeds
        new = {
            name: took.speed(old.get(name))
            for name, took in self._took.items()
            if took.running[0] >= SHORTEST
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


def _name(part: Part) -> str:
    """What has one speed: a method in an environment of so many states; what is measured costs, too."""
    env, budget = part.env, part.budget
    unit = "steps" if budget.num_steps else "episodes"
    measures = ", exact values" if budget.exact else ", recorded" if budget.record else ""
    method = f"{part.algorithm.__qualname__} by {unit}{measures} by {backend.chosen()}"
    return f"{method} in {type(env).__qualname__}, {env.num_states} states"


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
