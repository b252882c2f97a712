"""Environments and methods that are given as instances: as tables from which the same ones are made again."""

import contextlib
import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from jaxrl_tab.core import modules, names
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import ENVIRONMENT, PREFIX, FiniteHorizon, FiniteMDP

ARRAY = "array"  # the key of a table that stands for an array: {array = [0.5, 1.5], dtype = "float32"}


def is_array(value: Any) -> bool:
    return isinstance(value, Mapping) and value.keys() == {ARRAY, "dtype"}


def made(cls: type, label: str, values: Mapping[str, Any]) -> Any:
    """An environment from its parameters as JSON has them."""
    return build(cls, label, {key: _from_plain(value) for key, value in values.items()})


def _from_plain(value: Any) -> Any:
    if is_array(value):
        return np.asarray(value[ARRAY], value["dtype"])
    return tuple(map(_from_plain, value)) if isinstance(value, list) else value


def table_of(kind: names.Kind, instance: Any) -> dict[str, Any]:
    """A table that stands for an instance: its class with its fields, or the file of a `FiniteMDP`.

    Where neither makes the same one again, it stands for the instance in this process.
    """
    cls = type(instance)
    if cls is FiniteHorizon:
        inner = table_of(kind, instance.env)
        name = inner["name"] if isinstance(inner["name"], str) else names.reference(kind, inner["name"]).name
        inner.pop("max_steps", None)  # which does not count, and cannot be named
        label = {"label": f"{inner['label']},horizon={instance.horizon}"} if "label" in inner else {}
        return {**inner, "name": f"{PREFIX}:{instance.horizon}:{name}"} | label
    if isinstance(instance, FiniteMDP) and all(
        getattr(cls, name) is getattr(FiniteMDP, name) for name in ("reset", "step", "initial", "outcomes")
    ):
        data = instance.to_bytes()
        file = modules.File("FiniteMDP.npz", data)
        file = file._replace(path=f"FiniteMDP-{file.sha256[:8]}.npz")
        modules.keep([file])
        return {"name": file.path, "label": "FiniteMDP", "sha256": file.sha256}
    label, every = names.reference(kind, cls).label, dataclasses.fields(cls)
    fields = {f.name: value for f in every if (value := getattr(instance, f.name)) is not None}
    # What is given as a tuple may be kept as an array: then the tuple makes the same again, and is shorter.
    as_lists = [f.name for f in every if isinstance(f.default, tuple)]
    for listed in (as_lists, []) if kind is ENVIRONMENT else ():
        with contextlib.suppress(InputError, TypeError):
            plain = {name: _plain(value, name in listed) for name, value in fields.items()}
            _check_same(made(cls, label, plain), instance)
            return {"name": cls, **plain}
    if kind is not ENVIRONMENT:
        with contextlib.suppress(TypeError):
            return {"name": cls, **{name: _one_value(value) for name, value in fields.items()}}
    stand_in = names.made_by(lambda: instance, cls.__name__, {})
    refusal = f"this {cls.__name__} cannot be made again from its class and its fields: {names.OWN_FILE}"
    return {"name": names.remember(stand_in, label, refusal).name}


def _plain(value: Any, as_list: bool = False) -> Any:
    """A field of an environment as JSON has it. Raises TypeError where it has no such form."""
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        array = np.asarray(value)
        return (
            {ARRAY: array.tolist(), "dtype": str(array.dtype)}
            if array.ndim and not as_list
            else array.tolist()
        )
    if isinstance(value, list | tuple):
        return [_plain(x) for x in value]
    if isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{type(value).__name__} has no form in a file")


def _one_value(value: Any) -> Any:
    """A hyperparameter. Raises TypeError where it would be taken for several."""
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        if np.ndim(value):
            raise TypeError("an array would be a grid")
        return value.item()
    return value


def _check_same(again: Any, instance: Any) -> None:
    """Raises TypeError unless both are the same to the last bit, but for how JAX holds numbers."""
    (leaves, structure), (others, other) = jax.tree.flatten(again), jax.tree.flatten(instance)
    dtypes = [jax.dtypes.canonicalize_dtype(np.asarray(x).dtype) for x in (*leaves, *others)]
    arrays = [np.asarray(x, dtype) for x, dtype in zip((*leaves, *others), dtypes, strict=True)]
    pairs = zip(arrays[: len(leaves)], arrays[len(leaves) :], strict=True)
    if structure != other or any(x.dtype != y.dtype or x.tobytes() != y.tobytes() for x, y in pairs):
        raise TypeError("it is not the same")
