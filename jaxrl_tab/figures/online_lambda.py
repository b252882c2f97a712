"""Learning on the way, by traces, against the off-line lambda-return (book, figures 12.6 and 12.8)."""

from jaxrl_tab.figures.bias_variance import ALPHAS, EPISODES, LAMBDAS, curves, error, head, walked
from jaxrl_tab.figures.figure import Figure, Number

METHODS = {
    "td-lambda": "TD(λ)",
    "true-online-td-lambda": "True online TD(λ)",
    "offline-lambda-return": "Off-line λ-return",
}
TRACES, TRUE, OFFLINE = METHODS


def _experiment(num_seeds=100, num_episodes=EPISODES, lambdas=LAMBDAS, alphas=ALPHAS):
    grid = {"lam": list(lambdas), "alpha": list(alphas)}
    return {name: walked(name, grid, num_seeds=num_seeds, num_episodes=num_episodes) for name in METHODS}


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    *axes, last = canvas.subplots(2, 2, sharex=True, sharey=True).ravel()
    for ax, (name, title) in zip(axes, METHODS.items(), strict=True):
        curves(ax, datasets[name].rms, "lam", "λ")
        ax.set_title(title, fontsize=plot.TYPE)
    last.axis("off")  # the fourth place tells the curves apart, which are the same in all pictures
    last.legend(*axes[0].get_legend_handles_labels(), loc="center", frameon=False, fontsize=plot.TYPE)
    head(canvas, datasets[TRACES].rms)
    return canvas


FIGURE = Figure(
    title="Traces against the λ-return that they stand for",
    source="Sutton and Barto 2018, figures 12.6 and 12.8; van Seijen and Sutton 2014",
    shows="At its best TD(λ) learns as well as the off-line λ-return, but only with smaller step sizes. True online "
    "TD(λ), which is the λ-return as far as the episode has come, is better than both, and bears larger ones.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 2, "lambdas": (0.8, 0.9), "alphas": ALPHAS[4:12]},
    numbers=(
        # Mean RMS error over the first ten episodes, from plain loops over 100 000 seeds; the last three over 20 000.
        Number("TD(0.8), α = 0.3", 0.26244, 1.6e-4, error(TRACES, lam=0.8, alpha=0.3)),
        Number("true online TD(0.8), α = 0.4", 0.25445, 1.7e-4, error(TRUE, lam=0.8, alpha=0.4)),
        Number("off-line λ-return, λ = 0.8, α = 0.4", 0.26199, 3.8e-4, error(OFFLINE, lam=0.8, alpha=0.4)),
        Number("TD(0.95), α = 0.1", 0.33472, 3.2e-4, error(TRACES, lam=0.95, alpha=0.1)),
        Number("true online TD(0.95), α = 0.2", 0.31456, 4.3e-4, error(TRUE, lam=0.95, alpha=0.2)),
    ),
    draw=_draw,
)
