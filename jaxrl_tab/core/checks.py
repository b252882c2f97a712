"""Checks of the values that users give. (The wording of the messages is in `errors`.)"""

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, get_args, get_origin

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from jaxrl_tab.core.errors import (
    LIMITS,
    InputError,
    check_choice,
    in_words,
    nearest,
    reason,
    shown,
    unfit,
    whole,
)

T = TypeVar("T")

Marks: TypeAlias = np.ndarray | np.bool_
"""Where something is so. What NumPy finds of one number has no axes, and is a scalar."""


def concrete(x: Any) -> np.ndarray | None:
    """The value of `x` as a NumPy array, or None where it is a tracer and has no value yet."""
    return None if isinstance(x, Tracer) else np.asarray(x)


def as_array(x: Any) -> np.ndarray | None:
    """`concrete(x)`; what cannot become an array, such as rows of unlike lengths, is an empty one of objects."""
    try:
        return concrete(x)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0, object)


def assign(obj: Any, **values: Any) -> None:
    """Sets fields of a frozen `obj`, while it is made."""
    for field, value in values.items():
        object.__setattr__(obj, field, value)


def numbers(name: str | None, what: str, value: Any) -> Any:
    """`value` as a NumPy array; a tracer, which has no value to check yet, as it is.

    Raises InputError unless it is numbers in a rectangular array.
    """
    array = as_array(value)
    if array is None:
        return value
    if array.dtype.kind not in "biuf":
        raise unfit(name, what, "numbers, in rows of equal length", value)
    return array


def unbatched(env: Any, field: str, ndim: int, dtype: Any = float) -> Array:
    """A leaf of an environment as a JAX array. Raises InputError where it has the axes of a batch, too."""
    value = getattr(env, field)
    if np.ndim(value) != ndim:
        problem = f"{field} of shape {np.shape(value)} is a batch; vmap over the environment"
        raise InputError(problem, who=type(env).__name__, field=field)
    return jnp.asarray(value, dtype)


def build(cls: type[T], name: str, parameters: Mapping[str, Any]) -> T:
    """`cls(**parameters)`, where `name` is what a person calls the class.

    Raises:
        InputError: a parameter is unknown, with the nearest right one, or missing; or `cls` refuses a value.
    """
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    names = [f.name for f in fields]
    for parameter in parameters:
        if parameter not in names:
            wanted = nearest(parameter, names)
            problem = f"{name} has no parameter {shown(parameter)}; {wanted}"
            raise InputError(problem, field=str(parameter), wanted=wanted)
    is_ours = cls.__module__.partition(".")[0] == __name__.partition(".")[0]
    try:
        return cls(**parameters)
    except InputError as error:
        raise (error.renamed(name) if error.who == cls.__name__ else error) from None
    except Exception as error:
        try:
            inspect.signature(cls).bind(**parameters)
        except TypeError as missing:
            raise InputError(f"{name}: {missing}") from None
        if is_ours:
            raise  # an error in this package, not in the input
        raise InputError(f"{name} refuses its parameters: {type(error).__name__}: {reason(error)}") from error


TOLERANCE = 1e-6  # of a sum of probabilities: tables in float32 pass, thirds written as 0.333 do not


def is_distribution(prob: np.ndarray) -> Any:
    """Whether the last axis holds probabilities that add up to 1, bool [...]."""
    return (prob >= 0).all(-1) & (abs(prob.sum(-1) - 1) < TOLERANCE)


def first(wrong: Marks) -> Any:
    """The index of the first True, as a tuple of int, or None: what a message about an array names."""
    return tuple(int(i) for i in np.argwhere(wrong)[0]) if wrong.any() else None


def repeated(values: Iterable[Any]) -> list[Any]:
    """Those of `values` that equal an earlier one, in their order."""
    seen, again = set(), []
    for value in values:
        # A list cannot be in a set, so its text stands for it.
        key = value if type(value).__hash__ else repr(value)
        if key in seen:
            again.append(value)
        seen.add(key)
    return again


def is_list(value: Any) -> bool:
    """Whether `value` is a list, a tuple or an array with an axis; a string or a NamedTuple is not one."""
    if isinstance(value, np.ndarray | jax.Array):
        return value.ndim > 0
    return (
        isinstance(value, Sequence) and not isinstance(value, str | bytes) and not hasattr(value, "_fields")
    )


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


# --- what a field says of its values (see `pytree.field`) ---------------------------------------------
Numbers: TypeAlias = float | Sequence[float] | np.ndarray | Array
"""A field of this type keeps a number, or an array, as a NumPy array; a tracer stays as it is."""


class Kind(NamedTuple):
    """What fields of one type take.

    Attributes:
        check: returns the value as the field keeps it, from the name of the class, the field, and the value
            as it was passed; raises InputError where that is wrong.
        noun: what it is, for the help: "a number"; the limits of the field follow.
        otherwise: what else a field of this type may hold, for the help.
    """

    check: Callable[[str | None, dataclasses.Field, Any], Any]
    noun: str = ""
    otherwise: str = ""


def check_fields(obj: Any) -> None:
    """Raises InputError unless all fields of `obj` hold what they say that they take; keeps it in their form."""
    for field in dataclasses.fields(obj):
        value = getattr(obj, field.name)
        if (kept := checked(type(obj).__name__, field, value)) is not value:
            object.__setattr__(obj, field.name, kept)


def checked(who: str | None, field: dataclasses.Field, value: Any) -> Any:
    """`value` as a field of the class `who` keeps it. A field of a plain annotation takes anything."""
    rule = field.metadata
    if rule.get("static") and get_origin(field.type) is Literal:
        check_choice(who, field.name, value, get_args(field.type))
    elif "limits" in rule or (rule.get("static") and field.type is bool):
        is_left_out = value is None and field.type not in KINDS
        kind = _kind(field)
        return value if kind is None or is_left_out else kind.check(who, field, value)
    return value


def _kind(field: dataclasses.Field) -> Kind | None:
    return KINDS.get(field.type) or KINDS.get(but_none(field.type))


def but_none(annotation: Any) -> Any:
    """`X` of the annotation `X | None`; any other annotation as it is."""
    others = [x for x in get_args(annotation) if x is not type(None)]
    return others[0] if len(others) == 1 and type(None) in get_args(annotation) else annotation


def explained(field: dataclasses.Field) -> str:
    """The help of a field, with what it takes."""
    limits, takes = in_words(field.metadata.get("limits", {})), ""
    if limits and (kind := _kind(field)):
        takes = f"{kind.noun} {limits}{kind.otherwise}"
    if get_origin(field.type) is Literal:
        *others, last = (f'"{choice}"' for choice in get_args(field.type))
        takes = f"{', '.join(others)} or {last}"
    sentence = f"{takes[0].upper()}{takes[1:]}." if takes else ""
    return " ".join(filter(None, [field.metadata.get("help"), sentence]))


def within(limits: Mapping[str, float], number: np.ndarray) -> Marks:
    """Where numbers are finite and within the limits, bool of their shape."""
    return np.logical_and.reduce(
        [np.isfinite(number), *(LIMITS[name][1](number, limit) for name, limit in limits.items())]
    )


RATE = {"at_least": 0, "at_most": 1}
FRACTION = {"greater_than": 0, "less_than": 1}


def check_within(name: str, value: Any, limits: Mapping[str, float]) -> None:
    """Raises InputError unless `value` is one finite number within limits as a field has them, such as `RATE`."""
    number = np.asarray(value) if isinstance(value, int | float | np.number) else None
    # NumPy has no type for the longest whole numbers, so they become objects.
    if number is None or number.dtype == object or not within(limits, number):
        raise unfit(None, name, in_words(limits), value)


def check_number(who: str | None, field: dataclasses.Field, value: Any, kinds: str = "a number") -> Any:
    """`value`, unless it is neither a number, nor an array of them, nor a tracer.

    All must be within the limits, and stay within them in the precision in which JAX computes. Arrays of other
    libraries become arrays of NumPy, for JAX takes no others.
    """
    name, limits = field.name, field.metadata["limits"]
    if type(value) is float and _is_plainly_within(limits, value):
        return value
    number = np.empty(0, object) if isinstance(value, list | tuple) else as_array(value)
    if number is None:
        return value
    if number.dtype.kind not in "fiu":
        several = isinstance(value, list | tuple)
        hint = ": sweep(...) tries the values of a list, and jax.vmap takes an array" if several else ""
        raise unfit(who, name, kinds, value, hint)
    wanted = in_words(limits) or "a number"
    if not within(limits, number).all():
        raise unfit(who, name, wanted, value)
    dtype = jax.dtypes.canonicalize_dtype(float)
    with np.errstate(over="ignore", under="ignore"):
        rounded = number.astype(dtype)
    sizes = np.finfo(dtype)
    problem = ""
    if not np.isfinite(rounded).all() or ((number != 0) & (abs(rounded) < sizes.tiny)).any():
        holds = f"{dtype} holds 0 and sizes from {sizes.tiny:.2g} to {sizes.max:.2g}"
        problem = f"{name} is {shown(value)}, and {holds}"
    elif not within(limits, rounded).all():
        problem = f"{name} must be {wanted}, and {shown(value)} is not when rounded to {dtype}"
    if problem:
        raise InputError(problem, who=who, field=name, wanted=wanted, value=value)
    return value if isinstance(value, float | int | np.generic | np.ndarray | Array) else number


def _is_plainly_within(limits: Mapping[str, float], number: float) -> bool:
    """Whether a number is far from what float32 cannot hold, and within limits also when rounded to it.

    This is all that is asked of nearly every number, and takes a tenth of the time of the rest of `check_number`.
    """
    if number != 0 and not 1e-30 < abs(number) < 1e30:
        return False
    both = number, float(np.float32(number))
    return all(LIMITS[name][1](x, limit) for name, limit in limits.items() for x in both)


def _whole(who: str | None, field: dataclasses.Field, value: Any) -> int:
    return whole(who, field.name, value, field.metadata["limits"]["at_least"])


def _switch(who: str | None, field: dataclasses.Field, value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise unfit(who, field.name, "true or false", value)
    return bool(value)


def _numbers(who: str | None, field: dataclasses.Field, value: Any) -> Any:
    array = numbers(who, field.name, value)
    if not isinstance(array, np.ndarray):
        return array
    limits = field.metadata["limits"]
    if (i := first(~within(limits, array))) is not None:
        wanted = " and ".join(filter(None, ["finite", in_words(limits)]))
        raise unfit(who, field.name, wanted, array[i].item())
    return array.astype(np.float64)


KINDS: dict[Any, Kind] = {
    bool: Kind(_switch),
    int: Kind(_whole, "a whole number of"),
    float: Kind(check_number, "a number"),
    Numbers: Kind(_numbers, "numbers"),
}
"""The type of a field, as it is annotated -> what it takes. `schedules` and `policies` add theirs."""
