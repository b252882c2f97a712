"""The short corridor: the best policy may have to be stochastic (book, example 13.1)."""

import numpy as np

from jaxrl_tab.envs import ShortCorridor
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number

BEST = 2 - 2**0.5  # the probability of right
EPSILON = 0.1
LEFT, RIGHT = EPSILON / 2, 1 - EPSILON / 2  # of right, where the greedy action is left, or right


def _experiment():
    return {"values": lambda progress: _values()}


def _values():
    """The value of the start for some probabilities of right, exactly."""
    import xarray as xr

    probabilities = np.unique([*np.linspace(0.02, 0.98, 97), LEFT, BEST, RIGHT])
    return xr.Dataset({"value": ("right", [_value(p) for p in probabilities])}, {"right": probabilities})


def _value(right):
    env = ShortCorridor()
    return planning.policy_value(env, np.tile([1 - right, right], (env.num_states, 1)))


def _at(right):
    return lambda datasets: datasets["values"].value.sel(right=right).item()


def _best(datasets):
    return datasets["values"].value.max().item()


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    ds = datasets["values"]
    ax.plot(ds.right, ds.value, color=plot.COLORS[0], lw=1.8)
    marks = {"ε-greedy, left": LEFT, "best stochastic policy": BEST, "ε-greedy, right": RIGHT}
    for (name, p), color, ha in zip(
        marks.items(), plot.COLORS[1:], ("left", "center", "right"), strict=False
    ):
        value = ds.value.sel(right=p).item()
        ax.plot(p, value, "o", color=color)
        text = f"{name}: {value:.1f}".replace("-1", "−1").replace(" -", " −")
        above = 10 if ha == "center" else -2
        ax.annotate(text, (p, value), (8 * (ha == "left") - 8 * (ha == "right"), above), ha=ha,
                    textcoords="offset points", fontsize=plot.SMALL)  # fmt: skip
    plot.tidy(ax, "probability of right", "value of the start")
    ax.set(xlim=(0, 1), ylim=(-100, 0))
    plot.head(canvas, "Short corridor, all states look the same: exact values")
    return canvas


FIGURE = Figure(
    title="The short corridor: the best policy is stochastic",
    source="Sutton and Barto 2018, example 13.1",
    shows="Where three states look the same and right is sometimes left, neither always right nor always left arrives. "
    "An ε-greedy policy can only be near one of the two; a softmax of preferences can be anything between them.",
    experiment=_experiment,
    numbers=(
        # -2 (2 - p) / (p (1 - p)), the solution of the three equations, is largest at p = 2 - sqrt(2).
        Number("best stochastic policy", -(6 + 4 * 2**0.5), EXACT, _best, published="−11.6"),
        Number("ε-greedy with ε = 0.1, left", -82.105263, 2e-6, _at(LEFT), published="−82"),
        Number("ε-greedy with ε = 0.1, right", -44.210526, 2e-6, _at(RIGHT), published="−44"),
    ),
    draw=_draw,
)
