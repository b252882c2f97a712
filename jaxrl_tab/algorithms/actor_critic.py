"""Actor-critic methods: policy gradient with a bootstrapping critic (book, section 13.5)."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.policy_gradient import Preferences, ValueBaseline, grad_log
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.clock import Clock, at_visit, end_step, step_size
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


class ActorCriticState(NamedTuple):
    """A learner of preferences (the actor) and of values of states (the critic).

    Attributes:
        policy: the preferences.
        clock: what the schedules of the step sizes count.
        v: V, float [S].
        power: gamma^t in step t of the episode, float [].
        z: the traces of the actor, float [S, A]; None without traces.
        z_v: the traces of the critic, float [S]; None without traces.
    """

    policy: Preferences
    clock: Clock
    v: Float[Array, " S"]
    power: Float[Array, ""]
    z: Float[Array, "S A"] | None
    z_v: Float[Array, " S"] | None

    @property
    def q(self) -> Float[Any, "... S A"]:
        return self.policy.of_states


@pytree
class ActorCritic(ValueBaseline):
    """One-step actor-critic: the error of V, which TD(0) learns from, says whether an action was better than expected.

    delta <- R + gamma V(S') - V(S)
    V(S) <- V(S) + alpha_v delta
    theta <- theta + alpha gamma^t delta grad ln pi(A | S, theta)      (book, box of section 13.5)
    """

    backup: ClassVar[Backup] = Backup("action, state", "The value of S' is that of the critic.")

    def init(self, num_states: int, num_actions: int) -> ActorCriticState:
        policy, clock = self.begun(num_states, num_actions)
        v, one = jnp.full(len(policy.theta), self.v0, dtype=float), jnp.ones((), policy.theta.dtype)
        return ActorCriticState(policy, clock, v, one, z=None, z_v=None)

    def learned(self, state: ActorCriticState, t: Transition) -> ActorCriticState:
        state = self.begin(state, t)
        delta = t.r + t.discount * tables.entry(state.v, t.s_next) - tables.entry(state.v, t.s)
        return self.learn(state, t, delta)

    def learn(self, state: ActorCriticState, t: Transition, delta: Float[Array, ""]) -> ActorCriticState:
        """V and theta after an error; and counts the step of the episode, or the episode where it is over."""
        v = tables.put(state.v, tables.entry(state.v, t.s) + self.rate_of_values(state.clock, t) * delta, t.s)
        policy = self.reinforced(state, t, state.power * delta)
        return self.ended(state._replace(policy=policy, v=v), t)

    def rate_of_values(self, clock: Clock, t: Transition) -> Any:
        """alpha_v in the step that has begun."""
        visits = None if clock.visits is None else tables.row(clock.visits, t.s).sum()
        return at_visit(self.alpha_v, clock, visits)

    def ended(self, state: ActorCriticState, t: Transition) -> ActorCriticState:
        """The state at the end of a step."""
        power = jnp.where(t.last, 1, t.discount * state.power)
        return state._replace(clock=end_step(state.clock, t.last), power=power)


@pytree
class ActorCriticLambda(ActorCritic):
    """Actor-critic with eligibility traces: each error also goes to the earlier steps of the episode.

    z_v <- gamma lambda_v z_v + 1[s = S],  z <- gamma lambda z + gamma^t grad ln pi(A | S, theta)
    V <- V + alpha_v delta z_v,  theta <- theta + alpha delta z
                                                  (book, box "with eligibility traces" of section 13.5)

    Where step sizes are schedules, those of the current step go for all states that it credits.
    """

    lam: float = field(default=0.9, at_least=0, at_most=1, help="lambda of the actor.")
    lam_v: float = field(default=0.9, at_least=0, at_most=1, help="lambda of the critic.")

    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action", last="state"),
        "Traces carry each error back to the actions of earlier steps, which adds up to this, nearly.",
    )

    def init(self, num_states: int, num_actions: int) -> ActorCriticState:
        state = super().init(num_states, num_actions)
        return state._replace(z=jnp.zeros_like(state.policy.theta), z_v=jnp.zeros_like(state.v))

    def learn(self, state: ActorCriticState, t: Transition, delta: Float[Array, ""]) -> ActorCriticState:
        assert state.z is not None and state.z_v is not None
        policy, alpha = state.policy, step_size(self.alpha, state.clock, t.s, t.a)
        z_v = tables.put(state.z_v, tables.entry(state.z_v, t.s) + 1, t.s)
        z = tables.add_row(state.z, t.s, state.power * grad_log(tables.row(policy.theta, t.s), t.a))
        v = state.v + self.rate_of_values(state.clock, t) * delta * z_v
        if self.optimizer is None:
            policy = policy._replace(theta=policy.theta + alpha * (delta * z))
        else:
            policy = self.ascended(policy, delta * z, alpha)
        fade = jnp.where(t.last, 0, t.discount)
        return self.ended(
            state._replace(policy=policy, v=v, z=fade * self.lam * z, z_v=fade * self.lam_v * z_v), t
        )
