"""How long an experiment will take, from what was measured on this machine: before it begins, and on the way."""

import logging

import pytest

import jaxrl_tab as rl
from jaxrl_tab.engine import programs, speeds
from jaxrl_tab.engine.speeds import Speed
from jaxrl_tab.experiment import plan
from jaxrl_tab.experiment.progress import seconds_left


def part_of(method="sarsa", seeds=100, **budget):
    experiment = rl.Experiment("windy-gridworld", method, seeds=seeds, **(budget or {"steps": 8000}))
    (part,) = experiment.parts().values()
    return part


SARSA = "steps of Sarsa in WindyGridworld, 70 states"


def test_a_forecast_is_blocks_times_steps_times_what_one_took():
    """130 runs are three blocks of 64. Broken once: the runs are counted, and not the blocks -> fails."""
    known = {SARSA: Speed(1e-6, 0.5)}
    assert speeds.forecast(part_of(seeds=130), known) == (pytest.approx(3 * 8000 * 1e-6 + 0.5), True)
    two_programs = part_of({"name": "n-step-sarsa", "n": [1, 4]})
    known = {"steps of NStepSarsa in WindyGridworld, 70 states": Speed(2e-6, 0.25)}
    assert speeds.forecast(two_programs, known) == (pytest.approx(2 * 2 * 8000 * 2e-6 + 2 * 0.25), True)


def test_what_was_never_run_takes_the_mean_of_what_was_counted_alike():
    """Broken once: the speeds of episodes are taken for steps -> fails."""
    known = {SARSA: Speed(1e-6, 0.1), "steps of Mine in Walk, 5 states": Speed(4e-6, 0.4)}
    known["episodes of Mine in Walk, 5 states"] = Speed(1.0, 1.0)
    seconds, is_measured = speeds.forecast(part_of("q-learning"), known)
    assert not is_measured
    assert seconds == pytest.approx(2 * 8000 * 2e-6 + 0.2)  # the geometric means
    assert speeds.forecast(part_of("q-learning", episodes=5), {SARSA: known[SARSA]}) is None
    assert (
        speeds.forecast(part_of(exact=True, steps=8000), known).is_measured is False
    )  # exact values cost, too


def test_what_is_measured_is_kept_and_read_again(programs_folder, caplog):
    """As a mean over shards; what is over at once is not. Broken once: the last shard alone counts -> fails."""
    assert speeds.read() == {}
    clock = speeds.Clock()
    clock.finished(part_of(), 64, 0.1, 0.3)
    clock.finished(part_of(), 64, 0.3, 0.0)
    clock.finished(part_of("q-learning"), 64, 0.001, 0.3)
    clock.keep()
    assert speeds.read() == {SARSA: (pytest.approx(0.4 / (2 * 8000)), pytest.approx(0.3))}
    (file,) = (path for path in programs_folder.rglob("*.program"))
    file.write_bytes(file.read_bytes()[:-1] + b"!")
    with caplog.at_level(logging.WARNING):
        assert speeds.read() == {}
    assert "is not used: it is damaged, or was not written here" in caplog.text
    for nonsense in (b"", b"[]", b'{"x": [0, 1]}', b'{"x": [1]}', b'{"x": [1, -1]}', b'{"x": [NaN, 1]}'):
        programs.note(speeds.NAME, nonsense)
        assert speeds.read() == {}


def test_a_plan_says_how_long_it_takes_when_it_was_run_before(programs_folder):
    """Broken once: the runner measures nothing -> fails."""
    experiment = rl.Experiment("windy-gridworld", ["sarsa", "q-learning"], seeds=640, steps=2000)
    before = plan.plan(experiment.parts())
    assert {x.seconds for x in before.parts.values()} == {None}
    assert before.text().count("unknown") == 3
    reports = []
    rl.run(rl.Experiment("windy-gridworld", "sarsa", seeds=640, steps=20_000), progress=reports.append)
    assert reports[0].left is None
    sarsa, q_learning = plan.plan(experiment.parts()).parts.values()
    assert sarsa.seconds > 0 and sarsa.is_measured and q_learning.seconds > 0 and not q_learning.is_measured
    assert "?: nothing like it was run here yet" in plan.plan(experiment.parts()).text()
    rl.run(rl.Experiment("windy-gridworld", "sarsa", seeds=64, steps=2000), progress=reports.append)
    assert reports[-1].left == 0
    assert next(report for report in reports if report.total == 64).left > 0  # before anything is finished


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "under 1 s"),
        (1.04, "1 s"),
        (89, "89 s"),
        (91, "1.5 min"),
        (5390, "90 min"),
        (5500, "1.5 h"),
        (129_000, "36 h"),
        (130_000, "1.5 days"),
        (1e7, "120 days"),
    ],
)
def test_times_are_said_in_one_unit(seconds, words):
    assert plan._duration(seconds) == words


def test_parts_that_have_not_begun_take_what_is_expected_of_them():
    """Broken once: the average of the others is taken -> fails."""
    runs, took = {"a": 10, "b": 4}, {"a": (5, 1.0)}
    assert seconds_left(runs, took) == pytest.approx(5 * 0.2 + 4 * 0.2)
    assert seconds_left(runs, took, {"b": 3.0, "a": 9.0}) == pytest.approx(5 * 0.2 + 4 * 3)
    assert seconds_left(runs, {}, {"b": 3.0}) is None
    assert seconds_left(runs, {}, {"a": 1.0, "b": 3.0}) == pytest.approx(10 + 12)
    assert seconds_left({"a": 0}, {}) == 0
