"""Posterior sampling: act as if what is drawn from what one believes were so (Strens 2000; Osband et al. 2013)."""

from functools import partial
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.control import ValueControl
from jaxrl_tab.algorithms.models import Counts, planned
from jaxrl_tab.algorithms.posterior import drawn_model
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, Rate, end_step
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class PosteriorState(NamedTuple):
    """A learner that keeps the action values of a model that it has drawn, and counts what followed each pair.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of epsilon count.
        model: the counts.
        age: steps since the model was drawn, int32 []; before the first one was, as many as there can be.
    """

    q: Float[Array, "S A"]
    clock: Clock
    model: Counts
    age: Int[Array, ""]


@pytree
class PSRL(ValueControl):
    """Control that draws a model from its posterior for each episode, and acts as is best in that one.

    p(. | s, a) ~ Dirichlet(N(s, a, .) + prior / S)
    r(s, a) ~ Normal((r0 + sum of rewards) / (1 + N(s, a)), spread^2 / (1 + N(s, a)))
    Q(s, a) = r(s, a) + gamma sum_s' p(s' | s, a) max_a' Q(s', a')

    It is solved by value iteration, and acted on greedily until the next one is drawn. What is not known well differs
    from draw to draw, and now and then looks best: so it is explored, and by whole episodes, not by single steps. The
    prior is that any state may follow, all alike, and counts as `prior` transitions; that of rewards, as one of r0.

    With several `samples` each pair takes the best of so many draws, in each sweep: optimistic posterior sampling
    (Agrawal and Jia 2017).
    """

    epsilon: Rate = field(default=0.0, help="Probability of exploring besides.")
    q0: float = field(default=0.0, help="Values from which planning begins, one or a table of them [S, A].")
    prior: float = field(
        default=1.0, greater_than=0, help="How many transitions the prior of a pair counts as."
    )
    r0: float = field(default=0.0, help="Mean reward that is expected of a pair before it is tried.")
    spread: float = field(
        default=1.0,
        at_least=0,
        help="Standard deviation of rewards, and of what is expected of them at first.",
    )
    every: float = field(
        default=100.0, at_least=1, help="Steps after which another model is drawn within an episode, too."
    )
    samples: int = static(default=1, at_least=1, help="Draws for each pair, of which the best counts.")
    sweeps: int = static(default=100, at_least=1, help="Sweeps of value iteration, each time.")

    # It declares that it learns from itself alone: in a replay a transition would count as several.
    acts_after_update: ClassVar[bool] = True
    backup: ClassVar[Backup] = Backup(
        "action, each state, max action",
        "By a model that is drawn at the end of each episode, of all pairs.",
    )

    def init(self, num_states: int, num_actions: int) -> PosteriorState:
        q, clock = super().init(num_states, num_actions)
        never = jnp.int32(jnp.iinfo(jnp.int32).max)
        return PosteriorState(q, clock, Counts.empty(num_states, num_actions), never)

    def works_with(self, state: PosteriorState):
        drawn = jnp.repeat(state.model.n, self.samples, axis=1)
        return drawn, drawn, drawn  # while it is drawn; and times gamma, in the order of the sweeps

    def update(self, key, state: PosteriorState, t: Transition):
        state = self.begin(state, t)
        model = state.model.after(t, jnp.ones_like(t.r))
        is_over = t.last | (state.age.astype(t.r.dtype) >= jnp.asarray(self.every, t.r.dtype) - 1)
        numbers = (
            jnp.asarray(x, state.q.dtype) for x in (self.q0, self.prior, self.r0, self.spread, self.gamma)
        )
        solved = partial(_solved, self.samples, self.sweeps)
        word = jax.random.bits(key, dtype=jnp.uint32)
        q = tables.changed_where(is_over, solved, state.q, word, *model, *numbers)
        age = jnp.where(is_over, 0, state.age + 1)
        state = PosteriorState(q, end_step(state.clock, t.last), model, age)
        return state, self.policy(key, state, t.s_next)


def _solved(
    samples: int, sweeps: int, q, word, n, r, ends, q0, prior, r0, spread, gamma
) -> Float[Array, "S A"]:
    """Q of a model that is drawn: several draws of a pair are as many actions."""
    prob, reward = drawn_model(word, Counts(n, r, ends), samples, prior, r0, spread)
    start = jnp.repeat(jnp.where(q > UNAVAILABLE, q0, q), samples, axis=1)
    return planned(start, prob, reward, ends, gamma, sweeps).reshape(*q.shape, samples).max(2)
