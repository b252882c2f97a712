"""Values of hyperparameters as JSON and TOML have them."""

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxrl_tab.approx import MLP, Features, features, network
from jaxrl_tab.core import clock, policies, schedules
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.experiment.places import DEEPEST

# What is written as its text, and how that is read.
AS_TEXT = {
    clock.Schedule: schedules.parse,
    policies.Policy: policies.parse,
    Features: features.read,
    MLP: network.read,
}


def as_plain(key: str, value: Any) -> Any:
    """A hyperparameter as JSON has it, and as it can be written again."""
    if isinstance(value, Mapping):
        return {name: as_plain(name, x) for name, x in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(key, x) for x in value]
    if isinstance(value, policies.Table):
        return np.asarray(value.probabilities).tolist()
    parse = next((parse for cls, parse in AS_TEXT.items() if isinstance(value, cls)), None)
    if parse is None:
        return value
    with contextlib.suppress(InputError):  # its text will do only if that is read as the same value again
        if repr(parse(str(value))) == repr(value):
            return str(value)
    raise InputError(f"{key}: {shown(value)} cannot be written in a file; sweep(...) takes it")


def as_lists(value: Any, depth: int = 0) -> Any:
    """Lists in place of tuples and arrays."""
    if depth > DEEPEST:
        raise InputError(f"more than {DEEPEST} lists are in one another")
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return [as_lists(x, depth + 1) for x in value] if isinstance(value, list | tuple) else value


def depth_of(value: Any) -> int:
    """How deeply lists are nested, at the deepest place."""
    return _depth_of_lists(as_lists(value))


def _depth_of_lists(value: Any) -> int:
    return 1 + max(map(_depth_of_lists, value), default=0) if isinstance(value, list) else 0
