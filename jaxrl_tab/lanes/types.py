"""How LLVM writes types and numbers."""

from typing import Any

import numpy as np

from jaxrl_tab.lanes.code import Unsupported

TYPES = {"bool": "i1", "int32": "i32", "uint32": "i32", "float32": "float"}


def type_of(dtype: Any) -> str:
    """A single number. Raises Unsupported where no rule knows numbers of this kind."""
    if (name := np.dtype(dtype).name) not in TYPES:
        raise Unsupported(f"numbers of the type {name}")
    return TYPES[name]


def is_bool(dtype: Any) -> bool:
    return np.dtype(dtype).kind == "b"


def in_memory(dtype: Any) -> str:
    """A single number in memory, where a bool takes a byte."""
    return "i8" if is_bool(dtype) else type_of(dtype)


def bytes_of(dtype: Any) -> int:
    return np.dtype(dtype).itemsize


def vector(width: int, kind: str) -> str:
    """So many numbers side by side; one number where the width is 0."""
    return f"<{width} x {kind}>" if width else kind


def literal(number: Any) -> str:
    """A NumPy number."""
    if number.dtype == bool:
        return "true" if number else "false"
    if number.dtype == np.float32:  # LLVM writes a float as the double that is equal to it
        return f"0x{np.float64(number).view(np.uint64):016X}"
    return str(int(number))


def every(width: int, kind: str, number: str) -> str:
    """A literal in all lanes."""
    return f"splat ({kind} {number})" if width else number
