"""On what the benchmark runs, for the table and the record.

It is read here and not by `jaxrl_tab`, the import of which would set flags of XLA for all parties, and so for
naive JAX.
"""

import contextlib
import importlib.metadata
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PACKAGES = ("jaxrl-tab", "jax", "jaxlib", "numba", "llvmlite", "numpy")
# By what Linux calls them, the widest first.
VECTORS = {"avx512f": "AVX-512 (512 bits)", "avx2": "AVX2 (256 bits)", "asimd": "NEON (128 bits)"}
NUMBERS = ("cpu family", "model")


def settings() -> dict[str, Any]:
    """The machine, for the record."""
    return {"cpu": processor(), "cores": os.cpu_count(), "system": platform.platform()}


def processor() -> str:
    """Its model and how wide its vectors are, in words."""
    cpu = _cpu()
    return f"{model(cpu)}, {vectors(cpu)}"


def model(cpu: Mapping[str, str]) -> str:
    """What the processor is called, and its numbers: clouds call several generations by one name."""
    name = cpu.get("model name") or platform.processor() or platform.machine()
    numbers = [f"{number} {cpu[number]}" for number in NUMBERS if number in cpu]
    return f"{name} ({', '.join(numbers)})" if numbers else name


def vectors(cpu: Mapping[str, str]) -> str:
    """The widest vectors that the processor has."""
    features = {*cpu.get("flags", "").split(), *cpu.get("Features", "").split()}  # on x86, and on ARM
    return next(
        (name for feature, name in VECTORS.items() if feature in features), "vectors of unknown width"
    )


def _cpu() -> dict[str, str]:
    """What Linux tells of the first CPU: name -> text; nothing where there is no Linux."""
    cpu: dict[str, str] = {}
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            name, _, text = line.partition(":")
            cpu.setdefault(name.strip(), text.strip())
    return cpu


def versions() -> dict[str, str]:
    """Of Python and of the packages that are there."""
    installed = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            installed[name] = importlib.metadata.version(name)
    return installed
