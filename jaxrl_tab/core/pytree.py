"""Frozen dataclasses that are JAX pytrees."""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax
import numpy as np
from jax.core import Tracer

T = TypeVar("T")


def static(default: Any = dataclasses.MISSING, **kwargs: Any) -> Any:
    """A field of a `pytree` class that shapes the program (a size, a rule) and so is not a leaf."""
    return dataclasses.field(default=default, metadata={"static": True}, **kwargs)


@dataclass_transform(frozen_default=True, field_specifiers=(static, dataclasses.field))
def pytree(cls: type[T]) -> type[T]:
    """Makes `cls` a frozen dataclass and a JAX pytree: its fields are leaves, but for the `static` ones.

    JAX rebuilds an instance without calling `__init__`, so `__post_init__` sees only what a person wrote
    and may check values there (`concrete` tells a number from a tracer).
    """
    cls = dataclasses.dataclass(frozen=True, eq=False)(cls)
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    leaves = [f.name for f in fields if not f.metadata.get("static")]
    statics = [f.name for f in fields if f.metadata.get("static")]

    def flatten(obj):
        children = [(jax.tree_util.GetAttrKey(n), getattr(obj, n)) for n in leaves]
        return children, tuple(getattr(obj, n) for n in statics)

    def unflatten(aux, children):
        obj = object.__new__(cls)
        for name, value in (*zip(statics, aux, strict=True), *zip(leaves, children, strict=True)):
            object.__setattr__(obj, name, value)
        return obj

    jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
    return cls


def concrete(x: Any) -> np.ndarray | None:
    """The value of `x` as a NumPy array, or None where it is a tracer and has no value yet."""
    return None if isinstance(x, Tracer) else np.asarray(x)


def as_array(x: Any) -> np.ndarray | None:
    """`concrete(x)`; what cannot become an array, such as rows of unlike lengths, is an empty one of objects."""
    try:
        return concrete(x)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0, object)
