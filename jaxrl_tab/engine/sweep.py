"""A grid of hyperparameters times seeds, in one call."""

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from numbers import Integral
from typing import Any, Literal, NamedTuple, cast

import jax
import numpy as np
from jaxtyping import Float

from jaxrl_tab.algorithms.prediction import METHOD, METHODS
from jaxrl_tab.core import names, rng
from jaxrl_tab.core.checks import (
    InputError,
    build,
    check_held,
    check_pytree,
    checked,
    foreign,
    one_line,
    repeated,
    shown,
    whole,
)
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.types import Algorithm, Environment, FiniteEnvironment, available_actions, restricted
from jaxrl_tab.engine import batch
from jaxrl_tab.engine.axes import DRAW, check_settings, spread, swept_names
from jaxrl_tab.engine.budget import Budget, Record
from jaxrl_tab.engine.results import SweepResult, label, parameters
from jaxrl_tab.engine.room import plan
from jaxrl_tab.engine.train import Log
from jaxrl_tab.envs import ENVS
from jaxrl_tab.envs.base import samples_outcomes
from jaxrl_tab.exact import planning
from jaxrl_tab.show.progress import Progress, Report, reporting

BEYOND = 10  # times the largest possible return: step sizes above 1 and traces go beyond it, and come back
FRESH = 2**32 - 1  # what is folded into a root for the root of its fresh seeds


class Computed(NamedTuple):
    """What some runs gave.

    Attributes:
        q: their final tables, float [n, S, A].
        log: what happened, [n, rows] each; see `train.Log`.
        seconds: how long it took.
    """

    q: np.ndarray
    log: Log
    seconds: batch.Seconds


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One method in one environment, with every combination of hyperparameters and every seed: to be run.

    Its runs have numbers, 0 to `runs` - 1: the number of the configuration times `num_seeds` plus the place
    of the seed. A run with the seed at place i has the key `fold_in(key(seed), first_seed + i)`.

    Fresh seeds must be seeds of no other sweep, not even of a larger one of the same root. So they have a
    root of their own, `fold_in(key(seed), FRESH)`, in place of `key(seed)`: no sweep has a seed with this
    number, for numbers of seeds are below 2**31.

    Attributes:
        env: the environment.
        algorithm: the class of the method.
        axes: the swept hyperparameters in the order of the axes, each with its values.
        configs: an instance of the method for every point of the axes, in C order.
        num_seeds, first_seed: how many seeds there are, and the first of them.
        seed: the root seed.
        budget: how long each run is and what it records.
        fresh: whether the seeds are fresh ones, of the root that is kept for them.
    """

    env: Environment
    algorithm: type[Algorithm]
    axes: dict[str, tuple]
    configs: list[Algorithm]
    num_seeds: int
    first_seed: int
    seed: int
    budget: Budget
    fresh: bool = False

    @property
    def root(self) -> Any:
        """The key whose folds are those of the runs."""
        key = rng.key(self.seed)
        return jax.random.fold_in(key, FRESH) if self.fresh else key

    @property
    def runs(self) -> int:
        return len(self.configs) * self.num_seeds

    @functools.cached_property
    def largest_values(self) -> Float[np.ndarray, " configs"]:
        """Of each configuration, the |Q| beyond which a run has diverged; infinite where that is not judged.

        It is `BEYOND` times what no average of returns exceeds: the initial value, and the largest return of
        as many steps as the run has. Judged are environments whose rewards are those of their outcomes, and
        methods that multiply no return by ratios.
        """
        budget, env = self.budget, self.env
        steps = budget.num_steps or (budget.num_episodes or 0) * env.max_steps
        of_outcomes = samples_outcomes(env) and of_environment(env).instance is None

        @functools.cache
        def largest_return(gamma: float, anywhere: bool) -> float:
            return planning.largest_return(env, gamma, steps, anywhere)

        def largest(config: Any) -> float:
            method = of_method(config)
            if not of_outcomes or method.multiplies_returns:
                return np.inf
            initial = abs(getattr(config, method.learns.initial, 0.0))
            return BEYOND * (initial + largest_return(config.gamma, method.exploring_starts))

        return np.array([largest(config) for config in self.configs])

    @functools.cached_property
    def programs(self) -> list[np.ndarray]:
        """The numbers of the configurations that run as one program, int [configs] ascending, for each."""
        return [np.array(members) for members in _same_program(self.configs)]


def sweep(
    env: Environment | type[Algorithm] | str,
    algorithm: type[Algorithm] | str | Environment,
    grid: Mapping[str, Any] | None = None,
    *,
    num_seeds: int,
    num_draws: int | None = None,
    num_steps: int | None = None,
    num_episodes: int | None = None,
    log_every: int | None = None,
    seed: int = 0,
    exact: bool = False,
    record: Record | None = None,
    memory: int | None = None,
    progress: Report | Literal[False] | None = None,
) -> SweepResult:
    """Runs a method with every combination of hyperparameters, each over the same seeds.

    Seed i has the key `fold_in(key(seed), i)` in every configuration: common random numbers, which pair the
    configurations. What a run gives depends on that key and on its hyperparameters alone, bitwise.

    Args:
        env: the environment.
        algorithm: a class such as `Sarsa`, or its name: "sarsa", "mine.py:Mine" (see `core.names`). It may also
            stand before the environment, as in `train`.
        grid: for each hyperparameter a list of values (an axis of the result) or a single value. A value
            is a number, a schedule or a policy. Besides lists there are grids in steps and random draws,
            such as `LogGrid(0.01, 1, 5)` and `LogUniform(0.01, 1)`: see `axes`. What is not named keeps its
            default.
        num_seeds: how many seeds, at least 1.
        num_draws: how many trials of what is drawn at random; they are the axis `draw` of the result.
        num_steps, num_episodes, log_every, exact, record: as in `train`.
        seed: which sequence of seeds, a whole number >= 0.
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
    part = prepare(
        env,
        algorithm,
        grid,
        Budget(num_steps, num_episodes, log_every, bool(exact), record),
        num_seeds=num_seeds,
        num_draws=num_draws,
        seed=seed,
    )
    state = Progress(f"{_name_in(METHODS, part.algorithm)} in {_name_in(ENVS, type(env))}", 0, part.runs)
    with reporting(progress) as report:
        begun = time.perf_counter()

        def tell(done: int, steps: int) -> None:
            seconds = time.perf_counter() - begun
            left = seconds * (part.runs - done) / done
            report(state._replace(done=done, steps=steps, seconds=seconds, left=left))

        report(state)
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
        first_seed: the first of the `num_seeds` seeds, which follow each other.
        Others: as in `sweep`.

    Raises:
        InputError: something given is wrong.
    """
    names.check_not_importing()
    for name, value, least in (("num_seeds", num_seeds, 1), ("seed", seed, 0), ("first_seed", first_seed, 0)):
        whole(None, name, value, least)
    if not isinstance(env, Environment):
        raise InputError(
            f"env must be an environment such as make('windy-gridworld'), not {shown(env)}{foreign(env)}"
        )
    check_pytree("env", env)
    check_held(env)
    if budget.exact:
        planning.check_finite(env)
    if isinstance(env, FiniteEnvironment):
        planning.exact_model(env)  # refuses one that breaks the rules
    cls = _algorithm_class(algorithm)
    axes, configs = configurations(cls, {} if grid is None else grid, num_draws, seed)
    check_pytree(cls.__name__, configs[0])
    if len(configs) * num_seeds >= 2**31:
        raise InputError(
            f"{len(configs):,} settings x {num_seeds:,} seeds are more than the 2**31 runs that can be numbered: "
            "take fewer seeds or settings"
        )
    available = available_actions(env)
    for config in configs:
        restricted(config, available)  # only to refuse what cannot be
    return Part(env, cls, axes, configs, int(num_seeds), int(first_seed), int(seed), budget)


def compute(
    part: Part,
    runs: np.ndarray | None = None,
    *,
    memory: int | None = None,
    progress: Callable[[int, int], None] = lambda done, steps: None,
) -> Computed:
    """What some runs of a part give, in the order of `runs`; bitwise what they are among all runs.

    Args:
        runs: their numbers, int [n]; all by default.
        memory: as in `sweep`.
        progress: is called with the number of runs finished and of the steps they took, as blocks of them
            finish.

    Raises:
        InputError: there is not enough memory; nothing was compiled.
    """
    root = part.root
    instances = [leaves_as_arrays(part.configs[members[0]]) for members in part.programs]
    total = part.runs if runs is None else len(runs)
    results, room = plan(part.env, instances, root, total, part.budget, memory)
    config, place = np.divmod(np.arange(total) if runs is None else runs, part.num_seeds)
    done, steps, running, compiling = 0, 0, 0.0, 0.0

    def keep(finished: np.ndarray, tables_and_log: Any) -> None:
        nonlocal steps
        results.write(at[finished], tables_and_log)
        steps += int(tables_and_log[1].steps.sum(dtype=np.int64))

    for members in part.programs:
        at = np.flatnonzero(np.isin(config, members))
        if not len(at):
            continue
        leaves = (leaves_as_arrays(part.configs[i]) for i in members)
        stacked = jax.tree.map(lambda *x: np.stack(x)[:, None], *leaves)
        seeds = part.first_seed + np.arange(part.num_seeds, dtype=np.uint32)
        seeds = np.broadcast_to(seeds, (len(members), part.num_seeds))
        within = np.searchsorted(members, config[at]) * part.num_seeds + place[at]
        report = lambda n, done=done: progress(done + n, steps)
        seconds = batch.run(part.env, stacked, root, seeds, part.budget, keep, report, room, runs=within)
        done, running, compiling = done + len(at), running + seconds.running, compiling + seconds.compiling
    q, log = results.arrays
    return Computed(q, log, batch.Seconds(running, compiling))


def result(part: Part, computed: Computed) -> SweepResult:
    """The result of a sweep from what all runs of it gave, in the order of their numbers."""
    axes, first = part.axes, part.configs[0]
    method = of_method(first)
    # Where a behaviour policy is given epsilon is not looked at, and it would mislead to show it.
    unused = {"epsilon"} if method.behaviour is not None else set()
    shape = (*(len(values) for values in axes.values()), part.num_seeds)
    q, log = jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), (computed.q, computed.log))
    return SweepResult(
        environment=_name_in(ENVS, type(part.env)),
        algorithm=_name_in(METHODS, part.algorithm),
        learns=method.learns,
        env=part.env,
        grid=axes,
        fixed={k: value for k, value in parameters(first).items() if k not in {*swept_names(axes), *unused}},
        log=log,
        q=q,
        optimal_value=_exact_value(part.env, axes, part.configs),
        root_seed=part.seed,
        first_seed=part.first_seed,
        largest_value=part.largest_values.reshape(shape[:-1]),
        fresh=part.fresh,
        num_steps=part.budget.num_steps,
        num_episodes=part.budget.num_episodes,
        log_every=part.budget.row,
        seconds=computed.seconds.running,
        compile_seconds=computed.seconds.compiling,
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
    name = _name_in(METHODS, cls)
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
        if _is_list(values):
            if any(map(_is_list, values)):
                problem = (
                    f"the grid of {parameter} must be a flat list, not {shown(values)}; "
                    "probabilities [S, A] are one value where they are a policies.Table"
                )
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
        *values, trial = point if DRAW in axes else (*point, {})
        return build(cls, name, single | dict(zip(swept, values, strict=True)) | trial)

    return axes, [instance(point) for point in itertools.product(*axes.values())]


def _is_list(value: Any) -> bool:
    if isinstance(value, np.ndarray | jax.Array):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def leaves_as_arrays(algorithm: Algorithm) -> Algorithm:
    """Numbers as float64, of which JAX takes as much as it uses: a Python float would be another program."""
    return jax.tree.map(lambda x: np.asarray(x, np.float64), algorithm)


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
    if "gamma" in swept_names(axes):
        return np.array([value(trial["gamma"]) for trial in axes[DRAW]])
    return np.array(value(configs[0].gamma))


def _different(configs: Sequence[Algorithm], gamma: float) -> list[Algorithm]:
    """Those with this gamma whose exact values may differ: of control one, of prediction one for each pi."""
    same = [config for config in configs if config.gamma == gamma]
    if of_method(same[0]).learns is Learns.ACTIONS:
        return same[:1]
    by_pi: dict[int, Any] = {id(config.pi): config for config in cast(list[Any], same)}
    return list(by_pi.values())


def _judge(env: Environment, config: Any) -> float:
    """The exact value from the start of what `config` learns; NaN where there is no finite answer."""
    of_states, declared = of_method(config).learns is Learns.STATES, of_environment(env)
    if declared.instance is not None:  # a problem for each run: an environment may know the mean over them
        mean = declared.mean_optimal_value
        return np.nan if mean is None or of_states else mean(config.gamma)
    if not isinstance(env, FiniteEnvironment):
        return np.nan
    if of_states:
        return config.exact_value(env)
    try:
        return planning.start_value(env, planning.value_iteration(env, config.gamma)[0])
    except InputError:
        return np.nan
