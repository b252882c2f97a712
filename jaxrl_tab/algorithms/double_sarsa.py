"""Double Sarsa: Sarsa with two tables (Ganger, Duryea and Hu 2016)."""

from typing import ClassVar

from jaxrl_tab.algorithms.double import DoubleControl, DoubleState
from jaxrl_tab.core import policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class DoubleSarsa(DoubleControl):
    """On-policy control in which each table learns by the other: R + gamma Q2(S', A').

    Q1(S, A) <- Q1(S, A) + alpha [R + gamma Q2(S', A') - Q1(S, A)]

    or both the other way round, by a fair coin.

    A' is drawn from the behaviour policy by the mean of Q1 and Q2, before the update, and is the action that is then
    taken.
    """

    backup: ClassVar[Backup] = Backup(
        "action, state, action", "Q2 gives the value where Q1 learns, Q1 where Q2 does. A coin says which."
    )

    def update(self, key, state: DoubleState, t: Transition):
        state, first = self.begin(state, t), policies.coin(key)
        a_next = self.policy(key, state, t.s_next)
        _, q_next = state.own_and_other(first, t.s_next, a_next)
        return self.learn_one(state, t, first, t.r + t.discount * q_next), a_next
