"""What the built-in environments share: they state their outcomes, and sampling follows from that."""

from collections.abc import Callable, Sequence
from numbers import Integral
from typing import Any, NamedTuple, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.checks import assign, is_list
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError, unfit
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.types import Outcome

MAX_STEPS = 10_000  # long enough that no sensible run meets it: it is there so that every episode ends

TIME_LIMIT = "Time limit of an episode, in steps."

# (row, column) of each move, and how it is drawn. The first four are those of the book's grids.
COMPASS = ((-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1), (0, 0))

ARROWS = ("↑", "→", "↓", "←", "↗", "↘", "↙", "↖", "·")


class Panel(NamedTuple):
    """States that people see side by side in a table.

    Attributes:
        title: what they have in common, "usable ace"; empty where it is all of them.
        states: their numbers, int [rows, columns].
        rows, columns: names of the rows, from the top, and of the columns.
        down, along: what the rows and the columns are, "player", "dealer shows"; empty where that is plain.
    """

    title: str
    states: Int[np.ndarray, "rows columns"]
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    down: str = ""
    along: str = ""


class Finite(Shown):
    """A finite MDP: `outcomes` and `initial` say everything, `step` and `reset` sample from them.

    Attributes:
        num_states, num_actions, max_steps: as in `types.Environment`.
    """

    # Of an environment they are a class attribute, a field or a property; no annotation allows for all three.
    num_states: Any
    num_actions: Any
    max_steps: int

    @property
    def action_names(self) -> tuple[str, ...]:
        """A short name of each action, for pictures."""
        return tuple(str(a) for a in range(self.num_actions))

    def panels(self) -> tuple[Panel, ...]:
        """The tables in which people see the states; none where they are a list."""
        return ()

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

    def tabulated_step(self) -> Callable[[Key[Array, ""], Int[Array, ""], Int[Array, ""]], Outcome]:
        """`step` with all outcomes worked out beforehand: the same outcome from the same key, from tables."""
        states, actions = (jnp.arange(n, dtype=jnp.int32) for n in (self.num_states, self.num_actions))
        prob, outcome = jax.vmap(jax.vmap(self.outcomes, (None, 0)), (0, None))(states, actions)
        count = prob.shape[-1]
        prob, reward = prob.reshape(-1, count), outcome.reward.ravel()
        # S' and whether it is terminal in one number, so that one load gets both.
        entered = (2 * outcome.s_next + outcome.terminal.astype(outcome.s_next.dtype)).ravel()

        def step(key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
            i = s * self.num_actions + a
            i = i if count == 1 else i * count + policies.sample(key, tables.row(prob, i))
            into = tables.entry(entered, i)
            return Outcome(into >> 1, tables.entry(reward, i), (into & 1) == 1)

        return step

    @property
    def samples_outcomes(self) -> bool:
        """Whether `step` is nothing but a draw from `outcomes`."""
        return type(self).step is Finite.step


def samples_outcomes(env: Any) -> TypeGuard[Finite]:
    """Whether `step` is nothing but a draw from `outcomes`, as `Finite` has it, and the same in all steps of a run."""
    return isinstance(env, Finite) and env.samples_outcomes and of_environment(env).at is None


class FixedStart(Finite):
    """A finite MDP whose episodes all start in the state `start_state`, an int."""

    start_state: Any

    def initial(self) -> Float[Array, " S"]:
        return jnp.zeros(self.num_states, dtype=float).at[self.start_state].set(1)

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return jnp.int32(self.start_state)


class Grid(Finite):
    """A rectangle of cells, numbered row by row from the top left.

    It has one start, and one goal that is terminal, but where a subclass says otherwise in `starts`, `goals`, and
    `walls`: pictures ask these.

    Attributes:
        shape: (rows, columns).
        start, goal: cells, as (row, column).
    """

    shape: tuple[int, int]
    start: tuple[int, int]
    goal: tuple[int, int]

    def __post_init__(self):
        """Keeps all three as pairs of int. Raises InputError unless start and goal are two cells of the grid."""
        who = type(self).__name__
        shape = check_shape(who, self.shape)
        start, goal = (check_cell(who, name, getattr(self, name), shape) for name in ("start", "goal"))
        if start == goal:
            raise InputError(f"start and goal are the same cell {start}", who=who, field="goal")
        assign(self, shape=shape, start=start, goal=goal)

    @property
    def num_states(self) -> int:
        return self.shape[0] * self.shape[1]

    @property
    def action_names(self) -> tuple[str, ...]:
        return ARROWS[: self.num_actions]

    def panels(self) -> tuple[Panel, ...]:
        rows, columns = (tuple(map(str, range(n))) for n in self.shape)
        return (Panel("", np.arange(self.num_states).reshape(self.shape), rows, columns),)

    @property
    def low(self) -> tuple[float, ...]:
        return (0.0, 0.0)

    @property
    def high(self) -> tuple[float, ...]:
        return tuple(float(n - 1) for n in self.shape)

    def observation(self, s: Int[Array, ""]) -> Float[Array, " 2"]:
        """The row and the column of a cell, float [2]: what features are made of (see `approx`)."""
        return jnp.stack([s // self.shape[1], s % self.shape[1]]).astype(float)

    @property
    def starts(self) -> tuple[tuple[int, int], ...]:
        """The cells in which episodes start, each equally likely."""
        return (self.start,)

    @property
    def goals(self) -> tuple[tuple[int, int], ...]:
        return (self.goal,)

    @property
    def walls(self) -> tuple[tuple[int, int], ...]:
        """The cells that nobody can enter."""
        return ()

    @property
    def letters(self) -> dict[int, str]:
        """The state of a cell -> the letter that pictures have there."""
        return {self.state(cell): x for x, cells in (("S", self.starts), ("G", self.goals)) for cell in cells}

    @property
    def start_states(self) -> list[int]:
        """The states of `starts`."""
        return [self.state(cell) for cell in self.starts]

    @property
    def start_state(self) -> int:
        """The first of them."""
        return self.state(self.starts[0])

    def initial(self) -> Float[Array, " S"]:
        starts = np.array(self.start_states)
        return jnp.zeros(self.num_states, dtype=float).at[starts].set(1 / len(starts))

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        starts = self.start_states
        if len(starts) == 1:
            return jnp.int32(starts[0])
        return jnp.asarray(starts, jnp.int32)[policies.sample(key, jnp.full(len(starts), 1 / len(starts)))]

    def state(self, cell: tuple[int, int]) -> int:
        """The number of the state at (row, column)."""
        return cell[0] * self.shape[1] + cell[1]

    def neighbour(self, s: Int[Array, ""], a: Int[Array, ""], lift: Any = 0) -> Int[Array, "..."]:
        """The state that move `a` of COMPASS leads to from `s`, carried up by `lift` rows at the same time.

        The edge of the grid stops the sum of both: against a lift of 1, a move down stays in the bottom row.
        """
        rows, columns = self.shape
        s = jnp.asarray(s, jnp.int32)
        move = jnp.asarray(COMPASS, jnp.int32)[a]
        row = jnp.clip(s // columns + move[0] - lift, 0, rows - 1)
        column = jnp.clip(s % columns + move[1], 0, columns - 1)
        return row * columns + column


def check_shape(name: str, shape: Sequence[int], least: tuple[int, int] = (1, 1)) -> tuple[int, int]:
    """`shape` as (rows, columns). Raises InputError unless both are whole numbers and large enough."""
    pair = _pair(shape)
    if pair is None or pair[0] < least[0] or pair[1] < least[1]:
        raise unfit(name, "shape", f"(rows, columns), at least {least[0]} x {least[1]}", shape)
    return pair


def check_cell(name: str, what: str, cell: Sequence[int], shape: tuple[int, int]) -> tuple[int, int]:
    """`cell` as (row, column). Raises InputError unless it is inside `shape`."""
    pair = _pair(cell)
    if pair is None:
        raise unfit(name, what, "a cell (row, column)", cell)
    if not (0 <= pair[0] < shape[0] and 0 <= pair[1] < shape[1]):
        inside = f"rows are 0 to {shape[0] - 1}, columns 0 to {shape[1] - 1}"
        raise InputError(f"{what} {pair} is outside the grid; {inside}", who=name, field=what)
    return pair


def _pair(value: Any) -> tuple[int, int] | None:
    """`value` as two ints, or None where it is anything else."""
    items = list(value) if is_list(value) else []
    if len(items) != 2 or not all(isinstance(n, Integral) for n in items):
        return None
    return int(items[0]), int(items[1])
