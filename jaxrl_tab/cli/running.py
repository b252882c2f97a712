"""What the commands share that run experiments: what is typed for them, and how they are watched."""

import contextlib
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxrl_tab.cli.interrupt import interruptible
from jaxrl_tab.cli.options import Typed
from jaxrl_tab.cli.screen import say_where, show_look, show_outcome
from jaxrl_tab.cli.streams import PROG
from jaxrl_tab.cli.typed import Classes, values
from jaxrl_tab.core import memory
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.names import is_from_outside
from jaxrl_tab.core.pytree import checked_dataclass
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment.files import FORMATS, Outcome, check_formats


@checked_dataclass
class Where:
    """In how much memory an experiment is computed, and how much of it is shown.

    Attributes:
        memory: How much memory a method may take, such as 4GB; results that do not fit go to temporary files.
            By default it is half of what is free.
        formats: Of the pictures: png, svg, pdf, or several of them.
        pictures: Draw no pictures. (The report shows the same, and more.)
        json: Print the summary, or what would be run, as JSON.
        quiet: Show no progress and no table.
    """

    memory: str | None = None
    formats: tuple[str, ...] = FORMATS[:1]
    pictures: bool = True
    json: bool = False
    quiet: bool = False

    def __post_init__(self):
        _ = self.bytes, check_formats(self.formats)  # raises InputError before anything is computed

    @property
    def bytes(self) -> int | None:
        return None if self.memory is None else memory.parse(self.memory)


def is_typed_as_file(options: Any, typed: Mapping[str, Typed], own: Sequence[str]) -> bool:
    """Whether a file is named that says what is run; raises InputError where one of its `own` options stands beside."""
    is_file = options.env.endswith(".toml") or Path(options.env).is_file()
    if not is_file or options.env in ENVS or is_from_outside(options.env):
        return False
    given = [option for option in own if option in typed["options"]]
    if beside := [*options.methods, *typed["environment"], *typed["hyperparameters"], *given]:
        raise InputError(
            f"{beside[0]} cannot be given together with a file: {options.env} alone says what is run"
        )
    return True


def methods_typed(names: Sequence[str], typed: Typed, classes: Classes) -> list[dict[str, Any]]:
    """The methods as they stand in a file, each with what was typed for it: a value, or a list of several."""
    grids = values(names, typed, classes)
    alone_or_listed = lambda tried: tried[0] if len(tried) == 1 else tried
    return [
        {"name": name} | {k: alone_or_listed(tried) for k, tried in grids[name].items()} for name in names
    ]


def length_typed(options: Any, typed: Typed) -> dict[str, Any]:
    """How long runs are, as in a file."""
    if options.episodes is not None and "--steps" in typed:
        raise InputError("give --steps or --episodes, not both")
    return {"steps": options.steps if options.episodes is None else None, "episodes": options.episodes}


@contextlib.contextmanager
def watched(options: Where, folder: Path | None, again: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """How a run is watched, as arguments of `run`: its progress by a bar, and its results as soon as they are there.

    Where it is interrupted, it says how to go on: with all that `again` has, for the folder need not know it yet. That
    nobody reads the results any more does not interrupt it: the files are written first.
    """
    import pandas  # noqa: F401  Now, while there is nothing yet that Ctrl-C could wait for.

    unread: list[BaseException] = []

    def show(outcome: Outcome) -> None:
        try:
            show_outcome(outcome, folder, options)
            sys.stdout.flush()
        except (OSError, SystemExit) as error:  # rich ends the process where a pipe is broken
            unread.append(error)

    try:
        with interruptible():
            formats = (options.formats or None) if options.pictures else ()
            looked = None if options.quiet else show_look
            shown = {"progress": False if options.quiet else None, "ready": show, "looked": looked}
            yield {**shown, "formats": formats}
    except InputError:
        raise
    except BaseException as stop:
        if folder and folder.is_dir():
            command = shlex.join([PROG, "resume", *(again or [str(folder)])])
            stop.add_note(f"what is finished is kept, `{command}` goes on")
        raise
    for error in unread:
        raise error


def say_where_of(outcome: Outcome, folder: Path | None, options: Where) -> None:
    """Names the files, and how the data are read; where a person reads."""
    if folder and not options.json and not options.quiet:
        name = next(iter(outcome.datasets))
        say_where(folder, name if len(outcome.envs) > 1 else name.partition("/")[2])
