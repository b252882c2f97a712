"""How often to improve the policy: Monte Carlo control in batches of episodes (Silver, lecture 5)."""

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.envs import Blackjack
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

EPSILON = 0.1
EPISODES, EVERY = 2000, 250
BATCHES = (1, 10, 100, 1000)  # episodes between improvements
AT_RANDOM = BATCHES[-1]  # episodes: as many as the largest batch has before its first improvement


@pytree
class AtRandomFirst:
    """An exploration rate of 1 in so many episodes, and of EPSILON from then on."""

    episodes: Any
    clock: ClassVar = "episode"

    def __call__(self, n):
        return jnp.where(n > self.episodes, EPSILON, 1.0)


def _experiment(num_seeds=200):
    """A run for each batch. That of 1 also comes with a beginning at random, as the second value of epsilon."""
    budget = {"num_seeds": num_seeds, "num_episodes": EPISODES, "log_every": EVERY, "exact": True}
    rates = [AtRandomFirst(0), AtRandomFirst(AT_RANDOM)]

    def run(batch):
        grid = {"batch": batch, "epsilon": rates if batch == 1 else EPSILON}
        return swept(Blackjack(), "monte-carlo", grid, **budget)

    return {f"batch-{batch}": run(batch) for batch in BATCHES}


def _run(datasets, batch, at_random=False):
    ds = datasets[f"batch-{batch}"]
    return ds.isel(epsilon=int(at_random)) if batch == 1 else ds


def _learned(*run):
    """The exact value of each seed's greedy policy at the end."""
    return lambda datasets: _run(datasets, *run).greedy_value.isel(row=-1)


def _earned(*run):
    """The mean return of all episodes of each seed."""
    return lambda datasets: _run(datasets, *run).returns.sum("row") / EPISODES


def optimal_value(datasets):
    return planning.start_value(Blackjack(), planning.value_iteration(Blackjack())[0])


def _draw(datasets):
    from jaxrl_tab.show import plot

    names = {1: "each episode", **{batch: f"every {batch}" for batch in BATCHES[1:]}}
    curves = [(name, _run(datasets, batch)) for batch, name in names.items()]
    curves.append((f"each, the first {AT_RANDOM} at random", _run(datasets, 1, True)))
    # The last two lie on each other: a broad line, and one within it.
    looks = [{"ls": dash} for dash in plot.DASHES[:3]] + [{"lw": 4.5}, {"ls": "--", "lw": 1.2}]
    colors = (*plot.COLORS[: len(BATCHES)], plot.INK)
    canvas = plot.canvas(plot.WIDTH)
    learned, earned = canvas.subplots(1, 2)
    for (name, ds), look, color in zip(curves, looks, colors, strict=True):
        episodes = EVERY * (ds.row + 1)
        plot.mean_curve(learned, episodes, ds.greedy_value, name, color, **look)
        plot.mean_curve(earned, episodes, ds.returns / ds.episodes, name, color, **look)
    plot.exact_line(learned, optimal_value(datasets), "exact optimum", ls=":", lw=1)
    plot.tidy(learned, "episodes", "exact value, greedy policy")
    plot.tidy(earned, "episodes", f"mean return, last {EVERY}")
    learned.set_ylim(top=-0.03)
    for ax in (learned, earned):
        ax.set_xlim(left=0)
        plot.legend(ax)
    seeds = curves[0][1].sizes["seed"]
    plot.head(canvas, f"Blackjack, Monte Carlo, step 1/N, ε = {EPSILON}: the policy is improved after", seeds)
    return canvas


FIGURE = Figure(
    title="How often to improve the policy",
    source="Silver, lecture 5, Monte Carlo control; Sutton and Barto 2018, section 5.3",
    shows="The lecture improves the policy after each episode. Here, after 2000, the greedy policy is better where it "
    "waited for 1000, but not because it was evaluated better: until its first improvement it acts at random, and "
    "where each episode improves the policy after such a beginning, it learns as much. What is earned meanwhile is "
    "with the lecture.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # The optimum by enumeration; the others from 40 000 runs of a plain loop each.
        Number("optimal value from the start", -0.046556, EXACT, optimal_value),
        Number("each episode: value of the greedy policy at the end", -0.107094, 0.000060, _learned(1)),
        Number("every 10: value at the end", -0.106870, 0.000060, _learned(10)),
        Number("every 100: value at the end", -0.105002, 0.000057, _learned(100)),
        Number("every 1000: value at the end", -0.095838, 0.000038, _learned(1000)),
        Number("each, the first 1000 at random: value at the end", -0.095720, 0.000038, _learned(1, True)),
        Number("each episode: mean return of all 2000", -0.160810, 0.000119, _earned(1)),
        Number("every 100: mean return", -0.165445, 0.000117, _earned(100)),
        Number("every 1000: mean return", -0.260344, 0.000105, _earned(1000)),
    ),
    draw=_draw,
)
