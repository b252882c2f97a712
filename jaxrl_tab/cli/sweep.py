"""`jaxrl-tab sweep` and `jaxrl-tab resume`: experiments from the command line."""

import contextlib
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxrl_tab.cli.common import (
    ENVIRONMENTS,
    EXECUTOR,
    HYPERPARAMETERS,
    SEEDS,
    STEPS,
    find,
    groups_in,
    prepare,
    start_jax,
)
from jaxrl_tab.cli.options import Typed, checked_name, environments_first
from jaxrl_tab.cli.running import (
    Where,
    is_typed_as_file,
    length_typed,
    methods_typed,
    say_where_of,
    watched,
)
from jaxrl_tab.cli.screen import busy
from jaxrl_tab.cli.streams import PROG, print_json
from jaxrl_tab.cli.typed import OPTIONAL, Classes, parse, several_of, values_of, word
from jaxrl_tab.core.errors import InputError, one_line
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.engine import backend
from jaxrl_tab.engine.backend import Backend
from jaxrl_tab.engine.by_lanes import threads
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment import executors, runner
from jaxrl_tab.experiment.executors import Executor
from jaxrl_tab.experiment.plan import OnWorkers, on_workers, plan
from jaxrl_tab.experiment.shards import Job
from jaxrl_tab.experiment.spec import Experiment, template


@checked_dataclass
class Anywhere(Where):
    """The same, and where a sweep is computed.

    Attributes:
        executor: local (all cores of this machine), ray, slurm, or distributed (jax.distributed); see
            docs/scaling.md.
    """

    executor: str = "local"


@contextlib.contextmanager
def _executor(options: Any, typed: Typed, out: Path | None, is_used: bool = True) -> Iterator[Executor]:
    """The executor that the options name, made with those of them that are its own.

    Where it `is_used` for nothing, as by `--dry-run`, it need not be reached.
    """
    name = checked_name(EXECUTOR.noun, options.executor, executors.EXECUTORS)
    parameters = values_of(name, typed, EXECUTOR)
    if not is_used:
        yield executors.Local()
        return
    if name == "slurm":
        if out is None:
            raise InputError("--executor slurm needs --out: a folder that all machines see")
        parameters = {"folder": out / "jobs"} | parameters
    executor = executors.get(name, **parameters)
    with executor if isinstance(executor, executors.Distributed) else contextlib.nullcontext():
        yield executor


@checked_dataclass
class Sweep(Anywhere):
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
      jaxrl-tab sweep cliff-walking sarsa q-learning --alpha 0.1 0.5 --until-decided 2
      jaxrl-tab sweep windy-gridworld cliff-walking sarsa q-learning
      jaxrl-tab sweep mine.py:MyEnv mine.py:MyMethod sarsa --my-parameter 1 2
      jaxrl-tab sweep --write-template experiment.toml
      jaxrl-tab sweep experiment.toml --dry-run
      jaxrl-tab sweep experiment.toml --dry-run --executor ray --workers 64
      jaxrl-tab sweep experiment.toml --out runs/experiment

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`, or one of your own: mine.py:MyEnv,
            package.module:MyEnv, a table mdp.npz, gymnasium:NAME, gymnax:NAME; or an experiment in a file
            FILE.toml. Several names of environments that are listed are compared over all of them.
        methods: Names of one or more methods; see `jaxrl-tab list`; or of your own, mine.py:MyMethod. An
            option goes to all that have it.
        seeds: How many seeds.
        first_seed: The number of the first of them, from which the others follow.
        steps: How many steps each run takes.
        episodes: How many episodes each run finishes, instead of --steps.
        log_every: How many steps, or episodes, are summed up in one row of the log: 100 steps, or 1 episode,
            by default.
        seed: Which sequence of seeds.
        select: Run the best setting of each method again, on as many fresh seeds; show both numbers.
        until_decided: Compare the methods, each at its best setting, on as many fresh seeds as it takes: until each
            two are told apart, or are surely apart by less than D, of mean scores, if that is given. The first look is
            at as many fresh seeds as --seeds.
        most_seeds: With --until-decided: leave open what is not decided by so many seeds. (default: 2000)
        all_settings: With --until-decided: compare all settings of all methods with each other.
        exact: Also record the exact values of the greedy policy and of the one that acts, and the largest
            |Q - Q*|, at every row of the log. (The error of methods of prediction is always recorded.)
        exact_every: The same at one of so many rows only, and at the last: each takes time for many steps.
        record: Also record at every row what a function of your own says of the learner, such as
            mine.py:q_of_start.
        backend: What compiles it: lanes, which is for CPUs and fast, or xla. By default lanes, where it can.
        out: New folder for the data and the pictures.
        dry_run: Show what would be run, in how much memory, and stop.
        workers: With --dry-run: how long it takes on so many workers of the executor that are as fast as this machine.
        write_template: Write an experiment that explains itself, to FILE or, without one, to the screen, and
            stop.
    """

    env: str = word("ENV ...|FILE")
    methods: tuple[str, ...] = word("METHOD ...", many=True)
    seeds: int = field(default=SEEDS, at_least=1)
    first_seed: int = field(default=0, at_least=0)
    steps: int = field(default=STEPS, at_least=1)
    episodes: int | None = field(default=None, at_least=1)
    log_every: int | None = field(default=None, at_least=1)
    seed: int = field(default=0, at_least=0)
    select: bool = False
    until_decided: OPTIONAL = False
    most_seeds: int | None = field(default=None, at_least=2)
    all_settings: bool = False
    exact: bool = False
    exact_every: int | None = field(default=None, at_least=1)
    record: str | None = None
    backend: Backend = field(default="auto", static=True)
    out: Path | None = None
    dry_run: bool = False
    workers: int | None = field(default=None, at_least=1)
    write_template: bool = False


OF_EXPERIMENT = (
    "--seeds",
    "--first-seed",
    "--steps",
    "--episodes",
    "--log-every",
    "--seed",
    "--select",
    "--until-decided",
    "--most-seeds",
    "--all-settings",
    "--exact",
    "--exact-every",
    "--record",
    "--backend",
)


def sweep_command(argv: list[str]) -> int:
    prepare()
    groups = groups_in(argv, HYPERPARAMETERS, ENVIRONMENTS)
    options, typed = parse(Sweep, argv, **groups, executor=EXECUTOR)
    if options.write_template:
        return _write_template(options.env)
    if options.workers and not options.dry_run:
        raise InputError("--workers is for --dry-run: how many there are, the executor knows")
    if options.workers and options.executor == "local":
        raise InputError(
            "--workers is how many an executor has: give --executor ray, slurm or distributed as well"
        )
    with _executor(options, typed["executor"], options.out, not options.dry_run) as executor:
        if isinstance(executor, executors.Distributed) and executor.serve():
            return 0
        with busy("reading what is to be run", options.quiet):
            experiment = _experiment(options, typed, **groups)
        return _conduct(experiment, executor, options, ["sweep", *argv], typed["executor"])


def _forecast(experiment: Experiment, options: Sweep, typed: Typed) -> OnWorkers:
    """How long it takes on the workers of an executor: one core of each, unless it was said otherwise."""
    given = values_of(options.executor, typed, EXECUTOR)
    cores = given.get("num_cpus") or dict(given.get("parameters", {})).get("cpus_per_task") or 1
    if options.executor == "distributed":
        cores = threads()  # all of each machine
    return on_workers(Job.of(experiment, options.bytes, {}), options.workers or 1, int(cores))


def _conduct(
    experiment: Experiment, executor: Executor, options: Sweep, command: Sequence[str], typed: Typed
) -> int:
    """Runs the experiment, prints what came out, and leaves it in the folder; or says what it would do."""
    start_jax()
    forecast = None
    if options.dry_run or (not options.quiet and sys.stderr.isatty()):
        with busy("planning", options.quiet), backend.using(experiment.backend):
            planned = plan(experiment.parts(), options.bytes)
            forecast = _forecast(experiment, options, typed) if options.workers else None
        if options.dry_run and options.json:
            parts = {name: part._asdict() for name, part in planned.parts.items()}
            elsewhere = {"on_workers": forecast._asdict()} if forecast else {}
            print_json(planned._asdict() | {"parts": parts} | elsewhere)
        else:
            print(planned.text(), file=sys.stdout if options.dry_run else sys.stderr)
            if forecast:
                print(forecast.text())
            if about := experiment.until_decided:
                what = "every setting" if about["all_settings"] else "the best setting of each method"
                print(
                    f"then {what} is run on {experiment.select['fresh_seeds']} to {about['most_seeds']} fresh seeds, "
                    "until all is decided",
                    file=sys.stdout if options.dry_run else sys.stderr,
                )
        if options.dry_run:
            return 0
    about = {"memory": options.bytes, "command": shlex.join([PROG, *command])}
    with watched(options, options.out) as watch:
        outcome = runner.run(experiment, options.out, executor=executor, **about, **watch)
    say_where_of(outcome, options.out, options)
    return 0


def _experiment(
    options: Sweep, typed: Mapping[str, Typed], hyperparameters: Classes, environment: Classes
) -> Experiment:
    """The experiment that is in a file, or was typed."""
    if is_typed_as_file(options, typed, OF_EXPERIMENT):
        return Experiment.load(options.env)
    envs, names = environments_first(options.env, options.methods, ENVS)
    for env in envs:
        find(environment, env)
    environments = several_of(envs, typed["environment"], environment)
    names = names or ("",)
    for name in names:
        find(hyperparameters, name)
    return Experiment(
        environments,
        methods_typed(names, typed["hyperparameters"], hyperparameters),
        **length_typed(options, typed["options"]),
        seeds=options.seeds,
        first_seed=options.first_seed,
        log_every=options.log_every,
        seed=options.seed,
        exact=options.exact,
        exact_every=options.exact_every,
        record=options.record,
        backend=options.backend,
        select={} if options.select else None,
        until_decided=_comparison(options),
    )


def _comparison(options: Sweep) -> dict[str, Any] | None:
    """How the methods are compared, as in a file; None where they are not."""
    given, most = options.until_decided, options.most_seeds
    if given is False:
        if most is not None or options.all_settings:
            what = "--all-settings" if most is None else "--most-seeds"
            raise InputError(f"{what} says how --until-decided compares: give that as well")
        return None
    difference = {} if given is True else {"difference": given}
    return (
        difference | {"all_settings": options.all_settings} | ({} if most is None else {"most_seeds": most})
    )


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


@checked_dataclass
class Resume(Anywhere):
    """Goes on with a sweep that was interrupted, or that is to have more: computes what is missing, and nothing else.

    The results are the same, to the last bit, as if nothing had happened. Where they would not be, as with
    another version of JAX or on another kind of processor, it says what has changed, and computes nothing.

    More seeds are asked for by an option; more values, methods and environments, by writing them into experiment.toml
    in the folder, or by naming a file that has them all. What is there stays, and the results are those of the larger
    sweep that is run at once.

    Examples:
      jaxrl-tab resume runs/windy
      jaxrl-tab resume runs/windy --seeds 200
      jaxrl-tab resume runs/windy more.toml
      jaxrl-tab resume runs/windy --history

    Attributes:
        folder: The folder of the sweep: what --out named.
        file: An experiment with all that the sweep has, and more.
        seeds: How many seeds there are to be.
        steps: How many steps each run is to take. Runs go on from where they ended, if the folder has that.
        episodes: How many episodes each run is to finish, in the same way.
        formats: Of the pictures: png, svg, pdf, or several of them; by default those that there were, if any.
        history: Show what the sweep was begun with, and what was added when; and stop.
        mixed: Go on nevertheless; the report tells what was not the same for all numbers.
    """

    folder: str = word("DIR")
    file: str = word("[FILE]")
    seeds: int | None = field(default=None, at_least=1)
    steps: int | None = field(default=None, at_least=1)
    episodes: int | None = field(default=None, at_least=1)
    formats: tuple[str, ...] = ()
    history: bool = False
    mixed: bool = False


def resume_command(argv: list[str]) -> int:
    prepare()
    options, typed = parse(Resume, argv, executor=EXECUTOR)
    if not options.folder:
        raise InputError("name the folder of a sweep")
    folder, limit = Path(options.folder), options.bytes
    if options.history:
        return _show_history(folder, options)
    with _executor(options, typed["executor"], folder) as executor:
        if isinstance(executor, executors.Distributed) and executor.serve():
            return 0
        start_jax()
        about = {"memory": limit, "command": shlex.join([PROG, "resume", *argv]), "mixed": options.mixed}
        about |= {key: getattr(options, key) for key in ("seeds", "steps", "episodes")}
        about |= {"experiment": Experiment.load(options.file) if options.file else None}
        with watched(options, folder, argv) as watch:
            outcome = runner.resume(folder, executor=executor, **about, **watch)
        say_where_of(outcome, folder, options)
        return 0


def _show_history(folder: Path, options: Resume) -> int:
    lines = runner.history(folder)
    if options.json:
        print_json([dict(zip(("time", "what", "command"), line, strict=True)) for line in lines])
    else:
        for time, what, command in lines:
            print(f"{time}  {what}\n    {command}")
    return 0
