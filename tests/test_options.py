"""How schedules are typed on the command line, handed on, and shown."""

import json

import pytest
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import options, schedules
from jaxrl_tab.algorithms import ALGORITHMS
from jaxrl_tab.cli import main
from jaxrl_tab.options import Group

METHODS = Group(ALGORITHMS, "Of the methods.", grids=True)


def typed(option, token):
    ((value,),) = options.values("sarsa", {option: (token,)}, METHODS).values()
    return value


@pytest.mark.parametrize(
    ("token", "schedule"),
    [
        ("glie", schedules.glie()),
        ("sample_average", schedules.sample_average()),
        ("harmonic:100:visit", schedules.Harmonic(100.0)),
        ("power:0.75:step", schedules.Power(0.75, clock="step")),
        ("linear:1:0.05:500:episode", schedules.Linear(1.0, 0.05, 500.0)),
        ("exponential:1:0.99:0.01:step", schedules.Exponential(1.0, 0.99, 0.01, clock="step")),
    ],
)
@pytest.mark.parametrize("option", ["--alpha", "--epsilon"])
def test_every_family_can_be_typed(option, token, schedule):
    assert repr(typed(option, token)) == repr(schedule)


def test_numbers_are_still_numbers():
    assert typed("--epsilon", "0.5") == 0.5


@pytest.mark.parametrize(
    ("option", "token", "message"),
    [
        ("--epsilon", "small", "--epsilon takes a number or a schedule (glie, sample-average, power[:POWER"),
        (
            "--epsilon",
            "harmonic",
            "--epsilon: 'harmonic' is not of the form harmonic[:N0]:CLOCK, where CLOCK",
        ),
        (
            "--epsilon",
            "harmonic:ten:visit",
            "--epsilon: 'harmonic:ten:visit' is not of the form harmonic[:N0]",
        ),
        (
            "--alpha",
            "linear:1:0:step",
            "is not of the form linear:START:END:STEPS:CLOCK, where CLOCK is one of",
        ),
        ("--alpha", "powr:1:visit", "--alpha: there is no schedule 'powr:1:visit'; did you mean 'power'?"),
        ("--alpha", "power:0:visit", "--alpha: Power: power must be a positive number, not 0.0"),
        ("--gamma", "harmonic:100:visit", "--gamma takes a number, not 'harmonic:100:visit'"),
    ],
)
def test_what_is_no_schedule_is_refused_with_what_would_be(option, token, message):
    with pytest.raises(rl.InputError) as error:
        typed(option, token)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_help_says_how_a_schedule_is_typed(capsys):
    with pytest.raises(SystemExit):
        main(["sweep", "--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name in schedules.FAMILIES:
        assert schedules.form(name) in text
    assert "where CLOCK is one of step, episode, visit" in text
    assert text.count("A schedule is one of glie, sample-average,") == 1  # the environment takes none


def test_data_and_table_show_a_schedule_as_it_is_typed(tmp_path, capsys):
    """Broken once: rich without emoji=False -> "harmonic", then a picture for :100: -> fails."""
    command = "sweep random-walk sarsa --alpha power:0.5:2:visit --epsilon harmonic:100:visit --seeds 2"
    assert main([*command.split(), "--steps", "200", "--out", str(tmp_path / "walk")]) == 0
    assert "alpha power:0.5:2:visit, epsilon harmonic:100:visit" in capsys.readouterr().out
    ds = xr.open_datatree(tmp_path / "walk" / "results.nc")["sarsa"].to_dataset()
    fixed = json.loads(ds.attrs["fixed"])
    assert (fixed["alpha"], fixed["epsilon"]) == ("power:0.5:2:visit", "harmonic:100:visit")
