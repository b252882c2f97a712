"""Ordinary and weighted importance sampling, and a case of infinite variance (book, section 5.5)."""

from functools import partial

import numpy as np

from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.envs import Blackjack, InfiniteVariance
from jaxrl_tab.envs.base import FixedStart
from jaxrl_tab.envs.cards import HIT, LIMIT, SHOWN, STICK
from jaxrl_tab.exact import importance, planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

METHOD = "off-policy-monte-carlo-prediction"  # all actions are equally likely to be taken
WEIGHTINGS = ("ordinary", "weighted")
LEFT = np.array([[1.0, 0.0], [1.0, 0.0]])  # the policy that goes left for ever
PATHS = 10  # that are drawn


@pytree
class OneHand(FixedStart, Blackjack):
    """Blackjack that always starts with an ace and a two, which make 13, against a dealer's two."""

    @property
    def start_state(self):
        return self.state(13, dealer=2, usable=True)


HAND = OneHand()
# The memory of an episode is as long as the time limit. 64 steps are reached with a probability of 0.45^64.
LOOP = InfiniteVariance(max_steps=64)


def sticks_on_20():
    """The policy that sticks on 20 or 21 and hits on all else, float [S, A]."""
    pi = np.eye(2)[np.full(HAND.num_states, HIT)]
    for player in (LIMIT - 1, LIMIT):
        for usable in (False, True):
            first = HAND.state(player, 1, usable)
            pi[first : first + SHOWN] = np.eye(2)[STICK]
    return pi


def _experiment(
    num_seeds=256, num_episodes=4000, num_paths=128, path_episodes=50_000, path_every=125, path_beginning=1000
):
    """The paths that are drawn run twice: their beginning in rows of one episode, and all of them in long ones."""

    def run(env, pi, weighting, seeds, episodes, every=1):
        grid = {"pi": Table(pi), "weighting": weighting, "first_visit": True}
        budget = {"num_seeds": seeds, "num_episodes": episodes, "log_every": every}
        return swept(env, METHOD, grid, **budget, record=partial(_estimate, env.start_state))

    loop = {
        "beginning": (min(PATHS, num_paths), path_beginning, 1),
        "loop": (num_paths, path_episodes, path_every),
    }
    hand = {w: run(HAND, sticks_on_20(), w, num_seeds, num_episodes) for w in WEIGHTINGS}
    return hand | {
        f"{name}-{w}": run(LOOP, LEFT, w, *budget) for name, budget in loop.items() for w in WEIGHTINGS
    }


def _estimate(state, learner):
    return {"estimate": learner.v[state]}


def _episodes(ds):
    """How many there were at the end of each row."""
    return ds.attrs["log_every"] * (ds.row + 1)


def value():
    """v_pi of the hand."""
    return planning.evaluate(HAND, sticks_on_20())[HAND.start_state]


def variance():
    """The variances of what importance sampling averages, from the hand."""
    at_random = np.full((HAND.num_states, 2), 0.5)
    of_states = importance.variance(HAND, sticks_on_20(), at_random)
    return type(of_states)(*(x[HAND.start_state] for x in of_states))


def _squared_error(ds):
    return (ds.estimate.astype(float) - value()) ** 2


def _scaled_error(weighting, episodes):
    """The squared error of each seed after so many episodes, times their number."""

    def measure(datasets):
        ds = datasets[weighting]
        row = np.abs(_episodes(ds).values - episodes).argmin()
        return episodes * _squared_error(ds).isel(row=row)

    return measure


def _below(datasets):
    """Whether each run of the loop ends with an estimate that is too low."""
    return datasets["loop-ordinary"].estimate.isel(row=-1) < 1


def _farthest(datasets):
    """How far the weighted estimate of any run of the loop is from 1 at the end."""
    return abs(datasets["loop-weighted"].estimate.isel(row=-1).values - 1).max()


def _paths(datasets, weighting):
    """The estimates of the runs that are drawn, by the number of episodes, [episodes, seed]."""
    import xarray as xr

    def of(name):
        ds = datasets[f"{name}-{weighting}"]
        return ds.estimate.assign_coords(row=_episodes(ds)).rename(row="episodes")

    beginning, all_of_it = of("beginning"), of("loop")
    later = all_of_it.sel(episodes=all_of_it.episodes > beginning.episodes[-1], seed=beginning.seed)
    return xr.concat([beginning, later], "episodes").transpose("episodes", "seed")


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    left, right = canvas.subplots(1, 2)
    for weighting, color in zip(WEIGHTINGS, plot.COLORS, strict=False):
        ds = datasets[weighting]
        plot.mean_curve(left, _episodes(ds), _squared_error(ds), weighting, color)
    ordinary = datasets["ordinary"]
    episodes, seeds = _episodes(ordinary).values, ordinary.sizes["seed"]
    exact = variance().ordinary
    look = {"color": plot.INK, "ls": "--", "lw": 1.2}
    left.plot(episodes, exact / episodes, label=f"exact, ordinary: {exact:.2f} / episodes", **look)
    plot.tidy(left, "episodes", "mean squared error")
    left.set(xscale="log", yscale="log")
    left.set_title(
        f"Blackjack, 13 with a usable ace against 2\nmean and pointwise 95% interval over {seeds} seeds",
        fontsize=plot.TYPE,
    )
    plot.legend(left)

    for weighting, color in zip(WEIGHTINGS, plot.COLORS, strict=False):
        paths = _paths(datasets, weighting)
        width = {"ordinary": 0.8, "weighted": 2.2}[weighting]  # these are soon at 1, all of them, and stay
        lines = right.plot(paths.episodes, paths, color=color, lw=width)
        lines[0].set_label(f"{weighting}, {paths.sizes['seed']} runs")
    plot.exact_line(right, 1, "exact: 1", lw=1, zorder=3)
    plot.tidy(right, "episodes", "estimate of v")
    right.set(xscale="log", xlim=(1, None), ylim=(0, 3))
    right.set_title(
        "Infinite variance: the value of left for ever,\nlearned from going either way", fontsize=plot.TYPE
    )
    plot.legend(right)
    return canvas


FIGURE = Figure(
    title="Ordinary and weighted importance sampling",
    source="Sutton and Barto 2018, figures 5.3 and 5.4",
    shows="Ordinary importance sampling is unbiased, with a variance that can be worked out. Weighted is biased "
    "at first, and nearer all the same. Where the variance is infinite, ordinary estimates do not settle.",
    experiment=_experiment,
    small={
        "num_seeds": 2,
        "num_episodes": 20,
        "num_paths": 2,
        "path_episodes": 20,
        "path_every": 10,
        "path_beginning": 10,
    },
    numbers=(
        # By enumeration; what has no exact value from a plain loop, 30 000 runs of the hand and 12 000 of the
        # loop.
        Number(  # the book's is the mean of a hundred million games
            "exact value of the hand",
            -0.2772042,
            EXACT,
            lambda datasets: value(),
            published="−0.27726",
            published_standard_error=9e-5,
        ),
        Number("exact variance of ρG", 10.15621, 1e-5, lambda datasets: variance().ordinary),
        Number("exact variance of ρ", 9.79059, 1e-5, lambda datasets: variance().ratio),
        Number(
            "ordinary: 4000 × squared error after 4000 episodes",
            10.15621,
            1e-5,
            _scaled_error("ordinary", 4000),
        ),
        Number(
            "weighted: 4000 × squared error after 4000 episodes",
            9.51,
            0.078,
            _scaled_error("weighted", 4000),
        ),
        Number(
            "ordinary: 10 × squared error after 10 episodes", 10.15621, 1e-5, _scaled_error("ordinary", 10)
        ),
        Number("weighted: 10 × squared error after 10 episodes", 5.136, 0.031, _scaled_error("weighted", 10)),
        Number("loop, ordinary: share of runs below v after 50 000 episodes", 0.8732, 0.0030, _below),
        Number("loop, weighted: error of the worst run after 50 000 episodes", 0, EXACT, _farthest),
    ),
    draw=_draw,
)
