"""Mazes that change while a run goes on (book, section 8.3, examples 8.2 and 8.3)."""

import dataclasses
import functools
from typing import Any, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core import tables
from jaxrl_tab.core.checks import assign, concrete
from jaxrl_tab.core.describe import Lines
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.drawing import WALL
from jaxrl_tab.envs.maze import Maze, Plan, letters_of, outcomes_of, tabulated


@pytree
class ChangingMaze(Maze):
    """A maze of which another map holds from some step of the run on, counted over all of its episodes.

    Both are as `Maze` explains them. Where a walker stands as a wall comes, it walks out of it as it did before.

    `at(step)` is the maze in a step of the run. The maze itself, with its exact values and pictures, is the first
    one, or with changed = 1 the second. A sweep records no exact values, for none hold in all of its steps.
    """

    after: Lines = static(
        default=("S.#.G", "..#..", "....."),
        help="The map from the change on, of the same size, with the same starts and rules.",
    )
    change_at: int = static(default=1000, at_least=0, help="The first step of a run in which it holds.")
    changed: float = field(default=0.0, at_least=0, at_most=1, help="1: it holds from the beginning.")

    def __post_init__(self):
        super().__post_init__()
        assign(self, after=self._maze(self.after).map)
        (first, second), who = self.plans, type(self).__name__
        shapes = [(len(plan.rows), len(plan.rows[0])) for plan in self.plans]
        if shapes[0] != shapes[1]:
            problem = "the map after the change is {} x {}, and the first one {} x {}".format(
                *shapes[1], *shapes[0]
            )
            raise InputError(problem, who=who, field="after")
        one, other = tabulated(first), tabulated(second)
        alike = one.prob.shape == other.prob.shape and one.starts.tolist() == other.starts.tolist()
        if not alike or first._replace(rows=second.rows) != second:
            problem = (
                "both maps must have the same starts, and the same rules: legends, rewards, slips, and wind"
            )
            raise InputError(problem, who=who, field="after")

    @functools.cached_property
    def plans(self) -> tuple[Plan, Plan]:
        """The two, in their order."""
        return self._maze(self.map).plan, self._maze(self.after).plan

    def _maze(self, map: Lines) -> Maze:
        own: Any = {f.name: getattr(self, f.name) for f in dataclasses.fields(Maze)}
        return Maze(**own | {"map": map})

    @functools.cached_property
    def plan(self) -> Plan:
        """The one that people see; the first where a run is on its way."""
        return self.plans[int((changed := concrete(self.changed)) is not None and bool((changed > 0).all()))]

    def at(self, step: Int[Array, ""]) -> Self:
        """The maze in a step of the run, int [], counted from 0."""
        now = jnp.maximum(self.changed, (step >= self.change_at).astype(float))
        return jax.tree.map(lambda _: now, self)  # `changed` is its only number

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        first, second = (outcomes_of(plan, s, a) for plan in self.plans)
        before, after = (letters_of(plan) == WALL for plan in self.plans)
        in_new_wall = tables.entry(jnp.asarray(~before & after), s)
        return jax.tree.map(
            lambda x, y: jnp.where((jnp.asarray(self.changed) > 0) & ~in_new_wall, y, x), first, second
        )


@pytree
class BlockingMaze(ChangingMaze):
    """A maze whose short way is blocked in step 1000 of a run, while a longer one opens (book, example 8.2)."""

    map: Lines = static(default="barrier-left")
    after: Lines = static(default="barrier-right")
    change_at: int = static(default=1000)


@pytree
class ShortcutMaze(ChangingMaze):
    """A maze in which a short way opens in step 3000 of a run, and no other is blocked (book, example 8.3)."""

    map: Lines = static(default="barrier-right")
    after: Lines = static(default="barrier-short")
    change_at: int = static(default=3000)
