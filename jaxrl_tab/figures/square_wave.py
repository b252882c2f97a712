"""How wide features are, and how that shows early and late: the square wave (book, figure 9.8)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrl_tab import approx
from jaxrl_tab.approx.features import read
from jaxrl_tab.core import linear
from jaxrl_tab.envs.square_wave import EXTENT, SquareWave, wave
from jaxrl_tab.figures.figure import Figure, Number, swept

# Intervals 0.04 apart, so that there are 50 of them on the way from 0 to 2; as wide as a tile of as many tilings.
WIDTHS = {"narrow": "tile-coding(5, 10)", "medium": "tile-coding(10, 5)", "broad": "tile-coding(25, 2)"}
WIDE = {"narrow": 0.2, "medium": 0.4, "broad": 1.0}
ALPHA = 0.2
EXAMPLES = (10, 40, 160, 640, 2560, 10240)
POINTS = (np.arange(200) + 0.5) / 100  # at which the function is looked at


def _experiment(num_seeds=200, num_steps=EXAMPLES[-1]):
    budget = {"num_seeds": num_seeds, "num_steps": num_steps, "log_every": 10}
    run = lambda features: swept(
        SquareWave(), approx.SemiGradientTD, _grid(features), **budget, record=_function(features)
    )
    return {name: run(features) for name, features in WIDTHS.items()}


def _grid(features):
    return {"features": features, "alpha": ALPHA, "per_tiling": True}


def _function(features):
    """What is recorded: the function that is learned, at all points."""
    x: Any = read(features).ranged((0.0,), (EXTENT,))

    def values(learner):
        at = jax.vmap(x)(jnp.asarray(POINTS, learner.q.dtype)[:, None])
        return {"values": jax.vmap(linear.row, (None, 0))(learner.q, at)[:, 0]}

    return values


def _target():
    return np.asarray(wave(jnp.asarray(POINTS)))


def _after(ds, examples):
    return ds["values"].isel(row=min(examples // ds.attrs["log_every"], ds.sizes["row"]) - 1)


def _error(name, examples):
    """The root of the mean squared error over the points, of each seed."""
    return lambda datasets: np.sqrt(((_after(datasets[name], examples) - _target()) ** 2).mean("values_0"))


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 6.4)
    grid = canvas.subplots(len(EXAMPLES), len(WIDTHS), sharex=True, sharey=True)
    for row, examples in zip(grid, EXAMPLES, strict=True):
        for ax, (name, ds) in zip(row, datasets.items(), strict=True):
            ax.plot(POINTS, _target(), color=plot.GREY, lw=1, ls=":")
            ax.plot(POINTS, _after(ds, examples).isel(seed=0), color=plot.COLORS[0], lw=1.4)
            ax.plot([0.1, 0.1 + WIDE[name]], [1.25, 1.25], color=plot.COLORS[1], lw=2, clip_on=False)
            ax.set(ylim=(-0.3, 1.4), xlim=(0, EXTENT), yticks=[0, 1], xticks=[0, 1, 2])
            ax.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel(f"{examples:,}", rotation=0, ha="right", va="center")
    for ax, name in zip(grid[0], datasets, strict=True):
        plot.axes_title(ax, f"{name}: {WIDE[name]:g} wide")
    plot.head(canvas, "The square wave after so many examples, and how wide a feature is: one run")
    return canvas


FIGURE = Figure(
    title="How wide features are: early and late",
    source="Sutton and Barto 2018, figure 9.8",
    shows="After few examples the function is as bumpy as its features are narrow; how fine it can become in the end "
    "depends little on their width, for it is how many there are that tells numbers apart.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_steps": 100},
    numbers=tuple(
        # From 2000 runs of a plain loop; the book has pictures.
        Number(f"{name}: RMS error after {examples:,} examples", expected, error, _error(name, examples))
        for name, examples, expected, error in (
            ("narrow", 10, 0.59274, 7.5e-4),
            ("narrow", 160, 0.14153, 2.1e-4),
            ("narrow", 10240, 0.10598, 9.9e-5),
            ("medium", 10, 0.51183, 1.2e-3),
            ("medium", 160, 0.16419, 1.6e-4),
            ("medium", 10240, 0.10678, 1.1e-4),
            ("broad", 10, 0.41299, 1.3e-3),
            ("broad", 160, 0.18266, 1.9e-4),
            ("broad", 10240, 0.10530, 1.4e-4),
        )
    ),
    draw=_draw,
)
