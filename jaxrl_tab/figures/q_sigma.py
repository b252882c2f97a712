"""Q(sigma) between tree backup and sampling, with and without control variates (De Asis et al. 2018; book, 7.6).

The task and its settings, n = 3, alpha = 0.4, gamma = 1 and sigma times .95 with each episode, are the paper's, as two
public programs that repeat its experiment have them, too. How many episodes its curves show was not found out.
"""

import jax.numpy as jnp
import numpy as np

from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.schedules import Exponential
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.figures.figure import Figure, Number, swept

STATES, N, ALPHA, EPISODES = 19, 3, 0.4, 50
SIGMAS = (0.0, 0.25, 0.5, 0.75, 1.0)
DYNAMIC = Exponential(1.0, 0.95, clock="episode")
AS_DRAWN, OF_THE_BOOK = "as drawn", "control variates"
FORMS = {AS_DRAWN: False, OF_THE_BOOK: True}


def walk():
    """The random walk of 19 states with two actions, left and right, of which both ends are terminal."""
    last = STATES + 1
    p, r = np.zeros((last + 1, 2, last + 1)), np.zeros((last + 1, 2, last + 1))
    for s in range(1, last):
        p[s, (0, 1), (s - 1, s + 1)] = 1
    r[:, :, 0], r[:, :, last] = -1, 1
    return FiniteMDP(p, r, terminal=[0, last], start=np.eye(last + 1)[last // 2], max_steps=10**5)


def _experiment(num_seeds=100, num_episodes=EPISODES):
    env = walk()
    acts = Table(np.full((env.num_states, 2), 0.5))
    fixed = {"n": N, "alpha": ALPHA, "behaviour": acts}

    def run(sigma, form):
        grid = {**fixed, "sigma": sigma, "control_variates": FORMS[form]}
        return swept(env, "q-sigma", grid, num_seeds=num_seeds, num_episodes=num_episodes, record=_rms_error)

    return {form: run(list(SIGMAS), form) for form in FORMS} | {
        f"{form}, dynamic": run(DYNAMIC, form) for form in FORMS
    }


def _rms_error(learner):
    """The root of the mean of (Q - q_pi)^2 over the states and both actions."""
    v = np.clip(np.arange(STATES + 2) / (STATES + 1) * 2 - 1, -1, 1)
    truth = jnp.asarray(np.stack([v[:-2], v[2:]], 1), learner.q.dtype)
    return {"rms": jnp.sqrt(((learner.q[1:-1] - truth) ** 2).mean())}


def _after(form, sigma, episodes):
    """The error of each seed after so many episodes."""
    ds = lambda datasets: datasets[f"{form}, dynamic"] if sigma is None else datasets[form].sel(sigma=sigma)
    return lambda datasets: ds(datasets).rms.isel(row=min(episodes, ds(datasets).sizes["row"]) - 1)


def _draw(datasets):
    import matplotlib as mpl

    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    axes = canvas.subplots(1, 2, sharey=True)
    titles = "as drawn (the paper)", "with control variates (the book)"
    colors = mpl.colormaps["viridis"](np.linspace(0, 0.93, len(SIGMAS)))
    for ax, form, title in zip(axes, FORMS, titles, strict=True):
        ds = datasets[form]
        episodes = 1 + ds.row
        for sigma, color in zip(SIGMAS, colors, strict=True):
            plot.mean_curve(ax, episodes, ds.rms.sel(sigma=sigma), f"σ = {sigma:g}", color)
        dynamic = datasets[f"{form}, dynamic"].rms
        plot.mean_curve(ax, episodes, dynamic, "σ falls", plot.INK, ls="--")
        ax.set_title(title, fontsize=plot.TYPE)
        plot.tidy(ax, "episodes", "RMS error of Q" if ax is axes[0] else "")
        ax.set(xlim=(0, None), ylim=(0, None))
        plot.legend(ax)
    plot.head(
        canvas,
        f"Random walk, 19 states, two actions: {N}-step Q(σ), α = {ALPHA}",
        datasets[AS_DRAWN].sizes["seed"],
    )
    return canvas


FIGURE = Figure(
    title="Q(σ): how much to sample",
    source="De Asis, Hernandez-Garcia, Holland and Sutton 2018, the 19-state random walk; Sutton and Barto 2018, "
    "section 7.6",
    shows="As the paper has it: who samples (σ = 1) learns faster at first and is worse in the end than tree backup "
    "(σ = 0), and a σ that falls from 1, to .95 of it with each episode, has both. With the control variates of the "
    "book nothing is left to trade: where the task is deterministic they take away all noise of sampling, "
    "and σ = 1 is best throughout.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 2},
    numbers=(
        # RMS errors of all action values from 20 000 runs of a plain loop; the paper prints curves alone.
        *(
            Number(
                f"{form}, σ {name}: after {episodes} episodes", expected, error, _after(form, sigma, episodes)
            )
            for form, sigma, name, episodes, expected, error in (
                (AS_DRAWN, 0.0, "= 0", 10, 0.34944, 2.1e-4),
                (AS_DRAWN, 1.0, "= 1", 10, 0.25074, 2.1e-4),
                (AS_DRAWN, None, "dynamic", 10, 0.26659, 2.0e-4),
                (AS_DRAWN, 0.0, "= 0", 50, 0.04974, 1.5e-4),
                (AS_DRAWN, 1.0, "= 1", 50, 0.12008, 2.5e-4),
                (AS_DRAWN, None, "dynamic", 50, 0.03730, 1.7e-4),
                (OF_THE_BOOK, 0.5, "= 0.5", 50, 0.03184, 1.4e-4),
                (OF_THE_BOOK, 1.0, "= 1", 50, 0.02116, 1.1e-4),
                (OF_THE_BOOK, None, "dynamic", 50, 0.03649, 1.5e-4),
            )
        ),
    ),
    draw=_draw,
)
