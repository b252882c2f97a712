"""Action values with eligibility traces, in which a step costs the same however many pairs there are.

A step of the backward view does two things to every pair (s, a): Q <- Q + x z, and z <- k z (book, chapter 12). Both
are one number for all pairs, so they can be kept for all pairs together:

    z = scale marks                 z <- k z        is  scale <- k scale
    Q = base + credit marks         Q <- Q + x z    is  credit <- credit + x scale

What a pair is credited with is worked out when it is read (Wiering and Schmidhuber 1998, "Fast online Q(lambda)"),
and only the pair whose trace changes by itself is written: its base takes up what its old marks have brought.

How often all pairs are settled, that is their bases take up the credit, which is 0 then, and their marks the scale,
which is 1 then: when the scale is `SMALL` or less, which it is when the traces end, too. So 1 / scale is less than
1 / SMALL wherever it is used, and the marks of a pair are less than that many times its trace: nothing under- or
overflows, however long an episode is. (With gamma lambda = 1 the scale stays 1, and the marks are the traces.) The
same bound says how exact it is. Where a pair is marked, its base takes up the opposite of credit / scale, so that its
rounding is that of a number up to 1 / SMALL times as large as the credit. With this `SMALL`, Q was as near to that of
float64 as it is by a loop over all pairs, or nearer, wherever learning was measured; see docs/performance.md.

All this holds as well where values are linear in features: the weights stand for Q, a feature and an action for a pair,
and a step marks every feature x(S) that is not 0 (see `linear`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core import linear, tables
from jaxrl_tab.core.linear import X

SMALL = 1 / 16


class Credited(NamedTuple):
    """Action values Q with traces z.

    Attributes:
        base: Q without what is still to be credited, float [S, A].
        marks: the traces, each divided by `scale`, float [S, A].
        scale: float [], at most 1 unless traces were multiplied by more; where it is `SMALL` or less, the marks take
            it up as the next step begins.
        credit: what a pair is still to be credited with for each of its marks, float [].
    """

    base: Float[Array, "S A"]
    marks: Float[Array, "S A"]
    scale: Float[Array, ""]
    credit: Float[Array, ""]

    @property
    def q(self) -> Float[Any, "... S A"]:
        """Q; of a batch [..., S, A]."""
        return self.base + self.marks * self.credit[..., None, None]

    @property
    def z(self) -> Float[Any, "... S A"]:
        """The traces; of a batch [..., S, A]."""
        return self.marks * self.scale[..., None, None]

    def row(self, x: X) -> Float[Array, " A"]:
        """Q(s, .)."""
        return linear.row(self.base, x) + linear.row(self.marks, x) * self.credit

    def entry(self, x: X, a: Int[Array, ""]) -> Float[Array, ""]:
        """Q(s, a)."""
        return linear.entry(self.base, x, a) + linear.entry(self.marks, x, a) * self.credit

    def trace(self, x: X, a: Int[Array, ""]) -> Float[Array, ""]:
        """x . z(., a), which is z(s, a) where x is the number of a state."""
        return linear.entry(self.marks, x, a) * self.scale

    def begun(self) -> "Credited":
        """With a scale that is not small, as each step begins; nothing that can be read changes."""
        is_due = self.scale <= SMALL
        marks = tables.changed_where(is_due, _scaled, self.marks, self.scale)
        return self._replace(marks=marks, scale=jnp.where(is_due, 1, self.scale))

    def learned(
        self,
        x: X,
        a: Int[Array, ""],
        kept: Float[Array, ""] | float,
        by: Float[Array, ""] | float,
        step: Float[Array, ""],
    ) -> "Credited":
        """z(., a) <- kept z(., a) + by x; and then Q <- Q + step z, for all pairs."""
        mark = self._mark(by, step)

        def marked(times_x: Callable[[Array], Array], base: Array, old: Array) -> tuple[Array, Array]:
            new = kept * old + times_x(mark)
            return base + (old - new) * self.credit, new

        base, marks = linear.change(marked, (self.base, self.marks), x, a)
        return Credited(base, marks, self.scale, self.credit + step * self.scale)

    def replaced(self, x: X, by: Float[Array, " A"], step: Float[Array, ""]) -> "Credited":
        """z(s, .) <- by, for all actions; and then Q <- Q + step z, for all pairs. Of features that are 1 or 0."""
        mark = self._mark(by, step)

        def marked(base: Array, old: Array) -> tuple[Array, Array]:
            return base + (old - mark) * self.credit, mark

        base, marks = linear.change_rows(marked, (self.base, self.marks), x)
        return Credited(base, marks, self.scale, self.credit + step * self.scale)

    def _mark(self, by: Any, step: Float[Array, ""]) -> Float[Array, "*A"]:
        """What makes a trace `by`.

        Marking moves the last bits of Q(s, a), so it comes when all is read that decides between actions. The mark is
        worked out from `step`, which was made of that, so that XLA reads first, too: else it would copy the tables.
        """
        return jnp.where(step == step, by, jnp.nan) / self.scale  # with a step that is NaN, all of Q is NaN

    def added(self, x: X, a: Int[Array, ""], step: Float[Array, ""]) -> "Credited":
        """w(., a) <- w(., a) + step x, which for a table is Q(s, a) <- Q(s, a) + step, for this pair alone."""
        return self._replace(base=linear.add(self.base, x, a, step))

    def faded(self, by: Float[Array, ""] | float) -> "Credited":
        """z <- by z, for all pairs; `by` is at least 0. Where it is 0, Q is the base alone then."""
        scale = by * self.scale
        is_due = scale <= SMALL
        base = tables.changed_where(is_due, _credited, self.base, self.marks, self.credit)
        return Credited(base, self.marks, scale, jnp.where(is_due, 0, self.credit))


def _credited(base: Array, marks: Array, credit: Array) -> Array:
    return base + marks * credit


def _scaled(marks: Array, scale: Array) -> Array:
    return marks * scale


def start(q: Float[Array, "S A"]) -> Credited:
    """These values, without a trace."""
    return Credited(q, jnp.zeros_like(q), jnp.ones((), q.dtype), jnp.zeros((), q.dtype))
