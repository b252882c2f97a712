"""How far n-step Sarsa should look ahead on the mountain car (book, figure 10.4)."""

from jaxrl_tab.approx import SemiGradientNStepSarsa
from jaxrl_tab.envs import MountainCar
from jaxrl_tab.figures.figure import Figure, Number, swept
from jaxrl_tab.figures.mountain_car_steps import GREEDY

EPISODES = 50
ALPHAS = {
    1: (0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6),
    2: (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.4),
    4: (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0),
    8: (0.15, 0.2, 0.3, 0.4, 0.5, 0.6),
    16: (0.1, 0.15, 0.2, 0.25, 0.3, 0.4),
}
BOTTOM, TOP = 210, 300


def _experiment(num_seeds=100, num_episodes=EPISODES):
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes}

    def run(n, alphas):
        grid = GREEDY | {"n": n, "alpha": list(alphas)}
        return swept(MountainCar(), SemiGradientNStepSarsa, grid, **budget)

    return {str(n): run(n, alphas) for n, alphas in ALPHAS.items()}


def _length(n, alpha):
    """The mean length of the episodes, of each seed."""
    return lambda datasets: datasets[str(n)].lengths.sel(alpha=alpha).mean("row")


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.6)
    ax = canvas.subplots()
    for (n, ds), color, marker in zip(datasets.items(), plot.COLORS, plot.MARKERS, strict=False):
        lengths = ds.lengths.mean("row").rename(alpha="row")
        seen = lengths.isel(row=(lengths.mean("seed") < 1.2 * TOP).values)
        plot.mean_curve(ax, seen.row, seen, f"n = {n}", color, marker=marker)
    plot.tidy(ax, "α × 8 (number of tilings)", f"steps of an episode, first {EPISODES}")
    ax.set(ylim=(BOTTOM, TOP))
    plot.legend(ax)
    plot.head(canvas, "Mountain car: n-step semi-gradient Sarsa, eight tilings", datasets["1"].sizes["seed"])
    return canvas


def _number(n, alpha, expected, error):
    return Number(f"n = {n}, α = {alpha:g}/8", expected, error, _length(n, alpha))


FIGURE = Figure(
    title="How many rewards to look ahead on the mountain car",
    source="Sutton and Barto 2018, figure 10.4",
    shows="Looking ahead by four steps is best, as on the random walk: n between the ends, and the larger it is, the "
    "smaller the step size that it needs.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 3},
    numbers=(
        # From 1000 runs of a plain loop in float64; the book has curves.
        _number(1, 0.5, 284.27, 0.30),
        _number(1, 1.0, 235.91, 0.10),
        _number(2, 0.4, 267.40, 0.11),
        _number(2, 0.6, 241.63, 0.11),
        _number(4, 0.5, 230.17, 0.23),
        _number(8, 0.3, 239.89, 0.55),
        _number(16, 0.2, 248.83, 0.92),
    ),
    draw=_draw,
)
