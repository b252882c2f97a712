"""The rows of the benchmark: who does what, and what was promised of it."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from benchmarks.command import SHORT
from benchmarks.rounds import Party, Target, Task, fresh

OURS, BY_XLA = "jaxrl_tab", "jaxrl_tab by XLA"
LANE_BY_LANE, ABREAST, ALONE = "Numba, lane by lane", "Numba, 4 lanes abreast", "Numba, one run"
IMPORTS = "imports of JAX, pyplot, xarray, scipy.stats"
METHODS = ("q-learning", "sarsa")
BACKENDS = ("lanes", "xla")


class Size(NamedTuple):
    """How much is run in a round.

    Attributes:
        lanes, steps: of the methods that take one step after another; lanes a multiple of 4.
        slow_lanes: of what takes longer a step.
        lone_steps: of one run alone.
        games: of Blackjack, in each of the slow lanes.
        drives: episodes of the mountain car, in each of 256 lanes.
    """

    lanes: int
    steps: int
    slow_lanes: int
    lone_steps: int
    games: int
    drives: int


FULL = Size(lanes=4096, steps=8000, slow_lanes=1024, lone_steps=100_000, games=5000, drives=500)
QUICK = Size(lanes=256, steps=8000, slow_lanes=128, lone_steps=100_000, games=5000, drives=50)


class Peer(NamedTuple):
    """Somebody beside whom we are measured.

    Attributes:
        name: as the table shows it.
        call: as `_party` takes it.
        least, aim: what was promised of our speed beside it, as in `Target`.
    """

    name: str
    call: str
    least: float | None = None
    aim: float | None = None


def windy(size: Size, cores: int) -> list[Task]:
    """Q-learning and Sarsa on the windy gridworld, on as many cores as there are."""
    others = (
        Peer(ABREAST, "numba_windy:four_abreast", least=1.0, aim=1.3),
        Peer("naive JAX", "naive_jax:many_lanes", least=25, aim=45),
    )
    return [
        _windy("q-learning", size, cores, (1.8, 2.5), *others),
        _windy("sarsa", size, cores, (1.3, 2.0), *others),
    ]


def windy_on_one_core(size: Size, cores: int) -> list[Task]:
    """The same on one core of several, for which nothing was promised."""
    if cores == 1:
        return []
    unpromised = lambda task: tuple(Target(target.party, target.against) for target in task.targets)
    return [task._replace(targets=unpromised(task)) for task in windy(size, cores=1)]


def more_windy(size: Size, cores: int) -> list[Task]:
    """Other methods on the windy gridworld; the last one beside our own other backend, too."""
    abreast, by_xla = Peer(ABREAST, "numba_windy:four_abreast"), Peer(BY_XLA, "xla:windy", least=2.5)
    return [
        _windy("expected-sarsa", size, cores, (1.2, 1.8), abreast),
        _windy("double-q-learning", size, cores, (1.2, 1.8), abreast),
        _windy("n-step-sarsa", size, cores, (0.8, 1.2), abreast, by_xla),
    ]


def one_run(size: Size, cores: int) -> list[Task]:
    """One run alone, which cannot use more than one core."""
    peers = (
        Peer("naive JAX", "naive_jax:one_run", least=100),
        Peer(ALONE, "numba_windy:one_run", least=0.7, aim=1.0),
    )
    work = {"steps": size.lone_steps}
    return [
        _beside(f"{method}, one run alone", cores, "ours:one_run", {"method": method, **work}, *peers)
        for method in METHODS
    ]


def sarsa_lambda(size: Size, cores: int) -> list[Task]:
    peers = (
        Peer("Numba, every pair", "numba_sarsa_lambda:every_pair", least=1.5, aim=2.2),
        Peer("Numba, pairs when read", "numba_sarsa_lambda:when_read"),
    )
    work = {"lanes": size.slow_lanes, "steps": size.steps}
    return [_beside("sarsa-lambda, windy gridworld", cores, "ours:sarsa_lambda", work, *peers)]


def garnet(size: Size, cores: int) -> list[Task]:
    peers = (
        Peer(LANE_BY_LANE, "numba_garnet:lane_by_lane", least=1.5, aim=2.0),
        Peer(ABREAST, "numba_garnet:four_abreast"),
    )
    work = {"lanes": size.lanes, "steps": size.steps}
    return [_beside("q-learning, MDP of 1000 states", cores, "ours:garnet", work, *peers)]


def blackjack(size: Size, cores: int) -> list[Task]:
    peer = Peer(LANE_BY_LANE, "numba_blackjack:lane_by_lane", least=1.0, aim=1.3)
    work = {"lanes": size.slow_lanes, "episodes": size.games}
    task = _beside("monte-carlo, blackjack", cores, "ours:blackjack", work, peer)
    return [task._replace(unit="episodes", outcome="mean return in the last tenth")]


def mountain_car(size: Size, cores: int) -> list[Task]:
    """Semi-gradient Sarsa with tile coding: 256 runs, as in figure 10.2."""
    peers = (
        Peer(LANE_BY_LANE, "numba_mountain_car:lane_by_lane", least=1.0),
        Peer("naive JAX", "naive_jax_mountain_car:many_runs", least=20),
    )
    work = {"lanes": 256, "episodes": size.drives}
    task = _beside("semi-gradient Sarsa, mountain car", cores, "ours:mountain_car", work, *peers)
    return [task._replace(unit="episodes", outcome="mean steps of an episode")]


def devices(size: Size, cores: int) -> list[Task]:
    """Two devices against one, in the same process."""
    if cores < 2:
        return []
    work = {"method": "q-learning", "lanes": size.lanes, "steps": size.steps}
    parties = {
        name: _party(name, "ours:on_devices", {**work, "devices": count})
        for count, name in enumerate(("one device", "two devices"), start=1)
    }
    return [_task("q-learning, devices", 2, work, parties, Target(*reversed(parties), least=1.9, aim=1.97))]


def methods(size: Size, cores: int) -> list[Task]:
    """Every registered method beside our own Q-learning, so that a slow one is seen."""
    basis = "q-learning"
    others = [name for name in fresh("benchmarks.ours:method_names", cores=1) if name != basis]
    work = {"lanes": size.slow_lanes, "steps": size.steps}
    parties = {name: _party(name, "ours:any_method", {"method": name, **work}) for name in (basis, *others)}
    task = _task("every method", cores, work, parties, *(Target(name, basis) for name in others))
    return [task._replace(outcome=None)]


def compiling(size: Size, cores: int) -> list[Task]:
    """Compiling a method by either backend with an empty cache, and starting again with what that has kept."""

    def by_either(name: str, call: str, *targets: Target) -> Task:
        parties = {backend: _party(backend, call, {"backend": backend}) for backend in BACKENDS}
        return _task(name, cores, {}, parties, *targets)._replace(unit="programs", outcome=None)

    first = Target("lanes", "xla", least=1 / 4, aim=1 / 8, times=True)
    again = Target("lanes", None, least=0.03, aim=0.01, times=True)
    return [
        by_either("compiling, CPU time", "compiling:first", first),
        by_either("a second start", "compiling:again", again, Target("lanes", "xla", times=True)),
    ]


def command(size: Size, cores: int) -> list[Task]:
    """The README's command and shorter ones, each in a fresh process, beside what cannot be spared: imports."""
    starts = {
        "first start": ("first_start", 3.0, 2.0),
        "second start": ("second_start", 1.5, 1.0),
        "the table is shown": ("table_shown", 0.7, 0.5),
    }
    at_once = {name: (0.5, None) if "--dry-run" in words else (0.15, None) for name, words in SHORT.items()}
    basis = _party(IMPORTS, "command:imports", {})
    parties = {name: _party(name, f"command:{function}", {}) for name, (function, *_) in starts.items()}
    parties |= {name: _party(name, "command:short", {"command": SHORT[name]}) for name in SHORT}
    promised = {name: promise for name, (_, *promise) in starts.items()} | at_once
    targets = [Target(name, IMPORTS, *promised[name], times=True) for name in parties]
    task = _task("the README's sweep, and shorter commands", cores, {}, parties | {IMPORTS: basis}, *targets)
    return [task._replace(unit="starts", outcome=None)]


def _windy(method: str, size: Size, cores: int, promise: tuple[float, float], *others: Peer) -> Task:
    """A method on the windy gridworld; `promise` is what was promised beside lanes one after another."""
    work = {"method": method, "lanes": size.lanes, "steps": size.steps}
    lane_by_lane = Peer(LANE_BY_LANE, "numba_windy:lane_by_lane", *promise)
    return _beside(f"{method}, windy gridworld", cores, "ours:windy", work, lane_by_lane, *others)


def _beside(name: str, cores: int, call: str, work: Mapping[str, Any], *peers: Peer) -> Task:
    """What we do by `call` beside our peers, all with the same arguments `work`."""
    parties = {peer.name: _party(peer.name, peer.call, work) for peer in (Peer(OURS, call), *peers)}
    return _task(
        name, cores, work, parties, *(Target(OURS, peer.name, peer.least, peer.aim) for peer in peers)
    )


def _task(
    name: str, cores: int, work: Mapping[str, Any], parties: Mapping[str, Party], *targets: Target
) -> Task:
    """A task of steps, as many as the product of all numbers in `work`, on whose episodes all must agree."""
    steps = math.prod(number for number in work.values() if isinstance(number, int))
    return Task(name, cores, steps, "steps", tuple(parties.values()), targets, "episodes")


def _party(name: str, call: str, arguments: Mapping[str, Any]) -> Party:
    """A party whose `call` is in a module of `benchmarks`, the name of which begins with that of its library."""
    library, _, _ = call.partition(":")[0].partition("_")
    return Party(name, library, f"benchmarks.{call}", arguments)


ROWS: dict[str, Callable[[Size, int], list[Task]]] = {
    "windy": windy,
    "windy-one-core": windy_on_one_core,
    "more-windy": more_windy,
    "one-run": one_run,
    "sarsa-lambda": sarsa_lambda,
    "garnet": garnet,
    "blackjack": blackjack,
    "mountain-car": mountain_car,
    "devices": devices,
    "methods": methods,
    "compiling": compiling,
    "command": command,
}
SLOW = (
    "windy-one-core",
    "methods",
    "compiling",
    "command",
)  # a quick run leaves them out: they compile for too long
