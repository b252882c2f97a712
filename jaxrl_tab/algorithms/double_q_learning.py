"""Double Q-learning: one table chooses, the other evaluates (book, section 6.7; van Hasselt 2010)."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, begin_step, end_step, step_size
from jaxrl_tab.core.declared import LearnsFrom
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


@pytree
class DoubleQLearning(TDControl):
    """Off-policy control without maximisation bias: one table says which action is best, the other its value.

    With probability 1/2 each, Q1 learns by Q2 or Q2 learns by Q1 (book, equation 6.10 and the box after it):

    Q1(S, A) <- Q1(S, A) + alpha [R + gamma Q2(S', argmax_a Q1(S', a)) - Q1(S, A)]

    Of several actions that are best one is drawn. Actions are drawn from the behaviour policy by the mean of
    Q1 and Q2, after the update.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "One table chooses the action, the other gives its value: Q2(S', argmax Q1(S', a')) where Q1 learns, "
        "Q1(S', argmax Q2(S', a')) where Q2 does. A coin says which.",
    )

    def init(self, num_states: int, num_actions: int) -> DoubleState:
        q, clock = super().init(num_states, num_actions)
        return DoubleState(q, q, clock)

    def update(self, key, state: DoubleState, t: Transition):
        clock = begin_step(state.clock, t.s, t.a)
        first = policies.coin(key)  # whether Q1 learns; independent of what `policy` draws from this key
        row1, row2 = tables.row(state.q1, t.s_next), tables.row(state.q2, t.s_next)
        best = policies.sample(jax.random.fold_in(key, 0), policies.greedy(jnp.where(first, row1, row2)))
        q_next = jnp.where(
            first, tables.entry(state.q2, t.s_next, best), tables.entry(state.q1, t.s_next, best)
        )
        q = jnp.where(first, tables.entry(state.q1, t.s, t.a), tables.entry(state.q2, t.s, t.a))
        step = step_size(self.alpha, clock, t.s, t.a) * (t.r + t.discount * q_next - q)
        state = DoubleState(
            q1=tables.add(state.q1, t.s, t.a, jnp.where(first, step, 0)),
            q2=tables.add(state.q2, t.s, t.a, jnp.where(first, 0, step)),
            clock=end_step(clock, t.last),
        )
        return state, self.policy(key, state, t.s_next)
