"""One run as a function that is traced: with the problem that it draws, and what is measured at the ends of rows."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PRNGKeyArray

from jaxrl_tab.core import memory, rng
from jaxrl_tab.core.checks import concrete
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.types import Algorithm, Environment, fitted, init_learner, table_of
from jaxrl_tab.engine import loop
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.log import Log, Recording, record_of, recorded
from jaxrl_tab.engine.loop import Measure
from jaxrl_tab.engine.onward import split, without_table
from jaxrl_tab.exact import planning
from jaxrl_tab.lanes.outside import prepared

T = TypeVar("T")
WAITING = 2**13  # bytes of a run: states of the learner at the ends of rows, until they are measured


# Compiled by itself where nobody else does, so that a second call is quick; inlined where somebody does.
@partial(jax.jit, static_argnums=4, inline=True)
def unchecked(
    key: PRNGKeyArray,
    algorithm: Any,
    env: Any,
    full: Any,
    budget: Budget,
) -> tuple[Any, Log]:
    """`train.train` without its checks. `full` is `in_full((algorithm, env))` for exact values, or None.

    Of a method that is `Onward` it gives where the run is in the end, in place of the state of the learner.
    """
    stream = rng.stream(key)
    algorithm, begun, goes_on = split(algorithm)
    if (problem := problem_of(stream, env)) is not env:
        env = problem
        full = full and (full[0], env)  # it is drawn in the precision of the program
    measures = tuple(_make_measure(what, algorithm, env, full) for what in _measured(algorithm, budget))
    algorithm = fitted(algorithm, env)
    end, log = loop.run(stream, algorithm, env, budget, measures, begun)
    return (end if goes_on else end.learner), log


def gives(algorithm: Any, env: Any, budget: Budget) -> tuple[tuple[Any, ...], Any, Any]:
    """Arrays of the shapes of what a run gives, and of what it carries beside. No step and no exact value is traced.

    Returns:
        (table, Log), and where the run is in the end, but for the table, of a method that is `Onward`; what else is
        in the state of the learner; and states of it that wait to be measured, with what its update works with.
    """
    method, _, goes_on = split(algorithm)
    algorithm = fitted(method, env)
    learner = init_learner(algorithm, env)
    q = table_of(algorithm, env.num_states, learner)  # some methods work it out
    others = [x for x in jax.tree.leaves(learner) if x is not q]
    measured, waiting = {}, None
    if budget.exact:
        measured |= dict.fromkeys(exact_fields(algorithm, env), jnp.zeros((), q.dtype))
    if (record := record_of(budget.record, algorithm)) is not None:
        measured["recorded"] = recorded(record, algorithm, learner)
    rows = max((rows_at_once(what, algorithm, learner) for what in _measured(algorithm, budget)), default=1)
    if rows > 1:
        waiting = jax.tree.map(lambda x: jnp.zeros((rows, *x.shape), x.dtype), learner)
    works_with = of_method(algorithm).works_with
    beside = (waiting, None if works_with is None else works_with(learner))
    results = q, loop.empty_log(q.dtype, budget, measured)
    if goes_on:
        end = loop.any_start(algorithm, problem_of((jnp.uint32(0), jnp.uint32(0)), env))
        results = *results, without_table(end, place_of_table(algorithm, env, end.learner))
    return results, others, beside


def place_of_table(algorithm: Any, env: Any, learner: Any) -> int | None:
    """Which leaf of the state of a learner is its table; None where that is worked out of others."""
    places = []

    def look(learner: Any) -> None:
        table = table_of(algorithm, env.num_states, learner)
        places.append(next((i for i, x in enumerate(jax.tree.leaves(learner)) if x is table), None))

    jax.eval_shape(look, learner)  # in which no two leaves are the same array
    return places[0]


def problem_of(stream: rng.Stream, env: Any) -> Any:
    """The environment of a run; where each run has a problem of its own, that one."""
    instance = of_environment(env).instance
    return env if instance is None else instance(rng.as_key(rng.word(stream, jnp.int32(0), loop.INSTANCE)))


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


class _Measured(NamedTuple):
    """What is measured together.

    Attributes:
        exact: whether exact values are.
        record: what is recorded besides.
        every: of how many rows in one.
    """

    exact: bool
    record: Recording | None
    every: int = 1


def _measured(algorithm: Any, budget: Budget) -> list[_Measured]:
    """What is measured in a run: all together, but exact values apart where fewer rows have them."""
    record = record_of(budget.record, algorithm)
    if budget.exact and budget.exact_row > 1 and _solves(algorithm):
        own = [_Measured(False, record)] if record else []
        return [*own, _Measured(True, None, budget.exact_row)]
    return [_Measured(budget.exact, record)] if budget.exact or record else []


def _make_measure(what: _Measured, algorithm: Algorithm, env: Environment, full: Any) -> Measure:
    """How it is measured."""
    record, full = what.record, full if what.exact else None

    def make(algorithm: Algorithm, env: Environment, full: Any) -> Callable[[Any], dict[str, Any]]:
        measures = []
        if full is not None:
            with planning.doubled():
                exact_algorithm, exact_env = _restored(full, (algorithm, env))
                exact_algorithm = fitted(exact_algorithm, exact_env)
            acting = fitted(algorithm, env)
            measures.append(_exact_measurer(exact_algorithm, exact_env, acting))
        if record is not None:
            of_learner = partial(recorded, record, fitted(algorithm, env))
            measures.append(lambda learner: {"recorded": of_learner(learner)})
        return lambda learner: {name: x for measure in measures for name, x in measure(learner).items()}

    fit = fitted(algorithm, env)
    like = jax.eval_shape(lambda: init_learner(fit, env))
    if record is not None and _is_free(what, fit, like):
        return Measure(lambda learner: {"recorded": recorded(record, fit, learner)}, most=1)
    at_once = rows_at_once(what, fit, like)
    return Measure(prepared(make, algorithm, env, full, like=like), at_once, what.every)


def _is_free(what: _Measured, algorithm: Any, learner: Any) -> bool:
    """Whether all of it stands in the state of the learner, so that XLA has nothing to work out."""
    if what.exact or what.record is None:
        return False
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), learner)
    return not jax.make_jaxpr(partial(recorded, what.record, algorithm))(like).eqns


def rows_at_once(what: _Measured, algorithm: Any, learner: Any) -> int:
    """Of how many rows it is measured at once: of as many as may wait in `WAITING` bytes.

    Of one, where that solves a linear system, or takes nothing at all.
    """
    if (what.exact and _solves(algorithm)) or _is_free(what, algorithm, learner):
        return 1
    return max(1, WAITING // max(1, memory.size(learner)))


def _solves(algorithm: Any) -> bool:
    """Whether the exact values of a method are those of its policies, which are linear systems to be solved."""
    return of_method(algorithm).learns is not Learns.STATES


def _exact_measurer(algorithm: Any, env: Environment, acting: Any) -> Callable[[Any], dict[str, Any]]:
    """The exact numbers beside a method: in prediction those of its own `measurer`.

    `acting` is the method with its numbers in the precision of the program, in which it acts.
    """
    if not _solves(algorithm):
        return algorithm.measurer(env)
    fields = exact_fields(acting, env)
    is_average = of_method(algorithm).in_the_long_run
    of_table = planning.long_run_measurer(env) if is_average else planning.measurer(env, algorithm.gamma)
    states = np.arange(env.num_states, dtype=np.int32)

    @planning.in_turn
    def measure(learner: Any) -> dict[str, Any]:
        policies = [jax.vmap(acting.probs, (None, 0))(learner, states)] if "policy_value" in fields else []
        greedy_value, q_error, *values = of_table(table_of(acting, env.num_states, learner), *policies)
        found = {"greedy_value": greedy_value, "q_error": q_error} | dict(
            zip(fields[-1:], values, strict=False)
        )
        return {name: found[name] for name in fields}

    return measure


def exact_fields(algorithm: Any, env: Environment) -> tuple[str, ...]:
    """The fields of the Log that exact values of a method are recorded in."""
    if not _solves(algorithm):
        return of_method(algorithm).measures[: None if env.num_states else 1]
    acts = ("policy_value",) if hasattr(algorithm, "probs") else ()
    errors = ("q_error",) if of_method(algorithm).learns is Learns.ACTIONS else ()
    return ("greedy_value", *errors, *acts)
