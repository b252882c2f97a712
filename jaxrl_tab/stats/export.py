"""Results in files, and as plain tables for other programs: pandas, CSV, Parquet.

    from jaxrl_tab import export

    datasets = export.load("runs/windy/results.nc")  # or {"sarsa": result.to_xarray()}
    export.to_pandas(datasets, per="seed")
    export.save(datasets, "windy.parquet")
    export.save(datasets, "windy.nc")  # all of it, for `load`

A table is in long form: a row for each row of the log of each seed of each setting, or for each seed. Arrays
such as the final Q are left out. A netCDF file keeps everything, and `load` reads it: also an axis with numbers and
schedules, which `to_netcdf` of a dataset cannot write.
"""

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.core import netcdf
from jaxrl_tab.core.errors import InputError, nearest
from jaxrl_tab.stats.measures import LOG, has_errors

__all__ = ["load", "save", "to_pandas"]

Datasets = xr.Dataset | Mapping[str, xr.Dataset]
Per = Literal["row", "seed"]


def load(file: Path | str) -> dict[str, xr.Dataset]:
    """The datasets in a `results.nc` by their names, "METHOD" or "ENVIRONMENT/METHOD"; read as they are used.

    Raises:
        InputError: there is no such file, or it is of another kind.
    """
    try:
        datasets = netcdf.load(file)
    except FileNotFoundError:
        raise InputError(f"there is no file {file}") from None
    except OSError as error:
        raise InputError(f"{file} cannot be read as netCDF: {error}") from None
    return {
        path.strip("/"): netcdf.numbers_again(ds)
        for path, ds in datasets.items()
        if "episodes" in ds.data_vars
    }


def to_pandas(datasets: Datasets, per: Per = "row") -> pd.DataFrame:
    """Results in long form, which all tools for tables and plots take.

    Args:
        datasets: a dataset of `SweepResult.to_xarray`, or several by their names, as in `load`.
        per: what a row of the table is.
            "row": a row of the log of one run. Columns: steps, episodes, returns, lengths and rewards, all
            sums over the row (see `log.Log`), and what was recorded, if it is a number.
            "seed": one run. The same sums over the run; `diverged`; its score (see `stats.score`), as
            `last_tenth_return`, or of prediction as `v_error`; for control `unfinished`, whether it finished
            no episode in the last tenth, so that its score is what it collected there; and `final_NAME`, what
            was recorded, at the end.

    Returns:
        A frame with the columns `environment`, `method`, every hyperparameter of any method, `seed`, and
        those above. What a method does not have is empty; in a column with numbers and schedules all are
        text.

    Raises:
        InputError: `per` is something else.
    """
    if per not in ("row", "seed"):
        raise InputError(f'per must be "row" or "seed"; {nearest(str(per), ("row", "seed"))}')
    named = {"": datasets} if isinstance(datasets, xr.Dataset) else datasets
    frames, names = [], {}
    for name, ds in named.items():
        environment, _, method = name.rpartition("/")
        constant = stats.fixed(ds)
        names |= dict.fromkeys([*stats.hyperparameters(ds), *stats.drawn(ds), *constant])
        measured = _rows(ds) if per == "row" else _runs(ds)
        axes = [*stats.hyperparameters(ds), "seed", *(["row"] if per == "row" else [])]
        frame = measured.to_dataframe(dim_order=axes).reset_index()
        labels = {
            "environment": environment or ds.attrs["environment"],
            "method": method or ds.attrs["algorithm"],
            **constant,
        }
        frames.append(frame.assign(**{key: _repeated(value, len(frame)) for key, value in labels.items()}))
    table = pd.concat(frames, ignore_index=True)
    first = ["environment", "method", *names, "seed"]
    table = table[[*first, *(column for column in table.columns if column not in first)]]
    mixed = {
        str(name): column.map(str, na_action="ignore")
        for name, column in table.items()
        if name in names and len({isinstance(value, str) for value in column.dropna()}) > 1
    }
    return table.assign(**mixed)


def save(datasets: Datasets, file: Path | str, per: Per = "row") -> Path:
    """Writes a file, replacing one that exists: the table of `to_pandas`, .csv or .parquet; or all there is, .nc.

    Args:
        datasets: a dataset of `SweepResult.to_xarray`, or several by their names, as in `load`.
        file: its ending says what it is.
        per: what a row of the table is; netCDF has no table.

    Raises:
        InputError: another ending, or Parquet is not installed; and as `to_pandas`.
    """
    file = Path(file)
    if file.suffix not in (".csv", ".parquet", ".nc"):
        raise InputError(f"the name of the file must end in .csv, .parquet or .nc, not {file.name!r}")
    if file.suffix == ".nc":
        return _save_all(datasets, file)
    if file.suffix == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        raise InputError("Parquet needs pyarrow: python -m pip install 'jaxrl-tab[parquet]'")
    table = to_pandas(datasets, per)
    if file.suffix == ".csv":
        table.to_csv(file, index=False)
    else:
        table.to_parquet(file, index=False)
    return file


def _save_all(datasets: Datasets, file: Path) -> Path:
    named = {datasets.attrs["algorithm"]: datasets} if isinstance(datasets, xr.Dataset) else datasets
    unfinished = file.with_name(f".{file.name}.unfinished")
    unfinished.unlink(missing_ok=True)
    netcdf.save_all(named, unfinished, {})
    unfinished.replace(file)
    return file


def _rows(ds: xr.Dataset) -> xr.Dataset:
    """The log, and the numbers that were recorded beside it."""
    return ds[[str(name) for name, x in ds.data_vars.items() if set(x.dims) == set(ds.steps.dims)]]


def _runs(ds: xr.Dataset) -> xr.Dataset:
    """The log summed over each run, the score, and what was recorded, at the end."""
    log = _rows(ds)
    sums = {name: log[name].sum("row", skipna=False, dtype=_wide(log[name])) for name in LOG if name in ds}
    runs = xr.Dataset(sums | {"diverged": ds.diverged})
    runs["v_error" if has_errors(ds) else "last_tenth_return"] = stats.score(ds)
    if not has_errors(ds):
        runs["unfinished"] = stats.unfinished(ds)
    ends = log.drop_vars(LOG, errors="ignore").isel(row=-1, drop=True)
    return runs.merge(ends.rename({name: f"final_{name}" for name in ends.data_vars}))


def _wide(x: xr.DataArray) -> type:
    """The type in which to add up: a long run has more steps than an int32 counts."""
    return np.int64 if x.dtype.kind == "i" else np.float64


def _repeated(value: object, times: int) -> list[object]:
    return [value] * times


def __dir__() -> list[str]:
    return __all__
