"""Sarsa, Expected Sarsa and Q-learning on the cliff over the step size (book, figure 6.3)."""

from typing import Any

import numpy as np

from jaxrl_tab.envs import CliffWalking
from jaxrl_tab.exact import planning
from jaxrl_tab.figures import cliff_walking
from jaxrl_tab.figures.figure import Figure, Number, swept

EPSILON = cliff_walking.EPSILON
METHODS = ("sarsa", "expected-sarsa", "q-learning")
ALPHAS = tuple(round(0.1 * i, 1) for i in range(1, 11))
EPISODES_IN_ROW = 100
LOWEST = -160  # of the axis, as in the book
PHASES = {"interim": slice(0, 1), "asymptotic": slice(5, 10)}  # rows


def _experiment(num_seeds=60, num_episodes=1000, alphas=ALPHAS):
    grid = {"alpha": list(alphas), "epsilon": EPSILON}
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes, "log_every": EPISODES_IN_ROW}
    return {method: swept(CliffWalking(), method, grid, **budget) for method in METHODS}


def _mean_return(ds, phase):
    from jaxrl_tab import stats

    return stats.mean_return(ds, PHASES[phase])


def _at(method, alpha, phase):
    return lambda datasets: _mean_return(datasets[method].sel(alpha=alpha), phase)


def _greedy_limit():
    """The value from the start of the policy that is epsilon-greedy to Q*, ties split."""
    env = CliffWalking()
    _, q = planning.value_iteration(env)
    return planning.policy_value(env, planning.epsilon_greedy_policy(q, EPSILON))


def _draw(datasets):
    from jaxrl_tab import stats
    from jaxrl_tab.show import plot, words

    canvas = plot.canvas(plot.WIDTH)
    ax = canvas.subplots()
    styles: dict[str, dict[str, Any]] = {"interim": {"ls": ":", "mfc": "white"}, "asymptotic": {"ls": "-"}}
    for phase, style in styles.items():
        marks = zip(plot.COLORS, plot.MARKERS, strict=True)
        for (method, ds), (color, marker) in zip(datasets.items(), marks, strict=False):
            mean, low, high, _ = stats.mean_interval(_mean_return(ds, phase))
            errors = abs(np.stack([low, high]) - mean.values)
            line = {"color": color, "marker": marker, "ms": 5, "lw": 1.5, "capsize": 2}
            name = words.title_of(method)
            curve = ax.errorbar(ds.alpha, mean, errors, **line, **style)
            curve.lines[0].set_label(f"{name}, {phase}")
            if (last := float(mean[-1])) < LOWEST:
                text = f"{name} at α = 1: −{-last:.0f}, and falling on"
                at = {"xytext": (0, 4), "textcoords": "offset points", "ha": "right", "fontsize": plot.SMALL}
                ax.annotate(text, (0.93, LOWEST), **at, color=color)
    exact = {
        "best ε-soft policy": (cliff_walking.best_soft(), "--"),
        "ε-greedy to Q*, ties split": (_greedy_limit(), "-."),
    }
    for name, (value, style) in exact.items():
        plot.exact_line(ax, value, f"{name}: −{-value:.1f}", ls=style, zorder=1)
    plot.tidy(ax, "step size α", "mean return per episode")
    ax.set(ylim=(LOWEST, 0), xlim=(0.05, 1.05))
    phases = "episodes 1 to 100 (interim) and 501 to 1000 (asymptotic)"
    seeds = datasets["sarsa"].sizes["seed"]
    plot.head(canvas, f"Cliff walking, ε = {EPSILON}: {phases}", seeds)
    plot.legend(ax)
    return canvas


FIGURE = Figure(
    title="Sarsa, Expected Sarsa and Q-learning on the cliff, over the step size",
    source="van Seijen et al. 2009, figure 2; Sutton and Barto 2018, figure 6.3",
    shows="Expected Sarsa can take a step size of 1, where Sarsa falls apart; over few episodes it is the best "
    "with any. Q-learning's returns while it explores stay low with every step size.",
    experiment=_experiment,
    small={"num_seeds": 2, "alphas": (0.1, 0.5, 1.0)},
    numbers=(
        # By enumeration: with step size 1 in a deterministic world both methods come to an exact fixed point.
        Number("Expected Sarsa, α = 1, asymptotic", -20.7077, 5e-5, _at("expected-sarsa", 1.0, "asymptotic")),
        Number("Q-learning, α = 1, asymptotic", -50.8000, 5e-5, _at("q-learning", 1.0, "asymptotic")),
        # From 1000 runs of plain loops.
        Number("Sarsa, α = 0.1, asymptotic", -21.916, 0.034, _at("sarsa", 0.1, "asymptotic")),
        Number("Sarsa, α = 0.5, asymptotic", -26.78, 0.10, _at("sarsa", 0.5, "asymptotic")),
        Number("Sarsa, α = 0.5, interim", -71.19, 0.20, _at("sarsa", 0.5, "interim")),
        Number("Expected Sarsa, α = 0.5, interim", -56.35, 0.11, _at("expected-sarsa", 0.5, "interim")),
        Number("Q-learning, α = 0.5, interim", -80.78, 0.22, _at("q-learning", 0.5, "interim")),
    ),
    draw=_draw,
)
