"""The ten-armed test bed: how much exploration pays (book, sections 2.3, 2.6 and 2.7)."""

from jaxrl_tab.core.policies import UCB
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.envs import KArmedTestbed
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

AVERAGE = sample_average()
SETTINGS = {
    "greedy": {"alpha": AVERAGE, "epsilon": 0.0},
    "ε = 0.01": {"alpha": AVERAGE, "epsilon": 0.01},
    "ε = 0.1": {"alpha": AVERAGE, "epsilon": 0.1},
    "UCB, c = 2": {"alpha": AVERAGE, "behaviour": UCB(2.0)},
    "optimistic, Q₁ = 5": {"alpha": 0.1, "epsilon": 0.0, "q0": 5.0},
}
GREEDY, LITTLE, MORE, BOUNDS, OPTIMISTIC = SETTINGS
PANELS = {
    "ε-greedy (book, figure 2.2)": (GREEDY, LITTLE, MORE),
    "and others (book, figures 2.3 and 2.4)": (MORE, BOUNDS, OPTIMISTIC),
}


def _experiment(num_problems=4000, num_plays=1000):
    env = KArmedTestbed()
    budget = {"num_seeds": num_problems, "num_steps": num_plays, "log_every": 10}
    return {name: swept(env, "q-learning", setting, **budget) for name, setting in SETTINGS.items()}


def _late_reward(name):
    """The mean reward of the last 100 of 1000 plays."""

    def measure(datasets):
        late = datasets[name].isel(row=slice(90, 100))
        return late.rewards.sum("row") / late.steps.sum("row")

    return measure


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    axes = canvas.subplots(1, 2, sharey=True)
    best = KArmedTestbed().expected_best_mean()
    colors = dict(zip(SETTINGS, plot.COLORS, strict=False))
    for ax, (title, names) in zip(axes, PANELS.items(), strict=True):
        for name in names:
            ds = datasets[name]
            plays = ds.steps.isel(seed=0).cumsum("row")
            plot.mean_curve(ax, plays, ds.rewards / ds.steps, name, colors[name], lw=1.5)
        plot.exact_line(ax, best, f"the best arm: {best:.2f}")
        plot.tidy(ax, "plays", "mean reward" if ax is axes[0] else "")
        ax.set(xlim=(0, None), ylim=(-0.1, 1.65))
        ax.set_title(title, fontsize=plot.TYPE)
        plot.legend(ax)
    problems = datasets[GREEDY].sizes["seed"]
    plot.head(canvas, f"Ten-armed testbed: mean and pointwise 95% interval over {problems} problems")
    return canvas


def _best_arm(datasets):
    return KArmedTestbed().expected_best_mean()


FIGURE = Figure(
    title="The ten-armed test bed: how much exploration pays",
    source="Sutton and Barto 2018, figures 2.2 to 2.4",
    shows="Who never explores stays with a poor arm. Of those who explore at any time alike, one play in ten is "
    "better within 1000 plays than one in a hundred; optimistic values and upper confidence bounds, which "
    "explore where little is known, pass both.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # By integration; the others from 40 000 problems, with plain loops.
        Number("mean of the best arm", 1.538753, EXACT, _best_arm, published="1.54"),
        Number("greedy: mean reward of plays 901 to 1000", 1.0274, 0.0031, _late_reward(GREEDY)),
        Number("ε = 0.01", 1.3143, 0.0032, _late_reward(LITTLE)),
        Number("ε = 0.1", 1.3663, 0.0028, _late_reward(MORE)),
        Number("UCB, c = 2", 1.4846, 0.0031, _late_reward(BOUNDS)),
        Number("optimistic, Q₁ = 5, α = 0.1", 1.5045, 0.0031, _late_reward(OPTIMISTIC)),
    ),
    draw=_draw,
)
