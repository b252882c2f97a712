"""Sarsa on the windy gridworld (book, example 6.5)."""

from jaxrl_tab import planning
from jaxrl_tab.envs import WindyGridworld
from jaxrl_tab.figures.figure import Figure, Number

ALPHA, EPSILON = 0.5, 0.1
EXACT = 1e-6  # how far a number that is whole may come out from it


def _episodes(env, datasets):
    return datasets["sarsa"].episodes.sum("row")


def _optimum(env, datasets):
    return planning.start_value(env, planning.value_iteration(env)[0])


def _kings_steps(env, datasets):
    return -_optimum(WindyGridworld(moves="king"), datasets)


def _draw(datasets, env):
    from matplotlib.figure import Figure as Canvas

    from jaxrl_tab import plot

    canvas = Canvas(figsize=(12, 4.8), dpi=plot.DPI, layout="constrained")
    curve, grid = canvas.subplots(1, 2)
    plot.episodes_against_steps(curve, datasets)
    seeds = datasets["sarsa"].sizes["seed"]
    curve.set_title(f"α = {ALPHA}, ε = {EPSILON}: mean and 95% interval over {seeds} seeds")
    v, q = planning.value_iteration(env)
    plot.greedy_path(grid, env, q, "an optimal policy", planning.start_value(env, v))
    return canvas


FIGURE = Figure(
    title="Sarsa on the windy gridworld",
    source="Sutton and Barto 2018, example 6.5",
    environment="windy-gridworld",
    methods=("sarsa",),
    hyperparameters={"alpha": ALPHA, "epsilon": EPSILON},
    budget={"num_seeds": 200, "num_steps": 8000},
    numbers=(
        # From 10 000 seeds of a plain loop.
        Number("episodes finished in 8000 steps", 160.15, 0.10, _episodes),
        Number("optimal value from the start", -15, EXACT, _optimum),
        Number("optimal steps with king's moves", 7, EXACT, _kings_steps),
    ),
    draw=_draw,
)
