"""Control by a table of action values: how it acts. How it learns, a method adds."""

import dataclasses
from typing import Any, NamedTuple, Protocol, Self, TypeVar, cast, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import clock, linear, policies
from jaxrl_tab.core.checks import concrete
from jaxrl_tab.core.clock import Clock, Rate
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.linear import X
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.policies import EpsilonGreedy, Policy
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Available, State, Transition, restricted


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


@pytree
class ValueControl(Shown):
    """Control that acts by its action values: by an epsilon-greedy, or any other, behaviour policy.

    It has no step size, for not every method learns by one. A method adds its `update`.
    """

    epsilon: Rate = field(default=0.1, at_least=0, at_most=1, help="Probability of exploring.")
    gamma: float = field(default=1.0, at_least=0, at_most=1, help="Discount rate.")
    q0: float = field(
        default=0.0,
        help="Initial value of every entry of Q, or for one run a table of them [S, A]; above the true values "
        "it is optimistic (book, section 2.6).",
    )
    behaviour: Policy | None = field(
        default=None, help="The policy that acts (see `policies`), instead of the epsilon-greedy one."
    )

    def __post_init__(self):
        epsilon = concrete(self.epsilon)
        if self.behaviour is not None and epsilon is not None and np.any(epsilon != type(self).epsilon):
            raise InputError("give epsilon or behaviour, not both", who=type(self).__name__, field="epsilon")

    @property
    def selection(self) -> Policy:
        """The behaviour policy: as given, or else epsilon-greedy."""
        return EpsilonGreedy(self.epsilon) if self.behaviour is None else self.behaviour

    @property
    def all_policies(self) -> tuple[Policy, ...]:
        """All policies that it acts by or learns about."""
        return (self.selection,)

    @property
    def rates(self) -> tuple[Rate, ...]:
        """All numbers that may be schedules, besides those of its policies."""
        return ()

    def restricted_to(self, available: Available, **more: Any) -> Self:
        """The method where states have these actions only: it takes no other, and counts no other.

        Args:
            available: which actions there are in each state, bool [S, A].
            more: other fields that a subclass has to restrict, as they then are.
        """
        own: dict[str, Any] = {
            "q0": policies.among(self.q0, available),
            "epsilon": type(self).epsilon,  # which is part of the behaviour policy now
            "behaviour": restricted(self.selection, available),
        }
        return dataclasses.replace(self, **own | more)

    def init(self, num_states: int, num_actions: int) -> Any:
        """A TDState; a method that remembers more makes its own state of it."""
        for policy in self.all_policies:
            policy.check(num_states, num_actions)
        q = self.initial(num_states, num_actions)
        by_visit = any(map(clock.goes_by_visit, self.rates)) or any(p.by_visit for p in self.all_policies)
        return TDState(q, clock.start(num_states, num_actions, by_visit))

    def initial(self, num_states: int, num_actions: int) -> Float[Array, "_ A"]:
        """What is learned, before the first step."""
        q = jnp.full((num_states, num_actions), self.q0, dtype=float)
        available = self.available
        return q if available is None else policies.among(q, available)

    @property
    def available(self) -> Any:
        """The actions to which an epsilon-greedy policy is restricted, bool [S, A]; None where it is to none."""
        acting = self.selection
        return acting.available if isinstance(acting, EpsilonGreedy) else None

    def probs(self, state: Learner, s: State) -> Float[Array, " A"]:
        """The behaviour policy pi(. | s), float [A]."""
        return self.selection.probs(self.row(state, s), state.clock, s)

    def x(self, s: State) -> X:
        """What stands for a state: its number, for Q is a table; in `approx`, its features."""
        return cast(X, s)

    @property
    def nowhere(self) -> X:
        """What `x` gives, of no state in particular."""
        return jnp.int32(0)

    def row(self, state: Any, s: State) -> Float[Array, " A"]:
        """Q(s, .), float [A]."""
        return linear.row(state.q, self.x(s))

    def value(self, state: Any, s: State, a: Int[Array, ""]) -> Float[Array, ""]:
        """Q(s, a), float []."""
        return linear.entry(state.q, self.x(s), a)

    def policy(self, key: Key[Array, ""], state: Learner, s: State) -> Int[Array, ""]:
        return policies.sample(key, self.probs(state, s))

    def begin(self, state: L, t: Transition) -> L:
        """Counts the step and the visit of (S, A), before anything is learned from them."""
        return state._replace(clock=clock.begin_step(state.clock, t.s, t.a))
