"""What is asked of values that people give, and how a message names them."""

import dataclasses
import difflib
import inspect
import os
import reprlib
import sys
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxrl_tab.core.pytree import T, as_array, concrete


def assign(obj: Any, **values: Any) -> None:
    """Sets fields of a frozen `obj`, while it is made."""
    for field, value in values.items():
        object.__setattr__(obj, field, value)


def numbers(name: str, what: str, value: Any) -> Any:
    """`value` as a NumPy array; a tracer, which has no value to check yet, as it is.

    Raises InputError unless it is numbers in a rectangular array.
    """
    array = as_array(value)
    if array is None:
        return value
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name}: {what} must be numbers, in rows of equal length, not {shown(value)}")
    return array


def unbatched(name: str, what: str, value: Any, ndim: int, dtype: Any = float) -> Array:
    """A leaf as a JAX array. Raises InputError where it has not its `ndim` axes but those of a batch."""
    if np.ndim(value) != ndim:
        raise InputError(f"{name}: {what} of shape {np.shape(value)} is a batch; vmap over the environment")
    return jnp.asarray(value, dtype)


class InputError(ValueError):
    """Something that the user gave is wrong; the message is one line that says what would be right."""


class RunError(RuntimeError):
    """What was asked for is right, and could not be finished here; the message is one line that says why."""


_SHORT = reprlib.Repr()

_SHORT.maxstring = _SHORT.maxother = 60

SHOWN = 120  # characters of a value, at most


def shown(value: Any) -> str:
    """`value` as a message names it: in one short line, whatever it is."""
    if isinstance(value, np.ndarray | jax.Array) and value.ndim:
        if value.ndim > 1 or concrete(value) is None:
            return f"an array of shape {value.shape}"
        return one_line(np.array2string(np.asarray(value[:9]), max_line_width=1000, threshold=8))
    try:
        return one_line(_SHORT.repr(value))
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return f"a number of more than {sys.get_int_max_str_digits()} digits"


def one_line(text: str) -> str:
    """`text` in one line that is not long: the end is cut off where it would be."""
    line = " ".join(text.split())
    return line if len(line) <= SHOWN else line[: SHOWN - 4] + " ..."


def reason(error: BaseException) -> str:
    """What an error says, in one line; the name of its class where it says nothing."""
    return one_line(getattr(error, "strerror", None) or str(error)) or type(error).__name__


def nearest(name: Any, names: Iterable[str]) -> str:
    """Returns "did you mean 'x'?" for the name most like `name`, or one that begins so; else all `names`."""
    names, name = list(names), (name if isinstance(name, str) else "").lower().replace("_", "-")
    begins = [x for x in names if name and x.startswith(name)]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5) or begins
    return f"did you mean '{close[0]}'?" if close else f"choose one of {', '.join(names)}"


def check_choice(name: str, what: str, value: Any, choices: Iterable[str]) -> None:
    """Raises InputError unless `value` is one of the texts in `choices`; the message names the nearest."""
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"{name}: {what} {shown(value)} is unknown; {nearest(value, choices)}")


def build(cls: type[T], name: str, parameters: Mapping[str, Any]) -> T:
    """`cls(**parameters)`, where `name` is what a person calls the class.

    Raises:
        InputError: a parameter is unknown, with the nearest right one, or missing; or `cls` refuses a value.
    """
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    known = [f.name for f in fields]
    for parameter in parameters:
        if parameter not in known:
            raise InputError(f"{name} has no parameter {shown(parameter)}; {nearest(parameter, known)}")
    is_ours = cls.__module__.partition(".")[0] == __name__.partition(".")[0]
    try:
        return cls(**parameters)
    except InputError:
        raise
    except Exception as error:
        try:
            inspect.signature(cls).bind(**parameters)
        except TypeError as missing:
            raise InputError(f"{name}: {missing}") from None
        if is_ours:
            raise  # a defect
        raise InputError(f"{name} refuses its parameters: {type(error).__name__}: {reason(error)}") from error


def as_path(what: str, given: Any) -> Path:
    """`given` as a path. Raises InputError unless it is one that the system can be asked for."""
    try:
        known = isinstance(given, str | os.PathLike) and b"\0" not in os.fsencode(given)
    except UnicodeEncodeError:
        known = False
    if not known:
        raise InputError(f"{what} must be named by a text, or a Path, not {shown(given)}")
    return Path(given)


TOLERANCE = 1e-6  # of a sum of probabilities: tables in float32 pass, thirds written as 0.333 do not


def is_distribution(prob: np.ndarray) -> Any:
    """Whether the last axis holds probabilities that add up to 1, bool [...]."""
    return (prob >= 0).all(-1) & (abs(prob.sum(-1) - 1) < TOLERANCE)


def first(wrong: np.ndarray) -> Any:
    """The index of the first True, as a tuple of int, or None: what a message about an array names."""
    return tuple(int(i) for i in np.argwhere(wrong)[0]) if wrong.any() else None


def repeated(values: Iterable[Any]) -> list[Any]:
    """Those of `values` that were there before, in their order."""
    seen, again = set(), []
    for value in values:
        key = value if type(value).__hash__ else repr(value)
        if key in seen:
            again.append(value)
        seen.add(key)
    return again


def is_whole(value: Any, least: int = 1) -> bool:
    """Whether `value` is a whole number, `least` to 2**31 - 1; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) < 2**31


def whole(name: str, what: str, value: Any, least: int = 1) -> int:
    """`value` as an int. Raises InputError unless it `is_whole`."""
    if not is_whole(value, least):
        raise InputError(f"{name}: {what} must be a whole number of at least {least}, not {shown(value)}")
    return int(value)


def check_switches(name: str, obj: Any) -> None:
    """Raises InputError unless the static fields of `obj` that are declared bool are True or False."""
    for field in dataclasses.fields(obj):
        if field.type is not bool or not field.metadata.get("static"):
            continue
        if not isinstance(value := getattr(obj, field.name), bool | np.bool_):
            raise InputError(f"{name}: {field.name} must be True or False, not {shown(value)}")
        object.__setattr__(obj, field.name, bool(value))


def check_pytree(what: str, obj: Any, registry: Mapping[str, type] | None = None) -> None:
    """Raises InputError unless `obj` is an instance of a class that JAX can take apart.

    Where it is a string, the message names the class that has this name in `registry`, or else the first.
    """
    if isinstance(obj, str) and registry:
        cls = registry.get(obj, next(iter(registry.values())))
        raise InputError(f"{what} must be an instance, such as {cls.__name__}(), not {shown(obj)}")
    if isinstance(obj, type):
        raise InputError(f"{what} must be an instance, such as {obj.__name__}(), not the class")
    if hint := foreign(obj):
        raise InputError(f"{what} must be an environment of jaxrl_tab, not {shown(obj)}{hint}")
    if jax.tree_util.all_leaves([obj]):
        raise InputError(f"{what} is not a JAX pytree: decorate its class with jaxrl_tab.pytree")


def foreign(obj: Any) -> str:
    """What a message adds about `obj` where it is an environment of Gymnasium or gymnax."""
    library = "gymnasium" if hasattr(obj, "unwrapped") else "gymnax" if hasattr(obj, "step_env") else None
    return f"; rl.interop.from_{library} imports it" if library else ""


def check_held(obj: Any) -> None:
    """Raises InputError where a number of `obj` would be infinite in JAX's floats, which are float32 as a rule."""
    dtype = jax.dtypes.canonicalize_dtype(float)
    for path, leaf in jax.tree_util.tree_leaves_with_path(obj):
        if not jnp.issubdtype(jax.typeof(leaf).dtype, jnp.floating) or (number := concrete(leaf)) is None:
            continue
        with np.errstate(over="ignore"):
            lost = np.isfinite(number) & ~np.isfinite(number.astype(dtype))
        if lost.any():
            field = jax.tree_util.keystr(path, simple=True, separator=".")
            raise InputError(
                f"{type(obj).__name__}: {field} holds {number[lost][0]:g}, and {dtype} has numbers up to "
                f"{np.finfo(dtype).max:.2g} in size"
            )


def check_number(obj, name: str, ok, wanted: str, kinds: str = "a number") -> None:
    """Raises InputError unless field `name` of `obj` is a tracer, or a number or an array of them.

    All must be `ok`, which is `wanted` in words, and still be it in the precision in which JAX computes.
    """
    value, field = getattr(obj, name), f"{type(obj).__name__}: {name}"
    number = np.empty(0, object) if isinstance(value, list | tuple) else as_array(value)
    if number is None:
        return
    if number.dtype.kind not in "fiu":
        raise InputError(f"{field} must be {kinds}, not {shown(value)}{_instead(value)}")
    if not bool(ok(number).all()) or not np.isfinite(number).all():
        raise InputError(f"{field} must be {wanted}, not {shown(value)}")
    dtype = jax.dtypes.canonicalize_dtype(float)
    with np.errstate(over="ignore", under="ignore"):
        rounded = number.astype(dtype)
    limits = np.finfo(dtype)
    if not np.isfinite(rounded).all() or ((number != 0) & (abs(rounded) < limits.tiny)).any():
        raise InputError(
            f"{field} is {shown(value)}, and {dtype} holds 0 and sizes from {limits.tiny:.2g} to {limits.max:.2g}"
        )
    if not bool(ok(rounded).all()):
        raise InputError(f"{field} must be {wanted}, and {shown(value)} is not when rounded to {dtype}")


def _instead(value: Any) -> str:
    """What somebody may have meant who gave `value` for a number."""
    if isinstance(value, list | tuple):
        return ": sweep(...) tries the values of a list, and jax.vmap takes an array"
    return ": a text is read by schedules.parse, or on the command line" if isinstance(value, str) else ""
