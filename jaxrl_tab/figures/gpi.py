"""Generalized policy iteration: the book's 4 x 4 grid, and the lecture's zigzag from real numbers."""

import numpy as np

from jaxrl_tab.envs import Easy21, FiniteMDP
from jaxrl_tab.envs.base import COMPASS
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number

SIDE, MOVES = 4, COMPASS[:4]
UNIFORM = np.full((SIDE**2, len(MOVES)), 1 / len(MOVES))
INNER = np.arange(1, SIDE**2 - 1)  # the states that are not terminal
NEAR, FAR, CORNER = 1, 2, 3  # states of the first row: 1, 2 and 3 cells from the end
EXACTLY = "exact evaluation"
ONE = "1 sweep: value iteration"
SWEEPS = {EXACTLY: None, "10 sweeps": 10, "3 sweeps": 3, ONE: 1}
MARKS = dict(zip(SWEEPS, "os^.", strict=True))
ZIGZAGS = (EXACTLY, "3 sweeps", ONE)
LEAST = 1e-9  # errors below are drawn there
RANDOM = "random policy"
DRAWN = (2, 3, 10, np.inf)  # sweeps of evaluation
CELL = 0.5 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]])  # the corners, x and y
ARROW = {
    "angles": "xy",
    "scale_units": "xy",
    "scale": 1,
    "units": "xy",
    "width": 0.05,
    "headlength": 3,
    "headwidth": 3.5,
    "headaxislength": 3,
    "minlength": 0,
}


def grid() -> FiniteMDP:
    """The book's gridworld of figure 4.1: every step costs 1; two corners are the end; against the edge it stays."""
    cells = np.array(list(np.ndindex(SIDE, SIDE)))
    row, column = np.moveaxis(np.clip(cells[:, None] + np.array(MOVES), 0, SIDE - 1), -1, 0)
    entered = SIDE * row + column
    start = np.isin(np.arange(SIDE**2), INNER) / len(INNER)
    return FiniteMDP(
        np.eye(SIDE**2)[entered], -np.ones(entered.shape), terminal=[0, SIDE**2 - 1], start=start
    )


def _experiment():
    runs = {name: _iterates(sweeps) for name, sweeps in SWEEPS.items()}
    return {RANDOM: _evaluation, **runs}


def _iterates(sweeps):
    return lambda progress: planning.generalized_policy_iteration(Easy21(), sweeps=sweeps).to_xarray()


def _evaluation(progress):
    """v_k of the policy that takes any action, after k sweeps from 0 on; what is greedy to it, and its worth."""
    import xarray as xr

    env, v = grid(), [np.zeros(SIDE**2)]
    for _ in range(10):
        v.append(planning.evaluation_backup(env, v[-1], UNIFORM))
    v.append(planning.evaluate(env, UNIFORM).round(9))  # so that ties are ties
    greedy = planning.greedy_policy(planning.backup(planning.exact_model(env), np.stack(v), 1.0))
    variables = {
        "v": (("sweeps", "state"), v),
        "greedy": (("sweeps", "state", "action"), greedy),
        "greedy_value": (("sweeps", "state"), [planning.evaluate(env, policy) for policy in greedy]),
    }
    return xr.Dataset(variables, {"sweeps": [*np.arange(11.0), np.inf]})


def _v(sweeps, state):
    return lambda datasets: datasets[RANDOM].v.sel(sweeps=sweeps, state=state)


def _worth(sweeps):
    return lambda datasets: datasets[RANDOM].greedy_value.sel(sweeps=sweeps, state=INNER).mean()


def _at(run, what, n):
    return lambda datasets: datasets[run][what].isel(improvement=n)


def _improvements(datasets):
    return datasets[EXACTLY].sizes["improvement"] - 1


def _least(datasets):
    """Of v in any state, with exact evaluation: the policy improvement theorem."""
    return datasets[EXACTLY].least_change.min()


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 7.3)
    places = canvas.add_gridspec(3, 12, height_ratios=(2, 2, 1.6))
    farthest = 1.1 * max(float(datasets[name].zigzag.sum("distance").max()) for name in SWEEPS)
    for i, name in enumerate(ZIGZAGS):
        ax = canvas.add_subplot(places[0, 4 * i : 4 * i + 4])
        plot.zigzag(ax, datasets[name].zigzag.values, farthest, color=plot.COLORS[i])
        ax.set_title(name, fontsize=plot.TYPE)
    left = canvas.add_subplot(places[1, :6])
    right = canvas.add_subplot(places[1, 6:], sharey=left)
    _errors(left, datasets, lambda sweeps, n: n * (np.nan if sweeps is None else sweeps))
    _errors(right, datasets, lambda sweeps, n: n)
    plot.tidy(left, "sweeps", "largest |v − v*|")
    plot.tidy(right, "improvements", "")
    right.tick_params(labelleft=False)
    plot.legend(right, loc="upper right", bbox_to_anchor=(1, 1), ncols=1)
    for i, sweeps in enumerate(DRAWN):
        ax = canvas.add_subplot(places[2, 3 * i : 3 * i + 3])
        ds = datasets[RANDOM].sel(sweeps=sweeps)
        _values(ax, ds.v.values, ds.greedy.values)
        ax.set_title(f"k = {'∞' if sweeps == np.inf else int(sweeps)}", fontsize=plot.TYPE)
    what = "k sweeps of evaluating the random policy, and what is greedy to it"
    plot.head(canvas, f"Generalized policy iteration on Easy21; below, on the 4 × 4 grid,\n{what}")
    return canvas


def _errors(ax, datasets, of):
    """The error against what `of` makes of the sweeps of an evaluation and the number of improvements."""
    from jaxrl_tab.show import plot

    for name, sweeps in SWEEPS.items():
        error = datasets[name].error.values
        error = error[: 1 + np.argmax(error < LEAST)]
        style = {
            "color": plot.COLORS[[*ZIGZAGS, *SWEEPS].index(name)],
            "marker": MARKS[name],
            "ms": 3.5,
            "lw": 1.2,
        }
        ax.plot(of(sweeps, np.arange(len(error))), np.maximum(error, LEAST), label=name, **style)
    ax.set(yscale="log", ylim=(0.5 * LEAST, 2))
    ax.set_yticks([1, 1e-3, 1e-6, LEAST], ["1", "0.001", "$10^{-6}$", "less"])


def _values(ax, v, greedy):
    """A value in each cell, and below it the arrows of what is greedy to the values."""
    from jaxrl_tab.show import plot

    lines = np.arange(SIDE + 1) - 0.5
    ax.hlines(lines, -0.5, SIDE - 0.5, color=plot.GREY, lw=0.8)
    ax.vlines(lines, -0.5, SIDE - 0.5, color=plot.GREY, lw=0.8)
    for row, column in np.ndindex(SIDE, SIDE):
        s = SIDE * row + column
        if s not in INNER:
            ax.fill(column + CELL[0], row + CELL[1], color="#d8d8d8")
            continue
        style = {"ha": "center", "va": "center", "fontsize": plot.SMALL}
        ax.text(
            column, row - 0.25, (f"{v[s]:.1f}" if v[s] > -10 else f"{v[s]:.0f}").replace("-", "−"), **style
        )
        down, right = 0.24 * np.array(MOVES)[greedy[s] > 0].T
        at = np.full(len(down), column), np.full(len(down), row + 0.21)
        ax.quiver(*at, right, down, color=plot.COLORS[0], **ARROW)
    ax.set(xlim=(-0.52, SIDE - 0.48), ylim=(SIDE - 0.48, -0.52), aspect="equal")
    ax.axis("off")


FIGURE = Figure(
    title="Generalized policy iteration between its two lines, and the policies of the 4 × 4 grid",
    source="Sutton and Barto 2018, figure 4.1 and section 4.6; Silver 2015, lecture 3",
    shows="Improvement spoils the values, evaluation makes the policy fall short of greedy, and every round is "
    "smaller than the one before. Exact evaluation needs the fewest improvements, a single sweep the fewest sweeps. "
    "On the grid, what is greedy to the values of the random policy is the best after three sweeps already.",
    experiment=_experiment,
    numbers=(
        # By hand, or from plain loops; the book prints them with one decimal.
        Number("random policy, 2 sweeps: v beside the end", -1.75, EXACT, _v(2, NEAR), published="−1.7"),
        Number("3 sweeps: v beside the end", -2.4375, EXACT, _v(3, NEAR), published="−2.4"),
        Number("3 sweeps: v two cells from it", -2.9375, EXACT, _v(3, FAR), published="−2.9"),
        Number("10 sweeps: v beside the end", -6.137970, EXACT, _v(10, NEAR), published="−6.1"),
        Number("10 sweeps: v in the far corner", -8.967316, EXACT, _v(10, CORNER), published="−9.0"),
        Number("v_π beside the end", -14, EXACT, _v(np.inf, NEAR), published="−14"),
        Number("v_π two cells from it", -20, EXACT, _v(np.inf, FAR), published="−20"),
        Number("v_π in the far corner", -22, EXACT, _v(np.inf, CORNER), published="−22"),
        Number("greedy to 2 sweeps: mean value", -15 / 7, EXACT, _worth(2)),
        Number("greedy to 3 sweeps: mean value, the best", -2, EXACT, _worth(3)),
        # From plain loops over the rules of Easy21.
        Number("Easy21: improvements of policy iteration", 3, EXACT, _improvements),
        Number("Easy21: states that the last of them changes", 9, EXACT, _at(EXACTLY, "changed", 3)),
        Number("Easy21: largest error before it", 0.067948, EXACT, _at(EXACTLY, "error", 2)),
        Number("Easy21: the same of value iteration", 0.041745, EXACT, _at(ONE, "error", 2)),
        Number("Easy21: value from the start", 0.063076, EXACT, _at(EXACTLY, "start_value", 3)),
        Number("Easy21: least change by an improvement", -1e-12, 0, _least, "at least"),
    ),
    draw=_draw,
)
