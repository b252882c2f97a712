"""Differential Q-learning: off-policy control by the average reward (Wan, Naik and Sutton 2021)."""

from typing import ClassVar

from jaxrl_tab.algorithms.average_reward import AverageReward, RateState
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import step_size
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


@pytree
class DifferentialQLearning(AverageReward):
    """Q-learning by the average reward, which is learned from the same error: R - R-bar + max_a Q(S', a).

    delta = R - R-bar + max_a Q(S', a) - Q(S, A)
    Q(S, A) <- Q(S, A) + alpha delta
    R-bar <- R-bar + eta alpha delta          (Wan, Naik and Sutton 2021, equations 4 to 6)

    For tasks that do not end. R-bar tends to the best average reward whatever policy acts, if that tries everything.
    A' is drawn from the behaviour policy after the update.
    """

    eta: float = field(
        default=0.1, greater_than=0, help="Step size of the average reward, as a multiple of alpha."
    )

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action", "From each reward the average is taken off."
    )

    def update(self, key, state: RateState, t: Transition):
        state = self.begin(state, t)
        q_next = policies.largest(tables.row(state.q, t.s_next))
        delta = t.r - state.rate + t.discount * q_next - tables.entry(state.q, t.s, t.a)
        alpha = step_size(self.alpha, state.clock, t.s, t.a)
        state = self.learn(state, t, delta)._replace(rate=state.rate + self.eta * alpha * delta)
        return state, self.policy(key, state, t.s_next)
