"""What an environment or a method says about itself: its parameters, from its fields and its docstring."""

import dataclasses
import inspect
import re
from typing import Any, NamedTuple

_ENTRY = re.compile(r" {4}(\w+(?:, \w+)*): (.*)")


class Parameter(NamedTuple):
    """A field of an environment or a method.

    Attributes:
        name: of the field.
        type: its annotation, as written.
        default: its value if it is not given.
        help: one line, from the section "Attributes" of the class, or of the nearest base that has it there.
    """

    name: str
    type: Any
    default: Any
    help: str


def summary(cls: type) -> str:
    """The first line of the docstring of `cls`."""
    return inspect.cleandoc(cls.__doc__ or "").partition("\n")[0]


def parameters(cls: type) -> list[Parameter]:
    """The parameters of a registered class, in their order."""
    told: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        told |= _attributes(base.__dict__.get("__doc__") or "")
    return [Parameter(f.name, f.type, f.default, told.get(f.name, "")) for f in dataclasses.fields(cls)]


def _attributes(doc: str) -> dict[str, str]:
    """The entries of the section "Attributes": `name: text` or `name, name: text`, indented by four."""
    _, _, section = inspect.cleandoc(doc).partition("\nAttributes:\n")
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
