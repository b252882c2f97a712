"""The runs of a batch, as what a program takes."""

import dataclasses
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Int

from jaxrl_tab.core.types import Algorithm, Environment
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.loop import Run
from jaxrl_tab.engine.onward import Onward, split
from jaxrl_tab.engine.room import Needs, needs_of, program_arguments


@dataclasses.dataclass(frozen=True, eq=False)
class Runs:
    """Some runs of one program.

    Attributes:
        env: the environment, the same for all.
        algorithms: one method whose leaves are NumPy arrays, whose leading axes broadcast to `seeds`.
        root: JAX key; a run uses `fold_in(root, its seed)`.
        seeds: the number of each run's seed, uint32 [...]; runs are numbered in C order.
        budget: what to do in each run.
        numbers: the numbers of the runs to train, int [n]. A place is one in this list.
        begun: where these runs are, which go on, [n, ...] each; None: at time 0.
    """

    env: Environment
    algorithms: Algorithm | Onward
    root: jax.Array
    seeds: np.ndarray
    budget: Budget
    numbers: Int[np.ndarray, " n"]
    begun: Run | None = None

    def __len__(self) -> int:
        return len(self.numbers)

    def arguments(self, places: Int[np.ndarray, "*k"]) -> tuple:
        """What a program takes, as `room.program_arguments`, for the runs at these places, [*k] each.

        Beyond the last run it is that of the last one.
        """
        shape = self.seeds.shape
        places = np.minimum(places, len(self) - 1)
        index = np.unravel_index(self.numbers[places], shape)
        broadcast = lambda x: np.broadcast_to(x, shape + x.shape[len(shape) :])
        seeds, algorithms = jax.tree.map(lambda x: broadcast(x)[index], (self.seeds, self.algorithms))
        if self.begun is not None:
            algorithms = Onward(split(algorithms).method, jax.tree.map(lambda x: x[places], self.begun))
        return program_arguments(self.budget, self.root, seeds, algorithms, self.env)

    @cached_property
    def needs(self) -> Needs:
        """What one of them needs of memory."""
        _, _, (algorithm, _), _ = self.arguments(np.array(0))
        return needs_of(self.env, algorithm, self.root, self.budget)
