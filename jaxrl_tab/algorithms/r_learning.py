"""R-learning: off-policy control by the average reward (book, 1st edition, section 6.7; Schwartz 1993)."""

from typing import ClassVar

import jax.numpy as jnp

from jaxrl_tab.algorithms.average_reward import AverageReward, RateState
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


@pytree
class RLearning(AverageReward):
    """Q-learning by the average reward, which is learned in the steps that are greedy: R - R-bar + max_a Q(S', a).

    Q(S, A) <- Q(S, A) + alpha [R - R-bar + max_a Q(S', a) - Q(S, A)]
    R-bar <- R-bar + beta [R - R-bar + max_a Q(S', a) - max_a Q(S, a)]  if now Q(S, A) = max_a Q(S, a)

    (book, 1st edition, figure 6.16). For tasks that do not end. A' is drawn from the behaviour policy after the
    update.
    """

    beta: float = field(default=0.01, greater_than=0, help="Step size of the average reward.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action", "From each reward the average is taken off."
    )

    def update(self, key, state: RateState, t: Transition):
        state = self.begin(state, t)
        q_next = policies.largest(tables.row(state.q, t.s_next))
        delta = t.r - state.rate + t.discount * q_next - tables.entry(state.q, t.s, t.a)
        state = self.learn(state, t, delta)
        best = policies.largest(tables.row(state.q, t.s))
        best_next = policies.largest(tables.row(state.q, t.s_next))
        excess = t.r - state.rate + t.discount * best_next - best
        is_greedy = tables.entry(state.q, t.s, t.a) == best
        state = state._replace(rate=state.rate + jnp.where(is_greedy, self.beta * excess, 0))
        return state, self.policy(key, state, t.s_next)
