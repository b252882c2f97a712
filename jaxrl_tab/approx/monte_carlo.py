"""Gradient Monte Carlo prediction (book, box of section 9.3)."""

from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.prediction import MonteCarloPrediction, Prediction
from jaxrl_tab.approx.features import Features
from jaxrl_tab.approx.semi_gradient import SemiGradientControl, SemiGradientPrediction
from jaxrl_tab.core import episode, linear, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.episode import Episode, Walk
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import State, Transition


class Step(NamedTuple):
    """What is remembered of a step: S, or its features where states cannot be counted; and alpha."""

    s: Any
    alpha: Float[Array, "*t"]


class ReturnsState(NamedTuple):
    """A learner that waits for the end of the episode.

    Attributes:
        q: the weights, float [n, 1].
        clock: what the schedule of alpha counts.
        episode: the steps of this episode, [max_steps] each.
        returns: their rewards, of which returns are made at the end of the episode, float [max_steps].
    """

    q: Float[Array, "n 1"]
    clock: Clock
    episode: Episode
    returns: Float[Array, " t"]


@pytree
class _Returns(SemiGradientControl):
    """What `GradientMonteCarlo` learns with: one action."""

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ReturnsState:
        w, clock = super().init(num_states, num_actions)
        step = Step(jnp.int32(0) if num_states else self.nowhere, w[0, 0])
        returns = jnp.zeros(max_steps, w.dtype)
        return ReturnsState(w, clock, episode.start(max_steps, step), returns)

    def update(self, key, state: ReturnsState, t: Transition):
        state = self.begin(state, t)
        alpha = jnp.asarray(self.step_size(state, t), state.q.dtype)
        step = Step(t.s if _is_counted(t.s) else self.x(t.s), alpha)
        # Few episodes are cut short, and `lanes` leaves this out where none is.
        rest = lambda: t.discount * self.value(state, t.s_next, t.a)
        rest = lax.cond(t.last & (t.discount > 0), rest, lambda: jnp.zeros((), state.q.dtype))
        walk = partial(_walk, self.features if _is_counted(t.s) else None)
        learned, remembered = episode.learn(
            walk, (state.q, state.returns), state.episode, step, t.last, t.r, rest, self.gamma
        )
        clock = end_step(state.clock, t.last)
        return ReturnsState(learned[0], clock, remembered, learned[1]), t.a


def _is_counted(s: State) -> bool:
    return jnp.ndim(s) == 0


def _walk(features: Features | None, lane, learned, walk: Walk, r, rest, gamma):
    """The box, for one lane (see `episode.learn`); without `features` they are what is remembered of a state."""
    r, rest, gamma = (tables.entry(x, lane) for x in (r, rest, gamma))
    w, returns = learned
    returns = tables.write(returns, r, lane, walk.before)
    steps, only = jnp.where(walk.ends, walk.before + 1, 0), jnp.int32(0)

    def back(i, carry):
        returns, g = carry
        at = lane, steps - 1 - i
        g = tables.entry(returns, *at) + g
        return tables.write(returns, g, *at), gamma * g

    returns, _ = lax.fori_loop(jnp.int32(0), steps, back, (returns, rest))

    def learn(i, w):
        step = jax.tree.map(lambda xs: tables.entry(xs, lane, i), walk.steps)
        x = features(step.s) if features else step.s
        error = tables.entry(returns, lane, i) - linear.entry(w, x, only, lane)
        return linear.add(w, x, only, step.alpha * error, lane)

    return lax.fori_loop(jnp.int32(0), steps, learn, w), returns


@pytree
class GradientMonteCarlo(SemiGradientPrediction, Prediction):
    """Prediction from whole returns, at the end of the episode, whose V is linear in features of the state.

    w <- w + alpha [G_t - v(S_t)] x(S_t),  v(s) = x(s) . w,  for t = 0, 1, ..., T - 1      (book, box of section 9.3)

    This is true gradient descent, for G does not depend on w. From the first step to the last, as in the box; the table
    of `MonteCarloPrediction` goes back from the last, and with a constant alpha has other values where a state comes
    more than once in an episode.

    Where a time limit cuts an episode short, the value of the state in which it did counts as the rest.
    """

    method: ClassVar[type] = _Returns
    backup: ClassVar[Backup] = MonteCarloPrediction.backup
