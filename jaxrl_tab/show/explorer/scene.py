"""Where the states of an environment lie, what leads where, and what is exact: the stage of the tables over time."""

from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.types import Environment, FiniteEnvironment
from jaxrl_tab.envs.base import ARROWS, COMPASS, Grid, Panel
from jaxrl_tab.exact import planning
from jaxrl_tab.show.moves import Moves
from jaxrl_tab.show.places import Places
from jaxrl_tab.show.tasks import exact_tables, tables_of
from jaxrl_tab.stats.along import Datasets

PLACES = "A state is two numbers here, of which there is no end: these are places of a grid over them. Their colour is "
OF_VALUES = "V."
OF_ACTIONS = (
    "max q(s, a); where all rewards are costs, that is minus the cost to go. Nothing stands where all actions are "
    "alike."
)
MOST_CELLS, MOST_LISTED = 2000, 200  # states in pictures, and in a list


class Scene(NamedTuple):
    """What a reader sees of the states of an environment.

    Attributes:
        states: which of them, int [n].
        exact: what was to be learned about them: q*, of prediction v_pi; float64 [n, A or 1], None where there is
            no one such answer.
        data: the rest, as JSON has it.
    """

    states: np.ndarray
    exact: np.ndarray | None
    data: dict[str, Any]


def scene(env: Environment, datasets: Datasets, learned: np.ndarray) -> Scene:
    """The scene of an environment.

    Args:
        env: the environment.
        datasets: the sweeps in it.
        learned: what a method has learned that the states are worth, float [S]: of a long list of states those
            are shown where that is the furthest from what is exact, or else from 0.
    """
    model = planning.exact_model(env) if isinstance(env, FiniteEnvironment) else None
    tables = tables_of(env)
    if sum(table.states.size for table in tables) > MOST_CELLS:
        tables = ()
    exact = exact_tables(datasets, env)
    start = np.array([], int) if model is None else np.flatnonzero(model.start)
    if tables:
        states = np.unique(np.concatenate([table.states.ravel() for table in tables]))
    else:
        states = _listed(env.num_states, start, learned, exact)
    place = {int(s): i for i, s in enumerate(states)}
    terminal, reachable = np.zeros(env.num_states, bool), np.ones(env.num_states, bool)
    if model is not None:
        terminal, reachable = planning.terminal_states(model), planning.reachable(model)
    names = of_environment(env).action_names
    data = {
        "states": states.tolist(),
        "of": env.num_states,
        "panels": [_panel(table, place) for table in tables],
        "actions": list(names),
        "arrows": [list(COMPASS[ARROWS.index(name)]) if name in ARROWS else None for name in names],
        "start": [place[int(s)] for s in start if int(s) in place],
        "terminal": np.flatnonzero(terminal[states]).tolist(),
        "unreachable": np.flatnonzero(~reachable[states]).tolist(),
        "grid": _grid(env) if tables and isinstance(env, Grid) else None,
    }
    if exact is not None:
        exact = np.where(exact == UNAVAILABLE, np.nan, exact)[states]
    return Scene(states, exact, data)


def scene_of_places(places: Places, env: Environment, prediction: bool) -> Scene:
    """The same where states cannot be counted: places stand for them, of which nothing else is known."""
    states = places.panel.states.ravel()
    data = {
        "states": states.tolist(),
        "of": len(states),
        "panels": [_panel(places.panel, dict(enumerate(states.tolist())))],
        "actions": list(of_environment(env).action_names),
        "arrows": [None] * env.num_actions,
        "start": [places.start],
        "terminal": [],
        "unreachable": [],
        "grid": None,
        "places": PLACES + (OF_VALUES if prediction else OF_ACTIONS),
    }
    return Scene(states, None, data)


def _listed(num_states: int, start: np.ndarray, learned: np.ndarray, exact: np.ndarray | None) -> np.ndarray:
    """The states of a list: all, or those where episodes start and those where the learner is the furthest off."""
    if num_states <= MOST_LISTED:
        return np.arange(num_states)
    off = np.abs(learned if exact is None else learned - exact.max(-1))
    furthest = np.argsort(-np.nan_to_num(off, posinf=0, neginf=0), kind="stable")
    order = dict.fromkeys([*start[: MOST_LISTED // 4].tolist(), *furthest.tolist()])
    return np.sort(np.array([*order][:MOST_LISTED]))


def _panel(table: Panel, place: dict[int, int]) -> dict[str, Any]:
    return {
        "title": table.title,
        "states": [[place[int(s)] for s in row] for row in table.states],
        "rows": list(table.rows),
        "columns": list(table.columns),
        "down": table.down,
        "along": table.along,
    }


def _grid(env: Grid) -> dict[str, Any]:
    """What a grid has beside its cells: letters, walls, the wind of each column, and where each action leads."""
    moves, wind = Moves.of(env), of_environment(env).wind
    return {
        "letters": [[s, letter] for s, letter in env.letters.items()],
        "walls": [env.state(cell) for cell in env.walls],
        "wind": [] if wind is None else np.asarray(wind, float).tolist(),
        "next": moves.successor.tolist(),
        "stochastic": moves.stochastic,
    }
