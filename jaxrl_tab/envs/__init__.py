"""The environments, one file each. To add one: write its file, and add its line to ENVS.

ENVS holds those that can be made from their name alone; `FiniteMDP` needs its arrays, and so is a class only.
"""

from typing import Any

from jaxrl_tab.envs.blackjack import Blackjack
from jaxrl_tab.envs.cliff_walking import CliffWalking
from jaxrl_tab.envs.easy21 import Easy21
from jaxrl_tab.envs.finite_mdp import FiniteMDP
from jaxrl_tab.envs.infinite_variance import InfiniteVariance
from jaxrl_tab.envs.k_armed_testbed import KArmedTestbed
from jaxrl_tab.envs.maximization_bias import MaximizationBias
from jaxrl_tab.envs.random_walk import RandomWalk
from jaxrl_tab.envs.trace_gridworld import TraceGridworld
from jaxrl_tab.envs.two_doors import TwoDoors
from jaxrl_tab.envs.windy_gridworld import WindyGridworld
from jaxrl_tab.types import InputError, build, nearest, shown

ENVS = {
    "windy-gridworld": WindyGridworld,
    "cliff-walking": CliffWalking,
    "random-walk": RandomWalk,
    "blackjack": Blackjack,
    "easy21": Easy21,
    "two-doors": TwoDoors,
    "k-armed-testbed": KArmedTestbed,
    "maximization-bias": MaximizationBias,
    "infinite-variance": InfiniteVariance,
    "trace-gridworld": TraceGridworld,
}


def make(name: str, **parameters: Any):
    """The environment called `name` in ENVS, with its parameters: `make("windy-gridworld", moves="king")`.

    Raises:
        InputError: the name, a parameter or a value is wrong.
    """
    if not isinstance(name, str) or name not in ENVS:
        raise InputError(f"no environment is called {shown(name)}; {nearest(name, ENVS)}")
    return build(ENVS[name], name, parameters)


__all__ = [
    "ENVS",
    "Blackjack",
    "CliffWalking",
    "Easy21",
    "FiniteMDP",
    "InfiniteVariance",
    "KArmedTestbed",
    "MaximizationBias",
    "RandomWalk",
    "TraceGridworld",
    "TwoDoors",
    "WindyGridworld",
    "make",
]
