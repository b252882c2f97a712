"""The windy gridworld (book, example 6.5 and exercises 6.9, 6.10)."""

from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.envs.base import (
    ARROWS,
    COMPASS,
    MAX_STEPS,
    Grid,
    check_cell,
    check_max_steps,
    check_shape,
)
from jaxrl_tab.types import InputError, Outcome, concrete, nearest, pytree, static

MOVES = {"four": 4, "king": 8, "king+stay": 9}


@pytree
class WindyGridworld(Grid):
    """Reach the goal across columns in which the wind blows upwards; every step costs 1.

    The wind of the column that is left moves the walker up by so many cells, in the same step; the edge of
    the grid stops both the move and the wind. With `stochastic`, the wind of a column that has any is one
    less, as told, or one more, a third each.

    Attributes:
        wind: strength of each column, whole numbers [columns]; a leaf, so `vmap` can batch it.
        moves: "four", "king" (also diagonally) or "king+stay".
        stochastic: whether the wind varies.
        shape: (rows, columns).
        start: the cell (row, column) in which episodes start, (3, 0); state 30.
        goal: the terminal cell, (3, 7); state 37.
        max_steps: time limit of an episode, in steps.
    """

    wind: Any = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
    moves: Literal["four", "king", "king+stay"] = static("four")
    stochastic: bool = static(False)
    shape: tuple[int, int] = static((7, 10))
    start: tuple[int, int] = static((3, 0))
    goal: tuple[int, int] = static((3, 7))
    max_steps: int = static(MAX_STEPS)

    def __post_init__(self):
        name = "windy-gridworld"
        if self.moves not in MOVES:
            raise InputError(f"{name}: moves {self.moves!r} is unknown; {nearest(str(self.moves), MOVES)}")
        check_shape(name, self.shape)
        check_cell(name, "start", self.start, self.shape)
        check_cell(name, "goal", self.goal, self.shape)
        check_max_steps(name, self.max_steps)
        if tuple(self.start) == tuple(self.goal):
            raise InputError(f"{name}: start and goal are the same cell {tuple(self.start)}")
        if jnp.shape(self.wind)[-1:] != (self.shape[1],):
            raise InputError(
                f"{name}: wind must have one strength for each of the {self.shape[1]} columns, "
                f"not shape {jnp.shape(self.wind)}"
            )
        wind = concrete(self.wind)
        if wind is not None:
            if not np.array_equal(wind, np.round(wind)):
                raise InputError(f"{name}: wind strengths must be whole numbers of cells, not {self.wind!r}")
            object.__setattr__(self, "wind", wind.astype(np.int32))

    @property
    def num_actions(self) -> int:
        return MOVES[self.moves]

    @property
    def action_names(self) -> tuple[str, ...]:
        return ARROWS[: self.num_actions]

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        rows, columns = self.shape
        row, column = s // columns, s % columns
        move = jnp.asarray(COMPASS)[a]
        wind = jnp.asarray(self.wind, jnp.int32)[column]
        prob, gusts = jnp.ones(1), jnp.zeros(1, jnp.int32)
        if self.stochastic:
            prob, gusts = jnp.full(3, 1 / 3), jnp.where(wind != 0, jnp.array([-1, 0, 1]), 0)
        row = jnp.clip(row + move[0] - (wind + gusts), 0, rows - 1)
        column = jnp.clip(column + move[1], 0, columns - 1)
        goal = self.state(self.goal)
        s_next = jnp.where(s == goal, s, row * columns + column)
        reward = jnp.where(s == goal, 0.0, jnp.full_like(prob, -1.0))
        return prob, Outcome(s_next, reward, s_next == goal)
