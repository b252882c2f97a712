"""Optimistic initial values: exploration without chance (book, section 2.6)."""

from jaxrl_tab.figures import arms
from jaxrl_tab.figures.figure import Figure, Number

SETTINGS = {"optimistic, greedy: Q₁ = 5": (0.0, 5.0), "realistic, ε = 0.1: Q₁ = 0": (0.1, 0.0)}
OPTIMISTIC, REALISTIC = SETTINGS


def _experiment(num_problems=4000):
    def run(epsilon, q0):
        setting = {"alpha": 0.1, "epsilon": epsilon, "q0": q0}
        return arms.run("q-learning", setting, num_problems, arms.epsilon_greedy(epsilon))

    return {name: run(*setting) for name, setting in SETTINGS.items()}


def _spike(datasets):
    """How probable the best arm is in play 11, when each was pulled once."""
    return datasets[OPTIMISTIC].best.isel(row=0)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for name, color in zip(SETTINGS, plot.COLORS, strict=False):
        arms.draw_share(ax, datasets[name], name, color)
    arms.finish(ax, "", share=True)
    problems = datasets[OPTIMISTIC].sizes["seed"]
    plot.head(canvas, f"Ten-armed testbed, α = 0.1: mean, 95% interval, {problems} problems")
    return canvas


FIGURE = Figure(
    title="Optimistic initial values",
    source="Sutton and Barto 2018, figure 2.3",
    shows="Every arm disappoints who expects 5 of each, so all are tried, again and again, though nothing is left to "
    "chance: worse at first, better later. In play 11, when each arm was pulled once, the best one is pulled in more "
    "than two problems of five: the spike of exercise 2.6.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # From 40 000 problems, with plain loops.
        Number(
            "optimistic: probability of the best arm, plays 911 to 1001",
            0.85786,
            0.00161,
            arms.late_share(OPTIMISTIC),
        ),
        Number("realistic: the same", 0.75554, 0.00157, arms.late_share(REALISTIC)),
        Number("optimistic: the same in play 11", 0.43540, 0.00248, _spike),
        Number("optimistic: mean reward of plays 901 to 1000", 1.5045, 0.0031, arms.late_reward(OPTIMISTIC)),
    ),
    draw=_draw,
)
