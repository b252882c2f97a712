"""TDC on Baird's counterexample: it does not diverge (book, figure 11.5)."""

import numpy as np

from jaxrl_tab.approx import TDC
from jaxrl_tab.exact import expected
from jaxrl_tab.figures.baird import START, STEPS, draw_weights, exact, of_a_run, root_of_ve, sampled, weight
from jaxrl_tab.figures.figure import EXACT, Figure, Number

RATES = {"alpha": 0.005, "beta": 0.05}


def _sweeps():
    return expected.tdc(exact(), **RATES).curve(START, STEPS)[:, : len(START)]


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.8)
    left, right = canvas.subplots(1, 2, sharey=True)
    for axes, (at, w) in ((left, of_a_run(datasets)), (right, (np.arange(STEPS + 1), _sweeps()))):
        draw_weights(axes, at, w)
        ve, pbe = (
            [np.sqrt(error(x)) for x in w] for error in (exact().value_error, exact().projected_bellman_error)
        )
        axes.plot(at, ve, color=plot.INK, lw=1.6, ls="--", label="√VE")
        axes.plot(at, pbe, color=plot.INK, lw=1.6, ls=":", label="√PBE")
        axes.set_ylim(-4, 11)
    plot.tidy(left, "steps", "weights and errors")
    plot.tidy(right, "sweeps", "")
    plot.axes_title(left, "TDC, one run")
    plot.axes_title(right, "TDC in expectation")
    plot.legend(left, ncols=5)
    plot.head(canvas, "Baird's counterexample, α = {alpha:g}, β = {beta:g}".format(**RATES))
    return canvas


FIGURE = Figure(
    title="Gradient TD on Baird's counterexample",
    source="Sutton and Barto 2018, figure 11.5",
    shows="TDC brings the projected Bellman error to 0, and the weights stay finite. The value error does not go to 0 "
    "so soon: it stays near 2, and the weights are far from the best ones.",
    experiment=sampled(TDC, **RATES),
    small={"num_seeds": 2},
    numbers=(
        # From 200 000 runs of a plain loop; the book has curves.
        Number("√VE after 100 steps", 3.43199, 0.0013, root_of_ve(100)),
        Number("√VE after 1000 steps", 1.937411, 2.5e-5, root_of_ve(1000)),
        Number("w₁ after 100 steps", 1.85373, 0.0011, weight(1, 100)),
        Number("w₇ after 500 steps", 6.62614, 1e-4, weight(7, 500)),
        Number("w₈ after 1000 steps", -2.337968, 2.6e-5, weight(8, 1000)),
        Number(
            "in expectation, exactly: √VE after 1000 sweeps",
            1.9354645,
            EXACT,
            lambda datasets: np.sqrt(exact().value_error(_sweeps()[-1])),
        ),
        Number(
            "in expectation, exactly: √PBE after 1000 sweeps",
            0.0073786,
            EXACT,
            lambda datasets: np.sqrt(exact().projected_bellman_error(_sweeps()[-1])),
        ),
    ),
    draw=_draw,
)
