"""The names of states, as people know them."""

from collections.abc import Callable

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.types import Environment
from jaxrl_tab.envs.base import Grid


def state_names(env: Environment) -> Callable[[int], str]:
    """A function from the number of a state to its name.

    That is the cell "(3, 0)" in a grid; "player 13, dealer shows 2, usable ace" where people see the states in
    tables; elsewhere what the environment calls it, or the number itself. The terminal state that is in none of the
    tables is "end".
    """
    if isinstance(env, Grid):
        return lambda s: str(divmod(s, env.shape[1]))
    declared = of_environment(env)
    if not (panels := declared.panels()):
        return declared.state_name or str
    names = {
        int(s): ", ".join(
            filter(None, [f"{panel.down} {row}".strip(), f"{panel.along} {column}", panel.title])
        )
        for panel in panels
        for row, of_row in zip(panel.rows, panel.states, strict=True)
        for column, s in zip(panel.columns, of_row, strict=True)
    }
    return lambda s: names.get(s, "end")
