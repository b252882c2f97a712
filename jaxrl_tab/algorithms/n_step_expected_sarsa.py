"""n-step Expected Sarsa (book, sections 7.2 and 7.3)."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import lax

from jaxrl_tab.algorithms.n_step import NStepControl, NStepState, Sums
from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class NStepExpectedSarsa(OffPolicyControl, NStepControl):
    """n-step Sarsa that takes the mean over the actions of the last state.

    G_{t:t+n} = R_{t+1} + ... + gamma^{n-1} R_{t+n} + gamma^n sum_a pi(a | S_{t+n}) Q(S_{t+n}, a)
                                                                        (book, equation 7.7)

    Q(S_t, A_t) <- Q(S_t, A_t) + alpha rho_{t+1:t+n-1} [G_{t:t+n} - Q(S_t, A_t)]

    pi is the behaviour policy (on-policy, the default), and all rho are 1; or any other `target`, and rho is the
    product of the ratios pi(A | S) / b(A | S) over the actions from A_{t+1} to A_{t+n-1}. n = 1 is Expected Sarsa.
    Steps learn as in `NStepSarsa`; A' is drawn from the behaviour policy after the update.
    """

    remembers: ClassVar[type] = Sums
    on_policy: ClassVar[bool] = True
    weighs_by_ratios: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., state, each action",
        "π is the policy that acts. With another target the error counts by the product of π(A | S) / b(A | S) over "
        "the actions between.",
    )

    def update(self, key, state: NStepState, t: Transition):
        if self.target is not None:
            state = state._replace(memory=state.memory.weighed(self.ratio(state, t.s, t.a)))
        state = self.begin(state, t)
        memory = self.remember(state, t, g=0, weight=1).rewarded(t)
        state = self.learned(state, t, memory, _expected, t.s_next, self.pi, state.clock)
        return state, self.policy(key, state, t.s_next)


def _expected(lane, read, *inputs):
    """G = the rewards and, with its weight, the mean value of S'; as `NStepControl.learned` asks for it."""
    s_next, pi, clock = jax.tree.map(lambda x: x[lane], inputs)

    def target(q, i, step):
        row = lax.dynamic_slice(q, (lane, s_next, jnp.int32(0)), (1, 1, q.shape[2]))[0, 0]
        return step.g + step.weight * (pi.probs(row, clock, s_next) @ row)

    return target
