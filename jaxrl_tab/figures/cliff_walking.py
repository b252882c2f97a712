"""Sarsa and Q-learning on the cliff (book, example 6.6)."""

from jaxrl_tab.envs import CliffWalking
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

ALPHA = 0.5
EPSILON = 0.1


def _experiment(num_seeds=500, num_episodes=500):
    grid = {"alpha": ALPHA, "epsilon": EPSILON}
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes}
    return {method: swept(CliffWalking(), method, grid, **budget) for method in ("sarsa", "q-learning")}


def _late_return(method):
    return lambda datasets: datasets[method].returns.isel(row=slice(400, 500)).mean("row")


def optimum() -> float:
    """v* from the start."""
    env = CliffWalking()
    return planning.start_value(env, planning.value_iteration(env)[0])


def best_soft() -> float:
    """The value from the start of the best epsilon-soft policy."""
    env = CliffWalking()
    return planning.start_value(env, planning.epsilon_soft(env, EPSILON)[1])


def _draw(datasets):
    from jaxrl_tab.show import plot, words

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for (method, ds), color in zip(datasets.items(), plot.COLORS, strict=False):
        plot.mean_curve(ax, ds.row + 1, ds.returns, words.title_of(method), color, lw=1)
    lines = {"optimal policy": (optimum(), "--"), "best ε-soft policy": (best_soft(), ":")}
    for name, (value, style) in lines.items():
        plot.exact_line(ax, value, f"{name}: −{-value:.3g}", ls=style)
    plot.tidy(ax, "episodes", "sum of rewards in the episode")
    ax.set(ylim=(-100, 0), xlim=(0, 500))
    plot.head(canvas, f"Cliff walking, α = {ALPHA}, ε = {EPSILON}", datasets["sarsa"].sizes["seed"])
    plot.legend(ax)
    return canvas


FIGURE = Figure(
    title="Sarsa and Q-learning on the cliff",
    source="Sutton and Barto 2018, example 6.6",
    shows="Q-learning learns the shorter way along the cliff and, as it explores, falls off; Sarsa learns the "
    "way that is safe for who explores, and earns more.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # From long simulations with plain loops, and by enumeration.
        Number("Sarsa: mean return of episodes 401 to 500", -26.79, 0.10, _late_return("sarsa")),
        Number("Q-learning: mean return of episodes 401 to 500", -49.94, 0.11, _late_return("q-learning")),
        Number("optimal value from the start", -13, EXACT, lambda datasets: optimum()),
        Number(
            "best epsilon-soft policy's value from the start", -20.7077, 5e-5, lambda datasets: best_soft()
        ),
    ),
    draw=_draw,
)
