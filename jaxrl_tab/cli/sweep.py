"""`jaxrl-tab sweep` and `jaxrl-tab resume`: experiments from the command line."""

import contextlib
import dataclasses
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from jaxrl_tab.cli.common import (
    ENVIRONMENT,
    HYPERPARAMETERS,
    PROG,
    SEEDS,
    STEPS,
    Switch,
    find,
    known_name,
    named_in,
    parameters_of,
    prepare,
    start_jax,
    with_own,
)
from jaxrl_tab.cli.interrupt import interruptible
from jaxrl_tab.cli.options import Group, parse, place, size, values, whole, word
from jaxrl_tab.cli.screen import busy, print_json, show_outcome
from jaxrl_tab.core.checks import InputError, RunError, one_line, shown
from jaxrl_tab.core.names import is_from_outside
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment import executors, runner
from jaxrl_tab.experiment.executors import Executor
from jaxrl_tab.experiment.plan import plan
from jaxrl_tab.experiment.spec import Experiment, template
from jaxrl_tab.show.progress import Report, reporting


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
    name = known_name("an executor", options.executor, own)
    given = {option: getattr(options, option) for option in ("address", "processes", "process", "slurm")}
    given = {option: value for option, value in given.items() if value not in (None, ())}
    for option in given:
        if option not in own[name]:
            owners = ", ".join(other for other, names in own.items() if option in names)
            raise InputError(f"--{option} belongs to --executor {owners}, and the executor here is {name}")
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
      jaxrl-tab sweep mine.py:MyEnv mine.py:MyMethod sarsa --my-parameter 1 2
      jaxrl-tab sweep --write-template experiment.toml
      jaxrl-tab sweep experiment.toml --dry-run
      jaxrl-tab sweep experiment.toml --out runs/experiment
    """

    env: Annotated[Positional[str], arg(metavar="ENV|FILE", help_behavior_hint="")] = ""
    """Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv, package.module:MyEnv, a table
    mdp.npz, gymnasium:NAME, gymnax:NAME; or an experiment in a file FILE.toml."""
    methods: Annotated[Positional[tuple[str, ...]], arg(metavar="METHOD ...", help_behavior_hint="")] = ()
    """Names of one or more methods; see `jaxrl-tab list`; or of your own, mine.py:MyMethod. An option goes to all
    that have it."""
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


def sweep_command(argv: list[str]) -> int:
    prepare()
    for_environment, for_methods = named_in(argv)
    groups = {
        "hyperparameters": with_own(HYPERPARAMETERS, for_methods),
        "environment": with_own(ENVIRONMENT, for_environment),
    }
    options = parse(f"{PROG} sweep", Sweep, argv, **groups)
    if options.write_template:
        return _write_template(options.env)
    with _executor(options) as executor:
        if isinstance(executor, executors.Distributed) and executor.serve():
            return 0
        with busy("reading what is to be run", options.quiet):
            experiment = _experiment(options, **groups)
        return _conduct(experiment, executor, options, ["sweep", *argv])


def _conduct(experiment: Experiment, executor: Executor, options: Any, command: Sequence[str]) -> int:
    """Runs the experiment, prints what came out, and leaves it in the folder; or says what it would do."""
    start_jax()
    if options.dry_run:
        with busy("planning", options.quiet):
            found = plan(experiment.parts(), options.memory)
        if options.json:
            parts = {name: part._asdict() for name, part in found.parts.items()}
            print_json(found._asdict() | {"parts": parts})
        else:
            print(found.text())
        return 0
    if not options.quiet and sys.stderr.isatty():
        with busy("planning"):
            text = plan(experiment.parts(), options.memory).text()
        print(text, file=sys.stderr)
    given = {"memory": options.memory, "command": shlex.join([PROG, *command])}
    with _watched(options) as progress:
        outcome = runner.run(experiment, options.out, executor=executor, progress=progress, **given)
    return show_outcome(outcome, options.out, options)


def _experiment(options: Any, hyperparameters: Group, environment: Group) -> Experiment:
    """The experiment that is in a file, or was typed."""
    typed = {"steps": options.steps, "episodes": options.episodes, "log_every": options.log_every}
    typed |= {"seeds": options.seeds, "seed": options.seed, "exact": options.exact or None}
    typed |= {"select": {} if options.select else None}
    typed: dict[str, Any] = {name: value for name, value in typed.items() if value is not None}
    is_file = options.env.endswith(".toml") or Path(options.env).is_file()
    if is_file and options.env not in ENVS and not is_from_outside(options.env):
        others = [*options.methods, *options.environment, *options.hyperparameters]
        if said := [*others, *("--" + name.replace("_", "-") for name in typed)]:
            raise InputError(
                f"{said[0]} cannot be given together with a file: {options.env} alone says what is run"
            )
        return Experiment.load(options.env)
    find(environment, options.env)
    env = {"name": options.env} | parameters_of(options.env, options.environment, environment)
    names = options.methods or [""]
    for name in names:
        find(hyperparameters, name)
    grids = values(names, options.hyperparameters, hyperparameters)
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


def resume_command(argv: list[str]) -> int:
    prepare()
    options = parse(f"{PROG} resume", Resume, argv)
    if options.folder is None:
        raise InputError("name the folder of a sweep")
    options.out = options.folder
    command = shlex.join([PROG, "resume", *argv])
    with _executor(options) as executor:
        if isinstance(executor, executors.Distributed) and executor.serve():
            return 0
        start_jax()
        given = {"executor": executor, "memory": options.memory, "command": command, "mixed": options.mixed}
        with _watched(options) as progress:
            outcome = runner.resume(options.out, progress=progress, **given)
        return show_outcome(outcome, options.out, options)


@contextlib.contextmanager
def _watched(options: Any) -> Iterator[Report]:
    """What a run reports its progress to: a bar. Where it is interrupted, it says how to go on."""
    import pandas  # noqa: F401  Now, while there is nothing yet that Ctrl-C could wait for.

    try:
        with interruptible(), reporting(False if options.quiet else None) as report:
            yield report
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
