"""UCBVI: value iteration with upper confidence bounds (Azar, Osband and Munos 2017)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.optimism import Optimistic
from jaxrl_tab.core import clock, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class LayeredState(NamedTuple):
    """A learner that keeps a table of upper bounds of the action values, and counts what followed each pair.

    Of the counts there is a row for each state of each step, R = S H, or one for all steps, R = S.

    Attributes:
        q: Q, float [S H + 1, A].
        clock: which counts episodes.
        n: how often each state followed, and in the last place the end, float [R, A, S + 1]. What followed the last
            step of an episode is not counted, for nothing comes after it.
        visits: how often each pair was tried, float [R, A].
        r: the sums of the rewards, float [R, A].
    """

    q: Float[Array, "N A"]
    clock: Clock
    n: Float[Array, "R A S1"]
    visits: Float[Array, "R A"]
    r: Float[Array, "R A"]


@pytree
class UCBVI(Optimistic):
    """Control that plans with what it has counted, and a bonus for what it has seldom tried (UCBVI-CH).

    Q_h(s, a) = min(Q_h(s, a) of before, H, r(s, a) + sum_s' p(s' | s, a) max_a' Q_h+1(s', a') + b(s, a))

    b(s, a) = c H L / sqrt(N(s, a)),    L = log(5 S A T / p)      (Azar and others 2017, algorithms 1 to 3, with c = 7)

    by backward induction before each episode; where a pair was never tried, Q is H. p(. | s, a) is what followed among
    the N(s, a) visits, and r their mean reward, which the paper takes as known.

    In T steps its regret, all that it earns less than the best policy, is at most of the order of
    H sqrt(S A T) L + H^2 S^2 A L^2 where it is told that the task is `stationary`, as in the paper. Otherwise it counts
    for each step of an episode by itself, and S is the number of states of all steps. All that is in units of reward
    grows with `r_max`.
    """

    c: float = field(default=7.0, help="Factor of the bonus; far smaller serves better in practice.")
    stationary: bool = static(
        default=False,
        help="Whether what follows an action is the same at every step, so that what is seen in one counts for all.",
    )

    backup: ClassVar[Backup] = Backup(
        "action, each state, max action",
        "By what was counted, with a bonus: of all pairs, from the last step to the first, before each episode.",
    )

    def init(self, num_states: int, num_actions: int, max_steps: int = 1) -> LayeredState:
        states = (num_states - 1) // max_steps
        q = self.begun(num_states, num_actions, max_steps)
        visits = jnp.zeros((states if self.stationary else num_states - 1, num_actions), q.dtype)
        n = jnp.zeros((*visits.shape, states + 1), q.dtype)
        return LayeredState(q, clock.start(num_states, num_actions, False), n, visits, visits)

    def works_with(self, state: LayeredState):
        return state.n  # as probabilities

    def update(self, key, state: LayeredState, t: Transition):
        counted = clock.begin_step(state.clock, t.s, t.a)
        end, (rows, actions, width) = state.q.shape[0] - 1, state.n.shape
        states, horizon = width - 1, end // (width - 1)
        row = t.s % rows
        s_next = jnp.where(t.s_next == end, states, t.s_next % states)
        goes_on = (t.s < end - states).astype(state.n.dtype)  # it was not the last step
        n = tables.put(state.n, tables.entry(state.n, row, t.a, s_next) + goes_on, row, t.a, s_next)
        visits = tables.add(state.visits, row, t.a, jnp.ones_like(t.r))
        r = tables.add(state.r, row, t.a, t.r)
        steps = (counted.episode + 1).astype(n.dtype) * horizon
        bonus = self.c * self.r_max * horizon * jnp.log(5 * rows * actions * steps / self.p)
        gamma = jnp.asarray(self.gamma, n.dtype)
        q = tables.changed_where(t.last, _planned, state.q, n, visits, r, bonus, gamma)
        state = LayeredState(q, clock.end_step(counted, t.last), n, visits, r)
        return state, self.policy(key, state, t.s_next)


def _planned(q, n, visits, r, bonus, gamma) -> Float[Array, "N A"]:
    """Q by backward induction with what was counted, and no entry above what it was; `bonus` is that of one visit."""
    rows, actions, width = n.shape
    states = width - 1
    horizon, layers = (q.shape[0] - 1) // states, rows // states
    at = lambda x, h: lax.dynamic_index_in_dim(x.reshape(layers, states, *x.shape[1:]), h, keepdims=False)
    followed = n.sum(2)
    of_visit, of_next = (1 / jnp.maximum(x, 1) for x in (visits, followed))
    reward, prob = r * of_visit, n * of_next[..., None]

    def before(k, carry):
        q, v = carry
        h = horizon - 1 - k
        layer = h % layers if layers > 1 else 0
        old = lax.dynamic_index_in_dim(q, h, keepdims=False)
        share = jnp.where(h == horizon - 1, at(of_visit, layer), at(of_next, layer))
        count = jnp.where(h == horizon - 1, at(visits, layer), at(followed, layer))
        weights = gamma * jnp.moveaxis(at(prob, layer), 2, 0)
        # One next state after another: in which order a product of matrices is summed up differs between compilers.
        add = lambda i, sum: sum + weights[i] * v[i]
        backed_up = lax.fori_loop(0, width, add, at(reward, layer)) + bonus * jnp.sqrt(share)
        new = jnp.where(count > 0, jnp.minimum(old, backed_up), old)
        v = jnp.append(new.max(1), jnp.zeros(1, v.dtype))
        return lax.dynamic_update_index_in_dim(q, new, h, 0), v

    of_steps = q[:-1].reshape(horizon, states, actions)
    of_steps, _ = lax.fori_loop(0, horizon, before, (of_steps, jnp.zeros(width, q.dtype)))
    return jnp.concatenate([of_steps.reshape(-1, actions), q[-1:]])
