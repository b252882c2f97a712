"""Models of a task that are learned from experience, in tables."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.types import Transition


class LastOutcomes(NamedTuple):
    """The last outcome of each pair: all that there is to know of a deterministic task.

    Attributes:
        s_next, r, discount: S', R and gamma', int32 and float [S, A]; of a pair that was never tried, that it leads
            back to S with reward 0.
        tried: 1 where the pair was tried, else 0, float [S, A].
        states: the states in which something was tried, in the order of their first visits, int32 [S].
        known: how many these are, int32 [].
    """

    s_next: Int[Array, "S A"]
    r: Float[Array, "S A"]
    discount: Float[Array, "S A"]
    tried: Float[Array, "S A"]
    states: Int[Array, " S"]
    known: Int[Array, ""]

    @classmethod
    def empty(cls, num_states: int, num_actions: int, gamma: Float[Array, ""] | float) -> "LastOutcomes":
        """The model before anything was tried."""
        states, real = jnp.arange(num_states, dtype=jnp.int32), jnp.zeros((num_states, num_actions), float)
        return cls(
            s_next=jnp.broadcast_to(states[:, None], real.shape),
            r=real,
            discount=real + gamma,
            tried=real,
            states=jnp.zeros_like(states),
            known=jnp.int32(0),
        )

    def after(self, t: Transition) -> "LastOutcomes":
        """The model with one transition more."""
        is_new = tables.row(self.tried, t.s).sum() == 0
        put = lambda table, x: tables.put(table, x, t.s, t.a)
        last = jnp.minimum(self.known, len(self.states) - 1)  # where all states are known, nothing is new
        return LastOutcomes(
            s_next=put(self.s_next, t.s_next),
            r=put(self.r, t.r),
            discount=put(self.discount, t.discount),
            tried=put(self.tried, jnp.ones_like(t.r)),
            states=tables.put(self.states, jnp.where(is_new, t.s, tables.entry(self.states, last)), last),
            known=self.known + is_new.astype(jnp.int32),
        )


class Counts(NamedTuple):
    """What followed each pair, and how often: a model of any finite task.

    Attributes:
        n: how often each state followed, float [S, A, S'].
        r: the sum of the rewards, float [S, A].
        ends: 1 where entering the state ended the episode, else 0, float [S'].
    """

    n: Float[Array, "S A Z"]
    r: Float[Array, "S A"]
    ends: Float[Array, " S"]

    @classmethod
    def empty(cls, num_states: int, num_actions: int) -> "Counts":
        """The model before anything was tried."""
        r = jnp.zeros((num_states, num_actions), float)
        return cls(jnp.zeros((*r.shape, num_states), float), r, jnp.zeros(num_states, float))

    def after(self, t: Transition, weight: Float[Array, ""]) -> "Counts":
        """The model with one transition more, which counts so much: 0 or 1."""
        seen = tables.entry(self.n, t.s, t.a, t.s_next)
        ended = jnp.maximum(tables.entry(self.ends, t.s_next), (t.discount == 0).astype(self.ends.dtype))
        return Counts(
            n=tables.put(self.n, seen + weight, t.s, t.a, t.s_next),
            r=tables.add(self.r, t.s, t.a, weight * t.r),
            ends=tables.put(self.ends, ended, t.s_next),
        )


def planned(
    q: Float[Array, "S A"],
    prob: Float[Array, "S A Z"],
    reward: Float[Array, "S A"],
    ends: Float[Array, " S"],
    gamma: Float[Array, ""] | float,
    sweeps: int,
) -> Float[Array, "S A"]:
    """Q after so many sweeps of value iteration in a model: all pairs at once, from the Q that is given.

    Args:
        q: where to begin. Of an action that a state does not have it is UNAVAILABLE, and stays so.
        prob: the probabilities of the next states, whose sum is 0 of pairs whose Q is to stay as it is.
        reward: expected rewards.
        ends: 1 for the states in which nothing follows.
        gamma: discount rate.
        sweeps: how many.
    """
    known = (prob.sum(2) > 0) & (q > policies.UNAVAILABLE)
    weights = gamma * jnp.moveaxis(prob, 2, 0)

    def sweep(_, q):
        v = jnp.where(ends > 0, 0, q.max(1))
        # One next state after another: in which order a product of matrices is summed up differs between compilers.
        backed_up = lax.fori_loop(0, len(v), lambda k, sum: sum + weights[k] * v[k], reward)
        return jnp.where(known, backed_up, q)

    return lax.fori_loop(0, sweeps, sweep, q)
