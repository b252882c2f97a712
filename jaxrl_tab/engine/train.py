"""One run of a method in an environment, checked, compiled, and measured.

`train` is a pure function of a key: `jit` and `vmap` work on it, and `sweep` is nothing but that.
"""

from dataclasses import is_dataclass
from functools import partial
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PRNGKeyArray

from jaxrl_tab.algorithms.prediction import METHODS
from jaxrl_tab.core import rng, schedules
from jaxrl_tab.core.checks import check_held, check_pytree, concrete
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.types import Algorithm, Environment, available_actions, init_learner, restricted
from jaxrl_tab.engine import loop
from jaxrl_tab.engine.budget import Budget, Record
from jaxrl_tab.engine.log import Log, recorded
from jaxrl_tab.engine.loop import Measured
from jaxrl_tab.envs import ENVS
from jaxrl_tab.exact import planning
from jaxrl_tab.lanes.outside import prepared

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
    record: Record | None = None,
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
        exact: also record `greedy_value` and `q_error`, or `v_error`, at the end of every row, right to 1e-6
            of themselves (`planning.measurer`): they are computed in float64, from the numbers that
            `algorithm` and `env` were given. It enumerates the environment, and for control solves a linear
            system in each row: S^3 / 3 multiply-adds (0.08 ms for 70 states on one core).
        record: a function from the state of the learner to a dict of arrays, such as
            `lambda state: {"q_start": state.q[30].max()}`; recorded at the end of every row.

    Returns:
        The state of the learner (`.q` is float [S, A]), and the Log.

    Raises:
        InputError: a number is out of range, or `exact` is asked of an environment without `outcomes`.
    """
    if isinstance(algorithm, Environment):
        algorithm, env = env, algorithm
    algorithm, env = cast(Algorithm[L], algorithm), cast(Environment, env)
    budget = Budget(num_steps, num_episodes, log_every, bool(exact), record)
    rng.check_key(key)
    check_pytree("algorithm", algorithm, METHODS)
    if is_dataclass(algorithm):
        schedules.check_single(type(algorithm).__name__, algorithm)
    check_pytree("env", env, ENVS)
    check_held(env)
    restricted(algorithm, available_actions(env))  # raises InputError where the actions do not fit the method
    if exact:
        planning.check_finite(env)
    full = in_full((algorithm, env)) if exact else None
    return unchecked(key, algorithm, env, full, budget)


# Compiled by itself where nobody else does, so that a second call is quick; inlined where somebody does.
@partial(jax.jit, static_argnums=4, inline=True)
def unchecked(
    key: PRNGKeyArray,
    algorithm: Any,
    env: Any,
    full: Any,
    budget: Budget,
) -> tuple[Any, Log]:
    """`train` without its checks. `full` is `in_full((algorithm, env))` for exact values, or None."""
    stream = rng.stream(key)
    if (instance := of_environment(env).instance) is not None:
        env = instance(rng.as_key(rng.word(stream, jnp.int32(0), loop.INSTANCE)))
        full = full and (full[0], env)  # it is drawn in the precision of the program
    measure = _make_measure(algorithm, env, full, budget.record)
    algorithm = restricted(algorithm, available_actions(env))
    return loop.run(stream, algorithm, env, budget, measure)


def in_full(obj: T) -> T:
    """All numbers of a method or an environment in float64, each as two words; what is traced, as it is.

    A program in float32 can be given no other numbers: 0.99 would become 0.9900000095, and v, which goes with
    1 / (1 - gamma), would be off by 1e-6.
    """

    def words(x: Any) -> Any:
        if not jnp.issubdtype(jax.typeof(x).dtype, jnp.floating) or (number := concrete(x)) is None:
            return x
        return number.astype(np.float64)[..., None].view(np.uint32)

    return jax.tree.map(words, obj)


def _restored(full: T, obj: T) -> T:
    """What was given to `in_full`, whose numbers in the program are `obj`."""

    def number(words: Any, x: Any) -> Any:
        same = jnp.result_type(words) == jnp.result_type(x)
        return x if same or not planning.has_double() else lax.bitcast_convert_type(words, jnp.float64)

    return jax.tree.map(number, full, obj)


# --- what is measured at the end of a row -----------------------------------------------------------


def _make_measure(
    algorithm: Algorithm, env: Environment, full: Any, record: Record | None
) -> Measured | None:
    """What is measured at the end of a row, from the state of the learner, as fields of the Log."""
    if full is None and record is None:
        return None

    def make(algorithm: Algorithm, env: Environment, full: Any) -> Measured:
        measures = []
        if full is not None:
            with planning.doubled():
                exact_algorithm, exact_env = _restored(full, (algorithm, env))
                exact_algorithm = restricted(exact_algorithm, available_actions(exact_env))
            measures.append(_exact_measurer(exact_algorithm, exact_env))
        if record is not None:
            of_learner = partial(recorded, record, algorithm)
            measures.append(lambda learner: {"recorded": of_learner(learner)})
        return lambda learner: {name: x for measure in measures for name, x in measure(learner).items()}

    like = jax.eval_shape(lambda: init_learner(restricted(algorithm, available_actions(env)), env))
    return prepared(make, algorithm, env, full, like=like)


def _exact_measurer(algorithm: Any, env: Environment) -> Measured:
    """The exact numbers beside a method: in prediction those of its own `measurer`."""
    if of_method(algorithm).learns is Learns.STATES:
        return algorithm.measurer(env)
    measure = planning.measurer(env, algorithm.gamma)
    return lambda learner: dict(zip(("greedy_value", "q_error"), measure(learner.q), strict=True))
