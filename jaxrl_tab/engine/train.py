"""One run of a method in an environment, checked, compiled, and measured.

`train` is a pure function of a key: `jit` and `vmap` work on it, and `sweep` is nothing but that.
"""

from dataclasses import is_dataclass
from typing import Any, TypeVar, cast

import jax
from jax.core import Tracer
from jaxtyping import PRNGKeyArray

from jaxrl_tab.approx import dangers
from jaxrl_tab.core import rng, schedules
from jaxrl_tab.core.checks import check_held, check_pytree
from jaxrl_tab.core.declared import Learns, name_of, of_environment, of_method
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.names import registered_name
from jaxrl_tab.core.types import (
    Algorithm,
    Environment,
    FiniteEnvironment,
    fitted,
)
from jaxrl_tab.engine import backend, by_lanes, within
from jaxrl_tab.engine.budget import Budget, Recorder
from jaxrl_tab.engine.log import Log
from jaxrl_tab.engine.traced import in_full, unchecked
from jaxrl_tab.envs import ENVS, PREFIX
from jaxrl_tab.exact import planning
from jaxrl_tab.methods import METHODS

L = TypeVar("L")
T = TypeVar("T")


def train(
    key: PRNGKeyArray,
    algorithm: Algorithm[L] | Environment,
    env: Environment | Algorithm[L],
    *,
    num_steps: int | None = None,
    num_episodes: int | None = None,
    log_every: int | None = None,
    exact: bool = False,
    record: Recorder | None = None,
    exact_every: int | None = None,
) -> tuple[L, Log]:
    """Runs `algorithm` in `env` and returns what it learned and what happened.

    Args:
        key: a JAX key; the run is a function of it and of the hyperparameters.
        algorithm: the method with its hyperparameters.
        env: the environment. It may also stand before the method, as in `sweep`.
        num_steps: how many steps to take. Give this or `num_episodes`.
        num_episodes: how many episodes to finish.
        log_every: steps in a row of the log (100), or episodes in a row (1). The last row may be shorter.
            Sums are plain running sums in float32: exact for whole rewards up to 2**24, so do not make rows
            of millions of steps.
        exact: also record `greedy_value`, `policy_value` and `q_error`, or `v_error` (of prediction with
            features also `value_error`, `bellman_error` and `projected_bellman_error`), at the end of every row,
            right to 1e-6 of themselves (`planning.measurer`): they are computed in float64, from the numbers
            that `algorithm` and `env` were given. It enumerates the environment, and for control solves two
            linear systems in each row, of S^3 / 3 multiply-adds each: on one core 0.1 ms in all for 70 states, 0.9
            ms for 201.
        record: a function from the state of the learner to a dict of arrays, such as
            `lambda state: {"q_start": state.q[30].max()}`; recorded at the end of every row.
        exact_every: exact values of control in one of so many rows only, and in the last; NaN in the others. It makes
            `exact` true.

    Derivatives with respect to the numbers of the method are forward-mode (`jax.jvp`, `jax.jacfwd`, also under
    `vmap`). The run goes as it goes, and they say how what it learns, and what that is worth, changes with alpha,
    lambda or epsilon. For control that is not all: where a number changes the actions that are taken, everything
    jumps, and no derivative sees it.

    Returns:
        The state of the learner (`.q` is float [S, A]), and the Log.

    Raises:
        InputError: a number is out of range, or `exact` is asked of an environment without `outcomes`.
    """
    budget = Budget(num_steps, num_episodes, log_every, bool(exact), record, exact_every)
    rng.check_key(key)
    algorithm, env = checked_pair(algorithm, env)
    if budget.exact:
        check_exact(algorithm, env)
    by_compiler = within.train if _is_traced((key, algorithm, env)) else by_lanes.alone
    if learned := by_compiler(key, algorithm, env, budget):
        return learned
    full = in_full((algorithm, env)) if budget.exact else None
    return unchecked(key, algorithm, env, full, budget)


def checked_pair(
    algorithm: Algorithm[L] | Environment, env: Environment | Algorithm[L]
) -> tuple[Algorithm[L], Environment]:
    """A method for one run and its environment, in this order, whichever was given first.

    Raises:
        InputError: one of them is wrong, or they do not fit.
    """
    if isinstance(algorithm, Environment):
        algorithm, env = env, algorithm
    algorithm, env = cast(Algorithm[L], algorithm), cast(Environment, env)
    check_pytree("algorithm", algorithm, METHODS)
    if not isinstance(algorithm, Algorithm):
        raise InputError(f"algorithm must be a method such as Sarsa(), not {shown(algorithm)}")
    if is_dataclass(algorithm):
        schedules.check_single(type(algorithm).__name__, algorithm)
    check_pytree("env", env, ENVS)
    if not isinstance(env, Environment):
        raise InputError(f"env must be an environment such as make('windy-gridworld'), not {shown(env)}")
    check_held(env)
    check_end(algorithm, env)
    fitted(algorithm, env)  # raises InputError where it does not fit
    for line in dangers.step_sizes([algorithm], env):
        backend.tell(line)
    return algorithm, env


def check_exact(method: Any, env: Environment) -> None:
    """Raises InputError where nothing exact is known beside a method, or its class."""
    is_known = of_environment(env).known_values is not None and of_method(method).learns is Learns.STATES
    if env.num_states or not is_known:
        planning.check_lasting(env)


def check_end(method: Any, env: Environment) -> None:
    """Raises InputError where a method, or its class, is for tasks that end otherwise.

    That is one of the average reward where the task can end, and one that needs a horizon where it has none.
    """
    name = registered_name(METHODS, method if isinstance(method, type) else type(method))
    if of_method(method).needs_horizon and of_environment(env).horizon is None:
        own = registered_name(ENVS, type(env))
        raise InputError(
            f"{name} learns in tasks that end after a given number of steps, and {own} may go on: take "
            f"{PREFIX}:20:{own if own in ENVS else 'NAME'}, in Python FiniteHorizon(env, 20)"
        )
    if of_method(method).in_the_long_run and isinstance(env, FiniteEnvironment) and not _is_traced(env):
        with jax.ensure_compile_time_eval():
            planning.check_goes_on(env, name)
    elif of_method(method).in_the_long_run and not of_environment(env).continuing and not env.num_states:
        raise InputError(
            f"{name_of(env)} may end, and {name} is for tasks that do not end; one that does not says so by "
            "continuing = True"
        )


def _is_traced(tree: Any) -> bool:
    """Whether somebody compiles this, or makes many runs of it by `vmap`."""
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(tree))
