"""Blackjack: what the policy that sticks on 20 is worth, by Monte Carlo prediction (book, figure 5.1)."""

import numpy as np

from jaxrl_tab.core.policies import Table
from jaxrl_tab.envs import Blackjack
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.blackjack import SHOWN, SUMS, USABLE, surface
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept
from jaxrl_tab.figures.importance_sampling import sticks_on_20

METHOD = "monte-carlo-prediction"
GAMES = {"after 10 000 games": 10_000, "after 500 000 games": 500_000}
FEW, MANY = GAMES


def _experiment(num_seeds=32, few=GAMES[FEW], many=GAMES[MANY]):
    def run(games):
        grid, budget = (
            {"pi": Table(sticks_on_20())},
            {"num_episodes": games, "log_every": games, "exact": True},
        )
        return swept(Blackjack(), METHOD, grid, num_seeds=num_seeds, **budget)

    return {FEW: run(few), MANY: run(many)}


def _exact():
    return planning.evaluate(Blackjack(), sticks_on_20())


def _by_hand(v):
    """Values [S] as [usable ace, player's sum, dealer's card]."""
    return np.asarray(v)[:-1].reshape(2, len(SUMS), len(SHOWN))


def _error(name):
    """The RMS error over all hands, of each seed."""
    return lambda datasets: datasets[name].v_error.isel(row=-1)


def _start_value(datasets):
    return planning.start_value(Blackjack(), _exact())


def _usable(name):
    """How many times as large the RMS error of hands with a usable ace is, over seeds."""

    def measure(datasets):
        v = datasets[name].q.values.reshape(-1, Blackjack().num_states)
        wrong = np.stack([_by_hand(x) - _by_hand(_exact()) for x in v])
        errors = np.sqrt((wrong**2).mean((0, 2, 3)))
        return errors[1] / errors[0]

    return measure


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 5.0)
    tables = {name: ds.q.isel(seed=0).values.ravel() for name, ds in datasets.items()} | {"exactly": _exact()}
    deep, values = [], None
    for row, (usable, has) in enumerate(USABLE.items()):
        for column, (name, v) in enumerate(tables.items()):
            deep.append(ax := canvas.add_subplot(2, 3, 3 * row + column + 1, projection="3d"))
            values = surface(ax, _by_hand(v)[usable])
            ax.set_title(f"{name}\n{has}", fontsize=plot.TYPE)
    plot.color_bar(values, deep, length=0.5)
    plot.head(canvas, "Blackjack: the values of the policy that sticks on 20 and 21 only")
    return canvas


FIGURE = Figure(
    title="Blackjack: the values of a policy, by Monte Carlo and exactly",
    source="Sutton and Barto 2018, figure 5.1",
    shows="After 10 000 games the values of hands without a usable ace are smooth; those with one, which are rarer, "
    "are still rough. After half a million games both are like the exact ones.",
    experiment=_experiment,
    small={"num_seeds": 2, "few": 100, "many": 200},
    numbers=(
        # The value by enumeration; the others from a plain loop, of 300 and of 60 runs. The book has pictures.
        Number("exact value from the start", -0.353554, EXACT, _start_value),
        Number("RMS error over hands after 10 000 games", 0.19752, 0.00106, _error(FEW)),
        Number("the same after 500 000", 0.02602, 0.00032, _error(MANY)),
        Number("with a usable ace it is so many times as large", 3, 0, _usable(FEW), "at least"),
    ),
    draw=_draw,
)
