"""Prioritized sweeping: planning backwards from what has changed (book, section 8.4; Moore and Atkeson 1993)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.models import LastOutcomes
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class SweepingState(NamedTuple):
    """A learner that keeps a table of action values, a model of the task, and what is due to be updated.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
        model: the last outcome of each pair.
        priority: of each pair, by how much an update would change its target, float [S, A]; 0 where none is due.
        updates: how many updates were made, int32 [].
    """

    q: Float[Array, "S A"]
    clock: Clock
    model: LastOutcomes
    priority: Float[Array, "S A"]
    updates: Int[Array, ""]


@pytree
class PrioritizedSweeping(TDControl):
    """Control in deterministic tasks that updates first what would change most, and then what leads there.

    P = |R + gamma max_a Q(S', a) - Q(S, A)|      (book, the box of section 8.4)

    A pair is due with priority P where P > theta. After each real step up to n pairs that are due are updated, from
    the model, the highest priority first; each time all pairs that are known to lead to its S may become due. The
    queue is a table of priorities, of which the largest is looked for: that takes as long as the table is large.

    Of a random outcome the model remembers the last alone, so it is a method for deterministic tasks.
    """

    planning_steps: int = static(default=5, at_least=1, help="Most updates after each real step.")
    theta: float = field(
        default=1e-4, at_least=0, help="Priority up to which an update is not worth its time."
    )

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action", "From the model: of the pairs that are due, the most urgent ones."
    )

    def init(self, num_states: int, num_actions: int) -> SweepingState:
        q, clock = super().init(num_states, num_actions)
        model = LastOutcomes.empty(num_states, num_actions, self.gamma)
        return SweepingState(q, clock, model, jnp.zeros_like(q), jnp.int32(0))

    def update(self, key, state: SweepingState, t: Transition):
        state = self.begin(state, t)
        model = state.model.after(t)
        q_next = policies.largest(tables.row(state.q, t.s_next))
        error = jnp.abs(t.r + t.discount * q_next - tables.entry(state.q, t.s, t.a))
        old = tables.entry(state.priority, t.s, t.a)
        due = jnp.where(error > self.theta, jnp.maximum(old, error), old)
        priority = tables.put(state.priority, due, t.s, t.a)

        def goes_on(carry):
            turn, _, priority, s = carry
            return (turn < self.planning_steps) & (policies.largest(tables.row(priority, s)) > 0)

        def improve(carry):
            turn, q, priority, s = carry
            a = tables.row(priority, s).argmax().astype(jnp.int32)
            r, s_next, discount = (tables.entry(x, s, a) for x in (model.r, model.s_next, model.discount))
            delta = r + discount * policies.largest(tables.row(q, s_next)) - tables.entry(q, s, a)
            q = tables.add(q, s, a, step_size(self.alpha, state.clock, s, a) * delta)
            priority = tables.put(priority, jnp.zeros_like(r), s, a)
            errors = jnp.abs(model.r + model.discount * policies.largest(tables.row(q, s)) - q)
            leads_here = (model.s_next == s) & (model.tried > 0) & (errors > self.theta)
            priority = jnp.where(leads_here, jnp.maximum(priority, errors), priority)
            return turn + 1, q, priority, _first(priority)

        carry = jnp.int32(0), state.q, priority, _first(priority)
        turns, q, priority, _ = lax.while_loop(goes_on, improve, carry)
        state = SweepingState(q, end_step(state.clock, t.last), model, priority, state.updates + turns)
        return state, self.policy(key, state, t.s_next)


def _first(priority: Float[Array, "S A"]) -> Int[Array, ""]:
    """The state of the highest priority, the first of several."""
    # Over the actions first, which are few: the place of the largest number of all takes several times as long.
    return priority.max(1).argmax().astype(jnp.int32)
