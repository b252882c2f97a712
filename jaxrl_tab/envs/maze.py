"""Mazes that a person draws, and frozen lakes (book, examples 3.5, 4.1, 6.6 and 8.1; Gymnasium's FrozenLake)."""

import functools
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import assign, is_list
from jaxrl_tab.core.describe import Lines
from jaxrl_tab.core.errors import InputError, unfit
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs import drawing
from jaxrl_tab.envs.base import COMPASS, MAX_STEPS, TIME_LIMIT, Grid
from jaxrl_tab.envs.drawing import FREE, GOAL, MAPS, START, WALL, Letter
from jaxrl_tab.envs.windy_gridworld import MOVES

ICE = {"F": Letter(), "H": Letter(terminal=True)}  # what the letters of a lake mean


class Plan(NamedTuple):
    """All that the outcomes of a drawn grid follow from: its rows and its rules, as `Maze` explains them."""

    rows: tuple[str, ...]
    legend: tuple[tuple[str, Letter], ...]
    num_actions: int
    step_reward: float
    goal_reward: float
    bump_reward: float | None
    slip: float
    wind: tuple[int, ...]


class Table(NamedTuple):
    """What a plan says in numbers.

    Attributes:
        s_next, prob, reward: of each outcome, int32 and float64 [S, A, K]; K is 1 where nothing slips, else 3.
        is_terminal: bool [S]; walls are, so that they have a value, though nobody comes there.
        starts: the states in which episodes start, int [M].
    """

    s_next: np.ndarray
    prob: np.ndarray
    reward: np.ndarray
    is_terminal: np.ndarray
    starts: np.ndarray


class DrawnGrid(Grid):
    """A grid that is read from a drawing; a subclass says which, as `plan`."""

    @functools.cached_property
    def plan(self) -> Plan:
        raise NotImplementedError

    @property
    def num_actions(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.plan.num_actions

    @property
    def shape(self) -> tuple[int, int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.plan.rows), len(self.plan.rows[0])

    @property
    def starts(self) -> tuple[tuple[int, int], ...]:
        return self._cells(tabulated(self.plan).starts)

    @property
    def goals(self) -> tuple[tuple[int, int], ...]:
        return self._cells(np.flatnonzero(letters_of(self.plan) == GOAL))

    @property
    def walls(self) -> tuple[tuple[int, int], ...]:
        return self._cells(np.flatnonzero(letters_of(self.plan) == WALL))

    @property
    def letters(self) -> dict[int, str]:
        """Those of the drawing, but for walls and free cells."""
        plain = {letter for letter, of in self.plan.legend if of == Letter()} - {
            target for _, of in self.plan.legend for target in (of.to, of.jump)
        }
        return {s: str(x) for s, x in enumerate(letters_of(self.plan)) if x not in {*plain, *FREE, WALL}}

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        return outcomes_of(self.plan, s, a)

    def _cells(self, states: np.ndarray) -> tuple[tuple[int, int], ...]:
        columns = self.shape[1]
        return tuple(divmod(int(s), columns) for s in states)


def outcomes_of(plan: Plan, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
    """What may follow action `a` in state `s`, as `types.FiniteEnvironment` has it."""
    table = tabulated(plan)
    s_next = jnp.asarray(table.s_next)[s, a]
    prob, reward = (jnp.asarray(x, float)[s, a] for x in (table.prob, table.reward))
    return prob, Outcome(s_next, reward, jnp.asarray(table.is_terminal)[s_next])


@pytree
class Maze(DrawnGrid):
    """Find the way through a maze that somebody has drawn.

    A map is a list of rows, `["S..#G", "....."]`, or the name of a file or of a map of ours: dyna, four-rooms, cliff,
    grid-4x4, example-3.5, frozen-lake-4x4, frozen-lake-8x8, barrier-left, barrier-right, barrier-short. Of its letters
    `#` is a wall, `S` a start (of several each is equally likely; without any, episodes start in any cell in which a
    walker can be), `G` a goal, where episodes end (without any end the task goes on for ever, and needs a gamma below
    1), and `.` or a blank a free cell. The legend says what other letters mean, in Python
    `{"O": {"reward": -10, "terminal": True}}`, in lines "O: reward -10, terminal":

    - `reward`: of a step that ends there, in place of the step's; `terminal`: the episode ends there;
    - `slip`, `wind`: of moves that are made there, in place of those of the whole maze;
    - `to X`: a door; a step that ends there puts the walker at the cell of letter X, at once;
    - `jump X`: from there every move leads to the cell of letter X, and gives the `reward`.

    A file has these lines below the map, and settings, such as "slip: 2/3". A wall stops a move, and so does the
    edge, along which a king slides. Wind adds to the move, one row after another, until a wall or the edge is in
    the way. All cells are states, numbered row by row; walls and doors are states that no walker is ever in. Where
    no goal can be reached, values are finite only where gamma is below 1.
    """

    map: Lines = static(
        default=("S.#.G", "..#..", "....."),
        help="The map: its rows, a file (.txt), or the name of one of ours.",
    )
    legend: Lines = static(default=(), help='What letters mean, a line each: "O: reward -10, terminal".')
    step_reward: float | None = static(
        default=None, help="Reward of a step; by default what the map says, or -1."
    )
    goal_reward: float | None = static(
        default=None,
        help="Reward of the step into a goal, in its place; by default what the map says, or the same.",
    )
    bump_reward: float | None = static(
        default=None, help="Reward of a move that a wall or the edge stops; by default that of any step."
    )
    slip: float | None = static(
        default=None,
        at_least=0,
        at_most=1,
        help="Probability that a move goes to one of its two sides instead, half each; by default 0.",
    )
    wind: Any = static(
        default=(), help="Rows by which each column carries up a walker who leaves it, [columns]."
    )
    moves: Literal["four", "king", "king+stay"] = static(
        default="four", help="The actions; a king moves diagonally, too."
    )
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    def __post_init__(self):
        who = type(self).__name__
        drawn, legend = drawing.read(who, self.map), drawing.read_legend(who, self.legend)
        given = self._given()
        if drawing.name_of(self.map) in MAPS:  # its name stays, for it says the rest
            assign(self, map=drawing.name_of(self.map))
        else:  # what is in a file is kept here, for the file may change
            legend, given = drawn.legend | legend, drawn.settings | given
            assign(self, map=drawn.rows)
        drawing.check_rows(who, drawn.rows, drawn.legend | legend)
        wind = _wind(who, given.pop("wind", ()), len(drawn.rows[0]))
        numbers = {key: drawing.number(who, key, x) for key, x in given.items()}
        if not 0 <= (slip := numbers.get("slip", 0)) <= 1:
            raise unfit(who, "slip", "between 0 and 1", slip)
        assign(self, legend=drawing.as_lines(legend), wind=wind, **numbers)
        _check_start(who, self.plan)

    @functools.cached_property
    def plan(self) -> Plan:
        drawn = drawing.read(type(self).__name__, self.map)
        legend = drawn.legend | drawing.read_legend(type(self).__name__, self.legend)
        rules: dict[str, Any] = {"step_reward": -1.0, "bump_reward": None, "slip": 0.0, "wind": ()}
        rules |= drawn.settings | self._given()
        rules.setdefault("goal_reward", rules["step_reward"])
        return Plan(drawn.rows, tuple(legend.items()), MOVES[self.moves], **rules)

    def _given(self) -> dict[str, Any]:
        """The settings that do not leave to the map what holds."""
        own = {key: getattr(self, key) for key in drawing.SETTINGS}
        if is_list(self.wind) and len(self.wind) == 0:
            del own["wind"]
        return {key: x for key, x in own.items() if x is not None}


@pytree
class FrozenLake(DrawnGrid):
    """Cross a frozen lake without falling into a hole; only the goal gives a reward, of 1.

    It is Gymnasium's FrozenLake-v1, state by state, but for the order of the actions, which here are up, right,
    down, left. On slippery ice a move goes where it should with the probability `success_rate`, and otherwise to
    one of its two sides. In the letters of a map, `F` or `.` is ice, `H` a hole, where the episode ends, `#` a wall.
    """

    map_name: Literal["4x4", "8x8"] = static(default="4x4", help="Which lake of Gymnasium it is.")
    is_slippery: bool = static(default=True, help="Whether moves can go wrong.")
    success_rate: float = static(
        default=1 / 3, at_least=0, at_most=1, help="On slippery ice, the probability that a move goes right."
    )
    map: Lines = static(default=(), help="Another lake: its rows, or a file (.txt); see `maze`.")
    max_steps: int = static(default=100, at_least=1, help=TIME_LIMIT)

    def __post_init__(self):
        who = type(self).__name__
        success_rate = drawing.number(who, "success_rate", self.success_rate)
        assign(self, success_rate=success_rate)
        if isinstance(self.map, tuple) and not self.map:
            return  # it is one of Gymnasium
        drawn = drawing.read(who, self.map)
        if drawn.settings:
            raise InputError("a lake has no settings below its map; a maze has", who=who, field="map")
        drawing.check_rows(who, drawn.rows, ICE | drawn.legend)
        assign(self, map=(*drawn.rows, *drawing.as_lines(drawn.legend)))
        _check_start(who, self.plan)

    @functools.cached_property
    def plan(self) -> Plan:
        drawn = drawing.read(type(self).__name__, self.map or f"frozen-lake-{self.map_name}")
        slip = 1 - self.success_rate if self.is_slippery else 0.0
        return Plan(drawn.rows, tuple((ICE | drawn.legend).items()), 4, 0.0, 1.0, None, slip, ())


class _Cells(NamedTuple):
    """What holds in each cell, all [S].

    Attributes:
        letter: the one that is drawn.
        is_terminal: whether nothing goes on there; of a wall, too.
        enter: the reward of a step that ends there.
        put: the state in which one is who enters: the cell itself, or where a door leads.
        slip, lift: of the moves that are made there: the probability, and the rows of wind.
    """

    letter: np.ndarray
    is_terminal: np.ndarray
    enter: np.ndarray
    put: np.ndarray
    slip: np.ndarray
    lift: np.ndarray


@functools.lru_cache(maxsize=64)
def tabulated(plan: Plan) -> Table:
    """The outcomes of a plan."""
    cells, states = _cells(plan), np.arange(len(plan.rows) * len(plan.rows[0]))
    landing, is_stopped = _landings(plan, cells)
    s_next, reward = cells.put[landing], cells.enter[landing]
    if plan.bump_reward is not None:
        reward[is_stopped & (landing == states[:, None])] = plan.bump_reward
    for letter, of in plan.legend:
        if of.jump and (here := cells.letter == letter).any():
            s_next[here] = target = _only(cells, of.jump)
            reward[here] = cells.enter[target] if of.reward is None else of.reward
    over = cells.is_terminal
    s_next[over], reward[over] = states[over, None], 0.0
    # A move and its two sides; of three likely outcomes pictures show the one in the middle.
    which, prob = np.arange(plan.num_actions)[:, None], np.ones((len(states), 1))
    if cells.slip.any():
        which = np.array([(_turned(a, -1), a, _turned(a, 1)) for a in range(plan.num_actions)])
        prob = np.stack([cells.slip / 2, 1 - cells.slip, cells.slip / 2], -1)
    prob = np.repeat(prob[:, None], plan.num_actions, 1)
    is_start = cells.letter == START
    starts = np.flatnonzero(is_start if is_start.any() else ~over & (cells.put == states))
    return Table(s_next[:, which].astype(np.int32), prob, reward[:, which], over, starts)


def _cells(plan: Plan) -> _Cells:
    letter, rows = letters_of(plan), len(plan.rows)
    is_goal = letter == GOAL
    cells = _Cells(
        letter,
        is_terminal=is_goal | (letter == WALL),
        enter=np.where(is_goal, plan.goal_reward, plan.step_reward),
        put=np.arange(len(letter)),
        slip=np.full(len(letter), plan.slip),
        lift=np.tile(_within(rows, plan.wind or (0,) * len(plan.rows[0])), rows),
    )
    for name, of in plan.legend:
        here = letter == name
        cells.is_terminal[here] = of.terminal
        cells.enter[here] = plan.step_reward if of.reward is None or of.jump else of.reward
        cells.slip[here] = plan.slip if of.slip is None else of.slip
        if of.wind is not None:
            cells.lift[here] = _within(rows, [of.wind])
    for name, of in plan.legend:
        if of.to and (here := letter == name).any():
            cells.put[here] = target = _only(cells, of.to)
            cells.enter[here] = cells.enter[target] if of.reward is None else of.reward
    return cells


def _within(rows: int, wind: Sequence[int]) -> np.ndarray:
    """Wind, no stronger than from one edge to the other."""
    return np.array([max(-rows, min(rows, strength)) for strength in wind])


def _only(cells: _Cells, letter: str) -> int:
    """The state of the one cell with a letter."""
    return int(np.flatnonzero(cells.letter == letter)[0])


def letters_of(plan: Plan) -> np.ndarray:
    """The letter of each state, [S]."""
    return np.array(list("".join(plan.rows)))


def _turned(a: int, by: int) -> int:
    """The move at a right angle to move `a` of COMPASS; to stay has none."""
    return a if a == 8 else a - a % 4 + (a + by) % 4


def _landings(plan: Plan, cells: _Cells) -> tuple[np.ndarray, np.ndarray]:
    """The cell to which each move leads from each cell, int [S, A], and whether anything stopped it, bool [S, A].

    The move and the wind add up. The first step may go sideways, those after it up or down alone.
    """
    shape, move = (len(plan.rows), len(plan.rows[0])), np.array(COMPASS[: plan.num_actions])
    is_wall = (cells.letter == WALL).reshape(shape)
    row, column = (x.reshape(-1, 1) for x in np.indices(shape))
    down, right = move[:, 0] - cells.lift[:, None], move[:, 1]
    at_wall = is_stopped = np.zeros(down.shape, bool)
    for step in range(max(1, np.abs(down).max())):
        to = row + np.sign(down) * (np.abs(down) > step), column + (right if step == 0 else 0)
        inside = [np.clip(x, 0, n - 1) for x, n in zip(to, shape, strict=True)]
        is_stopped = is_stopped | (inside[0] != to[0]) | (inside[1] != to[1])
        at_wall = at_wall | is_wall[tuple(inside)]
        row, column = (np.where(at_wall, x, y) for x, y in zip((row, column), inside, strict=True))
    return row * shape[1] + column, is_stopped | at_wall


def _check_start(who: str, plan: Plan) -> None:
    """Raises InputError unless there is a cell to start in."""
    if not len(tabulated(plan).starts):
        raise InputError("there is no free cell to start in", who=who, field="map")


def _wind(who: str, wind: Any, columns: int) -> tuple[int, ...]:
    """The rows that each column lifts, or nothing where none does. Raises InputError unless they are whole numbers."""
    if not is_list(wind):
        raise unfit(who, "wind", "a list of whole numbers of cells", wind)
    strengths = tuple(drawing.whole_rows(who, "wind", x) for x in wind)
    if strengths and len(strengths) != columns:
        wanted = f"one strength for each of the {columns} columns"
        raise InputError(f"wind must have {wanted}, not {len(strengths)}", who=who, field="wind")
    return strengths if any(strengths) else ()
