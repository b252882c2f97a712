"""Frozen dataclasses that are JAX pytrees, whose fields say what they take."""

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, dataclass_transform

import jax

from jaxrl_tab.core.checks import T, check_fields, explained
from jaxrl_tab.core.errors import LIMITS
from jaxrl_tab.core.notebook import Shown

_ENTRY = re.compile(r" {4}(\w+(?:, \w+)*): (.*)")
_SECTION = "\nAttributes:\n"


def field(default: Any = dataclasses.MISSING, *, static: bool = False, help: str = "", **more: Any) -> Any:
    """A field of a `pytree` class that says what it takes.

        alpha: Rate = field(default=0.1, greater_than=0, help="Step size.")

    Its value is checked against that before `__post_init__` runs, by the field's type: see `checks.KINDS`.
    A field that only gives another default to a field of a base class keeps the help and the limits of that.

    Args:
        default: its value where none is given.
        static: whether it shapes the program (a size, a rule), and so is not a leaf.
        help: what it is. What it takes is added by itself.
        more: the limits of a number: at_least, greater_than, at_most, less_than; and what
            `dataclasses.field` takes.
    """
    limits = {name: more.pop(name) for name in LIMITS if name in more}
    metadata: dict[str, Any] = {"static": True} if static else {}
    if limits or not static:
        metadata["limits"] = limits
    if help:
        metadata["help"] = help
    return dataclasses.field(default=default, metadata=metadata, **more)


def static(default: Any = dataclasses.MISSING, **more: Any) -> Any:
    """A `field` of a `pytree` class that shapes the program (a size, a rule) and so is not a leaf."""
    return field(default, static=True, **more)


@dataclass_transform(frozen_default=True, field_specifiers=(field, static, dataclasses.field))
def checked_dataclass(cls: type[T], *, eq: bool = True) -> type[T]:
    """Makes `cls` a frozen dataclass whose fields are checked against what they say that they take.

    `__post_init__` may check afterwards what involves several fields. The docstring gets an entry for every
    field that has a help; an entry that it has already is the help of its field.
    """
    doc, inherited = vars(cls).get("__doc__"), getattr(cls, "__dataclass_fields__", {})
    documented = _attributes(doc or "")
    _check_first(cls)
    cls = dataclasses.dataclass(frozen=True, eq=eq, repr=not issubclass(cls, Shown))(cls)
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    for f in fields:
        if f.name in inspect.get_annotations(cls):
            before = dict(inherited[f.name].metadata) if f.name in inherited else {}
            help = {"help": documented[f.name]} if f.name in documented else {}
            # Limits are kept where none are given: MonteCarlo has another default and help for alpha.
            own = {key: x for key, x in f.metadata.items() if x or key not in before}
            f.metadata = MappingProxyType(before | help | own)
    undocumented = {f.name: explained(f) for f in fields if f.name not in documented and "help" in f.metadata}
    cls.__doc__ = _with_attributes(doc, undocumented) if undocumented else cls.__doc__
    return cls


@dataclass_transform(frozen_default=True, field_specifiers=(field, static, dataclasses.field))
def pytree(cls: type[T]) -> type[T]:
    """Makes `cls` a `checked_dataclass` and a JAX pytree: its fields are leaves, but for the `static` ones.

    JAX rebuilds an instance without calling `__init__`, so only what a person wrote is checked (`concrete`
    tells a number from a tracer).
    """
    cls = checked_dataclass(cls, eq=False)
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


def _check_first(cls: Any) -> None:
    """Has the fields of an instance of `cls` checked before the `__post_init__` of its class runs."""
    own = vars(cls).get("__post_init__")

    def __post_init__(self, *args):
        if type(self) is cls:  # not where a subclass, which has checked all fields, calls that of its base
            check_fields(self)
        if own is not None:
            own(self, *args)
        elif (inherited := getattr(super(cls, self), "__post_init__", None)) is not None:
            inherited(*args)

    cls.__post_init__ = __post_init__


def _with_attributes(doc: str | None, entries: Mapping[str, str]) -> str:
    """A docstring with these entries in its section "Attributes", which is made where there is none."""
    before, _, after = inspect.cleandoc(doc or "").partition(_SECTION)
    lines = [
        textwrap.fill(f"{name}: {help}", 110, initial_indent=" " * 4, subsequent_indent=" " * 8)
        for name, help in entries.items()
    ]
    return "\n".join([before.rstrip() + "\n" + _SECTION.rstrip(), *lines, after])


def _attributes(doc: str) -> dict[str, str]:
    """The entries of the section "Attributes": `name: text` or `name, name: text`, indented by four."""
    _, _, section = inspect.cleandoc(doc).partition(_SECTION)
    entries: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        if line and not line.startswith(" "):
            break
        if entry := _ENTRY.fullmatch(line):
            names = entry[1].split(", ")
            entries |= dict.fromkeys(names, entry[2])
        elif line.strip():
            entries |= {name: f"{entries[name]} {line.strip()}" for name in names}
    return entries
