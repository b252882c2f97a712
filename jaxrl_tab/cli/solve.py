"""`jaxrl-tab solve`: the exact values and an optimal policy of an environment."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from jaxrl_tab.cli import hard
from jaxrl_tab.cli.common import ENVIRONMENT, find, named_in, new_folder, start_jax, with_own
from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import busy, say_where
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.tables import arrows, show, tables
from jaxrl_tab.cli.typed import parse, values_of, word, words
from jaxrl_tab.cli.ways import Way, solved_by
from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.envs.base import Grid
from jaxrl_tab.exact import planning
from jaxrl_tab.show.words import counted, six_digits, some

ROWS, POLICIES = 20, 10  # of iterates that are printed, at most; and of grids of arrows
CLOSE = 1e-6  # a relative error that is none


@checked_dataclass
class Solve:
    """The exact values of an environment and its optimal actions.

    Examples:
      jaxrl-tab solve windy-gridworld
      jaxrl-tab solve windy-gridworld --moves king --epsilon 0.1 --out runs/king
      jaxrl-tab solve mdp.npz
      jaxrl-tab solve random-walk --states 5 --left-reward 0 --json
      jaxrl-tab solve cliff-walking --steps
      jaxrl-tab solve windy-gridworld --steps --sweeps 1 --out runs/value-iteration
      jaxrl-tab solve frozen-lake --gamma 0.99 --by anderson
      jaxrl-tab solve frozen-lake --horizon 20
      jaxrl-tab solve frozen-lake --hardness

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv, mdp.npz,
            gymnasium:NAME.
        gamma: Discount rate.
        epsilon: Also find the best policy among those that take a random action with this probability.
        temperature: Also find the best policy where each choice earns its entropy times this.
        by: Find the values in this way, and say what it took. The ways are exact but for rounding, or to 1e-10.
        horizon: Find the best values of a task that ends after so many steps; what is best may depend on the time left.
        hardness: Also say how hard the task is: its diameter, its smallest action gap, how fast policies mix.
        steps: Also show the way there, iterate by iterate: policy iteration, from the policy that takes any action.
        sweeps: With --steps, or --by modified: sweeps of evaluation between two improvements, from v = 0 on; 1 is value
            iteration. By default evaluation is exact with --steps, and has 5 sweeps with --by modified.
        out: New folder for pictures (PNG).
        json: Print JSON: the value from the start, v [S], q [S][A], and the policy's probabilities [S][A]; with
            --steps also those of each iterate.
    """

    env: str = word("ENV")
    gamma: float = field(default=1.0, at_least=0, at_most=1)
    epsilon: float | None = field(default=None, at_least=0, at_most=1)
    temperature: float | None = field(default=None, greater_than=0)
    by: Way = "policy-iteration"
    horizon: int | None = field(default=None, at_least=1)
    hardness: bool = False
    steps: bool = False
    sweeps: int | None = field(default=None, at_least=1)
    out: Path | None = None
    json: bool = False


def solve_command(argv: list[str]) -> int:
    group = with_own(ENVIRONMENT, named_in(argv)[0])
    options, typed = parse(Solve, argv, environment=group)
    cls = find(group, options.env)
    env = build(cls, options.env, values_of(options.env, typed["environment"], group))
    way = options.by if "--by" in typed["options"] else None
    _check(options, way)
    start_jax()
    if options.horizon:
        return _until(env, options, options.horizon)
    if of_environment(env).continuing and options == Solve(env=options.env, json=options.json):
        return _in_the_long_run(env, options)
    with new_folder(options.out) as folder, busy("solving"):
        found = solved_by(env, way, options.gamma, options.sweeps) if way else None
        best = found[:3] if found else planning.policy_iteration(env, options.gamma)
        solutions, epsilons = {"optimal": best}, {"optimal": 0.0}
        if options.epsilon is not None:
            soft = f"best epsilon-soft, epsilon {words(options.epsilon)}"
            solutions[soft] = planning.epsilon_soft(env, options.epsilon, options.gamma)
            epsilons[soft] = options.epsilon
        if options.temperature is not None:
            soft = f"best with entropy, temperature {words(options.temperature)}"
            solutions[soft] = planning.soft_value_iteration(env, options.temperature, options.gamma)
        hardness = planning.hardness(env, options.gamma) if options.hardness else None
        histories = {
            title: planning.generalized_policy_iteration(
                env, options.gamma, sweeps=options.sweeps, epsilon=epsilon
            )
            for title, epsilon in (epsilons if options.steps else {}).items()
        }
        if folder:
            _draw_solutions(env, solutions, folder)
            _draw_steps(env, histories, f"{options.env}, gamma {words(options.gamma)}", folder)
    if options.json:
        keys = [
            "optimal",
            *["epsilon_soft"] * (options.epsilon is not None),
            *["entropy_soft"] * (options.temperature is not None),
        ]
        numbers = {
            key: _numbers(env, *solutions[title], histories.get(title))
            for key, title in zip(keys, solutions, strict=True)
        }
        about = {"environment": options.env, "gamma": options.gamma, "epsilon": options.epsilon}
        more = {"by": {"way": way} | found.took} if found else {}
        more |= {"hardness": hard.as_json(hardness)} if hardness else {}
        print_json(about | numbers | more)
        return 0
    out = console()
    for title, (_, v, q) in solutions.items():
        out.print(
            f"[bold]{options.env}[/], gamma {words(options.gamma)}, {title}: "
            f"value from the start [bold]{six_digits(planning.start_value(env, v))}[/]"
        )
        if title in histories:
            _print_steps(env, histories[title])
        if found and title == "optimal":
            out.print(found.said, soft_wrap=True)
        show(out, *tables(env, v, q))
    if hardness:
        print_table(out, hard.hardness_table(env, hardness, options.gamma))
    if (rate := of_environment(env).discount) not in (None, options.gamma):
        out.print(f"Its source states a discount rate of {rate:g}: `--gamma {rate:g}` takes it.")
    if (mean_value := of_environment(env).mean_optimal_value) is not None:
        mean = escape(six_digits(mean_value(options.gamma)))
        out.print(f"Each run of a sweep draws a problem of its own; the mean over them is [bold]{mean}[/].")
    if options.out:
        say_where(options.out)
    return 0


def _check(options: Solve, way: str | None) -> None:
    """Raises InputError where options do not go together."""
    if options.sweeps and not options.steps and way != "modified":
        raise InputError(
            "--sweeps says how to make the steps that --steps shows; give both, or --by modified"
        )
    if way and options.steps:
        raise InputError(
            f"--steps shows policy iteration step by step, and --by {way} does it unseen; give one of them"
        )
    others = ("epsilon", "temperature", "hardness", "steps", "out")
    given = [f"--{name}" for name in others if getattr(options, name) not in (None, False)]
    if options.horizon and (given := [*["--by"] * (way is not None), *given]):
        raise InputError(
            f"--horizon is a task of its own, solved by backward induction; leave {given[0]} out"
        )


def _until(env: Any, options: Solve, horizon: int) -> int:
    """What `--horizon` prints: the values of the first step, and where what is best depends on the time left."""
    with busy("solving"):
        found = planning.finite_horizon(env, horizon, options.gamma)
    values = [float(planning.start_value(env, v)) for v in found.v]
    if options.json:
        about = {"environment": options.env, "gamma": options.gamma, "horizon": horizon}
        print_json(
            about | {"start_value": values} | {name: x.tolist() for name, x in found._asdict().items()}
        )
        return 0
    out = console()
    what = f"[bold]{options.env}[/], gamma {words(options.gamma)}, ended after {counted(horizon, 'steps')}"
    out.print(f"{what}: value from the start [bold]{six_digits(values[0])}[/]")
    show(out, *tables(env, found.v[0], found.q[0]))
    first, states = found.policy[0], planning.reachable(planning.exact_model(env))
    later = ~((found.policy > 0) & (first > 0)).any(-1) & states  # no action is best both now and then
    if n := int(later.any(0).sum()):
        said = (
            f"In {counted(n, 'states')} another action is best when less time is left: --json has every step."
        )
    else:
        said = "However little time is left, an action that is best now is still best."
    out.print(said, soft_wrap=True)
    return 0


def _in_the_long_run(env: Any, options: Solve) -> int:
    """What is printed of a task that does not end, where no gamma is given: what a step earns in the long run."""
    with busy("solving"):
        rate, bias, policy = planning.relative_value_iteration(env)
    # The bias of each action: what it pays, and the bias of where it leads, less what a step earns on average.
    q = planning.backup(planning.exact_model(env), bias, 1.0) - rate
    if options.json:
        numbers = {"bias": bias.tolist(), "policy": policy.tolist()}
        print_json({"environment": options.env, "average_reward": rate} | numbers)
        return 0
    out = console()
    out.print(
        f"[bold]{options.env}[/] does not end, so at gamma 1 returns are infinite. The best policy earns "
        f"[bold]{six_digits(rate)}[/] a step in the long run. The values are its bias: how much more comes from a "
        "state on than on average.",
        soft_wrap=True,
    )
    show(out, *tables(env, bias, q))
    stated = of_environment(env).discount
    own = ", which its source states" if stated not in (None, 1) else ""
    out.print(f"With a discount rate: `--gamma {f'{stated:g}' if own else 0.95}`{own}.")
    return 0


def _numbers(
    env: Any, policy: np.ndarray, v: np.ndarray, q: np.ndarray, history: planning.Iterates | None
) -> dict[str, Any]:
    """What is printed as JSON of one solution, and of the way to it."""
    solution = _of_one(planning.start_value(env, v), policy, v, q)
    if history is None:
        return solution
    every = zip(history.start_value, history.policy, history.v, history.q, strict=True)
    more = ("changed", "least_change", "largest_change", "error")
    numbers = [
        {"improvement": n} | {name: _plain(getattr(history, name)[n]) for name in more} | _of_one(*one)
        for n, one in enumerate(every)
    ]
    return solution | {"sweeps": history.sweeps, "settled": history.settled, "steps": numbers}


def _of_one(start_value: float, policy: np.ndarray, v: np.ndarray, q: np.ndarray) -> dict[str, Any]:
    named = [[None if x == policies.UNAVAILABLE else x for x in row] for row in q.tolist()]
    return {"start_value": float(start_value), "v": v.tolist(), "q": named, "policy": policy.tolist()}


def _plain(x: Any) -> float | None:
    """A number for JSON, which has none for what is not there."""
    return None if np.isnan(x) else x.item()


def _print_steps(env: Any, history: planning.Iterates) -> None:
    """A row for each iterate, or for some of them; what became of it; and the policies, where that is a few grids."""
    out, count = console(), len(history.v)
    out.print(f"{_how(history)}:")
    table = Table("policy", "states that\nact otherwise", "value from\nthe start")
    table.add_column("change of v,\nleast to most")
    table.add_column("largest\n|v − v*|")
    for column in table.columns:
        column.justify = "right"
    for n in some(count, ROWS):
        changes = (history.least_change[n], history.largest_change[n])
        table.add_row(
            str(n),
            str(history.changed[n]) if n else "",
            six_digits(history.start_value[n]),
            " to ".join(map(six_digits, changes)) if n else "",
            six_digits(history.error[n]),
        )
    if more := count - len(table.rows):
        table.caption = f"and {more} more: --json prints them all"
    print_table(out, table)
    out.print(_what_became(history), soft_wrap=True)
    if isinstance(env, Grid) and count <= POLICIES:
        show(out, *(arrows(env, policy, f"policy {n}") for n, policy in enumerate(history.policy)))


def _how(history: planning.Iterates) -> str:
    if history.sweeps is None:
        return "Policy iteration, from the policy that takes any action"
    how = "Value iteration" if history.sweeps == 1 else f"{history.sweeps} sweeps between improvements"
    return f"{how}, from v = 0"


def _what_became(history: planning.Iterates) -> str:
    count, off = len(history.v) - 1, six_digits(history.error[-1])
    if not history.settled:
        return f"After {count} improvements it has not settled: values are up to {off} off."
    if history.error[-1] > CLOSE * (1 + abs(history.v[-1][np.isfinite(history.v[-1])]).max()):
        return (
            f"It has settled at values that are up to {off} off: from v = 0, waiting looks better than it is."
        )
    if history.sweeps is None:
        return f"No action is better anywhere than those of policy {count}: it is the best."
    return "Further sweeps change nothing."


def _draw_steps(env: Any, histories: Mapping[str, planning.Iterates], what: str, folder: Path) -> None:
    from jaxrl_tab.show import plot

    for name, (title, history) in zip(("gpi", "gpi_soft"), histories.items(), strict=False):
        plot.save(plot.iterates(env, history, f"{what}, {title}\n{_how(history)}"), folder / f"{name}.png")


def _draw_solutions(env: Any, solutions: Mapping[str, tuple[np.ndarray, ...]], folder: Path) -> None:
    from jaxrl_tab.show import plot

    titles = [
        f"{title}; value from the start {six_digits(planning.start_value(env, v))}"
        for title, (_, v, _) in solutions.items()
    ]
    numbers = [(v, q) for _, v, q in solutions.values()]
    plot.save(plot.solutions(env, dict(zip(titles, numbers, strict=True))), folder / "values.png")
