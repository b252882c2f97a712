"""What a step earns in tasks that do not end: river swim, and the chain (Strehl and Littman 2008; Strens 2000)."""

from jaxrl_tab.envs import Chain, RiverSwim
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

GAMMA, EPSILON, ALPHA = 0.95, 0.1, 0.1
STEPS, EVERY = 20_000, 500
INITIAL = {0.0: "Q-learning, from Q = 0", 1 / (1 - GAMMA): "Q-learning, from Q = 20"}
LOW, HIGH = INITIAL
RIVER = RiverSwim(variant="osband", max_steps=STEPS + 1)  # nothing is cut off
RUN = "q-learning"


def _experiment(num_seeds=200):
    grid = {"alpha": ALPHA, "epsilon": EPSILON, "gamma": GAMMA, "q0": [*INITIAL]}
    return {RUN: swept(RIVER, RUN, grid, num_seeds=num_seeds, num_steps=STEPS, log_every=EVERY)}


def _earned(q0):
    """What each of the last 2000 steps earned, of each seed."""
    last = slice(-2000 // EVERY, None)
    return lambda datasets: datasets[RUN].sel(q0=q0).rewards.isel(row=last).sum("row") / 2000


def _best(env, scale=1.0):
    """The largest average reward of a step."""
    return lambda datasets: scale * planning.relative_value_iteration(env)[0]


def _exploring(datasets):
    """What the best policy earns where one step in ten is any action."""
    policy = planning.relative_value_iteration(RIVER)[2]
    return planning.average_reward(RIVER, (1 - EPSILON) * policy + EPSILON / 2)


def _draw(datasets):
    from jaxrl_tab.show import plot

    ds, canvas = datasets[RUN], plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for (q0, name), color in zip(INITIAL.items(), plot.COLORS, strict=False):
        plot.mean_curve(ax, EVERY * (ds.row + 1), ds.rewards.sel(q0=q0) / EVERY, name, color)
    plot.exact_line(ax, _best(RIVER)(datasets), "best")
    plot.exact_line(ax, _exploring(datasets), f"best, if ε = {EPSILON}", ls=":")
    plot.tidy(ax, "steps", "reward a step")
    ax.set(xlim=(0, STEPS), ylim=(-0.01, None))
    plot.legend(ax)
    plot.head(canvas, f"River swim: α = {ALPHA}, ε = {EPSILON}, γ = {GAMMA}", ds.sizes["seed"])
    return canvas


FIGURE = Figure(
    title="Tasks that do not end: what a step earns",
    source="Strehl and Littman 2008, figure 1; Osband, Russo and Van Roy 2013; Strens 2000, the chain",
    shows="The large reward of river swim lies up the river. From values of 0 on hardly any run gets there; from the "
    "largest values that there can be, all do, and earn soon what the best policy earns that explores as much. Of the "
    "chain, Strens gives what its best policy earns in 1000 steps.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # By hand, from the shares of time that the chain of the best policy spends in each state.
        Number("river swim of Osband and others: best, a step", 0.428622, EXACT, _best(RIVER)),
        Number("river swim of Strehl and Littman: best, a step", 668.8073, 1e-4, _best(RiverSwim())),
        Number("chain: best, 1000 steps", 3676.8, 1e-4, _best(Chain(), 1000), published="3677"),
        # From 3000 runs of a plain loop.
        Number("from Q = 0: a step at the end", 0.005167, 0.000240, _earned(LOW)),
        Number("from Q = 20: a step at the end", 0.335746, 0.000352, _earned(HIGH)),
    ),
    draw=_draw,
)
