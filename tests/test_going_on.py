"""Longer runs go on where shorter ones ended: the same bits as at once, and only what is new is computed."""

import dataclasses
import shutil
from pathlib import Path

import pytest
import quick
import xarray as xr
from marks import slow_but_first

import jaxrl_tab as rl
from jaxrl_tab import plot, report
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.sweep import prepare
from jaxrl_tab.experiment import going_on, shards, storage
from jaxrl_tab.experiment.records import Origin

LENGTH, LONGER = 40, 120


def experiment(**given):
    """Of two shards of 64 and 6 runs, and one of fresh seeds."""
    one = {
        "environment": "two-doors",
        "method": {"name": "sarsa", "alpha": [0.5, 0.25]},
        "log_every": 20,
    }
    return rl.Experiment(**(one | {"seeds": 35, "steps": LENGTH, "select": {"fresh_seeds": 5}} | given))


def make_small(patched):
    patched.setattr(shards, "SHARD_STEPS", 64 * LENGTH)
    patched.setattr(plot, "save_all", quick.picture)
    patched.setattr(report, "write_methods", quick.page)
    shards.forget_parts()


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Shards of 64 runs; a picture and a report that take no time."""
    make_small(monkeypatch)


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    folder = tmp_path_factory.mktemp("going-on") / "run"
    with pytest.MonkeyPatch.context() as patched:
        make_small(patched)
        rl.run(experiment(), folder, formats=(), progress=False)
    return folder


@pytest.fixture
def folder(begun, tmp_path):
    return Path(shutil.copytree(begun, tmp_path / "run"))


@pytest.fixture(scope="module")
def at_once():
    """What the longer experiment gives, with five more seeds."""
    with pytest.MonkeyPatch.context() as patched:
        make_small(patched)
        return rl.run(experiment(seeds=40, steps=LONGER), progress=False)


@pytest.fixture
def steps(at_once, monkeypatch):
    """How many steps are computed at a time, but for those of what is run at once."""
    taken, compute = [], shards.compute

    def counted(part, numbers, **given):
        taken.append(len(numbers) * (part.budget.num_steps or 0))
        return compute(part, numbers, **given)

    monkeypatch.setattr(shards, "compute", counted)
    return taken


def grown(folder, **given):
    return rl.resume(
        folder, experiment=experiment(seeds=40, steps=LONGER), formats=(), progress=False, **given
    )


def assert_same(one, other):
    assert list(one.datasets) == list(other.datasets) and list(one.fresh) == list(other.fresh)
    for name in one.datasets:
        xr.testing.assert_equal(one.datasets[name], other.datasets[name])
    for name in one.fresh:
        xr.testing.assert_equal(one.fresh[name], other.fresh[name])


NEW = 70 * (LONGER - LENGTH) + 10 * LONGER  # beside the fresh seeds, whose setting may be another one
ANEW = 80 * LONGER


def test_runs_go_on_beside_new_ones_and_give_the_same_bits(folder, at_once, steps, caplog):
    """Broken once: the shorter runs' places mixed up; their rows left out -> fails."""
    assert_same(grown(folder), at_once)
    assert sum(steps) in (NEW + 5 * (LONGER - LENGTH), NEW + 5 * LONGER)
    line = "seeds was 35, and is 40; steps was 40, and is 120; 70 runs go on where they ended; the shorter runs stay"
    assert line in caplog.text
    steps.clear()
    assert_same(rl.resume(folder), at_once)
    assert not steps


def test_interrupted_it_goes_on_as_before(folder, at_once, steps, monkeypatch):
    """A shard of longer runs is there, or not; and has where its runs ended, for still longer ones."""
    call, calls = going_on.Longer.__call__, []

    def stop(longer, number):
        calls.append(number)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return call(longer, number)

    monkeypatch.setattr(going_on.Longer, "__call__", stop)
    with pytest.raises(KeyboardInterrupt):
        grown(folder)
    assert_same(rl.resume(folder), at_once)
    assert NEW < sum(steps) < ANEW
    store = storage.Store(folder, rl.Experiment.load(folder / "experiment.toml").fingerprint)
    assert any(name.startswith(shards.END) for name in store.shapes(max(store.shards)))


@pytest.mark.parametrize("how", slow_but_first(["not kept", "gone", "damaged"]))
def test_what_has_no_beginning_is_computed_anew(folder, at_once, steps, caplog, how):
    """Broken once: the shapes not looked at -> KeyError."""
    file = folder / "shards" / "000000.npz"
    if how == "gone":
        file.unlink()
    elif how == "damaged":
        file.write_bytes(file.read_bytes()[:-100])
    else:  # as by an earlier version
        store = storage.Store(folder, experiment().fingerprint)
        facts = store.shards[0]
        store.write(0, store.read(0, (shards.END,)), surroundings=facts.surroundings)
        store.write_manifest()
    assert_same(grown(folder), at_once)
    assert NEW + 64 * LENGTH <= sum(steps) < ANEW + 5 * LONGER
    assert "6 runs go on where they ended" in caplog.text
    if how == "not kept":
        assert "64 runs begin anew, for where they ended was not kept" in caplog.text


def test_so_it_is_on_a_worker_that_does_not_see_the_folder_and_by_other_versions(folder, at_once):
    """Broken once: the surroundings not looked at -> runs of other versions go on."""
    new = experiment(seeds=40, steps=LONGER)
    store = storage.Store(folder, experiment().fingerprint)
    job = shards.Job.of(new, None, {}, [experiment()])
    name = store.shards[0].surroundings
    longer = going_on.longer(store, job, Origin(name, [], False))
    assert isinstance(longer, going_on.Longer) and set(longer.checksums) == {0, 1}
    number = min(longer.shards)
    one, other = longer(number), longer._replace(folder=str(folder / "nowhere"))(number)
    assert one.pop(shards.BEGUN) == 59 * LENGTH and one.keys() == other.keys()
    assert all(x.tobytes() == other[name].tobytes() for name, x in one.items() if name != "seconds")
    assert going_on.longer(store, job, Origin("another", [], True)) is job
    assert "70 runs begin anew, for they were computed with other versions" in going_on.told(
        store, job, Origin("another", [], True)
    )


WALK = prepare(rl.make("two-doors"), "sarsa", {}, Budget(num_steps=100, log_every=20), num_seeds=2)


@pytest.mark.parametrize(
    ("was", "now", "why"),
    [
        ({}, {}, None),
        ({}, {"log_every": 10}, "their rows are of 20 steps, and are to be of 10"),
        ({"num_steps": 110}, {}, "their last row is of 10 steps, and not of 20"),
        ({"exact_every": 5}, {"exact_every": 5}, None),
        (
            {"exact_every": 4},
            {"exact_every": 4},
            "their last row has exact values, which that of longer runs has not",
        ),
        ({"num_steps": 300, "log_every": 20}, {}, None),  # in a task that has a length of its own
    ],
)
def test_only_rows_that_begin_the_longer_ones_go_on(was, now, why):
    of = lambda **given: dataclasses.replace(WALK, budget=dataclasses.replace(WALK.budget, **given))
    assert going_on._why_unfit(of(**was), of(num_steps=300, **now)) == why


def test_what_takes_much_room_is_not_kept():
    """The counts of a model take more than all else; a table is in the results anyway."""
    windy, budget = rl.make("windy-gridworld"), Budget(num_steps=1000)
    kept = lambda method, seeds: shards.is_kept(prepare(windy, method, {}, budget, num_seeds=seeds), 0)
    assert kept("sarsa", 10**6) and kept("psrl", 200) and not kept("psrl", 300)
    part = prepare(windy, "sarsa", {}, budget, num_seeds=1000)
    assert shards.kept_bytes(part) == 32 * 1000


@pytest.mark.slow
@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    "given",
    [
        {"method": [{"name": "n-step-sarsa", "n": [2, 5]}, "dyna-q", "monte-carlo"]},
        {"method": "sarsa-lambda", "backend": "xla"},
        {"method": "td-lambda", "environment": "random-walk", "steps": None, "episodes": LENGTH},
    ],
)
def test_so_do_methods_of_all_kinds(tmp_path, given):
    """With a queue, a model, an episode that is remembered, traces; by either backend, and of prediction."""
    unit = "episodes" if "episodes" in given else "steps"
    now = experiment(**{"select": None, "seeds": 3} | given)
    longer = rl.Experiment.from_data(now.data() | {unit: LONGER})
    rl.run(now, tmp_path / "run", formats=(), progress=False)
    assert_same(rl.resume(tmp_path / "run", experiment=longer, formats=(), progress=False), rl.run(longer))
