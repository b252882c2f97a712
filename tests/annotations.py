"""Imports jaxrl_tab so that every call is checked against its annotations, by jaxtyping and beartype.

A value that an annotation excludes is right only where the function refuses it by itself, with an InputError
(or a RunError): then that error is raised, as it is without this. Everything else is a wrong annotation, or a
wrong call, and an error.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any, Self

import jaxtyping
from beartype import BeartypeConf, beartype

beartyped = beartype(conf=BeartypeConf(is_pep484_tower=True))  # a whole number is a float, as for type checkers
_jaxtyped = jaxtyping.jaxtyped


def jaxtyped(function: Any = jaxtyping.jaxtyped, *, typechecker: Any = None) -> Any:
    """In the place of `jaxtyping.jaxtyped`, which the import hook writes above every function and class."""
    if function is _jaxtyped:
        return functools.partial(jaxtyped, typechecker=typechecker)
    if inspect.isfunction(function):  # beartype knows what Self is only where it has the class
        hints = function.__annotations__
        hints.update({name: Any for name, hint in hints.items() if hint is Self})
    checked = _jaxtyped(function, typechecker=typechecker)
    if isinstance(function, type) or not inspect.isfunction(function) or inspect.isgeneratorfunction(function):
        return checked
    return _refusing(function, checked)


def _refusing(function: Callable, checked: Callable) -> Callable:
    @functools.wraps(checked)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return checked(*args, **kwargs)
        except jaxtyping.TypeCheckError as violation:
            from jaxrl_tab.core.checks import InputError, RunError

            try:
                function(*args, **kwargs)
            except (InputError, RunError):
                raise
            except Exception:
                raise violation from None
            raise violation

    return call


def check() -> None:
    """From now on modules of jaxrl_tab are checked as they are imported."""
    jaxtyping.jaxtyped = jaxtyped
    jaxtyping.install_import_hook("jaxrl_tab", "annotations.beartyped")
