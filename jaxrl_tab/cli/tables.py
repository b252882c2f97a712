"""Tables of states for the terminal: values and best actions, in the places where people see the states."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli.streams import too_narrow
from jaxrl_tab.core import policies
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.envs.base import Grid, Panel
from jaxrl_tab.exact import planning
from jaxrl_tab.show.moves import preferring
from jaxrl_tab.show.words import short_number, six_digits

WIDEST = 100_000  # characters of a line, where nothing limits them
MANY_STATES = 500  # the rows of a table that people look through, at most


def tables(env: Any, v: np.ndarray, q: np.ndarray | None, of_v: str = "value") -> list[Table]:
    """Values and best actions: where people see the states in tables in their places, else as a list.

    Args:
        env: the environment.
        v: values, float [S].
        q: action values, float [S, A]; None: there are no best actions.
        of_v: what `v` is called.
    """
    model, declared = planning.exact_model(env), of_environment(env)
    visited, terminal = planning.reachable(model), planning.terminal_states(model)
    best = _best(env, q)
    if not declared.panels() or env.num_states > MANY_STATES:
        choice = q is not None and env.num_actions > 1
        table = Table("state", of_v, *(["best actions"] if choice else []))
        listed = np.flatnonzero(visited & ~terminal)
        for s in listed[:MANY_STATES]:
            table.add_row(str(s), six_digits(float(v[s])), *([best(s)] if choice else []))
        if (more := len(listed) - MANY_STATES) > 0:
            table.caption = f"and {more} more states: --json prints them all"
        return [table]
    acts = visited & ~terminal
    actions = _lettered(env, [f"[cyan]{best(s)}[/]" for s in range(env.num_states)], acts)
    cells = [f"{short_number(v[s])}\n{x}" if acts[s] else x for s, x in enumerate(actions)]
    shown = [_panel(panel, cells, declared.wind) for panel in declared.panels()]
    if not all(cells[s] for s in np.flatnonzero(~visited & ~terminal)):
        shown[-1].caption = "empty: out of reach from the start"
    return shown


def show(out: Console, *shown: Table) -> None:
    """Prints tables of places, whole where that is a file; of a window that is too narrow it says so."""
    of, width = out.options.update(max_width=WIDEST), out.width
    widest = max(table.__rich_measure__(out, of).minimum for table in shown)
    if not out.is_terminal:
        out.width = max(width, widest)
    for table in shown:
        out.print(table)
    out.width = width
    if out.is_terminal and widest > width:
        out.print(too_narrow(widest))


def position(env: Any, q: np.ndarray | None, s: int) -> list[Table]:
    """Where the agent is: the table with state `s`, marked, and the best actions of the states in it.

    They are left out where all actions are equally good, as where nothing has been learned yet.
    """
    best = _best(env, q)
    prefers = np.zeros(env.num_states, bool) if q is None else preferring(q)
    cells = [f"[dim cyan]{best(i)}[/]" if prefers[i] else "" for i in range(env.num_states)]
    if isinstance(env, Grid):
        model = planning.exact_model(env)
        acts = planning.reachable(model) & ~planning.terminal_states(model)
        cells = _lettered(env, cells, acts, starts=False)
    cells[s] = "[bold reverse] ● [/]"
    declared = of_environment(env)
    return [
        _panel(panel, cells, declared.wind, lines=False) for panel in declared.panels() if s in panel.states
    ]


def arrows(env: Grid, policy: np.ndarray, title: str) -> Table:
    """The likeliest actions of a policy [S, A], on a grid; "any" where all are as likely."""
    model, declared = planning.exact_model(env), of_environment(env)
    shown = planning.reachable(model) & ~planning.terminal_states(model)
    best, prefers = _best(env, policy), preferring(policy)
    cells = [
        (f"[cyan]{best(s)}[/]" if prefers[s] else "any") if shown[s] else "" for s in range(env.num_states)
    ]
    cells = _lettered(env, cells, shown)
    (panel,) = declared.panels()
    return _panel(panel._replace(title=title), cells, declared.wind, lines=False)


def _lettered(env: Any, cells: Sequence[str], acts: np.ndarray, starts: bool = True) -> list[str]:
    """The cells of states in which one `acts`, bool [S], and the others empty; on a grid with its letters and walls.

    Without `starts` these have no letter.
    """
    shown = [cell if own else "" for cell, own in zip(cells, acts, strict=True)]
    if not isinstance(env, Grid):
        return shown
    for s, letter in env.letters.items():
        if acts[s] and (starts or letter != "S"):
            shown[s] = f"[bold reverse]{escape(letter)}[/] {shown[s]}"
        elif not acts[s]:
            shown[s] = f"[bold green]{letter}[/]" if letter == "G" else f"[bold]{escape(letter)}[/]"
    for cell in env.walls:
        shown[env.state(cell)] = "[dim]▒▒▒▒▒[/]"
    return shown


def _best(env: Any, q: np.ndarray | None) -> Callable[[int], str]:
    """A function from a state to the names of its best actions; empty where there are no action values."""
    between, names = "" if isinstance(env, Grid) else " ", of_environment(env).action_names
    return lambda s: "" if q is None else between.join(names[a] for a in best_actions(q[s]))


def best_actions(q: np.ndarray) -> np.ndarray:
    """The actions whose values are maximal but for rounding, int [n], from values [A]."""
    return np.flatnonzero(q >= q.max() - 1e-9 * abs(q[q > policies.UNAVAILABLE]).max(initial=0))


def _panel(panel: Panel, cells: Sequence[str], wind: Any, lines: bool = True) -> Table:
    """The `cells` of the states in a panel; below its columns the wind, where there is any."""
    axes = f"{panel.down} ↓, {panel.along} →" if panel.down else ""
    title = ": ".join(filter(None, [panel.title, axes]))
    table = Table("", *panel.columns, title=title or None, show_lines=lines, padding=0)
    table.show_footer = wind is not None
    footers = ["wind", *([""] * len(panel.columns) if wind is None else wind)]
    for column, footer in zip(table.columns, footers, strict=True):
        column.footer, column.justify, column.no_wrap, column.min_width = str(footer), "center", True, 5
    table.columns[0].min_width = None
    for name, row in zip(panel.rows, panel.states, strict=True):
        table.add_row(name, *(cells[int(s)] for s in row))
    return table
