"""Sarsa(lambda), the forward view: lambda-returns, off-line (Silver, lecture 5)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import episode, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.episode import Episode
from jaxrl_tab.core.pytree import field, pytree
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
    """

    q: Float[Array, "S A"]
    clock: Clock
    episode: Episode


@pytree
class SarsaLambdaForward(TDControl):
    """Sarsa towards the lambda-return, which mixes all n-step returns: (1 - lambda) lambda^(n-1) of each.

    At the end of the episode, for its steps from the last to the first, all by the Q of its start:

        G <- R_{t+1} + gamma [(1 - lambda) Q(S_{t+1}, A_{t+1}) + lambda G]      (book, equation 12.19)
        increment of Q(S_t, A_t) <- increment + alpha [G - Q(S_t, A_t)]

    The increments are added up, to the same as those of `SarsaLambda(offline=True)`, the backward view, where
    alpha stays the same in an episode. What is said there holds here: where a pair comes again and again in
    an episode Q may diverge, and the book's off-line lambda-return algorithm (section 12.1) is another one.
    lambda = 1 is every-visit Monte Carlo.
    """

    lam: float = field(default=0.9, at_least=0, at_most=1, help="lambda.")

    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action"), "At the end of the episode, all by the Q of its start."
    )

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ForwardState:
        q, clock = super().init(num_states, num_actions)
        step = Step(jnp.int32(0), jnp.int32(0), *[q[0, 0]] * 4)
        return ForwardState(q, clock, episode.start(max_steps, step))

    def update(self, key, state: ForwardState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        alpha = jnp.asarray(step_size(self.alpha, state.clock, t.s, t.a), state.q.dtype)
        value, q_next = tables.entry(state.q, t.s, t.a), tables.entry(state.q, t.s_next, a_next)
        step = Step(t.s, t.a, alpha, t.r, value, t.discount * q_next)
        q, remembered = episode.learn(_walk, state.q, state.episode, step, t.last, self.gamma, self.lam)
        return ForwardState(q, end_step(state.clock, t.last), remembered), a_next


def _walk(lane, q, walk, gamma, lam):
    """The box above, for one lane (see `episode.learn`)."""
    gamma, lam = tables.entry(gamma, lane), tables.entry(lam, lane)

    def take(step, carry):
        q, g = carry
        s, a, alpha, r, value, next_value = step
        g = r + (1 - lam) * next_value + lam * g
        return tables.write(q, tables.entry(q, lane, s, a) + alpha * (g - value), lane, s, a), gamma * g

    # After the last step there is its own next value and nothing more, whatever lambda.
    return walk.back(take, (q, walk.last.next_value))[0]
