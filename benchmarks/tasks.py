"""The rows of the benchmark: who does what, and what was promised of it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from benchmarks.rounds import Party, Target, Task, fresh

OURS = "jaxrl_tab"
LANE_BY_LANE, ABREAST = "Numba, lane by lane", "Numba, 4 lanes abreast"
NAIVE = "naive JAX"
METHODS = ("q-learning", "sarsa")


class Size(NamedTuple):
    """How much is run in a round.

    Attributes:
        lanes, steps: of the methods that take one step after another; lanes a multiple of 4.
        slow_lanes: of what takes longer a step.
        lone_steps: of one run alone.
        games: of Blackjack, in each of the slow lanes.
    """

    lanes: int
    steps: int
    slow_lanes: int
    lone_steps: int
    games: int


FULL = Size(lanes=4096, steps=8000, slow_lanes=1024, lone_steps=100_000, games=5000)
QUICK = Size(lanes=512, steps=8000, slow_lanes=128, lone_steps=100_000, games=5000)


def _ours(function: str, name: str = OURS, **given: Any) -> Party:
    return Party(name, "benchmarks.ours", function, given)


def windy(size: Size, cores: int) -> list[Task]:
    """Q-learning and Sarsa on the windy gridworld, on one core and on all."""
    tasks = []
    for method in METHODS:
        for count in sorted({1, cores}):
            given = {"method": method, "lanes": size.lanes, "steps": size.steps}
            parties = (
                _ours("windy", **given),
                Party(LANE_BY_LANE, "benchmarks.numba_windy", "lane_by_lane", given),
                Party(ABREAST, "benchmarks.numba_windy", "four_abreast", given),
                Party(NAIVE, "benchmarks.naive_jax", "many_lanes", given),
            )
            promised = count > 1
            targets = (
                Target(OURS, LANE_BY_LANE, *((1.0, 2.0) if promised else ())),
                Target(OURS, ABREAST),
                Target(OURS, NAIVE, *((25, 45) if promised else ())),
            )
            work = size.lanes * size.steps
            tasks.append(
                Task(f"{method}, windy gridworld", count, work, "steps", parties, targets, "episodes")
            )
    return tasks


def one_lane(size: Size, cores: int) -> list[Task]:
    """One run alone, as long as it takes to be worth while."""
    tasks = []
    for method in METHODS:
        given = {"method": method, "steps": size.lone_steps}
        parties = (
            _ours("one_lane", **given),
            Party(NAIVE, "benchmarks.naive_jax", "one_lane", given),
            Party(LANE_BY_LANE, "benchmarks.numba_windy", "lane_by_lane", given | {"lanes": 1}),
        )
        targets = Target(OURS, NAIVE, 100), Target(OURS, LANE_BY_LANE)
        tasks.append(
            Task(f"{method}, one run alone", 1, size.lone_steps, "steps", parties, targets, "episodes")
        )
    return tasks


def sarsa_lambda(size: Size, cores: int) -> list[Task]:
    given = {"lanes": size.slow_lanes, "steps": size.steps}
    every_pair, when_read = "Numba, every pair", "Numba, pairs when read"
    parties = (
        _ours("sarsa_lambda", **given),
        Party(every_pair, "benchmarks.numba_sarsa_lambda", "every_pair", given),
        Party(when_read, "benchmarks.numba_sarsa_lambda", "when_read", given),
    )
    targets = Target(OURS, every_pair, 0.8, 1.5), Target(OURS, when_read)
    work = size.slow_lanes * size.steps
    return [Task("sarsa-lambda, windy gridworld", cores, work, "steps", parties, targets, "episodes")]


def garnet(size: Size, cores: int) -> list[Task]:
    given = {"lanes": size.lanes, "steps": size.steps}
    parties = (
        _ours("garnet", **given),
        Party(LANE_BY_LANE, "benchmarks.numba_garnet", "lane_by_lane", given),
        Party(ABREAST, "benchmarks.numba_garnet", "four_abreast", given),
    )
    targets = Target(OURS, LANE_BY_LANE, 0.8, 1.5), Target(OURS, ABREAST)
    work = size.lanes * size.steps
    return [Task("q-learning, 1000-state MDP", cores, work, "steps", parties, targets, "episodes")]


def blackjack(size: Size, cores: int) -> list[Task]:
    given = {"lanes": size.slow_lanes, "episodes": size.games}
    parties = (
        _ours("blackjack", **given),
        Party(LANE_BY_LANE, "benchmarks.numba_blackjack", "lane_by_lane", given),
    )
    targets = (Target(OURS, LANE_BY_LANE, 0.5, 1.0),)
    work = size.slow_lanes * size.games
    outcome = "mean return in the last tenth"
    return [Task("monte-carlo, blackjack", cores, work, "episodes", parties, targets, outcome)]


def devices(size: Size, cores: int) -> list[Task]:
    """Two devices against one, in the same process; they must give the same."""
    if cores < 2:
        return []
    one, two = "one device", "two devices"
    tasks = []
    for method in METHODS:
        given = {"method": method, "lanes": size.lanes, "steps": size.steps}
        parties = tuple(_ours("on_devices", name, **given, devices=n) for name, n in ((one, 1), (two, 2)))
        targets = (Target(two, one, 1.9),)
        work = size.lanes * size.steps
        tasks.append(Task(f"{method}, devices", 2, work, "steps", parties, targets, "episodes"))
    return tasks


def methods(size: Size, cores: int) -> list[Task]:
    """Every registered method beside our own Q-learning."""
    basis, *others = sorted(
        fresh("benchmarks.ours", "method_names", 1), key=lambda name: name != "q-learning"
    )
    given = {"lanes": size.slow_lanes, "steps": size.steps}
    parties = tuple(_ours("any_method", name, method=name, **given) for name in (basis, *others))
    targets = tuple(Target(name, basis) for name in others)
    return [Task("every method", cores, size.slow_lanes * size.steps, "steps", parties, targets)]


def command(size: Size, cores: int) -> list[Task]:
    """The README's command from a cold start, and again."""
    first, again, basis = "empty cache", "filled cache", "imports and steps"
    functions = {first: "with_empty_cache", again: "with_filled_cache", basis: "imports_and_steps"}
    parties = tuple(Party(name, "benchmarks.cold", function, {}) for name, function in functions.items())
    targets = Target(first, basis, 2.0, times=True), Target(again, basis, 1.2, times=True)
    return [Task("the README's sweep", cores, 1, "starts", parties, targets)]


ROWS: dict[str, Callable[[Size, int], list[Task]]] = {
    "windy": windy,
    "one-lane": one_lane,
    "sarsa-lambda": sarsa_lambda,
    "garnet": garnet,
    "blackjack": blackjack,
    "devices": devices,
    "methods": methods,
    "command": command,
}
SLOW = ("methods", "command")  # left out of a quick run: they take minutes, and are compared with nobody
