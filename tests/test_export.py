"""Results as tables: every number is in its row, and comes back from the files."""

import importlib.util
import pickle
import sys

import h5netcdf
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from made_up import ALPHAS, make_result

import jaxrl_tab as rl
from jaxrl_tab import export, stats


@pytest.fixture(scope="module")
def result(windy):
    return make_result(windy, np.zeros((70, 4)))


@pytest.fixture(scope="module")
def two(result):
    """A method that swept alpha, and one that kept it; one of them with something recorded."""
    sarsa = result.to_xarray()
    value = np.arange(300.0).reshape(3, 5, 20)
    sarsa = sarsa.assign(
        greedy_value=(sarsa.steps.dims, value),
        policy=((*sarsa.steps.dims, "state"), np.ones((*value.shape, 70))),
    )
    kept = sarsa.isel(alpha=0, drop=True).drop_vars(["greedy_value", "policy"])
    kept = kept.assign_attrs(algorithm="q-lambda", fixed='{"alpha": "glie", "epsilon": 0.1, "lam": 0.9}')
    return {"windy/sarsa": sarsa, "windy/q-lambda": kept}


def test_a_row_of_the_table_is_a_row_of_the_log(result):
    table = result.to_pandas()
    assert list(table.columns) == [
        *("environment", "method", "alpha", "epsilon", "gamma", "seed", "row"),
        *("steps", "episodes", "returns", "lengths", "rewards"),
    ]
    assert len(table) == result.log.steps.size
    assert set(table.method) == {"sarsa"}
    assert set(table.environment) == {"windy-gridworld"}
    (one,) = table.query("alpha == 0.2 and seed == 3 and row == 11").to_dict("records")
    for name in ("steps", "episodes", "returns", "lengths", "rewards"):
        assert one[name] == getattr(result.log, name)[1, 3, 11]


def test_a_row_for_each_seed_has_sums_and_scores(two):
    table = export.to_pandas(two, per="seed")
    assert len(table) == 3 * 5 + 5
    ds = two["windy/sarsa"]
    one = table.query("method == 'sarsa' and alpha == '0.9' and seed == 4").iloc[0]
    at = ds.sel(alpha=0.9, seed=4)
    assert one.steps == at.steps.sum()
    assert one.returns == pytest.approx(float(at.returns.astype(float).sum()))
    assert one.last_tenth_return == stats.score(ds).sel(alpha=0.9, seed=4)
    assert one.final_greedy_value == at.greedy_value[-1]
    assert "policy" not in table.columns  # an array is no cell
    other = table.query("method == 'q-lambda'")
    assert set(other.alpha) == {"glie"}
    assert set(other.lam) == {0.9}
    assert other.final_greedy_value.isna().all()
    assert table.query("method == 'sarsa'").lam.isna().all()


def test_the_score_of_prediction_is_its_error(two):
    """Broken once: the axes in another order than those of the result -> fails."""
    ds = two["windy/sarsa"].rename(greedy_value="v_error").assign_attrs(learns="states")
    table = export.to_pandas({"td": ds}, per="seed")
    assert "last_tenth_return" not in table.columns
    assert table.v_error.tolist() == stats.score(ds).values.ravel().tolist()
    assert table.final_v_error.tolist() == ds.v_error[..., -1].values.ravel().tolist()
    assert set(table.environment) == {"windy-gridworld"}  # where the name does not say


def test_steps_are_counted_beyond_an_int32(two):
    ds = two["windy/sarsa"].copy(deep=True)
    ds["steps"][...] = 2**30
    assert set(export.to_pandas(ds, per="seed").steps) == {20 * 2**30}


def test_what_was_drawn_has_its_columns(result):
    ds = result.to_xarray().rename(alpha="draw").drop_vars("draw")
    ds = ds.assign_coords(draw=[0, 1, 2], alpha=("draw", [*ALPHAS]))
    table = export.to_pandas(ds)
    assert list(table.columns[2:6]) == ["draw", "alpha", "epsilon", "gamma"]
    assert set(zip(table.draw, table.alpha, strict=True)) == set(enumerate(ALPHAS))


@pytest.mark.parametrize("per", ["row", "seed"])
def test_files_hold_the_table(two, tmp_path, per):
    table = export.to_pandas(two, per)
    parquet = pd.read_parquet(export.save(two, tmp_path / "t.parquet", per))
    pd.testing.assert_frame_equal(parquet, table, check_dtype=False)
    csv = pd.read_csv(export.save(two, tmp_path / "t.csv", per))
    np.testing.assert_allclose(csv.returns, table.returns.astype(float), rtol=1e-7)
    assert list(csv.columns) == list(table.columns)
    assert csv.alpha.tolist() == table.alpha.tolist()


def test_a_file_of_a_sweep_is_read_by_names(two, tmp_path):
    file = tmp_path / "results.nc"
    xr.DataTree.from_dict(two).to_netcdf(file, engine="h5netcdf")
    loaded = export.load(file)
    assert list(loaded) == list(two)
    pd.testing.assert_frame_equal(export.to_pandas(loaded, "seed"), export.to_pandas(two, "seed"))


def test_many_datasets_are_written_and_read_with_one_look_at_the_file(two, tmp_path, monkeypatch):
    """Hundreds of groups took minutes. Broken once: opened for each group, names that are searched -> fails."""
    opened, searched = [], []
    start, search = h5netcdf.File.__init__, h5netcdf.Variable._lookup_dimensions

    def count(self, *args, **kwargs):
        opened.append(args)
        start(self, *args, **kwargs)

    monkeypatch.setattr(h5netcdf.File, "__init__", count)
    many = {f"{name}-{i}": ds for i in range(3) for name, ds in two.items()}
    file = export.save(many, tmp_path / "many.nc")
    assert len(opened) == 2  # to make it, and to fill it
    monkeypatch.setattr(
        h5netcdf.Variable, "_lookup_dimensions", lambda self: searched.append(self.name) or search(self)
    )
    loaded = export.load(file)
    assert len(opened) == 3 and not [
        x for x in searched if x.rpartition("/")[2] in two["windy/sarsa"].data_vars
    ]
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        for name, ds in many.items():
            xr.testing.assert_identical(loaded[name], tree[name].to_dataset())
            xr.testing.assert_identical(loaded[name], ds)
    assert pickle.loads(pickle.dumps(loaded)).keys() == many.keys()


def test_what_is_wrong_is_said_in_a_line(two, tmp_path, monkeypatch):
    with pytest.raises(rl.InputError, match=r"must end in \.csv, \.parquet or \.nc, not 't\.xlsx'"):
        export.save(two, tmp_path / "t.xlsx")
    with pytest.raises(rl.InputError, match='per must be "row" or "seed"'):
        export.to_pandas(two, "seeds")  # pyright: ignore[reportArgumentType]
    with pytest.raises(rl.InputError, match="there is no file"):
        export.load(tmp_path / "results.nc")
    (tmp_path / "other.nc").write_text("text")
    with pytest.raises(rl.InputError, match=r"other\.nc cannot be read as netCDF"):
        export.load(tmp_path / "other.nc")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(rl.InputError, match=r"pip install 'jaxrl-tab\[parquet\]'"):
        export.save(two, tmp_path / "t.parquet")
    assert [file.name for file in tmp_path.iterdir()] == ["other.nc"]
