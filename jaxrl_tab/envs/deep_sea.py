"""Deep sea: one way down out of very many is worth it (Osband, Van Roy, Russo and Wen 2019)."""

import dataclasses
from collections.abc import Callable
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import tables
from jaxrl_tab.core.checks import Numbers, assign, unbatched
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import FixedStart, Panel


@pytree
class DeepSea(FixedStart):
    """Dive from the top left, one row deeper with each step; only who goes right each time finds the treasure of 1.

    Of the two actions one leads a column left (or down along the left side), the other one a column right, at a cost
    of 0.01 / size. The episode ends below the last row, after `size` steps, and who then goes right in the last column
    gets 1 besides: 0.99 in all, the best there is. All other ways cost, or give nothing. Who takes actions at random
    finds the treasure in one of 2^size episodes; and until then the costs teach not to go right at all.

    Which of the actions is right is drawn for each cell and each run, as in the paper, so that nothing can be learned
    from one cell for another; with `--no-random` action 1 is everywhere. State row x size + column; the last state is
    terminal. `right` is a leaf: `vmap` can batch it.
    """

    size: int = static(default=10, at_least=2, help="Number of rows, and of columns.")
    random: bool = static(
        default=True, help="Whether each run draws which action leads right, for each cell."
    )
    right: Numbers = field(
        default=1.0, at_least=0, at_most=1, help="The action that leads right, [size x size], or one for all."
    )

    num_actions, start_state = 2, 0

    def __post_init__(self):
        cells = self.size**2
        if isinstance(self.right, np.ndarray) and self.right.ndim == 0:
            assign(self, right=np.full(cells, self.right))
        if (shape := np.shape(self.right))[-1:] != (cells,):
            problem = f"right must have one number for each of the {cells} cells, not shape {shape}"
            raise InputError(problem, who=type(self).__name__, field="right")

    @property
    def max_steps(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.size

    @property
    def horizon(self) -> int:
        return self.size

    @property
    def num_states(self) -> int:
        return self.size**2 + 1

    def panels(self) -> tuple[Panel, ...]:
        cells = np.arange(self.size**2).reshape(self.size, self.size)
        names = tuple(map(str, range(self.size)))
        return (Panel("", cells, names, names, down="depth", along="column"),)

    @property
    def instance(self) -> Callable[[Key[Array, ""]], Self] | None:
        return self._drawn if self.random else None

    def _drawn(self, key: Key[Array, ""]) -> Self:
        """The environment with `right` drawn from `key`, each action equally likely for each cell."""
        right = jax.random.bernoulli(key, 0.5, (self.size**2,)).astype(float)
        return dataclasses.replace(self, right=right)

    def mean_optimal_value(self, gamma: float) -> float:
        """v* from the start, the same for all problems."""
        return float(gamma ** (self.size - 1) - 0.01 / self.size * sum(gamma**n for n in range(self.size)))

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        s, size, end = jnp.asarray(s, jnp.int32), self.size, jnp.int32(self.size**2)
        column, over = s % size, s == end
        is_right = a == tables.entry(unbatched(self, "right", ndim=1), jnp.minimum(s, end - 1))
        moved = jnp.clip(column + jnp.where(is_right, 1, -1), 0, size - 1)
        s_next = jnp.where(s >= end - size, end, s - column + size + moved).astype(jnp.int32)
        found: Any = is_right & (s == end - 1)
        reward = jnp.where(is_right, -0.01 / size, 0.0) + jnp.where(found, 1.0, 0.0)
        return jnp.ones(1), Outcome(
            s_next[None], jnp.where(over, 0.0, reward)[None].astype(float), (s_next == end)[None]
        )
