"""Maxmin Q-learning: the largest of the least of several estimates (Lan, Pan, Fyshe and White 2020)."""

from functools import reduce
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Transition


class MaxminState(NamedTuple):
    """A learner that keeps several tables of action values.

    Attributes:
        each: the tables, float [N, S, A].
        clock: what the schedules of alpha and epsilon count; a visit counts whichever table it teaches.
    """

    each: Float[Array, "N S A"]
    clock: Clock

    @property
    def q(self) -> Float[Any, "... S A"]:
        """The least of all tables, entry by entry; of a batch [..., S, A]."""
        return self.each.min(-3)

    def least(self, s: Int[Array, ""]) -> Float[Array, " A"]:
        """The row of `q` of a state."""
        rows = [tables.entry(self.each, jnp.int32(i), s) for i in range(self.each.shape[0])]
        return reduce(lambda x, y: jnp.where(x < y, x, y), rows)


@pytree
class MaxminQLearning(TDControl):
    """Off-policy control by the least of N tables, whose bias goes from too high to too low as N grows.

    Q_min(s, a) = min over i of Q_i(s, a)
    Q_i(S, A) <- Q_i(S, A) + alpha [R + gamma max_a Q_min(S', a) - Q_i(S, A)], i drawn among the N

    (Lan et al. 2020, algorithm 1, learning from each transition once, as it comes). One table is Q-learning. Actions
    are drawn from the behaviour policy by Q_min, after the update.
    """

    tables: int = static(default=2, at_least=1, help="How many tables there are, N.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "The value of an action is the least in all tables. One of them, drawn, learns.",
    )

    def init(self, num_states: int, num_actions: int) -> MaxminState:
        q, clock = super().init(num_states, num_actions)
        return MaxminState(jnp.broadcast_to(q, (self.tables, *q.shape)), clock)

    def probs(self, state: MaxminState, s: Int[Array, ""]) -> Float[Array, " A"]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self.selection.probs(state.least(s), state.clock, s)

    def update(self, key, state: MaxminState, t: Transition):
        state = self.begin(state, t)
        i = policies.sample(jax.random.fold_in(key, 0), jnp.ones(self.tables))
        target = t.r + t.discount * policies.largest(state.least(t.s_next))
        q = tables.entry(state.each, i, t.s, t.a)
        alpha = step_size(self.alpha, state.clock, t.s, t.a)
        each = tables.put(state.each, q + alpha * (target - q), i, t.s, t.a)
        state = MaxminState(each, end_step(state.clock, t.last))
        return state, self.policy(key, state, t.s_next)
