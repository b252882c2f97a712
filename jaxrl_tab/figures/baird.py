"""Baird's counterexample: semi-gradient off-policy TD(0) and semi-gradient DP diverge (book, figure 11.2)."""

import functools

import numpy as np

from jaxrl_tab.approx import SemiGradientOffPolicyTD
from jaxrl_tab.envs import Baird
from jaxrl_tab.exact import expected
from jaxrl_tab.exact.projected import linear_values
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

TASK, GAMMA = Baird(), 0.99
START = np.array([1.0, 1, 1, 1, 1, 1, 10, 1])
STEPS, EVERY = 1000, 5
ALPHA = 0.01


@functools.cache
def exact():
    """What is exact about linear values of "always solid", while the policy of the book acts."""
    return linear_values(TASK, TASK.target_policy, TASK.features, GAMMA, behaviour=TASK.behaviour_policy)


def sampled(method, **numbers):
    """The experiment of a method in Baird's task: its weights and the root of VE, along runs."""

    def experiment(num_seeds=200):
        grid = {"features": "own", "w0": ",".join(f"{w:g}" for w in START), "gamma": GAMMA} | numbers
        budget = {"num_seeds": num_seeds, "num_steps": STEPS, "log_every": EVERY, "record": _weights}
        return {"sampled": swept(TASK, method, grid, **budget, exact=True)}

    return experiment


def _weights(learner):
    return {"weights": learner.v}


def weight(i, steps):
    """w_i after so many steps, counted from 1, of each seed."""
    return lambda datasets: datasets["sampled"]["weights"].isel(row=steps // EVERY - 1).values[..., i - 1]


def root_of_ve(steps):
    """The root of VE after so many steps, of each seed."""
    return lambda datasets: datasets["sampled"].v_error.isel(row=steps // EVERY - 1)


def draw_weights(axes, at, w, **more):
    """The eight weights [row, 8] along a run: those of the upper states alike."""
    from jaxrl_tab.show import plot

    for i in range(6):
        label = "$w_1$ to $w_6$" if i == 0 else None
        axes.plot(at, w[:, i], color=plot.COLORS[0], lw=1, label=label)
    for i, color in ((6, plot.COLORS[1]), (7, plot.COLORS[2])):
        axes.plot(at, w[:, i], color=color, lw=1.6, label=f"$w_{i + 1}$", **more)


def of_a_run(datasets, seed=0):
    """The weights of one run, from the start on: at which steps, and [row, 8]."""
    w = datasets["sampled"]["weights"].isel(seed=seed).values
    return EVERY * np.arange(len(w) + 1), np.vstack([START, w])


def _sweeps():
    return expected.dynamic_programming(exact(), ALPHA).curve(START, STEPS)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.6)
    left, right = canvas.subplots(1, 2, sharey=True)
    draw_weights(left, *of_a_run(datasets))
    draw_weights(right, np.arange(STEPS + 1), _sweeps())
    plot.tidy(left, "steps", "weights")
    plot.tidy(right, "sweeps", "")
    plot.axes_title(left, "Semi-gradient off-policy TD, one run")
    plot.axes_title(right, "Semi-gradient DP")
    plot.legend(left, ncols=3)
    plot.head(canvas, f"Baird's counterexample, α = {ALPHA:g}")
    return canvas


FIGURE = Figure(
    title="Baird's counterexample: TD and dynamic programming diverge",
    source="Sutton and Barto 2018, figure 11.2",
    shows="All values are 0, and the features can say so. Yet the weights grow without bound, with samples and without "
    "them, for an eigenvalue of the expected update is above 1.",
    experiment=sampled(SemiGradientOffPolicyTD, alpha=ALPHA),
    small={"num_seeds": 2},
    numbers=(
        # From 200 000 runs of a plain loop; the book has curves.
        Number("TD: √VE after 100 steps", 19.7195, 0.0087, root_of_ve(100)),
        Number("TD: w₈ after 500 steps", 76.328, 0.032, weight(8, 500)),
        Number("TD: w₈ after 1000 steps", 331.67, 0.16, weight(8, 1000)),
        Number("TD: w₇ after 1000 steps", 6.8196, 0.0026, weight(7, 1000)),
        Number(
            "DP, exactly: the largest eigenvalue of a sweep",
            1.0023925,
            EXACT,
            lambda datasets: expected.dynamic_programming(exact(), ALPHA).radius,
        ),
        Number("DP, exactly: w₈ after 1000 sweeps", 335.00121, 1e-4, lambda datasets: _sweeps()[-1, 7]),
    ),
    draw=_draw,
)
