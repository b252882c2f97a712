"""The windy gridworld (book, example 6.5 and exercises 6.9, 6.10)."""

from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import assign, numbers, unbatched
from jaxrl_tab.core.errors import InputError, unfit
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Grid

MOVES = {"four": 4, "king": 8, "king+stay": 9}


@pytree
class WindyGridworld(Grid):
    """Reach the goal across columns in which the wind blows upwards; every step costs 1.

    The wind of the column that is left carries the walker up by so many cells, in the same step; the edge of
    the grid stops the sum of move and wind. With `stochastic`, the wind of a column that has any is one less,
    as told, or one more, a third each. Actions are up, right, down, left; then, for a king, up-right,
    down-right, down-left, up-left; then stay. `wind` is a leaf: `vmap` can batch it.
    """

    wind: Any = field(
        default=(0, 0, 0, 1, 1, 1, 2, 2, 1, 0),
        help="Strength of each column, whole numbers [columns], below 0 downwards.",
    )
    moves: Literal["four", "king", "king+stay"] = static(
        default="four", help="The actions; a king moves diagonally, too."
    )
    stochastic: bool = static(default=False, help="Whether the wind varies.")
    shape: tuple[int, int] = static(default=(7, 10), help="(rows, columns).")
    start: tuple[int, int] = static(
        default=(3, 0), help="The cell (row, column) in which episodes start; (3, 0) is state 30."
    )
    goal: tuple[int, int] = static(default=(3, 7), help="The terminal cell; (3, 7) is state 37.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    def __post_init__(self):
        super().__post_init__()
        who, (_, columns) = type(self).__name__, self.shape
        wind = _whole_cells(who, self.wind)
        if wind.shape[-1:] != (columns,):
            requirement = f"one strength for each of the {columns} columns"
            raise InputError(f"wind must have {requirement}, not shape {wind.shape}", who=who, field="wind")
        assign(self, wind=wind)

    @property
    def num_actions(self) -> int:
        return MOVES[self.moves]

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        wind = unbatched(self, "wind", ndim=1, dtype=jnp.int32)
        lift, prob = wind[s % self.shape[1]], jnp.ones(1)
        if self.stochastic:
            gust = jnp.array([-1, 0, 1], jnp.int32)
            lift, prob = jnp.where(lift != 0, lift + gust, lift), jnp.full(3, 1 / 3, dtype=float)
        goal = jnp.int32(self.state(self.goal))
        s_next = jnp.where(s == goal, goal, self.neighbour(s, a, lift)).reshape(prob.shape)
        reward = jnp.where(s == goal, 0.0, jnp.full_like(prob, -1.0))
        return prob, Outcome(s_next, reward, s_next == goal)


def _whole_cells(who: str, wind: Any) -> Any:
    """`wind` as int32; a tracer as it is. Raises InputError unless it is whole numbers."""
    strengths = numbers(who, "wind", wind)
    if not isinstance(strengths, np.ndarray):
        return strengths
    with np.errstate(invalid="ignore"):  # NaN and infinity become some other number
        cells = strengths.astype(np.int32)
    if (wrong := cells != strengths).any():
        raise unfit(who, "wind", "whole numbers of cells", strengths[wrong][0].item())
    return cells
