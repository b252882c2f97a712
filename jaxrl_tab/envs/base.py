"""What the built-in environments share: they state their outcomes, and sampling follows from that."""

from collections.abc import Sequence
from numbers import Integral

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab import policies
from jaxrl_tab.types import InputError, Outcome


class Finite:
    """A finite MDP: `outcomes` and `initial` say everything, `step` and `reset` sample from them."""

    def initial(self) -> Float[Array, " S"]:
        raise NotImplementedError

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        raise NotImplementedError

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, self.initial())

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        prob, outcome = self.outcomes(s, a)
        k = 0 if prob.shape[0] == 1 else policies.sample(key, prob)
        return jax.tree.map(lambda x: x[k], outcome)


class Grid(Finite):
    """A rectangle of cells, numbered row by row from the top left; one start, one goal that is terminal.

    Attributes:
        shape: (rows, columns).
        start, goal: cells, as (row, column).
        action_names: a short name or an arrow for each action, for pictures.
    """

    shape: tuple[int, int]
    start: tuple[int, int]
    goal: tuple[int, int]

    @property
    def num_states(self) -> int:
        return self.shape[0] * self.shape[1]

    def state(self, cell: tuple[int, int]) -> int:
        """The number of the state at (row, column)."""
        return cell[0] * self.shape[1] + cell[1]

    def initial(self) -> Float[Array, " S"]:
        return jnp.zeros(self.num_states, dtype=float).at[self.state(self.start)].set(1)

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return jnp.int32(self.state(self.start))


def check_shape(name: str, shape: Sequence[int]) -> None:
    """Raises InputError unless `shape` is two positive integers and has at least two cells."""
    if len(shape) != 2 or not all(isinstance(n, Integral) and n > 0 for n in shape) or shape[0] * shape[1] < 2:
        raise InputError(f"{name}: shape must be (rows, columns) with at least two cells, not {shape!r}")


def check_cell(name: str, what: str, cell: Sequence[int], shape: Sequence[int]) -> None:
    """Raises InputError unless `cell` is a (row, column) inside `shape`."""
    if len(cell) != 2 or not all(isinstance(n, Integral) for n in cell):
        raise InputError(f"{name}: {what} must be (row, column), not {cell!r}")
    if not (0 <= cell[0] < shape[0] and 0 <= cell[1] < shape[1]):
        raise InputError(
            f"{name}: {what} {tuple(cell)} is outside the grid of {shape[0]} rows and {shape[1]} columns"
        )


def check_max_steps(name: str, max_steps: int) -> None:
    """Raises InputError unless the time limit is a positive integer."""
    if not isinstance(max_steps, Integral) or max_steps < 1:
        raise InputError(f"{name}: max_steps must be a whole number of at least 1, not {max_steps!r}")


# (row, column) of each move, and how it is drawn. "four" are the first four, the king also moves diagonally.
COMPASS = ((-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1), (0, 0))
ARROWS = ("↑", "→", "↓", "←", "↗", "↘", "↙", "↖", "·")
MAX_STEPS = 100_000  # long enough that no sensible run meets it: it is there so that every episode ends
