"""Mazes that change: who notices (book, examples 8.2 and 8.3, figures 8.4 and 8.5)."""

from jaxrl_tab.envs import BlockingMaze, ShortcutMaze
from jaxrl_tab.figures.figure import Figure, Number, swept

ALPHA, EPSILON, GAMMA, STEPS, KAPPA = 1.0, 0.1, 0.95, 50, 1e-3
METHODS = ("dyna-q", "dyna-q-plus")
EVERY = 50  # steps of a row
MAZES = {"blocking": (BlockingMaze(), 3000), "shortcut": (ShortcutMaze(), 6000)}  # and steps of a run


def _experiment(num_seeds=50):
    def run(maze, method):
        env, num_steps = MAZES[maze]
        grid = {"alpha": ALPHA, "epsilon": EPSILON, "gamma": GAMMA, "planning_steps": STEPS}
        grid |= {"kappa": KAPPA} if method == "dyna-q-plus" else {}
        return swept(env, method, grid, num_seeds=num_seeds, num_steps=num_steps, log_every=EVERY)

    return {f"{maze}, {method}": run(maze, method) for maze in MAZES for method in METHODS}


def _earned(maze, method, steps):
    """The rewards of the first steps of each run."""
    return lambda datasets: datasets[f"{maze}, {method}"].rewards.isel(row=slice(steps // EVERY)).sum("row")


def _draw(datasets):
    from jaxrl_tab.show import plot, words

    canvas = plot.canvas(plot.WIDTH)
    axes = canvas.subplots(1, 2)
    for ax, (maze, (env, _)) in zip(axes, MAZES.items(), strict=True):
        for method, color in zip(METHODS, plot.COLORS, strict=False):
            ds = datasets[f"{maze}, {method}"]
            steps = EVERY * (ds.row + 1)
            plot.mean_curve(ax, steps, ds.rewards.cumsum("row"), words.title_of(method), color)
        ax.axvline(env.change_at, color=plot.GREY, lw=1, ls=":")
        plot.tidy(ax, "steps", "reward so far" if maze == "blocking" else "")
        ax.set(xlim=(0, None), ylim=(0, None))
        ax.set_title(
            "The way is blocked" if maze == "blocking" else "A shorter way opens", fontsize=plot.TYPE
        )
        plot.legend(ax)
    seeds = datasets["blocking, dyna-q"].sizes["seed"]
    setting = f"α = {ALPHA:g}, ε = {EPSILON}, γ = {GAMMA}, n = {STEPS}, κ = {KAPPA}"
    plot.head(canvas, f"Mazes that change, at the dotted lines: {setting}", seeds)
    return canvas


FIGURE = Figure(
    title="Mazes that change: Dyna-Q+ tries again what it has not tried for long",
    source="Sutton and Barto 2018, figures 8.4 and 8.5",
    shows="Dyna-Q finds another way where its own is blocked, but not soon, and hardly ever a shorter one that opens: "
    "its model says that there is a wall. Dyna-Q+ finds both. The book prints curves, and not their settings; with "
    "these they look like its own.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # From 1500 runs of a plain loop each.
        Number("blocking, Dyna-Q: reward of 1000 steps", 46.93, 0.63, _earned("blocking", "dyna-q", 1000)),
        Number("blocking, Dyna-Q: of 3000", 74.38, 1.01, _earned("blocking", "dyna-q", 3000)),
        Number("blocking, Dyna-Q+: of 1000", 70.91, 0.20, _earned("blocking", "dyna-q-plus", 1000)),
        Number("blocking, Dyna-Q+: of 3000", 162.76, 0.18, _earned("blocking", "dyna-q-plus", 3000)),
        Number("shortcut, Dyna-Q: of 3000", 123.38, 0.79, _earned("shortcut", "dyna-q", 3000)),
        Number("shortcut, Dyna-Q: of 6000", 287.97, 0.77, _earned("shortcut", "dyna-q", 6000)),
        Number("shortcut, Dyna-Q+: of 3000", 136.07, 0.10, _earned("shortcut", "dyna-q-plus", 3000)),
        Number("shortcut, Dyna-Q+: of 6000", 364.69, 0.21, _earned("shortcut", "dyna-q-plus", 6000)),
    ),
    draw=_draw,
)
