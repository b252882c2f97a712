"""Differential Sarsa: on-policy control by the average reward (book, section 10.3)."""

from typing import ClassVar

from jaxrl_tab.algorithms.average_reward import AverageReward, RateState
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


@pytree
class DifferentialSarsa(AverageReward):
    """Sarsa by the average reward of the policy that acts: R - R-bar + Q(S', A').

    delta = R - R-bar + Q(S', A') - Q(S, A)
    R-bar <- R-bar + beta delta
    Q(S, A) <- Q(S, A) + alpha delta          (book, box of section 10.3, for a table)

    For tasks that do not end. A' is drawn from the behaviour policy before the update, and is the action that is then
    taken.
    """

    beta: float = field(default=0.01, greater_than=0, help="Step size of the average reward.")

    backup: ClassVar[Backup] = Backup(
        "action, state, action",
        "From each reward the average is taken off. A' is the action that is then taken.",
    )

    def update(self, key, state: RateState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        q_next = self.value(state, t.s_next, a_next)
        delta = t.r - state.rate + t.discount * q_next - self.value(state, t.s, t.a)
        state = self.learn(state, t, delta)._replace(rate=state.rate + self.beta * delta)
        return state, a_next
