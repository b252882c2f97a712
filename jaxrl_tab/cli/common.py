"""What several commands share: names, parameters of environments, and what is settled before JAX starts."""

import contextlib
import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from jaxrl_tab import envs, interop  # noqa: F401  interop adds the libraries that it imports from
from jaxrl_tab.cli.options import Typed
from jaxrl_tab.cli.typed import Classes, values_of
from jaxrl_tab.core import names
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import InputError, listed, one_line
from jaxrl_tab.engine import by_xla, programs
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment import disk, executors
from jaxrl_tab.methods import ALGORITHMS, METHOD, METHODS, PREDICTION

ALPHAS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)  # the step sizes of a sweep that names none
SEEDS, STEPS = 100, 8000
ENVIRONMENT = Classes(ENVS, "Parameters of the environment.", kind=envs.ENVIRONMENT)
ENVIRONMENTS = ENVIRONMENT._replace(
    help="Parameters of the environment; where one has several values, each is an environment of its own.",
    grids=True,
)
# But for those that learn bounds of them, which have other parameters.
OF_VALUES = [
    name
    for name, cls in ALGORITHMS.items()
    if of_method(cls).learns is Learns.ACTIONS and not of_method(cls).needs_horizon
]
HYPERPARAMETERS = Classes(
    METHODS,
    "Of the methods; several values make a grid.",
    kind=METHOD,
    grids=True,
    defaults={"alpha": ALPHAS},
    parts={
        "the methods of control": ALGORITHMS,
        "the methods of control that learn values": OF_VALUES,
        "the methods of prediction": PREDICTION,
    },
)
OF_ONE_METHOD = HYPERPARAMETERS._replace(help="Of the method.", grids=False, defaults={})
# Some parameters of the executors are called otherwise here, where they stand beside options of other things.
EXECUTOR = Classes(
    executors.EXECUTORS,
    "Of the executor. The address is that of a Ray cluster, or of process 0 of a distributed job.",
    spelled={"num_processes": "processes", "process_id": "process", "parameters": "slurm"},
    noun="an executor",
)


def prepare() -> None:
    """What must be settled before anything is computed."""
    by_xla.use_all_cores()
    programs.keep()


def start_jax() -> None:
    """Raises InputError where JAX cannot start, as where `JAX_PLATFORMS` names what is not there."""
    try:
        jax.devices()
    except RuntimeError as error:
        raise InputError(f"JAX cannot start: {one_line(str(error))}") from None


def with_own(group: Classes, words: Sequence[str]) -> Classes:
    """The group with the classes from outside of its registry that some words name, before the others."""
    assert group.kind
    own = {}
    for word in words:
        if not any(word in kind.registry for kind in names.KINDS) and not word.endswith(".toml"):
            with contextlib.suppress(InputError):  # it may be a value; a wrong name `find` refuses
                own[word] = names.find(group.kind, word).cls
    return group._replace(registry=own | dict(group.registry))


def named_in(argv: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """The words that may name an environment, and those that may name methods."""
    first = list(itertools.takewhile(lambda word: not word.startswith("-"), argv))
    if first:
        return first[:1], first[1:]
    words = [word for word in argv if names.is_from_outside(word)]
    return words, words


def groups_in(
    argv: Sequence[str], methods: Classes, environments: Classes = ENVIRONMENT
) -> dict[str, Classes]:
    """The options of methods and of environments, with the classes from outside that are named."""
    for_environment, for_methods = named_in(argv)
    return {
        "hyperparameters": with_own(methods, for_methods),
        "environment": with_own(environments, for_environment),
    }


def find(group: Classes, name: str) -> type:
    """The class that a word names, which must be of the kind of this group."""
    assert group.kind
    if not name:
        raise InputError(f"name {group.kind.noun}: {listed(group.registry)}")
    return group.registry[name] if name in group.registry else names.find(group.kind, name).cls


def build_named(groups: Mapping[str, Classes], typed: Mapping[str, Typed], **names: str) -> list[Any]:
    """For each group an instance of the class that a word names, with the options that were typed."""
    return [
        build(find(groups[title], name), name, values_of(name, typed[title], groups[title]))
        for title, name in names.items()
    ]


def new_folder(path: Path | None) -> contextlib.AbstractContextManager[Path | None]:
    """A new folder to write into, which gets the name `path` when all is written; none where `path` is None.

    If anything fails, what was finished stays in a folder beside it.
    """
    if path is None:
        return contextlib.nullcontext()
    return disk.new_folder(Path(os.path.normpath(path)), keep=True)
