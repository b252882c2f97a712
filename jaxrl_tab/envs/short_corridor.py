"""The short corridor with switched actions (book, example 13.1)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import FixedStart


@pytree
class ShortCorridor(FixedStart):
    """Three states in a row and the goal behind them; in the second, left and right are exchanged.

    From state 0 left leads nowhere and right to 1; from 1 right leads to 0 and left to 2; from 2 left leads to 1 and
    right to the goal, 3. Every step costs 1. Actions are left and right.

    Who sees the states is there in three steps. In the book nobody does: all of them look the same, which is said of
    the method (`Reinforce(groups="0,0,0,1")`). Then the best policy goes right with probability 2 - sqrt(2), about
    0.59, and is worth -(6 + 4 sqrt(2)), about -11.66, from the start; always right, or left, never arrives.
    """

    max_steps: int = static(default=1000, at_least=1, help="Time limit of an episode, in steps.")

    num_states, num_actions, start_state = 4, 2, 0

    @property
    def action_names(self) -> tuple[str, ...]:
        return "left", "right"

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        goes_right = (a == 1) != (s == 1)
        over = s == 3
        s_next = jnp.where(over, 3, jnp.where(goes_right, s + 1, jnp.maximum(s - 1, 0))).astype(jnp.int32)
        reward = jnp.where(over, 0.0, -jnp.ones(1))
        return jnp.ones(1), Outcome(s_next[None], reward, (s_next == 3)[None])
