"""How long an experiment will take, from what was measured on this machine: before it begins, and on the way."""

import json
import logging

import pytest

import jaxrl_tab as rl
from jaxrl_tab.engine import programs, speeds
from jaxrl_tab.engine.speeds import Known, Speed
from jaxrl_tab.experiment import plan
from jaxrl_tab.experiment.progress import seconds_left


def part_of(method="sarsa", seeds=100, **budget):
    experiment = rl.Experiment("windy-gridworld", method, seeds=seeds, **(budget or {"steps": 8000}))
    (part,) = experiment.parts().values()
    return part


SARSA = "steps of Sarsa in WindyGridworld, 70 states"


def test_a_forecast_is_blocks_times_steps_times_what_one_took():
    """130 runs are three blocks of 64. Broken once: the runs are counted, and not the blocks; or a program that was

    made before as one that is compiled -> each fails.
    """
    known = Known({SARSA: Speed(1e-6, 0.5, 0.1)})
    assert speeds.forecast(part_of(seeds=130), known) == (pytest.approx(3 * 8000 * 1e-6 + 0.5), True)
    two = part_of({"name": "n-step-sarsa", "n": [1, 4]})
    known = Known({"steps of NStepSarsa in WindyGridworld, 70 states": Speed(2e-6, 0.25, 0.05)})
    running = 2 * 2 * 8000 * 2e-6
    assert speeds.forecast(two, known) == (pytest.approx(running + 2 * 0.25), True)
    known = known._replace(programs=(two.needs[1].program, "another"))
    assert speeds.forecast(two, known) == (pytest.approx(running + 0.25 + 0.05), True)


def test_programs_have_names_of_their_own():
    """With other values of a hyperparameter it is the same program. Broken once: no budget in it -> fails."""
    name = lambda *method, **budget: part_of(*method, **budget).needs[0].program
    same = name(), name(seeds=7), name({"name": "sarsa", "alpha": 0.25})
    others = name("q-learning"), name(steps=80), name(episodes=8), name(steps=8000, log_every=50)
    assert len(set(same)) == 1 and len({same[0], *others}) == 5


def test_what_was_never_run_takes_the_mean_of_what_was_counted_alike():
    """Broken once: the speeds of episodes are taken for steps -> fails."""
    of_steps = {SARSA: Speed(1e-6, 0.1, 0.01), "steps of Mine in Walk, 5 states": Speed(4e-6, 0.4, 0.04)}
    known = Known(of_steps | {"episodes of Mine in Walk, 5 states": Speed(1.0, 1.0, 1.0)})
    seconds, is_measured = speeds.forecast(part_of("q-learning"), known)
    assert not is_measured
    assert seconds == pytest.approx(2 * 8000 * 2e-6 + 0.2)  # the geometric means
    assert speeds.forecast(part_of("q-learning", episodes=5), Known(of_steps)) is None
    assert (
        speeds.forecast(part_of(exact=True, steps=8000), known).is_measured is False
    )  # exact values cost, too


def test_what_is_measured_is_kept_and_read_again(programs_folder, caplog):
    """As a mean over shards; what is over at once is not. Broken once: the last shard alone counts -> fails."""
    assert speeds.read() == Known()
    clock = speeds.Clock()
    clock.finished(part_of(), 0, 64, 0.1, 0.3)
    clock.finished(part_of(), 0, 64, 0.3, 0.0)
    clock.finished(part_of("q-learning"), 0, 64, 0.001, 0.3)
    clock.keep()
    running = pytest.approx(0.4 / (2 * 8000))
    assert speeds.read().speeds == {SARSA: (running, pytest.approx(0.3), pytest.approx(0.06))}
    assert speeds.read().programs == tuple(part_of(x).needs[0].program for x in ("sarsa", "q-learning"))
    clock = speeds.Clock()  # in a later process: the program is kept, and what it took to make it is, too
    clock.finished(part_of(), 0, 64, 0.2, 0.05)
    clock.keep()
    assert speeds.read().speeds == {SARSA: (running, pytest.approx(0.3), pytest.approx(0.05))}
    (file,) = (path for path in programs_folder.rglob("*.program"))
    file.write_bytes(file.read_bytes()[:-1] + b"!")
    with caplog.at_level(logging.WARNING):
        assert speeds.read() == Known()
    assert "is not used: it is damaged, or was not written here" in caplog.text
    of = lambda *speed: json.dumps({"speeds": {"x": speed}, "programs": []}).encode()
    wrong = [of(0, 1, 1), of(1), of(1, -1, 1), of(1, 1, float("nan")), b'{"speeds": {}}', b'{"x": [1, 1, 1]}']
    for nonsense in (b"", b"[]", b'{"speeds": [], "programs": []}', *wrong):
        programs.note(speeds.NAME, nonsense)
        assert speeds.read() == Known()


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
