"""All that is public in the package, which shows it as its own: `jaxrl_tab.sweep` is `jaxrl_tab.api.sweep`."""

import importlib
import types
from typing import Any

from jaxrl_tab import algorithms, approx, envs, interop
from jaxrl_tab.algorithms import (
    PSRL,
    UCBVI,
    ActorCritic,
    ActorCriticLambda,
    DifferentialQLearning,
    DifferentialSarsa,
    DoubleExpectedSarsa,
    DoubleQLearning,
    DoubleSarsa,
    DynaQ,
    DynaQPlus,
    ExpectedSarsa,
    ExpectedSarsaLambda,
    GradientBandit,
    HystereticQLearning,
    ManyTargets,
    MaxminQLearning,
    MonteCarlo,
    NStepExpectedSarsa,
    NStepOffPolicySarsa,
    NStepSarsa,
    OffPolicyMonteCarlo,
    PrioritizedSweeping,
    QLambda,
    QLearning,
    QPiLambda,
    QSigma,
    Reinforce,
    ReinforceBaseline,
    Retrace,
    RLearning,
    RMax,
    Sarsa,
    SarsaLambda,
    SarsaLambdaForward,
    TargetQLearning,
    TreeBackup,
    TreeBackupLambda,
    TrueOnlineSarsaLambda,
    UCBQLearning,
    WeightedDoubleQLearning,
    bridge,
    moments,
    prediction,
)
from jaxrl_tab.core import backups, policies, schedules, tables
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.names import register
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome, Transition
from jaxrl_tab.core.version import __version__ as __version__
from jaxrl_tab.engine import batch, evaluation, offline
from jaxrl_tab.engine.axes import Choice, Integers, LinearGrid, LogGrid, LogUniform, Uniform
from jaxrl_tab.engine.by_xla import use_all_cores
from jaxrl_tab.engine.log import Log
from jaxrl_tab.engine.offline import collect, learn, replay
from jaxrl_tab.engine.results import SweepResult
from jaxrl_tab.engine.sweep import sweep
from jaxrl_tab.engine.train import train
from jaxrl_tab.engine.watch import Watched, watch
from jaxrl_tab.envs import (
    ENVS,
    AccessControl,
    Baird,
    Blackjack,
    CliffWalking,
    Easy21,
    FiniteHorizon,
    FiniteMDP,
    FrozenLake,
    InfiniteVariance,
    KArmedTestbed,
    MaximizationBias,
    Maze,
    MountainCar,
    RandomWalk,
    ShortCorridor,
    TraceGridworld,
    TsitsiklisVanRoy,
    TwoDoors,
    WindyGridworld,
    make,
)
from jaxrl_tab.exact import expected, importance, planning
from jaxrl_tab.experiment import executors, runner
from jaxrl_tab.experiment.compare import compare
from jaxrl_tab.experiment.reading import read
from jaxrl_tab.experiment.runner import explain, resume, run, search
from jaxrl_tab.experiment.search import Search
from jaxrl_tab.experiment.spec import Experiment
from jaxrl_tab.methods import ALGORITHMS, PREDICTION

# Imported when they are first used, because they take a second: name -> where it is.
_LATER = {
    "course": "course",
    "export": "stats.export",
    "figures": "figures",
    "plot": "show.plot",
    "report": "show.report",
    "stats": "stats",
}


class _Report(types.ModuleType):
    """The module `show.report`, which is called as people expect: `rl.report("runs/windy")`."""

    def __call__(self, folder: Any) -> Any:
        """The report of an experiment in a folder, as `experiment.runner.report`."""
        return runner.report(folder)


def __getattr__(name: str) -> Any:
    if name in _LATER:
        module = importlib.import_module(f"jaxrl_tab.{_LATER[name]}")
        if name == "report":
            module.__class__ = _Report
        return module
    raise AttributeError(f"module 'jaxrl_tab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_LATER])


__all__ = [
    "ALGORITHMS",
    "ENVS",
    "PREDICTION",
    "PSRL",
    "UCBVI",
    "AccessControl",
    "ActorCritic",
    "ActorCriticLambda",
    "Baird",
    "Blackjack",
    "Choice",
    "CliffWalking",
    "DifferentialQLearning",
    "DifferentialSarsa",
    "DoubleExpectedSarsa",
    "DoubleQLearning",
    "DoubleSarsa",
    "DynaQ",
    "DynaQPlus",
    "Easy21",
    "ExpectedSarsa",
    "ExpectedSarsaLambda",
    "Experience",
    "Experiment",
    "FiniteHorizon",
    "FiniteMDP",
    "FrozenLake",
    "GradientBandit",
    "HystereticQLearning",
    "InfiniteVariance",
    "InputError",
    "Integers",
    "KArmedTestbed",
    "LinearGrid",
    "Log",
    "LogGrid",
    "LogUniform",
    "ManyTargets",
    "MaximizationBias",
    "MaxminQLearning",
    "Maze",
    "MonteCarlo",
    "MountainCar",
    "NStepExpectedSarsa",
    "NStepOffPolicySarsa",
    "NStepSarsa",
    "OffPolicyMonteCarlo",
    "Outcome",
    "PrioritizedSweeping",
    "QLambda",
    "QLearning",
    "QPiLambda",
    "QSigma",
    "RLearning",
    "RMax",
    "RandomWalk",
    "Reinforce",
    "ReinforceBaseline",
    "Retrace",
    "RunError",
    "Sarsa",
    "SarsaLambda",
    "SarsaLambdaForward",
    "Search",
    "ShortCorridor",
    "SweepResult",
    "TargetQLearning",
    "TraceGridworld",
    "Transition",
    "TreeBackup",
    "TreeBackupLambda",
    "TrueOnlineSarsaLambda",
    "TsitsiklisVanRoy",
    "TwoDoors",
    "UCBQLearning",
    "Uniform",
    "Watched",
    "WeightedDoubleQLearning",
    "WindyGridworld",
    "algorithms",
    "approx",
    "backups",
    "batch",
    "bridge",
    "collect",
    "compare",
    "envs",
    "evaluation",
    "executors",
    "expected",
    "explain",
    "field",
    "importance",
    "interop",
    "learn",
    "make",
    "moments",
    "offline",
    "planning",
    "policies",
    "prediction",
    "pytree",
    "read",
    "register",
    "replay",
    "resume",
    "run",
    "schedules",
    "search",
    "static",
    "sweep",
    "tables",
    "train",
    "use_all_cores",
    "watch",
]
