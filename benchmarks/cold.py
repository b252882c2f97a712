"""The README's sweep as a person starts it: a fresh process, with its compilation cache empty, then filled.

JAX's own variable says where the cache is, as for any program. The basis is what cannot be spared: a fresh
process that imports jax, matplotlib and xarray, plus the seconds that the command of the same round, with the
filled cache, spent on the steps themselves, by its own account.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py

from benchmarks.rounds import Round, Timing

SWEEP = ("sweep", "windy-gridworld", "sarsa", "q-learning", "expected-sarsa", "--quiet")
ROOT = Path(__file__).parent.parent
SCRATCH = tempfile.TemporaryDirectory()  # of this process; each round has a folder of its own in it


def with_empty_cache() -> Round:
    return lambda number: _sweep(number, "first")


def with_filled_cache() -> Round:
    """To be run after the round of the empty cache, which fills it."""
    return lambda number: _sweep(number, "again")


def imports_and_steps() -> Round:
    """To be run after the round of the filled cache, which says what the steps took."""

    def run(number: int) -> Timing:
        seconds = _seconds("-c", "import jax, matplotlib, xarray")
        with h5py.File(folder(number) / "again" / "results.nc") as data:
            return Timing(seconds + sum(method.attrs["seconds"].item() for method in data.values()))

    return run


def _sweep(number: int, out: str) -> Timing:
    cache, out_folder = folder(number) / "cache", folder(number) / out
    command = ["-m", "jaxrl_tab", *SWEEP, "--out", str(out_folder)]
    return Timing(_seconds(*command, JAX_COMPILATION_CACHE_DIR=str(cache)))


def _seconds(*arguments: str, **variables: str) -> float:
    """How long a fresh Python takes, from its start to its end."""
    begun = time.perf_counter()
    subprocess.run([sys.executable, *arguments], cwd=ROOT, env=os.environ | variables, check=True)
    return time.perf_counter() - begun


def folder(number: int) -> Path:
    return Path(SCRATCH.name) / str(number)
