"""The gradient bandit algorithm with and without a baseline (book, section 2.8)."""

from jaxrl_tab.envs import KArmedTestbed
from jaxrl_tab.figures import arms
from jaxrl_tab.figures.figure import Figure, Number

ALPHAS = (0.1, 0.4)
BASELINES = {"with baseline": True, "without": False}
WITH, WITHOUT = BASELINES
SHIFT = 4.0  # of the means of all arms


def _experiment(num_problems=2000):
    env = KArmedTestbed(shift=SHIFT)

    def run(baseline):
        grid = {"alpha": list(ALPHAS), "baseline": baseline}
        return arms.run("gradient-bandit", grid, num_problems, arms.softmax, env)

    return {name: run(baseline) for name, baseline in BASELINES.items()}


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for name, color in zip(BASELINES, plot.COLORS, strict=False):
        for alpha, dash in zip(ALPHAS, plot.DASHES, strict=False):
            arms.draw_share(ax, datasets[name].sel(alpha=alpha), f"{name}, α = {alpha}", color, ls=dash)
    arms.finish(ax, "", share=True)
    problems = datasets[WITH].sizes["seed"]
    plot.head(canvas, f"Means around {SHIFT:g}, gradient bandit: mean, 95% interval, {problems} problems")
    return canvas


FIGURE = Figure(
    title="The gradient bandit, with and without a baseline",
    source="Sutton and Barto 2018, figure 2.5",
    shows="All rewards are 4 higher, which no method should mind. With the mean reward as a baseline the gradient "
    "bandit does not; without, every arm that is pulled is made more probable, the good ones only more so, and it "
    "learns slower.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # From 40 000 problems, with plain loops: the mean of plays 911, 921, ..., 1001.
        Number(
            "with baseline, α = 0.1: probability of the best arm",
            0.84575,
            0.00169,
            arms.late_share(WITH, alpha=0.1),
        ),
        Number("with baseline, α = 0.4", 0.71987, 0.00223, arms.late_share(WITH, alpha=0.4)),
        Number("without, α = 0.1", 0.49105, 0.00246, arms.late_share(WITHOUT, alpha=0.1)),
        Number("without, α = 0.4", 0.27753, 0.00223, arms.late_share(WITHOUT, alpha=0.4)),
    ),
    draw=_draw,
)
