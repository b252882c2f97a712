"""The values of a small gridworld: of the policy that takes any action, and the best (book, figures 3.2 and 3.5)."""

import numpy as np

from jaxrl_tab.envs import Maze
from jaxrl_tab.envs.base import ARROWS
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number

GAMMA = 0.9
RANDOM, BEST = "random policy", "optimal"
A, B, FAR = 1, 3, 20  # the two special states, and the bottom left corner
# As the book prints them, row by row.
PRINTED = {
    RANDOM: "3.3 8.8 4.4 5.3 1.5 1.5 3.0 2.3 1.9 0.5 0.1 0.7 0.7 0.4 -0.4 "
    "-1.0 -0.4 -0.4 -0.6 -1.2 -1.9 -1.3 -1.2 -1.4 -2.0",
    BEST: "22.0 24.4 22.0 19.4 17.5 19.8 22.0 19.8 17.8 16.0 17.8 19.8 17.8 16.0 14.4 "
    "16.0 17.8 16.0 14.4 13.0 14.4 16.0 14.4 13.0 11.7",
}
MOVES = "→ ↑→↓← ← ↑→↓← ← ↑→ ↑ ↑← ← ← " + "↑→ ↑ ↑← ↑← ↑← " * 3


def _experiment():
    return {RANDOM: _random, BEST: _best}


def _random(progress):
    q = planning.backup(planning.exact_model(_env()), _value_of_random(), GAMMA)
    return _dataset(_value_of_random(), q)


def _best(progress):
    return _dataset(*planning.value_iteration(_env(), GAMMA))


def _env():
    return Maze(map="example-3.5")


def _value_of_random():
    env = _env()
    return planning.evaluate(env, np.full((env.num_states, env.num_actions), 1 / env.num_actions), GAMMA)


def _dataset(v, q):
    import xarray as xr

    return xr.Dataset({"v": ("state", v), "q": (("state", "action"), q)})


def _v(run, state):
    return lambda datasets: datasets[run].v.sel(state=state)


def _unlike(run):
    """States whose value, rounded to a digit as the book's, is another one."""
    printed = np.array(PRINTED[run].split(), float)
    return lambda datasets: (abs(datasets[run].v.values - printed) > 0.05).sum()


def _moved_unlike(datasets):
    q = datasets[BEST].q.values
    best = q >= q.max(1, keepdims=True) - EXACT
    return sum(
        "".join(np.array(ARROWS[:4])[x]) != printed for x, printed in zip(best, MOVES.split(), strict=True)
    )


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    for ax, (name, ds) in zip(canvas.subplots(1, 2), datasets.items(), strict=True):
        q = ds.q.values.round(9)
        plot.values(ax, _env(), ds.v.values, q if name == BEST else None)
        ax.set_title(
            {RANDOM: "the policy that takes any action", BEST: "the best policies"}[name], fontsize=plot.TYPE
        )
    plot.head(canvas, "A leads to a, for 10, and B to b, for 5; off the edge costs 1; γ = 0.9")
    return canvas


FIGURE = Figure(
    title="State values of a gridworld",
    source="Sutton and Barto 2018, figures 3.2 and 3.5 (examples 3.5 and 3.8)",
    shows="A is worth less than its reward of 10 to who takes any action, for at a one is likely to run into the edge; "
    "B is worth more than its 5, for b is in the middle. Under the best policies all states are worth more.",
    experiment=_experiment,
    numbers=(
        # Exact; the printed ones are those of both pictures.
        Number("random policy: v(A)", 8.789291, EXACT, _v(RANDOM, A), published="8.8"),
        Number("random policy: v(B)", 5.322368, EXACT, _v(RANDOM, B), published="5.3"),
        Number(
            "random policy: v in the bottom left corner", -1.857700, EXACT, _v(RANDOM, FAR), published="-1.9"
        ),
        Number("random policy: states of 25 with another value", 0, EXACT, _unlike(RANDOM), published="0"),
        Number("optimal: v(A) = 10 / (1 - 0.9^5)", 10 / (1 - GAMMA**5), EXACT, _v(BEST, A), published="24.4"),
        Number("optimal: v(B) = v(A) - 5", 10 / (1 - GAMMA**5) - 5, EXACT, _v(BEST, B), published="19.4"),
        Number("optimal: states of 25 with another value", 0, EXACT, _unlike(BEST), published="0"),
        Number("optimal: states of 25 with other actions", 0, EXACT, _moved_unlike, published="0"),
    ),
    draw=_draw,
)
