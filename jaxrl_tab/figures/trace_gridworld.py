"""What one episode of Sarsa teaches, and one of Sarsa(lambda) (Silver, lecture 5; book, figure 7.4)."""

import numpy as np

from jaxrl_tab.envs import TraceGridworld
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

N, LAMBDA = 10, 0.9
METHODS = {
    "sarsa": ("One-step Sarsa", {}),
    "n-step-sarsa": (f"{N}-step Sarsa", {"n": N}),
    "sarsa-lambda": (f"Sarsa(λ), λ = {LAMBDA}", {"lam": LAMBDA}),
}
# A longer episode is cut off without reward, and teaches nothing. (So far back traces would be 0 in float32.)
ENV = TraceGridworld(max_steps=500)


def _experiment(num_seeds=1000):
    """The first episode of each seed.

    Before anything is learned all methods act alike, by the same random words. Monte Carlo, which learns when
    the episode is over, remembers which way it went.
    """
    budget = {"num_seeds": num_seeds, "num_episodes": 1}
    runs = {name: swept(ENV, name, setting, **budget) for name, (_, setting) in METHODS.items()}
    return runs | {"path": swept(ENV, "monte-carlo", {}, **budget, record=_path)}


def _path(learner):
    """The states and actions of the episode, [max_steps] each."""
    steps = learner.episode.steps
    return {"s": steps.s, "a": steps.a}


def _arrived(datasets):
    """The seeds whose episode came to the goal."""
    return np.flatnonzero(datasets["path"].returns.isel(row=0) == 1)


def _changed(method):
    """How many entries of Q the episode changed, for each seed that came to the goal."""
    return lambda datasets: (datasets[method].q != 0).sum(("state", "action"))[_arrived(datasets)]


def _unlike_the_path(method, last=ENV.max_steps):
    """How many entries of Q changed whose pair was not among the `last` of the path, or the reverse."""

    def measure(datasets):
        q, path = datasets[method].q.values, datasets["path"].isel(row=0)
        differ = 0
        for seed in _arrived(datasets):
            steps = slice(max(0, int(path.lengths[seed]) - last), int(path.lengths[seed]))
            on_path = np.zeros(q[seed].shape, bool)
            on_path[path.s[seed, steps], path.a[seed, steps]] = True
            differ += ((q[seed] != 0) != on_path).sum()
        return differ

    return measure


def _draw(datasets):
    from jaxrl_tab.show import plot

    path = datasets["path"].isel(row=0)
    arrived = _arrived(datasets)
    seed = arrived[path.lengths.values[arrived].argmin()]
    states = np.append(path.s[seed, : int(path.lengths[seed])], ENV.state(ENV.goal))
    canvas = plot.canvas(plot.WIDTH)
    first, *others = canvas.subplots(2, 2).ravel()
    plot.walk(first, ENV, states, f"The path of the episode\n{len(states) - 1} steps")
    for ax, (method, (title, _)) in zip(others, METHODS.items(), strict=True):
        q = datasets[method].q.values[seed]
        count = int((q != 0).sum())
        plot.changes(ax, ENV, q, f"{title}\n{count} action value{'s' * (count != 1)} changed")
    plot.head(
        canvas,
        f"Trace gridworld: one episode, the shortest of {path.sizes['seed']} first episodes\n"
        "an orange arrow: an action whose value changed, the fainter the less",
    )
    return canvas


FIGURE = Figure(
    title="What one episode of Sarsa teaches, and one of Sarsa(λ)",
    source="Silver, lecture 5, Sarsa(λ) gridworld example; Sutton and Barto 2018, figure 7.4",
    shows="The first episode that is paid changes one action value by one-step Sarsa, the last ten by 10-step "
    "Sarsa, and those of the whole way by Sarsa(λ), the less the farther from the goal.",
    experiment=_experiment,
    small={"num_seeds": 20},
    numbers=(
        # By hand: nothing is learned before the reward, which one-step Sarsa gives to the last pair alone.
        Number("one-step Sarsa: action values changed by an episode", 1, EXACT, _changed("sarsa")),
        Number(
            f"{N}-step Sarsa: changed values unlike the last {N} pairs of the path",
            0,
            EXACT,
            _unlike_the_path("n-step-sarsa", N),
        ),
        Number(
            "Sarsa(λ): changed values unlike the pairs of the path",
            0,
            EXACT,
            _unlike_the_path("sarsa-lambda"),
        ),
    ),
    draw=_draw,
)
