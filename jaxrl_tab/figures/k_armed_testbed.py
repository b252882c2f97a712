"""The ten-armed testbed: how much exploration pays (book, section 2.3)."""

from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.envs import KArmedTestbed
from jaxrl_tab.figures import arms
from jaxrl_tab.figures.figure import EXACT, Figure, Number

RATES = {"greedy": 0.0, "ε = 0.01": 0.01, "ε = 0.1": 0.1}
GREEDY, LITTLE, MORE = RATES


def _experiment(num_problems=4000):
    def run(epsilon):
        setting = {"alpha": sample_average(), "epsilon": epsilon}
        return arms.run("q-learning", setting, num_problems, arms.epsilon_greedy(epsilon))

    return {name: run(epsilon) for name, epsilon in RATES.items()}


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    rewards, share = canvas.subplots(1, 2)
    for name, color in zip(RATES, plot.COLORS, strict=False):
        arms.draw_rewards(rewards, datasets[name], name, color)
        arms.draw_share(share, datasets[name], name, color)
    arms.finish(rewards, "what it earns", share=False)
    arms.finish(share, "how often it pulls the best arm", share=True)
    problems = datasets[GREEDY].sizes["seed"]
    plot.head(canvas, f"Ten-armed testbed: mean and pointwise 95% interval over {problems} problems")
    return canvas


def _best_arm(datasets):
    return KArmedTestbed().expected_best_mean()


FIGURE = Figure(
    title="The ten-armed testbed: how much exploration pays",
    source="Sutton and Barto 2018, figure 2.2",
    shows="Who never explores stays with a poor arm, in two problems of three. Of those who explore at any time alike, "
    "one play in ten is better within 1000 plays than one in a hundred.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # By integration; the others from 40 000 problems, with plain loops.
        Number("mean of the best arm", 1.538753, EXACT, _best_arm),
        Number("greedy: mean reward of plays 901 to 1000", 1.0274, 0.0031, arms.late_reward(GREEDY)),
        Number("ε = 0.01", 1.3143, 0.0032, arms.late_reward(LITTLE)),
        Number("ε = 0.1", 1.3663, 0.0028, arms.late_reward(MORE)),
        Number(
            "greedy: probability of the best arm, plays 911 to 1001",
            0.36054,
            0.00240,
            arms.late_share(GREEDY),
        ),
        Number("ε = 0.01: the same", 0.59811, 0.00240, arms.late_share(LITTLE)),
        Number("ε = 0.1: the same", 0.79831, 0.00146, arms.late_share(MORE)),
    ),
    draw=_draw,
)
