"""Speedy Q-learning: what a table has just learned counts in full (Azar, Munos, Ghavamzadeh and Kappen 2011)."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies, schedules, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, Rate, step_size
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


class SpeedyState(NamedTuple):
    """A learner that keeps its table, and what stood in each entry before its last update.

    Attributes:
        q: Q_k, float [S, A], where k is how often an entry was updated.
        before: Q_{k-1}, float [S, A].
        clock: what the schedules of alpha and epsilon count.
    """

    q: Float[Array, "S A"]
    before: Float[Array, "S A"]
    clock: Clock


@pytree
class SpeedyQLearning(TDControl):
    """Q-learning in which what has changed since the last update of a pair is taken over with a step size near 1.

    T Q = R + gamma max_a Q(S', a), of Q_k and of Q_{k-1}, both from the same transition
    Q_{k+1}(S, A) = Q_k(S, A) + alpha [T Q_{k-1} - Q_k(S, A)] + (1 - alpha) [T Q_k - T Q_{k-1}]

    (Azar et al. 2011, algorithm 1, whose alpha is 1 / (k + 1), which is 1 / N(S, A) here, the default). There all pairs
    are updated at the same time, k times so far; here they are updated as they come, and Q_{k-1} is what stood in an
    entry before its last update. A' is drawn from the behaviour policy after the update.
    """

    alpha: Rate = field(default=schedules.sample_average(), help="Step size; by default 1 over the visits.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "Both for the values that there are, and for those before their last updates.",
    )

    def init(self, num_states: int, num_actions: int) -> SpeedyState:
        q, clock = super().init(num_states, num_actions)
        return SpeedyState(q, jnp.copy(q), clock)  # two tables, of which each is counted as memory

    def update(self, key, state: SpeedyState, t: Transition):
        state = self.begin(state, t)
        now, before = (
            t.r + t.discount * policies.largest(tables.row(q, t.s_next)) for q in (state.q, state.before)
        )
        q = tables.entry(state.q, t.s, t.a)
        alpha: Any = step_size(self.alpha, state.clock, t.s, t.a)
        step = alpha * (before - q) + (1 - alpha) * (now - before)
        state = self.change(state, t, step)._replace(before=tables.put(state.before, q, t.s, t.a))
        return state, self.policy(key, state, t.s_next)
