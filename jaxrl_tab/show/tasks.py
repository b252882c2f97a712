"""What people see of a task: the tables of its states, and what is exact about their values."""

import numpy as np

from jaxrl_tab import stats
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment, FiniteEnvironment, available_actions
from jaxrl_tab.envs.base import Panel
from jaxrl_tab.exact import planning
from jaxrl_tab.stats.along import Datasets


def tables_of(env: Environment) -> tuple[Panel, ...]:
    """The tables in which people see the states; none where they are a list, or nothing exact is known."""
    return of_environment(env).panels() if isinstance(env, FiniteEnvironment) else ()


def policy_of(theta: np.ndarray) -> np.ndarray:
    """What people see of preferences [..., S, A]: the probabilities of the actions, float64."""
    theta = np.asarray(theta, float)
    weights = np.exp(theta - theta.max(-1, keepdims=True))
    return weights / weights.sum(-1, keepdims=True)


def exact_tables(datasets: Datasets, env: Environment) -> np.ndarray | None:
    """What was to be learned: q*, float64 [S, A], or of prediction v_pi, [S, 1]; None where no one answer is right."""
    if not isinstance(env, FiniteEnvironment) or of_environment(env).differs:
        return None
    if stats.is_prediction(*datasets.values()):
        v = uniform_values(datasets, env)
        return None if v is None else v[:, None]
    if (gamma := common_gamma(datasets)) is None:
        return None
    try:
        return planning.value_iteration(env, gamma)[1]
    except InputError:  # there is no finite q*
        return None


def uniform_values(datasets: Datasets, env: Environment) -> np.ndarray | None:
    """v_pi, float64 [S], where all learned about the uniform policy with one gamma; else None."""
    has_pi = any("pi" in stats.fixed(ds) or "pi" in ds.dims for ds in datasets.values())
    gamma = common_gamma(datasets)
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


def common_gamma(datasets: Datasets) -> float | None:
    """The discount rate of all; None where they differ, or where it was swept."""
    gamma, *others = {stats.fixed(ds).get("gamma", np.nan) for ds in datasets.values()}
    return None if others or np.isnan(gamma) else gamma
