"""Whether the initial action values matter where the step size is 1/N (Silver, lecture 5; book, section 2.6)."""

from jaxrl_tab.envs import Blackjack
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept
from jaxrl_tab.figures.how_often import EPISODES, EPSILON, EVERY, optimal_value

INITIAL = {0.0: "0", -5.0: "−5, worse than any return", 5.0: "5, better than any return"}
PAIRS = 400  # (s, a)
RUN = "monte-carlo"


def _experiment(num_seeds=200):
    grid = {"q0": list(INITIAL), "epsilon": EPSILON}
    budget = {"num_seeds": num_seeds, "num_episodes": EPISODES, "log_every": EVERY, "exact": True}
    return {RUN: swept(Blackjack(), RUN, grid, **budget, record=_tried)}


def _tried(learner):
    """The number of pairs (s, a) that were tried."""
    return {"tried": (learner.clock.visits > 0).sum()}


def _at(variable, q0, episodes=EPISODES):
    """A variable of each seed after so many episodes."""
    return lambda datasets: datasets[RUN][variable].sel(q0=q0).isel(row=episodes // EVERY - 1)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    learned, tried = canvas.subplots(1, 2)
    ds = datasets[RUN]
    episodes = EVERY * (ds.row + 1)
    for (q0, name), color, dash in zip(INITIAL.items(), plot.COLORS, plot.DASHES, strict=False):
        of_runs, look = ds.sel(q0=q0), {"label": name, "color": color, "ls": dash}
        plot.mean_curve(learned, episodes, of_runs.greedy_value, **look)
        plot.mean_curve(tried, episodes, of_runs.tried / PAIRS, **look)
    plot.exact_line(learned, optimal_value(datasets), "exact optimum", lw=1)
    plot.tidy(learned, "episodes", "exact value, greedy policy")
    plot.tidy(tried, "episodes", "share of the pairs tried")
    tried.set_ylim(0, 1)
    for ax in (learned, tried):
        ax.set_xlim(0, None)
        plot.legend(ax)
    plot.head(
        canvas,
        f"Blackjack, Monte Carlo, step 1/N, ε = {EPSILON}: the initial value of all actions",
        ds.sizes["seed"],
    )
    return canvas


FIGURE = Figure(
    title="Whether the initial action values matter with step size 1/N",
    source="Silver, lecture 5, GLIE Monte Carlo control; Sutton and Barto 2018, section 2.6",
    shows="With step size 1/N the first return of a pair replaces its initial value altogether. Yet the value matters, "
    "by what is tried: below all returns, whatever comes first in a state looks better than what has not been tried, "
    "which is left to exploration; above them, everything is tried once, which costs at first and gains little later.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # The optimum by enumeration; the others from 40 000 runs of a plain loop each.
        Number("optimal value from the start", -0.046556, EXACT, optimal_value),
        Number(
            "from 0: greedy policy after 2000 episodes, mean", -0.107094, 0.000060, _at("greedy_value", 0)
        ),
        Number("from −5", -0.203386, 0.000148, _at("greedy_value", -5)),
        Number("from 5", -0.104979, 0.000057, _at("greedy_value", 5)),
        Number("from 0: after 500 episodes", -0.141785, 0.000084, _at("greedy_value", 0, 500)),
        Number("from 5: after 500 episodes", -0.152499, 0.000094, _at("greedy_value", 5, 500)),
        Number("from 0: pairs tried, of 400, after 2000 episodes", 329.476, 0.034, _at("tried", 0)),
        Number("from −5: pairs tried", 258.036, 0.032, _at("tried", -5)),
        Number("from 5: pairs tried", 356.978, 0.032, _at("tried", 5)),
    ),
    draw=_draw,
)
