"""The published figures: their numbers come out, and a number that is off is seen."""

import dataclasses
import json

import numpy as np
import pytest
import xarray as xr

from jaxrl_tab.cli import main
from jaxrl_tab.figures import FIGURES, Number


def number(measured, expected, standard_error):
    return Number("a number", expected, standard_error, lambda env, datasets: measured)


@pytest.mark.parametrize(
    ("measured", "expected", "standard_error", "apart"),
    [
        ([1.0, 3.0], 5.0, 0.0, 3.0),  # mean 2, its standard error sqrt(2) / sqrt(2) = 1
        ([1.0, 3.0], -1.0, 0.0, 3.0),
        ([1.0, 3.0], 2 + 5 * 1.25, 0.75, 5.0),  # both errors count: sqrt(1 + 0.5625) = 1.25
        (-15.0, -15.0, 1e-6, 0.0),
        (-20.70774, -20.7077, 5e-5, 0.8),
    ],
)
def test_distances_are_in_standard_errors_of_the_difference(measured, expected, standard_error, apart):
    check = number(np.array(measured), expected, standard_error).check(None, {})
    assert check.apart == pytest.approx(apart)
    assert check.ok == (apart <= 4)


def test_a_number_that_is_not_there_is_off():
    assert not number(np.array([1.0, np.nan]), 1.0, 1.0).check(None, {}).ok


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seeds"), [("windy-gridworld", 200), ("cliff-walking", 100)])
def test_the_numbers_of_the_figure_come_out(name, seeds, monkeypatch, tmp_path, capsys):
    """Within three standard errors of those in GROUND_TRUTH, at this seed; the program itself allows four."""
    figure = FIGURES[name]
    assert figure.budget["num_seeds"] >= seeds
    fewer = dataclasses.replace(figure, budget={**figure.budget, "num_seeds": seeds})
    monkeypatch.setitem(FIGURES, name, fewer)
    out = tmp_path / "figure"
    assert main(["figure", name, "--json", "--out", str(out)]) == 0
    found = json.loads(capsys.readouterr().out)["numbers"]
    assert len(found) == len(figure.numbers)
    assert all(n["ok"] and n["apart"] < 3 for n in found)
    assert {file.name for file in out.iterdir()} == {"results.nc", f"{name}.png"}
    assert set(xr.open_datatree(out / "results.nc").children) == set(figure.methods)


def test_the_expected_numbers_are_those_known():
    """They are the point of the figures: a change of one is a change of what is claimed."""
    windy, cliff = ([(n.expected, n.standard_error) for n in f.numbers] for f in FIGURES.values())
    assert windy == [(160.15, 0.1), (-15, 1e-6), (7, 1e-6)]
    assert cliff == [(-26.79, 0.1), (-49.94, 0.11), (-13, 1e-6), (-20.7077, 5e-5)]


def test_the_exit_code_says_that_a_number_is_off(monkeypatch, capsys):
    figure = FIGURES["windy-gridworld"]
    wrong = dataclasses.replace(
        figure,
        budget={"num_seeds": 4, "num_steps": 50},
        numbers=(Number("episodes", 160.15, 0.1, figure.numbers[0].measure), figure.numbers[1]),
    )
    monkeypatch.setitem(FIGURES, "windy-gridworld", wrong)
    assert main(["figure", "windy-gridworld"]) == 1
    table = capsys.readouterr().out.splitlines()
    (bad,) = [line for line in table if "│ episodes" in line]
    (good,) = [line for line in table if "│ optimal value" in line]
    assert "off" in bad
    assert "off" not in good
