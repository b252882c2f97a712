"""Fourier against polynomial features, on the walk of a thousand states (book, figure 9.5)."""

from jaxrl_tab import approx
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept
from jaxrl_tab.figures.long_walk import WALK, least_error, recorder

ALPHAS = {"polynomial": 1e-4, "fourier": 5e-5}
NAMES = {"polynomial": "Polynomial basis", "fourier": "Fourier basis"}
ORDERS = (5, 10, 20)
EPISODES, POINTS = 5000, 100


def _experiment(num_seeds=30, num_episodes=EPISODES, orders=ORDERS):
    return {
        f"{basis}({order})": curve(f"{basis}({order})", alpha, num_seeds, num_episodes)
        for order in orders
        for basis, alpha in ALPHAS.items()
    }


def curve(features, alpha, num_seeds, num_episodes, **more):
    """Gradient Monte Carlo with these features: a sweep that records the root of VE."""
    budget = {
        "num_seeds": num_seeds,
        "num_episodes": num_episodes,
        "log_every": max(1, num_episodes // POINTS),
    }
    grid = {"features": features, "alpha": alpha, **more}
    return swept(WALK, approx.GradientMonteCarlo, grid, **budget, record=recorder(features))


def error(features, episodes):
    """The root of VE after so many episodes, of each seed."""

    def after(datasets):
        ds = datasets[features]
        return ds.error.isel(row=min(episodes // ds.attrs["log_every"], ds.sizes["row"]) - 1)

    return after


def draw_curves(ax, datasets, labels, styles):
    """The root of VE against episodes."""
    from jaxrl_tab.show import plot

    for (name, label), style in zip(labels.items(), styles, strict=True):
        ds = datasets[name]
        plot.mean_curve(ax, ds.episodes.mean("seed").cumsum("row"), ds.error, label, **style)
    plot.tidy(ax, "episodes", "√VE, the root of the value error")
    ax.set(xlim=(0, None), ylim=(0, None))
    plot.legend(ax)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    ax = canvas.subplots()
    labels = {
        name: f"{NAMES[name.partition('(')[0]]}, n = {name.partition('(')[2][:-1]}" for name in datasets
    }
    dashes = ("-", "--", ":")
    styles = [{"color": plot.COLORS[i % 2], "ls": dashes[i // 2 % 3], "lw": 1.6} for i in range(len(labels))]
    draw_curves(ax, datasets, labels, styles)
    plot.head(
        canvas, "A walk of 1000 states, gradient Monte Carlo", next(iter(datasets.values())).sizes["seed"]
    )
    return canvas


def _what(basis, order, episodes):
    return f"{NAMES[basis]}, n = {order}: √VE after {episodes} episodes"


def _least(datasets):
    return least_error("polynomial(5)")


FIGURE = Figure(
    title="Fourier features against polynomials",
    source="Sutton and Barto 2018, figure 9.5",
    shows="All orders could express the values nearly exactly, but by gradient descent cosines come close much sooner "
    "than powers, which look so much like each other that what one weight learns another has to unlearn.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 4, "orders": (5, 20)},
    numbers=(
        # The book has curves. These are from 100 runs of a plain loop, after 500 episodes from 3000 and 1000; the least
        # error is from equations of another program.
        Number("polynomials, n = 5: the least √VE, exactly", 0.0010003, EXACT, _least),
        *(
            Number(_what(basis, order, episodes), expected, se, error(f"{basis}({order})", episodes))
            for basis, order, episodes, expected, se in (
                ("polynomial", 5, 500, 0.26868, 4.0e-4),
                ("polynomial", 5, 5000, 0.13082, 3.4e-3),
                ("polynomial", 20, 5000, 0.11773, 3.5e-3),
                ("fourier", 5, 500, 0.22013, 4.6e-4),
                ("fourier", 5, 5000, 0.05683, 2.9e-3),
                ("fourier", 20, 2000, 0.08813, 1.9e-3),
                ("fourier", 20, 5000, 0.05996, 2.8e-3),
            )
        ),
    ),
    draw=_draw,
)
