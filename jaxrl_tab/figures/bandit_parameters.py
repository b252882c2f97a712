"""All bandit methods beside each other, each at several values of its parameter (book, section 2.10)."""

import numpy as np

from jaxrl_tab.core.policies import UCB
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.envs import KArmedTestbed
from jaxrl_tab.figures import arms
from jaxrl_tab.figures.figure import Figure, Number, swept

AVERAGE = {"alpha": sample_average()}
# The exponents of 2 that its parameter takes, and the method with the parameter at x.
METHODS = {
    "ε-greedy, ε": (range(-7, -1), "epsilon", AVERAGE),
    "gradient bandit, α": (range(-5, 3), "alpha", {}),
    "UCB, c": (range(-4, 3), "behaviour", AVERAGE),
    "greedy, optimistic, Q₁": (range(-2, 3), "q0", {"alpha": 0.1, "epsilon": 0.0}),
}
EPSILON, GRADIENT, BOUNDS, OPTIMISTIC = METHODS


def _experiment(num_problems=1000):
    budget = {"num_seeds": num_problems, "num_steps": arms.PLAYS, "log_every": arms.PLAYS}

    def run(exponents, parameter, fixed):
        values = [2.0**k for k in exponents]
        of_parameter = [UCB(c) for c in values] if parameter == "behaviour" else values
        method = "q-learning" if fixed else "gradient-bandit"
        return swept(KArmedTestbed(), method, {parameter: of_parameter, **fixed}, **budget)

    return {name: run(*of) for name, of in METHODS.items()}


def _earned(ds):
    """The mean reward of a play, [values, seeds]."""
    return (ds.rewards / ds.steps).isel(row=0)


def _at(name, exponent):
    exponents = METHODS[name][0]
    return lambda datasets: _earned(datasets[name])[exponents.index(exponent)]


def _draw(datasets):
    from jaxrl_tab import stats
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    ax = canvas.subplots()
    for (name, (exponents, *_)), color, dash in zip(METHODS.items(), plot.COLORS, plot.DASHES, strict=False):
        interval = stats.mean_interval(_earned(datasets[name]))
        errors = [interval.estimate - interval.low, interval.high - interval.estimate]
        x = 2.0 ** np.array(exponents)
        ax.errorbar(x, interval.estimate, errors, color=color, ls=dash, lw=1.5, capsize=2, label=name)
    ax.set_xscale("log", base=2)
    plot.tidy(ax, "ε, α, c or Q₁", f"mean reward, first {arms.PLAYS} plays")
    plot.legend(ax)
    problems = datasets[EPSILON].sizes["seed"]
    plot.head(canvas, f"Ten-armed testbed: mean and 95% interval over {problems} problems")
    return canvas


FIGURE = Figure(
    title="A parameter study of the bandit methods",
    source="Sutton and Barto 2018, figure 2.6",
    shows="Each method at its best, and how much that depends on its parameter: upper confidence bounds earn the most.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # From 20 000 problems, with plain loops.
        Number("ε-greedy, ε = 1/16: mean reward of 1000 plays", 1.32596, 0.00394, _at(EPSILON, -4)),
        Number("gradient bandit, α = 1/4", 1.39888, 0.00426, _at(GRADIENT, -2)),
        Number("UCB, c = 1", 1.47792, 0.00424, _at(BOUNDS, 0)),
        Number("optimistic, Q₁ = 1", 1.45165, 0.00429, _at(OPTIMISTIC, 0)),
    ),
    draw=_draw,
)
