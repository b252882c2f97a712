"""The cost to go of the mountain car as it is learned (book, figure 10.1)."""

from typing import Any

import numpy as np

from jaxrl_tab.approx import SemiGradientSarsa
from jaxrl_tab.approx.features import read
from jaxrl_tab.core.linear import Active
from jaxrl_tab.envs import MountainCar
from jaxrl_tab.figures.figure import Figure, Number, swept
from jaxrl_tab.figures.mountain_car_steps import FEATURES, GREEDY

CAR, ALPHA, STEPS, EPISODES = MountainCar(), 0.5, 428, (12, 104, 1000, 9000)
STEP = f"step {STEPS}"
BOTTOM = (-np.pi / 6, 0.0)  # where the car stands still in the valley
POINTS = 40  # along a number of the picture


def _experiment(num_seeds=20, most=EPISODES[-1]):
    grid = GREEDY | {"alpha": ALPHA}
    budgets = {STEP: {"num_steps": STEPS, "log_every": STEPS}}
    for n in EPISODES:
        budgets[f"episode {n}"] = {"num_episodes": min(n, most), "log_every": min(n, most)}
    return {
        name: swept(CAR, SemiGradientSarsa, grid, num_seeds=num_seeds, **budget)
        for name, budget in budgets.items()
    }


def _cost_to_go(w, position, velocity):
    """-max q(s, a), of weights [..., n, A] in states that are given by arrays of one shape: [..., *shape]."""
    import jax
    import jax.numpy as jnp

    features = read(FEATURES).ranged(CAR.low, CAR.high)
    states = np.stack([np.ravel(position), np.ravel(velocity)], -1).astype(np.float32)
    x = jax.vmap(features)(jnp.asarray(states))
    assert isinstance(x, Active)
    w = np.asarray(w)
    q = w[..., np.asarray(x.ones), :].sum(-2)
    return -q.max(-1).reshape(*w.shape[:-2], *np.shape(position))


def _at_the_bottom(name):
    """What it still costs from the bottom of the valley, of each seed."""
    return lambda datasets: _cost_to_go(datasets[name].q.values, *BOTTOM)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 5.0)
    position, velocity = np.meshgrid(
        *(np.linspace(a, b, POINTS) for a, b in zip(CAR.low, CAR.high, strict=True)), indexing="ij"
    )
    for i, (name, ds) in enumerate(datasets.items()):
        ax: Any = canvas.add_subplot(2, 3, i + 1, projection="3d")
        cost = _cost_to_go(ds.q.values[0], position, velocity)
        ax.plot_surface(
            position, velocity, cost, cmap="viridis", ec="#00000055", lw=0.2, rcount=40, ccount=40
        )
        ax.set_xticks((-1.2, 0.5))
        ax.set_yticks((-0.07, 0.07))
        ax.set_zticks((0, int(cost.max())))
        ax.set_xlabel("position", labelpad=-6, fontsize=plot.SMALL)
        ax.set_ylabel("velocity", labelpad=-6, fontsize=plot.SMALL)
        ax.tick_params(labelsize=plot.SMALL, pad=-2)
        ax.set_title(name, fontsize=plot.TYPE)
    plot.head(canvas, f"Mountain car: the cost to go, −max q(s, a), of one run with α = {ALPHA}/8")
    return canvas


FIGURE = Figure(
    title="The cost to go of the mountain car",
    source="Sutton and Barto 2018, figure 10.1",
    shows="In the first episode, whose end no step has seen yet, the valley is worse than what nobody has visited, "
    "which drives the car out of it, though ε is 0. Later the cost spirals up to the states from which the car "
    "must swing back once more. The book does not say its step size.",
    experiment=_experiment,
    small={"num_seeds": 2, "most": 5},
    numbers=(
        # From 1000 runs of a plain loop in float64 (of 1000 episodes 300, of 9000 episodes 60).
        Number(f"cost to go from the bottom after {STEP}", 6.834, 0.049, _at_the_bottom(STEP)),
        *(
            Number(f"the same after episode {n}", expected, error, _at_the_bottom(f"episode {n}"))
            for n, expected, error in (
                (12, 40.58, 0.12),
                (104, 90.418, 0.058),
                (1000, 113.67, 0.10),
                (9000, 115.18, 0.23),
            )
        ),
    ),
    draw=_draw,
)
