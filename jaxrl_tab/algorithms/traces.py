"""What the methods with eligibility traces share: everything but the error (book, chapter 12)."""

from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import credited, linear
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.credited import Credited
from jaxrl_tab.core.linear import X
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import State, Transition


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


def marked(
    values: Credited, trace: str, alpha: Any, x: X, a: Int[Array, ""], step: Float[Array, ""]
) -> Credited:
    """The values where a pair has come with step size alpha, and all are credited with `step` times their traces.

    Its trace grows by 1; or it is 1 (replacing; Singh and Sutton 1996), and those of the other actions in the state are
    0 (clearing; the same); or it grows by 1 - alpha z (dutch; van Seijen and Sutton 2014).
    """
    if trace == "clearing":
        taken = jnp.arange(values.base.shape[-1], dtype=jnp.int32) == a
        return values.replaced(x, taken.astype(values.base.dtype), step)
    if trace != "dutch":
        return values.learned(x, a, 0.0 if trace == "replacing" else 1.0, 1.0, step)
    if linear.is_number(x):  # z + 1 - alpha z, and z is that of the one pair that is marked
        return values.learned(x, a, 1 - alpha, 1.0, step)
    return values.learned(x, a, 1.0, 1 - alpha * values.trace(x, a), step)


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

    def row(self, state: Any, s: State) -> Float[Array, " A"]:
        return state.values.row(self.x(s))

    def value(self, state: Any, s: State, a: Int[Array, ""]) -> Float[Array, ""]:
        return state.values.entry(self.x(s), a)

    def begin(self, state: Any, t: Transition) -> Any:
        state = super().begin(state, t)
        return state._replace(values=state.values.begun())

    def learn(
        self, state: Any, t: Transition, delta: Float[Array, ""], cut: Bool[Array, ""] | bool = False
    ) -> Any:
        """Marks (S, A), and Q <- Q + alpha delta z; then z <- gamma lambda z, or 0 where they are `cut`."""
        alpha, x = self.step_size(state, t), self.x(t.s)
        values = marked(state.values, self.trace, alpha, x, t.a, alpha * delta)
        values = values.faded(jnp.where(t.last | cut, 0, t.discount * self.lam))
        return state._replace(values=values, clock=end_step(state.clock, t.last))
