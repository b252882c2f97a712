"""Q-learning with any target policy (Silver, lecture 5: off-policy learning, Q-learning)."""

from typing import ClassVar

import jax

from jaxrl_tab.algorithms.control import TDState
from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class TargetQLearning(OffPolicyControl):
    """Off-policy control that learns from an action of any target policy: R + gamma Q(S', A'), A' ~ pi.

    Q(S, A) <- Q(S, A) + alpha [R + gamma Q(S', A') - Q(S, A)],  A' ~ pi(. | S')      (Silver, lecture 5)

    A' is only looked at; the action taken in S' is drawn from the behaviour policy, after the update and
    independently of A'. With the greedy target, which is the default, this is Q-learning.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, action",
        "A' is drawn from the target policy π, and only looked at: another action is taken.",
    )

    def update(self, key, state: TDState, t: Transition):
        state = self.begin(state, t)
        target_key = jax.random.fold_in(key, 0)  # `key` itself draws the action that is taken
        a_target = policies.sample(target_key, self.target_probs(state, t.s_next))
        delta = t.r + t.discount * tables.entry(state.q, t.s_next, a_target)
        delta = delta - tables.entry(state.q, t.s, t.a)
        state = self.learn(state, t, delta)
        return state, self.policy(key, state, t.s_next)
