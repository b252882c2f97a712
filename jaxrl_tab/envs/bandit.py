"""What bandits share: each play is an episode of one step."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import FixedStart


class Bandit(FixedStart):
    """From state 0 every action leads into the terminal state 1; the rewards differ (book, chapter 2)."""

    num_states, start_state = 2, 0
    max_steps = 1

    def rewards(self, a: Int[Array, ""]) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        """The K possible rewards of action `a`: their probabilities and they themselves, float [K] each."""
        raise NotImplementedError

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        prob, reward = self.rewards(a)
        entered, terminal = jnp.ones_like(prob, jnp.int32), jnp.ones_like(prob, bool)
        return prob, Outcome(entered, jnp.where(s == 0, reward, 0), terminal)


class NormalBandit(Bandit):
    """A bandit whose rewards are drawn from N(mean, 1): `outcomes` gives the mean, `step` adds the noise."""

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        mean = super().step(key, s, a)
        noise = jax.random.normal(key, dtype=mean.reward.dtype)
        return mean._replace(reward=mean.reward + jnp.where(s == self.start_state, noise, 0))
