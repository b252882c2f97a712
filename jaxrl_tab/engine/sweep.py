"""A grid of hyperparameters times seeds, in one call."""

import dataclasses
import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence, Set
from numbers import Integral
from typing import Any, Literal, cast

import jax
import numpy as np
from jaxtyping import Float

from jaxrl_tab.approx import dangers
from jaxrl_tab.approx.optimized import Optimized
from jaxrl_tab.core import modules, names
from jaxrl_tab.core.checks import build, check_held, check_pytree, checked, foreign, is_list, repeated
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.errors import InputError, one_line, shown, whole
from jaxrl_tab.core.names import registered_name
from jaxrl_tab.core.types import Algorithm, Environment, FiniteEnvironment, fitted
from jaxrl_tab.engine import backend as backends
from jaxrl_tab.engine.axes import DRAW, check_settings, spread, swept_names
from jaxrl_tab.engine.backend import Backend
from jaxrl_tab.engine.budget import Budget, Record
from jaxrl_tab.engine.part import Computed, Part, compute
from jaxrl_tab.engine.results import SweepResult, label, parameters
from jaxrl_tab.engine.traced import exact_fields
from jaxrl_tab.engine.train import check_end, check_exact
from jaxrl_tab.envs import name_of
from jaxrl_tab.exact import planning
from jaxrl_tab.methods import METHOD, METHODS
from jaxrl_tab.show.progress import Progress, Report, reporting


def sweep(
    env: Environment | type[Algorithm] | str,
    algorithm: type[Algorithm] | str | Environment,
    grid: Mapping[str, Any] | None = None,
    *,
    num_seeds: int,
    first_seed: int = 0,
    num_draws: int | None = None,
    num_steps: int | None = None,
    num_episodes: int | None = None,
    log_every: int | None = None,
    seed: int = 0,
    exact: bool = False,
    record: Record | None = None,
    exact_every: int | None = None,
    backend: Backend = "auto",
    memory: int | None = None,
    progress: Report | Literal[False] | None = None,
) -> SweepResult:
    """Runs a method with every combination of hyperparameters, each over the same seeds.

    Seed i has the key `fold_in(key(seed), i)` in every configuration: common random numbers, which pair the
    configurations. What a run gives depends on that key and on its hyperparameters alone, bitwise.

    It is one method, with as many seeds as it is told. To compare methods on as many seeds as it takes until all is
    decided, an experiment knows them all: `run(Experiment(env, methods, until_decided=True)).verdicts`, with no folder.

    Args:
        env: the environment.
        algorithm: a class such as `Sarsa`, or its name: "sarsa", "mine.py:Mine" (see `core.names`). It may also
            stand before the environment, as in `train`.
        grid: for each hyperparameter a list of values (an axis of the result) or a single value. A value
            is a number, a schedule or a policy. Besides lists there are grids in steps and random draws,
            such as `LogGrid(0.01, 1, 5)` and `LogUniform(0.01, 1)`: see `axes`. What is not named keeps its
            default.
        num_seeds: how many seeds, at least 1.
        first_seed: the number of the first of them, a whole number >= 0; the others follow it, and the coordinate
            `seed` of the results says so. So 30 seeds from 20 on go on where 20 seeds from 0 ended, to the last bit.
        num_draws: how many trials of what is drawn at random; they are the axis `draw` of the result.
        num_steps, num_episodes, log_every, exact, record, exact_every: as in `train`.
        seed: which sequence of seeds, a whole number >= 0.
        backend: what compiles it: "lanes" (for CPUs, and fast), "xla", or "auto": what `JAXRL_TAB_BACKEND` says,
            or else `lanes` where it can. See `engine.backend`.
        memory: how many bytes it may take, at least 1: results and what is being computed. By default half
            of what is free. It changes no number: with less, fewer runs are under way at a time, and results
            that do not fit are in files of the temporary folder (`TMPDIR`), which go away with them.
        progress: a function that is called with a `Progress` as blocks of runs finish; by default a bar where
            a person looks on, in a terminal or a notebook; False for none.

    Raises:
        InputError: something given is wrong; nothing was compiled.
    """
    if isinstance(algorithm, Environment):
        env, algorithm = algorithm, env
    env, algorithm = cast(Environment, env), cast(type[Algorithm] | str, algorithm)
    if memory is not None and (not isinstance(memory, Integral) or memory < 1):
        raise InputError(f"memory must be a number of bytes, at least 1, not {shown(memory)}")
    backends.check(backend)
    part = prepare(
        env,
        algorithm,
        grid,
        Budget(num_steps, num_episodes, log_every, bool(exact), record, exact_every),
        num_seeds=num_seeds,
        num_draws=num_draws,
        seed=seed,
        first_seed=first_seed,
    )
    state = Progress(
        f"{registered_name(METHODS, part.algorithm)} in {name_of(env)}",
        0,
        part.runs,
    )
    with reporting(progress) as report:
        begun = time.perf_counter()

        def tell(done: int, steps: int) -> None:
            seconds = time.perf_counter() - begun
            left = seconds * (part.runs - done) / done
            report(state._replace(done=done, steps=steps, seconds=seconds, left=left))

        report(state)
        with backends.using(backend):
            computed = compute(part, memory=memory, progress=tell)
    return result(part, computed)


def prepare(
    env: Environment,
    algorithm: type[Algorithm] | str,
    grid: Mapping[str, Any] | None,
    budget: Budget,
    *,
    num_seeds: int,
    num_draws: int | None = None,
    seed: int = 0,
    first_seed: int = 0,
) -> Part:
    """All checks of a sweep; nothing is compiled.

    Args:
        budget: how long each run is and what it records.
        Others: as in `sweep`.

    Raises:
        InputError: something given is wrong.
    """
    modules.check_not_importing()
    for name, value, least in (("num_seeds", num_seeds, 1), ("seed", seed, 0), ("first_seed", first_seed, 0)):
        whole(None, name, value, least)
    if not isinstance(env, Environment):
        raise InputError(
            f"env must be an environment such as make('windy-gridworld'), not {shown(env)}{foreign(env)}"
        )
    check_pytree("env", env)
    check_held(env)
    cls = _algorithm_class(algorithm)
    if budget.exact:
        check_exact(cls, env)
    if isinstance(env, FiniteEnvironment):
        planning.exact_model(env)  # refuses one that breaks the rules
    check_end(cls, env)
    axes, configs = configurations(cls, {} if grid is None else grid, num_draws, seed)
    check_pytree(cls.__name__, configs[0])
    if len(configs) * num_seeds >= 2**31:
        raise InputError(
            f"{len(configs):,} settings x {num_seeds:,} seeds are more than the 2**31 runs that can be numbered: "
            "take fewer seeds or settings"
        )
    if int(first_seed) + int(num_seeds) > 2**31:
        raise InputError(f"seeds have numbers below 2**31: {num_seeds:,} from {first_seed:,} on are too many")
    for config in configs:
        fitted(config, env)  # raises InputError where it does not fit
    for line in dangers.step_sizes(configs, env):
        backends.tell(line)
    return Part(env, cls, axes, configs, int(num_seeds), int(first_seed), int(seed), budget)


def result(part: Part, computed: Computed) -> SweepResult:
    """The result of a sweep from what all runs of it gave, in the order of their numbers."""
    axes, first = part.axes, part.configs[0]
    method = of_method(first)
    # Where a behaviour policy is given epsilon is not looked at, nor alpha beside an optimiser that has its own, and it
    # would mislead to show it.
    unused = {"epsilon"} if method.behaviour is not None else set()
    unused |= {"alpha"} if isinstance(first, Optimized) and first.optimizer else set()
    shape = (*(len(values) for values in axes.values()), part.num_seeds)
    q, log = jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), (computed.q, computed.log))
    return SweepResult(
        environment=name_of(part.env),
        algorithm=registered_name(METHODS, part.algorithm),
        learns=method.learns,
        env=part.env,
        grid=axes,
        fixed={k: value for k, value in parameters(first).items() if k not in {*swept_names(axes), *unused}},
        log=log,
        q=q,
        optimal_value=_exact_value(part.env, axes, part.configs),
        references=_references(part),
        root_seed=part.seed,
        first_seed=part.first_seed,
        largest_value=part.largest_values.reshape(shape[:-1]),
        fresh=part.fresh,
        num_steps=part.budget.num_steps,
        num_episodes=part.budget.num_episodes,
        log_every=part.budget.row,
        exact_every=part.budget.exact_every,
        seconds=computed.seconds.running,
        compile_seconds=computed.seconds.compiling,
        part=part,
    )


def _algorithm_class(algorithm: type[Algorithm] | str) -> type[Algorithm]:
    if isinstance(algorithm, str | type):
        return names.find(METHOD, algorithm).cls
    raise InputError(
        "algorithm must be a class such as Sarsa, not an instance: its hyperparameters go into the grid "
        f"(got {shown(algorithm)})"
    )


def configurations(
    cls: type[Algorithm], grid: Mapping[str, Any], num_draws: int | None = None, seed: int = 0
) -> tuple[dict[str, tuple], list[Algorithm]]:
    """The axes (name -> values), and an instance for every point of the grid, in C order.

    What is drawn at random is the last axis, `draw`, each of whose values is a dict of hyperparameters.
    """
    name = registered_name(METHODS, cls)
    if not isinstance(grid, Mapping):
        raise InputError(f"grid must be a dict from hyperparameters to values, not {shown(grid)}")
    if wrong := [key for key in grid if not isinstance(key, str)]:
        raise InputError(f"the keys of grid must be names of hyperparameters, not {shown(wrong[0])}")
    fields = {field.name: field for field in dataclasses.fields(cls)}  # pyright: ignore[reportArgumentType]

    def plain(parameter: str, value: Any) -> Any:
        """A NumPy or JAX number as a Python number, and "glie" as the schedule that it is."""
        value = value.item() if isinstance(value, np.generic | np.ndarray | jax.Array) else value
        is_text = isinstance(value, str) and parameter in fields
        return checked(name, fields[parameter], value) if is_text else value

    axes, single = {}, {}
    for parameter, values in spread(grid, num_draws, seed, name).items():
        if isinstance(values, Set | Iterator):
            problem = f"the grid of {parameter} must be a list, which has an order and a length, not {shown(values)}"
            raise InputError(problem, field=parameter, wanted="a list", value=values)
        if is_list(values):
            if any(map(is_list, values)):
                one = (
                    "a matrix [S, n] is one value where it is approx.Rows(matrix)"
                    if parameter == "features"
                    else "probabilities [S, A] are one value where they are a policies.Table"
                )
                problem = f"the grid of {parameter} must be a flat list, not {shown(values)}; {one}"
                raise InputError(problem, field=parameter)
            axes[parameter] = tuple(plain(parameter, value) for value in values)
        else:
            single[parameter] = plain(parameter, values)
    for parameter, values in axes.items():
        if not values:
            raise InputError(f"the grid of {parameter} is empty", field=parameter)
        if parameter != DRAW and (again := repeated(map(label, values))):
            problem = f"the grid of {parameter} holds {one_line(str(again[0]))} more than once"
            raise InputError(problem, field=parameter)
    sizes = [len(values) for values in axes.values()]
    check_settings(math.prod(sizes), f"{' x '.join(map(str, sizes))} values of {', '.join(axes)}")
    swept = [name for name in axes if name != DRAW]

    def instance(point: tuple) -> Algorithm:
        *values, trial = point if DRAW in axes else (*point, {})  # draws are the last axis
        return build(cls, name, single | dict(zip(swept, values, strict=True)) | trial)

    return axes, [instance(point) for point in itertools.product(*axes.values())]


def _exact_value(
    env: Environment, axes: Mapping[str, tuple], configs: Sequence[Algorithm]
) -> Float[np.ndarray, "*gammas"]:
    """What the runs are measured by, as `SweepResult.optimal_value` has it."""

    def value(gamma: float) -> float:
        values = {_judge(env, config) for config in _different(configs, gamma)}
        return values.pop() if len(values) == 1 else np.nan  # one for each pi, say

    gammas = axes.get("gamma") or [trial["gamma"] for trial in axes.get(DRAW, ()) if "gamma" in trial]
    return np.array([value(gamma) for gamma in gammas] if gammas else value(configs[0].gamma))


def _references(part: Part) -> dict[str, Float[np.ndarray, "*grid"]]:
    """What `value_error` is measured by, as `SweepResult.references` has it."""
    if not part.budget.exact or "value_error" not in exact_fields(part.configs[0], part.env):
        return {}
    errors, known = [], {}
    for config in cast(list[Any], part.configs):
        # Tables are not compared entry by entry, as in `_different`.
        key = config.features, config.gamma, id(config.pi), id(getattr(config, "behaviour", None))
        if key not in known:
            known[key] = _least_and_td(config, part.env)
        errors.append(known[key])
    shape = [len(values) for values in part.axes.values()]
    names = "least_value_error", "td_value_error"
    # A list, for of one setting alone NumPy would give a number that is no array.
    return {
        name: np.array(values).reshape(shape)
        for name, values in zip(names, zip(*errors, strict=True), strict=True)
    }


def _least_and_td(config: Any, env: Environment) -> tuple[float, float]:
    """The root of VE that the best weights have, and that of the TD fixed point; NaN where there is none."""
    try:
        values = config.linear_values(env)
    except InputError:
        return np.nan, np.nan
    least = values.value_error(values.best_weights()) ** 0.5
    try:
        return least, values.value_error(values.td_fixed_point()) ** 0.5
    except InputError:
        return least, np.nan


def _different(configs: Sequence[Algorithm], gamma: float) -> list[Algorithm]:
    """The configurations with this gamma whose exact values may differ: of prediction one for each pi."""
    same = [config for config in configs if config.gamma == gamma]
    if of_method(same[0]).learns is not Learns.STATES:
        return same[:1]
    # Tables are not compared entry by entry: the configurations of one Table in the grid share the object.
    by_pi: dict[int, Any] = {id(config.pi): config for config in cast(list[Any], same)}
    return list(by_pi.values())


def _judge(env: Environment, config: Any) -> float:
    """The exact value from the start of what `config` learns; NaN where there is no finite answer."""
    of_states, declared = of_method(config).learns is Learns.STATES, of_environment(env)
    if declared.instance is not None:  # a problem for each run: an environment may know the mean over them
        mean = declared.mean_optimal_value
        return np.nan if mean is None or of_states else mean(config.gamma)
    in_the_long_run = of_method(config).in_the_long_run
    if declared.at is not None or in_the_long_run or not isinstance(env, FiniteEnvironment):
        return np.nan
    if of_states:
        return config.exact_value(env)
    try:
        return planning.start_value(env, planning.value_iteration(env, config.gamma)[0])
    except InputError:
        return np.nan
