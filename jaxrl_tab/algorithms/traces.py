"""What the methods with eligibility traces share: everything but the error (book, chapter 12)."""

from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import credited
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.credited import Credited
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition

# The part of its trace that a pair keeps when it comes again with step size alpha, before 1 is added.
KEPT = {
    "accumulating": lambda alpha: 1.0,
    "replacing": lambda alpha: 0.0,  # Singh and Sutton 1996
    "dutch": lambda alpha: 1 - alpha,  # van Seijen and Sutton 2014
}


class TraceState(NamedTuple):
    """A learner that keeps action values, and how much of an error each pair is credited with.

    Attributes:
        values: Q and the traces z. Traces fade at the end of a step, and none outlives its episode.
        clock: what the schedules of alpha and epsilon count.
    """

    values: Credited
    clock: Clock

    @property
    def q(self) -> Float[Any, "... S A"]:
        """Q, float [S, A]; of a batch [..., S, A]."""
        return self.values.q

    def row(self, s: Int[Array, ""]) -> Float[Array, " A"]:
        """Q(s, .), float [A]."""
        return self.values.row(s)


@pytree
class TraceControl(TDControl):
    """Control that credits the pairs of earlier steps with each error, too. A method adds its `update`.

    Where alpha is a schedule, that of the current (S, A) goes for all pairs that the step credits. With
    accumulating traces a pair that comes again and again in an episode is in effect learned with alpha times
    its trace, and Q may diverge where that is more than 2.
    """

    lam: float = field(
        default=0.9,
        at_least=0,
        at_most=1,
        help="lambda: each step credits a pair gamma lambda times what the step before did.",
    )
    trace: Literal["accumulating", "replacing"] = static(
        default="accumulating", help="Whether the trace of a pair that comes again grows by 1 or is 1."
    )

    def init(self, num_states: int, num_actions: int) -> Any:
        """A TraceState; a method that remembers more makes its own state of it."""
        q, clock = super().init(num_states, num_actions)
        return TraceState(credited.start(q), clock)

    def row(self, state: Any, s: Int[Array, ""]) -> Float[Array, " A"]:
        return state.row(s)

    def begin(self, state: Any, t: Transition) -> Any:
        state = super().begin(state, t)
        return state._replace(values=state.values.begun())

    def learn(
        self, state: Any, t: Transition, delta: Float[Array, ""], cut: Bool[Array, ""] | bool = False
    ) -> Any:
        """z(S, A) <- z(S, A) + 1 and Q <- Q + alpha delta z; then z <- gamma lambda z, or 0 where they are `cut`."""
        alpha = step_size(self.alpha, state.clock, t.s, t.a)
        values = state.values.learned(t.s, t.a, KEPT[self.trace](alpha), alpha * delta)
        values = values.faded(jnp.where(t.last | cut, 0, t.discount * self.lam))
        return state._replace(values=values, clock=end_step(state.clock, t.last))
