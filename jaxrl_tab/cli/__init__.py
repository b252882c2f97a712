"""The command line, `jaxrl-tab` or `python -m jaxrl_tab`: list, solve, sweep, resume, figure.

Options for environments and methods are made from the registries: a new entry's parameters are options with
no edit here. All that a person can get wrong is refused before anything is compiled, with exit code 2 and
one line. Tables and JSON go to stdout, progress and errors to stderr.
"""

import codecs
import contextlib
import dataclasses
import datetime
import io
import json as jsonlib
import os
import shlex
import sys
import threading
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import jax
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from tyro.conf import FlagCreatePairsOff, Positional, arg

from jaxrl_tab.algorithms import ALGORITHMS
from jaxrl_tab.algorithms.prediction import METHODS, PREDICTION
from jaxrl_tab.cli.interrupt import interruptible
from jaxrl_tab.cli.options import (
    Group,
    about,
    option_of,
    parameters,
    parse,
    place,
    real,
    size,
    values,
    whole,
    word,
    words,
)
from jaxrl_tab.core import describe, policies
from jaxrl_tab.core.checks import InputError, RunError, as_path, build, nearest, one_line, reason, shown
from jaxrl_tab.core.types import Environment
from jaxrl_tab.core.version import __version__
from jaxrl_tab.engine import batch, programs
from jaxrl_tab.engine.results import label, save
from jaxrl_tab.envs import ENVS, instead
from jaxrl_tab.envs.base import Finite, Grid, Panel
from jaxrl_tab.exact import planning
from jaxrl_tab.experiment import executors, files, runner, storage
from jaxrl_tab.experiment.executors import Executor
from jaxrl_tab.experiment.plan import plan
from jaxrl_tab.experiment.progress import Progress as State
from jaxrl_tab.experiment.progress import Report
from jaxrl_tab.experiment.spec import Experiment, template
from jaxrl_tab.figures import FIGURES, Check
from jaxrl_tab.figures import Figure as PublishedFigure
from jaxrl_tab.figures.page import cells, page
from jaxrl_tab.show.words import edge_warning, six_digits, symbol, title_of

if TYPE_CHECKING:  # these take their time to import, and only some commands need them
    import pandas as pd
    import xarray as xr

    from jaxrl_tab.figures.figure import Run

Switch = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]

PROG = "jaxrl-tab"
TRACEBACK = "JAXRL_TAB_TRACEBACK"
PATIENCE = 2.0  # seconds of silence, at most
HELP = f"""\
usage: {PROG} COMMAND ...

How tabular control methods really behave: over many seeds, over a grid of hyperparameters, beside the exact
optimum.

commands:
  list      the environments and the methods, with their parameters
  solve     the exact values and an optimal policy of an environment
  sweep     methods x hyperparameters x seeds: a table, the data, and pictures
  resume    go on with a sweep that was interrupted
  figure    make published figures again, and check their numbers

examples:
  {PROG} list
  {PROG} solve windy-gridworld --moves king
  {PROG} sweep windy-gridworld sarsa q-learning expected-sarsa --out runs/windy
  {PROG} sweep --write-template experiment.toml
  {PROG} resume runs/windy
  {PROG} figure cliff-walking --out runs/cliff
  {PROG} figure --all --out runs/figures

`{PROG} COMMAND --help` says more about each. `{PROG} --version` prints the version.
"""

ALPHAS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)  # the step sizes of a sweep that names none
SEEDS, STEPS = 100, 8000
ENVIRONMENT = Group(ENVS, "Parameters of the environment.")
HYPERPARAMETERS = Group(
    METHODS,
    "Of the methods; several values make a grid.",
    grids=True,
    defaults={"alpha": ALPHAS},
    parts={"the methods of control": ALGORITHMS, "the methods of prediction": PREDICTION},
)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code: 0, 2 (wrong input), 130 (Ctrl-C), or 1.

    1 says that a figure is off, or that something could not be finished, as where the disk is full. Where the
    reader of its output goes away, as `| head` does, it ends quietly with 1; where stdout or stderr is closed
    nothing is said there, and the work is done. What the encoding of either lacks is replaced. A defect of
    this package is one line, too, and exit code 1; with `JAXRL_TAB_TRACEBACK=1` it is raised.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    _prepare_streams()
    try:
        try:
            return _dispatch(argv)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _give_up(sys.stdout)
        return 1
    except InputError as error:
        return _complain(str(error), code=2)
    except RunError as error:
        return _complain(str(error))
    except KeyboardInterrupt as stop:
        return _complain("; ".join(["interrupted", *map(str, stop.args)]), code=130)
    except MemoryError as error:
        return _complain("; ".join(["there is not enough memory", *_notes(error)]))
    except OSError as error:
        _give_up(sys.stdout)
        what = f"{error.filename}: " if error.filename else "reading or writing failed: "
        return _complain("; ".join([what + reason(error), *_notes(error)]))
    except Exception as error:
        if os.environ.get(TRACEBACK) == "1":
            raise
        what = f"this is a defect of {PROG}: {type(error).__name__}: {one_line(str(error))}"
        how = f"please report it with what {TRACEBACK}=1 shows, set before the command"
        return _complain("; ".join([what, *_notes(error), how]))


def _prepare_streams() -> None:
    """Makes stdout and stderr take all that may be printed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # it was closed
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  for as long as we run
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="lookalikes" if name == "stdout" else "backslashreplace")


LOOKALIKES = {"↑": "^", "→": ">", "↓": "v", "←": "<", "↗": "ne", "↘": "se", "↙": "sw", "↖": "nw", "·": "."}
LOOKALIKES |= {
    "–": "-",
    "−": "-",
    "±": "+-",
    "×": "x",
    "ε": "epsilon",
    "α": "alpha",
    "λ": "lambda",
    "γ": "gamma",
}


def _lookalikes(error: UnicodeError) -> tuple[str, int]:
    """What an encoding lacks, in characters that every one has."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    return "".join(LOOKALIKES.get(character, "?") for character in lacking), error.end


codecs.register_error("lookalikes", _lookalikes)


def _give_up(stream: TextIO) -> None:
    """Python flushes stdout and stderr once more at its end: what cannot be written goes nowhere."""
    with contextlib.suppress(OSError, ValueError):  # as where a test has put something else in its place
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _complain(line: str, code: int = 1) -> int:
    """Prints one line on stderr, if that is possible. Returns the exit code."""
    try:
        print(f"{PROG}: {line}", file=sys.stderr, flush=True)
    except OSError:
        _give_up(sys.stderr)
    return code


def _notes(error: BaseException) -> list[str]:
    return list(getattr(error, "__notes__", ()))


def _dispatch(argv: list[str]) -> int:
    for typed in argv:
        as_path("what is typed", typed)  # so that it can name a file, if it should
    commands = {
        "list": _list,
        "solve": _solve,
        "sweep": _sweep,
        "resume": _resume,
        "figure": _figure,
    }
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(HELP, end="")
        return 0
    if argv[0] == "--version":
        print(f"{PROG} {__version__}")
        return 0
    return commands[_known("a command", argv[0], commands)](argv[1:])


# --- list --------------------------------------------------------------------------------------------


@dataclasses.dataclass
class List:
    """The environments and the methods, with their parameters, defaults, and one line each; the figures.

    Examples:
      jaxrl-tab list
      jaxrl-tab list --json
    """

    json: Switch = False
    """Print JSON."""


def _list(argv: list[str]) -> int:
    options = parse(f"{PROG} list", List, argv)
    registries = {"environments": ENVS, "methods": ALGORITHMS, "prediction": PREDICTION}
    figures = {name: f"{figure.title} ({figure.source})" for name, figure in FIGURES.items()}
    if options.json:
        facts = {kind: {name: _facts(cls) for name, cls in r.items()} for kind, r in registries.items()}
        _print_json(facts | {"figures": {name: {"summary": text} for name, text in figures.items()}})
        return 0
    out = _console()
    headings = {
        "environments": "environments",
        "methods": "methods of control",
        "prediction": "methods of prediction, of the policy in which all actions are equally likely",
    }
    for kind, registry in registries.items():
        out.print(f"[bold]{headings[kind]}[/]")
        if shared := _shared(registry):
            out.print("\n  unless said otherwise, all have")
            out.print(_parameter_table(shared))
        for name, cls in registry.items():
            out.print(f"\n  [bold cyan]{name}[/]  {escape(describe.summary(cls))}")
            if own := [p for p in parameters(cls) if p not in shared]:
                out.print(_parameter_table(own))
        out.print()
    out.print(escape(about(HYPERPARAMETERS)), "\n", soft_wrap=True)
    out.print("[bold]figures[/]\n")
    for name, title in figures.items():
        out.print(f"  [bold cyan]{name}[/]  {escape(title)}")
    return 0


def _shared(registry: Mapping[str, type]) -> list[describe.Parameter]:
    """The parameters that all entries have, in the form that most of them have."""
    everywhere = [parameters(cls) for cls in registry.values()]
    names = [{p.name for p in ps} for ps in everywhere]
    counts = Counter(p for ps in everywhere for p in ps)
    return [p for p, n in counts.items() if 2 * n > len(registry) and all(p.name in known for known in names)]


def _parameter_table(shown: Sequence[describe.Parameter]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for p in shown:
        table.add_row(f"    [green]{option_of(p)}[/]", escape(words(p.default)), escape(p.help))
    return table


def _facts(cls: type) -> dict[str, Any]:
    facts = {p.name: {"default": label(p.default), "help": p.help} for p in describe.parameters(cls)}
    return {"summary": describe.summary(cls), "parameters": facts}


# --- solve -------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Solve:
    """The exact values of an environment and its optimal actions.

    Examples:
      jaxrl-tab solve windy-gridworld
      jaxrl-tab solve windy-gridworld --moves king --epsilon 0.1 --out runs/king
      jaxrl-tab solve random-walk --states 5 --left-reward 0 --json
    """

    env: Annotated[Positional[str], arg(metavar="ENV", help_behavior_hint="")] = ""
    """Name of the environment; see `jaxrl-tab list`."""
    gamma: Annotated[float, real(0, 1)] = 1.0
    """Discount rate, in [0, 1]."""
    epsilon: Annotated[float | None, real(0, 1), arg(help_behavior_hint="")] = None
    """Also find the best policy among those that take a random action with this probability."""
    out: Annotated[Path | None, place("DIR"), arg(help_behavior_hint="")] = None
    """New folder for a picture (PNG)."""
    json: Switch = False
    """Print JSON: the value from the start, v [S], q [S][A], and the policy's probabilities [S][A]."""


def _solve(argv: list[str]) -> int:
    options = parse(f"{PROG} solve", Solve, argv, environment=ENVIRONMENT)
    env = _environment(options.env, options.environment)
    _start_jax()
    with _folder(options.out) as folder, _busy("solving"):
        solutions = {"optimal": planning.policy_iteration(env, options.gamma)}
        if options.epsilon is not None:
            soft = f"best epsilon-soft, epsilon {words(options.epsilon)}"
            solutions[soft] = planning.epsilon_soft(env, options.epsilon, options.gamma)
        if folder:
            _draw_solutions(env, solutions, folder)
    if options.json:
        keys = ("optimal", "epsilon_soft")
        found = {
            key: {
                "start_value": planning.start_value(env, v),
                "v": v.tolist(),
                "q": [[None if x == policies.UNAVAILABLE else x for x in row] for row in q.tolist()],
                "policy": policy.tolist(),
            }
            for key, (policy, v, q) in zip(keys, solutions.values(), strict=False)
        }
        _print_json({"environment": options.env, "gamma": options.gamma, "epsilon": options.epsilon} | found)
        return 0
    out = _console()
    for title, (_, v, q) in solutions.items():
        out.print(
            f"[bold]{options.env}[/], gamma {words(options.gamma)}, {title}: "
            f"value from the start [bold]{six_digits(planning.start_value(env, v))}[/]"
        )
        for table in _pictures(env, v, q):
            out.print(table)
    if hasattr(env, "instance"):
        mean = escape(six_digits(env.mean_optimal_value(options.gamma)))
        out.print(f"Each run of a sweep draws a problem of its own; the mean over them is [bold]{mean}[/].")
    if options.out:
        _say_where(options.out)
    return 0


MANY_STATES = 500  # the rows of a table that people look through, at most


def _pictures(env: Any, v: np.ndarray, q: np.ndarray) -> list[Table]:
    """Values and best actions: where people see the states in tables in their places, else as a list."""
    model = planning.exact_model(env)
    visited, terminal = planning.reachable(model), planning.terminal_states(model)
    between = "" if isinstance(env, Grid) else " "
    best = lambda s: between.join(env.action_names[a] for a in _best_actions(q[s]))
    if not env.panels() or env.num_states > MANY_STATES:
        choice = env.num_actions > 1
        table = Table("state", "value", *(["best actions"] if choice else []))
        listed = np.flatnonzero(visited & ~terminal)
        for s in listed[:MANY_STATES]:
            table.add_row(str(s), six_digits(float(v[s])), *([best(s)] if choice else []))
        if (more := len(listed) - MANY_STATES) > 0:
            table.caption = f"and {more} more states: --json prints them all"
        return [table]
    marks = {env.start_state: "[bold reverse]S[/] "} if isinstance(env, Grid) else {}
    cells = [f"{_short(v[s])}\n{marks.get(s, '')}[cyan]{best(s)}[/]" for s in range(env.num_states)]
    for s in np.flatnonzero(terminal | ~visited):
        cells[s] = ""
    if isinstance(env, Grid):
        cells[env.state(env.goal)] = "[bold green]G[/]"
    tables = [_panel(panel, cells, getattr(env, "wind", None)) for panel in env.panels()]
    if not (visited | terminal).all():
        tables[-1].caption = "empty: out of reach from the start"
    return tables


def _panel(panel: Panel, cells: Sequence[str], wind: Any) -> Table:
    """The `cells` of the states in a panel; below its columns the wind, where there is any."""
    axes = f"{panel.down} ↓, {panel.along} →" if panel.down else ""
    title = ": ".join(filter(None, [panel.title, axes]))
    table = Table("", *panel.columns, title=title or None, show_lines=True, padding=0)
    table.show_footer = wind is not None
    footers = ["wind", *([""] * len(panel.columns) if wind is None else wind)]
    for column, footer in zip(table.columns, footers, strict=True):
        column.footer, column.justify, column.no_wrap, column.min_width = str(footer), "center", True, 5
    table.columns[0].min_width = None
    for name, row in zip(panel.rows, panel.states, strict=True):
        table.add_row(name, *(cells[int(s)] for s in row))
    return table


def _best_actions(q: np.ndarray) -> np.ndarray:
    """The actions whose values are maximal but for rounding, int [n], from values [A]."""
    return np.flatnonzero(q >= q.max() - 1e-9 * abs(q[q > policies.UNAVAILABLE]).max())


def _draw_solutions(env: Finite, solutions: Mapping[str, tuple[np.ndarray, ...]], folder: Path) -> None:
    from jaxrl_tab.show import plot

    titles = [
        f"{title}; value from the start {six_digits(planning.start_value(env, v))}"
        for title, (_, v, _) in solutions.items()
    ]
    if env.panels() and not isinstance(env, Grid):
        figure, grid = plot.panels_canvas(env, len(solutions))
        for row, title, (_, v, q) in zip(grid, titles, solutions.values(), strict=True):
            best = np.array([np.isin(np.arange(env.num_actions), _best_actions(x)) for x in q])
            plot.panels(row, env, v, best, title)
        plot.save(figure, folder / "values.png")
        return
    height = 1.2 + 5.8 * env.shape[0] / env.shape[1] if isinstance(env, Grid) else 3.6
    figure = plot.canvas(plot.WIDTH, height * len(solutions))
    axes = np.ravel(figure.subplots(len(solutions)))
    for ax, title, (_, v, q) in zip(axes, titles, solutions.values(), strict=True):
        if isinstance(env, Grid):
            plot.values(ax, env, v, q)
        else:
            plot.action_values(ax, env, np.where(q == policies.UNAVAILABLE, np.nan, q))
        ax.set_title(title, fontsize=plot.TITLE)
    plot.save(figure, folder / "values.png")


# --- sweep -------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Where:
    """Where a sweep is computed."""

    executor: Annotated[str, arg(metavar="NAME")] = "local"
    """local (all cores of this machine), ray, slurm, or distributed (jax.distributed); see docs/scaling.md."""
    address: Annotated[str | None, word("HOST:PORT"), arg(help_behavior_hint="")] = None
    """Of the Ray cluster, or of process 0 of a distributed job."""
    processes: Annotated[int | None, whole(1), arg(help_behavior_hint="")] = None
    """How many processes a distributed job has."""
    process: Annotated[int | None, whole(0), arg(help_behavior_hint="")] = None
    """Which of them this one is, from 0."""
    slurm: Annotated[tuple[str, ...], arg(metavar="KEY=VALUE ...", help_behavior_hint="")] = ()
    """What SLURM is asked for, in the words of submitit: timeout_min=30 slurm_partition=short."""


@contextlib.contextmanager
def _executor(options: Any) -> Iterator[Executor]:
    """The executor that was asked for, with the options that are its own."""
    own = {
        "local": (),
        "ray": ("address",),
        "slurm": ("slurm",),
        "distributed": ("address", "processes", "process"),
    }
    name = _known("an executor", options.executor, own)
    given = {option: getattr(options, option) for option in ("address", "processes", "process", "slurm")}
    given = {option: value for option, value in given.items() if value not in (None, ())}
    for option in given:
        if option not in own[name]:
            owners = ", ".join(other for other, names in own.items() if option in names)
            raise InputError(f"--{option} is of --executor {owners}, and this one is {name}")
    if name == "slurm":
        if options.out is None:
            raise InputError("--executor slurm needs --out: a folder that all machines see")
        asked = dict(_key_and_value(word) for word in options.slurm)
        given = {"folder": options.out / "jobs", "parameters": asked}
    if name == "distributed":
        names = {"processes": "num_processes", "process": "process_id"}
        given = {names.get(option, option): value for option, value in given.items()}
    executor = executors.get(name, **given)
    with executor if isinstance(executor, executors.Distributed) else contextlib.nullcontext():
        yield executor


def _key_and_value(word: str) -> tuple[str, Any]:
    key, equals, value = word.partition("=")
    if not equals:
        raise InputError(f"--slurm takes KEY=VALUE, not {shown(word)}")
    return key, int(value) if value.isdecimal() and len(value) < 20 else value


@dataclasses.dataclass
class Sweep(Where):
    """Every method with every combination of hyperparameters, each over the same seeds.

    What is run is said by options; or by a file, which can say more: several environments, random draws, and
    settings of its own for each method. Prints a summary table. With --out, leaves a folder: results.nc
    (netCDF: the numbers of every seed, a group for each method), summary.csv, pictures, report.html, and all
    that is needed to do it again. Where that is interrupted, `jaxrl-tab resume` goes on.

    Methods of prediction learn the values of the policy in which all actions are equally likely, and are
    compared by their error.

    Examples:
      jaxrl-tab sweep windy-gridworld sarsa q-learning expected-sarsa --out runs/windy
      jaxrl-tab sweep windy-gridworld sarsa --moves king --alpha 0.1 0.3 0.5 --epsilon 0.05 0.1
      jaxrl-tab sweep cliff-walking sarsa q-learning --alpha 0.5 --epsilon glie --episodes 500
      jaxrl-tab sweep k-armed-testbed q-learning --alpha 0.1 --behaviour greedy epsilon-greedy:0.1 ucb:2
      jaxrl-tab sweep random-walk n-step-td td-lambda --alpha 0.1 0.3 --n 1 4 16 --episodes 10
      jaxrl-tab sweep --write-template experiment.toml
      jaxrl-tab sweep experiment.toml --dry-run
      jaxrl-tab sweep experiment.toml --out runs/experiment
    """

    env: Annotated[Positional[str], arg(metavar="ENV|FILE", help_behavior_hint="")] = ""
    """Name of the environment, see `jaxrl-tab list`; or an experiment in a file FILE.toml."""
    methods: Annotated[Positional[tuple[str, ...]], arg(metavar="METHOD ...", help_behavior_hint="")] = ()
    """Names of one or more methods; see `jaxrl-tab list`. An option goes to all that have it."""
    seeds: Annotated[int | None, whole(1), arg(help_behavior_hint=f"(default: {SEEDS})")] = None
    """How many seeds."""
    steps: Annotated[int | None, whole(1), arg(help_behavior_hint=f"(default: {STEPS})")] = None
    """How many steps each run takes."""
    episodes: Annotated[int | None, whole(1), arg(help_behavior_hint="")] = None
    """How many episodes each run finishes, instead of --steps."""
    log_every: Annotated[int | None, whole(1), arg(help_behavior_hint="(default: 100 or 1)")] = None
    """How many steps, or episodes, are summed up in one row of the log."""
    seed: Annotated[int | None, whole(0), arg(help_behavior_hint="(default: 0)")] = None
    """Which sequence of seeds."""
    memory: Annotated[int | None, size(), arg(help_behavior_hint="(default: half of what is free)")] = None
    """How much memory a method may take, such as 4GB; results that do not fit go to temporary files."""
    select: Switch = False
    """Run the best setting of each method again, on as many fresh seeds; show both numbers."""
    exact: Switch = False
    """Also record the exact value of the greedy policy, and the largest |Q - Q*|, at every row of the log.
    (The error of methods of prediction is always recorded.)"""
    out: Annotated[Path | None, place("DIR"), arg(help_behavior_hint="")] = None
    """New folder for the data and the pictures."""
    dry_run: Switch = False
    """Show what would be run, in how much memory, and stop."""
    write_template: Switch = False
    """Write an experiment that explains itself, to FILE or, without one, to the screen, and stop."""
    json: Switch = False
    """Print the summary, or what would be run, as JSON."""
    quiet: Switch = False
    """Show no progress and no table."""


def _sweep(argv: list[str]) -> int:
    _prepare()
    options = parse(f"{PROG} sweep", Sweep, argv, hyperparameters=HYPERPARAMETERS, environment=ENVIRONMENT)
    if options.write_template:
        return _write_template(options.env)
    with _executor(options) as executor:
        if isinstance(executor, executors.Distributed) and executor.serve():
            return 0
        with _busy("reading what is to be run", options.quiet):
            experiment = _experiment(options)
        return _conduct(experiment, executor, options, ["sweep", *argv])


def _conduct(experiment: Experiment, executor: Executor, options: Any, command: Sequence[str]) -> int:
    """Runs the experiment, prints what came out, and leaves it in the folder; or says what it would do."""
    _start_jax()
    if options.dry_run:
        with _busy("planning", options.quiet):
            found = plan(experiment.parts(), options.memory)
        if options.json:
            parts = {name: part._asdict() for name, part in found.parts.items()}
            _print_json(found._asdict() | {"parts": parts})
        else:
            print(found.text())
        return 0
    given = {"memory": options.memory, "command": shlex.join([PROG, *command])}
    with _watched(options, experiment) as progress:
        outcome = runner.run(experiment, options.out, executor=executor, progress=progress, **given)
    return _show(outcome, options.out, options)


def _experiment(options: Any) -> Experiment:
    """The experiment that is in a file, or was typed."""
    typed = {"steps": options.steps, "episodes": options.episodes, "log_every": options.log_every}
    typed |= {"seeds": options.seeds, "seed": options.seed, "exact": options.exact or None}
    typed |= {"select": {} if options.select else None}
    typed: dict[str, Any] = {name: value for name, value in typed.items() if value is not None}
    if options.env not in ENVS and (options.env.endswith(".toml") or Path(options.env).is_file()):
        others = [*options.methods, *options.environment, *options.hyperparameters]
        if said := [*others, *("--" + name.replace("_", "-") for name in typed)]:
            raise InputError(f"{said[0]} beside a file: what is run is said in {options.env} alone")
        return Experiment.load(options.env)
    env = {"name": _known("an environment", options.env, ENVS)}
    env |= _parameters_of(options.env, options.environment)
    names = [_known("a method", name, METHODS) for name in options.methods or [""]]
    grids = values(names, options.hyperparameters, HYPERPARAMETERS)
    one = lambda tried: tried[0] if len(tried) == 1 else tried
    methods = [{"name": name} | {k: one(tried) for k, tried in grids[name].items()} for name in names]
    if options.steps is not None and options.episodes is not None:
        raise InputError("give --steps or --episodes, not both")
    default: dict[str, Any] = {"seeds": SEEDS} | ({} if "episodes" in typed else {"steps": STEPS})
    return Experiment([env], methods, **(default | typed))


def _write_template(file: str) -> int:
    if not file:
        print(template(), end="")
        return 0
    try:
        with open(file, "x", encoding="utf-8") as to:
            to.write(template())
    except FileExistsError:
        raise InputError(f"{one_line(file)} exists already; name a new file") from None
    except OSError as error:
        raise InputError(f"{one_line(file)} cannot be written: {error.strerror}") from None
    print(f"{file} is written; try {PROG} sweep {shlex.quote(file)} --dry-run")
    return 0


@dataclasses.dataclass
class Resume(Where):
    """Goes on with a sweep that was interrupted: computes what is missing or damaged, and nothing else.

    The results are the same, to the last bit, as if nothing had happened. Where they would not be, as with
    another version of JAX or on another kind of processor, it says what has changed, and computes nothing.

    Examples:
      jaxrl-tab resume runs/windy
    """

    folder: Annotated[Positional[Path | None], place("DIR"), arg(help_behavior_hint="")] = None
    """The folder of the sweep: what --out named."""
    memory: Annotated[int | None, size(), arg(help_behavior_hint="(default: half of what is free)")] = None
    """How much memory it may take, such as 4GB."""
    mixed: Switch = False
    """Go on nevertheless; the report tells what was not the same for all numbers."""
    json: Switch = False
    """Print the summary as JSON."""
    quiet: Switch = False
    """Show no progress and no table."""


def _resume(argv: list[str]) -> int:
    _prepare()
    options = parse(f"{PROG} resume", Resume, argv)
    if options.folder is None:
        raise InputError("name the folder of a sweep")
    options.out = options.folder
    command = shlex.join([PROG, "resume", *argv])
    with _executor(options) as executor:
        if isinstance(executor, executors.Distributed) and executor.serve():
            return 0
        _start_jax()
        given = {"executor": executor, "memory": options.memory, "command": command, "mixed": options.mixed}
        with _watched(options) as progress:
            outcome = runner.resume(options.out, progress=progress, **given)
        return _show(outcome, options.out, options)


@contextlib.contextmanager
def _watched(options: Any, experiment: Experiment | None = None) -> Iterator[Report]:
    """What a run reports its progress to: a bar. Where it is interrupted, it says how to go on."""
    import pandas  # noqa: F401  Now, while there is nothing yet that Ctrl-C could wait for.

    stderr = Console(stderr=True)
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("runs{task.fields[more]}"),
    )
    quiet = options.quiet or not stderr.is_terminal
    try:
        with interruptible(), Progress(*columns, console=stderr, disable=quiet) as bars:
            bar = bars.add_task("planning", total=None, more="")

            def progress(state: State) -> None:
                if experiment is not None and not quiet and state.steps == 0 and state.done == 0:
                    text = plan(experiment.parts(), options.memory).text()
                    stderr.print(text, markup=False, highlight=False, soft_wrap=True)
                bars.update(
                    bar,
                    description=state.label,
                    completed=state.done,
                    total=state.total,
                    more=_more(state),
                )

            yield progress
    except InputError:
        raise
    except BaseException as stop:
        if options.out is None or not options.out.is_dir():
            raise
        kept = f"what is finished is kept, `{PROG} resume {shlex.quote(str(options.out))}` goes on"
        if isinstance(stop, KeyboardInterrupt | RunError):
            raise type(stop)("; ".join([*map(str, stop.args), kept])) from None
        stop.add_note(kept)
        raise


def _more(state: State) -> str:
    """The numbers beside the bar."""
    said = [""]
    if state.steps:
        said.append(f"{state.steps / state.seconds / 1e6:.1f} million steps/s")
    if state.left and state.done < state.total:
        said.append(f"{datetime.timedelta(seconds=round(state.left))} left")
    if state.diverged:
        said.append(f"{state.diverged} diverged")
    return ", ".join(said)


def _show(outcome: files.Outcome, folder: Path | None, options: Any) -> int:
    """Prints what came out: tables for people, or JSON."""
    if options.json:
        summary = {"folder": folder and str(folder), "summary": _records(files.summary(outcome))}
        chosen = {"selection": _records(files.selection(outcome))} if outcome.fresh else {}
        _print_json(summary | chosen)
        return 0
    if options.quiet:
        return 0
    from jaxrl_tab import stats

    for environment in outcome.envs:
        own = outcome.of(environment)
        with _busy("summing up"):
            table = stats.summary(own)
        _print_summary(environment, table, own, outcome.envs[environment])
    if outcome.fresh:
        _print_selection(files.selection(outcome))
    if diverged := sum(int(ds.diverged.sum()) for ds in outcome.datasets.values()):
        runs = sum(ds.diverged.size for ds in outcome.datasets.values())
        why = "a number became infinite, or NaN, or grew beyond any possible return."
        _console().print(f"{diverged} of {runs} runs diverged: {why}")
    if folder:
        name = next(iter(outcome.datasets))
        _say_where(folder, name if len(outcome.envs) > 1 else name.partition("/")[2])
    return 0


def _records(table: "pd.DataFrame") -> Any:
    return jsonlib.loads(str(table.to_json(orient="records")))


def _print_selection(table: "pd.DataFrame") -> None:
    """The settings that were chosen, with what they gave on the seeds of the choice and on fresh ones."""
    columns = list(table.columns)
    hyperparameters = columns[2 : columns.index("chosen_score")]
    scores = ["on the seeds\nof the choice", "95% interval", "on fresh\nseeds", "95% interval"]
    several = len(set(table["environment"])) > 1
    view = Table(*(["environment"] if several else []), "method", "chosen\nsetting", *scores)
    for column in view.columns[-4:]:
        column.justify = "right"
    for row in table.to_dict("records"):
        setting = [f"{h} {words(row[h])}" for h in hyperparameters if row[h] == row[h]]
        cells = []
        for kind in ("chosen", "fresh"):
            mean, low, high = (row[f"{kind}_{what}"] for what in ("score", "low", "high"))
            digits = f"{{:.{_decimals(np.array([(high - low) / 2]), 2)}f}}".format
            cells += [_cell(mean, digits), _interval(low, high, digits)]
        names = (row["environment"], row["method"]) if several else (row["method"],)
        view.add_row(*names, ", ".join(setting) or "–", *cells)
    out = _console()
    out.print(view)
    out.print("The choice flatters the first number: report the second.")


def _run(
    runs: "Mapping[str, Run]", folder: Path | None, command: Sequence[str], quiet: bool, within: str = ""
) -> "dict[str, xr.Dataset]":
    """Makes one run after another, with a bar for each, and saves the data of each when it is done.

    In the file and on the screen its name is that in `runs` after `within`.
    """
    import xarray  # noqa: F401  Now, because later a Ctrl-C in the second that it takes would lose a run's data.

    about = {"command": shlex.join([PROG, *command]), "version": __version__}
    datasets = {}
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("runs"),
        TimeElapsedColumn(),
    )
    stderr = Console(stderr=True)
    with Progress(*columns, console=stderr, disable=quiet or not stderr.is_terminal) as bars:
        for name, run in runs.items():
            group = within + name
            bar = bars.add_task(f"{group}, compiling", total=None)

            def progress(done: int, total: int, bar=bar, group=group) -> None:
                bars.update(bar, description=group, completed=done, total=total)

            datasets[name] = run(progress)
            if folder:
                save(datasets[name], group, folder / storage.DATA, about)
    return datasets


def _print_summary(
    environment: str, table: "pd.DataFrame", datasets: "Mapping[str, xr.Dataset]", env: Environment
) -> None:
    """The summary for people: what all rows share stands above the table, what the marks mean below it."""
    from jaxrl_tab import stats

    ds = next(iter(datasets.values()))
    columns = list(table.columns)
    hyperparameters = columns[1 : columns.index("episodes")]
    tried = {h: table[h].dropna().drop_duplicates() for h in hyperparameters}  # not all methods have all
    shared = {h: found.iloc[0] for h, found in tried.items() if len(found) == 1}
    varied = [h for h in hyperparameters if h not in shared]
    unit = "steps" if "num_steps" in ds.attrs else "episodes"
    length = f"{ds.attrs[f'num_{unit}']} {unit}"
    setting = [f"{h} {words(value)}" for h, value in shared.items()]
    prediction = stats.is_prediction(*datasets.values())
    late = bool(table["unfinished"].any())
    score, kind, score_head = "last_tenth_return", "last_tenth", "mean return,\nlast tenth"
    if prediction:
        score, kind, score_head = "v_error", "v_error", "RMS error,\nwhole run"
    exact = "greedy_value" in columns
    view = Table(
        *["method", *varied, "episodes", score_head, "95% interval\nof the mean"],
        *(["unfinished\nruns"] if late else []),
        *(["RMS error\nat the end"] if prediction else []),
        *["million\nsteps/s"],
        *(["worth of the\ngreedy policy"] if exact else []),
        "value of\nthe policy" if prediction else "exact\noptimum",
    )
    for column in view.columns[1:]:
        column.justify = "right"
    # Two digits of the narrowest interval; of errors also three of the smallest.
    scores, low, high = (table[column].to_numpy(float) for column in (score, f"{kind}_low", f"{kind}_high"))
    decimals = _decimals((high - low) / 2, 2)
    if prediction:
        decimals = max(decimals, _decimals(scores, 3))
    digits = f"{{:.{decimals}f}}".format
    notes, edges, few = [], [], False
    for method, rows in table.groupby("method", sort=False):
        choice = len(rows[score].drop_duplicates()) > 1
        for row in rows.to_dict("records"):
            star, doubtful = choice and row["best"], row["seeds_wanted"] > row["seeds"]
            mark = " *" if star else " ~" if choice and row["tied"] else ""
            few |= doubtful
            view.add_row(
                f"{method}{mark}",
                *(_cell(row[h], words) for h in varied),
                f"{row['episodes']:.1f}",
                _cell(row[score], digits),
                _interval(row[f"{kind}_low"], row[f"{kind}_high"], digits) + (" !" if doubtful else ""),
                *([str(row["unfinished"])] if late else []),
                *([_cell(row["final_v_error"], digits)] if prediction else []),
                f"{row['steps_per_second'] / 1e6:.1f}",
                *([_cell(row["greedy_value"], six_digits)] if exact else []),
                _cell(row["optimum"], six_digits),
                style="bold" if star else None,
            )
            if doubtful and row["best"]:
                ends = [
                    f"the {name} is {_cell(row[f'{kind}_{key}'], digits)} ("
                    f"{_interval(row[f'{kind}_{key}_low'], row[f'{kind}_{key}_high'], digits)})"
                    for name, key in (("median", "median"), ("interquartile mean", "iqm"))
                ]
                wanted = f"{row['seeds_wanted']} seeds would be needed to trust the mean"
                notes.append(f"! {title_of(str(method))}: {', '.join(ends)}; {wanted}.")
        view.add_section()
        own = datasets[str(method)]
        at_edge = stats.at_edge(own, stats.best(own)) if choice else {}
        edges += [edge_warning(name, str(method), end) for name, end in at_edge.items()]
    out = _console()
    out.print(", ".join([f"[bold]{environment}[/]", *setting, f"{ds.sizes['seed']} seeds, {length} each"]))
    out.print(view)
    say = lambda line: out.print(line, markup=False)
    if prediction:
        say("The RMS error is that of V, over the states: its mean over the rows of the log, and at the end.")
    if varied and len(table[score].drop_duplicates()) > 1:
        say(
            "* This setting is the best of its method on these seeds. It was chosen for its mean, which flatters it."
        )
        if sum(table["tied"]) > sum(table["best"]):
            say(
                "~ This setting is not told apart from the best: these seeds do not say which of the two is better."
            )
    if late:
        say(
            "The unfinished runs end no episode in the last tenth: they score the rewards that they collected there, "
            "as if cut off."
        )
    if few:
        seeds = ds.sizes["seed"]
        say(
            "! This mean rests on few bad runs, and may be worse than it looks: "
            f"{stats.unseen(seeds)} stuck, which {seeds} seeds need not show."
        )
    for line in [*notes, *edges]:
        say(line)
    if not prediction:
        for name, value in _soft_optima(datasets, env).items():
            say(f"With {name}, no policy that goes on exploring is worth more than {six_digits(value)}.")
    if exact:
        say(
            "The worth of the greedy policy is its exact value at the end, the median over seeds; "
            "-inf: it goes round for ever."
        )


def _soft_optima(datasets: "Mapping[str, xr.Dataset]", env: Environment) -> dict[str, float]:
    """What the best policy earns that explores as the best settings do: "ε = 0.1" -> value."""
    from jaxrl_tab import stats

    found = {}
    for ds in datasets.values():
        setting = stats.fixed(ds) | stats.named(ds, stats.best(ds))
        by = "behaviour" if setting.get("behaviour") else "epsilon"
        used = [key for key in (by, "gamma") if key in setting]
        name = " and ".join(f"{symbol(key)} = {words(setting[key])}" for key in used)
        if name not in found:
            found[name] = stats.soft_optimum(env, setting)
    return {name: value for name, value in found.items() if not np.isnan(value)}


def _decimals(x: np.ndarray, digits: int) -> int:
    """How many decimals show so many significant digits of the smallest of `x` above 0, from 2 to 5."""
    least = x[np.isfinite(x) & (x > 0)].min(initial=1)
    return int(np.clip(digits - 1 - np.floor(np.log10(least)), 2, 5))


def _interval(low: float, high: float, digits: Any) -> str:
    return _cell(low, lambda _: f"{digits(low)} to {digits(high)}")


def _cell(value: Any, write: Any) -> str:
    """`write(value)`, or a dash where there is no value."""
    return "–" if value != value else write(value)


# --- figure ------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Figure:
    """Runs the setting of a published figure again, draws it, and checks its numbers; or of all figures.

    Prints what was got beside what is expected: from enumeration, or from long simulations with plain loops.
    The exit code is 1 if any number is off by more than four standard errors.

    Examples:
      jaxrl-tab figure windy-gridworld --out runs/windy-figure
      jaxrl-tab figure cliff-walking --json
      jaxrl-tab figure --all --out runs/figures
    """

    name: Annotated[Positional[str], arg(metavar="NAME", help_behavior_hint="")] = ""
    """Name of the figure; see `jaxrl-tab list`."""
    all: Switch = False
    """Make all figures; with --out, also index.html, which shows them."""
    out: Annotated[Path | None, place("DIR"), arg(help_behavior_hint="")] = None
    """New folder for the picture, as PNG and as PDF, and the data."""
    json: Switch = False
    """Print the numbers as JSON."""
    quiet: Switch = False
    """Show no progress."""


def _figure(argv: list[str]) -> int:
    _prepare()
    options = parse(f"{PROG} figure", Figure, argv)
    if options.all and options.name:
        raise InputError("name a figure or give --all, not both")
    names = tuple(FIGURES) if options.all else (_known("a figure", options.name, FIGURES),)
    _start_jax()
    checked, groups = {}, []
    with _folder(options.out) as folder:
        for name in names:
            figure = FIGURES[name]
            within = f"{name}/" if options.all else ""
            datasets = _run(figure.experiment(), folder, ["figure", *argv], options.quiet, within)
            groups += [within + run for run in datasets]
            with _busy(f"{name}: numbers and picture", options.quiet):
                checked[name] = figure, [number.check(datasets) for number in figure.numbers]
                if folder:
                    _draw_figure(figure, datasets, folder / name)
            if not options.json:
                _console().print(_check_table(*checked[name]))
        if folder and options.all:
            (folder / "index.html").write_text(page(checked, __version__), encoding="utf-8")

    if options.json:
        found = [
            {"figure": name, "numbers": [c._asdict() | {"ok": c.ok} for c in checks]}
            for name, (_, checks) in checked.items()
        ]
        _print_json({"figures": found} if options.all else found[0])
    elif options.out:
        _say_where(options.out, groups[0])
    return 0 if all(c.ok for _, checks in checked.values() for c in checks) else 1


def _draw_figure(figure: PublishedFigure, datasets: "Mapping[str, xr.Dataset]", file: Path) -> None:
    """As PNG, to look at, and as PDF, which is sharp at any size."""
    from jaxrl_tab.show import plot

    picture = figure.draw(datasets)
    for ending in (".png", ".pdf"):
        plot.save(picture, file.with_suffix(ending))


def _check_table(figure: PublishedFigure, checks: Sequence[Check]) -> Table:
    title = escape(f"{figure.title} ({figure.source})")
    caption = "expected: from long simulations with plain loops; what is exact, from enumeration"
    table = Table("number", "got", "± SE", "expected", "± SE", "SEs apart", title=title, caption=caption)
    for check in checks:
        *row, apart = map(escape, cells(check))
        table.add_row(*row, apart if check.ok else f"[bold red]{apart}, off[/]")
    return table


# --- shared ------------------------------------------------------------------------------------------


def _prepare() -> None:
    """What must be settled before anything is computed."""
    batch.use_all_cores()
    programs.keep()


def _start_jax() -> None:
    """Raises InputError where JAX cannot start, as where `JAX_PLATFORMS` names what is not there."""
    try:
        jax.devices()
    except RuntimeError as error:
        raise InputError(f"JAX cannot start: {one_line(str(error))}") from None


def _known(kind: str, name: str, names: Collection[str]) -> str:
    """`name`, which must be one of `names`."""
    if not name:
        raise InputError(f"name {kind}: {', '.join(names)}")
    if name not in names:
        raise InputError(
            f"{shown(name)} is not {kind}; {instead(name) if names is ENVS else nearest(name, names)}"
        )
    return name


def _environment(name: str, given: Mapping[str, tuple[str, ...]]) -> Any:
    return build(ENVS[_known("an environment", name, ENVS)], name, _parameters_of(name, given))


def _parameters_of(name: str, given: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """The parameters of an environment that were typed, with their values."""
    typed = values([name], given, ENVIRONMENT)[name]
    defaults = {p.name: p.default for p in parameters(ENVS[name])}
    return {n: tuple(v) if isinstance(defaults[n], tuple) else v[0] for n, v in typed.items()}


@contextlib.contextmanager
def _folder(path: Path | None) -> Iterator[Path | None]:
    """A new folder to write into, which gets the name `path` when all is written.

    Until then, and if anything fails, it stands beside as `path.unfinished-...`, and keeps what was finished.
    """
    if path is None:
        yield None
        return
    path = Path(os.path.normpath(path))
    try:
        if path.exists() or path.is_symlink():
            raise InputError(f"--out: {one_line(str(path))} exists already; name a new folder")
        unfinished = path.with_name(f"{path.name}.unfinished-{os.getpid()}")
        unfinished.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"--out: {one_line(str(path))} cannot be made: {error.strerror}") from None
    try:
        yield unfinished
        unfinished.rename(path)
    except BaseException as error:
        if not any(unfinished.iterdir()):
            unfinished.rmdir()
            raise
        kept = f"what was finished is in {unfinished}"
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(kept) from None
        error.add_note(kept)
        raise


def _say_where(folder: Path, group: str | None = None) -> None:
    out = _console()
    files = ", ".join(sorted(file.name for file in folder.iterdir() if not file.name.startswith(".")))
    out.print(f"[bold]{escape(str(folder))}[/]: {files}", soft_wrap=True)
    if group:
        how = f'xarray.open_datatree("{folder / storage.DATA}")["{group}"]'
        out.print(f"Read the data with {how}", markup=False, soft_wrap=True)


def _short(x: float) -> str:
    """`x` in a narrow cell: three significant digits of four decimals, or all that are before the point."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{round(x, 4) + 0:.3g}"


def _console() -> Console:
    """Where tables are printed, :100: as it is; a pipe or a file is wide enough for all of them."""
    return Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else 160)


def _print_json(value: Any) -> None:
    utf8 = (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    print(jsonlib.dumps(value, ensure_ascii=not utf8, indent=1))


@contextlib.contextmanager
def _busy(what: str, quiet: bool = False) -> Iterator[None]:
    """A line on the terminal that says `what` is under way, where that lasts longer than `PATIENCE`."""
    stderr = Console(stderr=True)
    if quiet or not stderr.is_terminal:
        yield
        return
    status = stderr.status(what)
    later = threading.Timer(PATIENCE, status.start)
    later.daemon = True
    later.start()
    try:
        yield
    finally:
        later.cancel()
        later.join()
        status.stop()
