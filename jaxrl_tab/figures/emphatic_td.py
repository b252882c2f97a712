"""Emphatic TD on Baird's counterexample: what it does in expectation, and what runs do (book, figure 11.6)."""

import numpy as np

from jaxrl_tab.approx import EmphaticTD
from jaxrl_tab.exact import expected
from jaxrl_tab.figures.baird import EVERY, START, STEPS, draw_weights, exact, sampled
from jaxrl_tab.figures.figure import EXACT, Figure, Number

ALPHA = 0.03


def _sweeps():
    return expected.emphatic_curve(exact(), ALPHA, START, STEPS)


def _root_of_ve(w):
    return np.sqrt(exact().value_error(w))


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.8)
    left, right = canvas.subplots(1, 2)
    at, w = np.arange(STEPS + 1), _sweeps()
    draw_weights(left, at, w)
    left.plot(at, [_root_of_ve(x) for x in w], color=plot.INK, lw=1.6, ls="--", label="√VE")
    plot.tidy(left, "sweeps", "weights and error")
    plot.axes_title(left, "In expectation")
    plot.legend(left, ncols=4)
    errors = datasets["sampled"].v_error.values
    low, middle, high = np.quantile(errors, (0.05, 0.5, 0.95), axis=0)
    steps = EVERY * np.arange(1, errors.shape[1] + 1)
    right.fill_between(steps, low, high, color=plot.COLORS[0], alpha=0.25, lw=0, label="90% of them")
    right.plot(steps, middle, color=plot.COLORS[0], lw=1.6, label="median")
    right.set_yscale("log")
    plot.tidy(right, "steps", "√VE")
    plot.axes_title(right, f"{len(errors)} runs")
    plot.legend(right, ncols=2)
    plot.head(canvas, f"Emphatic TD on Baird's counterexample, α = {ALPHA:g}")
    return canvas


FIGURE = Figure(
    title="Emphatic TD on Baird's counterexample",
    source="Sutton and Barto 2018, figure 11.6; the book has no runs",
    shows="In expectation it swings, and then comes to the right values. What happens is another thing: the emphasis "
    "is a product of ratios of 7, whose variance is so large that no run comes near.",
    experiment=sampled(EmphaticTD, alpha=ALPHA),
    small={"num_seeds": 2},
    numbers=(
        # By the same equations in another program, with one number for the emphasis as the task allows it.
        Number(
            "in expectation, exactly: √VE after 10 sweeps",
            8.441215,
            EXACT,
            lambda _: _root_of_ve(_sweeps()[10]),
        ),
        Number(
            "in expectation, exactly: √VE after 100 sweeps",
            0.956744,
            EXACT,
            lambda _: _root_of_ve(_sweeps()[100]),
        ),
        Number(
            "in expectation, exactly: √VE after 1000 sweeps", 0, EXACT, lambda _: _root_of_ve(_sweeps()[1000])
        ),
    ),
    draw=_draw,
)
