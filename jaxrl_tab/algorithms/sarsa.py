"""Sarsa: on-policy one-step control (book, section 6.4; Silver, lecture 5)."""

from typing import ClassVar

from jaxrl_tab.algorithms.control import Learner
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class Sarsa(TDControl):
    """On-policy control that learns from the action that it will take: R + gamma Q(S', A').

    Q(S, A) <- Q(S, A) + alpha [R + gamma Q(S', A') - Q(S, A)]      (book, equation 6.7)

    A' is drawn from the behaviour policy before the update, and is the action that is then taken.
    """

    backup: ClassVar[Backup] = Backup("action, state, action", "A' is the action that is then taken.")

    def update(self, key, state: Learner, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        delta = t.r + t.discount * self.value(state, t.s_next, a_next) - self.value(state, t.s, t.a)
        return self.learn(state, t, delta), a_next
