"""A grid of hyperparameters times seeds, in one call."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral
from typing import Any, cast

import jax
import numpy as np
from jaxtyping import Float

from jaxrl_tab import batch, planning
from jaxrl_tab.envs import ENVS
from jaxrl_tab.prediction import METHODS
from jaxrl_tab.results import SweepResult, label, parameters
from jaxrl_tab.train import Record, check_budget, default_log_every
from jaxrl_tab.types import (
    Algorithm,
    Environment,
    FiniteEnvironment,
    InputError,
    build,
    check_pytree,
    is_whole,
    nearest,
    shown,
)


def sweep(
    env: Environment,
    algorithm: type[Algorithm] | str,
    grid: Mapping[str, Any] | None = None,
    *,
    num_seeds: int,
    num_steps: int | None = None,
    num_episodes: int | None = None,
    log_every: int | None = None,
    seed: int = 0,
    exact: bool = False,
    record: Record | None = None,
    memory: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SweepResult:
    """Runs a method with every combination of hyperparameters, each over the same seeds.

    Seed i has the key `fold_in(key(seed), i)` in every configuration: common random numbers, which pair the
    configurations. What a run gives depends on that key and on its hyperparameters alone, bitwise.

    Args:
        env: the environment.
        algorithm: a class such as `Sarsa`, or its name in `ALGORITHMS` or `PREDICTION`.
        grid: for each hyperparameter a list of values (an axis of the result) or a single value. A value
            is a number, a schedule or a policy. What is not named keeps its default.
        num_seeds: how many seeds, at least 1.
        num_steps, num_episodes, log_every, exact, record: as in `train`.
        seed: which sequence of seeds, a whole number >= 0.
        memory: how many bytes it may take, at least 1: results and what is being computed. By default half
            of what is free. It changes no number: with less, fewer runs are under way at a time, and results
            that do not fit are in files of the temporary folder (`TMPDIR`), which go away with them.
        progress: is called with the number of runs finished and of all runs, as blocks of them finish.

    Raises:
        InputError: something given is wrong; nothing was compiled.
    """
    check_budget(num_steps, num_episodes, log_every)
    for name, value, least in (("num_seeds", num_seeds, 1), ("seed", seed, 0)):
        if not is_whole(value, least):
            raise InputError(
                f"{name} must be a whole number of at least {least} and below 2**31, not {shown(value)}"
            )
    if memory is not None and (not isinstance(memory, Integral) or memory < 1):
        raise InputError(f"memory must be a number of bytes, at least 1, not {shown(memory)}")
    if not isinstance(env, Environment):
        raise InputError(f"env must be an environment such as make('windy-gridworld'), not {shown(env)}")
    check_pytree("env", env)
    if exact:
        planning.check_finite(env)
    if isinstance(env, FiniteEnvironment):
        planning.exact_model(env)  # refuses one that breaks the rules
    cls = _algorithm_class(algorithm)
    axes, configs = configurations(cls, grid or {})

    budget = batch.Budget(num_steps, num_episodes, log_every, bool(exact), record)
    total = len(configs) * num_seeds
    root = jax.random.key(seed)
    programs = _same_program(configs)
    instances = [_leaves_as_arrays(config) for config in configs]
    results, room = batch.plan(env, [instances[i] for i, *_ in programs], root, total, budget, memory)
    done, seconds = 0, np.zeros(2)
    for members in programs:
        stacked = jax.tree.map(lambda *x: np.stack(x)[:, None], *(instances[i] for i in members))
        seeds = np.broadcast_to(np.arange(num_seeds, dtype=np.uint32), (len(members), num_seeds))

        def keep(runs, given, members=members):
            results.write(np.take(members, runs // num_seeds) * num_seeds + runs % num_seeds, given)

        report = lambda n, done=done: progress(done + n, total)
        seconds += batch.run(env, stacked, root, seeds, budget, keep, report, room)
        done += seeds.size

    # Where a behaviour policy is given epsilon is not looked at, and it would mislead to show it.
    unused = {"epsilon"} if getattr(configs[0], "behaviour", None) is not None else set()
    shape = tuple(len(values) for values in axes.values())
    q, log = jax.tree.map(lambda x: x.reshape(*shape, num_seeds, *x.shape[1:]), results.arrays)
    return SweepResult(
        environment=_name_in(ENVS, type(env)),
        algorithm=_name_in(METHODS, cls),
        env=env,
        grid=axes,
        fixed={k: value for k, value in parameters(configs[0]).items() if k not in axes and k not in unused},
        log=log,
        q=q,
        optimal_value=_exact_value(env, axes, configs),
        root_seed=int(seed),
        num_steps=num_steps,
        num_episodes=num_episodes,
        log_every=log_every or default_log_every(num_steps),
        seconds=seconds[0],
        compile_seconds=seconds[1],
    )


def _algorithm_class(algorithm: type[Algorithm] | str) -> type[Algorithm]:
    if isinstance(algorithm, str):
        if algorithm not in METHODS:
            raise InputError(f"no method is called {algorithm!r}; {nearest(algorithm, METHODS)}")
        return METHODS[algorithm]
    if not isinstance(algorithm, type) or not dataclasses.is_dataclass(algorithm):
        raise InputError(
            "algorithm must be a class such as Sarsa, not an instance: its hyperparameters go into the grid "
            f"(got {algorithm!r})"
        )
    return algorithm


def configurations(cls: type[Algorithm], grid: Mapping[str, Any]) -> tuple[dict[str, tuple], list[Algorithm]]:
    """The axes (name -> values), and an instance for every point of the grid, in C order."""
    name = _name_in(METHODS, cls)
    if not isinstance(grid, Mapping):
        raise InputError(f"grid must be a dict from hyperparameters to values, not {shown(grid)}")
    axes, single = {}, {}
    for parameter, values in grid.items():
        if isinstance(values, Sequence | np.ndarray | jax.Array) and np.ndim(values) > 0:
            if np.ndim(values) > 1:
                raise InputError(
                    f"the grid of {parameter} must be a flat list, not of shape {np.shape(values)}; "
                    "probabilities [S, A] are one value where they are a policies.Table"
                )
            axes[parameter] = tuple(_plain(value) for value in values)
        else:
            single[parameter] = _plain(values)
    for parameter, values in axes.items():
        labels = [label(v) for v in values]
        repeated = [v for i, v in enumerate(labels) if v in labels[:i]]
        if not values:
            raise InputError(f"the grid of {parameter} is empty")
        if repeated:
            raise InputError(f"the grid of {parameter} holds {repeated[0]} more than once")
    points = itertools.product(*axes.values())
    return axes, [build(cls, name, single | dict(zip(axes, point, strict=True))) for point in points]


def _plain(value: Any) -> Any:
    """A NumPy or JAX number as a Python number."""
    return value.item() if isinstance(value, np.generic | np.ndarray | jax.Array) else value


def _leaves_as_arrays(algorithm: Algorithm) -> Algorithm:
    """Numbers in JAX's own float type: a Python float and an array would be two programs."""
    dtype = jax.dtypes.canonicalize_dtype(float)
    return jax.tree.map(lambda x: np.asarray(x, dtype), algorithm)


def _same_program(configs: Sequence[Algorithm]) -> list[list[int]]:
    """The configurations, as indices, grouped by what shapes the program: all but the leaves' values."""
    groups: dict[Any, list[int]] = {}
    for i, config in enumerate(configs):
        leaves, treedef = jax.tree.flatten(config)
        groups.setdefault((treedef, tuple(np.shape(x) for x in leaves)), []).append(i)
    return list(groups.values())


def _name_in(registry: Mapping[str, type], cls: type) -> str:
    return next((name for name, value in registry.items() if value is cls), cls.__name__)


def _exact_value(
    env: Environment, axes: Mapping[str, tuple], configs: Sequence[Algorithm]
) -> Float[np.ndarray, "*gammas"]:
    """What the runs are measured by, as `SweepResult.optimal_value` has it."""

    def value(gamma: float) -> float:
        found = {_judge(env, config) for config in _different(configs, gamma)}
        return found.pop() if len(found) == 1 else np.nan  # one for each pi, say

    if "gamma" in axes:
        return np.array([value(gamma) for gamma in axes["gamma"]])
    return np.array(value(configs[0].gamma))


def _different(configs: Sequence[Algorithm], gamma: float) -> list[Algorithm]:
    """Those with this gamma whose exact values may differ: of control one, of prediction one for each pi."""
    same = [config for config in configs if config.gamma == gamma]
    if not hasattr(same[0], "exact_value"):
        return same[:1]
    by_pi: dict[int, Any] = {id(config.pi): config for config in cast(list[Any], same)}
    return list(by_pi.values())


def _judge(env: Environment, config: Any) -> float:
    """The exact value from the start of what `config` learns; NaN where there is no finite answer."""
    if hasattr(env, "instance"):  # a problem for each run: an environment may know the mean over them
        mean = getattr(env, "mean_optimal_value", None)
        return np.nan if mean is None or hasattr(config, "exact_value") else mean(config.gamma)
    if not isinstance(env, FiniteEnvironment):
        return np.nan
    if hasattr(config, "exact_value"):
        return config.exact_value(env)
    try:
        return planning.start_value(env, planning.value_iteration(env, config.gamma)[0])
    except InputError:
        return np.nan
