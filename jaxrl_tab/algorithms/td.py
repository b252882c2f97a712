"""What the one-step temporal-difference methods share: everything but the target."""

from jaxtyping import Array, Float

from jaxrl_tab.algorithms.control import L, Learner, ValueControl
from jaxrl_tab.core import clock, linear
from jaxrl_tab.core.clock import Rate
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


@pytree
class StepSize:
    """What learns by a step size, which is the first of its fields."""

    alpha: Rate = field(default=0.1, greater_than=0, help="Step size.")


@pytree
class TDControl(ValueControl, StepSize):
    """One-step control with an epsilon-greedy, or any other, behaviour policy. A method adds its `update`."""

    @property
    def rates(self) -> tuple[Rate, ...]:
        return (self.alpha,)

    def step_size(self, state: Learner, t: Transition) -> Float[Array, ""] | float:
        """alpha for the update of (S, A)."""
        return clock.step_size(self.alpha, state.clock, t.s, t.a)

    def learn(self, state: L, t: Transition, delta: Float[Array, ""]) -> L:
        """Q(S, A) <- Q(S, A) + alpha delta; and counts the episode where it is over."""
        return self.change(state, t, self.step_size(state, t) * delta)

    def change(self, state: L, t: Transition, step: Float[Array, ""]) -> L:
        """Q(S, A) <- Q(S, A) + step; and counts the episode where it is over."""
        q = linear.add(state.q, self.x(t.s), t.a, step)
        return state._replace(q=q, clock=clock.end_step(state.clock, t.last))
