"""What an executor is, and what it needs: work that travels, with the settings of the process that sent it.

Work is a function of a task's number and of nothing else. So it may be done anywhere, again, in any order,
and what comes of it is the same to the last bit, as long as JAX is set up there as it is here, in the same
versions and on the same kind of processor. `Job` makes the settings so, and refuses where the rest is not.
"""

import importlib.util
import os
import platform
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np

from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.engine import by_xla, programs, provenance

Arrays = Mapping[str, np.ndarray]
Work = Callable[[int], Arrays]


@runtime_checkable
class Executor(Protocol):
    """Does the tasks of a piece of work, somewhere."""

    def run(self, work: Work, tasks: Sequence[int]) -> Generator[tuple[int, Arrays]]:
        """Gives (task, work(task)) as they finish, in any order, and keeps none of them.

        Nothing is begun before the first is asked for. What is under way is given up where the iterator is
        closed (`contextlib.closing`), as by Ctrl-C.

        Args:
            work: what to do, from a task's number to arrays by name. It can be pickled, and done twice.
            tasks: the numbers, each once.

        Raises:
            RunError: `work` raised something in another process, or that process died too often; the message
                names the task. In this process what `work` raises goes through as it is.
            InputError: another process would compute other numbers; the message says why.
        """
        ...


class Failed(NamedTuple):
    """What a worker gives back where `work` raised something.

    Attributes:
        line: the error.
        trace: its traceback; empty where the work was refused before it began.
    """

    line: str
    trace: str


class Job(NamedTuple):
    """Work on its way to other processes.

    Attributes:
        work: as in `Executor.run`.
        cores: how many cores of another process become JAX devices; None: all that it may use.
        settings: JAX's, of the process that sends it.
        surroundings: of that process, see `provenance`.
        keeps: whether what is compiled is kept for other processes, as in that process, see `programs`.
    """

    work: Work
    cores: int | None
    settings: dict[str, Any]
    surroundings: dict[str, Any]
    keeps: bool = False

    @staticmethod
    def of(work: Work, cores: int | None = None) -> "Job":
        settings = provenance.settings() | {"jax_platforms": jax.default_backend()}
        return Job(work, cores, settings, provenance.surroundings(), programs.are_kept())

    def __call__(self, task: int) -> Arrays | Failed:
        """What `work` gives. Its errors are values: another process may be unable to load what was raised."""
        try:
            self._set_up()
        except InputError as refused:
            return Failed(str(refused), "")
        try:
            return {name: np.asarray(array) for name, array in self.work(task).items()}
        except Exception as error:
            named = "" if isinstance(error, InputError | RunError) else f"{type(error).__name__}: "
            return Failed(f"{named}{error}", traceback.format_exc())

    def _set_up(self) -> None:
        self._compare(provenance.installed())  # before the settings, which another JAX may not have
        provenance.set_for_good(self.settings)
        if self.cores is None:
            by_xla.use_all_cores()
        else:
            with suppress(RuntimeError):  # JAX has started, for an earlier task
                jax.config.update("jax_num_cpu_devices", self.cores)
        if self.keeps and not programs.are_kept():
            programs.keep()
        self._compare(provenance.surroundings())

    def _compare(self, of_this_process: Mapping[str, Any]) -> None:
        """Raises InputError where this process would compute other numbers than the one that sent the work."""
        if changed := provenance.differences(self.surroundings, of_this_process):
            raise InputError(
                f"{platform.node()} would not compute as the machine where this was started: "
                f"{'; '.join(changed)} there; install and set the same on all machines"
            )


def result_of(task: int, result: Arrays | Failed) -> tuple[int, Arrays]:
    """What `Executor.run` gives of a task that a worker has finished; raises what it raised."""
    if isinstance(result, Failed):
        if not result.trace:
            raise InputError(result.line)
        raise RunError(f"shard {task} failed: {result.line}") from RuntimeError(result.trace)
    return task, result


def environment() -> dict[str, str]:
    """The variables that say how XLA and JAX work, for processes that do not inherit them."""
    return {
        name: value for name, value in os.environ.items() if name.startswith(("JAX_", "JAXRL_TAB_", "XLA_"))
    }


def need(package: str, extra: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise InputError(f"{package} is not installed: pip install 'jaxrl-tab[{extra}]'")
