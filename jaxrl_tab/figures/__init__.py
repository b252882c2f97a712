"""Published figures, one file each. To add one: write its file, and add its line to FIGURES."""

from jaxrl_tab.figures import (
    access_control,
    bias_variance,
    blackjack,
    blackjack_regret,
    changing_mazes,
    cliff_alpha,
    cliff_walking,
    dyna_maze,
    expected_or_sample,
    gamblers_problem,
    gpi,
    how_often,
    importance_sampling,
    initial_q,
    jacks_car_rental,
    k_armed_testbed,
    lambda_arrows,
    maximization_bias,
    online_lambda,
    prioritized_sweeping,
    q_sigma,
    racetrack,
    recycling_robot,
    state_values,
    time_step,
    trace,
    trace_gridworld,
    trajectory_sampling,
    two_doors,
    windy_gridworld,
)
from jaxrl_tab.figures.figure import Check, Figure, Number, swept

FIGURES = {
    "recycling-robot": recycling_robot.FIGURE,
    "state-values": state_values.FIGURE,
    "gpi": gpi.FIGURE,
    "jacks-car-rental": jacks_car_rental.FIGURE,
    "gamblers-problem": gamblers_problem.FIGURE,
    "k-armed-testbed": k_armed_testbed.FIGURE,
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
    "online-lambda": online_lambda.FIGURE,
    "q-sigma": q_sigma.FIGURE,
    "blackjack": blackjack.FIGURE,
    "blackjack-regret": blackjack_regret.FIGURE,
    "how-often": how_often.FIGURE,
    "initial-q": initial_q.FIGURE,
    "racetrack": racetrack.FIGURE,
    "access-control": access_control.FIGURE,
    "importance-sampling": importance_sampling.FIGURE,
    "dyna-maze": dyna_maze.FIGURE,
    "changing-mazes": changing_mazes.FIGURE,
    "prioritized-sweeping": prioritized_sweeping.FIGURE,
    "expected-or-sample": expected_or_sample.FIGURE,
    "trajectory-sampling": trajectory_sampling.FIGURE,
}

__all__ = ["FIGURES", "Check", "Figure", "Number", "swept"]


def __dir__() -> list[str]:
    return __all__
