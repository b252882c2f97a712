"""How many seeds a comparison takes, from a pilot: the power that is asked is the power that there is."""

import json

import numpy as np
import pytest
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import stats
from jaxrl_tab.cli import main
from jaxrl_tab.stats import pilot

RNG = np.random.default_rng(0)
POPULATIONS = {"normal": RNG.standard_normal(20_000), "skewed": -RNG.exponential(size=20_000)}


def per_seed(x):
    return xr.DataArray(x, dims="seed")


def power(x, n, difference, trials):
    """How often `paired_difference` finds that x - y, drawn anew, is as much above 0."""
    drawn = np.random.default_rng(1).choice(x - x.mean() + difference, (trials, n))
    d = xr.DataArray(drawn, dims=("experiment", "seed"))
    return float((stats.paired_difference(d, xr.zeros_like(d)).interval.low > 0).mean())


def test_of_normal_scores_it_is_what_the_formula_says(monkeypatch):
    monkeypatch.setattr(pilot, "EXPERIMENTS", 1000)
    x = per_seed(POPULATIONS["normal"])
    n = stats.seeds_from_pilot(x, xr.zeros_like(x), 0.8)
    assert n == pytest.approx(stats.seeds_needed(0.8, float(x.std())), abs=2)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "difference"), [("normal", 0.3), ("skewed", 0.4)])
def test_the_power_asked_is_the_power_there_is(name, difference):
    """Broken once: by the formula for normal values, of skewed ones -> fails."""
    x = POPULATIONS[name]
    n = stats.seeds_from_pilot(per_seed(x), per_seed(np.zeros(len(x))), difference)
    assert power(x, n, difference, 10_000) == pytest.approx(0.9, abs=0.01)


def test_where_no_number_is_enough_it_says_so(monkeypatch):
    monkeypatch.setattr(pilot, "EXPERIMENTS", 10)
    monkeypatch.setattr(pilot, "LARGEST", 100)
    x = per_seed(POPULATIONS["normal"])
    assert stats.seeds_from_pilot(x, xr.zeros_like(x), 1e-6) == 100


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"difference": 0}, "difference must be a number other than 0"),
        ({"power": 1}, "power must be greater than 0 and less than 1"),
        ({"x": per_seed([1.0])}, "a pilot has scores of two methods on the same seeds"),
        ({"x": per_seed([np.nan, 1.0, np.nan])}, "two seeds or more at which neither method diverged"),
    ],
)
def test_wrong_arguments(change, message):
    given = {"x": per_seed([1.0, 2.0, 3.0]), "y": per_seed([1.0, 2.0, 2.0]), "difference": 1.0}
    with pytest.raises(rl.InputError, match=message):
        stats.seeds_from_pilot(**(given | change))


def test_the_command_tells_it_of_a_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pilot, "EXPERIMENTS", 200)
    datasets = {}
    for name, mean in (("a", -20.0), ("b", -22.0)):
        x = mean + RNG.standard_normal((40, 1))
        fields = {
            "returns": x,
            "rewards": x,
            "steps": np.full(x.shape, 800),
            "lengths": np.full(x.shape, 800),
        }
        fields |= {"episodes": np.ones(x.shape, int)}
        about = {"num_steps": 800, "log_every": 800, "environment": "a-task"}
        datasets[name] = xr.Dataset(
            {key: (("seed", "row"), value) for key, value in fields.items()}, {"seed": np.arange(40)}, about
        )
    xr.DataTree.from_dict(datasets).to_netcdf(tmp_path / "results.nc", engine="h5netcdf")
    assert main(["seeds", str(tmp_path), "--difference", "1", "--json"]) == 0
    (pair,) = json.loads(capsys.readouterr().out)["pairs"]
    assert pair["methods"] == ["a", "b"] and pair["environment"] == "a-task" and pair["pilot"] == 40
    assert pair["seeds"] == pytest.approx(stats.seeds_needed(1, pair["sd"]), rel=0.3)
    assert main(["seeds", str(tmp_path), "--difference", "1"]) == 0
    assert "up to 7.5% of all runs may be stuck, which 40 seeds need not show" in " ".join(
        capsys.readouterr().out.split()
    )


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("nowhere --difference 1", "there is no finished sweep in nowhere: neither fresh.nc nor results.nc"),
        ("nowhere", "give --difference: the least difference of mean scores that should be seen"),
        ("", "name the folder of a sweep"),
        ("nowhere --difference 0", "difference must be greater than 0, not 0"),
    ],
)
def test_what_is_typed_wrongly_is_refused(capsys, typed, message):
    assert main(["seeds", *typed.split()]) == 2
    assert message in capsys.readouterr().err
