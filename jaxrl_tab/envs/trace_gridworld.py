"""The gridworld of eligibility traces (lecture 5, "Sarsa(lambda) gridworld example"; book, figure 7.4)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Grid


@pytree
class TraceGridworld(Grid):
    """Find the goal of an empty grid; entering it gives 1, every other step 0.

    From values of 0 nothing is learned before the goal is first entered. Then one episode of Sarsa changes
    the value of one action, the last, n-step Sarsa those of the last n, and Sarsa(lambda) those of the
    whole path. With gamma below 1 the value of a cell d steps from the goal is gamma^(d - 1).
    Actions are up, right, down, left.
    """

    shape: tuple[int, int] = static(default=(9, 10), help="(rows, columns).")
    start: tuple[int, int] = static(default=(7, 1), help="The cell (row, column) in which episodes start.")
    goal: tuple[int, int] = static(default=(2, 6), help="The terminal cell.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = 4

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        goal = jnp.int32(self.state(self.goal))
        s_next = jnp.where(s == goal, goal, self.neighbour(s, a))
        reward = jnp.where((s != goal) & (s_next == goal), 1.0, 0.0).astype(float)
        return jnp.ones(1), Outcome(s_next[None], reward[None], (s_next == goal)[None])
