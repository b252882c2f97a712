"""What an environment looks like while somebody is in it, in characters and in pixels, for Gymnasium's `render`."""

import math
from typing import Any

import numpy as np
from jaxtyping import Int, UInt8

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.envs.base import Grid

CELL = 32  # pixels
# The colours of a Grid's cells, and of states and lines elsewhere.
FREE, WALL, NOWHERE, LINE = (250, 250, 250), (60, 60, 60), (255, 255, 255), (190, 190, 190)
LETTERS = {"S": (200, 225, 250), "G": (180, 225, 180)}
OTHER = (245, 215, 170)  # of cells with another letter
AGENT = (200, 60, 50)


def places(env: Any) -> Int[np.ndarray, "rows columns"]:
    """Where pictures have each state: the number of the state, and -1 where there is none.

    A grid is as it is; the tables in which people see the states are one below the other; others are in rows.
    """
    if panels := [panel.states for panel in of_environment(env).panels()]:
        columns = max(states.shape[1] for states in panels)
        wide = [
            np.pad(states, ((0, 1), (0, columns - states.shape[1])), constant_values=-1) for states in panels
        ]
        shown = np.concatenate(wide)[:-1]
        missing = np.setdiff1d(np.arange(env.num_states), shown)
    else:
        shown, missing = np.zeros((0, math.ceil(math.sqrt(env.num_states))), int), np.arange(env.num_states)
    if not len(missing):
        return shown
    rows = -(-len(missing) // shown.shape[1])
    more = np.full(rows * shown.shape[1], -1)
    more[: len(missing)] = missing
    gap = np.full((min(1, len(shown)), shown.shape[1]), -1)
    return np.concatenate([shown, gap, more.reshape(rows, -1)])


def text(env: Any, s: int, action: int | None) -> str:
    """The state, and the last action, in words; of a grid also the cells, with the agent in brackets."""
    named = of_environment(env).action_names
    said = f"state {s} of {env.num_states}" + ("" if action is None else f", after {named[action]}")
    if not isinstance(env, Grid):
        return said + "\n"
    letters, walls = env.letters, {env.state(cell) for cell in env.walls}
    cells = [letters.get(i, "#" if i in walls else ".") for i in range(env.num_states)]
    marked = [f"[{x}]" if i == s else f" {x} " for i, x in enumerate(cells)]
    rows, columns = env.shape
    lines = ["".join(marked[r * columns : (r + 1) * columns]).rstrip() for r in range(rows)]
    return "\n".join([said, *lines]) + "\n"


def pixels(env: Any, s: int) -> UInt8[np.ndarray, "height width 3"]:
    """A cell for each state, with the agent as a disc in its cell, uint8 [height, width, 3]."""
    shown = places(env)
    colors = np.full((*shown.shape, 3), FREE, np.uint8)
    if isinstance(env, Grid):
        of_state = {env.state(cell): WALL for cell in env.walls} | {
            i: LETTERS.get(letter, OTHER) for i, letter in env.letters.items()
        }
        for i, color in of_state.items():
            colors[shown == i] = color
    picture = colors.repeat(CELL, 0).repeat(CELL, 1)
    picture[::CELL], picture[:, ::CELL] = LINE, LINE
    picture[(shown < 0).repeat(CELL, 0).repeat(CELL, 1)] = NOWHERE
    away = np.arange(CELL) - (CELL - 1) / 2
    disc = away[:, None] ** 2 + away**2 < (CELL / 3) ** 2
    for row, column in np.argwhere(shown == s):
        picture[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL][disc] = AGENT
    return picture
