"""Expected Sarsa: Sarsa without the noise of A' (book, section 6.6; van Seijen et al. 2009)."""

from typing import ClassVar

from jaxrl_tab.algorithms.control import Learner
from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class ExpectedSarsa(OffPolicyControl):
    """Control that learns from the mean over A': R + gamma sum_a pi(a | S') Q(S', a).

    Q(S, A) <- Q(S, A) + alpha [R + gamma sum_a pi(a | S') Q(S', a) - Q(S, A)]      (book, equation 6.9)

    pi is the behaviour policy (on-policy, the default) or any other `target`; with the greedy one this is
    Q-learning. A' is drawn from the behaviour policy after the update.
    """

    on_policy: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, each action", "π is the policy that acts, or the target where there is one."
    )

    def update(self, key, state: Learner, t: Transition):
        state = self.begin(state, t)
        q_next = self.target_probs(state, t.s_next) @ self.row(state, t.s_next)
        delta = t.r + t.discount * q_next - self.value(state, t.s, t.a)
        state = self.learn(state, t, delta)
        return state, self.policy(key, state, t.s_next)
