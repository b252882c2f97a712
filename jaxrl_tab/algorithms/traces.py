"""What the methods with eligibility traces share: everything but the error (book, chapter 12)."""

from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import tables
from jaxrl_tab.core.clock import Clock, end_step, step_size
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
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
        z: the traces as the last update used them, float [S, A].
        decay: what the next update multiplies them by before it marks its own pair: gamma lambda; or 0 where
            they end, so that no trace outlives its episode; float [].
    """

    q: Float[Array, "S A"]
    clock: Clock
    z: Float[Array, "S A"]
    decay: Float[Array, ""]


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
        return TraceState(q, clock, z=jnp.zeros_like(q), decay=jnp.zeros((), q.dtype))

    def learn(self, state: Any, t: Transition, delta: Float[Array, ""]) -> Any:
        """z(S, A) <- z(S, A) + 1 and Q <- Q + alpha delta z, all pairs at once; then traces fade, or end.

        They fade at the head of the next update, which lets XLA do all of this in place.
        """
        alpha = step_size(self.alpha, state.clock, t.s, t.a)
        z = tables.lane_by_lane(_mark, state.decay * state.z, KEPT[self.trace](alpha), t.s, t.a)
        return state._replace(
            q=state.q + alpha * delta * z,
            z=z,
            decay=jnp.where(t.last, 0, t.discount * self.lam),
            clock=end_step(state.clock, t.last),
        )


def _mark(lane: Array, z: Array, kept: Array, s: Array, a: Array) -> Array:
    """z(S, A) <- kept z(S, A) + 1, for `tables.lane_by_lane`."""
    at = lane, tables.entry(s, lane), tables.entry(a, lane)
    return tables.write(z, tables.entry(kept, lane) * tables.entry(z, *at) + 1, *at)
