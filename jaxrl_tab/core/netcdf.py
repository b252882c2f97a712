"""Datasets in netCDF files, also those that xarray alone cannot write, or only with much memory."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxrl_tab.core import memory
from jaxrl_tab.core.schedules import typed

if TYPE_CHECKING:
    import h5netcdf
    import xarray as xr

CHUNK = 2**20  # bytes of the pieces in which a file holds a large variable
MIXED = "numbers_beside_texts"  # marks an axis in a file on which both are written as texts


def save(ds: "xr.Dataset", group: str, file: Path, about: Mapping[str, Any]) -> None:
    """Adds a dataset to a netCDF file, as a group. Where there is no file it is made, with attributes."""
    save_all({group: ds}, file, about)


def save_all(datasets: "Mapping[str, xr.Dataset]", file: Path, about: Mapping[str, Any]) -> None:
    """Adds datasets to a netCDF file, each as the group of its name; where there is none it is made, with attributes.

    All of them at once, for to open a file takes the longer the more groups there are in it.
    """
    import h5netcdf
    import xarray as xr

    if not file.exists():
        xr.Dataset(attrs=about).to_netcdf(file, engine="h5netcdf")
    with h5netcdf.File(file, "a") as whole:
        for group, ds in datasets.items():
            _save(_as_texts(ds), whole.create_group(group))


def load(file: Path | str) -> "dict[str, xr.Dataset]":
    """The datasets in all groups of a netCDF file, by their paths, read as they are used: see `numbers_again`.

    As `xr.open_datatree`, which takes minutes for hundreds of groups.

    Raises:
        OSError: there is no such file, or it is no netCDF.
    """
    import h5netcdf
    import h5py
    import xarray as xr
    from xarray.backends import CachingFileManager, H5NetCDFStore

    manager = CachingFileManager(h5netcdf.File, str(file), mode="r")
    with manager.acquire_context() as whole, h5py.File(file) as beside:
        datasets = {}
        for group in _groups(whole):
            _tell_dimensions(group, beside[group.name])
            datasets[group.name] = xr.open_dataset(H5NetCDFStore(manager, group=group.name))
    return {node.path: node.to_dataset() for node in xr.DataTree.from_dict(datasets).subtree}


def _groups(group: "h5netcdf.Group") -> "Iterator[h5netcdf.Group]":
    """A group, and those in it."""
    yield group
    for inner in group.groups.values():
        yield from _groups(inner)


def _tell_dimensions(group: "h5netcdf.Group", beside: Any) -> None:
    """Tells h5netcdf the dimensions of the variables in a group.

    In the file are references to them, whose names HDF5 would search in all of it, for each variable anew.
    """
    names = {beside[name]: name for name in group.dimensions if name in beside}
    for name, variable in group.variables.items():
        references = beside[name].attrs.get("DIMENSION_LIST", ()) if name in beside else ()
        dimensions = [names.get(beside[x[-1]]) if len(x) else None for x in references]
        if dimensions and None not in dimensions:
            variable._dimensions = tuple(dimensions)  # where it would keep them that it found


def _save(ds: "xr.Dataset", to: "h5netcdf.Group") -> None:
    """Writes a dataset into an empty group of an open file."""
    from xarray.backends import H5NetCDFStore

    # xarray encodes bool in a way of its own, which it alone reads again.
    large = [name for name, x in ds.items() if x.nbytes > memory.BLOCK and x.dtype != bool]
    rest = ds.drop_vars(large)
    encoding = {name: {"zlib": True, "complevel": 1, "shuffle": True} for name, x in rest.items() if x.ndim}
    rest.compute().dump_to_store(H5NetCDFStore(to, mode="a"), encoding=encoding)
    for name in large:
        _save_large(ds[name], to)


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


def _save_large(x: "xr.DataArray", to: "h5netcdf.Group") -> None:
    """Adds a variable [*hyperparameters, seed, ...] of numbers to a group, some seeds at a time."""
    before, seeds = x.dims.index("seed"), x.sizes["seed"]
    # The bytes of one seed in one setting.
    each = max(1, x.nbytes // (x.size // int(np.prod(x.shape[before + 1 :], dtype=int))))
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
