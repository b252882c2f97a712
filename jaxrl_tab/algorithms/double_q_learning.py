"""Double Q-learning: one table chooses, the other evaluates (book, section 6.7; van Hasselt 2010)."""

from typing import ClassVar

import jax

from jaxrl_tab.algorithms.double import DoubleControl, DoubleState
from jaxrl_tab.core import policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class DoubleQLearning(DoubleControl):
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

    def update(self, key, state: DoubleState, t: Transition):
        state, first = self.begin(state, t), policies.coin(key)
        own, _ = state.own_and_other(first, t.s_next)
        best = policies.sample(jax.random.fold_in(key, 0), policies.greedy(own))
        _, q_next = state.own_and_other(first, t.s_next, best)
        state = self.learn_one(state, t, first, t.r + t.discount * q_next)
        return state, self.policy(key, state, t.s_next)
