"""Datasets in netCDF files, also those that xarray alone cannot write, or only with much memory."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxrl_tab.core import memory
from jaxrl_tab.core.schedules import typed

if TYPE_CHECKING:
    import xarray as xr

CHUNK = 2**20  # bytes of the pieces in which a file holds a large variable
MIXED = "numbers_beside_texts"  # marks an axis in a file on which both are written as texts


def save(ds: "xr.Dataset", group: str, file: Path, about: Mapping[str, Any]) -> None:
    """Adds a dataset to a netCDF file, as a group. Where there is no file it is made, with attributes."""
    import xarray as xr

    if not file.exists():
        xr.Dataset(attrs=about).to_netcdf(file, engine="h5netcdf")
    ds = _as_texts(ds)
    # xarray encodes bool in a way of its own, which it alone reads again.
    large = [name for name, x in ds.items() if x.nbytes > memory.BLOCK and x.dtype != bool]
    rest = ds.drop_vars(large)
    encoding = {name: {"zlib": True, "complevel": 1, "shuffle": True} for name, x in rest.items() if x.ndim}
    rest.to_netcdf(file, mode="a", group=group, engine="h5netcdf", encoding=encoding)
    for name in large:
        _save_large(ds[name], file, group)


def _as_texts(ds: "xr.Dataset") -> "xr.Dataset":
    """The dataset as a file can hold it: where an axis has numbers beside texts, all are as typed, "0.1", "glie"."""
    mixed = {name: x for name, x in ds.coords.items() if x.dtype == object}
    text = lambda value: value if isinstance(value, str) else str(typed(value))
    return ds.assign_coords(
        {name: (x.dims, [text(value) for value in x.values], {MIXED: 1}) for name, x in mixed.items()}
    )


def numbers_again(ds: "xr.Dataset") -> "xr.Dataset":
    """The dataset of such a file as it was: a number on an axis with texts is a number."""
    mixed = {name: x for name, x in ds.coords.items() if MIXED in x.attrs}
    again = {
        name: np.array([_number_again(text) for text in x.values.tolist()], object)
        for name, x in mixed.items()
    }
    return ds.assign_coords({name: (mixed[name].dims, x) for name, x in again.items()})


def _number_again(text: str) -> Any:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _save_large(x: "xr.DataArray", file: Path, group: str) -> None:
    """Adds a variable [*hyperparameters, seed, ...] of numbers to a group, some seeds at a time."""
    import h5netcdf

    before, seeds = x.dims.index("seed"), x.sizes["seed"]
    # The bytes of one seed in one setting.
    each = max(1, x.nbytes // (x.size // int(np.prod(x.shape[before + 1 :], dtype=int))))
    with h5netcdf.File(file, "a") as whole:
        to = whole[group]
        for dim, size in x.sizes.items():
            if dim not in to.dimensions:
                to.dimensions[dim] = size
        chunks = (*(1,) * before, min(seeds, max(1, CHUNK // each)), *x.shape[before + 1 :])
        missing = np.nan if x.dtype.kind == "f" else None
        packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "chunks": chunks}
        variable = to.create_variable(x.name, x.dims, x.dtype, fillvalue=missing, **packed)
        # As xarray writes it, or what was drawn would be no coordinate when the file is read.
        if drawn := [str(name) for name in x.coords if name not in x.dims]:
            variable.attrs["coordinates"] = " ".join(drawn)
        for setting in np.ndindex(x.shape[:before]):
            for block in memory.blocks(seeds, each):
                variable[*setting, block] = x.values[*setting, block]
