"""Expected against sample updates, where both take the same time (book, section 8.5, figure 8.7)."""

import numpy as np

from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

BRANCHING = (2, 10, 100)
SHOWN = (*BRANCHING, 1000, 10_000)


def _branches(b):
    """One action with b outcomes, all equally likely, which end the episode: its value is 0.

    What they pay has the variance (b - 1) / b, as that of b numbers around their own mean, where they are drawn from
    N(0, 1).
    """
    paid = np.linspace(-1, 1, b)
    paid *= np.sqrt((b - 1) / b / paid.var())
    to_next = np.zeros((b + 1, 1, b + 1))
    to_next[0, 0, 1:] = 1 / b
    to_next[1:, 0, 1:] = np.eye(b)
    rewards = np.zeros_like(to_next)
    rewards[0, 0, 1:] = paid
    return FiniteMDP(to_next, rewards, terminal=range(1, b + 1))


def _experiment(num_seeds=2000):
    grid = {"alpha": sample_average(), "epsilon": 0.0, "q0": 1.0}  # an error of 1 before anything is known
    budget = {"num_seeds": num_seeds, "log_every": 1, "record": _value}
    return {f"b-{b}": swept(_branches(b), "q-learning", grid, num_steps=2 * b, **budget) for b in BRANCHING}


def _value(learner):
    return {"value": learner.q[0, 0]}


def _square(b, samples):
    """The squared error of each run after so many sample updates."""
    return lambda datasets: datasets[f"b-{b}"].value.isel(row=samples - 1) ** 2


def _expected_square(b, samples):
    return (b - 1) / (b * samples)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    ax.plot([0, 1, 1, 2], [1, 1, 0, 0], color=plot.INK, lw=1.6, label="expected update")
    for b, color in zip(SHOWN, plot.COLORS, strict=False):
        samples = np.unique(np.geomspace(1, 2 * b, 400).round())
        ax.plot(
            np.append(0, samples / b),
            np.sqrt(np.append(1, _expected_square(b, samples))),
            color=color,
            lw=1.3,
            label=f"samples, b = {b}",
        )
        if b in BRANCHING:
            some = np.unique(np.linspace(1, 2 * b, 10).round().astype(int))
            errors = [np.sqrt(float(_square(b, t)(datasets).mean())) for t in some]
            ax.plot(some / b, errors, ls="", marker="o", ms=4, color=color)
    plot.tidy(ax, "next values looked at, in units of b", "root mean square error of the value")
    ax.set(xlim=(0, 2), ylim=(0, 1.03))
    plot.legend(ax)
    seeds = datasets[f"b-{BRANCHING[0]}"].sizes["seed"]
    title = f"Expected or sample updates: lines are exact,\npoints are Q-learning with step 1/N, {seeds} runs"
    plot.head(canvas, title)
    return canvas


FIGURE = Figure(
    title="Expected against sample updates, by the number of branches",
    source="Sutton and Barto 2018, figure 8.7",
    shows="With b equally likely outcomes an expected update looks at b next values, and then there is no error; "
    "before, nothing is gained. As many sample updates leave an error of about 1/√b, and most of that is gained by the "
    "first few: the more branches, the better it is to spread them over many states.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=tuple(
        # The book's formula, (b - 1) / (b t), squared.
        Number(
            f"b = {b}: mean squared error after looking at {t}", _expected_square(b, t), EXACT, _square(b, t)
        )
        for b, t in ((2, 1), (2, 4), (10, 1), (10, 10), (100, 10), (100, 100), (100, 200))
    ),
    draw=_draw,
)
