"""Speedy Q-learning: how fast the error falls where all pairs learn at the same time (Azar et al. 2011)."""

import numpy as np

from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import Figure, Number

GAMMA, STATES, ACTIONS, BRANCHES = 0.95, 30, 4, 3
ITERATIONS = 1000
POWER = 0.75
METHODS = ("Q-learning, 1/(k + 1)", f"Q-learning, 1/(k + 1)^{POWER}", "speedy Q-learning")


def _task():
    """A garnet: of each pair three states follow, drawn at random. (s' [S, A, K], probabilities, rewards [S, A])"""
    rand = np.random.default_rng(2011)
    follow = [[rand.choice(STATES, BRANCHES, replace=False) for _ in range(ACTIONS)] for _ in range(STATES)]
    return (
        np.array(follow),
        rand.dirichlet(np.ones(BRANCHES), (STATES, ACTIONS)),
        rand.random((STATES, ACTIONS)),
    )


def _experiment(num_seeds=100, iterations=ITERATIONS):
    return {"errors": lambda progress: _errors(num_seeds, iterations)}


def _best(follow, prob, reward):
    """The exact q*, [S, A]."""
    p = np.zeros((STATES, ACTIONS, STATES))
    np.put_along_axis(p, follow, prob, 2)
    return planning.value_iteration(FiniteMDP(p, reward), GAMMA)[1]


def _errors(num_seeds, iterations):
    """The largest |Q - q*| after each iteration, in which all pairs learn from one outcome each: the same for all."""
    import xarray as xr

    follow, prob, reward = _task()
    best, edges = _best(follow, prob, reward), prob.cumsum(2)[..., :-1]
    pairs, rand = np.indices((STATES, ACTIONS)), np.random.default_rng(0)
    plain, slow, speedy, before = np.zeros((4, num_seeds, STATES, ACTIONS))
    errors = np.zeros((num_seeds, iterations, len(METHODS)))
    for k in range(iterations):
        drawn = (rand.random((num_seeds, STATES, ACTIONS, 1)) >= edges).sum(-1)
        s_next = follow[(*pairs, drawn)]

        def target(q, s_next=s_next):
            return reward + GAMMA * np.take_along_axis(q.max(2), s_next.reshape(num_seeds, -1), 1).reshape(
                s_next.shape
            )

        alpha = 1 / (k + 1)
        plain = plain + alpha * (target(plain) - plain)
        slow = slow + alpha**POWER * (target(slow) - slow)
        now, last = target(speedy), target(before)
        before, speedy = speedy, speedy + alpha * (last - speedy) + (1 - alpha) * (now - last)
        for i, q in enumerate((plain, slow, speedy)):
            errors[:, k, i] = abs(q - best).max((1, 2))
    return xr.Dataset(
        {"error": (("seed", "iteration", "method"), errors)}, {"iteration": np.arange(1, iterations + 1)}
    )


def _after(iterations, method):
    """The error after so many iterations, or after all where there are fewer."""

    def measure(datasets):
        ds = datasets["errors"]
        return ds.error.isel(iteration=min(iterations, ds.sizes["iteration"]) - 1, method=method)

    return measure


def _draw(datasets):
    from jaxrl_tab.show import plot

    ds = datasets["errors"]
    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for i, (name, color) in enumerate(zip(METHODS, plot.COLORS, strict=False)):
        plot.mean_curve(ax, ds.iteration, ds.error.isel(method=i).rename(iteration="row"), name, color)
    ax.set(xscale="log", yscale="log")
    plot.tidy(ax, "iterations", "largest |Q − q*|")
    plot.head(canvas, f"A random MDP of {STATES} states, γ = {GAMMA}", ds.sizes["seed"])
    plot.legend(ax)
    return canvas


FIGURE = Figure(
    title="Speedy Q-learning",
    source="Azar, Munos, Ghavamzadeh and Kappen 2011, algorithm 1 and figure 1; in a task of ours",
    shows="Where all pairs learn at the same time, from one outcome each, Q-learning with the step size 1/(k + 1) "
    "hardly gets on, for gamma is near 1; speedy Q-learning does, which takes over at once what the last iteration has "
    "changed. It is no method here: where pairs learn one by one, as they are visited, there are no last two "
    "iterations. With what stood in an entry before its last update instead, a change is taken over again and again, "
    "and Q diverges.",
    experiment=_experiment,
    small={"num_seeds": 2, "iterations": 20},
    numbers=(
        # From 2000 runs of a plain loop.
        Number(f"{METHODS[0]}: error after 1000 iterations", 11.436177, 0.000530, _after(1000, 0)),
        Number(f"{METHODS[1]}: error after 1000 iterations", 6.415952, 0.000660, _after(1000, 1)),
        Number(f"{METHODS[2]}: error after 100 iterations", 3.235181, 0.002927, _after(100, 2)),
        Number(f"{METHODS[2]}: error after 1000 iterations", 0.346944, 0.001161, _after(1000, 2)),
    ),
    draw=_draw,
)
