"""REINFORCE: Monte Carlo policy gradient, without and with a baseline (book, sections 13.3 and 13.4; Williams 1992)."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.policy_gradient import PolicyGradient, Preferences, ValueBaseline, grad_log
from jaxrl_tab.core import clock, episode, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, at_visit, end_step
from jaxrl_tab.core.episode import Episode, Walk
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


class Step(NamedTuple):
    """What is remembered of a step: S, A and R."""

    s: Int[Array, "*t"]
    a: Int[Array, "*t"]
    r: Float[Array, "*t"]


class ReinforceState(NamedTuple):
    """A learner of preferences that waits for the end of the episode.

    Attributes:
        policy: the preferences.
        clock: what the schedules of the step sizes count; its visits are the steps that were learned from.
        episode: the steps of this episode, [max_steps] each.
        returns: room for the returns that followed them, float [max_steps].
        gradient: of an episode, for the optimiser, float [S, A]; zeros between episodes. None without one.
        v: the baseline, float [S]; None without one.
    """

    policy: Preferences
    clock: Clock
    episode: Episode
    returns: Float[Array, " T"]
    gradient: Float[Array, "S A"] | None
    v: Float[Array, " S"] | None

    @property
    def q(self) -> Float[Any, "... S A"]:
        return self.policy.of_states


class Learned(NamedTuple):
    """What changes at the end of an episode: the fields of these names of the state, its policy and its clock."""

    theta: Float[Array, "*lanes S A"]
    gradient: Float[Array, "*lanes S A"] | None
    v: Float[Array, "*lanes S"] | None
    returns: Float[Array, "*lanes T"]
    visits: Int[Array, "*lanes S A"] | None


class Inputs(NamedTuple):
    """What it changes by, besides the episode.

    Attributes:
        rest: what may be expected after the last step.
        alpha, alpha_v, gamma: of the method.
        clock: without its visits, which are counted.
    """

    rest: Float[Array, "*lanes"]
    alpha: Any
    alpha_v: Any
    gamma: Any
    clock: Clock


@pytree
class Reinforce(PolicyGradient):
    """Gradient ascent of the value of the start, along what the returns of an episode say of its gradient.

    At the end of the episode, for its steps t = 0, 1, ..., T - 1:

        G <- R_{t+1} + gamma R_{t+2} + ... + gamma^{T-t-1} R_T
        theta <- theta + alpha gamma^t G grad ln pi(A_t | S_t, theta)      (book, box of section 13.3)

    Where a time limit cuts an episode short, G is the sum up to there.

    With an `optimizer` the gradients of an episode, all at the theta that acted, are added up, and it makes one step
    along their sum.
    """

    backup: ClassVar[Backup] = Backup("action, state, action, ..., end", "The whole return.")

    def __post_init__(self):
        super().__post_init__()
        if self.optimizer is not None and clock.goes_by_visit(self.alpha):
            problem = (
                "alpha cannot go by visits where an optimizer makes one step for all pairs of an episode"
            )
            raise InputError(problem, who=type(self).__name__, field="alpha")

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ReinforceState:
        policy, clock = self.begun(num_states, num_actions)
        zero = policy.theta[0, 0]
        return ReinforceState(
            policy,
            clock,
            episode.start(max_steps, Step(jnp.int32(0), jnp.int32(0), zero)),
            returns=jnp.zeros(max_steps, zero.dtype),
            gradient=None if self.optimizer is None else jnp.zeros_like(policy.theta),
            v=None,
        )

    def learned(self, state: ReinforceState, t: Transition) -> ReinforceState:
        state = state._replace(clock=state.clock._replace(step=state.clock.step + 1))
        now = state.clock._replace(visits=None)
        rest = jnp.zeros_like(t.r)
        if state.v is not None:
            rest = jnp.where(t.last, t.discount * tables.entry(state.v, t.s_next), 0)
        before = Learned(state.policy.theta, state.gradient, state.v, state.returns, state.clock.visits)
        inputs = Inputs(rest, self.alpha, getattr(self, "alpha_v", None), self.gamma, now)
        step = Step(t.s, t.a, t.r)
        after, remembered = episode.learn(_walk, before, state.episode, step, t.last, inputs)
        policy, gradient = state.policy._replace(theta=after.theta), after.gradient
        if gradient is not None:
            policy, gradient = self._stepped(policy, gradient, t, now)
        ended = end_step(now._replace(visits=after.visits), t.last)
        return ReinforceState(policy, ended, remembered, after.returns, gradient, after.v)

    def _stepped(
        self, policy: Preferences, gradient: Array, t: Transition, now: Clock
    ) -> tuple[Preferences, Array]:
        """The policy and the gradient after the step of the optimiser, where the episode is over."""
        step = lambda: (
            self.ascended(policy, gradient, at_visit(self.alpha, now, None)),
            jnp.zeros_like(gradient),
        )
        return lax.cond(t.last, step, lambda: (policy, gradient))


@pytree
class ReinforceBaseline(ValueBaseline, Reinforce):
    """REINFORCE that compares each return with a value of its state, V(s), which it learns beside.

    At the end of the episode, for its steps t = 0, 1, ..., T - 1:

        delta <- G - V(S_t)
        V(S_t) <- V(S_t) + alpha_v delta
        theta <- theta + alpha gamma^t delta grad ln pi(A_t | S_t, theta)      (book, box of section 13.4)

    The baseline changes the variance of the gradient, and not its mean. Where a time limit cuts an episode short,
    the value of the state in which it did counts as the rest.
    """

    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., end",
        "The whole return, less the value of the state in which the action was taken.",
    )

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ReinforceState:
        state = super().init(num_states, num_actions, max_steps)
        return state._replace(v=jnp.full(len(state.policy.theta), self.v0, dtype=float))


def _walk(lane, learned: Learned, walk: Walk, inputs: Inputs) -> Learned:
    """The boxes of both, for one lane (see `episode.learn`): back for the returns, and forth to learn from them."""
    alpha, alpha_v, gamma, now = jax.tree.map(lambda x: x[lane], inputs[1:])

    def note(step: Step, carry):
        returns, g, at = carry
        g = step.r + gamma * g
        return tables.write(returns, g, lane, at), g, at - 1

    returns, *_ = walk.back(note, (learned.returns, tables.entry(inputs.rest, lane), walk.before))

    def take(i, carry):
        theta, gradient, v, visits, power = carry
        s, a, _ = jax.tree.map(lambda x: tables.entry(x, lane, i), walk.steps)
        visits, n = episode.count(visits, None, lane, s, a)
        x = tables.entry(returns, lane, i)
        if v is not None:
            value = tables.entry(v, lane, s)
            x = x - value
            of_state = None if visits is None else tables.entry(visits, lane, s).sum()
            v = tables.write(v, value + at_visit(alpha_v, now, of_state) * x, lane, s)
        row = tables.entry(theta, lane, s)
        own = power * x * grad_log(row, a)  # of the gradient, in row s
        if gradient is None:
            theta = tables.write_row(theta, row + at_visit(alpha, now, n) * own, lane, s)
        else:
            gradient = tables.write_row(gradient, tables.entry(gradient, lane, s) + own, lane, s)
        return theta, gradient, v, visits, gamma * power

    first, count = jnp.int32(0), walk.ends.astype(jnp.int32) * (walk.before + 1)
    begin = learned.theta, learned.gradient, learned.v, learned.visits, jnp.ones_like(inputs.rest[0])
    theta, gradient, v, visits, _ = lax.fori_loop(first, count, take, begin)
    return Learned(theta, gradient, v, returns, visits)
