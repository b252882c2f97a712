"""What the one-step temporal-difference methods share: everything but the target."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab import policies, schedules, tables
from jaxrl_tab.schedules import Clock, Rate, Schedule
from jaxrl_tab.types import InputError, Transition, concrete, pytree


class TDState(NamedTuple):
    """A learner that keeps one table of action values.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
    """

    q: Float[Array, "S A"]
    clock: Clock


@pytree
class TDControl:
    """One-step control with an epsilon-greedy behaviour policy. A method adds its `update`.

    Attributes:
        alpha: step size, > 0; a number or a schedule.
        epsilon: probability of exploring, in [0, 1]; a number or a schedule.
        gamma: discount rate, in [0, 1].
        q0: initial value of every entry of Q; above the true values it is optimistic (book, section 2.6).
    """

    alpha: Rate = 0.1
    epsilon: Rate = 0.1
    gamma: float = 1.0
    q0: float = 0.0

    def __post_init__(self):
        check_number(self, "alpha", lambda x: x > 0, "greater than 0")
        check_number(self, "epsilon", lambda x: (x >= 0) & (x <= 1), "between 0 and 1")
        check_number(self, "gamma", lambda x: (x >= 0) & (x <= 1), "between 0 and 1")
        check_number(self, "q0", lambda x: x == x, "a number")

    def init(self, num_states: int, num_actions: int) -> TDState:
        q = jnp.full((num_states, num_actions), self.q0, dtype=float)
        return TDState(q, schedules.start(num_states, num_actions, self.alpha, self.epsilon))

    def probs(self, state: TDState, s: Int[Array, ""]) -> Float[Array, " A"]:
        """The behaviour policy pi(. | s), float [A]."""
        epsilon = schedules.exploration(self.epsilon, state.clock, s)
        return policies.epsilon_greedy(tables.row(state.q, s), epsilon)

    def policy(self, key: Key[Array, ""], state: TDState, s: Int[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, self.probs(state, s))

    def begin(self, state: TDState, t: Transition) -> TDState:
        """Counts the step and the visit of (S, A), before anything is learned from them."""
        return state._replace(clock=schedules.begin_step(state.clock, t.s, t.a))

    def learn(self, state: TDState, t: Transition, delta: Float[Array, ""]) -> TDState:
        """Q(S, A) <- Q(S, A) + alpha delta; and counts the episode where it is over."""
        alpha = schedules.step_size(self.alpha, state.clock, t.s, t.a)
        q = tables.add(state.q, t.s, t.a, alpha * delta)
        return state._replace(q=q, clock=schedules.end_step(state.clock, t.last))


def check_number(obj, name: str, ok, wanted: str) -> None:
    """Raises InputError unless field `name` of `obj` is a schedule, a tracer, or numbers that are `ok`."""
    value = getattr(obj, name)
    if callable(value) and not isinstance(value, Schedule):
        raise InputError(
            f"{type(obj).__name__}: {name} is a function; wrap it: schedules.Optax(f, clock='step')"
        )
    if isinstance(value, Schedule) or (number := concrete(value)) is None:
        return
    if number.dtype.kind not in "fiu" or not bool(ok(number).all()) or not np.isfinite(number).all():
        raise InputError(f"{type(obj).__name__}: {name} must be {wanted}, not {value!r}")
