"""The gradient bandit algorithm (book, section 2.8)."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.policy_gradient import PolicyGradient, Preferences
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Transition


class GradientBanditState(NamedTuple):
    """A learner of preferences that compares rewards with their mean.

    Attributes:
        policy: the preferences.
        clock: what a schedule of alpha counts.
        mean: the mean of the rewards that came in each state, float [S]; None without a baseline.
        rewards: how many there were, int32 [S]; None without a baseline.
    """

    policy: Preferences
    clock: Clock
    mean: Float[Array, " S"] | None
    rewards: Int[Array, " S"] | None

    @property
    def q(self) -> Float[Any, "... S A"]:
        return self.policy.of_states


@pytree
class GradientBandit(PolicyGradient):
    """Stochastic gradient ascent of the expected reward, for bandits.

    H(A) <- H(A) + alpha (R - mean) (1 - pi(A)),  H(a) <- H(a) - alpha (R - mean) pi(a)  for all other a
                                                                                  (book, equation 2.12)

    The mean is that of the rewards before this one (of the first, R itself, from which nothing is learned then). The
    preferences H are theta. Each state is a bandit of its own: what follows a reward is not asked for, so it is no
    method for longer episodes; see `Reinforce` and `ActorCritic`.
    """

    baseline: bool = static(default=True, help="Whether rewards are compared with their mean, or with 0.")

    backup: ClassVar[Backup] = Backup("action, end", "The reward alone counts, not what follows it.")

    def init(self, num_states: int, num_actions: int) -> GradientBanditState:
        policy, clock = self.begun(num_states, num_actions)
        mean = jnp.zeros(len(policy.theta), policy.theta.dtype) if self.baseline else None
        rewards = jnp.zeros(len(policy.theta), jnp.int32) if self.baseline else None
        return GradientBanditState(policy, clock, mean, rewards)

    def learned(self, state: GradientBanditState, t: Transition) -> GradientBanditState:
        state, x = self.begin(state, t), t.r
        if state.mean is not None and state.rewards is not None:
            n = tables.entry(state.rewards, t.s) + 1
            mean = jnp.where(n == 1, t.r, tables.entry(state.mean, t.s))
            x = t.r - mean
            after = mean + x / n.astype(x.dtype)
            state = state._replace(
                mean=tables.put(state.mean, after, t.s), rewards=tables.put(state.rewards, n, t.s)
            )
        return state._replace(policy=self.reinforced(state, t, x), clock=end_step(state.clock, t.last))
