"""Dyna-Q and Dyna-Q+: learning, planning and acting, all at once (book, sections 8.2 and 8.3; Sutton 1990)."""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.models import LastOutcomes
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class DynaState(NamedTuple):
    """A learner that keeps a table of action values, and a model of the task.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
        model: the last outcome of each pair.
        tried_at: the step in which each pair was tried last, int32 [S, A]; None where nothing goes by it.
    """

    q: Float[Array, "S A"]
    clock: Clock
    model: LastOutcomes
    tried_at: Int[Array, "S A"] | None = None


@pytree
class DynaQ(TDControl):
    """Q-learning that learns from what it remembers, too: n times after each real step.

    Q(S, A) <- Q(S, A) + alpha [R + gamma max_a Q(S', a) - Q(S, A)]      (book, the box of section 8.2)

    First from what happened, then n times from the model: S is drawn from the states that were visited, A from
    the actions that were tried there, and the model gives the R and S' that followed the last time. That is a
    model of deterministic tasks; where outcomes are random, the last one stands for all.

    The step size of an update from the model is the one of its pair at that time; a visit is a real one.
    """

    planning_steps: int = static(default=5, at_least=0, help="Updates from the model after each real step.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "Once from what happened, and some times more from what the model remembers of other pairs.",
    )

    def init(self, num_states: int, num_actions: int) -> DynaState:
        q, clock = super().init(num_states, num_actions)
        return DynaState(q, clock, LastOutcomes.empty(num_states, num_actions, self.gamma))

    def update(self, key, state: DynaState, t: Transition):
        state = self.begin(state, t)
        state = self.remember(state._replace(q=self.improved(state.q, state.clock, t)), t)

        def plan(k, q):
            draws = jax.random.fold_in(key, 2 * k), jax.random.fold_in(key, 2 * k + 1)
            at = policies.below(draws[0], state.model.known)
            s = tables.entry(state.model.states, at)
            a = policies.sample(draws[1], self.considered(state, s))
            return self.improved(q, state.clock, self.imagined(state, s, a))

        state = state._replace(
            q=lax.fori_loop(0, self.planning_steps, plan, state.q), clock=end_step(state.clock, t.last)
        )
        return state, self.policy(key, state, t.s_next)

    def improved(self, q: Float[Array, "S A"], clock: Clock, t: Transition) -> Float[Array, "S A"]:
        """Q after the update by a transition, which may be a real one."""
        q_next = policies.largest(tables.row(q, t.s_next))
        delta = t.r + t.discount * q_next - tables.entry(q, t.s, t.a)
        return tables.add(q, t.s, t.a, step_size(self.alpha, clock, t.s, t.a) * delta)

    def remember(self, state: DynaState, t: Transition) -> DynaState:
        """The learner with a transition more in its model."""
        return state._replace(model=state.model.after(t))

    def considered(self, state: DynaState, s: Int[Array, ""]) -> Float[Array, " A"]:
        """Equal weights for the actions that planning considers in a state that was visited, float [A]."""
        return tables.row(state.model.tried, s)

    def imagined(self, state: DynaState, s: Int[Array, ""], a: Int[Array, ""]) -> Transition:
        """What the model expects of a pair."""
        r, s_next, discount = (
            tables.entry(x, s, a) for x in (state.model.r, state.model.s_next, state.model.discount)
        )
        return Transition(s, a, r, s_next, discount, jnp.bool_(False))


@pytree
class DynaQPlus(DynaQ):
    """Dyna-Q that mistrusts what it has not tried for long, so that it finds out where the task has changed.

    R + kappa sqrt(tau)      (book, section 8.3)

    takes the place of R in planning, where tau is the number of steps since the pair was tried, or since the run
    began. Planning also considers actions that were never tried in a visited state: as if they led back to it with
    reward 0.
    """

    kappa: float = field(
        default=1e-3,
        at_least=0,
        help="Reward, in planning, for the root of the steps since a pair was tried.",
    )

    # Declared anew, for its bonus goes by the time: what others did, in any order, says nothing about that.
    update = DynaQ.update
    acts_after_update: ClassVar[bool] = True
    backup: ClassVar[Backup] = DynaQ.backup

    def init(self, num_states: int, num_actions: int) -> DynaState:
        state = super().init(num_states, num_actions)
        return state._replace(tried_at=jnp.zeros((num_states, num_actions), jnp.int32))

    def remember(self, state: DynaState, t: Transition) -> DynaState:
        assert state.tried_at is not None
        tried_at = tables.put(state.tried_at, state.clock.step, t.s, t.a)
        return super().remember(state, t)._replace(tried_at=tried_at)

    def considered(self, state: DynaState, s: Int[Array, ""]) -> Float[Array, " A"]:
        return (tables.row(state.q, s) > UNAVAILABLE).astype(state.q.dtype)

    def imagined(self, state: DynaState, s: Int[Array, ""], a: Int[Array, ""]) -> Transition:
        assert state.tried_at is not None
        t = super().imagined(state, s, a)
        tau = (state.clock.step - tables.entry(state.tried_at, s, a)).astype(t.r.dtype)
        return t._replace(r=t.r + self.kappa * jnp.sqrt(tau))
