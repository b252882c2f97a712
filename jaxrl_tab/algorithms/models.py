"""Models of a task that are learned from experience, in tables."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core import tables
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
