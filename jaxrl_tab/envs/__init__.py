"""The environments, one file each. To add one: write its file, and add its line to ENVS.

ENVS holds those that can be made from their name alone. `FiniteMDP`, which needs its arrays, and `FiniteHorizon`, which
needs another environment, are classes only.
"""

import re
from typing import Any

from jaxrl_tab.core import modules, names
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import nearest, shown
from jaxrl_tab.envs.access_control import AccessControl
from jaxrl_tab.envs.baird import Baird
from jaxrl_tab.envs.base import Finite, FixedStart, Grid
from jaxrl_tab.envs.blackjack import Blackjack
from jaxrl_tab.envs.chain import Chain
from jaxrl_tab.envs.changing_mazes import BlockingMaze, ShortcutMaze
from jaxrl_tab.envs.cliff_walking import CliffWalking
from jaxrl_tab.envs.deep_sea import DeepSea
from jaxrl_tab.envs.drifting_testbed import DriftingTestbed
from jaxrl_tab.envs.easy21 import Easy21
from jaxrl_tab.envs.finite_horizon import FORM, PREFIX, FiniteHorizon, of_name
from jaxrl_tab.envs.finite_mdp import FiniteMDP
from jaxrl_tab.envs.gamblers_problem import GamblersProblem
from jaxrl_tab.envs.garnet import Garnet
from jaxrl_tab.envs.infinite_variance import InfiniteVariance
from jaxrl_tab.envs.jacks_car_rental import JacksCarRental
from jaxrl_tab.envs.k_armed_testbed import KArmedTestbed
from jaxrl_tab.envs.long_walk import LongWalk
from jaxrl_tab.envs.maximization_bias import MaximizationBias
from jaxrl_tab.envs.maze import FrozenLake, Maze
from jaxrl_tab.envs.mountain_car import MountainCar
from jaxrl_tab.envs.racetrack import Racetrack
from jaxrl_tab.envs.random_walk import RandomWalk
from jaxrl_tab.envs.recycling_robot import RecyclingRobot
from jaxrl_tab.envs.river_swim import RiverSwim
from jaxrl_tab.envs.short_corridor import ShortCorridor
from jaxrl_tab.envs.square_wave import SquareWave
from jaxrl_tab.envs.taxi import Taxi
from jaxrl_tab.envs.trace_gridworld import TraceGridworld
from jaxrl_tab.envs.tsitsiklis_van_roy import TsitsiklisVanRoy
from jaxrl_tab.envs.two_doors import TwoDoors
from jaxrl_tab.envs.two_loops import TwoLoops
from jaxrl_tab.envs.windy_gridworld import WindyGridworld

ENVS: dict[str, type] = {
    "windy-gridworld": WindyGridworld,
    "cliff-walking": CliffWalking,
    "random-walk": RandomWalk,
    "long-walk": LongWalk,
    "blackjack": Blackjack,
    "easy21": Easy21,
    "two-doors": TwoDoors,
    "short-corridor": ShortCorridor,
    "k-armed-testbed": KArmedTestbed,
    "drifting-testbed": DriftingTestbed,
    "maximization-bias": MaximizationBias,
    "infinite-variance": InfiniteVariance,
    "trace-gridworld": TraceGridworld,
    "access-control": AccessControl,
    "two-loops": TwoLoops,
    "baird": Baird,
    "tsitsiklis-van-roy": TsitsiklisVanRoy,
    "chain": Chain,
    "river-swim": RiverSwim,
    "deep-sea": DeepSea,
    "garnet": Garnet,
    "maze": Maze,
    "blocking-maze": BlockingMaze,
    "shortcut-maze": ShortcutMaze,
    "frozen-lake": FrozenLake,
    "taxi": Taxi,
    "racetrack": Racetrack,
    "recycling-robot": RecyclingRobot,
    "jacks-car-rental": JacksCarRental,
    "gamblers-problem": GamblersProblem,
    "mountain-car": MountainCar,
    "square-wave": SquareWave,
}

# What people look for under these names, without hyphens, as Gymnasium calls it.
GYMNASIUM = {"frozenlake8x8": "FrozenLake8x8-v1"}


def make(name: str, **parameters: Any):
    """The environment of this name with its parameters: `make("windy-gridworld", moves="king")`.

    Args:
        name: of ENVS, or from outside: "mine.py:MyEnv", "gymnasium:FrozenLake-v1", "mdp.npz",
            "tiger.POMDP" (see `core.names`).
        parameters: of the environment.

    Raises:
        InputError: the name, a parameter or a value is wrong.
    """
    reference = names.find(ENVIRONMENT, name)
    return build(reference.cls, name, parameters)


def name_of(env: Any) -> str:
    """The name of an environment: its own title, or else that in ENVS, or of its class."""
    return of_environment(env).title or names.registered_name(ENVS, type(env))


def instead(name: Any) -> str:
    """What a message says instead of `name`, which is not in ENVS: one of ours, or how another is imported."""
    if not isinstance(name, str):
        return nearest(name, ENVS)
    if name == PREFIX:
        return f"say what ends, and after how many steps: {FORM}"
    stem, _, suffix = name.rpartition("-")
    if suffix in ("misc", "bsuite", "MinAtar"):
        return f"{shown('gymnax:' + name)} imports it, if its states can be counted"
    is_versioned = re.fullmatch("v[0-9]+", suffix) is not None
    plain = re.sub("[-_]", "", (stem if is_versioned else name).lower())
    if plain not in (ours.replace("-", "") for ours in ENVS) and (is_versioned or plain in GYMNASIUM):
        perhaps = "" if plain in GYMNASIUM else ", if it has a table of its outcomes"
        return f"{shown('gymnasium:' + GYMNASIUM.get(plain, name))} imports it{perhaps}"
    return nearest(name, ENVS)


def _of_table(file: modules.File) -> type:
    """The class of the table in a file, which has no parameters."""
    mdp = FiniteMDP.load(file.path, file.data)
    return names.made_by(lambda: mdp, "FiniteMDP", {})


ENVIRONMENT = names.Kind(
    noun="an environment",
    registry=ENVS,
    group="jaxrl_tab.environments",
    needs=("num_states", "num_actions", "max_steps", "reset", "step"),
    add=ENVS.__setitem__,
    hint=instead,
    around={PREFIX: of_name},
    table=_of_table,
)


__all__ = [
    "ENVIRONMENT",
    "ENVS",
    "AccessControl",
    "Baird",
    "Blackjack",
    "BlockingMaze",
    "Chain",
    "CliffWalking",
    "DeepSea",
    "DriftingTestbed",
    "Easy21",
    "Finite",
    "FiniteHorizon",
    "FiniteMDP",
    "FixedStart",
    "FrozenLake",
    "GamblersProblem",
    "Garnet",
    "Grid",
    "InfiniteVariance",
    "JacksCarRental",
    "KArmedTestbed",
    "LongWalk",
    "MaximizationBias",
    "Maze",
    "MountainCar",
    "Racetrack",
    "RandomWalk",
    "RecyclingRobot",
    "RiverSwim",
    "ShortCorridor",
    "ShortcutMaze",
    "SquareWave",
    "Taxi",
    "TraceGridworld",
    "TsitsiklisVanRoy",
    "TwoDoors",
    "TwoLoops",
    "WindyGridworld",
    "make",
]
