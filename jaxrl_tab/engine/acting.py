"""By which policies runs act in the end, after all that they have learned."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrl_tab.algorithms.control import ValueControl
from jaxrl_tab.algorithms.monte_carlo import MonteCarlo
from jaxrl_tab.algorithms.policy_gradient import PolicyGradient
from jaxrl_tab.algorithms.traces import TraceControl
from jaxrl_tab.core.clock import Clock
from jaxrl_tab.core.errors import RunError
from jaxrl_tab.core.policies import Policy
from jaxrl_tab.core.types import fitted
from jaxrl_tab.engine.part import Part, compute

# Methods that act by their Q as it is, and by what the clock has counted.
BY_Q = (ValueControl.probs, TraceControl.probs, PolicyGradient.probs)


def acting(
    part: Part,
    setting: int,
    places: np.ndarray,
    q: Float[np.ndarray, "n S A"],
    steps: np.ndarray,
    episodes: np.ndarray,
    memory: int | None = None,
) -> Float[np.ndarray, "n S A"] | None:
    """The policies by which some runs of a setting would go on acting, float64 [n, S, A].

    They follow from Q and from how many steps and episodes there were. Where they do not, as where they go by visits,
    the runs are run again, for what a run gives depends on its seed and its hyperparameters alone.

    Args:
        part: the method in its environment.
        setting: the number of the configuration.
        places: the places of the seeds, int [n].
        q: their final tables.
        steps, episodes: how many they had, int [n].
        memory: as in `sweep`.

    Returns:
        The policies; None where the method does not say by what probabilities it acts: it has no `probs`.

    Raises:
        RunError: run again, they gave other tables.
    """
    method: Any = fitted(part.configs[setting], part.env)
    if not hasattr(method, "probs"):
        return None
    if not _by_q(method):
        return _run_again(part, setting, method, places, q, memory)
    with jax.enable_x64(), jax.numpy_dtype_promotion("standard"):
        selection = jax.tree.map(
            lambda x: np.asarray(x, float), method.selection
        )  # so that a number is no program
        clock = Clock(np.asarray(steps, np.int32), np.asarray(episodes, np.int32), None)  # pyright: ignore[reportArgumentType]
        probs = _probs(selection, q.astype(float), clock)
    return _as_policies(probs)


@jax.jit
def _probs(selection: Policy, q: Any, clock: Clock) -> Any:
    """The probabilities [n, S, A] of a policy by tables [n, S, A] and clocks [n]."""
    of_states = jax.vmap(selection.probs, (0, None, 0))
    states = jnp.arange(q.shape[1], dtype=jnp.int32)
    return jax.vmap(of_states, (0, 0, None))(q, clock, states)


def _by_q(method: Any) -> bool:
    """Whether what a method does follows from its Q and from how many steps and episodes it had."""
    acts_by = type(method).probs
    if acts_by is MonteCarlo.probs:
        return method.batch == 1 and not method.selection.by_visit
    return acts_by in BY_Q and not method.selection.by_visit


def _run_again(
    part: Part, setting: int, method: Any, places: np.ndarray, q: np.ndarray, memory: int | None
) -> np.ndarray:
    states, length = jnp.arange(part.env.num_states, dtype=jnp.int32), part.budget
    record = lambda state: {"acting": jax.vmap(lambda s: method.probs(state, s))(states)}
    whole = length.num_steps or length.num_episodes
    budget = dataclasses.replace(length, log_every=whole, exact=False, exact_every=None, record=record)
    one = dataclasses.replace(part, axes={}, configs=[part.configs[setting]], budget=budget)
    computed = compute(one, places, memory=memory)
    if not np.array_equal(computed.q, q, equal_nan=True):
        raise RunError("the runs, run again, gave other numbers: this is another kind of machine")
    assert computed.log.recorded is not None
    return _as_policies(computed.log.recorded["acting"][:, -1])


def _as_policies(probs: Any) -> np.ndarray:
    """Probabilities in float64 that add up to 1."""
    probs = np.asarray(probs, np.float64)
    return probs / probs.sum(-1, keepdims=True)
