"""Groups of states with one value each: gradient Monte Carlo on the walk of a thousand states (book, figure 9.1)."""

import numpy as np

from jaxrl_tab import approx
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept
from jaxrl_tab.figures.long_walk import WALK, exact, least_error

FEATURES, GROUPS = "aggregation(10)", 10
ALPHA, EPISODES = 2e-5, 100_000


def _experiment(num_seeds=8, num_episodes=EPISODES):
    grid = {"features": FEATURES, "alpha": ALPHA}
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes, "log_every": num_episodes}
    return {"monte-carlo": swept(WALK, approx.GradientMonteCarlo, grid, **budget)}


def values(datasets, name):
    """The values of the states between the ends, [seeds, 1000]."""
    return datasets[name].q.values[:, 1:-1, 0].astype(float)


def value_error(datasets, name):
    """The root of VE, of each seed."""
    of = exact(FEATURES)
    return np.sqrt(((values(datasets, name) - of.values[1:-1]) ** 2) @ of.mu[1:-1])


def draw_values(ax, learned, label):
    """The values of a run, beside the exact ones and the best of the features, in the axes of figure 9.1."""
    from jaxrl_tab.show import plot

    of, states = exact(FEATURES), np.arange(1, WALK.states + 1)
    ax.plot(states, of.values[1:-1], color=plot.INK, lw=1.3, label="true value v")
    best = (of.features @ of.best_weights())[1:-1]
    ax.plot(states, best, color=plot.GREY, lw=1.3, ls="--", label="best of the features")
    ax.plot(states, learned, color=plot.COLORS[0], lw=1.7, label=label)
    plot.tidy(ax, "state", "value")
    ax.set(xlim=(0, WALK.states), ylim=(-1, 1))


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.8)
    ax = canvas.subplots()
    draw_values(ax, values(datasets, "monte-carlo")[0], "gradient Monte Carlo")
    often, mu = ax.twinx(), exact(FEATURES).mu[1:-1]
    states = np.arange(1, WALK.states + 1)
    often.fill_between(states, mu, color=plot.COLORS[1], alpha=0.35, lw=0, label="how often: μ")
    often.set(ylim=(0, 2 * mu.max()), yticks=[0, mu[498], mu.max()])
    often.set_yticklabels(["0", f"{mu[498]:.4f}", f"{mu.max():.4f}"])
    often.spines["top"].set_visible(False)
    handles = [*ax.get_legend_handles_labels()[0], *often.get_legend_handles_labels()[0]]
    ax.legend(handles=handles, loc="upper left", frameon=False, fontsize=plot.TYPE)
    episodes = datasets["monte-carlo"].attrs["num_episodes"]
    plot.head(canvas, f"A walk of 1000 states in {GROUPS} groups: one run of {episodes:,} episodes")
    return canvas


def _mu(state):
    return lambda datasets: exact(FEATURES).mu[state]


def _group(group):
    return lambda datasets: values(datasets, "monte-carlo")[:, 100 * group - 1]


FIGURE = Figure(
    title="Ten groups of a hundred states each",
    source="Sutton and Barto 2018, figure 9.1",
    shows="Each group has one value, which is near the mean of the true ones weighted by how often the walk is there: "
    "so the first and the last group, whose inner states are seen more often, are flatter than their middle.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 20},
    numbers=(
        # Of mu and of the least error from equations of another program, and mu as the axis of the figure has it. The
        # others from 60 runs of a plain loop; 100 000 episodes are not enough for the outer groups to be at their best.
        Number("μ of the state in the middle, exactly", 0.0136923, EXACT, _mu(500), published="0.0137"),
        Number("μ of the one beside it, exactly", 0.0017258, EXACT, _mu(499), published="0.0017"),
        Number("the least √VE, exactly", 0.0543770, EXACT, lambda datasets: least_error(FEATURES)),
        Number("√VE in the end", 0.05670, 3.2e-4, lambda datasets: value_error(datasets, "monte-carlo")),
        *(
            Number(f"value of group {group} in the end", expected, error, _group(group))
            for group, expected, error in (
                (1, -0.82422, 5.7e-4),
                (2, -0.65256, 1.3e-3),
                (10, 0.82306, 5.3e-4),
            )
        ),
    ),
    draw=_draw,
)
