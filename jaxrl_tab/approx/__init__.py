"""Beyond the table: values that are functions of features of a state (book, chapters 9 to 12).

    observed        what all features have in common: their range, and how they become those of a task
    features        what is known of a state: one-hot, aggregation, tile coding, polynomial, Fourier, radial basis,
                    or several of them together
    semi_gradient   what the semi-gradient methods share
    optimized       where an optimiser of optax may change the weights, in place of alpha
    control         Sarsa, Expected Sarsa, Q-learning, n-step Sarsa, Sarsa(lambda), true online Sarsa(lambda),
                    differential Sarsa
    prediction      TD(0), n-step TD, TD(lambda), true online TD(lambda)
    monte_carlo     gradient Monte Carlo
    off_policy      TD(0) with importance sampling, GTD2, TDC, emphatic TD
    least_squares   LSTD; online least-squares policy iteration
    weights         weights that are given at the start
    network         a small neural network
    deep            Q-learning and Sarsa by such a network, with experience replay and a target copy
    policy_iteration  least-squares policy iteration from a log
    dangers         a step size that must diverge, and the deadly triad

To add a method: write its class, and add its line here. They are used wherever a method is:

    method = rl.approx.SemiGradientSarsa(features="tile-coding(8, 8)", alpha=0.5, per_tiling=True, epsilon=0)
    state, log = rl.train(key, method, rl.MountainCar(), num_episodes=500)
"""

from jaxrl_tab.approx.control import (
    DifferentialSemiGradientSarsa,
    SemiGradientExpectedSarsa,
    SemiGradientNStepSarsa,
    SemiGradientQLearning,
    SemiGradientSarsa,
    SemiGradientSarsaLambda,
    SemiGradientTrueOnlineSarsaLambda,
)
from jaxrl_tab.approx.deep import DeepQNetwork, DeepSarsa
from jaxrl_tab.approx.features import (
    FEATURES,
    Aggregation,
    Concatenate,
    Fourier,
    Observation,
    OneHot,
    Own,
    Polynomial,
    RadialBasis,
    TileCoding,
    matrix,
)
from jaxrl_tab.approx.least_squares import LSPI, LSTD
from jaxrl_tab.approx.monte_carlo import GradientMonteCarlo
from jaxrl_tab.approx.network import MLP
from jaxrl_tab.approx.observed import Features, Rows
from jaxrl_tab.approx.off_policy import GTD2, TDC, EmphaticTD, SemiGradientOffPolicyTD
from jaxrl_tab.approx.policy_iteration import LeastSquaresPolicy, lspi
from jaxrl_tab.approx.prediction import (
    SemiGradientNStepTD,
    SemiGradientTD,
    SemiGradientTDLambda,
    SemiGradientTrueOnlineTDLambda,
)

CONTROL: dict[str, type] = {
    "semi-gradient-sarsa": SemiGradientSarsa,
    "semi-gradient-expected-sarsa": SemiGradientExpectedSarsa,
    "semi-gradient-q-learning": SemiGradientQLearning,
    "semi-gradient-n-step-sarsa": SemiGradientNStepSarsa,
    "semi-gradient-sarsa-lambda": SemiGradientSarsaLambda,
    "semi-gradient-true-online-sarsa-lambda": SemiGradientTrueOnlineSarsaLambda,
    "differential-semi-gradient-sarsa": DifferentialSemiGradientSarsa,
    "lspi": LSPI,
    "deep-q-network": DeepQNetwork,
    "deep-sarsa": DeepSarsa,
}
OF_STATES: dict[str, type] = {
    "semi-gradient-td": SemiGradientTD,
    "semi-gradient-n-step-td": SemiGradientNStepTD,
    "semi-gradient-td-lambda": SemiGradientTDLambda,
    "semi-gradient-true-online-td-lambda": SemiGradientTrueOnlineTDLambda,
    "gradient-monte-carlo": GradientMonteCarlo,
    "lstd": LSTD,
    "semi-gradient-off-policy-td": SemiGradientOffPolicyTD,
    "gtd2": GTD2,
    "tdc": TDC,
    "emphatic-td": EmphaticTD,
}

__all__ = [
    "CONTROL",
    "FEATURES",
    "GTD2",
    "LSPI",
    "LSTD",
    "MLP",
    "OF_STATES",
    "TDC",
    "Aggregation",
    "Concatenate",
    "DeepQNetwork",
    "DeepSarsa",
    "DifferentialSemiGradientSarsa",
    "EmphaticTD",
    "Features",
    "Fourier",
    "GradientMonteCarlo",
    "LeastSquaresPolicy",
    "Observation",
    "OneHot",
    "Own",
    "Polynomial",
    "RadialBasis",
    "Rows",
    "SemiGradientExpectedSarsa",
    "SemiGradientNStepSarsa",
    "SemiGradientNStepTD",
    "SemiGradientOffPolicyTD",
    "SemiGradientQLearning",
    "SemiGradientSarsa",
    "SemiGradientSarsaLambda",
    "SemiGradientTD",
    "SemiGradientTDLambda",
    "SemiGradientTrueOnlineSarsaLambda",
    "SemiGradientTrueOnlineTDLambda",
    "TileCoding",
    "lspi",
    "matrix",
]
