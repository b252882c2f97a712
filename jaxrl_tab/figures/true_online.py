"""True online TD(lambda) on a random task with tabular features (van Seijen et al. 2016).

The task is the one that the authors' public program draws. The paper of 2014, which introduced the method, has walks
alone, whose states share features.
"""

import jax.numpy as jnp
import numpy as np

from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

STATES, BRANCHES, NOISE, SEED = 10, 3, 0.1, 1000
GAMMA, STEPS = 0.99, 100
LAMBDAS = (0.0, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)
ALPHAS = (0.02, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0, 1.4)
METHODS = {
    "accumulating": ("td-lambda", {}),
    "replacing": ("td-lambda", {"trace": "replacing"}),
    "true online": ("true-online-td-lambda", {}),
}
ACCUMULATING, REPLACING, TRUE = METHODS
SHOWN, BOTTOM, TOP = 0.9, 0.6, 1.05  # the lambda of the second picture, and both ends of its errors


def task():
    """The chances [S, S] and rewards [S, S] of the random task of the authors' program, drawn as it draws them."""
    random = np.random.RandomState(SEED)
    p = np.zeros((STATES, STATES))
    for s in range(STATES):
        into = random.choice(range(STATES), BRANCHES, replace=False)
        cuts = np.sort(random.uniform(0, 1, BRANCHES - 1))
        p[s, into] = np.diff([0, *cuts, 1])
    return p, random.normal(0, 1, (STATES, STATES))


def _env():
    """The task with noise: a reward is higher or lower by its standard deviation, each with probability 1/2.

    V is linear in the rewards, so that its mean squared error is the same as under normal noise.
    """
    p, r = task()
    outcomes = [
        [[(p[s, k] / 2, k, r[s, k] + sign * NOISE, False) for k in np.flatnonzero(p[s]) for sign in (-1, 1)]]
        for s in range(STATES)
    ]
    return FiniteMDP.from_outcomes(outcomes, start=np.eye(STATES)[0], max_steps=10**6)


def _truth():
    """The values v and how often the states are visited in the long run, d, float64 [S] each."""
    p, r = task()
    v = np.linalg.solve(np.eye(STATES) - GAMMA * p, (p * r).sum(1))
    d = np.linalg.lstsq(np.vstack([p.T - np.eye(STATES), np.ones(STATES)]), np.eye(STATES + 1)[-1])[0]
    return v, d


def _average_reward():
    """What a step earns in the long run."""
    p, r = task()
    return _truth()[1] @ (p * r).sum(1)


def _experiment(num_seeds=200):
    budget = {"num_seeds": num_seeds, "num_steps": STEPS, "log_every": 1, "record": _error}
    grid = {"lam": list(LAMBDAS), "alpha": list(ALPHAS), "gamma": GAMMA}
    return {name: swept(_env(), method, grid | own, **budget) for name, (method, own) in METHODS.items()}


def _error(learner):
    """The mean of (V - v)^2 over the visits of states, as a part of that of v^2."""
    v, d = _truth()
    weights = jnp.asarray(d / (d * v**2).sum(), learner.q.dtype)
    return {"mse": (weights * (learner.q[:, 0] - jnp.asarray(v, learner.q.dtype)) ** 2).sum()}


def _mse(name, **setting):
    return lambda datasets: datasets[name].mse.sel(setting).mean("row")


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    by_lambda, by_alpha = canvas.subplots(1, 2)
    at = np.arange(len(LAMBDAS))
    for name, color, marker in zip(METHODS, plot.COLORS, plot.MARKERS, strict=False):
        mse = datasets[name].mse.mean("row", skipna=False)
        best = mse.mean("seed", skipna=False).fillna(np.inf).argmin("alpha")
        plot.mean_curve(by_lambda, at, mse.isel(alpha=best).rename(lam="row"), name, color, marker=marker)
        of_alpha = mse.sel(lam=SHOWN).rename(alpha="row")
        seen = of_alpha.isel(row=(of_alpha.mean("seed") < 2 * TOP).values)
        plot.mean_curve(by_alpha, seen.row, seen, name, color, marker=marker)
    by_lambda.set_xticks(at, [f"{lam:g}" for lam in LAMBDAS])
    plot.tidy(by_lambda, "λ, each with its best step size α", f"mean squared error, {STEPS} steps")
    plot.tidy(by_alpha, f"step size α, λ = {SHOWN:g}", "")
    by_alpha.set(ylim=(BOTTOM, TOP))
    plot.legend(by_lambda)
    seeds = datasets[TRUE].sizes["seed"]
    plot.head(canvas, f"TD(λ) on a random task of {STATES} states: mean and 95% interval, {seeds} seeds")
    return canvas


FIGURE = Figure(
    title="True online TD(λ) on a random task",
    source="van Seijen, Mahmood, Pilarski, Machado and Sutton 2016, the small random task with tabular features",
    shows="What long traces are good for depends on how they are kept. Accumulating ones bear small step sizes alone, "
    "so that a large λ gains nothing; replacing ones gain much, and true online TD(λ) more, with large steps as well.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # By another program, which draws the same task. The others over 200 000 runs of a plain loop, with normal
        # noise; the paper prints curves alone.
        Number("average reward", -0.185384, EXACT, lambda datasets: _average_reward()),
        *(
            Number(f"{name}, λ = {lam:g}, α = {alpha:g}", expected, error, _mse(name, lam=lam, alpha=alpha))
            for name, lam, alpha, expected, error in (
                (ACCUMULATING, 0.8, 0.15, 0.89500, 1.7e-4),
                (ACCUMULATING, 0.9, 0.1, 0.89775, 1.9e-4),
                (REPLACING, 0.9, 0.4, 0.81803, 2.7e-4),
                (REPLACING, 1.0, 0.8, 0.70952, 5.2e-4),
                (TRUE, 0.8, 0.4, 0.79534, 3.3e-4),
                (TRUE, 0.95, 0.4, 0.67093, 6.0e-4),
                (TRUE, 0.99, 0.3, 0.67005, 7.0e-4),
            )
        ),
    ),
    draw=_draw,
)
