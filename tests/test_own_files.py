"""Somebody's own files: those that a file imports are kept with it; and libraries from which environments come."""

import importlib.metadata
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import quick
from refusals import refused

import jaxrl_tab as rl
from jaxrl_tab import plot
from jaxrl_tab.core import modules, names
from jaxrl_tab.experiment import shards
from jaxrl_tab.methods import METHOD

# Sarsa whose steps are as long as the neighbours say: half of alpha, and a quarter of that where it is asked for.
MINE = """
import jaxrl_tab as rl
from helpers import half

@rl.pytree
class Mine(rl.Sarsa):
    def learn(self, state, t, delta):
        from later import quarter
        return super().learn(state, t, quarter(half(delta)))
"""
HELPERS = "def half(x):\n    import later\n\n    return x / 2\n"
LATER = "import helpers  # in a circle\n\ndef quarter(x):\n    return x / 4\n"
BUDGET = {"seeds": 3, "steps": 300}


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name, content in (("mine", MINE), ("helpers", HELPERS), ("later", LATER)):
        (tmp_path / f"{name}.py").write_text(content)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plot, "save_all", quick.picture)
    shards.forget_parts()
    yield tmp_path
    shards.forget_parts()


def experiment(name="mine.py:Mine", environment="random-walk"):
    return rl.Experiment(environment, {"name": name, "alpha": 0.5}, **BUDGET)


def final(experiment_or_folder, name="random-walk/Mine"):
    run = rl.run if isinstance(experiment_or_folder, rl.Experiment) else rl.resume
    return run(experiment_or_folder).datasets[name].q.values.tobytes()


def expected(alpha=0.5 / 8):
    """In floats, powers of two go in and out of a product as they are."""
    return final(
        rl.Experiment("random-walk", {"name": "sarsa", "alpha": alpha}, **BUDGET), "random-walk/sarsa"
    )


def lose_results(folder="run"):
    shutil.rmtree(f"{folder}/shards")
    shards.forget_parts()


# --- neighbours --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_files_that_a_file_imports_are_kept_and_loaded_with_it(here):
    """At its beginning, in a function, and in a circle. Broken once: only what is read at once is kept -> fails."""
    rl.run(experiment(), "run")
    for name in ("mine", "helpers", "later"):
        assert Path(f"run/sources/{name}.py").read_text() == Path(f"{name}.py").read_text()
        os.rename(f"{name}.py", f"gone-{name}.py")
    assert "helpers" not in sys.modules and "later" not in sys.modules
    lose_results()
    assert final("run") == expected()


def test_another_process_has_them_from_the_job(here):
    """Broken once: the job goes without its files -> fails."""
    one = experiment()
    Path("job").write_bytes(pickle.dumps(shards.Job(json.dumps(one.data()), None, files=one.files)))
    for name in ("mine", "helpers", "later"):
        os.remove(f"{name}.py")
    code = "import pickle, sys; sys.stdout.buffer.write(pickle.load(open('job', 'rb'))(0)['q'].tobytes())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True)
    assert done.stdout == expected(), done.stderr


@pytest.mark.slow
def test_a_changed_neighbour_is_another_file_and_stops_resume(here):
    """Broken once: neighbours are no part of the checksum -> fails."""
    first = names.find(METHOD, "mine.py:Mine").cls
    rl.run(experiment(), "run")
    lose_results()
    os.rename("later.py", "aside")
    refused(
        lambda: rl.resume("run"),
        f"{here}/later.py is missing: put it back as it was (its copy is run/sources/later.py), or rename "
        f"{here}/mine.py to go on with the copy",
    )
    os.rename("aside", "later.py")
    Path("later.py").write_text(LATER.replace("/ 4", "/ 2"))
    refused(
        lambda: rl.resume("run"),
        f"{here}/later.py was changed since: put it back as it was (its copy is run/",
    )
    assert names.find(METHOD, "mine.py:Mine").cls is not first
    assert final(experiment()) == expected(0.5 / 4)
    Path("later.py").write_text(LATER)
    Path("jax.py").write_text("")
    Path("jaxrl_tab.py").write_text("")
    refused(
        lambda: rl.resume("run"), f"{here}/mine.py imports {here}/jaxrl_tab.py, which was not there before"
    )
    os.remove("jaxrl_tab.py")
    assert final("run") == expected()


def test_an_altered_copy_of_a_neighbour_is_not_used(here):
    """Also where nothing says what the copies were. Broken once: only the copy of the file itself is looked at."""
    rl.run(experiment(), "run")
    lose_results()
    os.remove("mine.py")
    copy, index = Path("run/sources/later.py"), Path("run/sources/sources.json")
    copy.write_text(LATER.replace("/ 4", "/ 2"))
    checksum = modules.read(Path("later.py"), alone=True).sha256
    refused(
        lambda: rl.resume("run"),
        f"the copy of later.py in run/sources is missing or was altered: put the file back whose SHA-256 is {checksum}",
    )
    kept = index.read_text()
    index.write_text("x")
    refused(lambda: rl.resume("run"), "the copy of mine.py:Mine in run/sources is missing or was altered")
    index.write_text(kept)
    copy.unlink()
    refused(lambda: rl.resume("run"), "the copy of later.py in run/sources is missing or was altered")
    copy.symlink_to(here / "later.py")
    refused(lambda: rl.resume("run"), "run/sources/later.py is a link")
    copy.unlink()
    copy.write_text(LATER)
    assert final("run") == expected()


@pytest.mark.slow
def test_files_of_two_folders_do_not_mix(here):
    """Both have a file helpers.py. Broken once: all copies in one folder -> fails."""
    Path("other").mkdir()
    Path("other/mine.py").write_text(MINE)
    Path("other/helpers.py").write_text("def half(x):\n    return x\n")
    Path("other/later.py").write_text(LATER)
    methods = [
        {"name": name, "alpha": 0.5, "label": name[:1]} for name in ("mine.py:Mine", "other/mine.py:Mine")
    ]
    table = rl.interop.from_gymnasium("FrozenLake-v1")
    one = rl.Experiment(["random-walk", {"name": table, "label": "lake"}], methods, **BUDGET)
    rl.run(one, "run")
    copies = {path.relative_to("run/sources").as_posix() for path in Path("run/sources").rglob("*.py")}
    assert copies == {f"{place}{name}.py" for place in ("", "1/") for name in ("mine", "helpers", "later")}
    shutil.rmtree("other")
    os.remove("mine.py")
    lose_results()
    outcome = rl.resume("run").datasets
    assert outcome["random-walk/m"].q.values.tobytes() == expected()
    assert outcome["random-walk/o"].q.values.tobytes() == expected(0.5 / 4)


def test_a_package_beside_a_file_is_not_kept(here, monkeypatch):
    """Where Python finds it since it was started there; broken once: it is not looked for -> fails."""
    Path("pack").mkdir()
    Path("pack/__init__.py").write_text(
        "from pathlib import Path\nTEXT = (Path(__file__).parent / 'data').read_text()\n"
    )
    Path("pack/data").write_text("2")
    Path("mine.py").write_text(
        "import pack\n" + MINE.replace("quarter(half(delta))", "delta / int(pack.TEXT)")
    )
    refused(
        lambda: rl.run(experiment()),
        f"{here}/mine.py cannot be imported: ImportError, line 1: pack is a package beside it, and only files beside "
        "it are found",
    )
    monkeypatch.syspath_prepend(here)
    assert final(experiment()) == expected(0.25)
    refused(
        lambda: rl.run(experiment(), "run"),
        f"{here}/mine.py imports pack, a package beside it, of which no copy is kept: install it, or put what is "
        "needed of it into a file there; or run it without a folder",
    )
    assert not Path("run").exists()
    monkeypatch.setattr(sys, "path", ["", *sys.path])  # as what is installed for development
    rl.run(experiment(), "run")


def test_what_a_neighbour_does_wrong_is_said_of_the_neighbour(here):
    Path("helpers.py").write_text("\n1 / 0\n")
    refused(
        lambda: rl.run(experiment()), f"{here}/helpers.py cannot be imported: ZeroDivisionError, line 2: "
    )
    Path("helpers.py").write_text(
        "import jaxrl_tab as rl\nrl.sweep(rl.RandomWalk(), 'sarsa', num_seeds=1, num_steps=1)"
    )
    refused(
        lambda: rl.run(experiment()), f"{here}/helpers.py computes when it is imported: put all that it runs"
    )
    Path("helpers.py").write_text("this is no program")
    refused(lambda: rl.run(experiment()), f"{here}/helpers.py cannot be imported: SyntaxError, line 1: ")
    assert not [name for name in sys.modules if name.startswith("jaxrl_tab_file_helpers") and "_mine" in name]


def test_a_class_of_a_neighbour_is_found_in_its_own_file(here):
    Path("first.py").write_text("from mine import Mine\n")
    cls = names.find(METHOD, "first.py:Mine").cls
    reference = names.reference(METHOD, cls)
    assert reference.name == f"{here}/mine.py:Mine"
    assert reference.file == modules.read(Path("mine.py"))
    assert [x.name for x in reference.file.neighbours] == ["helpers.py", "later.py"]
    assert final(experiment(cls)) == expected()


# --- versions of libraries ---------------------------------------------------------------------------


@pytest.mark.slow
def test_another_version_of_a_library_stops_resume(here, monkeypatch):
    """Where an environment comes from it, and something is still to be computed.

    Broken once: versions are not compared; those of all libraries are -> each fails.
    """
    monkeypatch.setattr(shards, "SHARD_STEPS", 64 * 300)  # two shards
    name = "FrozenLake-v1/sarsa"
    lake, built_in = (
        rl.Experiment(env, "sarsa", seeds=70, steps=300) for env in ("gymnasium:FrozenLake-v1", "random-walk")
    )
    whole = rl.run(lake, "lake").datasets[name]
    rl.run(built_in, "built-in")
    os.remove("built-in/shards/000001.npz")
    version, now = importlib.metadata.version, importlib.metadata.version("gymnasium")
    session = json.loads(Path("lake/provenance.json").read_text())["sessions"][0]
    assert session["surroundings"]["gymnasium"] == now and "gymnax" not in session["surroundings"]
    assert f"<dt>gymnasium</dt><dd><span>{now}" in Path("lake/report.html").read_text()
    other = lambda name: "9.9" if name in ("gymnasium", "gymnax") else version(name)
    monkeypatch.setattr(importlib.metadata, "version", other)
    rl.resume("lake")  # all is there
    rl.resume("built-in")
    os.remove("lake/shards/000001.npz")
    changed = f"gymnasium was {now}, and is 9.9"
    refused(lambda: rl.resume("lake"), f"would not be computed as the rest was: {changed}; go on with")
    job = shards.Job(json.dumps(lake.data()), None, libraries={"gymnasium": now})
    refused(lambda: job(0), f"{changed} on ", ": install the same on all machines")
    assert rl.resume("lake", mixed=True).datasets[name].q.equals(whole.q)
    assert changed in Path("lake/report.html").read_text()


@pytest.mark.slow
def test_a_version_in_which_the_environment_is_another_one_is_named(here, monkeypatch):
    """Broken once: without it the folder is called damaged."""
    rl.run(experiment("sarsa", "gymnasium:FrozenLake-v1"), "lake")
    version, now = importlib.metadata.version, importlib.metadata.version("gymnasium")
    os.remove("lake/shards/000000.npz")
    arguments = rl.interop._module("gymnasium").arguments
    monkeypatch.setattr(
        rl.interop._module("gymnasium"), "arguments", lambda name: arguments(name) | {"new": 1}
    )
    monkeypatch.setattr(
        importlib.metadata, "version", lambda name: "9.9" if name == "gymnasium" else version(name)
    )
    refused(
        lambda: rl.resume("lake"), f"gymnasium was {now}, and is 9.9: install what it was, to go on in lake"
    )
