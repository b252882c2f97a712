"""The recycling robot: its table, and what it should do (book, example 3.3)."""

import numpy as np

from jaxrl_tab.envs import RecyclingRobot
from jaxrl_tab.envs.recycling_robot import HIGH, LOW, RECHARGE, SEARCH, WAIT
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number

GAMMA = 0.9
TABLE, VALUES = "table", "values"
STAYS_LOW = np.arange(51) / 50
ALPHA, BETA, SEARCHING, WAITING = 0.7, 0.6, 2.0, 1.0  # of the robot by default
# (s, a, s', p(s' | s, a), r(s, a, s')) as the book prints them; where p is 0 it prints no reward.
PRINTED = (
    (HIGH, SEARCH, HIGH, ALPHA, SEARCHING),
    (HIGH, SEARCH, LOW, 1 - ALPHA, SEARCHING),
    (LOW, SEARCH, HIGH, 1 - BETA, -3),
    (LOW, SEARCH, LOW, BETA, SEARCHING),
    (HIGH, WAIT, HIGH, 1, WAITING),
    (HIGH, WAIT, LOW, 0, None),
    (LOW, WAIT, HIGH, 0, None),
    (LOW, WAIT, LOW, 1, WAITING),
    (LOW, RECHARGE, HIGH, 1, 0),
    (LOW, RECHARGE, LOW, 0, None),
)


def _experiment():
    return {TABLE: _table, VALUES: _values}


def _table(progress):
    """p and r of the table's rows."""
    import xarray as xr

    model, found = planning.exact_model(RecyclingRobot()), []
    for s, a, s_next, *_ in PRINTED:
        to = model.s_next[s, a] == s_next
        p = model.prob[s, a][to].sum()
        found.append((p, (model.prob * model.reward)[s, a][to].sum() / p if p else np.nan))
    return xr.Dataset({"p": ("line", [p for p, _ in found]), "r": ("line", [r for _, r in found])})


def _values(progress):
    """q* for all probabilities that searching leaves a low battery low."""
    import xarray as xr

    q = [planning.value_iteration(RecyclingRobot(stays_low=beta), GAMMA)[1] for beta in STAYS_LOW]
    q = np.where(np.array(q) < -1e29, np.nan, q)
    return xr.Dataset({"q": (("stays_low", "state", "action"), q)}, {"stays_low": STAYS_LOW})


def _rows_unlike(datasets):
    ds = datasets[TABLE]
    right = [
        abs(float(p) - printed[3]) < EXACT and (printed[4] is None or abs(float(r) - printed[4]) < EXACT)
        for p, r, printed in zip(ds.p, ds.r, PRINTED, strict=True)
    ]
    return len(right) - sum(right)


def _v(state):
    return lambda datasets: datasets[VALUES].q.sel(stays_low=BETA, state=state).max()


def _searches_from(datasets):
    q = datasets[VALUES].q.sel(state=LOW)
    return STAYS_LOW[(q.argmax("action") == SEARCH).values.argmax()]


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.2)
    left, right = canvas.subplots(1, 2, width_ratios=(1, 1.2))
    names, actions = ("high", "low"), RecyclingRobot().action_names
    cells = [
        [
            names[s],
            actions[a],
            names[s_next],
            f"{float(p):.2g}",
            "–" if p == 0 else f"{float(r):g}".replace("-", "−"),
        ]
        for (s, a, s_next, *_), p, r in zip(PRINTED, datasets[TABLE].p, datasets[TABLE].r, strict=True)
    ]
    left.axis("off")
    table = left.table(cells, colLabels=["s", "a", "s'", "p", "r"], loc="center", cellLoc="center")
    table.auto_set_font_size(False)
    table.set_fontsize(plot.SMALL)
    table.auto_set_column_width(range(5))
    table.scale(1, 1.4)
    q = datasets[VALUES].q
    for a, (name, color, dash) in enumerate(zip(actions, plot.COLORS, plot.DASHES, strict=False)):
        right.plot(q.stays_low, q.sel(state=LOW, action=a), color=color, ls=dash, label=f"low: {name}")
    right.plot(q.stays_low, q.sel(state=HIGH, action=SEARCH), color=plot.INK, lw=1, label="high: search")
    plot.tidy(right, "probability that searching leaves a low battery low", "q*")
    plot.legend(right)
    plot.head(canvas, "The recycling robot: γ = 0.9, α = 0.7, and in the table β = 0.6")
    return canvas


FIGURE = Figure(
    title="The recycling robot: its table, and what it should do",
    source="Sutton and Barto 2018, example 3.3",
    shows="The table of the dynamics is the book's, with numbers for its letters. With a low battery the robot should "
    "recharge, unless searching is nearly safe.",
    experiment=_experiment,
    numbers=(
        Number("rows of ten that are not the printed ones", 0, EXACT, _rows_unlike, published="0"),
        # By hand: v(high) = 2 / (1 - 0.9 0.7 - 0.81 0.3), v(low) = 0.9 v(high).
        Number("v* with a high battery", 2 / (1 - 0.63 - 0.243), EXACT, _v(HIGH)),
        Number("v* with a low battery", 1.8 / (1 - 0.63 - 0.243), EXACT, _v(LOW)),
        # It is better from 3 / (5 - 0.09 v(high)) = 0.8374 on, and fiftieths are looked at.
        Number("β from which it should search with a low battery", 0.84, EXACT, _searches_from),
    ),
    draw=_draw,
)
