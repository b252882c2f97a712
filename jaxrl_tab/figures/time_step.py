"""The tyranny of the time step: the same grid in ever smaller steps (Silver, lecture 5)."""

from functools import partial

import numpy as np

from jaxrl_tab.envs import TraceGridworld
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept
from jaxrl_tab.figures.lambda_arrows import follows, path

METHOD = "sarsa-lambda"
GAMMA, LAMBDA = 0.95, 0.9  # per unit of time, in which a unit of the way is gone
ALPHA, EPSILON = 0.5, 0.1
WAY = "↑→↑→↑→"  # in units
PARTS = (1, 2, 4, 8)  # steps to a unit
LEARNED = PARTS[:3]  # those with which it also learns to find the way
SARSA, PER_STEP, PER_UNIT = KINDS = (
    "one-step Sarsa",
    f"λ = {LAMBDA} per step",
    f"λ = {LAMBDA} per unit of time",
)
SHARE = 0.1  # of the largest change, or of what the start is worth


def _grid(parts):
    """The grid of 5 times 6 units, with so many steps to a unit: entering the goal pays 1 with any."""
    shape, start, goal = (5 * parts + 1, 6 * parts + 1), (4 * parts, parts), (parts, 4 * parts)
    return TraceGridworld(shape=shape, start=start, goal=goal, max_steps=100_000)


def _gamma(parts):
    return GAMMA ** (1 / parts)


def _lam(kind, parts):
    return {SARSA: 0.0, PER_STEP: LAMBDA, PER_UNIT: LAMBDA ** (1 / parts)}[kind]


def _experiment(num_seeds=100, num_episodes=200, along_the_way=100):
    """Episodes that all go the same way, and runs that have to find one."""

    def run(parts, record, policy, **budget):
        lambdas = list(dict.fromkeys(_lam(kind, parts) for kind in KINDS))
        grid = {"lam": lambdas, "alpha": ALPHA, "gamma": _gamma(parts), "trace": "replacing", **policy}
        return swept(_grid(parts), METHOD, grid, record=record, **budget)

    def same_way(parts):
        env = _grid(parts)
        policy = {"behaviour": follows(env, _moves(parts))}
        return run(
            parts, partial(_pairs, *path(env, _moves(parts))), policy, num_seeds=1, num_episodes=along_the_way
        )

    def learning(parts):
        record = partial(_start, _grid(parts).start_state)
        return run(parts, record, {"epsilon": EPSILON}, num_seeds=num_seeds, num_episodes=num_episodes)

    return {f"way-{m}": same_way(m) for m in PARTS} | {f"learning-{m}": learning(m) for m in LEARNED}


def _pairs(states, actions, learner):
    """Q of the pairs of the way, from its last step to its first, [steps]."""
    return {"pairs": learner.q[states, actions][::-1]}


def _start(state, learner):
    """The largest value of an action in the start state, []."""
    return {"start": learner.row(state).max()}


def _moves(parts):
    return "".join(move * parts for move in WAY)


def _of(datasets, name, kind, parts):
    return datasets[f"{name}-{parts}"].sel(lam=_lam(kind, parts), method="nearest").astype(float)


def _changes(datasets, kind, parts):
    """What the first episode changes along the way, from its last step to its first, as a part of the largest."""
    change = _of(datasets, "way", kind, parts).pairs.isel(seed=0, row=0).values
    return change / change.max()


def _told(kind, parts):
    """The share of the steps of the way whose change is a tenth of the largest one or more."""
    return lambda datasets: (_changes(datasets, kind, parts) >= SHARE).mean()


def _episodes(start, parts):
    """After how many episodes the start is at a tenth of its value or above, [seed]; all of them if it never is."""
    there = (start >= SHARE * _gamma(parts) ** (parts * len(WAY) - 1)).transpose("seed", "row").values
    return np.where(there.any(1), there.argmax(1) + 1, there.shape[1])


def _along(kind, parts):
    """The number of episodes that all go the same way."""
    return lambda datasets: _episodes(_of(datasets, "way", kind, parts).pairs.isel(pairs_0=-1), parts)[0]


def _learning(kind, parts):
    """The number of episodes of each run that learns to find the way."""
    return lambda datasets: _episodes(_of(datasets, "learning", kind, parts).start, parts)


def _draw(datasets):
    import xarray as xr
    from matplotlib.ticker import NullLocator

    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    *spreads, counts = canvas.subplots(2, 2).ravel()
    looks = dict(zip(PARTS, ("-", "--", "-.", ":"), strict=True))
    for ax, kind, color in zip(spreads, KINDS, plot.COLORS, strict=False):
        for parts, dash in looks.items():
            change = _changes(datasets, kind, parts)
            edges = np.arange(len(change) + 1) / parts
            ax.stairs(change, edges, color=color, ls=dash, lw=1.6, label=f"{parts} to the unit")
        ax.set(xlim=(len(WAY), 0), ylim=(0, 1.03))
        plot.tidy(ax, "distance to the goal, units", "change, of the largest")
        ax.set_title(f"The first episode: {kind}", fontsize=plot.TYPE)
        plot.legend(ax)
    for kind, color, marker in zip(KINDS, plot.COLORS, plot.MARKERS, strict=False):
        along = [_along(kind, parts)(datasets) for parts in PARTS]
        counts.plot(PARTS, along, ":", color=color, marker=marker, mfc="white", ms=5)
        runs = xr.DataArray([_learning(kind, parts)(datasets) for parts in LEARNED], dims=("parts", "seed"))
        plot.mean_curve(counts, LEARNED, runs, kind, color, marker=marker, ms=5)
    plot.tidy(counts, "steps to the unit", "episodes")
    counts.set(xscale="log", yscale="log")
    for axis, ticks in ((counts.xaxis, PARTS), (counts.yaxis, (1, 3, 10, 30, 100))):
        axis.set_ticks(ticks, labels=map(str, ticks))
        axis.set_minor_locator(NullLocator())
    counts.set_title("Episodes until the start is at a tenth of its value", fontsize=plot.TYPE)
    plot.legend(counts)
    seeds = datasets[f"learning-{LEARNED[0]}"].sizes["seed"]
    plot.head(
        canvas,
        f"The same grid in ever smaller steps: α = {ALPHA}, γ = {GAMMA} per unit of time\n"
        f"white: the same way each time; filled: {seeds} runs, ε = {EPSILON}, mean and 95% interval",
    )
    return canvas


FIGURE = Figure(
    title="The tyranny of the time step",
    source="Silver, lecture 5, on the Sarsa(λ) gridworld example; Sutton and Barto 2018, section 12.7",
    shows="One episode tells one-step Sarsa of one step, which is the less of the way the smaller the steps are: it "
    "needs the more episodes, and so does Sarsa(λ) where λ stays the same per step. Where λ stays the same per unit of "
    "time (the lecture leaves open which it means), an episode tells as much of the way as before. Runs that have to "
    "find one then need 2.1, 2.7 and 3.9 episodes, and one-step Sarsa 14, 37 and 102.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 4},
    numbers=(
        # By hand: one step of 6 m; the k steps before the last for which (γλ)^k is a tenth or more.
        Number(f"{SARSA}, 1 step to the unit: share of the way told", 1 / 6, EXACT, _told(SARSA, 1)),
        Number(f"{SARSA}, 8 steps: share told", 1 / 48, EXACT, _told(SARSA, 8)),
        Number(f"{PER_STEP}, 4 steps: share told", 20 / 24, EXACT, _told(PER_STEP, 4)),
        Number(f"{PER_STEP}, 8 steps: share told", 21 / 48, EXACT, _told(PER_STEP, 8)),
        Number(f"{PER_UNIT}, 8 steps: share told", 1, EXACT, _told(PER_UNIT, 8)),
        # As soon as of n fair coins 6 m show heads with a probability of a tenth; the others by a plain loop.
        Number(f"{SARSA}, 1 step: episodes of the same way", 8, EXACT, _along(SARSA, 1)),
        Number(f"{SARSA}, 8 steps: episodes of the same way", 84, EXACT, _along(SARSA, 8)),
        Number(f"{PER_STEP}, 8 steps: episodes of the same way", 5, EXACT, _along(PER_STEP, 8)),
        Number(f"{PER_UNIT}, 8 steps: episodes of the same way", 1, EXACT, _along(PER_UNIT, 8)),
        # From 20 000 runs of a plain loop and more.
        Number(f"{SARSA}, 1 step: episodes to learn it", 14.0167, 0.0077, _learning(SARSA, 1)),
        Number(f"{SARSA}, 4 steps: episodes to learn it", 101.78, 0.13, _learning(SARSA, 4)),
        Number(f"{PER_STEP}, 4 steps: episodes to learn it", 11.823, 0.027, _learning(PER_STEP, 4)),
        Number(f"{PER_UNIT}, 1 step: episodes to learn it", 2.120, 0.0028, _learning(PER_UNIT, 1)),
        Number(f"{PER_UNIT}, 4 steps: episodes to learn it", 3.869, 0.0095, _learning(PER_UNIT, 4)),
    ),
    draw=_draw,
)
