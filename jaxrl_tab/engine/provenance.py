"""What the bits of a result depend on beside the experiment: settings of JAX, versions, sources, the processor.

Two processes give the same numbers only where all of this is the same. `using` makes the settings so; what no
running process can change is compared by `differences`.
"""

import contextlib
import enum
import hashlib
import json
import os
import platform
import re
import subprocess
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import backend
from jaxrl_tab.lanes import machine

PACKAGE = Path(__file__).parent.parent
UNOPTIMISED = "jax_disable_most_optimizations"
SETTINGS = (
    "jax_enable_x64",
    "jax_default_prng_impl",
    "jax_random_seed_offset",
    "jax_threefry_partitionable",
    "jax_high_dynamic_range_gumbel",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_optimization_level",
    UNOPTIMISED,
)
BACKEND = "backend"  # the name of that setting which is not JAX's
# It says how many devices the CPU is, and no number depends on that.
_DEVICE_COUNT = "--xla_force_host_platform_device_count"
# Of all that a processor can do, what XLA's arithmetic may be compiled to: on x86, and on ARM.
_ARITHMETIC = re.compile(r"s?sse\w+|avx\w*|fma\w*|f16c|amx\w*|fp\w*hp|asimd\w*|sve\w*|sme2?|bf16|i8mm")
# What XLA leaves out of it where it is told to: by this, processors of several generations are made alike.
_MOST = re.compile(r"--xla_cpu_max_isa=(\w+)")
_ABOVE = {
    "SSE4_2": r"avx\w*|fma\w*|f16c|amx\w*",
    "AVX": r"avx\w+|fma\w*|amx\w*",
    "AVX2": r"avx(?!2$)\w+|amx\w*",
}


def settings() -> dict[str, Any]:
    """The settings that change numbers, JAX's and the backend, as they are in this thread: name -> plain value."""
    values = {name: getattr(jax.config, name) for name in SETTINGS if hasattr(jax.config, name)}
    values[UNOPTIMISED] = jax.config.read(UNOPTIMISED)  # of which JAX makes no attribute
    values[BACKEND] = backend.chosen()
    return {name: x.value if isinstance(x, enum.Enum) else x for name, x in values.items()}


@contextlib.contextmanager
def using(chosen: Mapping[str, Any]) -> Iterator[None]:
    """Makes these `settings` within the block, and gives JAX its own back afterwards.

    Raises:
        InputError: JAX does not take one of them, or a block such as `jax.enable_x64` is stronger.
    """
    chosen = dict(chosen)
    compiled_by = chosen.pop(BACKEND, backend.chosen())
    # A new thread sees the settings of the process, without those of a block such as `jax.enable_x64`.
    with ThreadPoolExecutor(1) as elsewhere:
        before = elsewhere.submit(lambda: jax.config.values).result()
    try:
        for name, value in chosen.items():
            try:
                jax.config.update(name, value)
            except (ValueError, TypeError) as error:
                raise InputError(f"JAX cannot be given {name} = {value!r}: {error}") from None
            if settings().get(name, value) != value:
                raise InputError(
                    f"{name} must be {value!r}, and is set otherwise by a block of JAX around this"
                )
        with backend.preferring(compiled_by):
            yield
    finally:
        for name in chosen:
            jax.config.update(name, before[name])


def set_for_good(chosen: Mapping[str, Any]) -> None:
    """Makes these `settings` in this process."""
    for name, value in chosen.items():
        if name == BACKEND:
            backend.prefer(value)
        else:
            jax.config.update(name, value)


def installed() -> dict[str, Any]:
    """The versions of the packages that compute, and the digest of this one's sources."""
    names = ("jaxrl_tab", "jax", "jaxlib", "numpy", "optax")
    return {name: metadata.version(name) for name in names} | {"digest of jaxrl_tab's sources": sources()}


def surroundings(libraries: Mapping[str, str] = MappingProxyType({})) -> dict[str, Any]:
    """All that numbers depend on beside the experiment: name -> plain value. It starts JAX's backend.

    Args:
        libraries: the versions of those from which its environments come.
    """
    device = jax.local_devices()[0]
    flags = [x for x in os.environ.get("XLA_FLAGS", "").split() if not x.startswith(_DEVICE_COUNT)]
    return {
        **installed(),
        **libraries,
        **settings(),
        "LLVM": machine.version() if backend.chosen() == "lanes" else "",
        "XLA_FLAGS": " ".join(flags),
        "device": f"{device.platform} {device.device_kind}",
        "instruction set": instructions() if device.platform == "cpu" else "",
    }


def digest(surroundings: Mapping[str, Any]) -> str:
    """A name for surroundings: the same for the same."""
    return hashlib.sha256(json.dumps(surroundings, sort_keys=True).encode()).hexdigest()[:16]


def differences(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What of `now` was different before, a line for each. `was` may be what an earlier version recorded."""
    return [_change(name, was.get(name), value) for name, value in now.items() if was.get(name) != value]


def _change(name: str, before: Any, after: Any) -> str:
    if not isinstance(before, str):
        return f"{name} was {'not recorded' if before is None else before}, and is {after}"
    # Of several words, such as the flags of XLA, only those that differ.
    gone, new = (
        " ".join(x for x in a.split() if x not in b.split()) for a, b in ((before, after), (after, before))
    )
    if not gone:
        return f"{name} was without {new}, and is with it"
    return f"{name} was {gone}, and is {new}" if new else f"{name} was with {gone}, and is without"


@cache
def sources() -> str:
    """The digest of this package's sources, as they were when it was first asked for."""
    digest = hashlib.sha256()
    for folder, folders, names in os.walk(PACKAGE):  # twice as fast as by `Path`: each start does it
        folders.sort()
        for file in (os.path.join(folder, name) for name in sorted(names) if name.endswith(".py")):
            with open(file, "rb") as opened:
                data = opened.read()
            place = file.removeprefix(f"{PACKAGE}{os.sep}").replace(os.sep, "/")
            digest.update(f"{place} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:16]


@cache
def cpu(line: str) -> str:
    """What Linux tells of the CPU in a line of this name, a regular expression; nothing where it does not."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text()
        if match := re.search(rf"^(?:{line})[ \t]*:(.*)", lines, re.MULTILINE):
            return match[1].strip()
    return ""


def features() -> list[str]:
    """All that the CPU says it can do."""
    return cpu("flags|Features").split()


def is_left_out(feature: str) -> bool:
    """Whether XLA is told not to use what a processor can do, by the name that Linux has for it."""
    most = _MOST.search(os.environ.get("XLA_FLAGS", ""))
    return bool(most and re.fullmatch(_ABOVE.get(most[1].upper(), ""), feature))


def instructions() -> str:
    """The kind of the CPU, and what of its instructions the numbers may depend on."""
    used = (x for x in features() if _ARITHMETIC.fullmatch(x) and not is_left_out(x))
    return " ".join([platform.machine(), *sorted(used)])


@cache
def git_commit() -> str | None:
    """The commit that this package's sources are of, with "-dirty" where something was changed; else None."""
    git = ["git", "-C", str(PACKAGE)]
    describe = [*git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:  # in somebody else's repository, as in an environment below it, these files are not git's
        for command in ([*git, "ls-files", "--error-unmatch", "__init__.py"], describe):
            answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer
