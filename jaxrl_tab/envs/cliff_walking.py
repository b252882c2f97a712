"""Cliff walking (book, example 6.6), and as Gymnasium has it, slippery as well."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import assign
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Grid, check_shape


@pytree
class CliffWalking(Grid):
    """Walk along a cliff from one bottom corner to the other; a fall costs 100 and leads back to the start.

    The cliff is the bottom row between its two ends. A step onto it costs 100, and the walker is back at the
    start in the same step; the episode goes on. Every other step costs 1, the one onto the goal as well.
    Actions are up, right, down, left. The cells of the cliff are states that no walker is ever in.

    On slippery ground a move goes as it should, or to one of its two sides, each with probability 1/3: so it is in
    Gymnasium's CliffWalkingSlippery-v1, state by state. With gamma 1 the optimal values from the start are -13 and,
    slippery, -64.709176.
    """

    shape: tuple[int, int] = static(
        default=(4, 12),
        help="(rows, columns), at least 2 x 3. Of the book's 4 x 12, the start is state 36, the goal 47.",
    )
    is_slippery: bool = static(default=False, help="Whether moves can go wrong.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = 4

    def __post_init__(self):  # not that of Grid: start and goal follow from the shape
        assign(self, shape=check_shape(type(self).__name__, self.shape, least=(2, 3)))

    @property
    def start(self) -> tuple[int, int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.shape[0] - 1, 0

    @property
    def goal(self) -> tuple[int, int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.shape[0] - 1, self.shape[1] - 1

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        start, goal = jnp.int32(self.start_state), jnp.int32(self.state(self.goal))
        turns = jnp.arange(-1, 2) if self.is_slippery else jnp.zeros(1, jnp.int32)
        entered = jax.vmap(lambda turn: self.neighbour(s, (a + turn) % 4))(turns)
        fall = (start < entered) & (entered < goal)
        s_next = jnp.where(s == goal, goal, jnp.where(fall, start, entered))
        reward = jnp.where(s == goal, 0.0, jnp.where(fall, -100.0, -1.0)).astype(float)
        return jnp.ones(len(turns)) / len(turns), Outcome(s_next, reward, s_next == goal)
