"""The eligibility trace of a state that is visited several times (Silver, lectures 4 and 5; book, section 12.2)."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxrl_tab.algorithms.traces import marked
from jaxrl_tab.core import credited
from jaxrl_tab.figures.figure import EXACT, Figure, Number

VISITS = (2, 5, 6, 7, 12, 16, 17)  # the steps at which the state is visited
STEPS = 26
FADES = 0.8  # gamma lambda
ALPHA = 0.3  # of which the dutch trace takes account
LOOK = {"accumulating": "-", "replacing": "--", "dutch": "-."}


def _experiment():
    return {"trace": lambda progress: _traces()}


def _traces():
    """The traces that the error of each step finds, by their kinds."""
    import xarray as xr

    z = [_trace(kind) for kind in LOOK]
    return xr.Dataset({"z": (("kind", "step"), z)}, {"kind": list(LOOK), "step": range(STEPS)})


def _trace(kind):
    """The trace of state 0, float [STEPS], kept as all methods keep it; where it is not visited, state 1 is."""

    def step(values, s):
        values = marked(values.begun(), kind, ALPHA, s, jnp.int32(0), jnp.zeros(()))
        return values.faded(jnp.asarray(FADES)), values.z[0, 0]

    states = jnp.where(np.isin(np.arange(STEPS), VISITS), 0, 1)
    return jax.lax.scan(step, credited.start(jnp.zeros((2, 1))), states)[1]


def _z(kind, step):
    return lambda datasets: datasets["trace"].z.sel(kind=kind, step=step).item()


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    ds = datasets["trace"]
    between = np.linspace(0, 1, 20)
    for (kind, dash), color in zip(LOOK.items(), plot.COLORS, strict=False):
        of_kind = ds.sel(kind=kind)
        x = (ds.step.values[:, None] + between).ravel()
        y = (of_kind.z.values[:, None] * FADES**between).ravel()
        ax.plot(x, y, color=color, ls=dash, lw=1.8, label=kind)
        ax.plot(VISITS, of_kind.z.sel(step=list(VISITS)), "o", color=color, ms=3.5)
    ax.vlines(VISITS, -0.32, -0.12, color=plot.INK, lw=1.8, label="a visit")
    plot.tidy(ax, "step", "trace z of the state")
    ax.set(xlim=(0, STEPS), ylim=(-0.4, None))
    plot.head(canvas, f"The trace of one state: γλ = {FADES}; dutch with α = {ALPHA}")
    plot.legend(ax)
    return canvas


ACCUMULATING, REPLACING, DUTCH = LOOK
FIGURE = Figure(
    title="The eligibility trace of a state: it jumps at each visit, and fades in between",
    source="Silver, lecture 4, eligibility traces; Sutton and Barto 2018, sections 12.2 and 12.5",
    shows="Frequency and recency in one number: an accumulating trace grows by 1 at each visit, so that soon repeated "
    "visits take it far above 1; a replacing trace begins again from 1; a dutch one lies in between, the nearer to "
    "replacing the larger α.",
    experiment=_experiment,
    numbers=(
        # By hand: the sum over visits of 0.8 to the steps since; the last visit alone; or the sum in which each
        # also has 0.7 = 1 - α as a factor for each visit after it.
        Number("accumulating: at the third visit in a row, step 7", 2.767680, EXACT, _z(ACCUMULATING, 7)),
        Number("accumulating: at step 11, four steps later", 1.133642, EXACT, _z(ACCUMULATING, 11)),
        Number("replacing: at step 7", 1, EXACT, _z(REPLACING, 7)),
        Number("replacing: at step 11", 0.4096, EXACT, _z(REPLACING, 11)),
        Number("dutch: at step 7", 1.985994, EXACT, _z(DUTCH, 7)),
        Number("dutch: at step 11", 0.813463, EXACT, _z(DUTCH, 11)),
    ),
    draw=_draw,
)
