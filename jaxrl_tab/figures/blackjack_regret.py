"""Blackjack: how fast exploration may fade (Silver, lecture 5, GLIE Monte Carlo control)."""

from typing import Any

import numpy as np

from jaxrl_tab.core.policies import EpsilonGreedy
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.schedules import Harmonic, glie
from jaxrl_tab.envs import Blackjack
from jaxrl_tab.figures.figure import Figure, Number, swept

N0 = "100 / (100 + N(s))"
EPSILONS = {"1/k": glie(), "0.1": 0.1, N0: Harmonic(100.0, clock="visit")}
SHORT, LONG = 500_000, 2_000_000  # episodes


@pytree
class OneOf:
    """The policy among `policies` whose weight is 1; the other weights are 0.

    Schedules of different kinds make different programs. Here the choice among them is a number, so their
    runs are lanes of one program, side by side.
    """

    weights: Any
    policies: tuple[EpsilonGreedy, ...]

    @property
    def by_visit(self):
        return any(policy.by_visit for policy in self.policies)

    def check(self, num_states, num_actions):
        for policy in self.policies:
            policy.check(num_states, num_actions)

    def probs(self, q, clock, s):
        return sum(w * p.probs(q, clock, s) for w, p in zip(self.weights, self.policies, strict=True))


def _experiment(num_seeds=20, budgets=((50_000, 2000), (LONG, 50_000))):
    """The same runs twice: the beginning in short rows, and all of it in long ones.

    `budgets` are episodes in all and in a row.
    """
    policies = tuple(EpsilonGreedy(epsilon) for epsilon in EPSILONS.values())
    choices = [OneOf(tuple(weights), policies) for weights in np.eye(len(policies))]
    return {
        name: _named(
            swept(
                Blackjack(),
                "monte-carlo",
                {"behaviour": choices},
                num_seeds=num_seeds,
                num_episodes=episodes,
                log_every=every,
                exact=True,
            )
        )
        for name, (episodes, every) in zip(("beginning", "whole"), budgets, strict=True)
    }


def _named(run):
    """The run with its schedules by name."""
    return lambda progress: run(progress).rename(behaviour="epsilon").assign_coords(epsilon=list(EPSILONS))


def _regret(datasets):
    """v* - v of each seed's greedy policy, by the number of episodes it had, [epsilon, seed, episodes]."""
    import xarray as xr

    def of(ds):
        row = np.minimum(ds.attrs["log_every"] * (ds.row.values + 1), ds.attrs["num_episodes"])
        value = ds.greedy_value.astype(float).assign_coords(row=row).rename(row="episodes")
        return ds.attrs["optimal_value"] - value

    beginning, whole = of(datasets["beginning"]), of(datasets["whole"])
    later = whole.sel(episodes=whole.episodes > beginning.episodes[-1])
    return xr.concat([beginning, later], "episodes")


def _after(episodes, epsilon):
    """The regret of each seed after so many episodes."""
    return lambda datasets: _regret(datasets).sel(epsilon=epsilon).sel(episodes=episodes, method="nearest")


def _worst(datasets):
    return _after(LONG, "0.1")(datasets).max()


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    regret = _regret(datasets)
    for epsilon, color in zip(EPSILONS, plot.COLORS, strict=False):
        of_seeds = regret.sel(epsilon=epsilon).transpose("episodes", "seed")
        ax.plot(regret.episodes, of_seeds, color=color, lw=0.6, alpha=0.25)
        ax.plot(regret.episodes, of_seeds.mean("seed"), color=color, lw=2.5, label=f"ε = {epsilon}")
    plot.tidy(ax, "episodes k", "exact regret of the greedy policy, v* − v")
    ax.set(xscale="log", yscale="log", ylim=(1e-4, 0.2))
    seeds = regret.sizes["seed"]
    plot.head(canvas, f"Blackjack, every-visit Monte Carlo, step 1/N\n{seeds} seeds and their mean")
    plot.legend(ax)
    return canvas


FIGURE = Figure(
    title="Blackjack: exploration that fades too fast",
    source="Silver, lecture 5, GLIE Monte Carlo control",
    shows="With ε = 1/k, which is GLIE, hardly anything is learned after the first thousand games. With a "
    "constant 0.1 the greedy policy comes within a thousandth of the optimum; where ε falls with the "
    "visits of a state it is near it sooner, and behind in the end.",
    experiment=_experiment,
    small={"num_seeds": 2, "budgets": ((20, 10), (40, 20))},
    numbers=(
        # From a plain loop, the means over 360 seeds and more; with 0.1 the worst of 400 stood at 0.0030.
        Number("ε = 0.1: worst regret of any seed after 2 million episodes", 0.005, 0, _worst, "at most"),
        Number("ε = 0.1: mean regret after 2 million episodes", 0.00085, 0.00002, _after(LONG, "0.1")),
        Number("ε = 1/k: mean regret after 500 000 episodes", 0.0640, 0.0008, _after(SHORT, "1/k")),
        Number("ε = 1/k: mean regret after 2 million episodes", 0.0637, 0.0008, _after(LONG, "1/k")),
        Number(
            "ε = 100/(100 + N(s)): mean regret after 2 million episodes", 0.0038, 0.0001, _after(LONG, N0)
        ),
    ),
    draw=_draw,
)
