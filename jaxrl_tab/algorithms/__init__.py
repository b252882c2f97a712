"""The control methods, one file each. To add one: write its file, and add its line to ALGORITHMS."""

from jaxrl_tab.algorithms.expected_sarsa import ExpectedSarsa
from jaxrl_tab.algorithms.q_learning import QLearning
from jaxrl_tab.algorithms.sarsa import Sarsa

ALGORITHMS = {
    "sarsa": Sarsa,
    "q-learning": QLearning,
    "expected-sarsa": ExpectedSarsa,
}

__all__ = ["ALGORITHMS", "ExpectedSarsa", "QLearning", "Sarsa"]
