"""The windy gridworld (book, example 6.5 and exercises 6.9, 6.10)."""

from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import InputError, assign, check_choice, check_switches, numbers, unbatched, whole
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, Grid, check_grid

NAME = "windy-gridworld"
MOVES = {"four": 4, "king": 8, "king+stay": 9}


@pytree
class WindyGridworld(Grid):
    """Reach the goal across columns in which the wind blows upwards; every step costs 1.

    The wind of the column that is left carries the walker up by so many cells, in the same step; the edge of
    the grid stops the sum of move and wind. With `stochastic`, the wind of a column that has any is one less,
    as told, or one more, a third each. Actions are up, right, down, left; then, for a king, up-right,
    down-right, down-left, up-left; then stay. `wind` is a leaf: `vmap` can batch it.

    Attributes:
        wind: strength of each column, whole numbers [columns], below 0 downwards.
        moves: "four", "king" (also diagonally) or "king+stay".
        stochastic: whether the wind varies.
        shape: (rows, columns).
        start: the cell (row, column) in which episodes start; (3, 0) is state 30.
        goal: the terminal cell; (3, 7) is state 37.
        max_steps: time limit of an episode, in steps.
    """

    wind: Any = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
    moves: Literal["four", "king", "king+stay"] = static(default="four")
    stochastic: bool = static(default=False)
    shape: tuple[int, int] = static(default=(7, 10))
    start: tuple[int, int] = static(default=(3, 0))
    goal: tuple[int, int] = static(default=(3, 7))
    max_steps: int = static(default=MAX_STEPS)

    def __post_init__(self):
        check_choice(NAME, "moves", self.moves, MOVES)
        check_switches(NAME, self)
        shape, start, goal = check_grid(NAME, self.shape, self.start, self.goal)
        wind = _whole_cells(self.wind)
        if wind.shape[-1:] != (shape[1],):
            raise InputError(
                f"{NAME}: wind must have one strength for each of the {shape[1]} columns, "
                f"not shape {wind.shape}"
            )
        max_steps = whole(NAME, "max_steps", self.max_steps)
        assign(self, wind=wind, max_steps=max_steps)
        assign(self, shape=shape, start=start, goal=goal)

    @property
    def num_actions(self) -> int:
        return MOVES[self.moves]

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        wind = unbatched(NAME, "wind", self.wind, ndim=1, dtype=jnp.int32)
        lift, prob = wind[s % self.shape[1]], jnp.ones(1)
        if self.stochastic:
            gust = jnp.array([-1, 0, 1], jnp.int32)
            lift, prob = jnp.where(lift != 0, lift + gust, lift), jnp.full(3, 1 / 3, dtype=float)
        goal = jnp.int32(self.state(self.goal))
        s_next = jnp.where(s == goal, goal, self.neighbour(s, a, lift)).reshape(prob.shape)
        reward = jnp.where(s == goal, 0.0, jnp.full_like(prob, -1.0))
        return prob, Outcome(s_next, reward, s_next == goal)


def _whole_cells(wind: Any) -> Any:
    """`wind` as int32; a tracer as it is. Raises InputError unless it is whole numbers."""
    strengths = numbers(NAME, "wind", wind)
    if not isinstance(strengths, np.ndarray):
        return strengths
    with np.errstate(invalid="ignore"):  # NaN and infinity become some other number
        cells = strengths.astype(np.int32)
    if (wrong := cells != strengths).any():
        raise InputError(f"{NAME}: wind must be whole numbers of cells, not {strengths[wrong][0]}")
    return cells
