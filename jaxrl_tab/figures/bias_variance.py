"""The two knobs between bootstrapping and whole returns, n and lambda, on the random walk."""

import numpy as np

from jaxrl_tab.envs import RandomWalk
from jaxrl_tab.figures.figure import Figure, Number, swept

NS = (1, 2, 4, 8, 16)
LAMBDAS = (0.0, 0.4, 0.8, 0.9, 0.95, 0.975, 1.0)
TRACES = {"accumulating": "TD(λ)", "dutch": "True online TD(λ)"}
ALPHAS = (0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
EPISODES = 10
TOP = 0.57  # of the picture; above it some settings diverge


def _experiment(num_seeds=100, num_episodes=EPISODES, ns=NS, lambdas=LAMBDAS, alphas=ALPHAS):
    walk, budget = RandomWalk(), {"num_seeds": num_seeds, "num_episodes": num_episodes, "exact": True}
    by_n = {"n": list(ns), "alpha": list(alphas)}
    by_lambda = {"trace": list(TRACES), "lam": list(lambdas), "alpha": list(alphas)}
    return {
        "n-step-td": swept(walk, "n-step-td", by_n, **budget),
        "td-lambda": swept(walk, "td-lambda", by_lambda, **budget),
    }


def _error(method, **setting):
    """The RMS error over the states, averaged over the ends of the episodes, of each seed."""
    return lambda datasets: datasets[method].v_error.sel(setting).mean("row")


def _draw(datasets):
    from matplotlib.legend import Legend

    from jaxrl_tab.show import plot

    by_n, by_lambda = datasets["n-step-td"].v_error, datasets["td-lambda"].v_error
    canvas = plot.canvas(plot.WIDTH)
    (first, second), (third, last) = canvas.subplots(2, 2, sharex=True, sharey=True)
    panels = {"n-step TD": (first, by_n, "n", "n")}
    for ax, (trace, title) in zip((second, third), TRACES.items(), strict=True):
        panels[title] = ax, by_lambda.sel(trace=trace), "lam", "λ"
    for title, (ax, error, knob, symbol) in panels.items():
        _curves(ax, error, knob, symbol)
        ax.set_title(title, fontsize=plot.TYPE)
    first.set(ylim=(0.23, TOP), xlim=(0, 1.02))
    last.axis("off")
    # The fourth place tells the curves apart: those of n, and those of λ, which are the same in two pictures.
    for ax, place in ((first, 0.3), (second, 0.7)):
        handles, labels = ax.get_legend_handles_labels()
        at = {"loc": "upper center", "bbox_to_anchor": (place, 0.9)}
        last.add_artist(Legend(last, handles, labels, **at, frameon=False, fontsize=plot.TYPE))
    what = f"RMS error over states and the first {by_n.sizes['row']} episodes"
    plot.head(canvas, f"Random walk, 19 states: {what}", by_n.sizes["seed"])
    return canvas


def _curves(ax, error, knob, symbol):
    """The error against alpha, a curve for each value of the knob."""
    import matplotlib as mpl

    from jaxrl_tab import stats
    from jaxrl_tab.show import plot

    colors = mpl.colormaps["viridis"](np.linspace(0, 0.93, error.sizes[knob]))
    for value, color, marker in zip(error[knob].values, colors, plot.MARKERS * 2, strict=False):
        mean, low, high, _ = stats.mean_interval(error.sel({knob: value}).mean("row", skipna=False))
        ax.plot(error.alpha, mean, color=color, marker=marker, ms=3.5, lw=1.4, label=f"{symbol} = {value:g}")
        ax.fill_between(error.alpha, low, high, where=(mean < TOP).values, color=color, alpha=0.18, lw=0)
    plot.tidy(ax, "step size α", "RMS error")
    ax.tick_params(labelbottom=True, labelleft=True)


FIGURE = Figure(
    title="The bias-variance knobs n and λ on the random walk",
    source="Sutton and Barto 2018, figures 7.2, 12.6 and 12.8",
    shows="Between one-step bootstrapping and whole returns lies a best n, and a best λ. The larger they are, "
    "the smaller is the best step size; true online TD(λ) bears larger ones than TD(λ) does.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 2, "ns": (1, 2, 8), "lambdas": (0.8, 0.9), "alphas": ALPHAS[4:12]},
    numbers=(
        # Mean RMS error over the first ten episodes, from plain loops: the first three over 1 200 000 seeds,
        # the others over 100 000.
        Number("1-step TD, α = 0.8", 0.34518, 4e-5, _error("n-step-td", n=1, alpha=0.8)),
        Number("2-step TD, α = 0.6", 0.27683, 4e-5, _error("n-step-td", n=2, alpha=0.6)),
        Number("8-step TD, α = 0.25", 0.27650, 5e-5, _error("n-step-td", n=8, alpha=0.25)),
        Number(
            "TD(0.8), α = 0.3",
            0.26244,
            1.6e-4,
            _error("td-lambda", trace="accumulating", lam=0.8, alpha=0.3),
        ),
        Number(
            "true online TD(0.8), α = 0.4",
            0.25445,
            1.7e-4,
            _error("td-lambda", trace="dutch", lam=0.8, alpha=0.4),
        ),
    ),
    draw=_draw,
)
