"""Q-learning: off-policy one-step control (book, section 6.5; Watkins 1989)."""

from typing import ClassVar

from jaxrl_tab.algorithms.control import Learner
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class QLearning(TDControl):
    """Off-policy control that learns about the greedy policy while exploring: R + gamma max_a Q(S', a).

    Q(S, A) <- Q(S, A) + alpha [R + gamma max_a Q(S', a) - Q(S, A)]      (book, equation 6.8)

    A' is drawn from the behaviour policy after the update.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup("action, state, max action")

    def update(self, key, state: Learner, t: Transition):
        state = self.begin(state, t)
        q_next = policies.largest(self.row(state, t.s_next))
        delta = t.r + t.discount * q_next - self.value(state, t.s, t.a)
        state = self.learn(state, t, delta)
        return state, self.policy(key, state, t.s_next)
