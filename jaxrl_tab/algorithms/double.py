"""What the methods share that keep two tables, so that no estimate is judged by itself (van Hasselt 2010)."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import tables
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


class DoubleState(NamedTuple):
    """A learner that keeps two tables of action values.

    Attributes:
        q1, q2: the tables, float [S, A].
        clock: what the schedules of alpha and epsilon count; a visit counts whichever table it teaches.
    """

    q1: Float[Array, "S A"]
    q2: Float[Array, "S A"]
    clock: Clock

    @property
    def q(self) -> Float[Any, "... S A"]:
        """The mean of both tables, which the behaviour policy goes by; of a batch [..., S, A]."""
        return (self.q1 + self.q2) / 2

    def own_and_other(self, first: Bool[Array, ""], *index: Int[Array, ""]) -> tuple[Array, Array]:
        """What stands at an index in the table that learns, and in the other one.

        Args:
            first: whether Q1 learns.
            index: S for a row, [A] each; S and A for an entry, [] each.
        """
        in1, in2 = (tables.entry(q, *index) for q in (self.q1, self.q2))
        return jnp.where(first, in1, in2), jnp.where(first, in2, in1)


@pytree
class DoubleControl(TDControl):
    """One-step control with two tables, of which a coin says which one learns. A method adds its `update`."""

    def init(self, num_states: int, num_actions: int) -> DoubleState:
        q, clock = super().init(num_states, num_actions)
        return DoubleState(q, q, clock)

    def learn_one(
        self, state: DoubleState, t: Transition, first: Bool[Array, ""], target: Float[Array, ""]
    ) -> DoubleState:
        """Q(S, A) <- Q(S, A) + alpha [target - Q(S, A)] in the table that learns; counts the episode as `learn`."""
        own, _ = state.own_and_other(first, t.s, t.a)
        step = step_size(self.alpha, state.clock, t.s, t.a) * (target - own)
        return DoubleState(
            q1=tables.add(state.q1, t.s, t.a, jnp.where(first, step, 0)),
            q2=tables.add(state.q2, t.s, t.a, jnp.where(first, 0, step)),
            clock=end_step(state.clock, t.last),
        )
