"""Our side: `sweep` and `train`, as a user calls them.

A round of `sweep` is what it says it took: the runs with their logs, and the copy of these to the host. That
leaves out what it compiles and the exact optimum that it works out beside.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import numpy as np

import jaxrl_tab as rl
from benchmarks import problems
from benchmarks.rounds import Round, Timing, warm
from jaxrl_tab.core.types import Environment
from jaxrl_tab.engine import room
from jaxrl_tab.engine.budget import Budget

Outcome = Callable[[rl.Log], np.ndarray]

rl.use_all_cores()  # those that this process has been given

CONTROL = {"alpha": problems.ALPHA, "epsilon": problems.EPSILON}
WITH_TRACES = CONTROL | {"alpha": problems.ALPHA_OF_TRACES, "lam": problems.LAMBDA}


def windy(method: str, lanes: int, steps: int) -> Round:
    return _sweeps(rl.make("windy-gridworld"), method, CONTROL, _episodes, lanes, num_steps=steps)


def sarsa_lambda(lanes: int, steps: int) -> Round:
    env = rl.make("windy-gridworld")
    return _sweeps(env, "sarsa-lambda", WITH_TRACES, _episodes, lanes, num_steps=steps)


def garnet(lanes: int, steps: int) -> Round:
    mdp = problems.garnet()
    prob = np.zeros((*mdp.reward.shape, len(mdp.reward)))
    np.put_along_axis(prob, mdp.successors, mdp.prob, axis=-1)
    env = rl.envs.FiniteMDP(prob, mdp.reward, terminal=mdp.terminal)
    return _sweeps(env, "q-learning", CONTROL, _episodes, lanes, num_steps=steps)


def blackjack(lanes: int, episodes: int) -> Round:
    grid = {"epsilon": rl.schedules.glie()}
    budget = {"num_episodes": episodes, "log_every": episodes // 10}
    return _sweeps(rl.make("blackjack"), "monte-carlo", grid, _last_return, lanes, **budget)


def mountain_car(lanes: int, episodes: int) -> Round:
    grid = {
        "features": f"tile-coding({problems.TILINGS}, {problems.TILES})",
        "alpha": problems.CAR_ALPHA,
        "per_tiling": True,
        "epsilon": 0.0,
    }
    car, method = rl.MountainCar(), rl.approx.SemiGradientSarsa
    return _sweeps(car, method, grid, _mean_length, lanes, num_episodes=episodes)


def one_run(method: str, steps: int) -> Round:
    """`train` of one run, with a key that is new in each round."""
    algorithm, env = rl.ALGORITHMS[method](**CONTROL), rl.make("windy-gridworld")
    program = partial(rl.train, algorithm=algorithm, env=env, num_steps=steps)
    jax.block_until_ready(program(jax.random.key(0)))  # compiles

    def run(seed: int) -> Timing:
        key = jax.random.key(seed)
        begun = time.perf_counter()
        _, log = jax.block_until_ready(program(key))
        return Timing(time.perf_counter() - begun, np.asarray(log.episodes).sum(keepdims=True))

    return warm(run)


def method_names() -> list[str]:
    """All that are registered."""
    return [*rl.ALGORITHMS, *rl.PREDICTION]


def any_method(method: str, lanes: int, steps: int) -> Round:
    """A method as it is by default: of control on the windy gridworld, of prediction on the random walk."""
    if method in rl.PREDICTION:
        return _sweeps(rl.make("random-walk"), method, {}, _episodes, lanes, num_steps=steps)
    return _sweeps(rl.make("windy-gridworld"), method, {}, _episodes, lanes, num_steps=steps)


def on_devices(method: str, lanes: int, steps: int, devices: int) -> Round:
    """Runs on the first so many of this process's devices."""
    env = rl.make("windy-gridworld")
    one = jax.tree.map(np.float32, rl.ALGORITHMS[method](**CONTROL))
    algorithms = jax.tree.map(lambda x: np.full(lanes, x), one)
    budget = Budget(num_steps=steps, num_episodes=None, log_every=None, exact=False)
    used = jax.devices()[:devices]
    if len(used) < devices:
        raise RuntimeError(f"{devices} devices were asked for, and there are {len(used)}")

    def run(seed: int) -> Timing:
        root = jax.random.key(seed)
        results, free = room.plan([room.needs_of(env, one, root, budget)], lanes, devices=used)
        keep = results.write
        took = rl.batch.run(env, algorithms, root, np.arange(lanes), budget, keep, room=free, devices=used)
        return Timing(took.running, _episodes(results.arrays[1]))

    run(0)  # compiles
    return run


def _sweeps(
    env: Environment, method: Any, grid: Mapping[str, Any], outcome: Outcome, lanes: int, **budget: Any
) -> Round:
    def sweep(num_seeds: int, seed: int) -> rl.SweepResult:
        return rl.sweep(env, method, grid, num_seeds=num_seeds, seed=seed, **budget)

    def run(seed: int) -> Timing:
        result = sweep(lanes, seed)
        return Timing(result.seconds, outcome(result.log))

    sweep(lanes, 0)  # compiles
    return run


def _episodes(log: rl.Log) -> np.ndarray:
    """Episodes finished in each lane, int [lanes]."""
    return np.asarray(log.episodes).sum(-1)


def _last_return(log: rl.Log) -> np.ndarray:
    """Mean return of each lane in the last row of the log, float [lanes]."""
    return np.asarray(log.returns[..., -1] / log.episodes[..., -1])


def _mean_length(log: rl.Log) -> np.ndarray:
    """Steps of an episode in each lane, float [lanes]."""
    return np.asarray(log.lengths).mean(-1)
