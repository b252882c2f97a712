"""The control methods, one file each. To add one: write its file, and add its line to ALGORITHMS."""

from jaxrl_tab.algorithms.double_q_learning import DoubleQLearning
from jaxrl_tab.algorithms.expected_sarsa import ExpectedSarsa
from jaxrl_tab.algorithms.monte_carlo import MonteCarlo
from jaxrl_tab.algorithms.n_step_sarsa import NStepSarsa
from jaxrl_tab.algorithms.q_lambda import QLambda
from jaxrl_tab.algorithms.q_learning import QLearning
from jaxrl_tab.algorithms.sarsa import Sarsa
from jaxrl_tab.algorithms.sarsa_lambda import SarsaLambda
from jaxrl_tab.algorithms.target_q_learning import TargetQLearning

ALGORITHMS = {
    "sarsa": Sarsa,
    "q-learning": QLearning,
    "expected-sarsa": ExpectedSarsa,
    "monte-carlo": MonteCarlo,
    "n-step-sarsa": NStepSarsa,
    "sarsa-lambda": SarsaLambda,
    "q-lambda": QLambda,
    "double-q-learning": DoubleQLearning,
    "q-learning-target": TargetQLearning,
}

__all__ = [
    "ALGORITHMS",
    "DoubleQLearning",
    "ExpectedSarsa",
    "NStepSarsa",
    "QLambda",
    "QLearning",
    "Sarsa",
    "SarsaLambda",
    "TargetQLearning",
]
