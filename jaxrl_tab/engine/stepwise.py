"""One run, one step at a time, for somebody who looks at each step.

A step takes the random words that it takes in `loop.run`, and is compiled as the body of a loop, as it is there: so
what is learned is the same, to the last bit.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxrl_tab.algorithms import PolicyGradient, TDControl
from jaxrl_tab.algorithms.prediction import Prediction
from jaxrl_tab.core import rng
from jaxrl_tab.core.types import Transition, fitted, table_of
from jaxrl_tab.engine import loop
from jaxrl_tab.engine.loop import Happened, Run
from jaxrl_tab.engine.traced import problem_of


class Step(NamedTuple):
    """A step of a run.

    Attributes:
        happened: what happened.
        delta: the error that the method learned from, float []; NaN where it did not learn from one error.
        q: the table of values after the step, float [S, A].
    """

    happened: Happened
    delta: Float[Array, ""]
    q: Float[Array, "S A"]


@jax.jit
def at_start(key: PRNGKeyArray, algorithm: Any, env: Any) -> Run:
    """The run of this key at time 0."""
    return loop.at_start(*_of_run(key, algorithm, env))


@jax.jit
def after_episode(key: PRNGKeyArray, algorithm: Any, env: Any, learner: Any, t: Int[Array, ""]) -> Run:
    """The run when an episode has ended with step `t` > 0 and left this learner: the next one begins."""
    return loop.after_episode(*_of_run(key, algorithm, env), learner, t)


def next_step(key: PRNGKeyArray, algorithm: Any, env: Any, run: Run) -> tuple[Run, Step]:
    """The run one step later, and the step."""
    return _steps(jnp.int32(1), key, algorithm, env, run)


@jax.jit
def _steps(number: Int[Array, ""], key: PRNGKeyArray, algorithm: Any, env: Any, run: Run) -> tuple[Run, Step]:
    """So many steps, and the last of them. There is one alone: the compiler must not know, or it has no loop."""
    stream, method, problem = _of_run(key, algorithm, env)
    table = partial(table_of, method, problem.num_states)

    def one(_, carry: tuple[Run, Step]) -> tuple[Run, Step]:
        run, before = carry
        heard: list[Float[Array, ""]] = []
        run, happened = loop.one_step(stream, _telling(method, heard.append), problem, run)
        delta = heard[0] if len(heard) == 1 else jnp.full_like(before.delta, jnp.nan)
        return run, Step(happened, jnp.asarray(delta, before.delta.dtype), table(run.learner))

    zero, no = jnp.zeros_like(run.g), jnp.bool(False)
    nothing = Transition(run.s, run.a, zero, run.s, zero, no)
    return lax.fori_loop(0, number, one, (run, Step(Happened(nothing, no), zero, table(run.learner))))


def _of_run(key: PRNGKeyArray, algorithm: Any, env: Any) -> tuple[rng.Stream, Any, Any]:
    """The random stream of a run, the method with the actions that there are, and the problem of the run."""
    stream = rng.stream(key)
    problem = problem_of(stream, env)
    return stream, fitted(algorithm, problem), problem


def _telling(method: Any, tell: Callable[[Float[Array, ""]], None]) -> Any:
    """A method that does the same, and tells each error that it learns from (by `learn`, as `TDControl` has it)."""
    cls = type(method)

    def learn(self: Any, state: Any, t: Transition, delta: Float[Array, ""], *more: Any, **named: Any) -> Any:
        tell(delta)
        return cls.learn(self, state, t, delta, *more, **named)

    def control(self: Any, **policies: Any) -> Any:
        return _telling(cls.control(self, **policies), tell)

    if isinstance(method, TDControl | PolicyGradient) and hasattr(cls, "learn"):
        own = {"learn": learn}
    elif isinstance(method, Prediction):  # the method of control that it is made of learns
        own = {"control": control}
    else:
        return method
    twin = object.__new__(type(cls.__name__, (cls,), own))
    vars(twin).update(vars(method))
    return twin
