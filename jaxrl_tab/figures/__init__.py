"""Published figures, one file each. To add one: write its file, and add its line to FIGURES."""

from jaxrl_tab.figures import (
    access_control,
    bandit_parameters,
    bias_variance,
    blackjack,
    blackjack_regret,
    cliff_alpha,
    cliff_walking,
    gpi,
    gradient_bandit,
    how_often,
    importance_sampling,
    initial_q,
    k_armed_testbed,
    lambda_arrows,
    maximization_bias,
    optimistic_values,
    reinforce,
    short_corridor,
    testbed,
    time_step,
    trace,
    trace_gridworld,
    two_doors,
    upper_confidence_bounds,
    windy_gridworld,
)
from jaxrl_tab.figures.figure import Check, Figure, Number, swept

FIGURES = {
    "gpi": gpi.FIGURE,
    "testbed": testbed.FIGURE,
    "k-armed-testbed": k_armed_testbed.FIGURE,
    "optimistic-values": optimistic_values.FIGURE,
    "upper-confidence-bounds": upper_confidence_bounds.FIGURE,
    "gradient-bandit": gradient_bandit.FIGURE,
    "bandit-parameters": bandit_parameters.FIGURE,
    "two-doors": two_doors.FIGURE,
    "windy-gridworld": windy_gridworld.FIGURE,
    "cliff-walking": cliff_walking.FIGURE,
    "cliff-alpha": cliff_alpha.FIGURE,
    "maximization-bias": maximization_bias.FIGURE,
    "trace": trace.FIGURE,
    "trace-gridworld": trace_gridworld.FIGURE,
    "lambda-arrows": lambda_arrows.FIGURE,
    "time-step": time_step.FIGURE,
    "bias-variance": bias_variance.FIGURE,
    "blackjack": blackjack.FIGURE,
    "blackjack-regret": blackjack_regret.FIGURE,
    "how-often": how_often.FIGURE,
    "initial-q": initial_q.FIGURE,
    "access-control": access_control.FIGURE,
    "importance-sampling": importance_sampling.FIGURE,
    "short-corridor": short_corridor.FIGURE,
    "reinforce": reinforce.FIGURE,
}

__all__ = ["FIGURES", "Check", "Figure", "Number", "swept"]


def __dir__() -> list[str]:
    return __all__
