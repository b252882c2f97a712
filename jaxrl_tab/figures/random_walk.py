"""TD(0) and constant-alpha Monte Carlo on the random walk of five states (book, example 6.2)."""

import numpy as np

from jaxrl_tab.algorithms import moments
from jaxrl_tab.algorithms.prediction import TD
from jaxrl_tab.envs import RandomWalk
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

WALK = RandomWalk(states=5, left_reward=0.0)
STATES = "ABCDE"
V0, EPISODES = 0.5, 100
ALPHAS = {"td": (0.15, 0.1, 0.05), "monte-carlo-prediction": (0.01, 0.02, 0.03, 0.04)}
NAMES = {"td": "TD", "monte-carlo-prediction": "MC"}
SHOWN, SHOWN_ALPHA = (0, 1, 10, 100), 0.1  # after how many episodes values are drawn, and of which run


def _experiment(num_seeds=200):
    def run(method):
        grid = {"alpha": list(ALPHAS[method]), "v0": V0}
        budget = {"num_seeds": num_seeds, "num_episodes": EPISODES, "exact": True}
        return swept(WALK, method, grid, **budget, record=_values)

    return {method: run(method) for method in ALPHAS}


def _values(learner):
    return {"values": learner.v}


def _error(method, alpha, episodes):
    """The RMS error over the states after so many episodes, of each seed."""
    return lambda datasets: datasets[method].v_error.sel(alpha=alpha).isel(row=episodes - 1)


def _mean_of_a(datasets):
    """The expected V(A) after the first episode, exactly: A is where it ends at the left, half of the time."""
    curve = moments.learning_curve(WALK, TD(v0=V0, alpha=SHOWN_ALPHA), num_episodes=1)
    return curve.mean[1, 0]


def _better(datasets):
    """By how much the best of TD's errors after 100 episodes is below the best of Monte Carlo's."""
    best = {method: ds.v_error.isel(row=-1).mean("seed").min() for method, ds in datasets.items()}
    return float(best["monte-carlo-prediction"] - best["td"])


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.8)
    left, right = canvas.subplots(1, 2, width_ratios=(1, 1.25))
    learned = datasets["td"]["values"].sel(alpha=SHOWN_ALPHA).isel(seed=0).values[:, 1:-1]
    places = np.arange(len(STATES))
    left.plot(places, (places + 1) / 6, color=plot.INK, ls=":", lw=1.4, marker="o", ms=3, label="true values")
    for episodes, color, marker in zip(SHOWN, (plot.GREY, *plot.COLORS), plot.MARKERS, strict=False):
        v = learned[episodes - 1] if episodes else np.full(len(STATES), V0)
        left.plot(places, v, color=color, marker=marker, ms=4, lw=1.2, label=f"after {episodes}")
    left.set_xticks(places, STATES)
    plot.tidy(left, "state", "estimated value")
    left.set_ylim(0, 1)
    plot.axes_title(left, f"TD(0), one run, α = {SHOWN_ALPHA:g}")
    plot.legend(left, loc="upper left", bbox_to_anchor=(0, 1), ncols=1)
    for method, color in zip(ALPHAS, plot.COLORS, strict=False):
        for alpha, dash in zip(ALPHAS[method], ("-", "--", "-.", ":"), strict=False):
            error = datasets[method].v_error.sel(alpha=alpha)
            episodes = np.arange(1, EPISODES + 1)
            plot.mean_curve(right, episodes, error, f"{NAMES[method]}, α = {alpha:g}", color, ls=dash, lw=1.4)
    plot.tidy(right, "episodes", "RMS error over states")
    right.set(xlim=(0, EPISODES), ylim=(0, 0.25))
    plot.legend(right, ncols=3)
    plot.head(canvas, "Random walk of five states", datasets["td"].sizes["seed"])
    return canvas


def _after(method, alpha, episodes, expected, error):
    name = NAMES[method]
    what = f"{name}, α = {alpha:g}: RMS error after {episodes} episodes"
    return Number(what, expected, error, _error(method, alpha, episodes))


FIGURE = Figure(
    title="TD(0) beside Monte Carlo on the random walk of five states",
    source="Sutton and Barto 2018, example 6.2",
    shows="At every step size that was tried TD is below Monte Carlo soon, and its best is below all of Monte Carlo's. "
    "After one episode only the state has changed from which it ended: A or E.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # From 100 000 runs of a plain loop; the book has curves.
        _after("td", 0.05, 100, 0.035266, 5.2e-5),
        _after("td", 0.1, 25, 0.056643, 6.7e-5),
        _after("td", 0.1, 100, 0.055267, 7.3e-5),
        _after("td", 0.15, 10, 0.094930, 5.5e-5),
        _after("monte-carlo-prediction", 0.01, 100, 0.097089, 7.3e-5),
        _after("monte-carlo-prediction", 0.02, 100, 0.081898, 1.24e-4),
        _after("monte-carlo-prediction", 0.03, 50, 0.104734, 1.49e-4),
        _after("monte-carlo-prediction", 0.04, 100, 0.107282, 1.71e-4),
        # By hand: with 1/2 it ends at the left, and V(A) becomes 0.5 + 0.1 (0 - 0.5).
        Number("expected V(A) after one episode, α = 0.1, exactly", 0.475, EXACT, _mean_of_a),
        Number("after 100 episodes: the best of TD's is lower by", 0.03, 0, _better, "at least"),
    ),
    draw=_draw,
)
