"""Least-squares TD and policy iteration: weights that solve a linear system (book, section 9.8).

All transitions so far make up A and b of the system A w = b. The inverse of A is what is kept, which each step changes
with a number of operations that grows with the square of the number of weights (Sherman and Morrison).
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.prediction import TD, ValueState
from jaxrl_tab.approx.semi_gradient import LinearControl, SemiGradientPrediction
from jaxrl_tab.core import linear, policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition

RIDGE = "What A is at the start, times the identity matrix."


class LeastSquaresState(NamedTuple):
    """A learner that solves for its weights, of which there are k: one for each feature and action.

    Attributes:
        q: the weights w, float [n, A].
        clock: what has been experienced.
        inverse: the inverse of A, float [k, k].
        b: float [k].
    """

    q: Float[Array, "n A"]
    clock: Clock
    inverse: Float[Array, "k k"]
    b: Float[Array, " k"]


@pytree
class LeastSquares(LinearControl):
    """What the methods share that solve for their weights. A method adds its `update`."""

    ridge: float = field(default=0.1, greater_than=0, help=RIDGE)

    per_tiling: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]

    def init(self, num_states: int, num_actions: int) -> LeastSquaresState:
        w, clock = super().init(num_states, num_actions)
        flat = w.ravel()
        inverse = jnp.eye(len(flat), dtype=w.dtype) / self.ridge
        return LeastSquaresState(w, clock, inverse, self.ridge * flat)

    def gathered(
        self, state: LeastSquaresState, x: Float[Array, " k"], ahead: Float[Array, " k"], t: Transition
    ) -> LeastSquaresState:
        """The learner with A <- A + x [x - gamma' ahead]^T and b <- b + R x; w stays.

        x are the features of S and A, as many as there are weights, and `ahead` those of what follows.
        """
        v = ((x - t.discount * ahead)[:, None] * state.inverse).sum(0)
        turned = (state.inverse * x[None]).sum(1)
        inverse = state.inverse - turned[:, None] * (v / (1 + (v * x).sum()))[None]
        return state._replace(inverse=inverse, b=state.b + t.r * x, clock=end_step(state.clock, t.last))

    def solved(self, state: LeastSquaresState) -> Float[Array, "n A"]:
        """w = A^-1 b."""
        return (state.inverse * state.b[None]).sum(1).reshape(state.q.shape)


@pytree
class _OfStates(LeastSquares):
    """What `LSTD` learns with: one action."""

    def update(self, key, state: LeastSquaresState, t: Transition):
        state = self.begin(state, t)
        x, ahead = (linear.all_of(self.x(s), len(state.b), state.b.dtype) for s in (t.s, t.s_next))
        state = self.gathered(state, x, ahead, t)
        return state._replace(q=self.solved(state)), t.a


@pytree
class LSTD(SemiGradientPrediction, TD):
    """Least-squares TD(0): it solves for where semi-gradient TD ends, from all that it has seen, and has no step size.

    A <- A + x(S) [x(S) - gamma x(S')]^T,  b <- b + R x(S),  w = A^-1 b,  v(s) = x(s) . w
                                                           (book, box of section 9.8; Bradtke and Barto 1996)

    A begins as `ridge` times the identity matrix, which is the epsilon of the box. Its inverse is what is kept, which
    each step changes with a number of operations that grows with n^2, for n features (Sherman and Morrison):

    v = (A^-1)^T [x(S) - gamma x(S')]
    A^-1 <- A^-1 - (A^-1 x(S)) v^T / (1 + v . x(S))
    """

    ridge: float = field(default=0.1, greater_than=0, help=RIDGE)

    alpha: ClassVar = 0.1  # pyright: ignore[reportIncompatibleVariableOverride]
    v0: ClassVar = 0.0  # pyright: ignore[reportIncompatibleVariableOverride]
    w0: ClassVar = ""  # pyright: ignore[reportIncompatibleVariableOverride]
    per_tiling: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]
    method: ClassVar[type] = _OfStates
    backup: ClassVar[Backup] = Backup(
        TD.backup.columns, "The target of all steps so far at once, by least squares."
    )

    def works_with(self, state: ValueState) -> Any:
        return [state.learner.inverse] * 2  # the one before, and the product that is taken off it


@pytree
class LSPI(LeastSquares):
    """Online least-squares policy iteration: LSTD for action values, whose policy is improved while it acts.

    A <- A + x(S, A) [x(S, A) - gamma x(S', pi)]^T,  b <- b + R x(S, A),  q(s, a) = x(s, a) . w
    every so many steps: w <- A^-1 b, and with it pi, which is greedy to q
                                                      (Busoniu, Ernst, De Schutter and Babuska 2010, algorithm 2)

    x(s, a) are the features of s in the place of a, and 0 in those of the other actions; x(s, pi) is their mean under
    pi, where ties share. It acts epsilon-greedily to q, or by another `behaviour`, and learns about pi, as Q-learning
    does, from steps of whoever acted.

    **What was gathered is not gathered anew**: a step counts with the pi of its own time, so that A is a mixture of
    policies, of which the present one makes up the more the longer it has lasted. `rl.approx.lspi` evaluates each
    policy anew, from a log of all steps (Lagoudakis and Parr 2003).

    A begins as `ridge` times the identity matrix, and b as `ridge` times the first weights: so what was never tried
    keeps its first value, `q0`. The inverse of A is what is kept, as in `LSTD`; a step costs as much as the square of
    the number of weights, which is that of the features times that of the actions.
    """

    every: int = static(default=10, at_least=1, help="After how many steps the policy is improved.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "The target of all steps so far at once, by least squares; the action that is largest was so at their time.",
    )

    def works_with(self, state: LeastSquaresState) -> Any:
        return [state.inverse] * 2  # the one before, and the product that is taken off it

    def update(self, key, state: LeastSquaresState, t: Transition):
        state = self.begin(state, t)
        nothing, pi = jnp.zeros_like(state.q), policies.greedy(self.row(state, t.s_next))
        x = linear.add(nothing, self.x(t.s), t.a, jnp.ones_like(pi[0]))
        ahead = nothing
        for a, probability in enumerate(pi):
            ahead = linear.add(ahead, self.x(t.s_next), jnp.int32(a), probability)
        state = self.gathered(state, x.ravel(), ahead.ravel(), t)
        is_due = state.clock.step % self.every == 0
        state = state._replace(q=jnp.where(is_due, self.solved(state), state.q))
        return state, self.policy(key, state, t.s_next)
