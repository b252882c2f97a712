"""Maximisation bias (book, example 6.7 and figure 6.5)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import FixedStart

A, B, END = range(3)
LEFT = 0
MEAN = -0.1  # of the rewards in B; their standard deviation is 1


@pytree
class MaximizationBias(FixedStart):
    """Go right for 0 or left for -0.1 on average: the largest of many noisy estimates makes left look good.

    Episodes start in A, state 0. Left (action 0) leads to B, state 1, right (action 1) ends the episode; both
    give 0. In B there are many actions, and all end the episode with a reward from N(-0.1, 1). So left is
    worse, but a method that takes the maximum of its estimates in B for the value of B goes left for long.
    An episode is of two steps if it went left and of one if it went right: the share of left is the mean
    length of episodes, less 1. `outcomes` gives the mean of the reward, `step` adds the noise.

    A has two actions, left and right, and B has more: see `available`. **That matters**: a copy of left in A
    would have an estimate of its own, and it is the largest of the estimates that counts. With five copies of
    each of the two (epsilon 0.1, alpha 0.1, plain loops, 10 000 runs) Q-learning goes left in 63% of runs in
    episode 100, and Double Q-learning in 58% in episode 10; with two actions, as here and in the book, it is
    46% in both.
    """

    actions: int = static(default=10, at_least=2, help="Number of actions in B.")

    num_states, start_state = 3, A
    max_steps = 2

    @property
    def num_actions(self) -> int:
        return self.actions

    def available(self, s: Int[Array, ""]) -> Bool[Array, " A"]:
        """The actions that there are in `s`, bool [A]: in A the first two, elsewhere all."""
        return (jnp.arange(self.actions) < 2) | (s != A)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        s_next = jnp.where((s == A) & (a == LEFT), jnp.int32(B), jnp.int32(END))
        reward = jnp.where(s == B, MEAN, 0.0).astype(float)
        return jnp.ones(1), Outcome(s_next[None], reward[None], (s_next == END)[None])

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        mean = super().step(key, s, a)
        noise = jax.random.normal(key, dtype=mean.reward.dtype)
        return mean._replace(reward=mean.reward + jnp.where(s == B, noise, 0))
