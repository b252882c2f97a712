"""The gambler's problem (book, example 4.3)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Finite


@pytree
class GamblersProblem(Finite):
    """Bet on heads until there are 100 dollars, or none; only the 100 give a reward, of 1.

    A state is the capital, an action the stake, of which there are those from 1 to the capital, or to what is missing.
    Where heads come up the gambler wins the stake, else loses it. Capitals 0 and 100 are terminal. The book does not
    say with how much an episode starts: here with any of 1 to 99 dollars, each equally likely. Undiscounted, a value is
    the probability to get to the 100.

    The book has the stake of 0 as well, which changes nothing and so is as good as the best; here it is left out, for
    who has learned a little may like it best, and stay for ever. Where p_h < 1/2 it is optimal to stake all that one
    has, or all that is missing, among other stakes: v*(s) is p_h v*(2 s) up to half of the goal, and
    p_h + (1 - p_h) v*(2 s - goal) from there (Dubins and Savage 1965, How to gamble if you must). Where p_h > 1/2 it is
    to stake a dollar at a time, and with r = (1 - p_h) / p_h v*(s) is (1 - r^s) / (1 - r^goal).
    """

    p_h: float = field(default=0.4, at_least=0, at_most=1, help="Probability of heads.")
    goal: int = static(default=100, at_least=2, help="The capital to reach, in dollars.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    @property
    def num_states(self) -> int:
        return self.goal + 1

    @property
    def num_actions(self) -> int:
        return self.goal // 2 + 1

    def available(self, s: Int[Array, ""]) -> Bool[Array, " A"]:
        """The stakes that there are with capital `s`, bool [A]; where it is over, 0."""
        stakes, most = jnp.arange(self.num_actions), jnp.minimum(s, self.goal - s)
        return (stakes <= most) & ((stakes > 0) | (most == 0))

    def initial(self) -> Float[Array, " S"]:
        return jnp.zeros(self.num_states, dtype=float).at[1 : self.goal].set(1 / (self.goal - 1))

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return 1 + policies.below(key, self.goal - 1)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        heads = unbatched(self, "p_h", ndim=0)
        s = jnp.asarray(s, jnp.int32)
        stake = jnp.minimum(jnp.asarray(a, jnp.int32), jnp.minimum(s, self.goal - s))  # no more than there is
        s_next = jnp.stack([s + stake, s - stake])
        reward = jnp.where((s_next == self.goal) & (s != self.goal), 1.0, 0.0).astype(float)
        return jnp.stack([heads, 1 - heads]), Outcome(s_next, reward, (s_next == 0) | (s_next == self.goal))
