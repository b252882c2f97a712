"""A problem of the ten-armed testbed: the rewards of each arm (book, section 2.3)."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxrl_tab.core import rng
from jaxrl_tab.envs import KArmedTestbed
from jaxrl_tab.figures.figure import EXACT, Figure, Number

PROBLEMS = 10_000


def _experiment(num_problems=PROBLEMS):
    return {"problems": lambda progress: _problems(num_problems)}


def _problems(count):
    """The means of the arms of some problems, and a reward of each, by the environment's own step."""
    import xarray as xr

    env = KArmedTestbed()
    arms, start = jnp.arange(env.arms, dtype=jnp.int32), jnp.int32(0)

    def one(key):
        problem = env.instance(jax.random.fold_in(key, 0))
        keys = jax.random.split(jax.random.fold_in(key, 1), env.arms)
        return problem.means, jax.vmap(lambda key, a: problem.step(key, start, a).reward)(keys, arms)

    keys = jax.vmap(lambda i: jax.random.fold_in(rng.key(0), i))(jnp.arange(count))
    means, rewards = jax.jit(jax.vmap(one))(keys)
    return xr.Dataset({"means": (("seed", "arm"), means), "rewards": (("seed", "arm"), rewards)})


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 3.4)
    ax = canvas.subplots()
    means = datasets["problems"].means.isel(seed=0).values
    x = np.linspace(-3, 3, 121)
    density = np.exp(-(x**2) / 2)
    for a, mean in enumerate(means, 1):
        color = plot.COLORS[0] if mean < means.max() else plot.COLORS[1]
        ax.fill_betweenx(mean + x, a - 0.4 * density, a + 0.4 * density, color=color, alpha=0.35, lw=0)
        ax.hlines(mean, a - 0.4, a + 0.4, color=color, lw=1.8)
        ax.annotate(f"{mean:.2f}".replace("-", "−"), (a, mean), (0, 3), textcoords="offset points", ha="center",
                    fontsize=plot.SMALL)  # fmt: skip
    ax.axhline(0, color=plot.INK, lw=0.8, ls=":")
    ax.set_xticks(range(1, len(means) + 1))
    plot.tidy(ax, "arm", "reward")
    plot.head(canvas, "The problem of seed 0: each arm's mean q*(a), and the density of its rewards")
    return canvas


def _noise(datasets):
    """The mean square of reward less mean, of each problem."""
    ds = datasets["problems"]
    return ((ds.rewards - ds.means) ** 2).mean("arm")


FIGURE = Figure(
    title="A problem of the ten-armed testbed",
    source="Sutton and Barto 2018, figure 2.1",
    shows="The means of the arms are drawn from N(0, 1), once for a problem, and each reward from N(q*(a), 1): most of "
    "what an arm gives at a time is luck.",
    experiment=_experiment,
    small={"num_problems": 2},
    numbers=(
        # By definition, and by integration.
        Number(
            "mean of the best arm", 1.538753, EXACT, lambda datasets: datasets["problems"].means.max("arm")
        ),
        Number(
            "variance of the means",
            1.0,
            EXACT,
            lambda datasets: (datasets["problems"].means ** 2).mean("arm"),
        ),
        Number("variance of the rewards of an arm", 1.0, EXACT, _noise),
    ),
    draw=_draw,
)
