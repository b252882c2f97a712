"""A grid with noisy rewards: Q-learning against Double Q-learning (van Hasselt 2010, figure 4)."""

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxrl_tab.core import schedules
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

GAMMA, POWER = 0.95, 0.8
STEPS, EVERY = 10_000, 100
SIDE, START, GOAL, END = (
    3,
    6,
    2,
    9,
)  # the start is the cell at the bottom left, the goal that at the top right
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
NAMES = {"q-learning": "Q-learning", "double-q-learning": "Double Q-learning"}


def _outcomes(cell, move):
    """Each step pays -12 or 10; all actions at the goal pay 5 and end."""
    if cell >= GOAL and cell in (GOAL, END):
        return [(1.0, END, 5.0 if cell == GOAL else 0.0)]
    row, column = (min(max(x + d, 0), SIDE - 1) for x, d in zip(divmod(cell, SIDE), move, strict=True))
    return [(0.5, SIDE * row + column, reward) for reward in (-12.0, 10.0)]


ENV = FiniteMDP.from_outcomes(
    [[_outcomes(cell, move) for move in MOVES] for cell in range(END + 1)], terminal=[END], start=START
)


@pytree
class OfTwoTables:
    """1 / n^power of the visits that one of two tables learns from: it is the half of all, give or take a few."""

    power: Any
    clock: ClassVar = "visit"

    def __call__(self, n):
        return ((n + 1) / 2) ** -jnp.asarray(self.power, float)


def _experiment(num_seeds=4000, num_steps=STEPS):
    rates = {
        "q-learning": [schedules.Power(power, clock="visit") for power in (1.0, POWER)],
        "double-q-learning": [OfTwoTables(power) for power in (1.0, POWER)],
    }
    budget = {
        "num_seeds": num_seeds,
        "num_steps": num_steps,
        "log_every": EVERY,
        "record": _best_at_the_start,
    }

    def run(method):
        grid = {"alpha": rates[method], "epsilon": schedules.Power(0.5, clock="visit"), "gamma": GAMMA}
        return swept(ENV, method, grid, **budget)

    return {method: run(method) for method in NAMES}


def _best_at_the_start(state):
    return {"v_start": state.q[START].max()}


def _steps_of_the_best(datasets):
    """The average reward of a step of the best policy."""
    return planning.average_reward(ENV, planning.policy_iteration(ENV, GAMMA)[0])


def _value(datasets):
    return planning.start_value(ENV, planning.value_iteration(ENV, GAMMA)[0])


def _earned(method, rate):
    """The mean reward of the second half of the steps."""

    def measure(datasets):
        rows = datasets[method].isel(alpha=rate)
        return rows.rewards.isel(row=slice(rows.sizes["row"] // 2, None)).mean("row") / EVERY

    return measure


def _believed(method, rate):
    """max Q at the start after all steps."""
    return lambda datasets: datasets[method].isel(alpha=rate, row=-1).v_start


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    earned, believed = canvas.subplots(1, 2)
    for (method, name), color in zip(NAMES.items(), plot.COLORS, strict=False):
        for rate, (power, dash) in enumerate(zip(("1/n", f"1/n^{POWER:g}"), plot.DASHES, strict=False)):
            ds = datasets[method].isel(alpha=rate)
            steps = EVERY * (ds.row + 1)
            plot.mean_curve(earned, steps, ds.rewards / EVERY, f"{name}, {power}", color, ls=dash)
            plot.mean_curve(believed, steps, ds.v_start, "", color, ls=dash)
    plot.exact_line(earned, _steps_of_the_best(datasets), "best policy: 0.2", ls=":", lw=1)
    plot.exact_line(believed, _value(datasets), "exact: 0.36", ls=":", lw=1)
    plot.tidy(earned, "steps", "reward per step")
    plot.tidy(believed, "steps", "max Q at the start")
    for ax in (earned, believed):
        ax.set_xlim(left=0)
        plot.legend(ax)
    seeds = datasets[Q].sizes["seed"]
    plot.head(canvas, "A grid with rewards of −12 or 10, γ = 0.95, ε = 1/√n(s)", seeds)
    return canvas


Q, DOUBLE = NAMES
FIGURE = Figure(
    title="Noisy rewards: Q-learning against Double Q-learning",
    source="van Hasselt 2010, figure 4",
    shows="Q-learning takes luck for value and stays in the grid for ever, where each step costs 1 on average; at the "
    "start it believes in 15 instead of 0.36. Double Q-learning errs to the other side, and goes to the goal. With the "
    "step size 1/n^0.8 both are nearer.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_steps": 1000},
    numbers=(
        # Exact ones by hand; the others from 10 000 runs of a plain loop. The paper counts the visits of each table.
        Number("average reward of a step of the best policy", 0.2, EXACT, _steps_of_the_best, "is", "0.2"),
        Number("exact value of the start", 0.362656, EXACT, _value, "is", "0.36"),
        Number("Q-learning, 1/n: max Q at the start", 14.730529, 0.055553, _believed(Q, 0)),
        Number("Q-learning, 1/n^0.8: max Q at the start", 6.735106, 0.038815, _believed(Q, 1)),
        Number("Q-learning, 1/n^0.8: reward per step, second half", -0.938910, 0.002200, _earned(Q, 1)),
        Number("Double Q-learning, 1/n: max Q at the start", -5.204393, 0.038849, _believed(DOUBLE, 0)),
        Number("Double Q-learning, 1/n^0.8: max Q at the start", -3.053736, 0.034417, _believed(DOUBLE, 1)),
        Number(
            "Double Q-learning, 1/n^0.8: reward per step, second half", 0.145211, 0.001922, _earned(DOUBLE, 1)
        ),
    ),
    draw=_draw,
)
