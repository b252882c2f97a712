"""n-step Sarsa about another policy than the one that acts (book, section 7.3)."""

from typing import ClassVar

import jax.numpy as jnp

from jaxrl_tab.algorithms.n_step import NStepControl, NStepState, Sums, bootstrapped
from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class NStepOffPolicySarsa(OffPolicyControl, NStepControl):
    """n-step Sarsa that learns about a target policy pi by importance sampling.

    Q(S_t, A_t) <- Q(S_t, A_t) + alpha rho_{t+1:t+n} [G_{t:t+n} - Q(S_t, A_t)]      (book, equation 7.11)

    rho is the product of the ratios pi(A | S) / b(A | S) over the actions from A_{t+1} to the last one, whose value G
    ends with; after a terminal state there is none. pi is greedy by default (book, box of section 7.3), so that nothing
    is learned from what comes before an action that is not greedy. Steps learn as in `NStepSarsa`.

    All of an error is multiplied, that of the first reward too, which makes the variance what it is. With one ratio for
    each decision, and control variates, it is `QSigma(sigma=1)` (book, equation 7.14).
    """

    remembers: ClassVar[type] = Sums
    weighs_by_ratios: ClassVar[bool] = True
    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., state, action",
        "Another policy b acts. The error counts by the product of π(A | S) / b(A | S) over the actions after A_t.",
    )

    def update(self, key, state: NStepState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        memory = self.remember(state, t, g=0, weight=1).rewarded(t)
        is_over = t.last & (t.discount == 0)
        memory = memory.weighed(jnp.where(is_over, 1, self.ratio(state, t.s_next, a_next)))
        return self.learned(state, t, memory, bootstrapped, t.s_next, a_next), a_next
