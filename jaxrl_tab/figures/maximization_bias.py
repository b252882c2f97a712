"""Maximisation bias: Q-learning against Double Q-learning (book, example 6.7 and figure 6.5)."""

from jaxrl_tab.envs import MaximizationBias
from jaxrl_tab.figures.figure import Figure, Number, swept

ALPHA, EPSILON = 0.1, 0.1
METHODS = ("q-learning", "double-q-learning")


def _experiment(num_seeds=4000, num_episodes=300):
    env, grid = MaximizationBias(), {"alpha": ALPHA, "epsilon": EPSILON}
    return {
        method: swept(env, method, grid, num_seeds=num_seeds, num_episodes=num_episodes) for method in METHODS
    }


def _went_left(ds):
    """Whether each episode went left: then it is of two steps, else of one. [seed, row]"""
    return ds.lengths - ds.episodes


def _share(method, first, last=None):
    """The share of left in the episodes from `first` to `last`, or in `first`."""
    return lambda datasets: _went_left(datasets[method]).isel(row=slice(first - 1, last or first)).mean("row")


def _draw(datasets):
    from jaxrl_tab.show import plot, words

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for (method, ds), color in zip(datasets.items(), plot.COLORS, strict=False):
        plot.mean_curve(ax, ds.row + 1, 100 * _went_left(ds), words.title_of(method), color)
    least = 100 * EPSILON / 2
    plot.exact_line(ax, least, f"optimal but for exploration: {least:g}%")
    plot.tidy(ax, "episodes", "% of runs that go left from A")
    ax.set(ylim=(0, 100), xlim=(0, None))
    plot.head(canvas, f"Maximization bias, α = {ALPHA}, ε = {EPSILON}", datasets[METHODS[0]].sizes["seed"])
    plot.legend(ax)
    return canvas


Q, DOUBLE = METHODS
FIGURE = Figure(
    title="Maximisation bias: Q-learning against Double Q-learning",
    source="Sutton and Barto 2018, example 6.7 and figure 6.5",
    shows="Q-learning prefers the worse action for a long time, because the largest of several noisy estimates "
    "is too large; Double Q-learning, which chooses by one table and values by the other, hardly does.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # From 40 000 runs of plain loops.
        Number("Q-learning: share of left in episode 19, its peak", 0.9396, 0.0012, _share(Q, 19)),
        Number("Q-learning: in episode 100", 0.4587, 0.0025, _share(Q, 100)),
        Number("Q-learning: in episodes 281 to 300", 0.1203, 0.0011, _share(Q, 281, 300)),
        Number("Double Q-learning: in episode 10", 0.4560, 0.0025, _share(DOUBLE, 10)),
        Number("Double Q-learning: in episode 100", 0.0944, 0.0015, _share(DOUBLE, 100)),
        Number("Double Q-learning: in episodes 281 to 300", 0.0673, 0.0006, _share(DOUBLE, 281, 300)),
    ),
    draw=_draw,
)
