"""Published figures, one file each. To add one: write its file, and add its line to FIGURES."""

from jaxrl_tab.figures import (
    bias_variance,
    blackjack,
    blackjack_regret,
    cliff_alpha,
    cliff_walking,
    gpi,
    importance_sampling,
    k_armed_testbed,
    maximization_bias,
    trace_gridworld,
    two_doors,
    windy_gridworld,
)
from jaxrl_tab.figures.figure import Check, Figure, Number, swept

FIGURES = {
    "gpi": gpi.FIGURE,
    "k-armed-testbed": k_armed_testbed.FIGURE,
    "two-doors": two_doors.FIGURE,
    "windy-gridworld": windy_gridworld.FIGURE,
    "cliff-walking": cliff_walking.FIGURE,
    "cliff-alpha": cliff_alpha.FIGURE,
    "maximization-bias": maximization_bias.FIGURE,
    "trace-gridworld": trace_gridworld.FIGURE,
    "bias-variance": bias_variance.FIGURE,
    "blackjack": blackjack.FIGURE,
    "blackjack-regret": blackjack_regret.FIGURE,
    "importance-sampling": importance_sampling.FIGURE,
}

__all__ = ["FIGURES", "Check", "Figure", "Number", "swept"]


def __dir__() -> list[str]:
    return __all__
