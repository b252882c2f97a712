"""Pictures of step sizes and exploration rates."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxrl_tab.show.rates import COUNTS, LEAST, Study, study
from jaxrl_tab.show.style import NARROW, canvas, legend, line_styles, literal, tidy


def schedules(rates: Sequence[Any], *, width: float = NARROW) -> Figure:
    """Their values against n, both axes logarithmic; the legend says which conditions each meets.

    Values below a millionth of the largest are left out.

    Args:
        rates: numbers and schedules, also as they are typed, or what `rates.study` says of them.
        width: of the figure, inches.
    """
    studies = [one if isinstance(one, Study) else study(one) for one in rates]
    figure = canvas(width)
    ax: Any = figure.subplots()
    n = np.unique(np.round(np.geomspace(COUNTS[0], COUNTS[-1], 200)).astype(int))
    largest = max(float(one.values.max()) for one in studies)
    for one, style in zip(studies, line_styles(), strict=False):
        y = one.values[n - 1]
        label = f"{one.name} (GLIE: {one.glie.answer}; Robbins and Monro: {one.robbins_monro.answer})"
        seen = np.where(y >= LEAST * largest, y, np.nan)
        ax.plot(n, seen, label=literal(label), lw=1.4, ms=4, markevery=25, **style)
    ax.set_xscale("log")
    if largest > 0:
        ax.set_yscale("log")
    tidy(ax, "n", "value")
    legend(ax)
    return figure
