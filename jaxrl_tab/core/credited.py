"""Action values with eligibility traces, in which a step costs the same however many pairs there are.

A step of the backward view does two things to every pair: Q <- Q + x z, and z <- k z (book, chapter 12). Both are
one number for all pairs, so they can be kept for all pairs together:

    z = scale marks        z <- k z        is scale <- k scale
    Q = base + credit marks      Q <- Q + x z      is credit <- credit + x scale

What a pair is credited with is worked out when it is read (Wiering and Schmidhuber 1998, "Fast online Q(lambda)").
Only a pair whose trace changes by itself is written: its base then takes up what its marks have brought so far.

The marks grow as the scale falls, and with them the rounding of what is summed up. So all is settled, with the
scale 1 and no credit, when the scale would be `SMALL` or less; and when the traces end, which is the scale 0. With
this `SMALL` float32 is nearer to the exact Q than a loop over all pairs, see docs/performance.md.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.core import tables

SMALL = 1 / 32


class Credited(NamedTuple):
    """Action values Q with traces z.

    Attributes:
        base: Q without what is still to be settled, float [S, A].
        marks: the traces, each divided by `scale`, float [S, A].
        scale: float [], in (0, 1].
        credit: what a pair is still to be credited with for each of its marks, float [].
    """

    base: Float[Array, "S A"]
    marks: Float[Array, "S A"]
    scale: Float[Array, ""]
    credit: Float[Array, ""]

    @property
    def q(self) -> Float[Any, "... S A"]:
        """Q, settled; of a batch [..., S, A]."""
        return self.base + self.marks * self.credit[..., None, None]

    @property
    def z(self) -> Float[Any, "... S A"]:
        """The traces; of a batch [..., S, A]."""
        return self.marks * self.scale[..., None, None]

    def row(self, s: Int[Array, ""]) -> Float[Array, " A"]:
        """Q(s, .)."""
        return tables.row(self.base, s) + tables.row(self.marks, s) * self.credit

    def entry(self, s: Int[Array, ""], a: Int[Array, ""]) -> Float[Array, ""]:
        """Q(s, a)."""
        return tables.entry(self.base, s, a) + tables.entry(self.marks, s, a) * self.credit

    def marked(self, s: Int[Array, ""], a: Int[Array, ""]) -> "Credited":
        """z(s, a) <- z(s, a) + 1."""
        return self._with_marks(s, a, tables.entry(self.marks, s, a) + 1 / self.scale)

    def kept(self, s: Int[Array, ""], a: Int[Array, ""], part: Float[Array, ""] | float) -> "Credited":
        """z(s, a) <- part z(s, a)."""
        return self._with_marks(s, a, part * tables.entry(self.marks, s, a))

    def credited(self, x: Float[Array, ""]) -> "Credited":
        """Q <- Q + x z, for all pairs."""
        return self._replace(credit=self.credit + x * self.scale)

    def faded(self, by: Float[Array, ""]) -> "Credited":
        """z <- by z, for all pairs; `by` is in [0, 1]."""
        scale = by * self.scale
        is_due = scale <= SMALL
        settled = lambda base, marks: (base + marks * self.credit, marks * scale)
        base, marks = lax.cond(is_due, settled, lambda *tables: tables, self.base, self.marks)
        return Credited(base, marks, jnp.where(is_due, 1, scale), jnp.where(is_due, 0, self.credit))

    def _with_marks(self, s: Int[Array, ""], a: Int[Array, ""], marks: Float[Array, ""]) -> "Credited":
        """With so many marks of a pair, whose value stays what it is."""
        base = self.entry(s, a) - marks * self.credit
        return self._replace(
            base=tables.put(self.base, base, s, a), marks=tables.put(self.marks, marks, s, a)
        )


def start(q: Float[Array, "S A"]) -> Credited:
    """These values, without a trace."""
    return Credited(q, jnp.zeros_like(q), jnp.ones((), q.dtype), jnp.zeros((), q.dtype))
