"""R-max: what is not known well enough is taken to be as good as can be (Brafman and Tennenholtz 2002)."""

from functools import partial
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.control import ValueControl
from jaxrl_tab.algorithms.models import Counts, planned
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, Rate, end_step
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class ModelState(NamedTuple):
    """A learner that keeps a table of action values, and counts what followed each pair.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of epsilon count.
        model: the counts.
    """

    q: Float[Array, "S A"]
    clock: Clock
    model: Counts


@pytree
class RMax(ValueControl):
    """Control that plans with what it knows, and takes all else to be as good as can be, so that it goes there.

    Q(s, a) = r(s, a) + gamma sum_s' p(s' | s, a) max_a' Q(s', a')    where (s, a) was tried m times or more
    Q(s, a) = q0                                                       where it was not

    r and p are means of the first m visits. They are solved by value iteration as often as a pair becomes known, and
    it acts greedily. What makes it explore is q0, which should be the largest return that there may be: Rmax / (1 -
    gamma) where no reward is above Rmax, or 0 where all are costs.
    """

    epsilon: Rate = field(default=0.0, help="Probability of exploring besides.")
    m: float = field(
        default=2.0, at_least=1, help="Visits that make a pair known; the more, the more is random."
    )
    sweeps: int = static(default=100, at_least=1, help="Sweeps of value iteration, each time.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, each state, max action",
        "By the model, of all pairs that are known, each time when one becomes so.",
    )

    def init(self, num_states: int, num_actions: int) -> ModelState:
        q, clock = super().init(num_states, num_actions)
        return ModelState(q, clock, Counts.empty(num_states, num_actions))

    def works_with(self, state: ModelState):
        return state.model.n  # as probabilities

    def update(self, key, state: ModelState, t: Transition):
        state = self.begin(state, t)
        m = jnp.asarray(self.m, state.q.dtype)
        visits = tables.entry(state.model.n, t.s, t.a).sum()
        is_new = visits < m
        model = state.model.after(t, is_new.astype(state.q.dtype))
        gamma = jnp.asarray(self.gamma, state.q.dtype)
        solved = partial(_solved, self.sweeps)
        q = tables.changed_where(is_new & (visits + 1 >= m), solved, state.q, *model, gamma, m)
        state = ModelState(q, end_step(state.clock, t.last), model)
        return state, self.policy(key, state, t.s_next)


def _solved(sweeps: int, q, n, r, ends, gamma, m) -> Float[Array, "S A"]:
    """Q as it follows from the pairs that are known, where the others stay as they are."""
    visits = n.sum(2)
    share = jnp.where(visits >= m, 1 / jnp.maximum(visits, 1), 0)
    return planned(q, n * share[..., None], r * share, ends, gamma, sweeps)
