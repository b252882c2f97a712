"""What bits depend on beside the experiment: set where it can be, refused where it cannot, never mixed unsaid."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import quick

import jaxrl_tab as rl
from jaxrl_tab import plot
from jaxrl_tab.core import rng
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import provenance, room
from jaxrl_tab.experiment import records, runner, storage
from jaxrl_tab.experiment import shards as splitting

SHARDS = 64 * 200
WALK = rl.Experiment("random-walk", "sarsa", seeds=130, steps=200)  # three shards
OTHERWISE = {
    "jax_enable_x64": True,
    "jax_default_prng_impl": "rbg",
    "jax_threefry_partitionable": False,
    "jax_default_matmul_precision": "highest",
    "jax_random_seed_offset": 3,
}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Shards of 64 runs, and a picture that takes no time."""
    monkeypatch.setattr(splitting, "SHARD_STEPS", SHARDS)
    monkeypatch.setattr(plot, "save_all", quick.picture)
    splitting._shards.cache_clear()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("provenance") / "run"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(splitting, "SHARD_STEPS", SHARDS)
        patched.setattr(plot, "save_all", quick.picture)
        splitting._shards.cache_clear()
        rl.run(WALK, folder, command="a command")
    return folder


@pytest.fixture
def folder(whole, tmp_path):
    """The same, in which two of three shards are missing."""
    copy = Path(shutil.copytree(whole, tmp_path / "run"))
    for number in (0, 2):
        (copy / "shards" / f"00000{number}.npz").unlink()
    return copy


def shards(folder):
    """The arrays of all shards, but for the seconds they took."""
    return {
        (file.name, name): array
        for file in sorted((folder / "shards").iterdir())
        for name, array in np.load(file).items()
        if name not in ("about", "seconds")
    }


def assert_same(folder, other):
    one, two = shards(folder), shards(other)
    assert one.keys() == two.keys() and len(one) > 9
    for key in one:
        assert one[key].tobytes() == two[key].tobytes() and one[key].dtype == two[key].dtype, key


def sessions(folder):
    return json.loads((folder / "provenance.json").read_text())["sessions"]


# --- settings ----------------------------------------------------------------------------------------


def test_a_sweep_draws_from_the_same_generator_whatever_jax_is_set_to():
    """Broken once: `jax.random.key`, or the words of a run's stream as JAX is set to draw them -> fails."""
    env, given = rl.make("blackjack"), {"num_seeds": 3, "num_steps": 40}
    expected = rl.sweep(env, "q-learning", **given)
    with provenance.using({name: OTHERWISE[name] for name in OTHERWISE if "x64" not in name}):
        found = rl.sweep(env, "q-learning", **given)
        bits = jax.random.key_data(rng.key(2**31 - 1))
    np.testing.assert_array_equal(found.q, expected.q)
    np.testing.assert_array_equal(bits, jax.random.key_data(jax.random.key(2**31 - 1)))


def test_another_setting_in_the_same_process_is_another_program():
    """Shapes and types are the same here. Broken once: programs found by those alone -> fails."""
    one = room.signature((rng.key(0), rl.QLearning()))
    with provenance.using({"jax_default_matmul_precision": "highest"}):
        other = room.signature((rng.key(0), rl.QLearning()))
    assert one == room.signature((rng.key(0), rl.QLearning())) != other
    assert one._replace(settings=other.settings) == other


def test_resume_sets_what_it_can_and_sets_it_back(folder, whole):
    """Broken once: settings left as they are -> refused."""
    with provenance.using(OTHERWISE):
        rl.resume(folder)
        assert provenance.settings().items() >= OTHERWISE.items()
    assert_same(folder, whole)
    first, second = sessions(folder)
    assert first["surroundings"] == second["surroundings"] == provenance.surroundings()


@pytest.mark.slow
def test_so_does_the_command(folder, whole):
    """In a process that the variables of JAX have set up otherwise."""
    env = os.environ | {name.upper(): str(value) for name, value in OTHERWISE.items()}
    command = [sys.executable, quick.__file__, "resume", str(folder), "--quiet"]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    missing = "".join(f"shards/00000{i}.npz is missing: it is computed again\n" for i in (0, 2))
    assert (done.returncode, done.stderr.replace(missing, "")) == (0, "")
    assert_same(folder, whole)


# --- refused -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_changed_sources_and_flags_are_refused_in_a_line(folder, tmp_path):
    """The command, of a copy of the package in which one line is another one. Broken once: not compared -> 0."""
    shutil.copytree(provenance.PACKAGE, tmp_path / "changed" / "jaxrl_tab")
    file = tmp_path / "changed" / "jaxrl_tab" / "algorithms" / "q_learning.py"
    file.write_text(file.read_text() + "# one line more\n")
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_max_isa=SSE4_2"
    env = os.environ | {"PYTHONPATH": str(tmp_path / "changed"), "XLA_FLAGS": flags}
    before = (folder / "provenance.json").read_bytes()
    command = [sys.executable, quick.__file__, "resume", str(folder), "--quiet"]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""
    line = done.stderr.splitlines()[-1]
    assert line.startswith(f"jaxrl-tab: what is missing in {folder} would not be computed as the rest was: ")
    sources = provenance.sources()
    for said in (
        f"digest of jaxrl_tab's sources was {sources}, and is ",
        "XLA_FLAGS was without --xla_cpu_max_isa=SSE4_2, and is with it",
        f"begin a new folder with {folder / 'experiment.toml'}, or allow it with --mixed",
    ):
        assert said in line
    assert len(done.stderr.splitlines()) == 3  # and the two shards that are missing
    assert (folder / "provenance.json").read_bytes() == before


@pytest.fixture
def newer(monkeypatch):
    """Another version of JAX."""
    installed = provenance.installed()
    monkeypatch.setattr(provenance, "installed", lambda: installed | {"jax": "9.9"})


@pytest.mark.usefixtures("newer")
def test_mixed_numbers_are_allowed_and_told(folder, whole):
    """They are the same here, for it is not another JAX. Where they were allowed once, they are asked for again."""
    with pytest.raises(
        InputError, match=rf": jax was {jax.__version__}, and is 9.9; go on with what it was, or"
    ):
        rl.resume(folder)
    assert len(sessions(folder)) == 1
    rl.resume(folder, mixed=True)
    assert_same(folder, whole)
    assert [session["surroundings"]["jax"] for session in sessions(folder)] == [jax.__version__, "9.9"]
    report = (folder / "report.html").read_text()
    assert f"<dt>mixed</dt><dd><span>jax was {jax.__version__}, and is 9.9<" in report
    (folder / "shards" / "000002.npz").unlink()
    with pytest.raises(InputError, match=r"and is 9\.9"):
        rl.resume(folder)
    (folder / "shards" / "000001.npz").unlink()
    rl.resume(folder)  # for what is left is of this JAX


@pytest.mark.usefixtures("newer")
def test_what_is_computed_is_not_refused(whole, tmp_path, caplog):
    """Files are made again, with a line; where there is nothing to do, without."""
    folder = Path(shutil.copytree(whole, tmp_path / "run"))
    rl.resume(folder)
    assert caplog.text == ""
    (folder / "summary.csv").unlink()
    rl.resume(folder)
    said = f"only tables, pictures and report are made now; jax was {jax.__version__}, and is 9.9"
    assert [record.getMessage() for record in caplog.records][1:] == [said]
    report = "".join((folder / "report.html").read_text().split())
    assert f"<dt>jax</dt><dd><span>{jax.__version__}<" in report  # what the numbers are of


@pytest.mark.slow
def test_each_shard_says_what_it_was_computed_with(folder, whole):
    """Also where the records are gone, and where shards of another folder are put there."""
    other = folder.parent / "other"
    with provenance.using({"jax_default_matmul_precision": "highest"}):
        rl.run(WALK, other)
    shutil.copy(other / "shards" / "000000.npz", folder / "shards")
    (folder / "provenance.json").unlink()
    (folder / "manifest.json").unlink()
    with pytest.raises(InputError, match="what it was computed with is not recorded"):
        rl.resume(folder)
    (folder / "shards" / "000000.npz").unlink()
    rl.resume(folder)
    assert_same(folder, whole)


def test_folders_of_earlier_versions_are_refused_unless_they_are_finished(whole, tmp_path):
    """Their shards do not say what they were computed with."""
    folder = Path(shutil.copytree(whole, tmp_path / "run"))
    (folder / "manifest.json").unlink()
    for file in (folder / "shards").iterdir():
        arrays = dict(np.load(file))
        about = json.loads(str(arrays[storage.ABOUT]))
        del about["surroundings"]
        np.savez(file, **arrays | {storage.ABOUT: np.array(json.dumps(about))})
    rl.resume(folder)
    (folder / "shards" / "000001.npz").unlink()
    with pytest.raises(InputError, match="what it was computed with is not recorded; go on"):
        rl.resume(folder)
    rl.resume(folder, mixed=True)
    assert "what it was computed with is not recorded" in (folder / "report.html").read_text()


def without(name, folder, *numbers):
    """Makes shards of a folder ones that an earlier version wrote, which did not record this."""
    for number in numbers:
        file = folder / "shards" / f"00000{number}.npz"
        arrays = dict(np.load(file))
        del arrays[name]
        np.savez(file, **arrays)
    (folder / "manifest.json").unlink()


@pytest.mark.slow
def test_what_earlier_versions_did_not_record_is_not_missed(tmp_path):
    """Broken once: shards compared by all of their arrays -> called damaged, and set aside, even by `explain`."""
    folder = tmp_path / "run"
    new = rl.run(rl.Experiment("two-doors", "sarsa", seeds=70, steps=200, exact=True), folder)
    without("policy_value", folder, 0)  # of two shards, as after `resume(mixed=True)`
    runner.explain(folder)
    again = rl.resume(folder)
    one, other = new.datasets["two-doors/sarsa"], again.datasets["two-doors/sarsa"]
    assert "policy_value" in one and "policy_value" not in other
    np.testing.assert_array_equal(other.q_error, one.q_error)
    assert not (folder / "set-aside").exists()


def test_a_setting_that_cannot_be_set_is_refused(folder):
    """In a block of `jax.enable_x64`, which is stronger than what `resume` sets."""
    with (
        jax.enable_x64(True),
        pytest.raises(InputError, match="jax_enable_x64 must be False, and is set otherwise"),
    ):
        rl.resume(folder)
    assert not list(folder.glob("set-aside/*")) and not provenance.settings()["jax_enable_x64"]


# --- what is compared --------------------------------------------------------------------------------


def test_processors_are_alike_where_xla_is_told_to_use_no_more(monkeypatch):
    """An older and a newer one. Ages and models do not count, nor how many devices there are."""
    older = ["fpu", "sse4_2", "avx", "avx2", "fma"]
    found = {}
    for flags in ("", "--xla_cpu_max_isa=AVX2", "--xla_cpu_max_isa=sse4_2"):
        monkeypatch.setenv("XLA_FLAGS", flags)
        for features in (older, [*older, "avx512f", "avx_vnni", "amx_tile"]):
            monkeypatch.setattr(provenance, "features", lambda features=features: features)
            found[flags, len(features)] = provenance.instructions().split()[1:]
    assert found["", 5] == ["avx", "avx2", "fma", "sse4_2"]
    assert set(found["", 8]) - set(found["", 5]) == {"avx512f", "avx_vnni", "amx_tile"}
    assert found["--xla_cpu_max_isa=AVX2", 5] == found["--xla_cpu_max_isa=AVX2", 8] == found["", 5]
    assert found["--xla_cpu_max_isa=sse4_2", 5] == found["--xla_cpu_max_isa=sse4_2", 8] == ["sse4_2"]
    one = provenance.surroundings()
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_max_isa=sse4_2 --xla_force_host_platform_device_count=7")
    assert provenance.surroundings() == one


def test_the_commit_is_that_of_the_package(monkeypatch, tmp_path):
    """Not of the folder in which somebody works, nor of a repository around an environment."""
    monkeypatch.chdir(tmp_path)
    run = lambda *words, at: subprocess.run(
        ["git", "-C", at, *words], capture_output=True, text=True, check=True
    )
    here = Path(__file__).parent.parent
    expected = run("rev-parse", "HEAD", at=here).stdout.strip() if (here / ".git").exists() else None
    provenance.git_commit.cache_clear()
    assert (provenance.git_commit() or "").removesuffix("-dirty") == (expected or "")
    run("init", at=tmp_path)
    monkeypatch.setattr(provenance, "PACKAGE", tmp_path)
    (tmp_path / "__init__.py").write_text("")
    provenance.git_commit.cache_clear()
    assert provenance.git_commit() is None
    provenance.git_commit.cache_clear()


def test_a_library_that_comes_to_it_changes_no_number_that_is_there():
    """Where more environments are added. Another version of one that was there does; in whichever session it came.

    Broken once, each: a library that was not there is a change; only the first session is looked at -> fails.
    """
    now = provenance.surroundings()
    sessions = [{"surroundings": now}, {"surroundings": now | {"gymnasium": "1"}}]
    names = [provenance.digest(session["surroundings"]) for session in sessions]
    store = storage.Store.__new__(storage.Store)

    def of(count, library):
        store.shards = {i: SimpleNamespace(surroundings=name) for i, name in enumerate(names[:count])}
        return records.Origin.of(store, {"sessions": sessions[:count]}, False, {"gymnasium": library})

    assert of(1, "1").changed == of(2, "1").changed == []
    assert of(2, "2").changed == ["gymnasium was 1, and is 2"]
    assert records.mixture(sessions) == ""
    other = {"surroundings": now | {"jax": "0"}}
    assert records.mixture([*sessions, other]) == f"jax was {now['jax']}, and is 0"
    assert records.mixture(sessions[:1]) == records.NOT_RECORDED
