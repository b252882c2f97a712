"""The command line, `jaxrl-tab` or `python -m jaxrl_tab`: the commands of `MODULES`.

Options for environments and methods are made from the registries: a new entry's parameters are options with
no edit here. All that a person can get wrong is refused before anything is compiled, with exit code 2 and
one line; most of it even before JAX is imported (see `front`). Tables and JSON go to stdout, progress and errors
to stderr.
"""

import atexit
import contextlib
import gc
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from jaxrl_tab.cli.options import checked_name
from jaxrl_tab.cli.streams import PROG, complain, give_up, prepare_streams
from jaxrl_tab.core.errors import InputError, RunError, as_path, one_line, reason
from jaxrl_tab.experiment import painter

# Command -> the module that it is in, imported when it is asked for: they take a second.
MODULES = {
    "list": "listing",
    "bridge": "bridge",
    "schedule": "schedule",
    "solve": "solve",
    "watch": "watch",
    "sweep": "sweep",
    "search": "search",
    "resume": "sweep",
    "explain": "explain",
    "seeds": "seeds",
    "compare": "compare",
    "read": "read",
    "moments": "moments",
    "figure": "figure",
    "check": "check",
}
OBJECTS = 100_000  # that are new: then Python looks for garbage among them, instead of at 700
TRACEBACK = "JAXRL_TAB_TRACEBACK"
HELP = f"""\
usage: {PROG} COMMAND ...

How tabular control methods really behave: over many seeds, over a grid of hyperparameters, beside the exact
optimum.

commands:
  list      the environments and the methods, with their parameters and their backup diagrams
  bridge    dynamic programming beside temporal differences
  schedule  what a step size or an exploration rate comes to, and whether it meets the conditions
  solve     the exact values and an optimal policy of an environment
  watch     an episode of a method, step by step, while it learns
  sweep     methods x hyperparameters x seeds: a table, the data, and pictures
  search    good settings of each method, without running all of them to the end
  resume    go on with a sweep: one that was interrupted, or that is to have more
  explain   where the methods of a sweep lose what they earn less than the best policy
  compare   results beside others: the same bits, or better, or worse
  read      results that other tools computed: a table of methods, and a page
  seeds     how many seeds a comparison takes, judged by the runs of a sweep
  moments   exact learning curves of prediction, without a single run
  figure    make published figures again, and check their numbers
  check     whether an agent that a student wrote is right, and which mistake is in it

examples:
  {PROG} list
  {PROG} list --backups q-learning sarsa-lambda
  {PROG} bridge
  {PROG} schedule glie harmonic:100:visit 0.1
  {PROG} solve windy-gridworld --moves king
  {PROG} watch windy-gridworld sarsa --alpha 0.5
  {PROG} sweep windy-gridworld sarsa q-learning expected-sarsa --out runs/windy
  {PROG} sweep --write-template experiment.toml
  {PROG} search windy-gridworld sarsa --epsilon 0.01:0.3 --draws 27 --out runs/best
  {PROG} resume runs/windy
  {PROG} explain runs/windy
  {PROG} compare runs/last-month runs/today
  {PROG} read 'runs/{{method}}/seed_{{seed}}.csv' --html theirs.html
  {PROG} seeds runs/windy --difference 0.5
  {PROG} moments random-walk td --alpha 0.05 0.1 0.2 --episodes 100
  {PROG} figure cliff-walking --out runs/cliff
  {PROG} figure --all --out runs/figures
  {PROG} check my_agent.py

`{PROG} COMMAND --help` says more about each. `{PROG} --version` prints the version.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code: 0, 2 (wrong input), 130 (Ctrl-C), or 1.

    1 says that a figure is off, that an agent is wrong, that results are worse (if that was asked), or that something
    could not be finished, as where the disk is full. Where the reader of its output goes away, as `| head` does, it
    ends quietly with 1; where stdout or stderr is closed nothing is said there, and the work is done. What the
    encoding of either lacks is replaced. A defect of this package is one line, too, and exit code 1; with
    `JAXRL_TAB_TRACEBACK=1` it is raised.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    prepare_streams()
    try:
        try:
            return _dispatch(argv)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        give_up(sys.stdout)
        return 1
    except (InputError, RunError) as error:
        return complain(str(error), error, code=2 if isinstance(error, InputError) else 1)
    except KeyboardInterrupt as stop:
        return complain("interrupted", stop, code=130)
    except MemoryError as error:
        return complain("there is not enough memory", error)
    except OSError as error:
        give_up(sys.stdout)
        what = f"{error.filename}: " if error.filename else "reading or writing failed: "
        return complain(what + reason(error), error)
    except Exception as error:
        if os.environ.get(TRACEBACK) == "1":
            raise
        with contextlib.suppress(Exception):  # where JAX cannot even be imported
            from jaxrl_tab.lanes import versions

            if newer := versions.newer():
                error.add_note(newer)
        error.add_note(f"please report it with what {TRACEBACK}=1 shows, set before the command")
        what = f"this is a defect of {PROG}: {type(error).__name__}: {one_line(str(error))}"
        return complain(what, error)


def _dispatch(argv: list[str]) -> int:
    for typed in argv:
        as_path("what is typed", typed)  # so that it can name a file, if it should
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(HELP, end="")
        return 0
    if argv[0] == "--version":
        from jaxrl_tab.core.version import __version__

        print(f"{PROG} {__version__}")
        return 0
    name, rest = checked_name("a command", argv[0], MODULES), argv[1:]
    if name not in ("list", "check"):  # which need no more than the front does
        _load("front").answer(name, rest)
    with painter.beside() if _draws(name, rest) else contextlib.nullcontext():
        return getattr(_load(MODULES[name]), f"{name}_command")(rest)


def _load(name: str) -> ModuleType:
    """A module of this package, which imports all that it needs.

    None of that is ever garbage. To look for some again and again would take a tenth of the time; and later on it is
    looked for seldom.
    """
    module = f"{__name__}.{name}"
    if module in sys.modules or not gc.isenabled():
        return importlib.import_module(module)
    gc.disable()
    try:
        return importlib.import_module(module)
    finally:
        gc.freeze()
        gc.set_threshold(OBJECTS)
        atexit.register(gc.freeze)  # in the end Python would look through all that there is
        gc.enable()


def _draws(name: str, argv: Sequence[str]) -> bool:
    """Whether a command may draw the pictures of an experiment."""
    into_folder = name == "resume" or (name in ("sweep", "search") and "--out" in argv)
    return into_folder and not {"--dry-run", "--no-pictures"} & set(argv)
