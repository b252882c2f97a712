"""`jaxrl-tab watch`: an episode step by step, while a method learns."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Group as Together
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from jaxrl_tab.cli.common import (
    OF_ONE_METHOD,
    build_named,
    groups_in,
    prepare,
    start_jax,
)
from jaxrl_tab.cli.screen import busy
from jaxrl_tab.cli.streams import console
from jaxrl_tab.cli.tables import position, show, tables
from jaxrl_tab.cli.typed import FILE, parse, word
from jaxrl_tab.core.declared import Learns, of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.core.types import FiniteEnvironment
from jaxrl_tab.engine.watch import EPISODES, Watched, watch
from jaxrl_tab.show import learning
from jaxrl_tab.show.steps import Told
from jaxrl_tab.show.tasks import policy_of
from jaxrl_tab.show.words import significant

SECONDS, SLOWEST = 20.0, 0.5  # that an episode is played for, about; and one step of it, at most
LAST_STEPS = 8  # of which a person sees the numbers while an episode is played
BARS, COURSE = "▁▂▃▄▅▆▇█", 60  # heights in a line of text, and how long one is, at most
FEW_STATES = 25  # of which the values are listed after an episode


@checked_dataclass
class Watch:
    """Plays an episode of a method step by step, while it learns.

    For each step it tells the state, the action, the reward, the error that the method learns from, and which
    values it changes. It is an episode of the run that `sweep` makes with this seed, to the last bit. In a
    terminal the steps are played one after another; else all are printed, of a long episode its beginning and
    its end.

    Examples:
      jaxrl-tab watch windy-gridworld sarsa --alpha 0.5
      jaxrl-tab watch windy-gridworld sarsa --alpha 0.5 --at 1
      jaxrl-tab watch blackjack monte-carlo --episodes 20000 --html learning.html
      jaxrl-tab watch mountain-car semi-gradient-sarsa --features "tile-coding(8, 8)" --epsilon 0 --episodes 100
      jaxrl-tab watch random-walk td --alpha 0.1 --episodes 100 --gif learning.gif
      jaxrl-tab watch cliff-walking mine.py:MyMethod --my-parameter 2

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv, mdp.npz,
            gymnasium:NAME.
        method: Name of the method, see `jaxrl-tab list`, or of your own: mine.py:MyMethod.
        episodes: How many episodes the run has.
        at: Which of them to play; by default the last.
        seed: The number of the seed in a sweep, as its results have it.
        root_seed: What that sweep was given as --seed.
        gif: Also write what the run learns over time to a new file, as an animation.
        html: The same as a page with a slider.
    """

    env: str = word("ENV")
    method: str = word("METHOD")
    episodes: int = field(default=EPISODES, at_least=1)
    at: int | None = field(default=None, at_least=1)
    seed: int = field(default=0, at_least=0)
    root_seed: int = field(default=0, at_least=0)
    gif: FILE = None
    html: FILE = None


def watch_command(argv: list[str]) -> int:
    prepare()
    groups = groups_in(argv, OF_ONE_METHOD)
    options, typed = parse(Watch, argv, **groups)
    env, method = build_named(groups, typed, environment=options.env, hyperparameters=options.method)
    files = _files(options, env)
    start_jax()
    with busy("learning"):
        watched = watch(
            env,
            method,
            num_episodes=options.episodes,
            at=options.at,
            seed=options.seed,
            root_seed=options.root_seed,
        )
    _show(watched)
    for file in files:
        with busy("drawing"):
            watched.save(file)
        console().print(f"[bold]{escape(str(file))}[/]: what it learns over time", soft_wrap=True)
    return 0


def _files(options: Watch, env: Any) -> list[Path]:
    """The files to write. Raises InputError where one cannot be, before anything is computed."""
    files = []
    for ending in ("gif", "html"):
        if (name := getattr(options, ending)) is not None:
            files.append(learning.check(name, env))
            if files[-1].suffix.lower() != f".{ending}":
                raise InputError(f"--{ending} names a file that ends in .{ending}")
    return files


def _show(watched: Watched) -> None:
    """Plays the episode in a terminal, or prints its steps; then what the method has learned by its end."""
    out, told = console(), watched.told
    which = f"episode {watched.at} of {watched.num_episodes}, seed {watched.seed}"
    out.print(f"[bold]{escape(watched.name)}[/]: {which}", soft_wrap=True)
    if sys.stdout.isatty():
        pause = min(SLOWEST, SECONDS / len(watched.steps))
        with Live(console=out, auto_refresh=False) as screen:
            for frame in _frames(watched, told):
                screen.update(frame, refresh=True)
                time.sleep(pause)
    else:
        table = _table(told)
        for row in told.rows():
            table.add_row(*map(escape, row))
        out.print(table)
    out.print(told.end, markup=False)
    env = watched.env
    if not env.num_states:
        for line in _courses(watched):
            out.print(line, markup=False, soft_wrap=True)
    if isinstance(env, FiniteEnvironment) and (of_environment(env).panels() or env.num_states <= FEW_STATES):
        q, of_v = np.asarray(watched.q, float), "value"
        if told.learns is Learns.PREFERENCES:
            q, of_v = policy_of(q), "probability"
            out.print(
                "What it has learned by then: its likeliest actions, and the probability of each of them"
            )
        else:
            out.print("What it has learned by then:")
        show(out, *tables(env, q.max(-1), None if told.learns is Learns.STATES else q, of_v))


def _frames(watched: Watched, told: Told) -> Iterator[Together]:
    """What a person sees after each step: the last steps, and where the agent is."""
    q = None if told.learns is Learns.STATES else np.asarray(watched.before, float)
    for i, change in enumerate(watched.steps.changes):
        table = _table(told)
        for step in range(max(0, i + 1 - LAST_STEPS), i + 1):
            table.add_row(*map(escape, told.row(step)))
        if q is not None:
            q[change.s, change.a] = change.after
        yield Together(table, *_place(watched.env, q, watched.steps.experience.s_next[i]))


def _place(env: Any, q: np.ndarray | None, s: Any) -> list[Any]:
    """Where the agent is: a drawing, where there is one."""
    if env.num_states:
        return list(position(env, q, int(s)))
    picture = of_environment(env).picture
    return [] if picture is None else [Text("\n".join(picture(s)))]


def _courses(watched: Watched) -> Iterator[str]:
    """How the numbers that a state is went up and down in the episode: a line for each of them."""
    seen = watched.steps.experience
    numbers = np.concatenate([seen.s[:1], seen.s_next])
    if len(numbers) > COURSE:
        numbers = numbers[np.linspace(0, len(numbers) - 1, COURSE).round().astype(int)]
    names = of_environment(watched.env).observed_names
    for name, x in zip(names, numbers.T, strict=True):
        low, high = float(x.min()), float(x.max())
        heights = ((x - low) / (high - low or 1) * (len(BARS) - 1)).round().astype(int)
        ends = f"{significant(low, 3)} to {significant(high, 3)}"
        yield f"{name:>{max(map(len, names))}} {''.join(BARS[i] for i in heights)} {ends}"


def _table(told: Told) -> Table:
    table = Table(box=box.SIMPLE)
    for heading in told.head:
        table.add_column(escape(heading), no_wrap=len(heading) < len("next state"))
    return table
