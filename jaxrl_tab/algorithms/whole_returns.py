"""What the Monte Carlo methods share, on-policy and off-policy: they wait for the end of the episode."""

from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import episode, tables
from jaxrl_tab.core.clock import Clock, at_visit, end_step
from jaxrl_tab.core.episode import Episode, Walk
from jaxrl_tab.core.policies import Policy
from jaxrl_tab.core.types import Transition

FIRST_VISIT = "Only the return from the first time that (s, a) occurs in an episode counts."


class Step(NamedTuple):
    """What is remembered of a step: S, A, R, b(A | S), and whether its entry occurs for the first time.

    On-policy no ratio is needed, and b is None. Where every visit counts, nobody asks which is the first, and
    that is None.
    """

    s: Int[Array, "*t"]
    a: Int[Array, "*t"]
    r: Float[Array, "*t"]
    b: Float[Array, "*t"] | None
    first: Bool[Array, "*t"] | None


class MonteCarloState(NamedTuple):
    """A learner that waits for the end of the episode.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules count; its visits are the returns that were averaged.
        episode: the steps of this episode, [max_steps] each.
        acting: the q and the clock that actions are chosen by; None where it is always the present ones.
        mean_weight: the mean weight of the returns that were averaged, float [S, A]; None unless weighted.
        seen: the last episode in which an entry occurred, int32 [S, A]; None for every-visit.
    """

    q: Float[Array, "S A"]
    clock: Clock
    episode: Episode
    acting: tuple[Float[Array, "S A"], Clock] | None
    mean_weight: Float[Array, "S A"] | None
    seen: Int[Array, "S A"] | None


class Rules(NamedTuple):
    """What shapes the walk back: the fields and the attribute of a method of these names."""

    weighting: str | None
    first_visit: bool
    of_states: bool


class Learned(NamedTuple):
    """What the walk back changes: the fields of the state of these names, and the visits of its clock."""

    q: Float[Array, "*lanes S A"]
    visits: Int[Array, "*lanes S A"] | None
    mean_weight: Float[Array, "*lanes S A"] | None


class Inputs(NamedTuple):
    """What the walk back goes by, besides the episode.

    Attributes:
        rest: what may be expected after the last step.
        pi: the target policy; None on-policy.
        alpha, gamma: of the method.
        clock: without its visits, which the walk back counts.
    """

    rest: Float[Array, "*lanes"]
    pi: Policy | None
    alpha: Any
    gamma: Any
    clock: Clock


class WholeReturns(TDControl):
    """Control that learns from whole returns at the end of an episode, for its steps from the last to the first."""

    weighting: Any = None  # the kind of importance sampling; on-policy there is none
    first_visit: bool
    of_states: ClassVar[bool] = False  # the table has one entry a state; see `prediction`

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> MonteCarloState:
        q, clock = super().init(num_states, num_actions)
        b = None if self.weighting is None else q[0, 0]
        first = jnp.bool(False) if self.first_visit else None
        step = Step(jnp.int32(0), jnp.int32(0), q[0, 0], b, first)
        return MonteCarloState(
            q,
            clock,
            episode.start(max_steps, step),
            acting=None,
            mean_weight=jnp.zeros_like(q) if self.weighting == "weighted" else None,
            seen=jnp.zeros(q.shape, jnp.int32) if self.first_visit else None,
        )

    def learned(
        self,
        state: MonteCarloState,
        t: Transition,
        pi: Policy | None = None,
        b: Float[Array, ""] | None = None,
    ) -> MonteCarloState:
        """The learner after a step; off-policy of the target `pi`, where b(A | S) was the probability of A."""
        seen, first = episode.visit(state.seen, state.clock.episode + 1, t.s, self.column(t.a))
        step = Step(t.s, t.a, t.r, b, first)
        state = state._replace(clock=state.clock._replace(step=state.clock.step + 1))
        walk = partial(_walk, Rules(self.weighting, self.first_visit, self.of_states))
        before = Learned(state.q, state.clock.visits, state.mean_weight)
        clock = state.clock._replace(visits=None)
        nothing = lambda: jnp.zeros((), state.q.dtype)
        # Few episodes are cut short, and `lanes` leaves this out where none is.
        rest = lax.cond(t.last & (t.discount > 0), lambda: self.rest(state, t), nothing)
        inputs = Inputs(rest, pi, self.alpha, self.gamma, clock)
        after, remembered = episode.learn(walk, before, state.episode, step, t.last, inputs)
        clock = end_step(clock._replace(visits=after.visits), t.last)
        return MonteCarloState(after.q, clock, remembered, state.acting, after.mean_weight, seen)

    def rest(self, state: MonteCarloState, t: Transition) -> Float[Array, ""]:
        """What may be expected after S', under the policy that is learned about: 0 where S' is terminal."""
        raise NotImplementedError

    def column(self, a: Int[Array, ""]) -> Int[Array, ""]:
        """Where the table has what is learned about A."""
        return a


def _walk(rules: Rules, lane, learned: Learned, walk: Walk, inputs: Inputs) -> Learned:
    """The boxes of `MonteCarlo` and `OffPolicyMonteCarlo`, for one lane (see `episode.learn`).

    C is kept as the mean weight: with alpha = 1/N, alpha W / mean = W / sum. A weight multiplies the return:
    all of it at once, or, per decision, what follows its action. On-policy there is none, and W is None.
    """
    alpha, gamma, clock = jax.tree.map(lambda x: x[lane], inputs[2:])

    def take(step: Step, carry):
        (q, visits, mean_weight), g, w = carry
        s, a, r, b, first = step
        at = lane, s, jnp.int32(0) if rules.of_states else a
        counts = lambda new, old: new if first is None else jnp.where(first, new, old)

        def weigh(q, visits, g, w):
            if b is None:  # on-policy
                return g, w
            row = lax.dynamic_slice(q, (lane, s, jnp.int32(0)), (1, 1, q.shape[2]))[0, 0]
            target, counted = jax.tree.map(lambda x: x[lane], (inputs.pi, visits))
            rho = tables.entry(target.probs(row, clock._replace(visits=counted), s), a) / b
            return (rho * g, w) if rules.weighting == "per-decision" else (g, rho * w)

        g = r + g
        if rules.of_states:  # the action is part of what follows the state
            g, w = weigh(q, visits, g, w)
        visits, n = episode.count(visits, first, *at)
        rate = at_visit(alpha, clock, n)
        if rules.weighting == "weighted":
            old = tables.entry(mean_weight, *at)
            mean_weight = tables.write(mean_weight, counts(old + rate * (w - old), old), *at)
            mean = tables.entry(mean_weight, *at)
            rate = rate * jnp.where(w > 0, w / mean, 0)
        target = w * g if rules.weighting == "ordinary" else g
        old = tables.entry(q, *at)
        q = tables.write(q, counts(old + rate * (target - old), old), *at)
        if not rules.of_states:
            g, w = weigh(q, visits, g, w)
        return Learned(q, visits, mean_weight), gamma * g, w

    one = None if rules.weighting is None else jnp.ones((), inputs.rest.dtype)
    return walk.back(take, (learned, tables.entry(inputs.rest, lane), one))[0]
