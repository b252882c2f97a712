"""Monte Carlo control: learn from whole returns (book, sections 5.3 and 5.4; Silver, lecture 5)."""

from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import episode, tables
from jaxrl_tab.core.clock import Clock, Rate, at_visit, end_step
from jaxrl_tab.core.episode import Episode
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.core.types import Transition


class Step(NamedTuple):
    """What is remembered of a step: S, A, R, and whether (S, A) occurs in it for the first time."""

    s: Int[Array, "*t"]
    a: Int[Array, "*t"]
    r: Float[Array, "*t"]
    first: Bool[Array, "*t"]


class MonteCarloState(NamedTuple):
    """A learner that waits for the end of the episode.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules count; its visits are the returns that were averaged.
        episode: the steps of this episode, [max_steps] each.
        acting: the q and the clock that actions are chosen by; None where it is always the present ones.
        seen: the last episode in which (s, a) occurred, int32 [S, A]; None for every-visit.
    """

    q: Float[Array, "S A"]
    clock: Clock
    episode: Episode
    acting: tuple[Float[Array, "S A"], Clock] | None
    seen: Int[Array, "S A"] | None


@pytree
class MonteCarlo(TDControl):
    """Generalised policy iteration on whole returns: G = R_1 + gamma R_2 + ..., Q(S, A) <- mean of the G's.

    At the end of the episode, for its steps from the last to the first:

        G <- R_{t+1} + gamma G
        N(S_t, A_t) <- N(S_t, A_t) + 1
        Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G - Q(S_t, A_t)]      (alpha = 1/N unless another is given)

    With `epsilon=schedules.glie()` this is the lecture's GLIE Monte Carlo control. The policy is improved
    after every `batch` episodes, and does not change in between, schedules included: with many it is policy
    iteration. (Q still has the returns of earlier policies in it; a constant alpha forgets them.)

    Where a time limit cuts an episode short, the mean value of the state in which it did counts as the rest.
    """

    alpha: Rate = field(
        default=sample_average(), help="Step size. By default 1/N(s, a): Q is the mean of the returns."
    )
    first_visit: bool = static(
        default=False, help="Only the return from the first time that (s, a) occurs in an episode counts."
    )
    batch: int = static(default=1, at_least=1, help="Episodes per improvement of the policy.")
    exploring_starts: bool = static(
        default=False,
        help="Every episode starts in any state, with any action, equally likely (book, section 5.3); epsilon "
        "may then be 0.",
    )

    acts_after_update: ClassVar[bool] = True

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> MonteCarloState:
        q, clock = super().init(num_states, num_actions)
        step = Step(jnp.int32(0), jnp.int32(0), q[0, 0], jnp.bool(False))
        return MonteCarloState(
            q,
            clock,
            episode.start(max_steps, step),
            acting=(q, clock) if self.batch > 1 else None,
            seen=jnp.zeros(q.shape, jnp.int32) if self.first_visit else None,
        )

    def probs(self, state: Any, s: Int[Array, ""]) -> Float[Array, " A"]:
        q, clock = state.acting or (state.q, state.clock)
        return self.selection.probs(tables.row(q, s), clock, s)

    def update(self, key, state: MonteCarloState, t: Transition):
        seen, first = episode.visit(state.seen, state.clock.episode + 1, t.s, t.a)
        step = Step(t.s, t.a, t.r, first)
        state = state._replace(clock=state.clock._replace(step=state.clock.step + 1))
        rest = t.discount * (self.probs(state, t.s_next) @ tables.row(state.q, t.s_next))
        (q, visits), remembered = episode.learn(
            partial(_walk, self.first_visit), (state.q, state.clock.visits), state.episode, step, t.last,
            rest, self.alpha, self.gamma, state.clock._replace(visits=None)
        )  # fmt: skip
        clock = end_step(state.clock._replace(visits=visits), t.last)
        acting = state.acting
        if acting is not None:
            improve = t.last & (clock.episode % self.batch == 0)
            acting = jax.tree.map(lambda new, old: jnp.where(improve, new, old), (q, clock), acting)
        state = MonteCarloState(q, clock, remembered, acting, seen)
        return state, self.policy(key, state, t.s_next)


def _walk(first_visit, lane, learned, steps, length, rest, alpha, gamma, clock):
    """The box above, for one lane (see `episode.learn`)."""
    alpha, gamma, clock = jax.tree.map(lambda x: x[lane], (alpha, gamma, clock))

    def back(i, carry):
        (q, visits), g = carry
        s, a, r, first = (tables.entry(x, lane, i) for x in steps)
        g = r + g
        visits, n = episode.count(visits, first, lane, s, a)
        old = tables.entry(q, lane, s, a)
        new = old + at_visit(alpha, clock, n) * (g - old)
        q = tables.write(q, jnp.where(first, new, old) if first_visit else new, lane, s, a)
        return (q, visits), gamma * g

    return episode.backward(back, length, (learned, tables.entry(rest, lane)))[0]
