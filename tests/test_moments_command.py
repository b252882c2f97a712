"""`jaxrl-tab moments`: it says, writes and draws what `rl.moments` works out."""

import csv
import json

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

import jaxrl_tab as rl
from jaxrl_tab.algorithms.moments import best_alpha, learning_curve
from jaxrl_tab.algorithms.prediction import TD, NStepTD, TDLambda
from jaxrl_tab.cli import main, moments
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.show import plot
from jaxrl_tab.show.exact_curves import MOST, PARTS

WALK = rl.make("random-walk", states=5, left_reward=0.0)
TASK = ("moments", "random-walk", "n-step-td", "--states", "5", "--left-reward", "0", "--v0", "0.5")
GRID = {"alpha": [0.4, 0.1, 1.0], "n": [1, 2]}
TYPED = ("--alpha", "0.4", "0.1", "1", "--n", "1", "2", "--episodes", "20")


@pytest.fixture(scope="module")
def curve():
    return learning_curve(WALK, NStepTD(v0=0.5), num_episodes=20, **GRID)


def test_it_prints_the_numbers_of_the_library(curve, capsys):
    """Broken once: the variance in place of the squared bias; the star at the largest error -> fails."""
    assert main([*TASK, *TYPED]) == 0
    out = capsys.readouterr().out
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    assert [line[:2] for line in lines] == [[alpha, n] for alpha in ("0.4", "0.1", "1") for n in ("1", "2")]
    shown = np.array([[float(cell.removesuffix(" *")) for cell in line[2:]] for line in lines]).reshape(
        3, 2, 4
    )
    last = (part[..., -1] for part in (curve.mse, curve.squared_bias, curve.variance))
    np.testing.assert_allclose(shown, np.stack([curve.mse[..., 2], *last], -1), rtol=6e-4)
    assert [line[3].endswith(" *") for line in lines] == [
        x == curve.mse[..., -1].min() for x in curve.mse[..., -1].ravel()
    ]
    assert "over 5 states: exact, without runs. Before the first episode it is 0.05556." in " ".join(
        out.split()
    )
    assert main([*TASK, *TYPED, "--whole-run"]) == 0
    out = capsys.readouterr().out
    (starred,) = [line for line in out.splitlines() if " *" in line and "│" in line]
    mean = curve.mse[..., 1:].mean(-1)
    i, k = np.unravel_index(mean.argmin(), mean.shape)
    cells = [cell.strip() for cell in starred.split("│")[1:-1]]
    assert [float(cells[0]), int(cells[1])] == [GRID["alpha"][i], GRID["n"][k]]
    assert float(cells[-1].removesuffix(" *")) == pytest.approx(mean.min(), rel=6e-4)


def test_in_a_narrow_window_columns_go_and_no_number_is_cut_off(curve, capsys, monkeypatch):
    """Broken once: all columns in 40 characters -> "0.05…"."""
    monkeypatch.setattr(moments, "console", lambda: Console(highlight=False, width=40))
    assert main([*TASK, *TYPED, "--whole-run"]) == 0
    out = capsys.readouterr().out
    assert "…" not in out and f"{curve.mse[0, 0, 1:].mean():.4g}" in out
    assert "wider window the table has: error after episode 2; of which squared bias; variance" in (
        " ".join(out.split())
    )


def test_the_best_alpha_and_what_programs_read(curve, capsys):
    assert main([*TASK, *TYPED, "--best", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["grid"] == GRID
    assert data["fixed"] == {"gamma": 1.0, "v0": 0.5}
    for part in PARTS:
        np.testing.assert_allclose(data[part], getattr(curve, part), rtol=1e-12)
    best = [{"n": n} | best_alpha(WALK, NStepTD(n=n, v0=0.5), num_episodes=20)._asdict() for n in (1, 2)]
    assert data["best"] == best
    assert main([*TASK, *TYPED, "--best"]) == 0
    rows = [line.split("│")[1:-1] for line in capsys.readouterr().out.partition("best alpha")[2].splitlines()]
    shown = [[float(cell) for cell in row] for row in rows if len(row) == 3]
    np.testing.assert_allclose(shown, [[*row.values()] for row in best], rtol=6e-4)


def test_what_grows_without_bound_is_told(capsys):
    """JSON has no infinite numbers."""
    huge = ("moments", "random-walk", "td", "--states", "5", "--alpha", "1.5", "--episodes", "1")
    assert main([*huge]) == 0
    assert "inf" in capsys.readouterr().out
    assert main([*huge, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mse"][1] is None


def test_the_folder_has_all_numbers(curve, tmp_path, capsys):
    out = tmp_path / "exact"
    assert main([*TASK, *TYPED, "--out", str(out)]) == 0
    assert {file.name for file in out.iterdir()} == {"moments.csv", "moments.nc", "moments.png"}
    with (out / "moments.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["alpha", "n", "episode", *PARTS]
    for part in PARTS:
        of_part = np.array([float(row[part]) for row in rows]).reshape(3, 2, 21)
        np.testing.assert_allclose(of_part, getattr(curve, part), rtol=1e-12)
    with xr.open_dataset(out / "moments.nc", engine="h5netcdf") as saved:
        np.testing.assert_array_equal(saved.covariance, curve.covariance)
        assert saved.attrs["method"] == "n-step-td"


def lines(ax):
    return [np.asarray(line.get_ydata(), float) for line in ax.get_lines()]


def test_the_picture_shows_the_best_alpha_of_each_n(curve):
    """Broken once: the curves of the first alpha -> fails."""
    axes = plot.exact_curves(curve, "mine").axes
    at = curve.mse[..., -1].argmin(0)
    for ax, part in zip(axes, PARTS, strict=False):
        for k, y in enumerate(lines(ax)):
            expected = getattr(curve, part)[at[k], k, 1:]
            np.testing.assert_array_equal(y, np.where(expected > 0, expected, np.nan))
    assert axes[0].get_legend().get_texts()[0].get_text() == f"α = {GRID['alpha'][at[0]]:g}, n = 1"
    np.testing.assert_array_equal(lines(axes[3]), curve.mse[[1, 0, 2], :, -1].T)  # in the order of alpha


def test_the_picture_of_alpha_alone_has_the_parts_of_the_error():
    """The largest error leaves the scale; of many settings some are drawn, the first and the last among them."""
    alphas = np.linspace(0.05, 1.4, 15).tolist()
    curve = learning_curve(WALK, TDLambda(v0=0.5, offline=True), num_episodes=4, alpha=alphas[::-1])
    axes = plot.exact_curves(curve, "mine").axes
    assert len(axes[0].get_lines()) == MOST
    labels = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert (labels[0].partition(" (")[0], labels[-1]) == ("α = 1.4", "α = 0.05")
    for y, part in zip(lines(axes[3]), PARTS, strict=True):
        of_part = getattr(curve, part)[::-1, -1]
        np.testing.assert_array_equal(y, np.where(np.isfinite(of_part) & (of_part > 0), of_part, np.nan))
    assert axes[0].get_ylim()[1] < 20 * curve.mse[0, 0]
    alone = plot.exact_curves(learning_curve(WALK, TD(v0=0.5, alpha=0.1), num_episodes=2), "mine").axes
    assert not alone[3].axison


@pytest.mark.parametrize("alpha", [[], [0.1, 0.1]])
def test_a_grid_has_values_that_are_different(alpha):
    with pytest.raises(
        InputError, match="alpha must be a number, or a list of some that are different, not "
    ):
        learning_curve(WALK, TD(), num_episodes=1, alpha=alpha)
