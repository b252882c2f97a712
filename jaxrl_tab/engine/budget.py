"""How long a run is, and what is recorded of it: one object from `train` to the experiment."""

import dataclasses
from collections.abc import Callable
from typing import Any, Self, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxrl_tab.core import names
from jaxrl_tab.core.errors import InputError, is_whole, shown
from jaxrl_tab.core.types import table_of

Record: TypeAlias = Callable[[Any], dict[str, Array]]


@dataclasses.dataclass(frozen=True)
class Tables:
    """Records the table of values. It is an object with a name, so that its program can be kept.

    Attributes:
        num_states: of the task; a method with features works out the value of each.
    """

    num_states: int

    def of(self, method: Any, learner: Any) -> dict[str, Array]:
        """What is recorded of a method, fitted to the task, and the state of its learner."""
        return {"table": table_of(method, self.num_states, learner)}


@dataclasses.dataclass(frozen=True)
class AtPoints(Tables):
    """The same where states cannot be counted, at points in their range.

    Attributes:
        points: what is observed of a state there, N times d numbers.
    """

    points: tuple[tuple[float, ...], ...]

    @classmethod
    def of_array(cls, points: np.ndarray) -> Self:
        return cls(0, tuple(map(tuple, points.tolist())))

    def of(self, method: Any, learner: Any) -> dict[str, Array]:
        points = jnp.asarray(self.points, learner.q.dtype)
        return {"table": jax.vmap(method.row, (None, 0))(learner, points)}


Recorder: TypeAlias = Record | Tables

NO_RECORDER = "record must be a function from the state of the learner to a dict of arrays"
RECORDER = names.Functions(
    "a function that records",
    hint="give a function, or its name, 'file.py:function' or 'package.module:function'",
)


@dataclasses.dataclass(frozen=True)
class Budget:
    """How long a run is, and what is recorded of it.

    Attributes:
        num_steps: how many steps to take. Give this or `num_episodes`.
        num_episodes: how many episodes to finish.
        log_every: steps in a row of the log, or episodes where they are the budget; see `row`.
        exact: whether exact values are recorded at the end of rows.
        record: a function from the state of the learner to a dict of arrays, recorded at the end of every row.
        exact_every: of how many rows one has exact values, and the last has them; if it is given, `exact` is True.
            The errors of prediction, which cost little, are recorded in every row.

    Raises:
        InputError: neither or both of the lengths are given, a number is not whole or below 1, or `record` is
            no function.
    """

    num_steps: int | None = None
    num_episodes: int | None = None
    log_every: int | None = None
    exact: bool = False
    record: Recorder | None = None
    exact_every: int | None = None

    def __post_init__(self):
        if (self.num_steps is None) == (self.num_episodes is None):
            raise InputError("give either a number of steps or one of episodes: how long a run is")
        for name in ("num_steps", "num_episodes", "log_every", "exact_every"):
            if (value := getattr(self, name)) is not None and not is_whole(value):
                raise InputError(f"{name} must be a whole number of at least 1, not {shown(value)}")
        if not (self.record is None or isinstance(self.record, Tables) or callable(self.record)):
            raise InputError(NO_RECORDER)
        object.__setattr__(self, "exact", self.exact or self.exact_every is not None)

    @property
    def exact_row(self) -> int:
        """Of how many rows one has exact values, where they are recorded: of one, by default."""
        return self.exact_every or 1

    @property
    def row(self) -> int:
        """How many steps, or episodes, a row of the log sums up: 100 steps, or 1 episode, by default."""
        return self.log_every or (1 if self.num_steps is None else 100)
