"""What `jaxrl-tab solve --hardness` prints: how hard a task is to learn, each number with a sentence."""

from typing import Any

import numpy as np
from rich.table import Table

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.hardness import MOST_STATES
from jaxrl_tab.show.words import number


def hardness_table(env: Any, found: planning.Hardness, gamma: float) -> Table:
    table = Table("how hard it is", "", "what that means", show_lines=True)
    table.columns[1].justify = "right"
    for name, value, meaning in _rows(env, found, gamma):
        table.add_row(name, number(value), meaning)
    if np.isnan(found.diameter):
        table.caption = f"–: not worked out for more than {MOST_STATES} states"
    return table


def _rows(env: Any, found: planning.Hardness, gamma: float) -> list[tuple[str, float, str]]:
    gaps = found.gaps
    where = "no action is worse than another"
    if np.isfinite(gaps.smallest):
        action = of_environment(env).action_names[gaps.action]
        where = f"what the closest wrong action loses: {action} in state {gaps.state}; samples to tell grow as 1/gap²"
    counted = "steps of an episode" if gamma == 1 else "steps from the start, that at t counted γ^t times"
    forgets = (
        "steps until the state says next to nothing about where one was (to 1/4), if {}; ∞: in a fixed rhythm"
    )
    return [
        ("states", found.states, "that can be reached and are not terminal"),
        (
            "diameter",
            found.diameter,
            "steps to the state that is hardest to reach, if one tries (Jaksch et al. 2010)",
        ),
        ("smallest action gap", gaps.smallest, where),
        ("span of v*", found.span, "the best state is worth so much more than the worst"),
        ("horizon", found.steps, f"{counted}, under the best policy"),
        ("mixing time, best", found.best.mixing_time, forgets.format("the best policy acts")),
        ("mixing time, any", found.anything.mixing_time, forgets.format("any action is taken")),
        (
            "second eigenvalue, any",
            found.anything.second_eigenvalue,
            "of the chain where any action is taken: by this factor a step forgets, in the end",
        ),
    ]


def as_json(found: planning.Hardness) -> dict[str, Any]:
    """For JSON, which has neither NaN nor infinity: null, and "infinite"."""
    plain = lambda x: None if np.isnan(x) else "infinite" if np.isinf(x) else x
    of = lambda named: {name: plain(x) for name, x in named._asdict().items()}
    gaps = found.gaps
    table = [[plain(x) for x in row] for row in gaps.gap.tolist()]
    return {
        "states": found.states,
        "diameter": plain(found.diameter),
        "gaps": {"smallest": plain(gaps.smallest), "state": gaps.state, "action": gaps.action, "gap": table},
        "span": found.span,
        "steps": plain(found.steps),
        "best": of(found.best),
        "anything": of(found.anything),
    }
