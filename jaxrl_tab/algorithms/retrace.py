"""Retrace(lambda): off-policy traces that are cut no more than is safe (Munos et al. 2016)."""

from typing import ClassVar

import jax.numpy as jnp

from jaxrl_tab.algorithms.off_policy_traces import ExpectedTraces
from jaxrl_tab.algorithms.traces import TraceState
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class Retrace(ExpectedTraces):
    """Off-policy control with traces that go on by the ratio of the policies, but never grow by it.

    delta = R + gamma sum_a pi(a | S') Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda min(1, pi(A | S) / b(A | S)) z(s, a) + 1[(s, a) = (S, A)]
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)      (Munos et al. 2016, equations 3 and 4, and section 3.1)

    pi is any `target`, by default the greedy policy; the ratio is that of the moment when A was chosen. Safe whatever
    acts, as tree backup is, and where b is near pi it looks as far as Sarsa(lambda). A' is drawn from the behaviour
    policy after the update.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action", last="state, each action"),
        "Each action that was taken, but for the first, goes on by min(1, π(A | S) / b(A | S)) alone, and the mean "
        "over actions takes the rest.",
    )

    def update(self, key, state: TraceState, t: Transition):
        return self.traced(key, state, t, c=jnp.minimum(1, self.ratio(state, t.s, t.a)))
