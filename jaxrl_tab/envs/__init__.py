"""The environments, one file each. To add one: write its file, and add its line to ENVS."""

from typing import Any

from jaxrl_tab.envs.windy_gridworld import WindyGridworld
from jaxrl_tab.types import InputError, nearest

ENVS = {
    "windy-gridworld": WindyGridworld,
}


def make(name: str, **parameters: Any):
    """The environment called `name` in ENVS, with its parameters: `make("windy-gridworld", moves="king")`.

    Raises:
        InputError: the name, a parameter or a value is wrong.
    """
    if name not in ENVS:
        raise InputError(f"no environment is called {name!r}; {nearest(name, ENVS)}")
    return build(ENVS[name], name, parameters)


__all__ = ["ENVS", "WindyGridworld", "make"]
