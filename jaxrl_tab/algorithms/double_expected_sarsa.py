"""Double Expected Sarsa: Expected Sarsa with two tables (Ganger, Duryea and Hu 2016; book, exercise 6.13)."""

from typing import ClassVar

from jaxrl_tab.algorithms.double import DoubleControl, DoubleState
from jaxrl_tab.core import policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class DoubleExpectedSarsa(DoubleControl):
    """Control in which each table learns by the mean of the other: R + gamma sum_a pi(a | S') Q2(S', a).

    Q1(S, A) <- Q1(S, A) + alpha [R + gamma sum_a pi(a | S') Q2(S', a) - Q1(S, A)]

    or both the other way round, by a fair coin. pi is the behaviour policy, by the mean of Q1 and Q2. A' is drawn from
    it after the update.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, each action",
        "π is the policy that acts. Q2 gives the values where Q1 learns, Q1 where Q2 does. A coin says which.",
    )

    def update(self, key, state: DoubleState, t: Transition):
        state, first = self.begin(state, t), policies.coin(key)
        _, other = state.own_and_other(first, t.s_next)
        q_next = self.probs(state, t.s_next) @ other
        state = self.learn_one(state, t, first, t.r + t.discount * q_next)
        return state, self.policy(key, state, t.s_next)
