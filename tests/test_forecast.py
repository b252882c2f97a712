"""How long an experiment will take, from what was measured on this machine: before it begins, and on the way."""

import json
import logging

import pytest

import jaxrl_tab as rl
from jaxrl_tab.cli import main
from jaxrl_tab.core import memory
from jaxrl_tab.engine import backend, programs, speeds, typical
from jaxrl_tab.engine.part import compute
from jaxrl_tab.engine.speeds import Known, Speed
from jaxrl_tab.experiment import plan, shards
from jaxrl_tab.experiment.progress import seconds_left


def part_of(method="sarsa", seeds=100, env="windy-gridworld", **budget):
    experiment = rl.Experiment(env, method, seeds=seeds, **(budget or {"steps": 8000}))
    (part,) = experiment.parts().values()
    return part


SARSA = "Sarsa by steps by lanes in WindyGridworld, 70 states"
LONG = 1e9  # seconds: so long a measurement leaves no room for what is usual


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(speeds, "threads", lambda: 2)
    monkeypatch.setattr(speeds, "LONGEST", LONG)


def test_a_forecast_is_runs_times_what_is_usual_times_what_one_took():
    """130 runs are 80 on each of two cores, in groups of 16. Broken once: runs are not shared by the cores; or a

    program that was made before as one that is compiled -> each fails.
    """
    usual = typical.typical(part_of())
    known = Known({SARSA: Speed(2.0, 3.0, 0.5, LONG)})
    found = speeds.forecast(part_of(seeds=130), known)
    assert found == (pytest.approx(80 * 2 * usual.running + 3 * usual.compiling), True)
    two = part_of({"name": "n-step-sarsa", "n": [1, 4]})
    usual = typical.typical(two)
    known = Known({"NStepSarsa by steps by lanes in WindyGridworld, 70 states": Speed(2.0, 3.0, 0.5, LONG)})
    running = 2 * 64 * 2 * usual.running
    assert speeds.forecast(two, known) == (pytest.approx(running + 2 * 3 * usual.compiling), True)
    known = known._replace(programs=(two.needs[1].program, "another"))
    ready = 3 * usual.compiling + 0.5 * usual.starting
    assert speeds.forecast(two, known) == (pytest.approx(running + ready), True)


def test_what_is_usual_grows_with_what_is_done():
    """Broken once, each: entries of tables, rows, exact values, the backend do not count."""
    of = lambda *method, **budget: typical.typical(part_of(*method, **budget)).running
    assert of(steps=16_000) == pytest.approx(2 * of())
    assert of() < of("double-q-learning") < of("n-step-sarsa") < of("monte-carlo") < of("sarsa-lambda")
    assert of(steps=8000, log_every=1) > 3 * of() and of(steps=8000, exact=True) > 50 * of()
    assert (
        of("td-lambda", env="random-walk", steps=8000) < of("td-lambda", steps=8000) / 2
    )  # 21 states, or 70
    before = of()
    with backend.using("xla"):
        assert of() > 4 * before
    assert typical.typical(part_of(steps=8000, exact=True)).compiling > typical.typical(part_of()).compiling


def test_psrl_takes_as_long_as_its_models():
    """It took 2.7 times as long as was said where they are many. Broken once: episodes do not count -> fails."""
    of = lambda env, **more: typical.typical(part_of({"name": "psrl", **more}, env=env)).running
    one = of("river-swim")
    assert of("river-swim", sweeps=200, every=200.0) == pytest.approx(one, rel=0.05)
    many, few = of("frozen-lake", samples=5), of("frozen-lake", sweeps=50)
    assert many == pytest.approx(5 * of("frozen-lake"), rel=0.05) == pytest.approx(10 * few, rel=0.1)
    assert (
        of("finite-horizon:20:river-swim") > 100 * one
    )  # 20 times as many states, and five times as many models


@pytest.mark.parametrize(
    ("env", "method"),
    [
        ("random-walk", "td"),
        ("cliff-walking", "q-learning"),
        ("windy-gridworld", "sarsa"),
        ("blackjack", "monte-carlo"),
    ],
)
def test_the_length_of_episodes_is_foreseen_within_a_factor_of_two(env, method):
    """Broken once: the policy that is learned, or the one at first, for the whole run -> fails."""
    part = part_of(method, seeds=64, env=env, episodes=200)
    steps = compute(part).log.steps.sum() / (64 * 200)
    assert 0.5 < typical.episode_steps(part) / steps < 2


def test_of_episodes_of_which_nothing_is_known_a_length_is_assumed(monkeypatch):
    monkeypatch.setattr(typical, "OUTCOMES", 10)
    assert typical.episode_steps.__wrapped__(part_of(episodes=5)) == typical.EPISODE_STEPS


def test_programs_have_names_of_their_own():
    """With other values of a hyperparameter it is the same program. Broken once: no budget in it -> fails."""
    name = lambda *method, **budget: part_of(*method, **budget).needs[0].program
    same = name(), name(seeds=7), name({"name": "sarsa", "alpha": 0.25})
    others = name("q-learning"), name(steps=80), name(episodes=8), name(steps=8000, log_every=50)
    assert len(set(same)) == 1 and len({same[0], *others}) == 5


def test_what_was_never_run_is_judged_by_others():
    """The more by those that are like it, and that took long. Broken once, each: all count alike -> fails."""
    usual = typical.typical(part_of("q-learning"))
    foreseen = lambda known: speeds.forecast(part_of("q-learning"), Known(known)).seconds
    expected = lambda pace: pytest.approx(pace * (64 * usual.running + usual.compiling))
    of = lambda pace, seconds: Speed(pace, pace, pace, seconds)
    assert foreseen({}) == expected(1)
    assert foreseen({"Mine by steps by lanes in Walk, 5 states": of(4, speeds.SURE)}) == expected(2)
    near, far = SARSA, "Mine by steps by lanes in Walk, 5 states"
    assert foreseen({near: of(2, LONG), far: of(64, LONG)}) == expected(4)
    assert foreseen({near: of(2, LONG), far: of(64, 0.001)}) == expected(2)
    own = "QLearning by steps by lanes in WindyGridworld, 70 states"
    assert foreseen({own: of(4, speeds.SURE)}) == expected(2)  # a short measurement
    assert foreseen({own: of(4, LONG), near: of(2, LONG)}) == expected(4)
    short = speeds.forecast(part_of("q-learning"), Known({own: of(4, speeds.SURE / 2)}))
    assert not short.is_measured
    assert speeds.forecast(part_of(exact=True, steps=8000), Known({SARSA: of(4, LONG)})).is_measured is False


def test_on_another_kind_of_device_nothing_is_usual(monkeypatch):
    monkeypatch.setattr(speeds.jax, "default_backend", lambda: "gpu")
    assert speeds.forecast(part_of(), Known()) is None
    assert speeds.forecast(part_of(), Known({SARSA: Speed(1.0, 1.0, 1.0, 5.0)})).seconds > 0


def test_what_is_measured_is_kept_and_read_again(programs_folder, caplog):
    """As a mean over shards; what is over at once is not. Broken once: the last shard alone counts -> fails."""
    assert speeds.read() == Known()
    usual = typical.typical(part_of())
    clock = speeds.Clock()
    clock.finished(part_of(), 0, 64, 0.1, 0.3)
    clock.finished(part_of(), 0, 64, 0.3, 0.0)
    clock.finished(part_of("q-learning"), 0, 64, 0.001, 0.3)
    clock.keep()
    running, compiling = pytest.approx(0.4 / (2 * 32 * usual.running)), pytest.approx(0.3 / usual.compiling)
    assert speeds.read().speeds == {SARSA: (running, compiling, 1.0, 0.4)}
    assert speeds.read().programs == tuple(part_of(x).needs[0].program for x in ("sarsa", "q-learning"))
    clock = speeds.Clock()  # in a later process: the program is kept, and what it took to make it is, too
    clock.finished(part_of(), 0, 64, 0.2, 0.05)
    clock.keep()
    starting = pytest.approx(0.05 / usual.starting)
    assert speeds.read().speeds == {SARSA: (running, compiling, starting, 0.2)}
    (file,) = (path for path in programs_folder.rglob("*.program"))
    file.write_bytes(file.read_bytes()[:-1] + b"!")
    with caplog.at_level(logging.WARNING):
        assert speeds.read() == Known()
    assert "is not used: it is damaged, or was not written here" in caplog.text
    of = lambda *speed: json.dumps({"speeds": {"x": speed}, "programs": []}).encode()
    nan = float("nan")
    wrong = [
        of(0, 1, 1, 1),
        of(1, 1, 1),
        of(1, -1, 1, 1),
        of(1, 1, nan, 1),
        b'{"speeds": {}}',
        b'{"x": [1, 1, 1, 1]}',
    ]
    for nonsense in (b"", b"[]", b'{"speeds": [], "programs": []}', *wrong):
        programs.note(speeds.NAME, nonsense)
        assert speeds.read() == Known()


def test_a_plan_says_how_long_it_takes(programs_folder):
    """Broken once: the runner measures nothing; what is being run has no forecast -> each fails."""
    experiment = rl.Experiment("windy-gridworld", ["sarsa", "q-learning"], seeds=640, steps=2000)
    before = plan.plan(experiment.parts())
    assert not any(x.is_measured for x in before.parts.values())
    assert before.text().count(" about ") == 3 and "it may take twice as long, or half" in before.text()
    reports = []
    rl.run(rl.Experiment("windy-gridworld", "sarsa", seeds=640, steps=200_000), progress=reports.append)
    assert reports[0].left > 0 and reports[-1].left == 0
    sarsa, q_learning = plan.plan(experiment.parts()).parts.values()
    assert sarsa.seconds > 0 and sarsa.is_measured and q_learning.seconds > 0 and not q_learning.is_measured


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.02, "under 0.1 s"),
        (0.212, "0.21 s"),
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
    """Corrected as what is finished was off. Broken once: the average of the others is taken -> fails."""
    runs, took = {"a": 10, "b": 4}, {"a": (5, 1.0)}
    assert seconds_left(runs, took) == pytest.approx(5 * 0.2 + 4 * 0.2)
    assert seconds_left(runs, took, {"b": 3.0}) == pytest.approx(5 * 0.2 + 4 * 3)
    off = (1 + 100) / (1 + 5 * 4)  # a second of what was expected counts, too
    assert seconds_left(runs, {"a": (5, 100.0)}, {"b": 3.0, "a": 4.0}) == pytest.approx(5 * 20 + off * 4 * 3)
    assert seconds_left(runs, {}, {"b": 3.0}) is None
    assert seconds_left(runs, {}, {"a": 1.0, "b": 3.0}) == pytest.approx(10 + 12)
    assert seconds_left({"a": 0}, {}) == 0


# --- on workers elsewhere -------------------------------------------------------------------------------


def job_of(seeds):
    return shards.Job.of(rl.Experiment("windy-gridworld", "sarsa", seeds=seeds, steps=2**20), None, {})


def test_workers_take_one_shard_after_another(monkeypatch):
    """Shards of 128 runs: ten on four workers are three in turn.

    Broken once, each: shared out in equal parts; cores do not count; a program is made once for all workers, or for
    each shard -> fails.
    """
    monkeypatch.setattr(speeds, "read", lambda: Known({SARSA: Speed(2.0, 3.0, 0.5, LONG)}))
    job = job_of(1280)
    usual = typical.typical(job.parts["windy-gridworld/sarsa"])
    of_shard, ready = 128 * 2 * usual.running, 3 * usual.compiling
    found = plan.on_workers(job, workers=4, cores=1)
    assert found.shards == 10 and found.busy == 4
    assert found.seconds == pytest.approx(plan.STARTING + ready + 3 * of_shard)
    assert found.computing == pytest.approx(10 / 4 * of_shard)
    assert plan.on_workers(job, 4, 2).seconds == pytest.approx(plan.STARTING + ready + 3 * of_shard / 2)
    assert (
        plan.on_workers(job, 64, 1)
        .text()
        .endswith("there are shards for 10 workers only: more have nothing to do")
    )
    needs = job.parts["windy-gridworld/sarsa"].needs[0]
    assert found.writing == pytest.approx(10 * 0.002 + 1280 * memory.size(needs.results) / 3e8)
    monkeypatch.setattr(plan, "HANDING", 100.0)
    assert (
        plan.on_workers(job, 4, 1)
        .text()
        .endswith("the workers wait for the process that writes: 17 min for all shards")
    )
    monkeypatch.setattr(speeds, "pace", lambda *_: None)
    assert (
        plan.on_workers(job, 1, 1).text()
        == "10 shards on 1 worker of 1 core: nobody knows how long such a worker takes"
    )


def test_a_forecast_for_workers_needs_neither_them_nor_a_cluster(capsys):
    """Broken once: the executor made for a dry run, too -> nothing answers at that address."""
    typed = "sweep windy-gridworld sarsa --alpha 0.5 --seeds 70 --steps 100 --dry-run"
    ray = f"{typed} --executor ray --address 127.0.0.1:9 --num-cpus 2 --workers 64"
    assert main(ray.split()) == 0
    assert "\n1 shard on 64 workers of 2 cores: about 4" in capsys.readouterr().out
    slurm = f"{typed} --executor slurm --slurm cpus_per_task=8 --workers 2 --json"
    assert main(slurm.split()) == 0
    found = json.loads(capsys.readouterr().out)["on_workers"]
    assert (found["workers"], found["cores"], found["shards"]) == (2, 8, 1)


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("--workers 64 --executor ray", "--workers is for --dry-run"),
        ("--workers 64 --dry-run", "give --executor ray, slurm or distributed as well"),
        ("--workers 0 --dry-run", "workers must be a whole number of at least 1, not 0"),
    ],
)
def test_workers_that_mean_nothing_are_refused(capsys, typed, said):
    assert main(["sweep", "windy-gridworld", "sarsa", *typed.split()]) == 2
    assert said in capsys.readouterr().err
