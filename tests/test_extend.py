"""A sweep in a folder grows: what is there stays, what is new is computed, and all is what the larger one gives."""

import functools
import json
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import quick
import xarray as xr
from marks import slow_but, slow_but_first

import jaxrl_tab as rl
from jaxrl_tab import cli, plot, report
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import by_xla, programs
from jaxrl_tab.experiment import disk, found, growth, runner, shards, storage

SARSA = {"name": "sarsa", "alpha": [0.5, 0.25]}
MORE = {"name": "sarsa", "alpha": [0.25, 0.9, 0.5]}
DRAWN = {"name": "q-learning", "alpha": {"uniform": [0.1, 0.9]}, "draws": 3}


def experiment(**given):
    """Of three shards: two, and one of fresh seeds."""
    one = {"environment": "windy-gridworld", "method": SARSA, "seeds": 35, "steps": 20}
    return rl.Experiment(**(one | {"select": {"fresh_seeds": 5}} | given))


FIRST = experiment()
STAGES = [
    experiment(seeds=70),  # more seeds
    experiment(seeds=75, method=[MORE, DRAWN], select={"fresh_seeds": 70}),  # a value, and a method
    experiment(
        seeds=75,
        environment={
            "name": "windy-gridworld",
            "moves": ["king", "four"],
        },  # which calls the old one otherwise
        method=[DRAWN | {"draws": 4}, MORE | {"epsilon": [0.1, 0.2]}],
        select={"fresh_seeds": 70},
    ),
]
# The setting chosen of Sarsa is another one where 0.9 is tried: all its fresh seeds are run again.
NEW_RUNS = [2 * 35, 2 * 5 + 75 + 3 * 75 + 70 + 70, 75 + 3 * 75 + 4 * 75 + 6 * 75 + 2 * 70]


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Shards of 64 runs; a picture and a report that take no time."""
    make_small(monkeypatch)


def make_small(patched):
    patched.setattr(shards, "SHARD_STEPS", 64 * 20)
    patched.setattr(plot, "save_all", quick.picture)
    patched.setattr(report, "write_methods", quick.page)
    shards.forget_parts()


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The folder of the first experiment."""
    folder = tmp_path_factory.mktemp("extend") / "run"
    with pytest.MonkeyPatch.context() as patched:
        make_small(patched)
        rl.run(FIRST, folder, command="begun")
    return folder


@pytest.fixture
def folder(begun, tmp_path):
    return Path(shutil.copytree(begun, tmp_path / "run"))


@functools.cache
def at_once(stage):
    """What a larger experiment gives, by its number."""
    with pytest.MonkeyPatch.context() as patched:
        make_small(patched)
        return rl.run(STAGES[stage])


@pytest.fixture
def computed(monkeypatch):
    """How many runs are computed in each shard, but for those of what is run at once."""
    at_once(0), at_once(1)
    runs, call = [], shards.Job.__call__
    monkeypatch.setattr(
        shards.Job, "__call__", lambda job, n: runs.append(job.shards[n].runs) or call(job, n)
    )
    return runs


def kept(folder):
    return {file.name: file.read_bytes() for file in (folder / "shards").glob("*.npz")}


def assert_same(outcome, other):
    for one, two in ((outcome.datasets, other.datasets), (outcome.fresh, other.fresh)):
        assert list(one) == list(two)
        for name in one:
            xr.testing.assert_equal(one[name], two[name])
            assert one[name].q.dtype == two[name].q.dtype


def test_it_is_what_the_larger_one_gives_and_only_what_is_new_is_computed(folder, computed):
    """Broken once: the old shards taken for those of the new plan; the setting by its new number -> fails."""
    grow(folder, 0, computed)
    grow(folder, 1, computed)
    names = [line[1] for line in runner.history(folder)]
    assert names[0] == "sarsa in windy-gridworld; 35 seeds, 20 steps" and names[1].startswith(
        "seeds was 35, "
    )


def grow(folder, stage, computed):
    whole, before = at_once(stage), kept(folder)
    computed.clear()
    assert_same(rl.resume(folder, experiment=STAGES[stage]), whole)
    assert sum(computed) == NEW_RUNS[stage]
    after = kept(folder)
    changed = {name for name in before if before[name] != after[name]}
    facts = json.loads((folder / "manifest.json").read_text())["shards"]
    assert all(facts[name]["setting"] is not None for name in changed)  # what was chosen is another one
    computed.clear()
    assert_same(rl.resume(folder), whole)
    assert not computed


@pytest.mark.slow
def test_so_it_is_where_environments_are_added(folder, computed):
    """And the one that was there is called otherwise since."""
    rl.resume(folder, experiment=STAGES[1])
    grow(folder, 2, computed)
    assert "environment windy-gridworld is called windy-gridworld,moves=four" in runner.history(folder)[2][1]
    assert not (folder / "overview.png").exists()  # for now there is one of each environment
    with xr.open_datatree(folder / "results.nc") as tree:
        own = tree["windy-gridworld,moves=king/sarsa"].to_dataset()
        xr.testing.assert_equal(own, at_once(2).datasets["windy-gridworld,moves=king/sarsa"])


def test_every_run_is_planned_once_and_its_number_stays():
    """Of an experiment that grew in all ways, several programs and draws among them; nothing is compiled."""
    glie = [DRAWN | {"draws": 4}, MORE | {"epsilon": ["glie", 0.1, 0.2]}, "monte-carlo"]
    last = STAGES[2].data() | {"method": glie, "first_seed": 0, "seeds": 90}
    more = [rl.Experiment.from_data(last | {"steps": steps}) for steps in (20, 40)]
    grew = [experiment(first_seed=2, seeds=20), FIRST, *STAGES, *more]
    numbers = {}
    for count in range(1, len(grew) + 1):
        job = shards.Job.of(grew[count - 1], None, {}, grew[: count - 1])
        job = job._replace(chosen=json.dumps(dict.fromkeys(job.parts, 0)))
        for number, shard in job.shards.items():
            assert numbers.setdefault(number, shard.runs) == shard.runs
        for name, part in job.parts.items():
            own = [shards.runs(part, shard) for shard in job.shards.values() if shard.part == name]
            assert sorted(np.concatenate(own)) == list(range(part.runs))


@pytest.mark.slow
def test_seeds_before_the_first_are_added_as_well(folder, tmp_path):
    later = rl.run(experiment(first_seed=20, seeds=50, select=None), tmp_path / "later")
    wider = experiment(first_seed=10, seeds=65, select=None)
    assert_same(rl.resume(tmp_path / "later", experiment=wider), rl.run(wider))
    assert list(later.datasets["windy-gridworld/sarsa"].seed[[0, -1]]) == [20, 69]


@pytest.mark.slow
def test_it_can_be_decided_afterwards(tmp_path, computed):
    """And with more seeds, where the same settings are chosen, nothing is compared again."""
    folder = tmp_path / "run"
    rl.run(experiment(select=None), folder)
    given = {
        "method": [SARSA, "q-learning"],
        "select": {"fresh_seeds": 5},
        "until_decided": {"most_seeds": 20},
    }
    outcome = rl.resume(folder, experiment=experiment(**given))
    assert repr(outcome.verdicts) == repr(rl.run(experiment(**given)).verdicts)
    computed.clear()
    assert repr(rl.resume(folder, seeds=36).verdicts) == repr(outcome.verdicts) and sum(computed) == 3


@pytest.mark.slow
def test_longer_runs_whose_rows_are_others_are_computed_anew_and_the_old_ones_stay(folder, computed, caplog):
    before = kept(folder)
    outcome = rl.resume(folder, steps=40)
    assert sum(computed) == 2 * 35 + 5 and before.items() <= kept(folder).items()
    longer = rl.sweep(rl.make("windy-gridworld"), "sarsa", {"alpha": [0.5, 0.25]}, num_seeds=35, num_steps=40)
    xr.testing.assert_equal(outcome.datasets["windy-gridworld/sarsa"], longer.to_xarray())
    assert "70 runs begin anew, for their last row is of 20 steps, and not of 100; the shorter" in caplog.text
    computed.clear()
    (folder / "shards" / "000000.npz").unlink()  # of no use any more, and so of no loss
    assert_same(rl.resume(folder), outcome)
    assert not computed


def test_one_that_was_interrupted_can_grow_as_well(folder, computed):
    """What it lacks is computed as it was planned first."""
    for name in ("000001.npz", "000002.npz"):
        (folder / "shards" / name).unlink()
    assert_same(rl.resume(folder, experiment=STAGES[0]), at_once(0))
    assert computed == [6, 64, 6, 5]


# --- interrupted -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "moment", slow_but(["written"], ["written", "resolved", "begun", "shard", "fresh", "files"])
)
def test_interrupted_at_any_moment_it_goes_on(folder, computed, monkeypatch, moment):
    """By a plain `resume`, and nothing is computed twice. Broken once: the manifest written first -> fails."""
    wanted = len(STAGES[1].parts()) and {"begun": 0, "shard": 2, "fresh": 7, "files": 99}.get(moment)

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        if moment == "written":
            patched.setattr(found, "_write_resolved", stop)
        elif moment == "resolved":
            patched.setattr(
                runner, "find", lambda *a, **k: stop() if calls else calls.append(1) or find(*a, **k)
            )
            calls, find = [], found.find
        elif moment == "files":
            patched.setattr(runner, "write_files", stop)
        else:
            call = shards.Job.__call__
            count = iter(range(99))
            patched.setattr(
                shards.Job, "__call__", lambda job, n: stop() if next(count) == wanted else call(job, n)
            )
        with pytest.raises(KeyboardInterrupt):
            rl.resume(folder, experiment=STAGES[1])
    assert_same(rl.resume(folder), at_once(1))
    assert sum(computed) == 2 * 40 + 75 + 3 * 75 + 70 + 70
    assert len(runner.history(folder)) == 2 and not list(folder.rglob(f"*{disk.UNFINISHED}*"))


@pytest.mark.weekly
def test_killed_again_and_again_while_it_grows(begun, tmp_path):
    """With SIGKILL, at moments of all kinds; then it is asked for once more."""
    subprocess.run([sys.executable, __file__, str(begun), str(tmp_path)], check=True)
    for number in range(4):
        folder = tmp_path / str(number)
        assert_same(rl.resume(folder), at_once(1))
        assert not (folder / disk.ASIDE).exists() and len(runner.history(folder)) == 2


def kill_four_times(begun, scratch):
    """In processes of their own, copies of this one, which has not started JAX."""
    random, used, killed = np.random.default_rng(0), 1.0, 0
    for number in range(-1, 4):  # the first one is left alone, to know how long it takes
        folder = Path(shutil.copytree(begun, scratch / str(number)))
        pid = extending(folder)
        if number >= 0:
            quick.kill_after(random.uniform(0.1, used), pid)
        _, status, usage = os.wait4(pid, 0)
        killed += os.WIFSIGNALED(status)
        used = usage.ru_utime + usage.ru_stime if number < 0 else used
        assert os.waitpid(extending(folder), 0)[1] == 0
    assert killed > 1


def extending(folder):
    warnings.simplefilter("ignore")  # JAX says that this would not do if it had started
    if pid := os.fork():
        return pid
    try:
        by_xla.use_all_cores()
        programs.keep()
        quick.make_quick()
        shards.SHARD_STEPS = 64 * 20
        rl.resume(folder, experiment=STAGES[1], progress=False)
    except BaseException:
        os._exit(1)
    os._exit(0)


# --- refused, and damaged ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seeds": 34}, "seeds was 35, and is 34; what is there is kept, and a folder only grows"),
        ({"steps": 19}, "steps was 20, and is 19; what is there"),
        ({"episodes": 9}, "the length of these runs is a number of steps: give steps, not episodes"),
        ({"seeds": 0}, "seeds must be a whole number of at least 1, not 0"),
        ({"experiment": experiment(seed=1)}, "seed was 0, and is 1; what is there"),
        ({"experiment": experiment(exact=True)}, "exact was false, and is true; what is there"),
        ({"experiment": experiment(method="q-learning")}, "method sarsa is gone; what is there"),
        (
            {"experiment": experiment(method=[SARSA | {"alpha": [0.25, 0.9]}])},
            "method sarsa: alpha was [0.5, 0.25], and is [0.25, 0.9]; what is there",
        ),
        (
            {"experiment": experiment(environment={"name": "windy-gridworld", "moves": "king"}, seeds=99)},
            "environment windy-gridworld: moves was",
        ),
        ({"experiment": experiment(first_seed=1)}, "first_seed was 0, and is 1; what is there"),
        ({"experiment": experiment(select=None)}, "select: fresh_seeds was 5, and is not given; what is"),
    ],
)
def test_what_would_be_less_is_refused_in_a_line(folder, computed, given, message):
    before = {file: file.read_bytes() for file in folder.rglob("*.*") if file.is_file()}
    with pytest.raises(InputError) as error:
        rl.resume(folder, **given)
    assert str(error.value).startswith(message) and "\n" not in str(error.value)
    assert {file: file.read_bytes() for file in folder.rglob("*.*") if file.is_file()} == before


def test_what_is_written_in_the_folder_is_a_wish(folder, computed):
    """And a mistake in it is told, and the file left as it is."""
    file = folder / "experiment.toml"
    text = file.read_text()
    file.write_text("# my seeds\n" + text.replace('"sarsa"', '"sarsb"'))
    with pytest.raises(InputError, match=r"experiment.toml, line 25: 'sarsb' is not a method; did you mean"):
        rl.resume(folder)
    file.write_text("# my seeds\n" + text.replace("seeds = 35", "seeds = 34"))
    with pytest.raises(InputError, match="was changed since: seeds was 35, and is 34; what is there is kept"):
        rl.resume(folder)
    file.write_text("# my seeds\n" + text.replace("seeds = 35", "seeds = 40"))
    rl.resume(folder)
    assert_same(rl.resume(folder, seeds=70), at_once(0))
    assert file.read_text() == "# my seeds\n" + text.replace("seeds = 35", "seeds = 70")
    assert sum(computed) == 2 * 35


@pytest.mark.parametrize("name", slow_but_first(["resolved.json", "manifest.json", "experiment.toml"]))
def test_the_history_is_there_twice(folder, computed, caplog, name):
    rl.resume(folder, seeds=70)
    history = runner.history(folder)
    computed.clear()
    os.truncate(folder / name, (folder / name).stat().st_size // 2)
    if name == "experiment.toml":
        (folder / name).write_bytes(b"\0")
    assert_same(rl.resume(folder), at_once(0))
    assert name in caplog.text and not computed and runner.history(folder) == history
    data = json.loads((folder / "resolved.json").read_text())
    data["history"][0]["experiment"]["seeds"] = 99
    (folder / "resolved.json").write_text(json.dumps(data))
    assert runner.history(folder) == history


def test_a_history_that_cannot_be_is_refused(folder):
    """Also where the manifest has it, with a right checksum. Broken once: not looked at -> KeyError."""
    rl.resume(folder, seeds=70)
    manifest = storage.read_manifest(folder)
    assert manifest
    data = json.loads((folder / "resolved.json").read_text())
    manifest["history"][0]["experiment"]["seeds"] = data["history"][0]["experiment"]["seeds"] = 99
    storage._write_manifest(folder, manifest)
    (folder / "resolved.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match="says of how the experiment grew is damaged"):
        rl.resume(folder)


# --- as a person does it -----------------------------------------------------------------------------


def test_on_the_command_line(tmp_path, monkeypatch, capsys):
    """By options, and by the file that it was read from, changed; a file of one's own comes along."""
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(
        'environment = "windy-gridworld"\nseeds = 35\nsteps = 20\n\n[[method]]\nname = "sarsa"\n'
        "alpha = [0.5, 0.25]\n\n[select]\nfresh_seeds = 5\n"
    )
    assert cli.main(["sweep", "x.toml", "--out", "run", "--quiet"]) == 0
    assert cli.main(["resume", "run", "--seeds", "70", "--quiet"]) == 0
    Path("mine.py").write_text(
        "from jaxrl_tab import Sarsa, pytree\n\n@pytree\nclass Mine(Sarsa):\n    pass\n"
    )
    text = Path("x.toml").read_text().replace("35", "70")
    Path("x.toml").write_text(text + '\n[[method]]\nname = "mine.py:Mine"\nalpha = [0.5, 0.25]\n')
    assert cli.main(["resume", "run", "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "x.toml was changed since: method Mine is new; put it back" in said
    assert "or add what is new in it: `jaxrl-tab resume run" in said
    assert cli.main(["resume", "run", "x.toml", "--quiet"]) == 0
    elsewhere = shutil.copy("mine.py", "moved.py")  # what it is called does not matter
    wider = Path("x.toml").read_text().replace("mine.py", elsewhere).replace("70", "71")
    Path("y.toml").write_text(wider.replace("moved.py:Mine", 'moved.py:Mine"\nlabel = "Mine'))
    Path("mine.py").unlink()
    assert cli.main(["resume", "run", "--quiet"]) == 0
    with xr.open_datatree("run/results.nc") as tree:
        for label in ("sarsa", "Mine"):
            xr.testing.assert_equal(tree[label].to_dataset(), at_once(0).datasets["windy-gridworld/sarsa"])
    loaded = rl.Experiment.load("y.toml")
    assert growth.taken_away(found.find(Path("run")).experiment, loaded) == []
    capsys.readouterr()
    assert cli.main(["resume", "run", "--history"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "    jaxrl-tab sweep x.toml --out run --quiet" and len(lines) == 6
    assert lines[2].endswith("  seeds was 35, and is 70")


if __name__ == "__main__":
    kill_four_times(*map(Path, sys.argv[1:]))
