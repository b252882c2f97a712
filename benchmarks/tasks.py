"""The rows of the benchmark: who does what, and what was promised of it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from benchmarks.rounds import Party, Target, Task, fresh

OURS, NAIVE = "jaxrl_tab", "naive JAX"
LANE_BY_LANE, ABREAST = "Numba, lane by lane", "Numba, 4 lanes abreast"
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
QUICK = Size(lanes=256, steps=8000, slow_lanes=128, lone_steps=100_000, games=5000)


def ours(function: str, given: dict[str, Any], name: str = OURS) -> Party:
    return Party(name, "ours", f"benchmarks.ours:{function}", given)


def numba(name: str, call: str, given: dict[str, Any]) -> Party:
    return Party(name, "numba", f"benchmarks.{call}", given)


def naive(function: str, given: dict[str, Any]) -> Party:
    return Party(NAIVE, "naive JAX", f"benchmarks.naive_jax:{function}", given)


def windy(size: Size, cores: int) -> list[Task]:
    """Q-learning and Sarsa on the windy gridworld, on as many cores as there are."""
    return [
        _windy(
            method,
            size,
            cores,
            Target(OURS, LANE_BY_LANE, least=1.0, aim=2.0),
            Target(OURS, ABREAST),
            Target(OURS, NAIVE, least=25, aim=45),
        )
        for method in METHODS
    ]


def windy_on_one_core(size: Size, cores: int) -> list[Task]:
    """The same on one core of several, for which nothing was promised."""
    if cores == 1:
        return []
    targets = Target(OURS, LANE_BY_LANE), Target(OURS, ABREAST), Target(OURS, NAIVE)
    return [_windy(method, size, 1, *targets) for method in METHODS]


def _windy(method: str, size: Size, cores: int, *targets: Target) -> Task:
    given = {"method": method, "lanes": size.lanes, "steps": size.steps}
    return Task(
        f"{method}, windy gridworld",
        cores,
        work=size.lanes * size.steps,
        unit="steps",
        parties=(
            ours("windy", given),
            numba(LANE_BY_LANE, "numba_windy:lane_by_lane", given),
            numba(ABREAST, "numba_windy:four_abreast", given),
            naive("many_lanes", given),
        ),
        targets=targets,
        outcome="episodes",
    )


def one_run(size: Size, cores: int) -> list[Task]:
    """One run alone, which cannot use more than one core."""
    tasks = []
    for method in METHODS:
        given = {"method": method, "steps": size.lone_steps}
        tasks.append(
            Task(
                f"{method}, one run alone",
                cores,
                work=size.lone_steps,
                unit="steps",
                parties=(
                    ours("one_run", given),
                    naive("one_run", given),
                    numba(LANE_BY_LANE, "numba_windy:lane_by_lane", given | {"lanes": 1}),
                ),
                targets=(Target(OURS, NAIVE, least=100), Target(OURS, LANE_BY_LANE)),
                outcome="episodes",
            )
        )
    return tasks


def sarsa_lambda(size: Size, cores: int) -> list[Task]:
    given = {"lanes": size.slow_lanes, "steps": size.steps}
    every_pair, when_read = "Numba, every pair", "Numba, pairs when read"
    task = Task(
        "sarsa-lambda, windy gridworld",
        cores,
        work=size.slow_lanes * size.steps,
        unit="steps",
        parties=(
            ours("sarsa_lambda", given),
            numba(every_pair, "numba_sarsa_lambda:every_pair", given),
            numba(when_read, "numba_sarsa_lambda:when_read", given),
        ),
        targets=(Target(OURS, every_pair, least=0.8, aim=1.5), Target(OURS, when_read)),
        outcome="episodes",
    )
    return [task]


def garnet(size: Size, cores: int) -> list[Task]:
    given = {"lanes": size.lanes, "steps": size.steps}
    task = Task(
        "q-learning, MDP of 1000 states",
        cores,
        work=size.lanes * size.steps,
        unit="steps",
        parties=(
            ours("garnet", given),
            numba(LANE_BY_LANE, "numba_garnet:lane_by_lane", given),
            numba(ABREAST, "numba_garnet:four_abreast", given),
        ),
        targets=(Target(OURS, LANE_BY_LANE, least=0.8, aim=1.5), Target(OURS, ABREAST)),
        outcome="episodes",
    )
    return [task]


def blackjack(size: Size, cores: int) -> list[Task]:
    given = {"lanes": size.slow_lanes, "episodes": size.games}
    task = Task(
        "monte-carlo, blackjack",
        cores,
        work=size.slow_lanes * size.games,
        unit="episodes",
        parties=(
            ours("blackjack", given),
            numba(LANE_BY_LANE, "numba_blackjack:lane_by_lane", given),
        ),
        targets=(Target(OURS, LANE_BY_LANE, least=0.5, aim=1.0),),
        outcome="mean return in the last tenth",
    )
    return [task]


def devices(size: Size, cores: int) -> list[Task]:
    """Two devices against one, in the same process."""
    if cores < 2:
        return []
    given = {"method": "q-learning", "lanes": size.lanes, "steps": size.steps}
    one, two = "one device", "two devices"
    task = Task(
        "q-learning, devices",
        cores=2,
        work=size.lanes * size.steps,
        unit="steps",
        parties=(
            ours("on_devices", given | {"devices": 1}, one),
            ours("on_devices", given | {"devices": 2}, two),
        ),
        targets=(Target(two, one, least=1.9),),
        outcome="episodes",
    )
    return [task]


def methods(size: Size, cores: int) -> list[Task]:
    """Every registered method beside our own Q-learning, so that a slow one is seen."""
    basis = "q-learning"
    names = fresh("benchmarks.ours:method_names", cores=1)
    others = [name for name in names if name != basis]
    given = {"lanes": size.slow_lanes, "steps": size.steps}
    task = Task(
        "every method",
        cores,
        work=size.slow_lanes * size.steps,
        unit="steps",
        parties=tuple(ours("any_method", given | {"method": name}, name) for name in (basis, *others)),
        targets=tuple(Target(name, basis) for name in others),
    )
    return [task]


def command(size: Size, cores: int) -> list[Task]:
    """The README's command from a cold start, and again."""
    first, again, basis = "empty cache", "filled cache", "imports and steps"
    functions = {first: "with_empty_cache", again: "with_filled_cache", basis: "imports_and_steps"}
    task = Task(
        "the README's sweep",
        cores,
        work=1,
        unit="starts",
        parties=tuple(
            Party(name, "commands", f"benchmarks.cold:{function}", {}) for name, function in functions.items()
        ),
        targets=(Target(first, basis, least=2.0, times=True), Target(again, basis, least=1.2, times=True)),
    )
    return [task]


ROWS: dict[str, Callable[[Size, int], list[Task]]] = {
    "windy": windy,
    "windy-one-core": windy_on_one_core,
    "one-run": one_run,
    "sarsa-lambda": sarsa_lambda,
    "garnet": garnet,
    "blackjack": blackjack,
    "devices": devices,
    "methods": methods,
    "command": command,
}
SLOW = ("windy-one-core", "methods", "command")  # a quick run leaves them out: they compile for too long
