"""Bootstrapping with groups of states, on the walk of a thousand (book, figure 9.2)."""

import numpy as np

from jaxrl_tab import approx
from jaxrl_tab.figures import aggregation
from jaxrl_tab.figures.bias_variance import curves
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept
from jaxrl_tab.figures.long_walk import WALK, exact, recorder, td_error

TEN = aggregation.FEATURES
ALPHA, EPISODES = 2e-4, 100_000  # of the values on the left; the book does not print them
TWENTY = "aggregation(20)"
NS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
ALPHAS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
TD, N_STEP = "td", "n-step-td"


def _experiment(num_seeds=8, num_episodes=EPISODES, n_step_seeds=100, ns=NS, alphas=ALPHAS):
    left = {"features": TEN, "alpha": ALPHA}
    right = {"features": TWENTY, "n": list(ns), "alpha": list(alphas)}
    ten = {"num_seeds": n_step_seeds, "num_episodes": 10, "record": recorder(TWENTY, weighted=False)}
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes, "log_every": num_episodes}
    return {
        TD: swept(WALK, approx.SemiGradientTD, left, **budget),
        N_STEP: swept(WALK, approx.SemiGradientNStepTD, right, **ten),
    }


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.8)
    left, right = canvas.subplots(1, 2, width_ratios=(1, 1.2))
    aggregation.draw_values(left, aggregation.values(datasets, TD)[0], "semi-gradient TD(0)")
    of, states = exact(TEN), np.arange(1, WALK.states + 1)
    fixed = (of.features @ of.td_fixed_point())[1:-1]
    left.plot(states, fixed, color=plot.COLORS[1], lw=1.2, ls=":", label="TD fixed point")
    plot.legend(left, ncols=1)
    error = datasets[N_STEP].error
    curves(right, error, "n", "n")
    right.set(ylim=(0.25, 0.56), ylabel="RMS error, first 10 episodes")
    plot.legend(right)
    plot.head(canvas, "1000 states: TD(0) with 10 groups; n-step TD with 20 groups", error.sizes["seed"])
    return canvas


def _n_step(n, alpha):
    return lambda datasets: datasets[N_STEP].error.sel(n=n, alpha=alpha).mean("row")


def _group(group):
    return lambda datasets: aggregation.values(datasets, TD)[:, 100 * group - 1]


FIGURE = Figure(
    title="TD with groups of states: where it ends, and how fast",
    source="Sutton and Barto 2018, figure 9.2",
    shows="TD(0) ends at its fixed point, which is flatter than the best values that the groups allow. And n-step "
    "methods compare as they do with a table: an n in between is best, and needs a smaller step the larger it is.",
    experiment=_experiment,
    small={
        "num_seeds": 2,
        "num_episodes": 20,
        "n_step_seeds": 2,
        "ns": (1, 4, 64),
        "alphas": (0.1, 0.2, 0.4, 0.5, 1.0),
    },
    numbers=(
        # The exact one from equations of another program. The others from plain loops: of 60 runs on the left, a
        # little off the fixed point with this step size, and of 4000 on the right.
        Number("√VE of the TD fixed point, exactly", 0.1167353, EXACT, lambda datasets: td_error(TEN)),
        Number(
            "TD(0): √VE in the end", 0.11409, 2.4e-4, lambda datasets: aggregation.value_error(datasets, TD)
        ),
        *(
            Number(f"TD(0): value of group {group} in the end", expected, error, _group(group))
            for group, expected, error in (
                (1, -0.69718, 4.9e-4),
                (5, -0.00856, 5.5e-4),
                (10, 0.72632, 3.9e-4),
            )
        ),
        *(
            Number(f"{n}-step TD, α = {alpha:g}: RMS error", expected, error, _n_step(n, alpha))
            for n, alpha, expected, error in (
                (1, 0.5, 0.39172, 1.4e-4),
                (1, 1.0, 0.43294, 4.1e-4),
                (4, 0.2, 0.34346, 3.0e-4),
                (4, 0.4, 0.28913, 6.7e-4),
                (64, 0.1, 0.45548, 1.1e-3),
            )
        ),
    ),
    draw=_draw,
)
