"""Exploring the deep sea: how often the treasure is found at all (Osband, Van Roy, Russo and Wen 2019)."""

from jaxrl_tab.envs import DeepSea
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

SIZES, EPISODES = (4, 6, 8, 10, 12), 500
# epsilon and q0 of each agent, and what it is called
AT_RANDOM, GREEDY, OPTIMISTIC = (1.0, 0.0), (0.1, 0.0), (0.0, 1.0)
AGENTS = {AT_RANDOM: "at random, ε = 1", GREEDY: "ε = 0.1, from Q = 0", OPTIMISTIC: "greedy, from Q = 1"}


def _experiment(num_seeds=500):
    grid = {"alpha": 1.0, "epsilon": [0.0, 0.1, 1.0], "q0": [0.0, 1.0]}
    budget = {"num_seeds": num_seeds, "num_episodes": EPISODES, "log_every": 1}
    return {f"size-{size}": swept(DeepSea(size=size), "q-learning", grid, **budget) for size in SIZES}


def _found(ds, agent):
    """Whether each seed ever found the treasure, 0 or 1: only an episode that did gives more than 0."""
    epsilon, q0 = agent
    return (ds.returns.sel(epsilon=epsilon, q0=q0) > 0.5).any("row").astype(float)


def _share(size, agent):
    return lambda datasets: _found(datasets[f"size-{size}"], agent)


def at_random(size):
    """The probability to go right `size` times in a row in one of the episodes at least."""
    return 1 - (1 - 0.5**size) ** EPISODES


def _best(datasets):
    env = DeepSea(size=SIZES[-1])
    return planning.start_value(env, planning.value_iteration(env)[0])


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for (agent, name), color in zip(AGENTS.items(), plot.COLORS, strict=False):
        shares = [float(_found(ds, agent).mean("seed")) for ds in datasets.values()]
        ax.plot(SIZES, [100 * share for share in shares], "o-", color=color, label=name)
    exact = [100 * at_random(size) for size in SIZES]
    ax.plot(SIZES, exact, "--", color=plot.INK, lw=1, label="at random, exact")
    plot.tidy(ax, "size of the sea", f"% of runs that find the treasure in {EPISODES} episodes")
    ax.set(xticks=SIZES, ylim=(-3, 103))
    plot.legend(ax)
    seeds = next(iter(datasets.values())).sizes["seed"]
    plot.head(canvas, f"Deep sea: Q-learning, α = 1, {seeds} seeds")
    return canvas


FIGURE = Figure(
    title="Exploring the deep sea",
    source="Osband, Van Roy, Russo and Wen 2019, Deep exploration via randomized value functions",
    shows="Who acts at random finds the treasure in one of 2^size episodes; ε-greedy behaviour is worse than that, for "
    "the first thing that it learns is that going right costs. Values that begin as high as they can be lead to all "
    "that is not known yet, and the treasure is always found.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        Number("value of the best policy", 0.99, EXACT, _best, published="0.99"),
        # By counting: see `at_random`.
        *(
            Number(f"at random, size {n}: share that finds it", at_random(n), 0, _share(n, AT_RANDOM))
            for n in (8, 10, 12)
        ),
        Number("ε = 0.1, size 8: share that finds it", at_random(8) / 10, 0, _share(8, GREEDY), "at most"),
        Number("from Q = 1, size 12: share that finds it", 1, 0, _share(12, OPTIMISTIC), "at least"),
    ),
    draw=_draw,
)
