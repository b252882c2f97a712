"""Statistics along one dimension of a dataset, a block at a time."""

import functools
import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.core import memory
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.notebook import table

PLACES = 50  # of which a notebook shows the intervals
MEMORY = 2**22  # float64 of one intermediate result, unless all values of one place are more


Datasets = Mapping[str, xr.Dataset]  # a sweep for each method, by the name that people see


class Interval(NamedTuple):
    """An estimate from the values along a dimension, and an interval; without that dimension.

    Attributes:
        estimate: the mean, or whatever else the function says, float64; NaN where there are no values.
        low, high: bounds of the interval, float64; NaN where there are too few values for one.
        n: how many values are there, int.
    """

    estimate: xr.DataArray
    low: xr.DataArray
    high: xr.DataArray
    n: xr.DataArray

    def __repr__(self) -> str:
        estimate, low, high, n = (np.asarray(part) for part in self)
        if not estimate.ndim:
            return f"<Interval {estimate:.4g} ({low:.4g} to {high:.4g}), n = {n}>"
        places = " x ".join(f"{size} {name}" for name, size in self.estimate.sizes.items())
        numbers = estimate[~np.isnan(estimate)]
        span = f"{numbers.min():.4g} to {numbers.max():.4g}" if numbers.size else "none"
        return f"<Interval of {places}: estimates {span}>"

    def _repr_html_(self) -> str:
        parts = xr.broadcast(*self)
        estimate = parts[0]
        places = list(itertools.islice(np.ndindex(estimate.shape), PLACES))
        rows = [
            [str(estimate[name].values[i]) for name, i in zip(estimate.dims, place, strict=True)]
            + [f"{part.values[place]:.4g}" for part in parts]
            for place in places
        ]
        more = estimate.size - len(rows)
        title = f"Interval; the first {len(rows)} of {estimate.size} places" if more else "Interval"
        return table(title, [*map(str, estimate.dims), *self._fields], rows)


def along(
    x: xr.DataArray,
    dims: str | tuple[str, str],
    of: Callable[..., Sequence[np.ndarray]],
    resamples: int = 1,
    parts: int = 3,
) -> tuple[xr.DataArray, ...]:
    """The results of `of` for the values along a dimension, without the NaNs, and the number of these values.

    Where two dimensions are given, the first is of strata. `of` gets the values of each stratum, [c, n] in
    their order along the dimension, of c places elsewhere that have equally many, and returns so many
    `parts`, [c] each. It makes arrays `resamples` times as large, which bounds c: so no more than a block of
    places is in memory as float64. Where there are no values all is NaN.
    """
    within, dim = (dims[:1], dims[1]) if isinstance(dims, tuple) else ((), dims)
    check_dims(x, [*within, dim])
    others = [d for d in x.dims if d not in (*within, dim)]
    like = x.isel(dict.fromkeys((*within, dim), 0), drop=True).transpose(*others).astype(float)
    values = x.transpose(*others, *within, dim).values
    strata, shape = (values if within else values[..., None, :]), like.shape or (1,)
    results, counts = np.full((parts, like.size), np.nan), np.zeros(like.size, int)
    for some in blocks(like.size, int(np.prod(strata.shape[-2:])) * resamples):
        block = np.arange(some.start, some.stop)
        at = strata.reshape(*shape, *strata.shape[-2:])[np.unravel_index(block, shape)].astype(float)
        missing = np.isnan(at)
        if missing.any():  # moves the NaNs to the end, and keeps the others in their order
            at = np.take_along_axis(at, np.argsort(missing, axis=-1, kind="stable"), axis=-1)
        sizes = (~missing).sum(-1)
        counts[block] = sizes.sum(-1)
        # Places that have equally many values in each stratum are worked out together.
        patterns, pattern = np.unique(sizes, axis=0, return_inverse=True)
        for i, lengths in enumerate(patterns):
            if lengths.any():
                same = pattern == i
                results[:, block[same]] = of(*(at[same, k, :size] for k, size in enumerate(lengths) if size))
        memory.let_go()
    return tuple(like.copy(data=part.reshape(like.shape)) for part in (*results, counts))


def blocks(count: int, each: int) -> list[slice]:
    """`memory.blocks` of about `MEMORY` float64 or less, where there are so many for `each`."""
    return list(memory.blocks(count, each, MEMORY))


def aligned(x: xr.DataArray, y: xr.DataArray, apart: Sequence[str] = ()) -> tuple[xr.DataArray, xr.DataArray]:
    """Both, as float, with the dimensions of either but those that are kept `apart`.

    Raises InputError unless the labels of the dimensions that both have are the same.
    """
    for d in x.dims:
        if d in y.dims and not (x.sizes[d] == y.sizes[d] and np.array_equal(x[d], y[d])):
            raise InputError(
                f"what is compared must have the same labels along {d}: {x[d].values} and {y[d].values}"
            )
    return xr.broadcast(x.astype(float), y.astype(float), exclude=apart)


def check_dims(x: xr.DataArray, dims: Sequence[Hashable]) -> None:
    if not isinstance(x, xr.DataArray):
        raise InputError(f"numbers must be an xarray.DataArray, whose axes have names, not {shown(x)}")
    for d in dims:
        if not isinstance(d, str) or d not in x.dims:
            raise InputError(
                f"no dimension {shown(d)} to take the statistic over; there are {name_list(x.dims)}"
            )
        if not x.sizes[d]:
            raise InputError(f"nothing lies along the dimension {d!r}")
    if len(set(dims)) < len(dims):
        raise InputError(f"the dimensions {name_list(dims)} must be different ones")


def by_seeds(of: Callable[..., xr.DataArray]) -> Callable[..., xr.DataArray]:
    """`of(ds, ...)`, which has a number for each seed, worked out for some seeds at a time if there are many."""

    @functools.wraps(of)
    def in_blocks(ds: xr.Dataset, *arguments: Any) -> xr.DataArray:
        seeds = ds.sizes["seed"]
        some = memory.blocks(seeds, 8 * ds.episodes.size // seeds)
        parts = [of(ds.isel(seed=block), *arguments) for block in some]
        return xr.concat(parts, "seed").transpose(*parts[0].dims) if len(parts) > 1 else parts[0]

    return in_blocks


def name_list(names: Any) -> str:
    return ", ".join(str(name) for name in names) or "none"
