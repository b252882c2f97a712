"""The ways to the best values that `jaxrl-tab solve --by` knows, and in a sentence what each of them took."""

from typing import Any, Literal, NamedTuple

import numpy as np

from jaxrl_tab.exact import planning
from jaxrl_tab.show.words import counted, six_digits

Way = Literal["policy-iteration", "value-iteration", "modified", "anderson", "anchored", "linear-programming"]
SWEEPS = 5  # of modified policy iteration between two improvements, by default


class Solved(NamedTuple):
    """What a way found, and what it took."""

    policy: np.ndarray
    v: np.ndarray
    q: np.ndarray
    said: str
    took: dict[str, Any]  # the same, for JSON


def solved_by(env: Any, way: Way, gamma: float, sweeps: int | None) -> Solved:
    """The best policy and values, found in this way.

    Raises:
        InputError: there is no finite answer, or it was not found in this way.
    """
    if way in ("policy-iteration", "modified"):
        return _by_policies(env, gamma, None if way == "policy-iteration" else sweeps or SWEEPS)
    return _by_linear_programs(env, gamma) if way == "linear-programming" else _by_sweeps(env, way, gamma)


def _by_policies(env: Any, gamma: float, sweeps: int | None) -> Solved:
    found = planning.generalized_policy_iteration(env, gamma, sweeps=sweeps)
    n, error = len(found.v) - 1, float(found.error[-1])
    took: dict[str, Any] = {"improvements": n, "error": error}
    if sweeps is None:
        said = f"Policy iteration: {counted(n, 'improvements')}, each after an exact evaluation."
    else:
        took["sweeps"] = n * sweeps
        said = (
            f"Modified policy iteration: {counted(n, 'improvements')}, with {counted(sweeps, 'sweeps')} of evaluation "
            f"after each{_settled(found.settled, error)}"
        )
    return Solved(found.policy[-1], found.v[-1], found.q[-1], said, took)


def _by_sweeps(env: Any, way: str, gamma: float) -> Solved:
    plain = planning.accelerated_value_iteration(env, gamma, "plain")
    found, beside = plain, ""
    if way != "value-iteration":
        found = planning.accelerated_value_iteration(env, gamma, way)
        beside = f" (value iteration without it: {plain.sweeps})"
    name = {"value-iteration": "Value iteration"}.get(way, f"{way.capitalize()} value iteration")
    error = float(found.error[-1])
    said = f"{name} from v = 0: {counted(found.sweeps, 'sweeps')}{beside}{_settled(found.settled, error)}"
    return Solved(found.policy, found.v, found.q, said, {"sweeps": found.sweeps, "error": error})


def _settled(settled: bool, error: float) -> str:
    """The end of a sentence."""
    so_far = "" if settled else ", and it has not settled yet"
    return f"{so_far}; values are at most {_in_full(error)} off."


def _by_linear_programs(env: Any, gamma: float) -> Solved:
    found = planning.linear_programming(env, gamma)
    q = planning.backup(planning.exact_model(env), found.v, gamma)
    error = float(np.nanmax(abs(found.v - planning.value_iteration(env, gamma)[0])))
    said = (
        f"Linear programming: the smallest values that no action improves on are at most {_in_full(error)} off, "
        f"and no occupancy earns more than {six_digits(found.value)}, which is what these values are from the start."
    )
    return Solved(found.policy, found.v, q, said, {"error": error, "occupancy": found.occupancy.tolist()})


def _in_full(error: float) -> str:
    """A small number in full, for what is called rounding elsewhere is the matter here."""
    return f"{error:.2g}"
