"""What episodes along one and the same way change, with lambda as a knob (Silver, lecture 5; book, section 12.7)."""

import numpy as np

from jaxrl_tab.core.policies import Table
from jaxrl_tab.envs import TraceGridworld
from jaxrl_tab.envs.base import COMPASS, Grid
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

LAMBDAS = (0.0, 0.5, 0.9, 1.0)
ALPHA = 0.5
EPISODES = 10
SHOWN = (1, 2, EPISODES)
ENV = TraceGridworld(shape=(5, 6), start=(4, 0), goal=(0, 5))
MOVES = "↑↑↑→→↓↓↓→→↑↑→↑↑"
RUN = "sarsa-lambda"


def path(env: Grid, moves: str) -> tuple[np.ndarray, np.ndarray]:
    """The states and the actions, int [moves] each, of a way from the start, told by the names of its moves."""
    actions = np.array([env.action_names.index(move) for move in moves])
    cells = np.add(env.start, np.cumsum(np.asarray(COMPASS)[actions], 0))
    states = np.append(env.start_state, cells[:-1] @ (env.shape[1], 1))
    return states, actions


def follows(env: Grid, moves: str) -> Table:
    """The policy that goes this way, on which no cell comes twice."""
    pi = np.full((env.num_states, env.num_actions), 1 / env.num_actions)
    states, actions = path(env, moves)
    pi[states] = np.eye(env.num_actions)[actions]
    return Table(pi)


def _experiment(num_episodes=EPISODES):
    grid = {"lam": list(LAMBDAS), "alpha": ALPHA, "behaviour": follows(ENV, MOVES)}
    return {RUN: swept(ENV, RUN, grid, num_seeds=1, num_episodes=num_episodes, record=_table)}


def _table(learner):
    """Q after the episode, [S, A]."""
    return {"table": learner.q}


def _tables(datasets, lam):
    """Q after each number of episodes, the first of them none: float [episodes + 1, S, A]."""
    tables = datasets[RUN].table.sel(lam=lam).isel(seed=0).values
    return np.concatenate([np.zeros_like(tables[:1]), tables])


def _changes(datasets, lam):
    """What each episode changes, float [episodes, S, A]."""
    return np.diff(_tables(datasets, lam), axis=0)


def _back(datasets, lam, episodes):
    """Q of the pairs of the way after so many episodes, from the last step to the first, float [moves]."""
    return _tables(datasets, lam)[episodes][path(ENV, MOVES)][::-1]


def _count(lam, episode):
    return lambda datasets: (_changes(datasets, lam)[episode - 1] != 0).sum()


def _value(lam, steps_before, episodes):
    """Q of the pair so many steps before the last one."""
    return lambda datasets: _back(datasets, lam, episodes)[steps_before]


def _draw(datasets):
    from jaxrl_tab.show import plot

    shown = [episode for episode in SHOWN if episode <= datasets[RUN].sizes["row"]]
    canvas = plot.canvas(plot.WIDTH)
    axes = canvas.subplots(len(shown), len(LAMBDAS), squeeze=False)
    states, _ = path(ENV, MOVES)
    rows, columns = np.divmod([*states, ENV.state(ENV.goal)], ENV.shape[1])
    for row, episode in zip(axes, shown, strict=True):
        for ax, lam in zip(row, LAMBDAS, strict=True):
            change = _changes(datasets, lam)[episode - 1]
            ax.plot(columns, rows, color=plot.GREY, lw=0.8, zorder=2.5)
            plot.amounts(ax, ENV, change, ALPHA, f"episode {episode}\nλ = {lam:g}: {change.sum():.2f}")
    plot.head(
        canvas,
        f"Sarsa(λ), α = {ALPHA}: what an episode along the grey way changes\n"
        "area of an arrow: the change of its action's value; number: all changes together",
    )
    return canvas


LAST = len(MOVES) - 1
FIGURE = Figure(
    title="What one episode changes, with λ as a knob",
    source="Silver, lecture 5, Sarsa(λ) gridworld example; Sutton and Barto 2018, section 12.7",
    shows="Each episode goes the same way and is paid 1 at its end. One-step Sarsa (λ = 0) moves what it has learned "
    "back by one step an episode; λ = 1 tells all steps alike at once, and has nothing left to change by the tenth; in "
    "between, the first episode tells each step λ times as much as the one after it.",
    experiment=_experiment,
    small={"num_episodes": EPISODES},
    numbers=(
        # By hand, with γ = 1: the first episode adds α λ^k to the pair k steps before the last. After n episodes
        # one-step Sarsa has there the probability that n fair coins show more than k heads; λ = 1 has 1 - 1/2^n.
        Number("λ = 0: action values changed by episode 1", 1, EXACT, _count(0.0, 1)),
        Number("λ = 0: by episode 10", 10, EXACT, _count(0.0, 10)),
        Number("λ = 0.5: by episode 1", 15, EXACT, _count(0.5, 1)),
        Number("λ = 0.5, episode 1: change 3 steps before the last", 0.0625, EXACT, _value(0.5, 3, 1)),
        Number("λ = 0.9, episode 1: change of the first step", 0.114384, EXACT, _value(0.9, LAST, 1)),
        Number("λ = 1, episode 1: change of the first step", 0.5, EXACT, _value(1.0, LAST, 1)),
        Number(
            "λ = 0: value 4 steps before the last, after 10 episodes", 0.623047, EXACT, _value(0.0, 4, 10)
        ),
        Number("λ = 1: value of the first step, after 10 episodes", 0.999023, EXACT, _value(1.0, LAST, 10)),
    ),
    draw=_draw,
)
