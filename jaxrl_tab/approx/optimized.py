"""Linear methods whose weights an optimiser of optax changes, in place of the book's alpha.

The gradient is the semi-gradient of 1/2 [target - q(S, A)]^2 by all weights: -delta x(S) for the action A, and 0 for
the others; with eligibility traces -delta z. An optimiser that remembers, such as Adam, changes all weights in each
step, which so costs as much as there are weights, however few features are 1.
"""

from functools import partial
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxrl_tab.algorithms.n_step import Correction
from jaxrl_tab.algorithms.n_step_sarsa import NStepSarsa
from jaxrl_tab.algorithms.sarsa_lambda import SarsaLambda
from jaxrl_tab.algorithms.traces import marked
from jaxrl_tab.approx.features import OneHot
from jaxrl_tab.approx.semi_gradient import SemiGradientControl
from jaxrl_tab.core import linear, optimizers, tables
from jaxrl_tab.core.checks import assign, concrete
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Environment, Transition

OPTIMIZER = (
    'An optimiser in place of alpha, as the call that makes it in optax, with its learning rate: "optax:adam(0.01)"; '
    "in Python also any transformation of gradients."
)

NO_GRADIENT = (
    "an optimizer changes weights along a gradient, and true online learning has none, for alpha is a part of its "
    "traces: give alpha"
)


class OptimizedState(NamedTuple):
    """As `TDState`, with the state of an optimiser of the weights."""

    q: Float[Array, "n A"]
    clock: Clock
    optimizer: Any


@pytree
class Optimized(Shown):
    """What a method has whose weights an optimiser may change."""

    optimizer: Any = static(default="", help=OPTIMIZER)

    def __post_init__(self):
        own: Any = self
        super().__post_init__()  # pyright: ignore[reportAttributeAccessIssue]
        if isinstance(self.optimizer, str) and not self.optimizer:
            return
        who = type(self).__name__
        try:
            assign(self, optimizer=optimizers.whole(self.optimizer))
        except InputError as error:
            raise error.renamed(who, "optimizer") from None
        alpha = concrete(own.alpha)
        if alpha is not None and np.any(alpha != type(own).alpha):
            raise InputError("give alpha or optimizer, not both", who=who, field="alpha")
        if own.per_tiling:
            problem = "alpha is divided by the number of tilings, and there is none with an optimizer"
            raise InputError(problem, who=who, field="per_tiling")

    def fitted_to(self, env: Environment) -> Self:
        fitted: Any = super().fitted_to(env)  # pyright: ignore[reportAttributeAccessIssue]
        size = env.num_states if isinstance(fitted.features, OneHot) else fitted.features.size
        shape = size, 1 if hasattr(self, "v0") else env.num_actions
        learned = jax.ShapeDtypeStruct(shape, jax.dtypes.canonicalize_dtype(float))
        optimizers.check_fits(self.optimizer, learned, type(self).__name__)
        return fitted


@pytree
class OptimizedControl(Optimized, SemiGradientControl):
    """One-step control whose weights an optimiser may change."""

    def init(self, num_states: int, num_actions: int) -> Any:
        state = super().init(num_states, num_actions)
        if not self.optimizer:
            return state
        return OptimizedState(state.q, state.clock, optimizers.start(self.optimizer, state.q))

    def learn(self, state: Any, t: Transition, delta: Float[Array, ""]) -> Any:
        """w <- w + what the optimiser makes of delta x(S) at A; and counts the episode where it is over."""
        if not self.optimizer:
            return super().learn(state, t, delta)
        ascent = linear.add(jnp.zeros_like(state.q), self.x(t.s), t.a, delta)
        change, optimizer = optimizers.change(self.optimizer, ascent, state.optimizer, state.q)
        return OptimizedState(state.q + change, end_step(state.clock, t.last), optimizer)


def _corrected(made: Any, lane: Any, learned: Any, step: Any, error: Any) -> Any:
    """What an optimiser makes of the error of a step; as `NStepControl.correction`, for the weights of one lane."""
    w, state = jax.tree.map(lambda x: tables.entry(x, lane), learned)
    ascent = linear.add(jnp.zeros_like(w), step.s, step.a, error)
    change, state = optimizers.change(made, ascent, state, w)
    put = partial(lax.dynamic_update_index_in_dim, index=lane, axis=0, allow_negative_indices=False)
    return jax.tree.map(put, learned, (w + change, state))


@pytree
class OptimizedNStepControl(Optimized, SemiGradientControl, NStepSarsa):
    """n-step Sarsa whose weights an optimiser may change, once for each step that learns."""

    def init(self, num_states: int, num_actions: int) -> Any:
        state = super().init(num_states, num_actions)
        if not self.optimizer:
            return state
        return state._replace(optimizer=optimizers.start(self.optimizer, state.q))

    @property
    def correction(self) -> Correction:
        return partial(_corrected, self.optimizer) if self.optimizer else super().correction


@pytree
class OptimizedTraceControl(Optimized, SemiGradientControl, SarsaLambda):
    """Sarsa(lambda) whose weights an optimiser may change."""

    def __post_init__(self):
        super().__post_init__()
        if self.optimizer and (self.trace == "dutch" or self.offline):
            problem = (
                NO_GRADIENT if self.trace == "dutch" else "an optimizer does not go with learning off-line"
            )
            raise InputError(problem, who=type(self).__name__, field="optimizer")

    def init(self, num_states: int, num_actions: int) -> Any:
        state = super().init(num_states, num_actions)
        if not self.optimizer:
            return state
        return state._replace(optimizer=optimizers.start(self.optimizer, state.q))

    def learn(
        self, state: Any, t: Transition, delta: Float[Array, ""], cut: Bool[Array, ""] | bool = False
    ) -> Any:
        """Marks (S, A), and w <- w + what the optimiser makes of delta z; then z <- gamma lambda z."""
        if not self.optimizer:
            return super().learn(state, t, delta, cut)
        # Nothing is credited by the marks: so the base is w, all of which the optimiser changes.
        values = marked(state.values, self.trace, 0.0, self.x(t.s), t.a, jnp.zeros_like(delta))
        change, optimizer = optimizers.change(self.optimizer, delta * values.z, state.optimizer, values.base)
        values = values._replace(base=values.base + change).faded(jnp.where(t.last, 0, t.discount * self.lam))
        return state._replace(values=values, clock=end_step(state.clock, t.last), optimizer=optimizer)
