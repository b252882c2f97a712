"""Sarsa(lambda), the forward view: lambda-returns, off-line (Silver, lecture 5; book, section 12.1)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import episode, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.episode import Episode
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class Step(NamedTuple):
    """What is remembered of a step: S, A, alpha, R, Q(S, A), and the discounted Q(S', A') that followed."""

    s: Int[Array, "*t"]
    a: Int[Array, "*t"]
    alpha: Float[Array, "*t"]
    r: Float[Array, "*t"]
    value: Float[Array, "*t"]
    next_value: Float[Array, "*t"]


class ForwardState(NamedTuple):
    """A learner that waits for the end of the episode.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
        episode: the steps of this episode, [max_steps] each.
        kept: ones, in which the walk back notes what later updates of the episode leave of earlier ones,
            float [S, A]; None where the increments are added up.
    """

    q: Float[Array, "S A"]
    clock: Clock
    episode: Episode
    kept: Float[Array, "S A"] | None


@pytree
class SarsaLambdaForward(TDControl):
    """Sarsa towards the lambda-return, which mixes all n-step returns: (1 - lambda) lambda^(n-1) of each.

    At the end of the episode, for its steps from the last to the first, all by the Q of its start:

        G <- R_{t+1} + gamma [(1 - lambda) Q(S_{t+1}, A_{t+1}) + lambda G]      (book, equation 12.19)
        increment of Q(S_t, A_t) <- increment + alpha [G - Q(S_t, A_t)]

    The increments are added up, to the same as those of `SarsaLambda(offline=True)`, the backward view, where
    alpha stays the same in an episode. Where a pair comes again and again in an episode, Q may diverge, as is said
    there. lambda = 1 is every-visit Monte Carlo.

    The book's **off-line lambda-return algorithm** (section 12.1) has the same returns, and makes its updates one after
    another, from the first step to the last, `one_by_one`:

        Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G - Q(S_t, A_t)]      (book, equation 12.4)
    """

    lam: float = field(default=0.9, at_least=0, at_most=1, help="lambda.")
    one_by_one: bool = static(
        default=False,
        help="Make the updates at the end of the episode one after another (the book), rather than to add up the "
        "increments (the lecture).",
    )

    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action"), "At the end of the episode, all by the Q of its start."
    )

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ForwardState:
        q, clock = super().init(num_states, num_actions)
        step = Step(jnp.int32(0), jnp.int32(0), *[q[0, 0]] * 4)
        kept = jnp.ones_like(q) if self.one_by_one else None
        return ForwardState(q, clock, episode.start(max_steps, step), kept)

    def update(self, key, state: ForwardState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        alpha = jnp.asarray(step_size(self.alpha, state.clock, t.s, t.a), state.q.dtype)
        value, q_next = tables.entry(state.q, t.s, t.a), tables.entry(state.q, t.s_next, a_next)
        step = Step(t.s, t.a, alpha, t.r, value, t.discount * q_next)
        learned, remembered = episode.learn(
            _walk, (state.q, state.kept), state.episode, step, t.last, self.gamma, self.lam
        )
        q, kept = learned
        return ForwardState(q, end_step(state.clock, t.last), remembered, kept), a_next


def _walk(lane, learned, walk, gamma, lam):
    """The boxes above, for one lane (see `episode.learn`).

    One by one, n updates of a pair, each by (1 - alpha) Q + alpha G, leave of the k-th the product of (1 - alpha) of
    all after it. So from the last to the first each adds alpha (G - Q) times that, by the Q of the start.
    """
    gamma, lam = tables.entry(gamma, lane), tables.entry(lam, lane)

    def take(step, carry):
        (q, kept), g = carry
        at, alpha = (lane, step.s, step.a), step.alpha
        g = step.r + (1 - lam) * step.next_value + lam * g
        if kept is not None:
            share = tables.entry(kept, *at)
            kept, alpha = tables.write(kept, share * (1 - alpha), *at), share * alpha
        q = tables.write(q, tables.entry(q, *at) + alpha * (g - step.value), *at)
        return (q, kept), gamma * g

    def forget(step, kept):
        return tables.write(kept, jnp.ones_like(step.alpha), lane, step.s, step.a)

    # After the last step there is its own next value and nothing more, whatever lambda.
    (q, kept), _ = walk.back(take, (learned, walk.last.next_value))
    return q, None if kept is None else walk.back(forget, kept)
