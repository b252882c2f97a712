"""Dyna-Q in the Dyna maze: fewer episodes for more planning (book, example 8.1 and figure 8.2)."""

import numpy as np

from jaxrl_tab.envs import Maze
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

ALPHA, EPSILON, GAMMA = 0.1, 0.1, 0.95
STEPS = (0, 5, 50)  # of planning, to a real one
EPISODES = 50
SHORTEST = 14


def _experiment(num_seeds=100):
    grid = {"planning_steps": list(STEPS), "alpha": ALPHA, "epsilon": EPSILON, "gamma": GAMMA}
    run = swept(Maze(map="dyna"), "dyna-q", grid, num_seeds=num_seeds, num_episodes=EPISODES)
    return {"dyna-q": run}


def _lengths(datasets, n):
    return datasets["dyna-q"].lengths.sel(planning_steps=n)


def _in_episode(n, episode):
    return lambda datasets: _lengths(datasets, n).isel(row=episode - 1)


def _after_the_first(n):
    """The mean length of episodes 2 to 50."""
    return lambda datasets: _lengths(datasets, n).isel(row=slice(1, None)).mean("row")


def _at_random(datasets):
    """The expected length of an episode of somebody who takes any action: the first of all three."""
    env = Maze(map="dyna", step_reward=-1, goal_reward=-1)
    return -planning.policy_value(env, np.full((env.num_states, env.num_actions), 1 / env.num_actions))


def _best(datasets):
    env = Maze(map="dyna", step_reward=-1, goal_reward=-1)
    return -planning.start_value(env, planning.value_iteration(env)[0])


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for n, color in zip(STEPS, plot.COLORS, strict=False):
        lengths = _lengths(datasets, n).isel(row=slice(1, None))
        plot.mean_curve(
            ax, lengths.row + 1, lengths, f"{n} planning steps" if n else "none: Q-learning", color
        )
    plot.exact_line(ax, SHORTEST, f"the shortest way: {SHORTEST}")
    plot.tidy(ax, "episodes, from the second on", "steps of an episode")
    ax.set(ylim=(0, 800), xlim=(0, EPISODES))
    plot.legend(ax)
    seeds = datasets["dyna-q"].sizes["seed"]
    plot.head(canvas, f"Dyna maze, α = {ALPHA}, ε = {EPSILON}, γ = {GAMMA}", seeds)
    return canvas


FIGURE = Figure(
    title="Dyna-Q in the Dyna maze: fewer episodes for more planning",
    source="Sutton and Barto 2018, figure 8.2",
    shows="Where nothing is planned, an episode teaches one more step of the way, from its end. With 50 planning steps "
    "to a real one nearly all of the way is known when the second episode is over.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        Number("the shortest way", SHORTEST, EXACT, _best, published="14"),
        # Nothing is known in the first episode, so it goes at random: from a linear system. The book says that it took
        # "about 1700 steps", with the same random numbers for all.
        Number("expected steps of the first episode, exactly", 868.7254, 1e-4, _at_random, published="1700"),
        # From 20 000 runs of a plain loop each; with 50 planning steps from 6000.
        Number("none: steps of episode 2", 677.66, 4.28, _in_episode(0, 2)),
        Number("none: mean steps of episodes 2 to 50", 83.330, 0.141, _after_the_first(0)),
        Number("5 planning steps: steps of episode 2", 149.01, 0.48, _in_episode(5, 2)),
        Number("5 planning steps: mean of episodes 2 to 50", 21.0282, 0.0118, _after_the_first(5)),
        Number("50 planning steps: steps of episode 2", 39.140, 0.125, _in_episode(50, 2)),
        Number("50 planning steps: mean of episodes 2 to 50", 17.3352, 0.0189, _after_the_first(50)),
    ),
    draw=_draw,
)
