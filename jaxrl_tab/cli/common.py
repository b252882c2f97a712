"""What several commands share: names, parameters of environments, and what is settled before JAX starts."""

import contextlib
import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import jax
from tyro.conf import FlagCreatePairsOff, arg

from jaxrl_tab.algorithms import ALGORITHMS
from jaxrl_tab.algorithms.prediction import METHODS, PREDICTION
from jaxrl_tab.cli.options import Group, parameters, values
from jaxrl_tab.core.checks import InputError, build, nearest, one_line, shown
from jaxrl_tab.engine import batch, programs
from jaxrl_tab.envs import ENVS, instead

Switch = Annotated[bool, FlagCreatePairsOff, arg(help_behavior_hint="")]

PROG = "jaxrl-tab"

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


def prepare() -> None:
    """What must be settled before anything is computed."""
    batch.use_all_cores()
    programs.keep()


def start_jax() -> None:
    """Raises InputError where JAX cannot start, as where `JAX_PLATFORMS` names what is not there."""
    try:
        jax.devices()
    except RuntimeError as error:
        raise InputError(f"JAX cannot start: {one_line(str(error))}") from None


def known_name(kind: str, name: str, names: Collection[str]) -> str:
    """`name`, which must be one of `names`."""
    if not name:
        raise InputError(f"name {kind}: {', '.join(names)}")
    if name not in names:
        raise InputError(
            f"{shown(name)} is not {kind}; {instead(name) if names is ENVS else nearest(name, names)}"
        )
    return name


def make_environment(name: str, given: Mapping[str, tuple[str, ...]]) -> Any:
    return build(ENVS[known_name("an environment", name, ENVS)], name, parameters_of(name, given))


def parameters_of(name: str, given: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """The parameters of an environment that were typed, with their values."""
    typed = values([name], given, ENVIRONMENT)[name]
    defaults = {p.name: p.default for p in parameters(ENVS[name])}
    return {n: tuple(v) if isinstance(defaults[n], tuple) else v[0] for n, v in typed.items()}


@contextlib.contextmanager
def new_folder(path: Path | None) -> Iterator[Path | None]:
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
