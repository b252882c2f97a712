"""Regret of exploring by chance, and by upper bounds (Jin and others 2018; Azar, Osband and Munos 2017)."""

import numpy as np

from jaxrl_tab.envs import FiniteHorizon, RiverSwim
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

HORIZON, EPISODES, EVERY = 20, 5000, 50
RIVER = FiniteHorizon(RiverSwim(variant="osband"), HORIZON)
# The factor of the bonus, in practice and in theory.
UCB, UCBVI = (0.01, 1.0), (0.03, 7.0)


def _experiment(num_seeds=30, num_episodes=EPISODES):
    grids = {
        "q-learning": {"alpha": 0.1, "epsilon": 0.1},
        "ucb-q-learning": {"c": list(UCB)},
        "ucbvi": {"c": list(UCBVI), "stationary": True},
    }
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes, "log_every": EVERY}
    return {method: swept(RIVER, method, grid, **budget) for method, grid in grids.items()}


def _best():
    return planning.start_value(RIVER, planning.value_iteration(RIVER)[0])


def _regret(ds):
    """What the best policy earns in all episodes until the end of a row more than was earned, [..., seed, row]."""
    return (EVERY * _best() - ds.returns.astype(float)).cumsum("row")


def _in_all(method, c=None):
    """The regret of each seed in all episodes."""
    return lambda datasets: _at(datasets, method, c).isel(row=-1)


def _growth(method, c=None):
    """How many times larger the regret of each seed is than after half of the episodes."""

    def of(datasets):
        regret = _at(datasets, method, c)
        return regret.isel(row=-1) / regret.isel(row=regret.sizes["row"] // 2 - 1)

    return of


def _at(datasets, method, c):
    regret = _regret(datasets[method])
    return regret if c is None else regret.sel(c=c)


def _draw(datasets):
    from jaxrl_tab.show import plot

    lines = {
        "Q-learning, ε = 0.1": ("q-learning", None, 0, "-"),
        "UCB Q-learning, c = 1": ("ucb-q-learning", UCB[1], 1, "--"),
        "UCBVI, c = 7": ("ucbvi", UCBVI[1], 2, ":"),
        "UCB Q-learning, c = 0.01": ("ucb-q-learning", UCB[0], 1, "-"),
        "UCBVI, c = 0.03": ("ucbvi", UCBVI[0], 2, "-"),
    }
    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    episodes = EVERY * (np.arange(datasets["ucbvi"].sizes["row"]) + 1)
    for name, (method, c, color, style) in lines.items():
        plot.mean_curve(ax, episodes, _at(datasets, method, c), name, plot.COLORS[color], ls=style)
    middle = episodes[len(episodes) // 3]
    for power, name, beside in ((1, "∝ k", (-16, 4)), (0.5, "∝ √k", (0, -14))):
        ax.plot(episodes, 7 * episodes**power, color=plot.INK, lw=0.8)
        ax.annotate(name, (middle, 7 * middle**power), beside, textcoords="offset points")
    plot.tidy(ax, "episodes k", "regret in all of them")
    ax.set(xscale="log", yscale="log", xlim=(EVERY, episodes[-1]))
    plot.legend(ax)
    seeds = datasets["ucbvi"].sizes["seed"]
    plot.head(canvas, f"River swim of {HORIZON} steps: what is earned less than the best", seeds)
    return canvas


FIGURE = Figure(
    title="Regret of exploring by chance, and by upper bounds",
    source="Jin, Allen-Zhu, Bubeck and Jordan 2018; Azar, Osband and Munos 2017: without a figure, of bounds alone",
    shows="Who explores by chance hardly comes up the river: nearly all that the best policy earns is lost, episode by "
    "episode, and the regret is a straight line. With upper bounds it grows no faster than the root of the number of "
    "episodes. But within 5000 of them it does so only where the bonus is a hundredth of that with which the guarantee "
    "is proved, or less: with that one, everything is still new to the method.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 200},
    numbers=(
        # By backward induction in a plain loop.
        Number("best, an episode", 3.3972640, EXACT, lambda datasets: _best()),
        # From plain loops of their own, with 200 to 600 runs.
        Number("Q-learning, ε = 0.1: regret in 5000 episodes", 16531.24, 0.16, _in_all("q-learning")),
        Number("UCB Q-learning, c = 0.01: the same", 4249.1, 9.3, _in_all("ucb-q-learning", UCB[0])),
        Number("UCB Q-learning, c = 1: the same", 16766.7, 7.9, _in_all("ucb-q-learning", UCB[1])),
        Number("UCBVI, c = 0.03: the same", 1247.9, 8.0, _in_all("ucbvi", UCBVI[0])),
        Number("UCBVI, c = 7: the same", 16767.4, 0.9, _in_all("ucbvi", UCBVI[1])),
        # With twice the episodes √2 where it grows like the root, and 2 where it is a straight line.
        Number(
            "UCB Q-learning, c = 0.01: growth from 2500 on", 1.2830, 0.0022, _growth("ucb-q-learning", UCB[0])
        ),
        Number("UCBVI, c = 0.03: growth from 2500 on", 1.285, 0.0061, _growth("ucbvi", UCBVI[0])),
    ),
    draw=_draw,
)
