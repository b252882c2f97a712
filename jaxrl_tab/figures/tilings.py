"""Many tilings against one, on the walk of a thousand states (book, figure 9.10)."""

from jaxrl_tab.figures.bases import EPISODES, curve, draw_curves, error
from jaxrl_tab.figures.figure import EXACT, Figure, Number
from jaxrl_tab.figures.long_walk import least_error

ONE, MANY = (
    "tile-coding(1, 5)",
    "tile-coding(50, 5)",
)  # each tile as wide as 200 states, tilings 4 states apart
LABELS = {ONE: "state aggregation (one tiling)", MANY: "tile coding (50 tilings)"}
ALPHA = 1e-4  # of one tiling; of fifty it is divided by 50, so that the first steps are as large


def _experiment(num_seeds=16, num_episodes=EPISODES):
    more = {"per_tiling": True}
    return {features: curve(features, ALPHA, num_seeds, num_episodes, **more) for features in LABELS}


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    ax = canvas.subplots()
    styles = [{"color": color, "lw": 1.7} for color in plot.COLORS[:2]]
    draw_curves(ax, datasets, LABELS, styles)
    for features, style in zip(LABELS, styles, strict=True):
        ax.axhline(least_error(features), color=style["color"], ls="--", lw=1.2)
    plot.head(canvas, "A walk of 1000 states, gradient Monte Carlo", datasets[ONE].sizes["seed"])
    return canvas


FIGURE = Figure(
    title="Fifty tilings against one",
    source="Sutton and Barto 2018, figure 9.10",
    shows="Both learn as fast at first, for the step size is the same for a state. One tiling of five tiles soon is "
    "as good as it can be (dashed); fifty of them, each a little moved, tell states apart that one cannot.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 4},
    numbers=(
        # The book has curves. The exact ones are from equations of another program, the others from 100 runs of a
        # plain loop.
        Number("one tiling: the least √VE, exactly", 0.1049471, EXACT, lambda datasets: least_error(ONE)),
        Number("50 tilings: the least √VE, exactly", 0.0020978, EXACT, lambda datasets: least_error(MANY)),
        *(
            Number(f"{count}: √VE after {episodes} episodes", expected, se, error(features, episodes))
            for features, count, episodes, expected, se in (
                (ONE, "one tiling", 500, 0.25313, 8.3e-4),
                (ONE, "one tiling", 2000, 0.12950, 6.8e-4),
                (ONE, "one tiling", 5000, 0.11481, 9.8e-4),
                (MANY, "50 tilings", 500, 0.25005, 8.2e-4),
                (MANY, "50 tilings", 2000, 0.11718, 1.2e-3),
                (MANY, "50 tilings", 5000, 0.06902, 1.3e-3),
            )
        ),
    ),
    draw=_draw,
)
