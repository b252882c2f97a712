"""Arms that drift: a constant step size against sample averages (book, exercise 2.5)."""

import numpy as np

from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.envs import DriftingTestbed, KArmedTestbed
from jaxrl_tab.figures import arms
from jaxrl_tab.figures.figure import EXACT, Figure, Number

EPSILON, PLAYS, EVERY = 0.1, 10_000, 100
RATES = {"sample averages": sample_average(), "α = 0.1": 0.1}
AVERAGES, CONSTANT = RATES


def _experiment(num_problems=1000):
    def run(alpha):
        setting, chances = {"alpha": alpha, "epsilon": EPSILON}, arms.epsilon_greedy(EPSILON)
        return arms.run("q-learning", setting, num_problems, chances, DriftingTestbed(), PLAYS, EVERY)

    return {name: run(alpha) for name, alpha in RATES.items()}


def _best(plays):
    """The mean of max_a q*(a) after so many plays, when each q* is N(0, plays drift^2)."""
    return DriftingTestbed().drift * np.sqrt(plays) * KArmedTestbed().expected_best_mean()


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    rewards, share = canvas.subplots(1, 2)
    plays = np.arange(PLAYS)
    rewards.plot(plays, _best(plays), color=plot.INK, ls="--", lw=1.0, label="the best arm")
    for name, color in zip(RATES, plot.COLORS, strict=False):
        arms.draw_rewards(rewards, datasets[name], name, color)
        arms.draw_share(share, datasets[name], name, color)
    for ax, what in ((rewards, "mean reward"), (share, "best arm, % of plays")):
        plot.tidy(ax, "plays", what)
        ax.set(xlim=(0, PLAYS), ylim=(0, None))
    share.set_ylim(0, 100)
    plot.legend(rewards)
    problems = datasets[CONSTANT].sizes["seed"]
    plot.head(canvas, f"Ten arms that drift, ε = {EPSILON}: mean and 95% interval, {problems} problems")
    return canvas


FIGURE = Figure(
    title="Arms that drift",
    source="Sutton and Barto 2018, exercise 2.5",
    shows="An average of all rewards of an arm says what it was worth, and the longer it goes on the less it notices "
    "of what has changed. A constant step size forgets, and keeps up with the best arm.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # By integration; the others from 20 000 problems, with plain loops.
        Number("mean of the best arm after 10 000 plays", 1.538753, EXACT, lambda datasets: _best(PLAYS)),
        Number(
            "sample averages: mean reward of plays 9001 to 10 000", 1.0590, 0.0045, arms.late_reward(AVERAGES)
        ),
        Number("α = 0.1", 1.3231, 0.0038, arms.late_reward(CONSTANT)),
        Number(
            "sample averages: probability of the best arm, plays 9101 to 10 001",
            0.45017,
            0.00284,
            arms.late_share(AVERAGES),
        ),
        Number("α = 0.1: the same", 0.76079, 0.00136, arms.late_share(CONSTANT)),
    ),
    draw=_draw,
)
