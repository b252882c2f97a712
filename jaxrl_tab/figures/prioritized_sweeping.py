"""Prioritized sweeping against Dyna-Q: updates until a maze is solved (book, example 8.4)."""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrl_tab.envs import Maze
from jaxrl_tab.envs.drawing import MAPS
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import Figure, Number, swept

ALPHA, EPSILON, GAMMA, UPDATES = 1.0, 0.1, 0.95, 5
CELLS = 47  # of the Dyna maze, without its walls
SHORTEST = {1: 14, 2: 29, 3: 44}  # steps, of the Dyna maze with each cell cut into 1, 4 and 9
LONGER = 1.2  # so many times the shortest way may be, for a maze to be solved
STEPS = 8000  # of a run, and the more the more cells there are
EVERY = 20  # steps of a row, likewise
DYNA, SWEEPING = "dyna-q", "prioritized-sweeping"


def _maze(parts):
    """The Dyna maze with each cell cut into so many rows and columns; its start and goal in the outer corners."""
    rows = [list(row) for row in MAPS["dyna"].read_text().split("\n\n")[0].split()]
    drawn = np.array(rows).repeat(parts, 0).repeat(parts, 1)
    for letter, column in (("S", 0), ("G", -1)):
        cells = np.argwhere(drawn == letter)
        drawn[drawn == letter] = "."
        drawn[cells[0][0], cells[column][1]] = letter
    return Maze(map=["".join(row) for row in drawn], step_reward=0, goal_reward=1)


def _experiment(num_seeds=20, steps=STEPS):
    def run(parts, method):
        env = _maze(parts)
        reach = int(LONGER * SHORTEST[parts])
        s_next, goal = planning.exact_model(env).s_next[..., 0], env.state(env.goals[0])
        record = partial(_solved, s_next, env.start_state, goal, reach)
        grid = {"alpha": ALPHA, "epsilon": EPSILON, "gamma": GAMMA, "planning_steps": UPDATES}
        cells = parts**2
        budget = {"num_seeds": num_seeds, "num_steps": steps * cells, "log_every": EVERY * cells}
        return swept(env, method, grid, record=record, **budget)

    return {f"{method}-{m}": run(m, method) for m in SHORTEST for method in (DYNA, SWEEPING)}


def _solved(s_next, start, goal, reach, learner):
    """Whether the greedy way from the start leads to the goal in so many steps; and how many updates were made."""
    go = lambda _, s: jnp.where(s == goal, s, jnp.asarray(s_next)[s, learner.q[s].argmax()])
    is_there = lax.fori_loop(0, reach, go, jnp.int32(start)) == goal
    updates = getattr(learner, "updates", learner.clock.step * (1 + UPDATES))
    return {"solved": is_there, "updates": updates}


def _updates(datasets, method, parts):
    """The updates of each run until it had solved the maze; all that it made where it never had."""
    ds = datasets[f"{method}-{parts}"].transpose("seed", "row", ...)
    solved = ds.solved.values.reshape(ds.sizes["seed"], -1)
    row = np.where(solved.any(1), solved.argmax(1), solved.shape[1] - 1)
    return ds.updates.values.reshape(solved.shape)[np.arange(len(row)), row]


def _until_solved(method, parts):
    return lambda datasets: _updates(datasets, method, parts)


def _draw(datasets):
    import xarray as xr
    from matplotlib.ticker import NullLocator

    from jaxrl_tab.show import plot, words

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    cells = [CELLS * m**2 for m in SHORTEST]
    for method, color, marker in zip((DYNA, SWEEPING), plot.COLORS, plot.MARKERS, strict=False):
        updates = [_updates(datasets, method, m) for m in SHORTEST]
        runs = xr.DataArray(np.array(updates, float).T, dims=("seed", "cells"))
        plot.mean_curve(ax, cells, runs, words.title_of(method), color, marker=marker, ms=5)
    plot.tidy(ax, "states of the maze", "updates until it is solved")
    ax.set(xscale="log", yscale="log", ylim=(50, None))
    ax.xaxis.set_ticks(cells, labels=map(str, cells))
    ax.xaxis.set_minor_locator(NullLocator())
    plot.legend(ax)
    seeds = datasets[f"{DYNA}-1"].sizes["seed"]
    plot.head(canvas, f"Dyna maze in ever smaller cells, α = {ALPHA:g}, ε = {EPSILON}, γ = {GAMMA}", seeds)
    return canvas


FIGURE = Figure(
    title="Prioritized sweeping against Dyna-Q: updates until a maze is solved",
    source="Sutton and Barto 2018, example 8.4",
    shows="Most of the updates that Dyna-Q draws change nothing, for nothing is known yet where they look ahead. "
    "Prioritized sweeping updates only where something has changed, backwards from the goal, and makes a fiftieth of "
    "them. Each makes five at most after a real step; a maze counts as solved when the greedy way is at most a fifth "
    "longer than the shortest. The book's sizes lie between, and its mazes were drawn otherwise.",
    experiment=_experiment,
    small={"num_seeds": 2, "steps": 200},
    numbers=(
        # From 200 to 1000 runs of a plain loop.
        Number("47 states, Dyna-Q: updates", 6728, 147, _until_solved(DYNA, 1)),
        Number("47 states, prioritized sweeping", 154.3, 2.0, _until_solved(SWEEPING, 1)),
        Number("188 states, Dyna-Q", 33_522, 616, _until_solved(DYNA, 2)),
        Number("188 states, prioritized sweeping", 679.0, 9.7, _until_solved(SWEEPING, 2)),
        Number("423 states, Dyna-Q", 90_016, 2249, _until_solved(DYNA, 3)),
        Number("423 states, prioritized sweeping", 1532, 35, _until_solved(SWEEPING, 3)),
    ),
    draw=_draw,
)
