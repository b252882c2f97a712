"""`jaxrl-tab bridge`: dynamic programming beside temporal differences, and that one is the mean of the other."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.algorithms import bridge
from jaxrl_tab.cli.common import (
    OF_ONE_METHOD,
    build_named,
    groups_in,
    new_folder,
    prepare,
    start_jax,
)
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import parse, word
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.core.types import available_actions
from jaxrl_tab.engine.train import train
from jaxrl_tab.exact import planning
from jaxrl_tab.show.states import state_names
from jaxrl_tab.show.words import counted, six_digits

SHOWN = 5  # of the entries, those that the backup would change the most
SAME = 1e-9  # times the largest number: what two sums may differ by that are the same


@checked_dataclass
class Bridge:
    """Dynamic programming beside temporal differences: three Bellman equations, each with both of its backups.

    A full backup sums over all that may happen, a sample backup draws one of it. Beside each update is its diagram:
    open circles are states, solid ones are actions, an arc is a maximum. With an environment and a one-step method the
    method learns for a while; then the mean of the targets that it may draw is worked out from its own update, in
    each state and for each action, and compared with the full backup.

    Examples:
      jaxrl-tab bridge
      jaxrl-tab bridge windy-gridworld q-learning --stochastic --steps 5000
      jaxrl-tab bridge random-walk td --out runs/bridge
      jaxrl-tab bridge --json

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv, mdp.npz,
            gymnasium:NAME.
        method: Name of a one-step method, or of your own: mine.py:MyMethod.
        steps: How long it learns before.
        seed: Of what it learns from.
        out: New folder for a picture (PNG and SVG).
        json: Print JSON.
    """

    env: str = word("[ENV]")
    method: str = word("[METHOD]")
    steps: int = field(default=1000, at_least=1)
    seed: int = field(default=0, at_least=0)
    out: Path | None = None
    json: bool = False


class Compared(NamedTuple):
    """What a method has learned, the mean of what it samples there, and the full backup.

    Attributes:
        env, method: the instances.
        row: that of the table.
        values, mean, full: float64, [S, A] or [S]; UNAVAILABLE where a state does not have an action.
    """

    env: Any
    method: Any
    row: bridge.Row
    values: np.ndarray
    mean: np.ndarray
    full: np.ndarray

    @property
    def there(self) -> np.ndarray:
        """Which of the entries there are, bool."""
        return self.values != UNAVAILABLE

    @property
    def difference(self) -> float:
        """The largest between the mean and the full backup."""
        return float(np.abs(self.mean - self.full)[self.there].max())

    @property
    def is_same(self) -> bool:
        """Whether that is rounding."""
        return self.difference <= SAME * max(1.0, float(np.abs(self.full[self.there]).max()))


def bridge_command(argv: list[str]) -> int:
    prepare()
    groups = groups_in(argv, OF_ONE_METHOD)
    options, typed = parse(Bridge, argv, **groups)
    compared = None
    of_learning = {"--steps", "--seed"} & set(typed["options"])
    if options.env or typed["environment"] or typed["hyperparameters"] or of_learning:
        env, method = build_named(groups, typed, environment=options.env, hyperparameters=options.method)
        row = bridge.row_of(method)
        start_jax()
        with busy("learning and comparing"):
            compared = _compare(env, method, row, options)
    with new_folder(options.out) as folder:
        if folder:
            _draw(folder)
    if options.json:
        rows = [_data(row) for row in bridge.TABLE]
        print_json({"rows": rows, "compared": None if compared is None else _numbers(compared, options)})
        return 0
    if compared is None:
        console().print(bridge.table(), markup=False, soft_wrap=True)
    else:
        _print(compared, options)
    if options.out:
        say_where(options.out)
    return 0


def _compare(env: Any, method: Any, row: bridge.Row, options: Bridge) -> Compared:
    if differs := of_environment(env).differs:
        raise InputError(f"{differs} in {options.env}, so that no backup is that of all")
    planning.exact_model(env)  # raises InputError where there is none, before anything is learned
    state, _ = train(jax.random.key(options.seed), method, env, num_steps=options.steps)
    values = np.asarray(state.v if of_method(method).learns is Learns.STATES else state.q, np.float64)
    if values.ndim == 2 and (available := available_actions(env)) is not None:
        values = np.where(available, values, UNAVAILABLE)
    if not np.isfinite(values).all():
        raise InputError(
            f"after {counted(options.steps, 'steps')} {options.method} has diverged: a value is infinite, or not a "
            "number; take a smaller alpha, or fewer steps"
        )
    mean, full = bridge.expected_backup(method, env, values), bridge.full_backup(method, env, values)
    return Compared(env, method, row, values, mean, full)


def _print(compared: Compared, options: Bridge) -> None:
    out, of_states = console(), compared.values.ndim == 1
    entries = counted(int(compared.there.sum()), "states" if of_states else "pairs of state and action")
    out.print(
        f"{options.method} in {options.env}, after {counted(options.steps, 'steps')}\n",
        style="bold",
        markup=False,
    )
    diagram = of_method(compared.method).backup
    lines = bridge.beside(compared.row, options.method, diagram)
    words = [diagram.words, ""] if diagram and diagram.words else []
    out.print("\n".join([*lines, "", *words]), markup=False, soft_wrap=True)
    name, symbol = state_names(compared.env), "V(s)" if of_states else "Q(s, a)"
    table = Table(
        "state s", *([] if of_states else ["action a"]), symbol, "mean of the sample", "full backup"
    )
    for column in table.columns[-3:]:
        column.justify = "right"
    change = np.where(compared.there, np.abs(compared.full - compared.values), 0)
    for i in np.argsort(-change, axis=None, kind="stable")[:SHOWN]:
        at = np.unravel_index(int(i), change.shape)
        actions = [] if of_states else [of_environment(compared.env).action_names[int(at[1])]]
        numbers = [six_digits(float(x[at])) for x in (compared.values, compared.mean, compared.full)]
        if change[at] > 0:
            table.add_row(*map(escape, [name(int(at[0])), *actions, *numbers]))
    table.caption = f"what the backup changes the most, of {entries}"
    print_table(out, table)
    verdict = "is" if compared.is_same else "is not"
    out.print(
        f"The mean of what is sampled {verdict} the full backup: the largest difference over all {entries} "
        f"is {compared.difference:.2g}.",
        soft_wrap=True,
    )


def _data(row: bridge.Row) -> dict[str, Any]:
    return {
        "equation": row.equation,
        "full": {"method": row.full, "update": row.full_update, "diagram": row.full_diagram.diagram()},
        "sample": {
            "method": row.sample,
            "update": row.sample_update,
            "diagram": row.sample_diagram.diagram(),
        },
        "methods": row.methods,
    }


def _numbers(compared: Compared, options: Bridge) -> dict[str, Any]:
    def listed(x: np.ndarray) -> list[Any]:
        x = x.astype(object)
        x[~compared.there] = None
        return x.tolist()

    return {
        "environment": options.env,
        "method": options.method,
        "steps": options.steps,
        "seed": options.seed,
        "equation": compared.row.equation,
        "values": listed(compared.values),
        "mean_of_samples": listed(compared.mean),
        "full_backup": listed(compared.full),
        "largest_difference": compared.difference,
    }


def _draw(folder: Path) -> None:
    from jaxrl_tab.show import plot

    figure = plot.bridge()
    for ending in ("png", "svg"):
        plot.save(figure, folder / f"bridge.{ending}")
