"""The gambler's problem: sweeps of value iteration, and the policies that are optimal (book, figure 4.3)."""

import numpy as np

from jaxrl_tab.envs import GamblersProblem
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number

RUN = "value-iteration"
SWEEPS = (1, 2, 3, 32)
MOST = 100  # sweeps; they change nothing long before


def _experiment():
    return {RUN: _value_iteration}


def _value_iteration(progress):
    """Sweeps as in the box of section 4.4: in place, from the smallest capital to the largest."""
    import xarray as xr

    env = GamblersProblem()
    v, rows, p_h, goal = np.zeros(env.num_states), [], float(env.p_h), env.goal
    for _ in range(MOST):
        for s in range(1, goal):
            stakes = np.arange(1, min(s, goal - s) + 1)
            win = v[s + stakes] + (s + stakes == goal)  # the goal is terminal, of value 0, and pays 1
            v[s] = (p_h * win + (1 - p_h) * v[s - stakes]).max()
        rows.append(v.copy())
    exact, q = planning.value_iteration(env)
    is_best = q >= exact[:, None] - 1e-9
    variables = {
        "v": (("sweep", "capital"), rows),
        "exact": ("capital", exact),
        "is_best": (("capital", "stake"), is_best & (exact > 0)[:, None]),
    }
    return xr.Dataset(variables, {"sweep": np.arange(1, MOST + 1)})


def _v(sweep, capital):
    return lambda datasets: datasets[RUN].v.sel(sweep=sweep, capital=capital)


def _sweeps_needed(datasets):
    """After which all that is to come changes no value by more than a millionth."""
    v = datasets[RUN].v.values
    return 1 + np.argmax(abs(v - v[-1]).max(1) < EXACT)


def _farthest(datasets):
    ds = datasets[RUN]
    return abs(ds.v.isel(sweep=-1) - ds.exact).max()


def _smallest_stake(capital):
    return lambda datasets: datasets[RUN].is_best.sel(capital=capital).values.argmax()


def _unsure(datasets):
    return (datasets[RUN].is_best.sum("stake") > 1).sum()


def _bold(datasets):
    """Capitals of which all, or all that is missing, is an optimal stake."""
    is_best = datasets[RUN].is_best.values
    goal = len(is_best) - 1
    return sum(is_best[s, min(s, goal - s)] for s in range(1, goal))


def _draw(datasets):
    from jaxrl_tab.show import plot

    ds, canvas = datasets[RUN], plot.canvas(plot.WIDTH)
    left, right = canvas.subplots(1, 2)
    inner = np.arange(1, ds.sizes["capital"] - 1)
    looks = zip(SWEEPS, plot.COLORS, plot.DASHES, strict=False)
    for sweep, color, dash in looks:
        name = f"{sweep} sweep{'s' if sweep > 1 else ''}"
        left.plot(inner, ds.v.sel(sweep=sweep, capital=inner), color=color, ls=dash, lw=1.3, label=name)
    left.plot(inner, ds.exact[inner], color=plot.INK, lw=1, label="exact")
    plot.tidy(left, "capital", "value")
    plot.legend(left)
    is_best = ds.is_best.values
    right.plot(*np.nonzero(is_best), ".", color=plot.GREY, ms=3.5, label="optimal")
    right.step(
        inner, is_best[inner].argmax(1), where="mid", color=plot.COLORS[0], lw=1.3, label="the smallest"
    )
    plot.tidy(right, "capital", "stake")
    plot.legend(right)
    plot.head(canvas, "The gambler's problem, heads with probability 0.4")
    return canvas


FIGURE = Figure(
    title="The gambler's problem: value iteration, and its many optimal policies",
    source="Sutton and Barto 2018, figure 4.3 (example 4.3)",
    shows="The book draws the smallest stake that is optimal of each capital. With 72 of the 99 there are others; to "
    "stake all, or all that is missing, always is one. With up to 12 dollars, with 25, 50 and 75, and from 88 on it is "
    "the only one.",
    experiment=_experiment,
    numbers=(
        # From the closed form of bold play, in decimals of 60 digits; the book prints no numbers.
        Number("1 sweep: v(50)", 0.4, EXACT, _v(1, 50)),
        Number("1 sweep: v(75)", 0.64, EXACT, _v(1, 75)),
        Number("1 sweep: v(25)", 0, EXACT, _v(1, 25)),
        Number("2 sweeps: v(25)", 0.16, EXACT, _v(2, 25)),
        Number("sweeps until no value changes by a millionth more", 11, EXACT, _sweeps_needed),
        Number("the last sweep: farthest from the exact values", 0, EXACT, _farthest),
        Number("capitals with several optimal stakes", 72, EXACT, _unsure),
        Number("capitals with which to stake all one can is optimal", 99, EXACT, _bold),
        Number("smallest optimal stake with 50 dollars", 50, EXACT, _smallest_stake(50)),
        Number("with 25 dollars", 25, EXACT, _smallest_stake(25)),
        Number("with 51 dollars", 1, EXACT, _smallest_stake(51)),
    ),
    draw=_draw,
)
