"""Where the shards of a sweep are computed: in this process, or in others, here or on other machines.

A shard is a function of the experiment and of its number, so the results are bitwise the same everywhere, and
what is lost is computed again. Workers only compute: one process hands out the shards, and writes them.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

from jaxrl_tab.core.checks import build
from jaxrl_tab.core.errors import InputError, nearest
from jaxrl_tab.experiment.executors.base import Arrays, Executor, Work
from jaxrl_tab.experiment.executors.distributed import Distributed
from jaxrl_tab.experiment.executors.ray import Ray
from jaxrl_tab.experiment.executors.slurm import Slurm


@dataclass(frozen=True)
class Local:
    """In this process, one after another, each on all JAX devices: see `use_all_cores`."""

    def run(self, work: Work, tasks: Sequence[int]) -> Generator[tuple[int, Arrays]]:
        """As `Executor.run`."""
        for task in tasks:
            yield task, work(task)


EXECUTORS: dict[str, type[Executor]] = {
    "local": Local,
    "ray": Ray,
    "slurm": Slurm,
    "distributed": Distributed,
}


def get(name: str, **options: Any) -> Executor:
    """The executor with this name, in `EXECUTORS`.

    Args:
        name: its name.
        options: its fields, by name.

    Raises:
        InputError: there is none with this name, or no such option, or a package is missing; the message says
            how to install it.
    """
    if name not in EXECUTORS:
        raise InputError(f"no executor is called {name!r}; {nearest(name, EXECUTORS)}")
    return build(EXECUTORS[name], name, options)


__all__ = ["EXECUTORS", "Arrays", "Distributed", "Executor", "Local", "Ray", "Slurm", "Work", "get"]
