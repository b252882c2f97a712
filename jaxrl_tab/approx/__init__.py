"""Beyond the table: values that are functions of features of a state (book, chapters 9 to 12).

    features        what is known of a state: one-hot, aggregation, tile coding, polynomial, Fourier, radial basis
    semi_gradient   what the semi-gradient methods share
    control         Sarsa, Expected Sarsa, Q-learning, n-step Sarsa, Sarsa(lambda), true online Sarsa(lambda)
    prediction      TD(0), n-step TD, TD(lambda), true online TD(lambda)

To add a method: write its class, and add its line here.
"""

from jaxrl_tab.algorithms import ALGORITHMS
from jaxrl_tab.algorithms.prediction import PREDICTION
from jaxrl_tab.approx import control, prediction
from jaxrl_tab.approx.features import (
    FEATURES,
    Aggregation,
    Features,
    Fourier,
    OneHot,
    Polynomial,
    RadialBasis,
    Rows,
    TileCoding,
)

CONTROL: dict[str, type] = {
    "semi-gradient-sarsa": control.SemiGradientSarsa,
    "semi-gradient-expected-sarsa": control.SemiGradientExpectedSarsa,
    "semi-gradient-q-learning": control.SemiGradientQLearning,
    "semi-gradient-n-step-sarsa": control.SemiGradientNStepSarsa,
    "semi-gradient-sarsa-lambda": control.SemiGradientSarsaLambda,
    "semi-gradient-true-online-sarsa-lambda": control.SemiGradientTrueOnlineSarsaLambda,
}
OF_STATES: dict[str, type] = {
    "semi-gradient-td": prediction.SemiGradientTD,
    "semi-gradient-n-step-td": prediction.SemiGradientNStepTD,
    "semi-gradient-td-lambda": prediction.SemiGradientTDLambda,
    "semi-gradient-true-online-td-lambda": prediction.SemiGradientTrueOnlineTDLambda,
}
ALGORITHMS |= CONTROL
PREDICTION |= OF_STATES

__all__ = [
    "CONTROL",
    "FEATURES",
    "OF_STATES",
    "Aggregation",
    "Features",
    "Fourier",
    "OneHot",
    "Polynomial",
    "RadialBasis",
    "Rows",
    "TileCoding",
]
