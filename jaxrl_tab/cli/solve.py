"""`jaxrl-tab solve`: the exact values and an optimal policy of an environment."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from jaxrl_tab.cli.common import ENVIRONMENT, find, named_in, new_folder, start_jax, with_own
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.tables import tables
from jaxrl_tab.cli.typed import parse, values_of, word, words
from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.exact import planning
from jaxrl_tab.show.words import six_digits


@checked_dataclass
class Solve:
    """The exact values of an environment and its optimal actions.

    Examples:
      jaxrl-tab solve windy-gridworld
      jaxrl-tab solve windy-gridworld --moves king --epsilon 0.1 --out runs/king
      jaxrl-tab solve mdp.npz
      jaxrl-tab solve random-walk --states 5 --left-reward 0 --json

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv, mdp.npz,
            gymnasium:NAME.
        gamma: Discount rate.
        epsilon: Also find the best policy among those that take a random action with this probability.
        out: New folder for a picture (PNG).
        json: Print JSON: the value from the start, v [S], q [S][A], and the policy's probabilities [S][A].
    """

    env: str = word("ENV")
    gamma: float = field(default=1.0, at_least=0, at_most=1)
    epsilon: float | None = field(default=None, at_least=0, at_most=1)
    out: Path | None = None
    json: bool = False


def solve_command(argv: list[str]) -> int:
    group = with_own(ENVIRONMENT, named_in(argv)[0])
    options, typed = parse(Solve, argv, environment=group)
    cls = find(group, options.env)
    env = build(cls, options.env, values_of(options.env, typed["environment"], group))
    start_jax()
    with new_folder(options.out) as folder, busy("solving"):
        solutions = {"optimal": planning.policy_iteration(env, options.gamma)}
        if options.epsilon is not None:
            soft = f"best epsilon-soft, epsilon {words(options.epsilon)}"
            solutions[soft] = planning.epsilon_soft(env, options.epsilon, options.gamma)
        if folder:
            _draw_solutions(env, solutions, folder)
    if options.json:
        keys = ("optimal", "epsilon_soft")
        numbers = {
            key: {
                "start_value": planning.start_value(env, v),
                "v": v.tolist(),
                "q": [[None if x == policies.UNAVAILABLE else x for x in row] for row in q.tolist()],
                "policy": policy.tolist(),
            }
            for key, (policy, v, q) in zip(keys, solutions.values(), strict=False)
        }
        print_json({"environment": options.env, "gamma": options.gamma, "epsilon": options.epsilon} | numbers)
        return 0
    out = console()
    for title, (_, v, q) in solutions.items():
        out.print(
            f"[bold]{options.env}[/], gamma {words(options.gamma)}, {title}: "
            f"value from the start [bold]{six_digits(planning.start_value(env, v))}[/]"
        )
        for table in tables(env, v, q):
            out.print(table)
    if (mean_value := of_environment(env).mean_optimal_value) is not None:
        mean = escape(six_digits(mean_value(options.gamma)))
        out.print(f"Each run of a sweep draws a problem of its own; the mean over them is [bold]{mean}[/].")
    if options.out:
        say_where(options.out)
    return 0


def _draw_solutions(env: Any, solutions: Mapping[str, tuple[np.ndarray, ...]], folder: Path) -> None:
    from jaxrl_tab.show import plot

    titles = [
        f"{title}; value from the start {six_digits(planning.start_value(env, v))}"
        for title, (_, v, _) in solutions.items()
    ]
    numbers = [(v, q) for _, v, q in solutions.values()]
    plot.save(plot.solutions(env, dict(zip(titles, numbers, strict=True))), folder / "values.png")
