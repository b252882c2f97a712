"""The walk of a thousand states, whose exact values the figures of chapter 9 judge approximate ones by."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrl_tab import approx
from jaxrl_tab.envs import LongWalk
from jaxrl_tab.exact import planning

WALK = LongWalk(max_steps=2000)  # no episode in 10^11 lasts as long, and so little is remembered quickly


@cache
def exact(features: str) -> planning.LinearValues:
    """All that is exact about the values of the walk as a linear function of these features."""
    return planning.linear_values(WALK, np.ones((WALK.num_states, 1)), approx.matrix(features, WALK))


def least_error(features: str) -> float:
    """The root of VE that the best weights have."""
    values = exact(features)
    return values.value_error(values.best_weights()) ** 0.5


def td_error(features: str) -> float:
    """The root of VE that the fixed point of TD has."""
    values = exact(features)
    return values.value_error(values.td_fixed_point()) ** 0.5


def recorder(features: str, weighted: bool = True) -> Callable[[Any], dict[str, Any]]:
    """What is recorded of a learner: the root of VE (equation 9.1); or with all states counting alike.

    It is what `exact=True` records as `value_error`, or `v_error`, here with the exact side worked out once for all
    figures.
    """
    values = exact(features)
    weight = values.mu if weighted else (np.arange(WALK.num_states) % (WALK.states + 1) > 0) / WALK.states

    def errors(learner: Any) -> dict[str, Any]:
        x, v, mu = (jnp.asarray(y, learner.v.dtype) for y in (values.features, values.values, weight))
        return {"error": jnp.sqrt((mu * ((x * learner.v[None]).sum(1) - v) ** 2).sum())}

    return errors


def values_of(features: str, weights: Any) -> np.ndarray:
    """The values of the states between the ends, [..., 1000], with these weights [..., n]."""
    return (np.asarray(weights, float) @ exact(features).features.T)[..., 1:-1]
