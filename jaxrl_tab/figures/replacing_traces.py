"""Replacing against accumulating traces, and first against every visit (Singh and Sutton 1996)."""

import numpy as np

from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.figures.bias_variance import EPISODES, error, walked
from jaxrl_tab.figures.figure import Figure, Number, swept

ALPHAS = (0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
LAMBDAS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)
TRACES = ("accumulating", "replacing")
STAYS = 0.8  # the probability of one more step in the loop; each step pays 1
VALUE = 1 / (1 - STAYS)
VISITS = {"every visit": False, "first visit": True}
LOOPS = 50  # episodes of the loop


def _experiment(num_seeds=100, num_episodes=EPISODES, lambdas=LAMBDAS, alphas=ALPHAS, num_loops=4000):
    grid = {"lam": list(lambdas), "alpha": list(alphas)}
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes}
    loop = FiniteMDP(
        [[[STAYS, 1 - STAYS]], [[0, 1]]], [[1.0], [0.0]], terminal=[1], start=[1, 0], max_steps=500
    )

    def visited(first):
        runs = {"num_seeds": num_loops, "num_episodes": LOOPS}
        return swept(loop, "monte-carlo-prediction", {"first_visit": first}, **runs, record=_of_the_loop)

    return {trace: walked("td-lambda", {**grid, "trace": trace}, **budget) for trace in TRACES} | {
        name: visited(first) for name, first in VISITS.items()
    }


def _of_the_loop(learner):
    return {"v": learner.q[0, 0]}


def _bias(name, episodes):
    return lambda datasets: datasets[name].v.isel(row=episodes - 1) - VALUE


def _squared(name, episodes):
    return lambda datasets: _bias(name, episodes)(datasets) ** 2


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    walk, loop = canvas.subplots(1, 2)
    lambdas = datasets[TRACES[0]].lam.values
    at = np.arange(len(lambdas))
    for trace, color, marker in zip(TRACES, plot.COLORS, plot.MARKERS, strict=False):
        mean = datasets[trace].rms.mean("row", skipna=False)
        best = mean.mean("seed", skipna=False).fillna(np.inf).argmin("alpha")
        plot.mean_curve(walk, at, mean.isel(alpha=best).rename(lam="row"), trace, color, marker=marker)
    walk.set_xticks(at, [f"{lam:g}" for lam in lambdas])
    plot.tidy(walk, "λ, each with its best step size α", f"RMS error, first {EPISODES} episodes")
    walk.set_title("TD(λ) on the random walk", fontsize=plot.TYPE)
    for (name, color), dash in zip(zip(VISITS, plot.COLORS, strict=False), plot.DASHES, strict=False):
        v = datasets[name].v
        plot.mean_curve(loop, 1 + v.row, (v - VALUE) ** 2, name, color, ls=dash)
    plot.tidy(loop, "episodes", "mean squared error")
    loop.set(xscale="log", yscale="log")
    loop.set_title(f"Monte Carlo in a loop, left with probability {1 - STAYS:.1f}", fontsize=plot.TYPE)
    for ax in (walk, loop):
        plot.legend(ax)
    seeds = " and ".join(
        str(datasets[name].sizes["seed"]) for name in (TRACES[0], *VISITS) if name != "every visit"
    )
    plot.head(canvas, f"A state that comes again: mean and pointwise 95% interval over {seeds} seeds")
    return canvas


FIGURE = Figure(
    title="Replacing traces, and first visits",
    source="Singh and Sutton 1996, Reinforcement learning with replacing eligibility traces",
    shows="Where states come again, replacing traces learn better than accumulating ones, the more so the larger λ is. "
    "With λ = 1 they stand for the first visit, as accumulating ones do for every visit, which is biased, and has the "
    "smaller error after few episodes, the larger one after many.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 2, "lambdas": (0.8, 0.9), "alphas": (0.3, 0.5), "num_loops": 9},
    numbers=(
        # By plain loops over 20 000 seeds (the second: 100 000).
        Number("accumulating, λ = 0.6, α = 0.5", 0.25842, 3.3e-4, error(TRACES[0], lam=0.6, alpha=0.5)),
        Number("accumulating, λ = 0.8, α = 0.3", 0.26244, 1.6e-4, error(TRACES[0], lam=0.8, alpha=0.3)),
        Number("accumulating, λ = 1, α = 0.025", 0.51435, 5.6e-4, error(TRACES[0], lam=1.0, alpha=0.025)),
        Number("replacing, λ = 0.8, α = 0.5", 0.24885, 4.0e-4, error(TRACES[1], lam=0.8, alpha=0.5)),
        Number("replacing, λ = 0.95, α = 0.3", 0.27933, 3.9e-4, error(TRACES[1], lam=0.95, alpha=0.3)),
        Number("replacing, λ = 1, α = 0.25", 0.36924, 5.1e-4, error(TRACES[1], lam=1.0, alpha=0.25)),
        # Exact, with p the probability to stay, after n episodes: the bias of every visit is -p / ((1 - p) (n + 1)),
        # which is 2 / (n + 1) of what it is after the first (the paper's theorem), that of the first visit 0; the mean
        # squared error of the first is p / ((1 - p)^2 n), and of every visit what a sum over all lengths gives.
        Number("every visit: bias after 1 episode", -2, 0, _bias("every visit", 1)),
        Number("every visit: bias after 10", -4 / 11, 0, _bias("every visit", 10)),
        Number("first visit: bias after 10", 0, 0, _bias("first visit", 10)),
        Number("every visit: mean squared error after 1", 9, 0, _squared("every visit", 1)),
        Number("first visit: mean squared error after 1", 20, 0, _squared("first visit", 1)),
        Number("every visit: mean squared error after 50", 0.670601, 0, _squared("every visit", 50)),
        Number("first visit: mean squared error after 50", 0.4, 0, _squared("first visit", 50)),
    ),
    draw=_draw,
)
