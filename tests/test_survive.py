"""Experiments survive: each fault is made to happen; the results are those of an undisturbed run, bitwise."""

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import keeping
import numpy as np
import pytest
import quick
import xarray as xr
from marks import slow_but, slow_but_first

import jaxrl_tab as rl
from jaxrl_tab import cli, plot, report, stats
from jaxrl_tab.cli import interrupt
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.engine import by_xla
from jaxrl_tab.experiment import disk, runner, shards, storage

QUICK = [sys.executable, str(Path(quick.__file__))]
LONG = "sweep windy-gridworld sarsa --alpha 0.25 --steps 2000 --log-every 2000 --seeds 20000 --out"


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Shards of 64 runs; a picture and a report that take no time."""
    monkeypatch.setattr(shards, "SHARD_STEPS", 64 * 200)
    monkeypatch.setattr(plot, "save_all", quick.picture)
    monkeypatch.setattr(report, "write_methods", quick.page)
    shards._shards.cache_clear()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """(folder, outcome, reports of progress) of an experiment with nine shards, four of fresh seeds."""
    folder, reports = tmp_path_factory.mktemp("survive") / "run", []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(shards, "SHARD_STEPS", 64 * 200)
        patched.setattr(plot, "save_all", quick.picture)
        patched.setattr(report, "write_methods", quick.page)
        outcome = runner.run(quick.SELECTED, folder, progress=reports.append, command="a command")
    return folder, outcome, reports


@pytest.fixture
def folder(undisturbed, tmp_path):
    """A copy of what the undisturbed run left."""
    return Path(shutil.copytree(undisturbed[0], tmp_path / "run"))


@pytest.fixture
def computed(monkeypatch):
    """The numbers of the shards that are computed."""
    numbers, call = [], shards.Job.__call__
    monkeypatch.setattr(shards.Job, "__call__", lambda job, n: numbers.append(n) or call(job, n))
    return numbers


def saved(folder):
    """All data in a folder: file, group, variable -> array."""
    found = {}
    for name in ("results.nc", "fresh.nc"):
        with xr.open_datatree(folder / name) as tree:
            for group, node in tree.children.items():
                found |= {(name, group, key): x.values for key, x in node.variables.items()}
    return found


expected = functools.cache(saved)


def assert_same(folder, undisturbed):
    one, two = saved(folder), expected(undisturbed)
    assert one.keys() == two.keys()
    for key in one:
        np.testing.assert_array_equal(one[key], two[key], err_msg=str(key))
        assert one[key].dtype == two[key].dtype
    assert not list(folder.rglob(f"*{disk.UNFINISHED}*"))


# --- what a run gives --------------------------------------------------------------------------------


def test_the_results_are_those_of_a_sweep(windy, undisturbed):
    """Put together from shards."""
    folder, outcome, _ = undisturbed
    expected = rl.sweep(windy, "sarsa", {"alpha": [0.25, 0.5]}, num_seeds=70, num_steps=200).to_xarray()
    xr.testing.assert_equal(outcome.datasets["windy-gridworld/sarsa"], expected)
    with xr.open_datatree(folder / "results.nc") as tree:
        assert list(tree.children) == ["sarsa", "q-learning"] and tree.attrs["command"] == "a command"
        xr.testing.assert_equal(tree["sarsa"].to_dataset(), expected)
        assert tree["sarsa"].attrs["seconds"] > 0


def test_what_was_chosen_runs_again_on_seeds_of_no_other_sweep(windy, undisturbed):
    """Case: they went on where the seeds of the choice end, and so were those of a larger sweep of the same root.

    Their keys are folds of fold_in(root, 2**32 - 1), and here 2**32 - 1 is the number of no seed.
    """
    _, outcome, _ = undisturbed
    table = outcome.selection.set_index("method")
    alpha = table.alpha["sarsa"]
    assert alpha == stats.best(outcome.datasets["windy-gridworld/sarsa"])["alpha"]
    fresh = outcome.fresh["windy-gridworld/sarsa"]
    assert fresh.seed.values.tolist() == list(range(66))
    assert fresh.attrs["fresh_seeds"] == 1
    root = jax.random.fold_in(jax.random.key(0), 2**32 - 1)
    method = rl.Sarsa(alpha=alpha)
    state, _ = rl.train(jax.random.fold_in(root, 65), method, windy, num_steps=200)
    np.testing.assert_array_equal(fresh.q.sel(seed=65), state.q)
    larger = rl.sweep(windy, "sarsa", {"alpha": alpha}, num_seeds=136, num_steps=200).to_xarray()
    again = {x.tobytes() for x in fresh.q.values} & {x.tobytes() for x in larger.q.values}
    assert not again


@pytest.mark.slow
def test_a_number_is_chosen_among_schedules_as_it_is_labelled(windy):
    """The axis has 0.25 and "power:2:step". Broken once: the number compared with its text -> fails.

    Each is a program of its own. Broken once: runs counted in the program, not in the part -> fails.
    """
    method = {"name": "sarsa", "alpha": ["power:2:step", 0.25]}
    select = {"fresh_seeds": 2}
    outcome = rl.run(rl.Experiment("windy-gridworld", method, seeds=4, steps=4000, select=select))
    (row,) = outcome.selection.to_dict("records")
    assert row["alpha"] == 0.25
    alphas = [rl.schedules.parse("power:2:step"), 0.25]
    expected = rl.sweep(windy, "sarsa", {"alpha": alphas}, num_seeds=4, num_steps=4000).to_xarray()
    xr.testing.assert_equal(outcome.datasets["windy-gridworld/sarsa"], expected)
    assert row["fresh_score"] == stats.score(outcome.fresh["windy-gridworld/sarsa"]).mean()


def test_the_folder_says_how_to_do_it_again(undisturbed):
    folder, _, _ = undisturbed
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")} - {"report.html"}
    tables = {"summary.csv", "selection.csv", "results.nc", "fresh.nc", "overview.png"}
    assert names == tables | {
        "experiment.toml",
        "resolved.json",
        "provenance.json",
        "manifest.json",
        "shards",
    }
    assert rl.Experiment.load(folder / "experiment.toml").data() == quick.SELECTED.data()
    assert json.loads((folder / "resolved.json").read_text()) == quick.SELECTED.data()
    (session,) = json.loads((folder / "provenance.json").read_text())["sessions"]
    assert session["surroundings"]["jax"] == jax.__version__ and session["devices"] == 2
    assert session["started"] <= session["ended"] and session["command"] == "a command"


def test_progress_counts_runs_steps_and_time(undisturbed):
    _, _, reports = undisturbed
    runs = [report.done for report in reports]
    assert runs == sorted(runs) and runs[0] == 0 and runs[-1] == 140 + 70 + 2 * 66
    assert all(report.total == runs[-1] for report in reports)
    assert reports[-1].steps == 200 * runs[-1] and reports[-1].left == 0
    assert reports[0].left is None and reports[1].left > 0 and reports[1].label == "windy-gridworld/sarsa"


@pytest.mark.slow
def test_several_environments_have_groups_and_pictures_of_their_own(tmp_path):
    walks = {"name": "random-walk", "left_reward": [-1, 0]}
    outcome = rl.run(rl.Experiment(walks, ["td"], seeds=2, steps=100), tmp_path / "run")
    with xr.open_datatree(tmp_path / "run" / "results.nc") as tree:
        for label, value in zip(outcome.envs, (0, 0.5), strict=True):
            assert tree[f"{label}/td"].attrs["optimal_value"] == pytest.approx(value)
            assert (tmp_path / "run" / "pictures" / label / "overview.png").exists()
    assert outcome.summary.environment.tolist() == list(outcome.envs)


def test_any_label_has_its_pictures(tmp_path, computed):
    """Broken once: the label as the name of a folder -> the file name is too long."""
    labels = ["\u4e16" * 200, "foo.unfinished", "Walk", "walk"]
    walks = [{"name": "random-walk", "label": label} for label in labels]
    rl.run(rl.Experiment(walks, "td", seeds=2, steps=100), tmp_path / "run")
    assert len(list((tmp_path / "run" / "pictures").glob("*/overview.png"))) == 4
    with xr.open_datatree(tmp_path / "run" / "results.nc") as tree:
        assert set(labels) == set(tree.children)
    computed.clear()
    before = (tmp_path / "run" / "results.nc").stat().st_mtime_ns
    rl.resume(tmp_path / "run")
    assert computed == [] and (tmp_path / "run" / "results.nc").stat().st_mtime_ns == before


def test_results_that_do_not_fit_are_in_files_with_the_same_numbers(folder, undisturbed):
    outcome = rl.resume(folder, memory=2_000_000)
    for name, ds in undisturbed[1].datasets.items():
        xr.testing.assert_equal(outcome.datasets[name], ds)


def test_without_a_folder_the_outcome_is_the_same_and_nothing_is_left(undisturbed, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    outcome = rl.run(quick.SELECTED)
    assert list(tmp_path.iterdir()) == []
    for name, ds in undisturbed[1].datasets.items():
        xr.testing.assert_equal(outcome.datasets[name], ds)


# --- interrupted, killed, damaged --------------------------------------------------------------------


@pytest.mark.parametrize("shards", slow_but([0, 4, 7], [0, 1, 4, 5, 7, 9]))
def test_an_interrupted_run_goes_on_where_it_was(undisturbed, tmp_path, computed, shards):
    """Before anything, in a part, between parts, before and in the fresh seeds, before files are written."""

    def interrupt(report):
        finished = [f for f in (tmp_path / "run" / "shards").glob("*") if f.suffix != disk.UNFINISHED]
        if len(finished) == shards:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rl.run(quick.SELECTED, tmp_path / "run", progress=interrupt)
    assert computed == list(range(shards))
    rl.resume(tmp_path / "run")
    assert computed == list(range(9))
    assert_same(tmp_path / "run", undisturbed[0])
    assert len(json.loads((tmp_path / "run" / "provenance.json").read_text())["sessions"]) == 2


@pytest.mark.slow
def test_killed_ten_times_at_random_moments(undisturbed, tmp_path):
    """Broken once: results put together only by who computed a shard -> fails."""
    subprocess.run([*QUICK, "kill", str(tmp_path), "10"], check=True)
    folders = sorted(tmp_path.glob("killed-*"))
    assert folders
    for folder in folders:
        assert_same(folder, undisturbed[0])
        assert not (folder / disk.ASIDE).exists()  # nothing was found damaged


def test_a_finished_run_is_left_alone(folder, computed):
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.n*")}
    rl.resume(folder)
    assert computed == []
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.n*")} == before


def truncate(file):
    os.truncate(file, file.stat().st_size // 2)


def flip(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


@pytest.mark.parametrize("damage", [truncate, flip, Path.unlink])
def test_damaged_shards_are_named_and_computed_again(folder, undisturbed, computed, caplog, damage):
    for number in (2, 6):
        damage(folder / "shards" / f"00000{number}.npz")
    rl.resume(folder)
    named = [record.getMessage().split(" ")[0] for record in caplog.records]
    assert named == ["shards/000002.npz", "shards/000006.npz"] and computed == [2, 6]
    assert len(list(folder.glob("set-aside/*"))) == (0 if damage is Path.unlink else 2)
    assert_same(folder, undisturbed[0])


def test_a_manifest_cut_short_is_made_again(folder, undisturbed, computed, caplog):
    truncate(folder / "manifest.json")
    rl.resume(folder)
    assert [record.getMessage().split(":")[0] for record in caplog.records] == ["manifest.json is damaged"]
    assert computed == []
    assert_same(folder, undisturbed[0])


@pytest.mark.parametrize(
    "name", ["results.nc", "summary.csv", "overview.png", "resolved.json", "provenance.json"]
)
def test_other_damaged_files_are_named_and_made_again(folder, undisturbed, computed, caplog, name):
    truncate(folder / name)
    rl.resume(folder)
    assert name in caplog.text and computed == []
    assert_same(folder, undisturbed[0])
    if name not in ("provenance.json", "results.nc"):  # in which times are
        assert (folder / name).read_bytes() == (undisturbed[0] / name).read_bytes()


# --- refused -----------------------------------------------------------------------------------------


def test_an_experiment_with_less_is_refused_with_the_difference(folder, computed):
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("seeds = 70", "seeds = 69"))
    before = (folder / "manifest.json").read_bytes()
    with pytest.raises(InputError) as error:
        rl.resume(folder)
    assert f"{file} was changed since: seeds was 70, and is 69" in str(error.value)
    assert computed == [] and (folder / "manifest.json").read_bytes() == before


@pytest.mark.parametrize("name", ["experiment.toml", "resolved.json"])
@pytest.mark.parametrize(
    "damage", slow_but_first([b"seeds = 1", b'{"seeds": 70}', b"", b"[1, 2]", b"\0\xff"], 2)
)
def test_one_of_the_two_experiments_mends_the_other(folder, undisturbed, computed, caplog, name, damage):
    """Broken once: what is in `resolved.json` taken as it is -> TypeError."""
    before = (folder / name).read_bytes()
    (folder / name).write_bytes(damage)
    rl.resume(folder)
    assert caplog.messages[0].startswith(
        f"{name} is damaged: it is now set-aside/0-{name}, and is made again, of"
    )
    assert (folder / name).read_bytes() == before and computed == []
    assert (folder / "set-aside" / f"0-{name}").read_bytes() == damage


def test_an_altered_resolved_json_is_damage(folder, undisturbed, computed, caplog):
    """For nobody edits it: the fingerprint is that of the other. Broken once: taken for a change -> refused."""
    text = (folder / "resolved.json").read_text()
    (folder / "resolved.json").write_text(text.replace('"seeds": 70', '"seeds": 71'))
    rl.resume(folder)
    assert "resolved.json is damaged" in caplog.text and computed == []
    assert (folder / "resolved.json").read_text() == text


@pytest.mark.parametrize(
    "text",
    [
        *("[]", "3", '{"file": 3, "sessions": []}', '{"file": null, "sessions": [{"versions": 3}]}'),
        '{"file": "\\ud800", "sessions": []}',
    ],
)
def test_records_of_another_kind_are_begun_anew(folder, caplog, text):
    """Broken once: looked at only whether it is JSON -> TypeError, KeyError, UnicodeEncodeError."""
    (folder / "provenance.json").write_text(text)
    rl.resume(folder)
    assert (
        "provenance.json is damaged: it is now set-aside/0-provenance.json, and is begun anew" in caplog.text
    )
    (session,) = json.loads((folder / "provenance.json").read_text())["sessions"]
    assert session["ended"]


def test_what_is_no_experiment_or_no_name_is_refused(tmp_path):
    wrong: Any
    for wrong in (None, "experiment.toml", {}):
        with pytest.raises(InputError, match="run takes an Experiment, not"):
            rl.run(wrong, tmp_path / "run")
    for wrong in (3, None, "a\0b", b"bytes"):
        with pytest.raises(InputError, match="the folder must be named by a text, or a Path, not"):
            rl.resume(wrong)
    with pytest.raises(InputError, match="the folder must be named by a text, or a Path, not"):
        rl.run(quick.SELECTED, "a\0b")


def test_so_is_one_that_was_changed_where_it_was_read_from(tmp_path, computed):
    """Until it is put back, or is elsewhere. A comment is no change."""
    file = tmp_path / "walk.toml"
    file.write_text('seeds = 2\nsteps = 100\nenvironment = "random-walk"\nmethod = "td"\n')
    rl.run(rl.Experiment.load(file), tmp_path / "run")
    text = file.read_text()
    file.write_text(text + "# well\n")
    rl.resume(tmp_path / "run")
    file.write_text(text.replace("100", "200"))
    with pytest.raises(
        InputError, match=r"walk.toml was changed since: steps was 100, and is 200; put it back"
    ):
        rl.resume(tmp_path / "run")
    file.rename(tmp_path / "other.toml")
    rl.resume(tmp_path / "run")
    assert computed == [0]


def test_both_changed_alike_are_still_refused(folder):
    for name in ("experiment.toml", "resolved.json"):
        text = (folder / name).read_text()
        (folder / name).write_text(
            text.replace("seeds = 70", "seeds = 71").replace('"seeds": 70', '"seeds": 71')
        )
    with pytest.raises(InputError, match="was begun with another experiment"):
        rl.resume(folder)


def test_folders_without_an_experiment_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for name, said in {"x": "there is no folder", "file": "is not a folder", ".": "no experiment in"}.items():
        with pytest.raises(InputError, match=said):
            rl.resume(tmp_path / name)
    with pytest.raises(InputError, match="exists already"):
        rl.run(quick.SELECTED, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_too_many_results_for_the_disk_are_refused_before_anything(tmp_path, computed):
    many = rl.Experiment("windy-gridworld", ["sarsa"], seeds=2**30, steps=1000)
    with pytest.raises(InputError, match=r"the results need .* TB on the disk, and there is room for"):
        rl.run(many, tmp_path / "run")
    assert computed == [] and list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_second_process_is_refused_and_the_first_goes_on(undisturbed, tmp_path):
    """Broken once: no lock -> fails."""
    hold = f"""
import sys; sys.argv[1:] = []; sys.path.insert(0, {str(Path(quick.__file__).parent)!r})
import quick; from jaxrl_tab.experiment import runner
quick.make_quick()
def wait(report):
    if report.done == 64 and not sys.stdin.closed:  # it is reported twice
        print("at work", flush=True); sys.stdin.readline(); sys.stdin.close()
runner.run(quick.SELECTED, {str(tmp_path / "run")!r}, progress=wait)
"""
    with subprocess.Popen(
        [sys.executable, "-c", hold], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdin and first.stdout
        assert first.stdout.readline() == "at work\n"
        with pytest.raises(InputError, match="another process is at work in"):
            rl.resume(tmp_path / "run")
        with pytest.raises(InputError, match="exists already"):
            rl.run(quick.SELECTED, tmp_path / "run")
        first.stdin.close()
    assert first.returncode == 0
    assert_same(tmp_path / "run", undisturbed[0])


# --- no room, no memory ------------------------------------------------------------------------------


@pytest.fixture(params=["300k", "600k"])
def small_disk(request, tmp_path):
    """A disk with room for some shards, or for all and no results; None for those who may not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={request.param}", "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True).returncode:
        yield None
        return
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_no_shard_is_lost(small_disk, tmp_path, undisturbed):
    """A real one; or else a process that may write no large files. With room again it goes on."""
    place = small_disk or tmp_path
    file, out = tmp_path / "selected.toml", place / "run"
    file.write_text(quick.SELECTED.to_toml())
    limit = (
        "" if small_disk else "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)); "
    )
    code = f"{limit}import sys, quick; from jaxrl_tab.experiment import runner; runner._check_room = lambda *_: None"
    code += "; quick.make_quick(); sys.exit(quick.cli.main())"
    argv = [sys.executable, "-c", code, "sweep", str(file), "--out", str(out)]
    done = subprocess.run(argv, capture_output=True, text=True, cwd=Path(quick.__file__).parent)
    assert done.returncode == 1, done.stderr
    all_computed = len(list((out / "shards").iterdir())) == 9  # then the results are shown
    assert bool(done.stdout) == all_computed and done.stderr.count("\n") == 1
    assert "could not be written: " in done.stderr and f"`jaxrl-tab resume {out}` goes on" in done.stderr
    left = [path for path in out.rglob("*") if path.name.endswith(disk.UNFINISHED)]
    assert left == []
    if small_disk:
        subprocess.run(["mount", "-o", "remount,size=10M", str(place)], check=True)
    rl.resume(out)
    assert_same(out, undisturbed[0])


@pytest.fixture
def little_memory(monkeypatch):
    """Programs that say, as XLA does, that memory runs out where a device is given more than so many runs."""
    compiled, most, asked = by_xla._compiled, [0], []

    def program(*args):
        def call(blocks, root, seeds, *rest):
            asked.append(seeds.shape[1:])
            if np.prod(seeds.shape[1:]) > most[0]:
                raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 1 bytes.")
            return compiled(*args)(blocks, root, seeds, *rest)

        return call

    program.cache_clear = compiled.cache_clear
    with keeping.optimising():  # the bits are those that a user gets
        monkeypatch.setattr(by_xla, "_compiled", program)
        yield most, asked


@pytest.mark.slow
def test_a_block_that_is_too_large_is_halved(windy, little_memory, caplog):
    """First blocks of a call, then lanes; the same to the last bit. Broken once: down to 2 lanes -> fails."""
    most, asked = little_memory
    given = {"num_seeds": 70, "num_steps": 200, "backend": "xla"}
    most[0] = 2**20
    expected = rl.sweep(windy, "sarsa", {"alpha": [0.3, 0.7]}, **given)
    for most[0], shape in ((64, (1, 64)), (8, (1, 8))):
        asked.clear()
        again = rl.sweep(windy, "sarsa", {"alpha": [0.3, 0.7]}, **given)
        assert asked[-1] == shape
        for x, y in zip(
            jax.tree.leaves((again.q, again.log)), jax.tree.leaves((expected.q, expected.log)), strict=True
        ):
            np.testing.assert_array_equal(x, y)
    assert "out of memory with 64 runs at a time" in caplog.text
    most[0] = 1
    with pytest.raises(
        RunError, match=r"not enough memory for 8 runs at a time on each device .2., the smallest"
    ):
        rl.sweep(windy, "sarsa", {"alpha": [0.3, 0.7]}, **given)


def test_other_errors_of_jax_are_not_taken_for_want_of_memory(windy, monkeypatch):
    def broken(*_):
        raise jax.errors.JaxRuntimeError("INTERNAL: broken")

    monkeypatch.setattr(by_xla, "_compiled", lambda *_: broken)
    with pytest.raises(jax.errors.JaxRuntimeError, match="broken"):
        rl.sweep(windy, "sarsa", {}, num_seeds=1, num_steps=10, backend="xla")


# --- diverged ----------------------------------------------------------------------------------------


def test_runs_that_diverge_are_counted_and_leave_all_others_as_they_are(tmp_path, capsys):
    """In the data, on the way, and on the screen.

    By numbers that are none, or beyond ten times any return: each of the 2000 steps costs 1. Broken once: judged
    by infinities alone -> fails.
    """
    reports = []
    method = {"name": "sarsa-lambda", "alpha": [0.25, 0.8, 3.0]}
    rl.run(
        rl.Experiment("windy-gridworld", method, seeds=40, steps=2000),
        tmp_path / "run",
        progress=reports.append,
    )
    alone = rl.run(rl.Experiment("windy-gridworld", method | {"alpha": 0.25}, seeds=40, steps=2000))
    with xr.open_datatree(tmp_path / "run" / "results.nc") as tree:
        ds = tree["sarsa-lambda"].to_dataset().load()
    bad = ~(abs(ds.q) <= 10 * 2000).all(("state", "action"))
    assert not bad.sel(alpha=0.25).any() and 0 < bad.sel(alpha=0.8).sum() < 40
    assert np.isfinite(ds.q.sel(alpha=0.8)).all() and not np.isfinite(ds.q.sel(alpha=3)).all()
    np.testing.assert_array_equal(ds.diverged, bad)
    assert reports[-1].diverged == bad.sum()
    np.testing.assert_array_equal(ds.q.sel(alpha=0.25), alone.datasets["windy-gridworld/sarsa-lambda"].q)
    assert cli.main(["resume", str(tmp_path / "run")]) == 0
    assert f"{int(bad.sum())} of 120 runs diverged" in capsys.readouterr().out


# --- Ctrl-C ------------------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.parametrize("number", slow_but_first([signal.SIGINT, signal.SIGTERM]))
def test_ctrl_c_keeps_the_finished_shards_and_says_how_to_go_on(tmp_path, number):
    out = tmp_path / "windy"
    with subprocess.Popen([*QUICK, *LONG.split(), str(out)], stderr=subprocess.PIPE, text=True) as running:
        while not (out / "shards").is_dir() or len(list((out / "shards").glob("*.npz"))) < 2:
            assert running.poll() is None
            time.sleep(0.01)
        begun = time.monotonic()
        running.send_signal(number)
        _, said = running.communicate()
    assert time.monotonic() - begun < 10
    assert running.returncode == 130
    kept = f"what is finished is kept, `jaxrl-tab resume {out}` goes on"
    assert said == f"jaxrl-tab: interrupted; {kept}\n"
    manifest = storage.read_manifest(out)
    assert manifest and 0 <= len(list((out / "shards").iterdir())) - len(manifest["shards"]) <= 1
    assert 1 <= len(manifest["shards"]) < 313


STUBBORN = """
import time; from jaxrl_tab.cli.interrupt import interruptible
with interruptible():
    print("ready", flush=True)
    while True:
        try: time.sleep(60)
        except KeyboardInterrupt: print("heard", flush=True)
"""
DEAF = """
import jax; from jaxrl_tab.cli.interrupt import interruptible
loop = lambda x: jax.lax.while_loop(lambda x: x >= 0, lambda x: (x * 3 + 1) % 7, x)
endless = jax.jit(loop).lower(1).compile()
with interruptible():
    print("ready", flush=True)
    endless(1).block_until_ready()
"""


@pytest.mark.parametrize("program", slow_but_first([STUBBORN, DEAF]))
def test_a_second_ctrl_c_and_compiled_code_that_does_not_hear_end_at_once(program):
    """One at the second signal, the other soon after the first. Broken once: nobody watches -> hangs."""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout and running.stderr
        assert running.stdout.readline() == "ready\n"
        time.sleep(0.5)  # until it is in the middle of what does not end
        running.send_signal(signal.SIGINT)
        if program == STUBBORN:
            assert running.stdout.readline() == "heard\n"
            running.send_signal(signal.SIGINT)
        begun = time.monotonic()
        assert "what is finished is kept" in running.stderr.read()
    assert running.returncode == 130
    assert time.monotonic() - begun < interrupt.PATIENCE + 5


def test_afterwards_signals_are_as_they_were():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with interrupt.interruptible():
        assert signal.getsignal(signal.SIGTERM) not in before
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


# --- the command -------------------------------------------------------------------------------------


def test_resume_prints_what_sweep_does(folder, capsys):
    assert cli.main(["resume", str(folder)]) == 0
    printed = capsys.readouterr()
    assert "on fresh" in printed.out and "the best of its method" in printed.out
    assert printed.err == ""
    assert cli.main(["resume", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["method"] for row in found["selection"]] == ["sarsa", "q-learning"]
    assert {"chosen_score", "fresh_score"} <= set(found["selection"][0])
    assert cli.main(["resume", str(folder), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert cli.main(["resume"]) == cli.main(["resume", str(folder / "shards")]) == 2
