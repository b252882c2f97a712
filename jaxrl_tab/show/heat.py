"""What the report shows of where methods lose: sentences, and heat maps that are drawn in the page without a script."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.envs.base import ARROWS, Grid, Panel
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.losses import Losses
from jaxrl_tab.show.explained import Explained
from jaxrl_tab.show.states import state_names
from jaxrl_tab.show.tasks import tables_of
from jaxrl_tab.show.words import number, short_number

LEAST = 0.005  # the share of all that is lost, below which a state is left empty
MOST_CELLS = 2000  # in a page, of a method


class Cell(NamedTuple):
    """A state: its place, how deep its colour is, from 0 to 1, what is written in it, and what is told of it."""

    x: int
    y: int
    depth: float
    lines: tuple[str, ...]
    about: str


class Map(NamedTuple):
    """States that people see side by side.

    Attributes:
        title, rows, columns, down, along: as of a `Panel`; of a grid none.
        shape: (rows, columns).
        cells: the states in which anything is lost.
        out: the places (x, y) of the states that nobody can come to, but for walls.
        walls: the places (x, y) of the walls of a grid.
        letters: of a grid, as ((row, column), letter).
    """

    title: str
    shape: tuple[int, ...]
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    down: str
    along: str
    cells: list[Cell]
    out: list[tuple[int, int]]
    walls: list[tuple[int, int]]
    letters: list[tuple[tuple[int, int], str]]


class Heat(NamedTuple):
    """What the report shows of a method: of which policies the maps are, `policies` says."""

    name: str
    sentences: list[str]
    maps: list[Map]
    policies: str


def heats(explained: Mapping[str, Explained], label: str) -> list[Heat]:
    """Of the methods of an environment."""
    return [_heat(one) for one in explained.values() if one.environment == label]


def _heat(one: Explained) -> Heat:
    losses, tables = one.main, tables_of(one.env)
    drawn = one.loses(losses) and sum(table.states.size for table in tables) <= MOST_CELLS
    policies = "greedy policies" if losses is one.greedy else "policies that act"
    return Heat(
        one.name, one.sentences, [_map(one, losses, table) for table in tables] if drawn else [], policies
    )


def _map(one: Explained, losses: Losses, table: Panel) -> Map:
    lost, names = losses.by_state, of_environment(one.env).action_names
    model, name_of = planning.exact_model(one.env), state_names(one.env)
    reachable, grid = planning.reachable(model), one.env if isinstance(one.env, Grid) else None
    walls = [(x, y) for y, x in grid.walls] if grid else []
    cells, out = [], []
    for (y, x), s in np.ndenumerate(table.states):
        if (x, y) in walls:
            continue
        if not reachable[s]:
            out.append((x, y))
        elif lost[s] >= LEAST * lost.sum():
            by = losses.by_action[s]
            worst = [names[a] for a in np.flatnonzero(by == by.max())]
            about = (
                f"{name_of(int(s))}: {number(float(lost[s]))} is lost in {number(float(losses.visits[s]))} visits, "
                f"the most of it by {', '.join(worst)}"
            )
            by_arrows = all(name in ARROWS for name in worst)
            lines = (
                ("".join(worst), short_number(float(lost[s])))
                if by_arrows
                else (short_number(float(lost[s])),)
            )
            cells.append(Cell(x, y, float(lost[s] / lost.max()), lines, about))
    if grid:
        letters = [(divmod(s, grid.shape[1]), letter) for s, letter in grid.letters.items()]
        return Map("", table.states.shape, (), (), "", "", cells, out, walls, letters)
    return Map(
        table.title,
        table.states.shape,
        table.rows,
        table.columns,
        table.down,
        table.along,
        cells,
        out,
        [],
        [],
    )
