"""Off-policy Monte Carlo: whole returns of one policy, weighted so that they speak of another."""

from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.core import episode, tables
from jaxrl_tab.core.clock import Clock, Rate, at_visit, end_step
from jaxrl_tab.core.coverage import check_coverage
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.episode import Episode
from jaxrl_tab.core.policies import Greedy, Policy
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.core.types import Transition

Weighting = Literal["weighted", "ordinary", "per-decision"]


class Step(NamedTuple):
    """What is remembered of a step: S, A, R, b(A | S), and whether its entry occurs for the first time."""

    s: Int[Array, "*t"]
    a: Int[Array, "*t"]
    r: Float[Array, "*t"]
    b: Float[Array, "*t"]
    first: Bool[Array, "*t"]


class OffPolicyMonteCarloState(NamedTuple):
    """A learner that waits for the end of the episode.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules count; its visits are the returns that were averaged.
        episode: the steps of this episode, [max_steps] each.
        mean_weight: the mean weight of those returns, float [S, A]; None unless weighted.
        seen: the last episode in which an entry occurred, int32 [S, A]; None for every-visit.
    """

    q: Float[Array, "S A"]
    clock: Clock
    episode: Episode
    mean_weight: Float[Array, "S A"] | None
    seen: Int[Array, "S A"] | None


class Rules(NamedTuple):
    """What shapes the walk back: the fields and the attribute of `OffPolicyMonteCarlo` of these names."""

    weighting: str
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
        pi: the target policy.
        alpha, gamma: of the method.
        clock: without its visits, which the walk back counts.
    """

    rest: Float[Array, "*lanes"]
    pi: Policy
    alpha: Any
    gamma: Any
    clock: Clock


@pytree
class OffPolicyMonteCarlo(OffPolicyControl):
    """Monte Carlo that learns about a target policy pi from episodes of a behaviour policy b.

    At the end of the episode, for its steps from the last to the first, beginning with W = 1:

        G <- R_{t+1} + gamma G
        C(S_t, A_t) <- C(S_t, A_t) + W
        Q(S_t, A_t) <- Q(S_t, A_t) + W / C(S_t, A_t) [G - Q(S_t, A_t)]
        W <- W pi(A_t | S_t) / b(A_t | S_t)

    That is weighted importance sampling with the greedy target, by default (book, boxes of sections 5.6 and
    5.7); it is biased, and its error is far smaller. "ordinary" averages W G (book, equation 5.5), and is
    unbiased; "per-decision" averages G with a ratio on each reward for the actions up to it alone, which is
    G <- R_{t+1} + gamma rho_{t+1} G (book, section 5.9). A target that depends on Q is inputs as Q is when the
    walk back comes to its state, as in the box.

    Where a time limit cuts an episode short, the mean value under pi of the state in which it did counts as
    the rest.
    """

    alpha: Rate = field(
        default=sample_average(),
        help="Step size. By default 1/N(s, a): what is averaged counts equally. Weighted averages then have "
        "the book's W/C, with C = the sum of all W so far.",
    )
    weighting: Weighting = static(default="weighted", help="The kind of importance sampling.")
    first_visit: bool = static(
        default=False, help="Only the return from the first time that (s, a) occurs in an episode counts."
    )

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    of_states: ClassVar[bool] = False  # the table has one entry a state; see `prediction`

    def __post_init__(self):
        super().__post_init__()
        check_coverage(type(self).__name__, self.pi, self.selection)

    @property
    def multiplies_returns(self) -> bool:
        return self.weighting != "weighted"

    @property
    def pi(self) -> Policy:
        return Greedy() if self.target is None else self.target

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> OffPolicyMonteCarloState:
        q, clock = super().init(num_states, num_actions)
        real = q[0, 0]
        step = Step(jnp.int32(0), jnp.int32(0), real, real, jnp.bool(False))
        return OffPolicyMonteCarloState(
            q,
            clock,
            episode.start(max_steps, step),
            mean_weight=jnp.zeros_like(q) if self.weighting == "weighted" else None,
            seen=jnp.zeros(q.shape, jnp.int32) if self.first_visit else None,
        )

    def update(self, key, state: OffPolicyMonteCarloState, t: Transition):
        b = tables.entry(self.probs(state, t.s), t.a)
        seen, first = episode.visit(state.seen, state.clock.episode + 1, t.s, self.column(t.a))
        step = Step(t.s, t.a, t.r, b, first)
        state = state._replace(clock=state.clock._replace(step=state.clock.step + 1))
        walk = partial(_walk, Rules(self.weighting, self.first_visit, self.of_states))
        learned = Learned(state.q, state.clock.visits, state.mean_weight)
        clock = state.clock._replace(visits=None)
        inputs = Inputs(self.rest(state, t), self.pi, self.alpha, self.gamma, clock)
        learned, remembered = episode.learn(walk, learned, state.episode, step, t.last, inputs)
        clock = end_step(clock._replace(visits=learned.visits), t.last)
        state = OffPolicyMonteCarloState(learned.q, clock, remembered, learned.mean_weight, seen)
        return state, self.policy(key, state, t.s_next)

    def rest(self, state: OffPolicyMonteCarloState, t: Transition) -> Float[Array, ""]:
        """What may be expected after S', under pi: 0 where it is terminal."""
        return t.discount * (self.target_probs(state, t.s_next) @ tables.row(state.q, t.s_next))

    def column(self, a: Int[Array, ""]) -> Int[Array, ""]:
        """Where the table has what is learned about A."""
        return a


def _walk(rules: Rules, lane, learned: Learned, steps: Step, length, inputs: Inputs) -> Learned:
    """The box above, for one lane (see `episode.learn`).

    C is kept as the mean weight: with alpha = 1/N, alpha W / mean = W / sum. A weight multiplies the return:
    all of it at once, or, per decision, what follows its action.
    """
    alpha, gamma, clock = jax.tree.map(lambda x: x[lane], inputs[2:])

    def back(i, carry):
        (q, visits, mean_weight), g, w = carry
        s, a, r, b, first = (tables.entry(x, lane, i) for x in steps)
        at = lane, s, jnp.int32(0) if rules.of_states else a
        counts = lambda new, old: jnp.where(first, new, old) if rules.first_visit else new

        def weigh(q, visits, g, w):
            row = jax.lax.dynamic_slice(q, (lane, s, jnp.int32(0)), (1, 1, q.shape[2]))[0, 0]
            target, counted = jax.tree.map(lambda x: x[lane], (inputs.pi, visits))
            rho = tables.entry(target.probs(row, clock._replace(visits=counted), s), a) / b
            return (rho * g, w) if rules.weighting == "per-decision" else (g, rho * w)

        g = r + g
        if rules.of_states:  # the action is part of what follows the state
            g, w = weigh(q, visits, g, w)
        visits, n = episode.count(visits, first, *at)
        step = at_visit(alpha, clock, n)
        if rules.weighting == "weighted":
            old = tables.entry(mean_weight, *at)
            mean_weight = tables.write(mean_weight, counts(old + step * (w - old), old), *at)
            mean = tables.entry(mean_weight, *at)
            step = step * jnp.where(w > 0, w / mean, 0)
        target = w * g if rules.weighting == "ordinary" else g
        old = tables.entry(q, *at)
        q = tables.write(q, counts(old + step * (target - old), old), *at)
        if not rules.of_states:
            g, w = weigh(q, visits, g, w)
        return Learned(q, visits, mean_weight), gamma * g, w

    one = jnp.ones((), inputs.rest.dtype)
    return episode.backward(back, length, (learned, tables.entry(inputs.rest, lane), one))[0]
