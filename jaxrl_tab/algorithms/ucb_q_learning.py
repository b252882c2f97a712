"""Q-learning with upper confidence bounds (Jin, Allen-Zhu, Bubeck and Jordan 2018)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.optimism import Optimistic
from jaxrl_tab.core import clock, policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


class BoundedState(NamedTuple):
    """A learner that keeps a table of upper bounds of the action values.

    Attributes:
        q: Q, float [S, A].
        clock: which counts visits and episodes.
        horizon: H, float [].
    """

    q: Float[Array, "S A"]
    clock: Clock
    horizon: Float[Array, ""]


@pytree
class UCBQLearning(Optimistic):
    """Q-learning that adds a bonus for what was seldom tried, so that it explores with a guarantee (UCB-Hoeffding).

    Q(S, A) <- (1 - alpha_t) Q(S, A) + alpha_t [R + V(S') + b_t]      (Jin and others 2018, algorithm 1)

    V(s) = min(H, max_a Q(s, a)),    alpha_t = (H + 1) / (H + t),    b_t = c sqrt(H^3 iota / t)

    where t counts the visits of the pair, iota is log(S A T / p), and Q begins at H. The step size forgets what came
    first, when V(S') was hardly known: but for a share of about 1 / H of the visits, all of its weight is on the last.

    In T steps its regret, all that it earns less than the best policy, is at most of the order of
    sqrt(H^4 S A T iota), where S counts the states of one step. All that is in units of reward grows with `r_max`.
    """

    backup: ClassVar[Backup] = Backup(
        "action, state, max action", "With a bonus, and no value above the most that an episode may give."
    )

    def init(self, num_states: int, num_actions: int, max_steps: int = 1) -> BoundedState:
        q = self.begun(num_states, num_actions, max_steps)
        return BoundedState(q, clock.start(num_states, num_actions, True), jnp.asarray(max_steps, q.dtype))

    def update(self, key, state: BoundedState, t: Transition):
        counted, h = clock.begin_step(state.clock, t.s, t.a), state.horizon
        assert counted.visits is not None
        n = tables.entry(counted.visits, t.s, t.a).astype(h.dtype)
        pairs = (state.q.shape[0] - 1) * state.q.shape[1]
        iota = jnp.log(pairs * (counted.episode + 1).astype(h.dtype) / self.p)
        bonus = self.c * self.r_max * jnp.sqrt(h * h * h * iota / n)
        v_next = jnp.minimum(self.r_max * h, policies.largest(tables.row(state.q, t.s_next)))
        delta = t.r + t.discount * v_next + bonus - tables.entry(state.q, t.s, t.a)
        q = tables.add(state.q, t.s, t.a, (h + 1) / (h + n) * delta)
        state = state._replace(q=q, clock=clock.end_step(counted, t.last))
        return state, self.policy(key, state, t.s_next)
