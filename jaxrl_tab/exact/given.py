"""Values and policies as they are given, checked, in float64."""

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import as_array, first
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.exact.model import Model, available_only


def numbers(name: str, value: Any) -> np.ndarray:
    """`value` in float64. Raises InputError unless it is numbers in a rectangular array."""
    array = as_array(value)
    if array is None or array.dtype.kind not in "biuf":
        raise InputError(f"{name} must be numbers, in rows of equal length, not {shown(value)}")
    return array.astype(np.float64)


def checked_policy(model: Model, policy_probs: Any) -> np.ndarray:
    table = policies.as_table("policy_probs", policy_probs, model.prob.shape[:2])
    probs = numbers("policy_probs", table.probabilities)
    if model.available is not None:
        policies.check_among("policy_probs", probs, model.available)
    return probs / probs.sum(1, keepdims=True)


def checked_values(model: Model, name: str, values: Any) -> np.ndarray:
    """`values` in float64: v [S], or q [S, A], whatever that says of actions that are not available."""
    array = numbers(name, values)
    shape = model.prob.shape[: 1 if name == "v" else 2]
    if array.shape != shape:
        each = f"{shape[0]} states" + "".join(f" and {n} actions" for n in shape[1:])
        raise InputError(f"{name} must have one value for each of the {each}, not {array.shape}")
    return array if name == "v" else available_only(model, array)


def checked_table(q: Any) -> Float[np.ndarray, "... S A"]:
    """`q` in float64. Raises InputError unless it is a table of numbers, or many."""
    array = numbers("q", q)
    if array.ndim < 2 or not array.size:
        raise InputError(f"q must be action values [S, A] or [..., S, A], not of shape {array.shape}")
    if (i := first(np.isnan(array))) is not None:
        raise InputError(f"q{list(i)} is not a number, so no action is the best there")
    return array
