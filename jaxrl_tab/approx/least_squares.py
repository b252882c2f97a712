"""Least-squares TD (book, section 9.8; Bradtke and Barto 1996)."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.prediction import TD, ValueState
from jaxrl_tab.approx.semi_gradient import SemiGradientControl, SemiGradientPrediction
from jaxrl_tab.core import linear
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


class LeastSquaresState(NamedTuple):
    """A learner that solves for its weights.

    Attributes:
        q: the weights w, float [n, 1].
        clock: what has been experienced.
        inverse: the inverse of A, float [n, n].
        b: float [n].
    """

    q: Float[Array, "n 1"]
    clock: Clock
    inverse: Float[Array, "n n"]
    b: Float[Array, " n"]


@pytree
class _LeastSquares(SemiGradientControl):
    """What `LSTD` learns with: one action."""

    ridge: float = field(
        default=0.1, greater_than=0, help="What A is at the start, times the identity matrix."
    )

    def init(self, num_states: int, num_actions: int) -> LeastSquaresState:
        w, clock = super().init(num_states, num_actions)
        return LeastSquaresState(
            w, clock, jnp.eye(len(w), dtype=w.dtype) / self.ridge, jnp.zeros_like(w[:, 0])
        )

    def update(self, key, state: LeastSquaresState, t: Transition):
        state = self.begin(state, t)
        size = len(state.b)
        x, x_next = (linear.all_of(self.x(s), size, state.b.dtype) for s in (t.s, t.s_next))
        v = linear.total((x - t.discount * x_next)[:, None] * state.inverse)
        turned = linear.total((state.inverse * x[None]).T)
        inverse = state.inverse - turned[:, None] * (v / (1 + linear.total(v * x)))[None]
        b = state.b + t.r * x
        w = linear.total((inverse * b[None]).T)
        return LeastSquaresState(w[:, None], end_step(state.clock, t.last), inverse, b), t.a


@pytree
class LSTD(SemiGradientPrediction, TD):
    """Least-squares TD(0): it solves for where semi-gradient TD ends, from all that it has seen, and has no step size.

    A <- A + x(S) [x(S) - gamma x(S')]^T,  b <- b + R x(S),  w = A^-1 b,  v(s) = x(s) . w      (book, section 9.8)

    A begins as `ridge` times the identity matrix, which is the epsilon of the box. Its inverse is what is kept, which
    each step changes with a number of operations that grows with n^2, for n features (Sherman and Morrison):

    v = (A^-1)^T [x(S) - gamma x(S')]
    A^-1 <- A^-1 - (A^-1 x(S)) v^T / (1 + v . x(S))
    """

    ridge: float = field(
        default=0.1, greater_than=0, help="What A is at the start, times the identity matrix."
    )

    alpha: ClassVar = 0.1  # pyright: ignore[reportIncompatibleVariableOverride]
    v0: ClassVar = 0.0  # pyright: ignore[reportIncompatibleVariableOverride]
    w0: ClassVar = ""  # pyright: ignore[reportIncompatibleVariableOverride]
    per_tiling: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]
    method: ClassVar[type] = _LeastSquares
    backup: ClassVar[Backup] = Backup(
        TD.backup.columns, "The target of all steps so far at once, by least squares."
    )

    def works_with(self, state: ValueState) -> Any:
        return [state.learner.inverse] * 2  # the one before, and the product that is taken off it
