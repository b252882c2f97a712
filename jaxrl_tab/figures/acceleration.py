"""Fewer sweeps: value iteration, plain, anchored and Anderson's, beside modified and exact policy iteration."""

import numpy as np

from jaxrl_tab.envs import FiniteMDP, FrozenLake
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number

LAKE, LAKE_GAMMA = FrozenLake(map_name="8x8"), 0.99
RING, RING_GAMMA, RING_SWEEPS = 50, 0.999, 700
PLAIN, ANCHORED, ANDERSON, MODIFIED, EXACTLY = (
    "value iteration",
    "anchored",
    "Anderson",
    "modified, 5 sweeps",
    "policy iteration",
)
WAYS = {PLAIN: "plain", ANCHORED: "anchored", ANDERSON: "anderson"}
SWEEPS = 5
LEAST = 1e-9  # errors below are drawn there


def ring() -> FiniteMDP:
    """One way round, and 1 for each lap: values are carried round by sweeps, one state further with each."""
    onward = np.eye(RING)[(np.arange(RING) + 1) % RING]
    return FiniteMDP(onward[:, None], np.eye(RING)[:, :1], terminal=[])


def _experiment():
    lake = {name: lambda progress, by=by: _swept(LAKE, LAKE_GAMMA, by, 10_000) for name, by in WAYS.items()}
    policies = {MODIFIED: lambda progress: _policies(SWEEPS), EXACTLY: lambda progress: _policies(None)}
    rings = {
        f"ring, {name}": lambda progress, by=by: _swept(ring(), RING_GAMMA, by, RING_SWEEPS)
        for name, by in WAYS.items()
    }
    return {**lake, **policies, **rings}


def _swept(env, gamma, by, most):
    import xarray as xr

    found = planning.accelerated_value_iteration(env, gamma, by, max_sweeps=most)
    return xr.Dataset({"error": ("sweep", found.error), "residual": ("sweep", found.residual)})


def _policies(sweeps):
    found = planning.generalized_policy_iteration(LAKE, LAKE_GAMMA, sweeps=sweeps)
    return found.to_xarray()[["error"]].rename(improvement="sweep")


def _reached(name, error, each=1):
    """After how many sweeps the error is that small."""
    return lambda datasets: each * int((datasets[name].error.values > error).sum())


def _residual(name, sweeps):
    """The Bellman error of the values after so many sweeps of the ring."""
    return lambda datasets: datasets[f"ring, {name}"].residual.isel(sweep=sweeps)


def _of_bound(datasets):
    """The largest ratio of the Bellman error to what the theorem allows."""
    ds = datasets[f"ring, {ANCHORED}"]
    power = RING_GAMMA ** np.arange(2, RING_SWEEPS + 2)
    allowed = (1 / RING_GAMMA - RING_GAMMA) * (1 + 2 * RING_GAMMA - power) / (1 / power - power)
    return (ds.residual.values[1:] / allowed / ds.error.values[0]).max()


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.5)
    left, right = canvas.subplots(1, 2)
    names = (PLAIN, ANCHORED, ANDERSON, MODIFIED, EXACTLY)
    looks = dict(zip(names, zip(plot.COLORS, plot.DASHES * 2, strict=False), strict=False))
    for name, (color, dash) in looks.items():
        error = datasets[name].error.values
        error = np.maximum(error[: 1 + np.argmax(error < LEAST)], LEAST)
        each = SWEEPS if name == MODIFIED else 1
        marker = {"marker": "o", "ms": 3} if name == EXACTLY else {}
        left.plot(each * np.arange(len(error)), error, color=color, ls=dash, lw=1.5, label=name, **marker)
        residual = datasets[f"ring, {name}"].residual.values[: RING_SWEEPS + 1] if name in WAYS else []
        right.plot(np.maximum(residual, LEAST), color=color, ls=dash, lw=1.5, label=name, **marker)
    for ax, ylabel in ((left, "largest |v − v*|"), (right, "Bellman error, largest |Tv − v|")):
        plot.tidy(ax, "sweeps", ylabel)
        ax.set(yscale="log", ylim=(0.5 * LEAST, 3), xlim=(0, 700))
        ax.set_yticks([1, 1e-3, 1e-6, LEAST], ["1", "0.001", "$10^{-6}$", "less"])
    plot.axes_title(left, f"Frozen lake 8x8, γ = {LAKE_GAMMA:g}")
    plot.axes_title(right, f"A ring of {RING} states, γ = {RING_GAMMA:g}")
    plot.legend(right, loc="lower right", bbox_to_anchor=(1, 0.05), ncols=1)
    return canvas


FIGURE = Figure(
    title="Fewer sweeps: Anderson's and anchored value iteration",
    source="Lee and Ryu 2023, Accelerating value iteration with anchoring; Geist and Scherrer 2018",
    shows="On the lake Anderson's mixture of earlier sweeps needs a third of the sweeps of value iteration, policy "
    "iteration two improvements with exact evaluations (dots), and the anchor slows things down. On the ring, where "
    "sweeps carry values round and round, the anchor keeps what it promises: a Bellman error that is soon small.",
    experiment=_experiment,
    numbers=(
        # Counted by plain loops: of the lake over Gymnasium's own table of it.
        Number("lake, value iteration: sweeps to 0.001", 259, EXACT, _reached(PLAIN, 1e-3)),
        Number("lake, value iteration: sweeps to a millionth", 479, EXACT, _reached(PLAIN, 1e-6)),
        Number("lake, anchored: sweeps to a millionth", 745, EXACT, _reached(ANCHORED, 1e-6)),
        Number("lake, modified: sweeps to a millionth", 485, EXACT, _reached(MODIFIED, 1e-6, SWEEPS)),
        Number("lake, Anderson: sweeps to a millionth", 240, 0, _reached(ANDERSON, 1e-6), "at most"),
        Number("lake, policy iteration: improvements", 10, 0, _reached(EXACTLY, 1e-6), "at most"),
        # γ to the power of the sweep, by hand; the bound of Lee and Ryu (their theorem 2) for v_0 = 0.
        Number(
            "ring, value iteration: Bellman error after 300 sweeps",
            RING_GAMMA**300,
            EXACT,
            _residual(PLAIN, 300),
        ),
        Number(
            "ring, anchored: Bellman error after 300 sweeps", 0.0198144254, EXACT, _residual(ANCHORED, 300)
        ),
        Number("ring, anchored: how much of its bound that is, at most", 1, 0, _of_bound, "at most"),
    ),
    draw=_draw,
)
