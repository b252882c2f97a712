"""A tiny experiment in a folder, for the tests that damage folders and make calls of the system fail."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
import quick
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import plot, report
from jaxrl_tab.experiment import shards

EXPERIMENT = rl.Experiment("windy-gridworld", {"name": "sarsa", "alpha": [0.25, 0.5]}, seeds=40, steps=20)


@contextlib.contextmanager
def small():
    """Shards of 64 runs, of which there are two; pictures and report that take no time."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(shards, "SHARD_STEPS", 64 * 20)
        patched.setattr(plot, "save_all", quick.picture)
        patched.setattr(
            report, "write_methods", lambda folder, *_: (folder / "report.html").write_text("a report")
        )
        shards._shards.cache_clear()
        yield
    shards._shards.cache_clear()


def numbers(folder: Path) -> dict[str, np.ndarray]:
    """All numbers of the runs in a finished folder."""
    with xr.open_dataset(folder / "results.nc", engine="h5netcdf", group="sarsa") as ds:
        return {str(key): x.values for key, x in ds.variables.items()}


def check_the_same(folder: Path, expected: dict[str, np.ndarray]) -> None:
    found = numbers(folder)
    assert found.keys() == expected.keys()
    for key, x in found.items():
        assert x.dtype == expected[key].dtype and x.tobytes() == expected[key].tobytes(), key
