"""Where the states of an environment lie, what leads where, and what is exact: the stage of the tables over time."""

from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab import stats
from jaxrl_tab.core.checks import InputError
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.types import Environment, FiniteEnvironment, available_actions
from jaxrl_tab.envs.base import ARROWS, COMPASS, Grid, Panel
from jaxrl_tab.exact import planning
from jaxrl_tab.show.moves import Moves
from jaxrl_tab.stats.along import Datasets

MOST_CELLS, MOST_LISTED = 2000, 200  # states in pictures, and in a list


class Scene(NamedTuple):
    """What a reader sees of the states of an environment.

    Attributes:
        states: which of them, int [n].
        exact: what was to be learned about them: q*, of prediction v_pi; float64 [n, A or 1], None where there is
            no one such answer.
        judged: which of them can be reached and are not terminal, bool [n].
        data: the rest, as JSON has it.
    """

    states: np.ndarray
    exact: np.ndarray | None
    judged: np.ndarray
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
    exact = _exact(env, datasets) if model else None
    start = np.flatnonzero(np.asarray(model.initial)) if model else np.array([], int)
    if tables:
        states = np.unique(np.concatenate([table.states.ravel() for table in tables]))
    else:
        states = _listed(env.num_states, start, learned, exact)
    place = {int(s): i for i, s in enumerate(states)}
    terminal = planning.terminal_states(model) if model else np.zeros(env.num_states, bool)
    reachable = planning.reachable(model) if model else np.ones(env.num_states, bool)
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
    exact = None if exact is None else exact[states]
    return Scene(states, exact, (reachable & ~terminal)[states], data)


def tables_of(env: Environment) -> tuple[Panel, ...]:
    """The tables in which people see the states; none where they are a list, or nothing exact is known."""
    return of_environment(env).panels() if isinstance(env, FiniteEnvironment) else ()


def uniform_values(datasets: Datasets, env: Environment) -> np.ndarray | None:
    """v_pi, float64 [S], where all learned about the uniform policy with one gamma; else None."""
    has_pi = any("pi" in stats.fixed(ds) or "pi" in ds.dims for ds in datasets.values())
    gamma = _common_gamma(datasets)
    if has_pi or gamma is None:
        return None
    available = available_actions(env)
    shape = env.num_states, env.num_actions
    weights = np.ones(shape) if available is None else np.asarray(available, float)
    uniform = weights / weights.sum(1, keepdims=True)
    try:
        return planning.evaluate(env, uniform, gamma)
    except InputError:  # not finite everywhere
        return None


def _common_gamma(datasets: Datasets) -> float | None:
    """The discount rate of all; None where they differ, or where it was swept."""
    gamma, *others = {stats.fixed(ds).get("gamma", np.nan) for ds in datasets.values()}
    return None if others or np.isnan(gamma) else gamma


def _exact(env: Environment, datasets: Datasets) -> np.ndarray | None:
    """q* [S, A], or of prediction v_pi [S, 1]; None where there is no one such answer."""
    if of_environment(env).instance is not None:  # each run has a problem of its own
        return None
    if stats.is_prediction(*datasets.values()):
        v = uniform_values(datasets, env)
        return None if v is None else v[:, None]
    if (gamma := _common_gamma(datasets)) is None:
        return None
    try:
        return planning.value_iteration(env, gamma)[1]
    except InputError:
        return None


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
    """What a grid has beside its cells: the goal, the wind of each column, and where each action leads."""
    moves, wind = Moves.of(env), of_environment(env).wind
    return {
        "goal": env.state(env.goal),
        "wind": [] if wind is None else np.asarray(wind, float).tolist(),
        "next": moves.successor.tolist(),
        "stochastic": moves.stochastic,
    }
