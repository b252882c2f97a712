"""Posterior sampling in river swim: regret over time (Osband, Russo and Van Roy 2013; Agrawal and Jia 2017)."""

from jaxrl_tab.envs import RiverSwim
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import Figure, Number, swept

GAMMA, EVERY, SAMPLES = 0.95, 20, 5
CAREFUL, HASTY = 30.0, 10.0  # visits that make a pair known, of R-max
STEPS, ROW = 20_000, 200
LOST = 1000  # regret that only those have who stay at the bank
HIGHEST = 1 / (1 - GAMMA)
RIVER = RiverSwim(variant="osband", max_steps=STEPS + 1)  # nothing is cut off
ONE, BEST_OF, R_MAX, Q_LEARNING = "psrl", "several-samples", "r-max", "q-learning"


def _experiment(num_seeds=150):
    budget = {"num_seeds": num_seeds, "num_steps": STEPS, "log_every": ROW}
    grids = {
        ONE: {"every": EVERY},
        BEST_OF: {"every": EVERY, "samples": SAMPLES},
        R_MAX: {"q0": HIGHEST, "m": [HASTY, CAREFUL]},
        Q_LEARNING: {"q0": [0.0, HIGHEST], "alpha": 0.1, "epsilon": 0.1},
    }
    names = {BEST_OF: "psrl"}
    return {
        name: swept(RIVER, names.get(name, name), {"gamma": GAMMA, **grid}, **budget)
        for name, grid in grids.items()
    }


def _best():
    """The largest average reward of a step."""
    return planning.relative_value_iteration(RIVER)[0]


def _regret(ds, **setting):
    """By how much each seed has earned less than the best policy does on average, after each row."""
    return ROW * _best() * (ds.row + 1) - ds.rewards.sel(setting).cumsum("row")


def _total(name, **setting):
    return lambda datasets: _regret(datasets[name], **setting).isel(row=-1)


def _in_the_second_half(datasets):
    regret = _regret(datasets[ONE])
    return regret.isel(row=-1) - regret.isel(row=STEPS // ROW // 2 - 1)


def _lost(datasets):
    """Whether each seed of R-max with the small m never found the large reward, 0 or 1."""
    return (_total(R_MAX, m=HASTY)(datasets) > LOST).astype(float)


def _draw(datasets):
    from jaxrl_tab.show import plot

    curves = [
        ("Q-learning, from Q = 0", _regret(datasets[Q_LEARNING], q0=0.0), {}),
        ("Q-learning, from Q = 20", _regret(datasets[Q_LEARNING], q0=HIGHEST), {}),
        (f"R-max, m = {HASTY:g}", _regret(datasets[R_MAX], m=HASTY), {"ls": "--"}),
        (f"R-max, m = {CAREFUL:g}", _regret(datasets[R_MAX], m=CAREFUL), {}),
        ("posterior sampling", _regret(datasets[ONE]), {}),
        (f"best of {SAMPLES} samples", _regret(datasets[BEST_OF]), {"ls": "--"}),
    ]
    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    colors = (plot.INK, *(plot.COLORS[i] for i in (0, 1, 1, 2, 2)))
    for (name, regret, look), color in zip(curves, colors, strict=True):
        plot.mean_curve(ax, ROW * (regret.row + 1), regret, name, color, **look)
    plot.tidy(ax, "steps", "regret")
    ax.set(xlim=(0, STEPS), yscale="log", ylim=(50, 2e4))
    plot.legend(ax)
    plot.head(canvas, f"River swim, γ = {GAMMA}", datasets[ONE].sizes["seed"])
    return canvas


FIGURE = Figure(
    title="Exploring by posterior sampling",
    source="Osband, Russo and Van Roy 2013, section 6; Agrawal and Jia 2017; Brafman and Tennenholtz 2002",
    shows="Who explores by chance stays at the bank, and loses with each step what the large reward up the river would "
    "pay. R-max swims there, and pays for trying everything m times; where m is too small, some runs never find out "
    "what the river is worth. Posterior sampling tries what may still be best, and its regret hardly grows in the end. "
    "The best of several samples explores sooner, and a little longer.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # From 500 to 3000 runs of plain loops, which draw gamma variables as NumPy does.
        Number("posterior sampling: regret", 187.26, 2.08, _total(ONE)),
        Number("posterior sampling: regret, second half", 13.6, 1.4, _in_the_second_half),
        Number(f"best of {SAMPLES} samples: regret", 211.46, 5.09, _total(BEST_OF)),
        Number("R-max, m = 30: regret", 271.97, 1.89, _total(R_MAX, m=CAREFUL)),
        Number("R-max, m = 10: share of runs that stay at the bank", 0.0553, 0.0042, _lost),
        Number("Q-learning from Q = 0: regret", 8000, 0, _total(Q_LEARNING, q0=0.0), "at least"),
    ),
    draw=_draw,
)
