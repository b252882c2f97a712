"""By what runs are compiled: by `lanes`, our own compiler, or by XLA.

`lanes` makes code for CPUs in which every number is a vector over runs; it takes llvmlite. XLA, which is JAX's own
compiler, makes code for all devices. On a CPU both give the same numbers, but for those that the documentation of
performance lists, and `lanes` is two to three times as fast.
"""

import contextlib
import importlib.util
import logging
import os
from collections.abc import Iterator
from contextvars import ContextVar
from functools import cache
from typing import Any, Literal, TypeAlias, get_args

import jax

from jaxrl_tab.core.declared import name_of
from jaxrl_tab.core.errors import InputError, nearest, shown

Backend: TypeAlias = Literal["auto", "lanes", "xla"]
NAMES = get_args(Backend)
VARIABLE = "JAXRL_TAB_BACKEND"
_asked: ContextVar[str | None] = ContextVar("backend", default=None)
_preferred: ContextVar[str | None] = ContextVar("preferred backend", default=None)


def check(name: Any) -> Backend:
    """The name of a backend. Raises InputError where it is none, or there is no llvmlite for it."""
    if name not in NAMES:
        hint = nearest(name, NAMES) if isinstance(name, str) else f"it is one of {', '.join(NAMES)}"
        raise InputError(f"there is no backend {shown(name)}; {hint}", field="backend")
    if name == "lanes" and not is_installed():
        raise InputError("the backend 'lanes' needs llvmlite: pip install llvmlite", field="backend")
    return name


@cache
def is_installed() -> bool:
    """Whether there is what `lanes` needs."""
    return importlib.util.find_spec("llvmlite") is not None


@contextlib.contextmanager
def using(name: str) -> Iterator[None]:
    """Within the block runs are compiled by this backend; "auto": as around it."""
    check(name)
    token = _asked.set(_asked.get() if name == "auto" else name)
    try:
        yield
    finally:
        _asked.reset(token)


def fall_back(algorithm: Any, env: Any, reason: Exception) -> None:
    """Says, once, that XLA compiles a method in an environment, since `lanes` does not.

    Raises:
        InputError: `lanes` was asked for.
    """
    line = f"{type(algorithm).__name__} in {name_of(env)} is not compiled by lanes: {reason}"
    if asked() == "lanes":
        raise InputError(f"{line}; take the backend 'xla' or 'auto'") from None
    tell(f"{line}; XLA compiles it")


@cache
def tell(line: str) -> None:
    """Logs the line, the first time only."""
    logging.getLogger(__name__).warning("%s", line)


@contextlib.contextmanager
def preferring(name: str) -> Iterator[None]:
    """Within the block runs are compiled by this backend, which another process chose, where it can.

    Nobody need have asked for it: where `lanes` does not compile something, XLA does, as it did there.
    """
    token = _preferred.set(check(name))
    try:
        yield
    finally:
        _preferred.reset(token)


def prefer(name: str) -> None:
    """The same, from now on."""
    _preferred.set(check(name))


def asked() -> Backend:
    """The backend that was asked for: by `using`, or else by the variable of the environment.

    Raises:
        InputError: there is no such backend.
    """
    return check(_asked.get() or os.environ.get(VARIABLE) or "auto")


def chosen() -> Literal["lanes", "xla"]:
    """The backend by which runs are compiled: where nothing was asked for, `lanes` on a CPU. It starts JAX."""
    if (name := _preferred.get() or asked()) in ("lanes", "xla"):
        return name
    return "lanes" if is_installed() and jax.default_backend() == "cpu" else "xla"
