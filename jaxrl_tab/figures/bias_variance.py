"""The two knobs between bootstrapping and whole returns, n and lambda, on the random walk (book, figures 7.2, 12.3)."""

import jax.numpy as jnp
import numpy as np

from jaxrl_tab.envs import RandomWalk
from jaxrl_tab.figures.figure import Figure, Number, swept

WALK = RandomWalk(max_steps=2000)  # which no episode in 10^11 lasts, and so little is remembered quickly
NS = tuple(2**k for k in range(10))
LAMBDAS = (0.0, 0.4, 0.8, 0.9, 0.95, 0.975, 0.99, 1.0)
ALPHAS = (0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
EPISODES = 10
BOTTOM, TOP = 0.23, 0.57  # of the picture; above it some settings diverge
METHODS = {"n-step-td": ("n-step TD", "n", "n"), "offline-lambda-return": ("Off-line λ-return", "lam", "λ")}


def _experiment(num_seeds=100, num_episodes=EPISODES, ns=NS, lambdas=LAMBDAS, alphas=ALPHAS):
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes}
    return {
        "n-step-td": walked("n-step-td", {"n": list(ns), "alpha": list(alphas)}, **budget),
        "offline-lambda-return": walked(
            "offline-lambda-return", {"lam": list(lambdas), "alpha": list(alphas)}, **budget
        ),
    }


def walked(method, grid, **budget):
    """A sweep on the walk that records the RMS error of V over its 19 states."""
    return swept(WALK, method, grid, **budget, record=rms_error)


def rms_error(learner):
    """The root of the mean over states of (V - v_pi)^2."""
    size = learner.q.shape[0]
    truth = jnp.asarray(2 * np.arange(size) / (size - 1) - 1, learner.q.dtype)
    return {"rms": jnp.sqrt(((learner.q[:, 0] - truth)[1:-1] ** 2).mean())}


def error(method, **setting):
    """The RMS error over the states, averaged over the ends of the episodes, of each seed."""
    return lambda datasets: datasets[method].rms.sel(setting).mean("row")


def curves(ax, rms, knob, symbol):
    """The error against alpha, a curve for each value of the knob."""
    import matplotlib as mpl

    from jaxrl_tab import stats
    from jaxrl_tab.show import plot

    colors = mpl.colormaps["viridis"](np.linspace(0, 0.93, rms.sizes[knob]))
    for value, color, marker in zip(rms[knob].values, colors, plot.MARKERS * 2, strict=False):
        mean, low, high, _ = stats.mean_interval(rms.sel({knob: value}).mean("row", skipna=False))
        ax.plot(rms.alpha, mean, color=color, marker=marker, ms=3.5, lw=1.4, label=f"{symbol} = {value:g}")
        ax.fill_between(rms.alpha, low, high, where=(mean < TOP).values, color=color, alpha=0.18, lw=0)
    plot.tidy(ax, "step size α", "RMS error")
    ax.tick_params(labelbottom=True, labelleft=True)
    ax.set(ylim=(BOTTOM, TOP), xlim=(0, 1.02))


def head(canvas, rms):
    from jaxrl_tab.show import plot

    what = f"RMS error over states and the first {rms.sizes['row']} episodes"
    plot.head(canvas, f"Random walk, 19 states: {what}", rms.sizes["seed"])


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    axes = canvas.subplots(1, 2, sharex=True, sharey=True)
    for ax, (name, (title, knob, symbol)) in zip(axes, METHODS.items(), strict=True):
        curves(ax, datasets[name].rms, knob, symbol)
        ax.set_title(title, fontsize=plot.TYPE)
        plot.legend(ax)
    head(canvas, datasets["n-step-td"].rms)
    return canvas


FIGURE = Figure(
    title="The bias-variance knobs n and λ on the random walk",
    source="Sutton and Barto 2018, figures 7.2 and 12.3",
    shows="Between one-step bootstrapping and whole returns lies a best n, and a best λ. The larger they are, the "
    "smaller is the best step size. Mixed by λ, at the end of each episode, returns are about as good as by the best "
    "n, and bear larger step sizes.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 2, "ns": (1, 2), "lambdas": (0.8, 0.9), "alphas": ALPHAS[4:12]},
    numbers=(
        # Mean RMS error over the first ten episodes, from plain loops: the first three over 1 200 000 seeds, the
        # others over 40 000 and, of λ, 20 000.
        Number("1-step TD, α = 0.8", 0.34518, 4e-5, error("n-step-td", n=1, alpha=0.8)),
        Number("2-step TD, α = 0.6", 0.27683, 4e-5, error("n-step-td", n=2, alpha=0.6)),
        Number("8-step TD, α = 0.25", 0.27650, 5e-5, error("n-step-td", n=8, alpha=0.25)),
        Number("4-step TD, α = 0.4", 0.26338, 2.4e-4, error("n-step-td", n=4, alpha=0.4)),
        Number("64-step TD, α = 0.1", 0.44624, 3.3e-4, error("n-step-td", n=64, alpha=0.1)),
        Number("512-step TD, α = 0.05", 0.50832, 4.2e-4, error("n-step-td", n=512, alpha=0.05)),
        Number(
            "λ-return, λ = 0.4, α = 0.5", 0.31982, 1.5e-4, error("offline-lambda-return", lam=0.4, alpha=0.5)
        ),
        Number(
            "λ-return, λ = 0.8, α = 0.4", 0.26199, 3.8e-4, error("offline-lambda-return", lam=0.8, alpha=0.4)
        ),
        Number(
            "λ-return, λ = 0.95, α = 0.1",
            0.33632,
            2.9e-4,
            error("offline-lambda-return", lam=0.95, alpha=0.1),
        ),
        Number(
            "λ-return, λ = 1, α = 0.05", 0.50847, 5.9e-4, error("offline-lambda-return", lam=1.0, alpha=0.05)
        ),
    ),
    draw=_draw,
)
