"""How many bytes a sweep needs, known from shapes before anything is compiled; and where its results go.

Two things take memory: the results, which grow with the number of runs, and the call of the compiled program,
whose size can be chosen. Results that do not fit beside a call go to files, which the operating system reads
and writes as they are looked at. So the number of runs is limited by the disk alone.
"""

import mmap
import os
import re
import shutil
import sys
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxrl_tab.core.errors import unfit

UNITS = {"B": 1} | {f"{k}B": 1000**i for i, k in enumerate("kMGT", 1)}
MEMINFO = Path("/proc/meminfo")
BLOCK = 2**24  # bytes of results that are looked at at a time, after they are computed
_MAPPED: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()  # the files of results
UNITS |= {f"{k}iB": 1024**i for i, k in enumerate("KMGT", 1)}


class Call(NamedTuple):
    """The bytes that one call of the program takes on one device.

    Blocks of lanes run one after another. The arguments and the results of a block stay in memory until the
    call ends; the memory that it works in serves the next block.

    Attributes:
        shared: what all lanes read: the environment.
        kept: the arguments and the results of one lane.
        working: what the loop of one lane carries from step to step.
    """

    shared: int
    kept: int
    working: int

    def bytes(self, lanes: int, blocks: int) -> int:
        return self.shared + lanes * (blocks * self.kept + self.working)


class Results:
    """The results of many runs: arrays with a leading axis of runs, written piece by piece.

    Where they are `on_disk`, each array is a file without a name in the temporary folder (`TMPDIR`), mapped
    into memory; it is gone when nobody holds the array any more, or with the process.

    Attributes:
        arrays: a pytree of arrays [runs, ...].
    """

    arrays: Any

    def __init__(self, like: Any, runs: int, on_disk: bool = False):
        """Makes room. `like` is a pytree of the shapes that one run gives."""
        make = self._in_a_file if on_disk else np.empty
        self.arrays = jax.tree.map(lambda x: make((runs, *x.shape), x.dtype), like)

    def write(self, runs: np.ndarray, values: Any) -> None:
        """Writes the results of these runs: `runs` int [n], `values` a pytree of arrays [n, ...].

        Where an array is smaller than the room for it, it stands at its beginning, and 0 beyond.
        """

        def put(array: np.ndarray, x: np.ndarray) -> None:
            if x.shape[1:] != array.shape[1:]:
                array[runs] = 0
            array[(runs, *map(slice, x.shape[1:]))] = x

        jax.tree.map(put, self.arrays, values)
        let_go()

    def _in_a_file(self, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        size = max(1, int(np.prod(shape)) * np.dtype(dtype).itemsize)
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):  # reserves the space, or a full disk would kill the process
                os.posix_fallocate(file.fileno(), 0, size)
            file.truncate(size)
            mapped = mmap.mmap(file.fileno(), size)
        _MAPPED.add(mapped)
        return np.ndarray(shape, dtype, buffer=mapped)


def blocks(count: int, each: int, most: int = BLOCK) -> Iterator[slice]:
    """Slices of about equal length that cover `count` items of `each` bytes: about `most` bytes or less."""
    number = max(1, min(count, -(-count * each // most)))
    size, larger = divmod(count, number)
    first = 0
    for i in range(number):
        last = first + size + (i < larger)
        yield slice(first, last)
        let_go()
        first = last


def let_go() -> None:
    """Frees the memory that reading results in files took; what is needed again is read again."""
    if _MAPPED and hasattr(mmap, "MADV_DONTNEED"):
        for file in list(_MAPPED):
            file.madvise(mmap.MADV_DONTNEED)


def size(tree: Any) -> int:
    """The bytes of arrays of the shapes and dtypes of a pytree."""
    return sum(int(np.prod(x.shape)) * x.dtype.itemsize for x in jax.tree.leaves(tree))


def free(devices: Sequence[Any] = ()) -> int:
    """The bytes that are free on each of these devices; on a CPU, or without any, in the machine.

    A device that does not tell has no limit.
    """
    if devices and devices[0].platform != "cpu":
        stats = [device.memory_stats() or {} for device in devices]
        return min(s.get("bytes_limit", sys.maxsize) - s.get("bytes_in_use", 0) for s in stats)
    return _free_on_linux() or _free_anywhere()


def _free_on_linux() -> int:
    """What Linux says is available, without psutil, whose import takes a sixth of a second start; 0 where it does not.

    In some containers there seems to be more than there is in all; psutil knows better what to do with that.
    """
    try:
        numbers = dict(re.findall(r"^(\w+): *(\d+) kB", MEMINFO.read_text(), re.MULTILINE))
    except OSError:
        return 0
    available, total = (1024 * int(numbers.get(name, 0)) for name in ("MemAvailable", "MemTotal"))
    return available if available <= total else 0


def _free_anywhere() -> int:
    import psutil  # here, so that a second start need not wait for it

    return psutil.virtual_memory().available


def disk() -> tuple[str, int]:
    """The temporary folder, and the bytes that are free in it."""
    folder = tempfile.gettempdir()
    return folder, shutil.disk_usage(folder).free


def words(count: int) -> str:
    """A number of bytes as people read it: three digits and a unit."""
    unit = max((u for u in ("B", "kB", "MB", "GB", "TB") if UNITS[u] <= max(count, 1)), key=UNITS.__getitem__)
    return f"{count / UNITS[unit]:.3g} {unit}"


def parse(text: str) -> int:
    """The bytes that a text such as "4GB" or "1.5 GiB" stands for. Raises InputError where it is none."""
    match = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([a-z]+)", text.strip(), re.IGNORECASE)
    units = {unit.lower(): factor for unit, factor in UNITS.items()}
    count = int(float(match[1]) * units.get(match[2].lower(), 0)) if match else 0
    if count < 1:
        raise unfit(None, "memory", f"a number with a unit ({', '.join(UNITS)}), such as 4GB", text)
    return count
