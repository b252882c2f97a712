"""Learning curves of semi-gradient Sarsa on the mountain car (book, figures 10.2 and 10.3)."""

import numpy as np

from jaxrl_tab.approx import SemiGradientNStepSarsa, SemiGradientSarsa
from jaxrl_tab.envs import MountainCar
from jaxrl_tab.figures.figure import Figure, Number, swept

FEATURES = "tile-coding(8, 8)"
GREEDY = {"features": FEATURES, "per_tiling": True, "epsilon": 0.0}
ALPHAS, N, ALPHA_OF_N = (0.1, 0.2, 0.5), 8, 0.3
ONE_STEP, N_STEP = "Sarsa", f"{N}-step Sarsa"
EPISODES = 500


def _experiment(num_seeds=100, num_episodes=EPISODES):
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes}
    one, many = GREEDY | {"alpha": list(ALPHAS)}, GREEDY | {"alpha": [ALPHA_OF_N]}
    return {
        ONE_STEP: swept(MountainCar(), SemiGradientSarsa, one, **budget),
        N_STEP: swept(MountainCar(), SemiGradientNStepSarsa, many | {"n": N}, **budget),
    }


def _length(name, alpha, first, last):
    """The mean length of episodes `first` to `last`, of each seed."""
    return lambda datasets: (
        datasets[name].lengths.sel(alpha=alpha).isel(row=slice(first - 1, last)).mean("row")
    )


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    by_alpha, by_n = canvas.subplots(1, 2, sharey=True)

    def curve(ax, name, alpha, color, dash="-"):
        lengths = datasets[name].lengths.sel(alpha=alpha)
        at = np.arange(1, lengths.sizes["row"] + 1)
        plot.mean_curve(ax, at, lengths, f"{name}, α = {alpha:g}/8", color, ls=dash, lw=1)

    for alpha, color in zip(ALPHAS, plot.COLORS, strict=False):
        curve(by_alpha, ONE_STEP, alpha, color)
    curve(by_n, ONE_STEP, ALPHAS[-1], plot.COLORS[2])
    curve(by_n, N_STEP, ALPHA_OF_N, plot.COLORS[3])
    for ax, label in ((by_alpha, "steps of an episode"), (by_n, "")):
        ax.set(yscale="log", ylim=(100, 1000))
        ax.set_yticks([100, 200, 400, 1000], ["100", "200", "400", "1000"])
        ax.minorticks_off()
        plot.tidy(ax, "episode", label)
        plot.legend(ax)
    plot.head(
        canvas, "Mountain car: semi-gradient Sarsa with eight tilings", datasets[ONE_STEP].sizes["seed"]
    )
    return canvas


def _number(name, alpha, first, last, expected, error):
    what = f"{name}, α = {alpha:g}/8: steps of an episode, {first} to {last}"
    return Number(what, expected, error, _length(name, alpha, first, last))


FIGURE = Figure(
    title="Learning to drive up a mountain",
    source="Sutton and Barto 2018, figures 10.2 and 10.3",
    shows="The larger of these step sizes learns faster, and 8-step Sarsa faster still: the weak car must first go "
    "back to go forward, and nothing but −1 a step says so.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 120},
    numbers=(
        # From 1000 runs of a plain loop in float64; the book has curves.
        _number(ONE_STEP, 0.1, 1, 10, 1350.0, 2.0),
        _number(ONE_STEP, 0.1, 91, 110, 206.68, 0.21),
        _number(ONE_STEP, 0.2, 91, 110, 168.19, 0.19),
        _number(ONE_STEP, 0.5, 1, 10, 601.5, 1.4),
        _number(ONE_STEP, 0.5, 91, 110, 141.37, 0.21),
        _number(ONE_STEP, 0.5, 451, 500, 117.36, 0.14),
        _number(N_STEP, ALPHA_OF_N, 1, 10, 584.5, 2.0),
        _number(N_STEP, ALPHA_OF_N, 91, 110, 116.92, 0.52),
    ),
    draw=_draw,
)
