"""Baird's counterexample (book, section 11.2; Baird 1995)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Finite

UPPER = 6
DASHED, SOLID = range(2)


@pytree
class Baird(Finite):
    """Seven states, no rewards, and features with which off-policy TD diverges: the deadly triad at its smallest.

    Dashed (action 0) leads to one of the six upper states, 0 to 5, each equally likely, and solid (action 1) to the
    lower one, 6, from wherever. It starts in any state with equal probability, and goes on for ever; every reward is 0.
    The policy that acts takes dashed with probability 6/7, so that all states come equally often; asked is for the
    values of "always solid", which are 0 everywhere. An upper state i is worth 2 w_i + w_7 by its eight features, and
    the lower one w_6 + 2 w_7 (counted from 0). The book has gamma = 0.99 and weights of 1, 1, 1, 1, 1, 1, 10, 1 at the
    start.
    """

    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_states, num_actions = UPPER + 1, 2
    continuing = True
    discount = 0.99

    @property
    def action_names(self) -> tuple[str, ...]:
        return "dashed", "solid"

    @property
    def features(self) -> Float[np.ndarray, "7 8"]:
        """Those of the book, float64 [7, 8]."""
        upper = np.hstack([2 * np.eye(UPPER), np.zeros((UPPER, 1)), np.ones((UPPER, 1))])
        return np.vstack([upper, [0, 0, 0, 0, 0, 0, 1, 2]])

    @property
    def target_policy(self) -> Float[np.ndarray, "7 2"]:
        """Always solid, float64 [7, 2]."""
        return np.tile([0.0, 1.0], (self.num_states, 1))

    @property
    def behaviour_policy(self) -> Float[np.ndarray, "7 2"]:
        """Dashed with probability 6/7, float64 [7, 2]."""
        return np.tile([UPPER / self.num_states, 1 / self.num_states], (self.num_states, 1))

    def initial(self) -> Float[Array, " S"]:
        return jnp.full(self.num_states, 1 / self.num_states, dtype=float)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        upper = jnp.arange(UPPER, dtype=jnp.int32)
        s_next = jnp.where(a == DASHED, upper, UPPER)
        nothing = jnp.zeros(UPPER, float)
        return jnp.full(UPPER, 1 / UPPER, dtype=float), Outcome(s_next, nothing, jnp.zeros(UPPER, bool))
