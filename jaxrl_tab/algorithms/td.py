"""What the one-step temporal-difference methods share: everything but the target."""

import dataclasses
from typing import Any, NamedTuple, Protocol, Self, TypeVar, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core import clock, policies, tables
from jaxrl_tab.core.checks import InputError, check_number, check_switches
from jaxrl_tab.core.clock import Clock, Rate
from jaxrl_tab.core.policies import EpsilonGreedy, Policy
from jaxrl_tab.core.pytree import concrete, pytree
from jaxrl_tab.core.schedules import check_rate
from jaxrl_tab.core.types import Transition, restricted


@runtime_checkable
class Learner(Protocol):
    """What every state of a learner has: a NamedTuple with Q and a clock."""

    @property
    def q(self) -> Float[Array, "S A"]: ...
    @property
    def clock(self) -> Clock: ...
    def _replace(self, **fields: Any) -> Any: ...


L = TypeVar("L", bound=Learner)


class TDState(NamedTuple):
    """A learner that keeps one table of action values.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
    """

    q: Float[Array, "S A"]
    clock: Clock


def check_learning(method: Any) -> None:
    """Raises InputError unless the fields `alpha`, `gamma` and `q0` of `method` are in range."""
    check_rate(method, "alpha", lambda x: x > 0, "greater than 0")
    check_number(method, "gamma", lambda x: (x >= 0) & (x <= 1), "between 0 and 1")
    check_number(method, "q0", lambda x: x == x, "a number")


@pytree
class TDControl:
    """One-step control with an epsilon-greedy, or any other, behaviour policy. A method adds its `update`.

    Attributes:
        alpha: step size, > 0; a number or a schedule.
        epsilon: probability of exploring, in [0, 1]; a number or a schedule.
        gamma: discount rate, in [0, 1].
        q0: initial value of every entry of Q, or for one run a table of them [S, A]; above the true values it
            is optimistic (book, section 2.6).
        behaviour: the policy that acts (see `policies`), instead of the epsilon-greedy one.
    """

    alpha: Rate = 0.1
    epsilon: Rate = 0.1
    gamma: float = 1.0
    q0: float = 0.0
    behaviour: Policy | None = None

    def __post_init__(self):
        check_switches(type(self).__name__, self)
        check_learning(self)
        check_rate(self, "epsilon", lambda x: (x >= 0) & (x <= 1), "between 0 and 1")
        policies.check_policy(self, "behaviour")
        given = concrete(self.epsilon)
        if self.behaviour is not None and given is not None and np.any(given != TDControl.epsilon):
            raise InputError(f"{type(self).__name__}: give epsilon or behaviour, not both")

    @property
    def selection(self) -> Policy:
        """The behaviour policy: as given, or else epsilon-greedy."""
        return EpsilonGreedy(self.epsilon) if self.behaviour is None else self.behaviour

    @property
    def all_policies(self) -> tuple[Policy, ...]:
        """All policies that it acts by or learns about."""
        return (self.selection,)

    def restricted_to(self, available: Bool[Array, "S A"], **more: Any) -> Self:
        """The method where states have these actions only: it takes no other, and counts no other.

        Args:
            available: which actions there are in each state, bool [S, A].
            more: other fields that a subclass has to restrict, as they then are.
        """
        return dataclasses.replace(
            self,
            q0=policies.among(self.q0, available),
            epsilon=TDControl.epsilon,  # which is part of the behaviour policy now
            behaviour=restricted(self.selection, available),
            **more,
        )

    def init(self, num_states: int, num_actions: int) -> Any:
        """A TDState; a method that remembers more makes its own state of it."""
        for policy in self.all_policies:
            policy.check(num_states, num_actions)
        q = jnp.full((num_states, num_actions), self.q0, dtype=float)
        if (there := getattr(self.selection, "available", None)) is not None:
            q = policies.among(q, there)
        by_visit = clock.goes_by_visit(self.alpha) or any(policy.by_visit for policy in self.all_policies)
        return TDState(q, clock.start(num_states, num_actions, by_visit))

    def probs(self, state: Learner, s: Int[Array, ""]) -> Float[Array, " A"]:
        """The behaviour policy pi(. | s), float [A]."""
        return self.selection.probs(tables.row(state.q, s), state.clock, s)

    def policy(self, key: Key[Array, ""], state: Learner, s: Int[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, self.probs(state, s))

    def begin(self, state: L, t: Transition) -> L:
        """Counts the step and the visit of (S, A), before anything is learned from them."""
        return state._replace(clock=clock.begin_step(state.clock, t.s, t.a))

    def learn(self, state: L, t: Transition, delta: Float[Array, ""]) -> L:
        """Q(S, A) <- Q(S, A) + alpha delta; and counts the episode where it is over."""
        alpha = clock.step_size(self.alpha, state.clock, t.s, t.a)
        q = tables.add(state.q, t.s, t.a, alpha * delta)
        return state._replace(q=q, clock=clock.end_step(state.clock, t.last))
