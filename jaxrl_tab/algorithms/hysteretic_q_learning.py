"""Hysteretic Q-learning: bad news is learned more slowly (Matignon, Laurent and Le Fort-Piat 2007)."""

from typing import ClassVar

import jax.numpy as jnp

from jaxrl_tab.algorithms.control import TDState
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import step_size
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


@pytree
class HystereticQLearning(TDControl):
    """Q-learning with two step sizes: alpha where things are better than believed, a smaller one where they are worse.

    delta = R + gamma max_a Q(S', a) - Q(S, A)
    Q(S, A) <- Q(S, A) + (alpha if delta >= 0 else beta) delta          (Matignon et al. 2007, equation 3)

    Of agents that learn together each so forgives the others that they explore. Where outcomes are random, it is
    optimistic: it learns an expectile of the returns, and not their mean. A' is drawn from the behaviour policy after
    the update.
    """

    beta: float = field(default=0.01, greater_than=0, help="Step size where the error is below 0.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action", "What is worse than believed counts less than what is better."
    )

    def update(self, key, state: TDState, t: Transition):
        state = self.begin(state, t)
        q_next = policies.largest(tables.row(state.q, t.s_next))
        delta = t.r + t.discount * q_next - tables.entry(state.q, t.s, t.a)
        alpha = step_size(self.alpha, state.clock, t.s, t.a)
        state = self.change(state, t, jnp.where(delta < 0, self.beta, alpha) * delta)
        return state, self.policy(key, state, t.s_next)
