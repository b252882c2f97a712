"""The racetrack (book, exercise 5.12 and figure 5.5)."""

import functools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import assign, unbatched
from jaxrl_tab.core.describe import Lines
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs import drawing
from jaxrl_tab.envs.base import ARROWS, COMPASS, MAX_STEPS, TIME_LIMIT, Finite
from jaxrl_tab.envs.drawing import GOAL, START, WALL

SPEEDS = 5  # of each component of the velocity, from 0
VELOCITIES = SPEEDS**2
CRASH = -1  # in place of a state
STAY = len(COMPASS) - 1  # the action that changes no velocity


def _drawn(*rows: tuple[int, int, int], columns: int) -> tuple[str, ...]:
    """A track whose last row is the starting line, with the finish at its right edge, from the top.

    Each entry of `rows` is how many rows have their cells from one column to before another.
    """
    cells = [
        WALL * first + "." * (end - first) + WALL * (columns - end)
        for n, first, end in rows
        for _ in range(n)
    ]
    cells = [row[:-1] + row[-1].replace(".", GOAL) for row in cells]
    return (*cells[:-1], cells[-1].replace(".", START))


TRACKS = {
    "left": _drawn(
        (1, 3, 17), (2, 2, 17), (1, 1, 17), (2, 0, 17),
        (1, 0, 10), (7, 0, 9), (8, 1, 9), (7, 2, 9), (3, 3, 9), columns=17
    ),
    "right": _drawn(
        (1, 16, 32), (1, 13, 32), (1, 12, 32), (4, 11, 32), (1, 12, 32), (1, 13, 32),
        (1, 14, 30), (1, 14, 27), (1, 14, 26), (1, 14, 24),
        *((1, first, 23) for first in range(14, 0, -1)), (3, 0, 23), columns=32
    ),
}  # fmt: skip


class Track(NamedTuple):
    """A track in numbers.

    Attributes:
        places: row, column, velocity up and velocity to the right of each state but the last, int [S - 1, 4].
        starts: the states in which episodes start, int32 [M].
        after: the state to which each action leads from each state if the car obeys, CRASH where it leaves the track,
            int32 [S, 9].
    """

    places: Int[np.ndarray, "places 4"]
    starts: Int[np.ndarray, " M"]
    after: Int[np.ndarray, "S 9"]


@pytree
class Racetrack(Finite):
    """Drive a car around a right turn as fast as you can, without running off the track.

    A state is a cell and a velocity: so many cells up and so many to the right in each step, 0 to 4 each. An action
    adds 1, 0 or -1 to each of the two, but neither leaves its range, and both are 0 on the starting line only: what
    would make them so elsewhere changes nothing. With probability 0.1 the car does not obey, and keeps its velocity.
    Then it moves by its velocity, in a straight line. If that meets the finish line first, the episode ends; if it
    leaves the track first, the car is put on the starting line, on any of its cells, with velocity 0, and the episode
    goes on. Every step costs 1. Episodes start like that, too.

    The line is followed in as many parts as the longer way has cells; of each part the cell nearest to its end counts.
    Actions are the moves of a king, up first and the last to stay, added to the velocity. States are those that can be
    reached, 2361 on the left track of figure 5.5 and 7794 on the right one, by cell, row by row, and by velocity; see
    `state` and `places`. The last one is terminal. With gamma 1 the optimal values from the start are -11.694577 on the
    left track and -8.895873 on the right one.

    The book draws its tracks and prints no table of them. Of the left one all public copies that were looked at agree.
    The right one has the 30 rows of two copies that were made independently, one cell by cell and one by rules; in
    another one, which was copied on, the widest part is one row higher.

    In a map of your own `S` is the starting line, `G` the finish line, `.` the track, and `#` is not. Cars drive up and
    to the right only.
    """

    track: Literal["left", "right"] = static(default="left", help="Which track of figure 5.5 it is.")
    failure: float = field(
        default=0.1, at_least=0, less_than=1, help="Probability that the velocity stays as it is."
    )
    map: Lines = static(default=(), help="Another track: its rows, or a file (.txt).")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = len(COMPASS)

    def __post_init__(self):
        if isinstance(self.map, tuple) and not self.map:
            return  # it is one of the book
        who = type(self).__name__
        rows = drawing.read(who, self.map).rows
        drawing.check_rows(who, rows, {})
        for letter, what in ((START, "starting"), (GOAL, "finish")):
            if letter not in "".join(rows):
                raise InputError(f"the track has no {what} line, of letters {letter}", who=who, field="map")
        assign(self, map=rows)

    @property
    def rows(self) -> tuple[str, ...]:
        """The track as it is drawn, from the top."""
        return self.map if isinstance(self.map, tuple) and self.map else TRACKS[self.track]  # pyright: ignore

    @property
    def num_states(self) -> int:
        return len(tabulated(self.rows).after)

    @property
    def places(self) -> Int[np.ndarray, "places 4"]:
        """Row, column, velocity up and velocity to the right of each state but the last, int [S - 1, 4]."""
        return tabulated(self.rows).places

    @property
    def action_names(self) -> tuple[str, ...]:
        return ARROWS

    def state(self, row: int, column: int, up: int = 0, right: int = 0) -> int:
        """The number of the state in a cell with a velocity. Raises InputError where no car can be so."""
        found = np.flatnonzero((self.places == (row, column, up, right)).all(1))
        if not len(found):
            problem = f"no car can come to {(row, column)} with velocity {(up, right)}"
            raise InputError(problem, who=type(self).__name__)
        return int(found[0])

    def state_name(self, s: int) -> str:
        """Where a car is in state `s`, and how fast."""
        if s == len(self.places):
            return "finish"
        row, column, up, right = self.places[s]
        return f"({row}, {column}), speed ↑{up} →{right}"

    def initial(self) -> Float[Array, " S"]:
        starts = tabulated(self.rows).starts
        return jnp.zeros(self.num_states, dtype=float).at[starts].set(1 / len(starts))

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        starts = tabulated(self.rows).starts
        return jnp.asarray(starts)[policies.below(key, len(starts))]

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """To obey, not to, and to begin again in each cell of the starting line: K = 2 + M."""
        after, starts = self._after(s, a), jnp.asarray(tabulated(self.rows).starts)
        prob = jnp.where(after == CRASH, 0.0, self._obeys_and_not())
        crash = jnp.full(len(starts), (1 - prob.sum()) / len(starts))
        s_next = jnp.concatenate([jnp.maximum(after, 0), starts])
        return jnp.concatenate([prob, crash]), self._outcome(s, s_next)

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        """A draw from `outcomes`, where two short draws cost less than one."""
        at_move, at_crash = jax.random.split(key)
        after = self._after(s, a)[policies.sample(at_move, self._obeys_and_not())]
        return self._outcome(s, jnp.where(after == CRASH, self.reset(at_crash), after))

    def _after(self, s: Int[Array, ""], a: Int[Array, ""]) -> Int[Array, " 2"]:
        """Where `a` leads if the car obeys, and if it does not: a state, or CRASH."""
        after = jnp.asarray(tabulated(self.rows).after)
        return jnp.stack([after[s, a], after[s, STAY]])

    def _outcome(self, s: Int[Array, ""], s_next: Int[Array, "..."]) -> Outcome:
        """The outcome, or outcomes, of coming to `s_next`."""
        end = self.num_states - 1
        s_next = jnp.where(s == end, end, s_next)
        reward = jnp.where(s == end, 0.0, -1.0).astype(float)
        return Outcome(s_next, jnp.full(s_next.shape, reward), s_next == end)

    def _obeys_and_not(self) -> Float[Array, " 2"]:
        failure = unbatched(self, "failure", ndim=0)
        return jnp.stack([1 - failure, failure])


@functools.lru_cache(maxsize=16)
def tabulated(rows: Sequence[str]) -> Track:
    """A drawn track in numbers."""
    letters = np.array([list(row) for row in rows])
    cells = np.argwhere((letters != WALL) & (letters != GOAL))
    number = np.full(letters.shape, CRASH)
    number[tuple(cells.T)] = range(len(cells))
    number[letters == GOAL] = len(cells)
    is_start = letters[tuple(cells.T)] == START
    landing = np.stack([_landing(number, cells, *velocity) for velocity in np.ndindex(SPEEDS, SPEEDS)], 1)
    velocity = _velocities(is_start)
    cell = np.arange(len(cells))[:, None, None]
    entered = landing[cell, velocity]
    # A state for each cell and velocity, the finish line after them; then those alone to which one can come.
    end = VELOCITIES * len(cells)
    after = np.where(
        entered == len(cells), end, np.where(entered == CRASH, CRASH, VELOCITIES * entered + velocity)
    )
    after = np.append(after.reshape(end, -1), [[end] * after.shape[-1]], 0)
    reached, new = np.isin(np.arange(end + 1), VELOCITIES * np.flatnonzero(is_start)), True
    while np.any(new):
        to = after[reached]
        new = ~reached[to[to != CRASH]]
        reached[to[to != CRASH]] = True
    renumbered = np.append(np.cumsum(reached) - 1, CRASH)  # the last one for CRASH, which is -1
    states = np.flatnonzero(reached[:-1])
    velocities = np.stack(np.divmod(states % VELOCITIES, SPEEDS), 1)
    return Track(
        np.append(cells[states // VELOCITIES], velocities, 1),
        renumbered[VELOCITIES * np.flatnonzero(is_start)].astype(np.int32),
        renumbered[after[reached]].astype(np.int32),
    )


def _velocities(is_start: np.ndarray) -> np.ndarray:
    """The velocity after each action, 0 to 24, by cell, velocity and action, int [C, 25, 9]."""
    before = np.stack(np.divmod(np.arange(VELOCITIES), SPEEDS), 1)[:, None]
    up, right = np.moveaxis(np.clip(before + np.array(COMPASS) * (-1, 1), 0, SPEEDS - 1), -1, 0)
    may_be = (up + right > 0) | is_start[:, None, None]
    return np.where(may_be, SPEEDS * up + right, np.arange(VELOCITIES)[:, None])


def _landing(number: np.ndarray, cells: np.ndarray, up: int, right: int) -> np.ndarray:
    """Where cars from all `cells` end, int [C]; `number` says of each cell of the map which it is."""
    longest, at = max(up, right), number[tuple(cells.T)]
    for step in range(1, longest + 1):
        way = [-_nearest(up * step, longest), _nearest(right * step, longest)]
        row, column = (cells + np.array(way)).T
        is_inside = (row >= 0) & (column < number.shape[1])
        entered = np.where(
            is_inside, number[np.maximum(row, 0), np.minimum(column, number.shape[1] - 1)], CRASH
        )
        at = np.where((at == CRASH) | (at == len(cells)), at, entered)
    return at


def _nearest(way: int, parts: int) -> int:
    """way / parts to the nearest whole number; of two, the larger one."""
    return (2 * way + parts) // (2 * parts)
