"""What the one-step temporal-difference methods share: everything but the target."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab import policies, schedules, tables
from jaxrl_tab.policies import EpsilonGreedy, Policy
from jaxrl_tab.schedules import Clock, Rate, check_number
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
    """One-step control with an epsilon-greedy, or any other, behaviour policy. A method adds its `update`.

    Attributes:
        alpha: step size, > 0; a number or a schedule.
        epsilon: probability of exploring, in [0, 1]; a number or a schedule.
        gamma: discount rate, in [0, 1].
        q0: initial value of every entry of Q; above the true values it is optimistic (book, section 2.6).
        behaviour: how actions are chosen, instead of epsilon-greedy: Softmax, UCB, ... (see `policies`).
    """

    alpha: Rate = 0.1
    epsilon: Rate = 0.1
    gamma: float = 1.0
    q0: float = 0.0
    behaviour: Policy | None = None

    def __post_init__(self):
        check_number(self, "alpha", lambda x: x > 0, "greater than 0")
        check_number(self, "epsilon", lambda x: (x >= 0) & (x <= 1), "between 0 and 1")
        check_number(self, "gamma", lambda x: (x >= 0) & (x <= 1), "between 0 and 1")
        check_number(self, "q0", lambda x: x == x, "a number")
        policies.check_policy(self, "behaviour")
        given = concrete(self.epsilon)
        if self.behaviour is not None and given is not None and np.any(given != TDControl.epsilon):
            raise InputError(f"{type(self).__name__}: give epsilon or behaviour, not both")

    @property
    def selection(self) -> Policy:
        """The behaviour policy: as given, or else epsilon-greedy."""
        return EpsilonGreedy(self.epsilon) if self.behaviour is None else self.behaviour

    def init(self, num_states: int, num_actions: int) -> TDState:
        self.selection.check(num_states, num_actions)
        q = jnp.full((num_states, num_actions), self.q0, dtype=float)
        by_visit = schedules.goes_by_visit(self.alpha) or self.selection.by_visit
        return TDState(q, schedules.start(num_states, num_actions, by_visit))

    def probs(self, state: TDState, s: Int[Array, ""]) -> Float[Array, " A"]:
        """The behaviour policy pi(. | s), float [A]."""
        return self.selection.probs(tables.row(state.q, s), state.clock, s)

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
