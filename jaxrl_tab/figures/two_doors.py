"""Greedy behaviour locks on to the worse of two doors (lecture 5, "Example of greedy action selection")."""

from functools import partial

from jaxrl_tab.core import policies, schedules
from jaxrl_tab.envs import TwoDoors
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

BEHAVIOURS = {"greedy": 0.0, "0.1-greedy": 0.1, "GLIE, ε = 1/k": schedules.glie()}
GREEDY, SOFT, GLIE = BEHAVIOURS
RIGHT = 1  # the worse door: 2 on average, and 3 behind the left one


def _prefers_right(env, learner):
    """The probability that a greedy choice would be the worse door."""
    return {"right": policies.greedy(learner.q[env.start_state])[RIGHT]}


def _experiment(num_seeds=4000, num_plays=1000):
    env = TwoDoors()
    record = partial(_prefers_right, env)

    def run(epsilon):
        grid = {"alpha": schedules.sample_average(), "epsilon": epsilon}
        budget = {"num_seeds": num_seeds, "num_steps": num_plays, "log_every": 5}
        return swept(env, "q-learning", grid, **budget, record=record)

    return {name: run(epsilon) for name, epsilon in BEHAVIOURS.items()}


def _plays(ds):
    return ds.episodes.isel(seed=0).cumsum("row")


def _share(behaviour, plays):
    """Whether each run would open the worse door after so many plays."""

    def measure(datasets):
        ds = datasets[behaviour]
        return ds.right.isel(row=(_plays(ds) <= plays).values).isel(row=-1)

    return measure


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for (name, ds), color in zip(datasets.items(), plot.COLORS, strict=False):
        plot.mean_curve(ax, _plays(ds), ds.right, name, color)
    exact = TwoDoors().lock_in_probability()
    plot.exact_line(ax, exact, f"exact probability of lock-in: {exact:.3f}")
    plot.tidy(ax, "plays", "share of runs that prefer the worse door")
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    ax.set_ylim(0, 1)
    plot.head(canvas, "Two doors, sample averages", datasets[GREEDY].sizes["seed"])
    plot.legend(ax)
    return canvas


FIGURE = Figure(
    title="Greedy behaviour locks on to the worse of two doors",
    source="Silver 2015, lecture 5, greedy action selection",
    shows="Who is greedy from the first play on keeps for ever to the door that paid first, which in two of "
    "three runs is the worse one. Exploring mends it, but with ε = 1/k it takes long.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # By hand: the door that is first to pay is the choice for ever; one pays always, the other every
        # second time: 1 / (1 + 1/2). The others from 100 000 runs of a plain loop.
        Number(
            "exact probability of lock-in", 2 / 3, EXACT, lambda datasets: TwoDoors().lock_in_probability()
        ),
        Number("greedy: worse door preferred after 1000 plays", 2 / 3, EXACT, _share(GREEDY, 1000)),
        Number("0.1-greedy: after 100 plays", 0.23512, 0.0013, _share(SOFT, 100)),
        Number("0.1-greedy: after 1000 plays", 0.00365, 0.0002, _share(SOFT, 1000)),
        Number("GLIE: after 1000 plays", 0.3118, 0.0015, _share(GLIE, 1000)),
    ),
    draw=_draw,
)
