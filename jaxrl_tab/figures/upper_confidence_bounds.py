"""Upper confidence bounds: exploration where little is known (book, section 2.7)."""

from jaxrl_tab.core.policies import UCB
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.figures import arms
from jaxrl_tab.figures.figure import Figure, Number

SETTINGS = {"UCB, c = 2": {"behaviour": UCB(2.0)}, "ε-greedy, ε = 0.1": {"epsilon": 0.1}}
BOUNDS, GREEDY = SETTINGS


def _experiment(num_problems=4000):
    return {
        name: arms.run("q-learning", {"alpha": sample_average(), **setting}, num_problems)
        for name, setting in SETTINGS.items()
    }


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for name, color in zip(SETTINGS, plot.COLORS, strict=False):
        arms.draw_rewards(ax, datasets[name], name, color)
    arms.finish(ax, "", share=False)
    problems = datasets[BOUNDS].sizes["seed"]
    plot.head(canvas, f"Ten-armed testbed, α = 1/N: mean, 95% interval, {problems} problems")
    return canvas


FIGURE = Figure(
    title="Upper confidence bounds",
    source="Sutton and Barto 2018, figure 2.4",
    shows="Who pulls the arm that may be the best, as far as is known, explores where little is known: after the first "
    "ten plays, which try every arm, that earns more than exploring at random.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # From 40 000 problems, with plain loops.
        Number("UCB, c = 2: mean reward of plays 901 to 1000", 1.4846, 0.0031, arms.late_reward(BOUNDS)),
        Number("ε = 0.1", 1.3663, 0.0028, arms.late_reward(GREEDY)),
    ),
    draw=_draw,
)
