"""How schedules and policies are typed on the command line, handed on, and shown."""

import json

import pytest
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import policies, schedules
from jaxrl_tab.cli import main
from jaxrl_tab.cli import typed as options
from jaxrl_tab.cli.common import HYPERPARAMETERS
from jaxrl_tab.cli.options import whole_number
from jaxrl_tab.core.policies import UCB, EpsilonGreedy, Greedy, Softmax, Table


def typed(option, token, method="expected-sarsa"):
    found = options.values([method], {option: (token,)}, HYPERPARAMETERS)[method]
    (value,) = found[option.removeprefix("--")]
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


@pytest.mark.parametrize(("text", "number"), [("1e4", 10_000), ("12", 12), ("2.5e1", 25), ("-1e0", -1)])
def test_whole_numbers_may_have_an_exponent(text, number):
    """Broken once: read as int alone -> fails."""
    assert whole_number(text) == number and type(whole_number(text)) is int


@pytest.mark.parametrize("text", ["1.5", "1e-3", "1e400", "nan", "1e17", "four"])
def test_what_is_no_whole_number_is_none(text):
    """1e17 + 1 would be the same number."""
    with pytest.raises((ValueError, OverflowError)):
        whole_number(text)


def test_numbers_are_still_numbers():
    assert typed("--epsilon", "0.5") == 0.5


@pytest.mark.parametrize(
    ("option", "token", "message"),
    [
        (
            "--epsilon",
            "small",
            "--epsilon: 'small' is neither a number nor a schedule; a schedule is one of glie, sample-average, ",
        ),
        (
            "--epsilon",
            "harmonic:-1",
            "where CLOCK is one of step, episode, visit: no clock stands at its end",
        ),
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
        ("--alpha", "power:0:visit", "--alpha: power must be greater than 0, not 0.0"),
        ("--gamma", "harmonic:100:visit", "--gamma takes a number, not 'harmonic:100:visit'"),
    ],
)
def test_what_is_no_schedule_is_refused_with_what_would_be(option, token, message):
    with pytest.raises(rl.InputError) as error:
        typed(option, token)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_method_whose_own_step_size_is_a_schedule_takes_numbers_and_schedules():
    """Broken once: its default was no number, so the token stayed text -> fails."""
    assert typed("--alpha", "0.5", "monte-carlo") == 0.5
    assert str(typed("--alpha", "power:0.8:visit", "monte-carlo")) == "power:0.8:1:visit"
    assert options.values(["monte-carlo"], {}, HYPERPARAMETERS) == {"monte-carlo": {}}  # no grid of numbers
    assert len(options.values(["sarsa"], {}, HYPERPARAMETERS)["sarsa"]["alpha"]) > 1


# --- policies ----------------------------------------------------------------------------------------

POLICIES = {
    "greedy": Greedy(),
    "epsilon-greedy:0.05": EpsilonGreedy(0.05),
    "epsilon-greedy:glie": EpsilonGreedy(schedules.glie()),
    "softmax:0.5": Softmax(0.5),
    "softmax:harmonic:10:episode": Softmax(schedules.Harmonic(10.0, clock="episode")),
    "ucb:2": UCB(2.0),
}


@pytest.mark.parametrize("text", POLICIES)
@pytest.mark.parametrize("option", ["--behaviour", "--target"])
def test_every_policy_is_typed_as_it_is_written(option, text):
    assert repr(typed(option, text)) == repr(POLICIES[text])
    assert str(POLICIES[text]) == text


def test_the_number_of_a_policy_may_be_left_off_and_its_name_have_underscores():
    assert repr(typed("--behaviour", "epsilon_greedy")) == repr(EpsilonGreedy())
    assert {str(policies.parse(name)).partition(":")[0] for name in policies.POLICIES} == {*policies.POLICIES}


@pytest.mark.parametrize(
    ("token", "message"),
    [
        ("sofmax:0.5", "--behaviour: there is no policy 'sofmax:0.5'; did you mean 'softmax'?"),
        ("0.5", "there is no policy '0.5'; choose one of greedy, epsilon-greedy, softmax, ucb"),
        ("greedy:1", "'greedy:1' is not of the form greedy"),
        ("softmax:", "is not of the form softmax[:TEMPERATURE], where TEMPERATURE is a number or a schedule"),
        (
            "softmax::",
            "is not of the form softmax[:TEMPERATURE], where TEMPERATURE is a number or a schedule",
        ),
        ("softmax:powr:1:step", "there is no schedule 'powr:1:step'; did you mean 'power'?"),
        ("softmax:0", "temperature must be greater than 0, not 0.0"),
        ("ucb:glie", "'ucb:glie' is not of the form ucb[:C], where C is a number"),
        ("epsilon-greedy:2", "epsilon must be between 0 and 1, not 2.0"),
    ],
)
def test_what_is_no_policy_is_refused_with_what_would_be(token, message):
    with pytest.raises(rl.InputError) as error:
        typed("--behaviour", token)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_tables_have_short_names_that_tell_them_apart():
    names = [str(Table([[p, 1 - p]] * 50)) for p in (0.5, 0.25)]
    assert all(name.startswith("table 50x2:") and len(name) < 25 for name in names)
    assert names[0] != names[1] and names[0] == str(Table([[0.5, 0.5]] * 50))
    assert "available 1x2:" in str(EpsilonGreedy(0.1, [[True, False]]))


def test_an_option_goes_to_all_methods_that_have_it():
    found = options.values(["td", "n-step-td"], {"--n": ("1", "4"), "--alpha": ("0.5",)}, HYPERPARAMETERS)
    assert found == {"td": {"alpha": [0.5]}, "n-step-td": {"alpha": [0.5], "n": [1, 4]}}
    with pytest.raises(
        rl.InputError,
        match=r"none of td, sarsa has --n, which belongs to n-step-sarsa, .*, n-step-td, .*-n-step-td$",
    ):
        options.values(["td", "sarsa"], {"--n": ("1",)}, HYPERPARAMETERS)
    with pytest.raises(
        rl.InputError,
        match=r"td has no --q0, which belongs to the methods of control that learn values; td has --a",
    ):
        options.values(["td"], {"--q0": ("1",)}, HYPERPARAMETERS)


# --- what is shown -----------------------------------------------------------------------------------


def test_help_says_how_a_schedule_is_typed(capsys):
    with pytest.raises(SystemExit):
        main(["sweep", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for name in schedules.NAMES:
        assert schedules.form(name) in text
    assert "where CLOCK is one of step, episode, visit" in text
    assert text.count("A schedule is one of glie, sample-average,") == 1  # the environment takes none
    for name in policies.POLICIES:
        assert policies.form(name) in text
    assert "--q0 X [X ...] Initial value of every entry of Q" in text
    assert (
        "above the true values it is optimistic (book, section 2.6). (of the methods of control that learn values"
        in text
    )
    assert "--n N [N ...] How many rewards it looks ahead. A whole number of at least 1." in text
    assert "(of n-step-sarsa, n-step-expected-sarsa, n-step-off-policy-sarsa, tree-backup, q-sigma," in text
    assert "n-step-td, n-step-off-policy-td, semi-gradient-n-step-td; default: 4)" in text
    assert "default: 0.05 0.1 0.2 0.3 0.5 0.7 1; sample-average for monte-carlo," in text
    assert "None" not in text
    assert "--pi" not in text  # a table cannot be typed


@pytest.mark.slow
def test_data_and_table_show_a_schedule_as_it_is_typed(tmp_path, capsys):
    """Broken once: rich without emoji=False -> "harmonic", then a picture for :100: -> fails."""
    command = "sweep random-walk sarsa --alpha power:0.5:2:visit --epsilon harmonic:100:visit --seeds 2"
    assert main([*command.split(), "--steps", "200", "--out", str(tmp_path / "walk")]) == 0
    assert "alpha power:0.5:2:visit, epsilon harmonic:100:visit" in capsys.readouterr().out
    ds = xr.open_datatree(tmp_path / "walk" / "results.nc")["sarsa"].to_dataset()
    fixed = json.loads(ds.attrs["fixed"])
    assert (fixed["alpha"], fixed["epsilon"]) == ("power:0.5:2:visit", "harmonic:100:visit")
