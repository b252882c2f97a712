"""Somebody's own classes and tables: wherever a name stands, in a folder, and in other processes."""

import importlib.metadata
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import quick
from refusals import refused

import jaxrl_tab as rl
from jaxrl_tab import cli, plot
from jaxrl_tab.core import modules, names
from jaxrl_tab.engine import programs, provenance
from jaxrl_tab.envs import ENVIRONMENT
from jaxrl_tab.experiment import shards
from jaxrl_tab.methods import METHOD

OWN = '''
"""An environment and a method of one's own."""
import jax.numpy as jnp
import jaxrl_tab as rl
from jaxrl_tab import Outcome, pytree, static, tables
from jaxrl_tab.envs import Finite

@pytree
class Coin(Finite):
    """Toss until it shows heads; every toss costs 1.

    Attributes:
        heads: how likely heads are.
    """

    heads: float = 0.5
    max_steps: int = static(default=100)
    num_states, num_actions = 2, 2

    def initial(self):
        return jnp.array([1.0, 0.0])

    def outcomes(self, s, a):
        over = s == 1
        heads = jnp.asarray(self.heads, float) / (1 + a)
        s_next = jnp.where(over, 1, jnp.array([1, 0]))
        return jnp.stack([heads, 1 - heads]), Outcome(s_next, jnp.where(over, 0.0, -jnp.ones(2)), s_next == 1)

@pytree
class Hasty(rl.Sarsa):
    """Sarsa that exaggerates.

    Attributes:
        haste: by what the error is multiplied.
    """

    haste: float = 1.0

    def update(self, key, state, t):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        q_next = tables.entry(state.q, t.s_next, a_next)
        delta = self.haste * (t.r + t.discount * q_next - tables.entry(state.q, t.s, t.a))
        return self.learn(state, t, delta), a_next
'''
BUDGET = {"seeds": 70, "steps": 200}  # two shards each, where they are small
TYPED = ["mine.py:Coin", "mine.py:Hasty", "--heads", "0.25", "--haste", "0.5", "1", "--alpha", "0.5"]
TYPED += ["--seeds", "70", "--steps", "200", "--select", "--quiet"]


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Shards of 64 runs, and a picture that takes no time; nothing is left in the registries."""
    monkeypatch.setattr(shards, "SHARD_STEPS", 64 * 200)
    monkeypatch.setattr(plot, "save_all", quick.picture)
    registries = [rl.ENVS, rl.ALGORITHMS, rl.PREDICTION]
    before = [dict(registry) for registry in registries]
    shards.forget_parts()
    yield
    shards.forget_parts()
    for registry, content in zip(registries, before, strict=True):
        registry.clear()
        registry |= content


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working directory with a file mine.py."""
    (tmp_path / "mine.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def experiment(**more):
    table = {"name": "mine.py:Hasty", "haste": [0.5, 1.0], "alpha": 0.5}
    coin = {"name": "mine.py:Coin", "heads": 0.25}
    return rl.Experiment(**({"environment": coin, "method": [table]} | BUDGET | more))


def expected():
    """What the classes give in Python, without an experiment."""
    cls = names.find(METHOD, "mine.py:Hasty").cls
    env = rl.make("mine.py:Coin", heads=0.25)
    result = rl.sweep(env, cls, {"haste": [0.5, 1.0], "alpha": 0.5}, num_seeds=70, num_steps=200)
    return result.to_xarray()


def check(ds, other):
    assert ds.q.values.tobytes() == other.q.values.tobytes()
    assert ds.returns.values.tobytes() == other.returns.values.tobytes()


# --- names -------------------------------------------------------------------------------------------


def test_a_name_stands_for_a_class_wherever_one_is_named(here, monkeypatch):
    coin = rl.make("mine.py:Coin", heads=0.25)
    assert coin.heads == 0.25 and type(coin).__name__ == "Coin"
    result = rl.sweep(coin, "mine.py:Hasty", {"haste": 0.5}, num_seeds=2, num_steps=20)
    assert (result.environment, result.algorithm) == ("Coin", "Hasty")
    package = here / "pack_of_own"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "inner.py").write_text(OWN)
    monkeypatch.syspath_prepend(here)
    reference = names.find(METHOD, "pack_of_own.inner:Hasty")
    assert reference.cls.__module__ == "pack_of_own.inner"
    again = names.reference(METHOD, reference.cls)  # as where the class is given, not its name
    assert again == reference


def test_the_same_file_is_one_module_and_a_changed_one_another(here):
    first = names.find(ENVIRONMENT, "mine.py:Coin").cls
    assert names.find(ENVIRONMENT, str(here / "mine.py") + ":Coin").cls is first
    (here / "mine.py").write_text(OWN + "\n")
    assert names.find(ENVIRONMENT, "mine.py:Coin").cls is not first


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.py:Coin", "there is no file none.py"),
        ("mine.py:Con", "there is no 'Con' in mine.py; did you mean 'Coin'?"),
        ("mine.py", "mine.py is a file: name what is in it as well, as in 'mine.py:NAME'"),
        (
            "mine.py:Hasty",
            "mine.py:Hasty is not an environment: it has no num_states, num_actions, max_steps, ",
        ),
        ("mine.py:Hasty", "; it is a method"),
        ("mine.py:jnp", "mine.py:jnp is not a class"),
        ("raises.py:Coin", "raises.py cannot be imported: ZeroDivisionError, line 2: division by zero"),
        ("text.py:Coin", "text.py cannot be imported: SyntaxError, line 1: "),
        ("bare.py:Coin", "bare.py:Coin is not a JAX pytree: decorate the class with jaxrl_tab.pytree"),
        ("no_such_module:Coin", "no_such_module cannot be imported: ModuleNotFoundError: No module named"),
        ("none.npz", "there is no file none.npz"),
        ("mine.npz", "is not a table that FiniteMDP.save wrote"),
        ("gymnasium:Taxi-v99", "gymnasium: Environment version `v99` for environment `Taxi` doesn't exist."),
        ("coin", "'coin' is not an environment; "),
    ],
)
def test_what_a_name_does_not_stand_for_is_said_in_one_line(here, name, message, capsys):
    (here / "raises.py").write_text("\n1 / 0")
    (here / "text.py").write_text("this is no program")
    (here / "bare.py").write_text(OWN.replace("@pytree", ""))
    (here / "mine.npz").write_bytes(b"nothing")
    refused(lambda: rl.make(name), message)
    refused(lambda: rl.Experiment(name, "sarsa", **BUDGET), message)
    for command in (["solve", name], ["sweep", name, "sarsa"]):
        assert cli.main(command) == 2
        assert message in capsys.readouterr().err


def test_a_parameter_that_must_be_given_and_one_that_the_class_refuses(here):
    (here / "needs.py").write_text(
        OWN.replace("heads: float = 0.5", "heads: float").replace("class Hasty", "class Other")
        + "\n    def __post_init__(self):\n        raise ValueError('never')\n"
    )
    refused(lambda: rl.make("needs.py:Coin"), "needs.py:Coin: missing a required argument: 'heads'")
    assert rl.make("needs.py:Coin", heads=1.0).heads == 1.0
    refused(lambda: rl.sweep(rl.make("random-walk"), "needs.py:Other", num_seeds=1, num_steps=1), "never")


def test_registered_names(here, capsys):
    """Broken once: a taken name overwrites -> fails."""
    coin, hasty = (names.find(k, f"mine.py:{c}").cls for k, c in ((ENVIRONMENT, "Coin"), (METHOD, "Hasty")))
    rl.register("coin", coin)
    rl.register("hasty", hasty)
    assert rl.ENVS["coin"] is coin and rl.ALGORITHMS["hasty"] is hasty
    assert type(rl.make("coin")) is coin
    refused(lambda: rl.register("coin", coin), "the name 'coin' is taken; choose another one")
    refused(lambda: rl.register("sarsa", hasty), "the name 'sarsa' is taken")
    refused(lambda: rl.register("x", int), "int is not a method: it has no gamma")
    refused(lambda: rl.register("a:b", hasty), "a name has letters, digits, hyphens and dots")
    assert cli.main(["list"]) == 0
    listed = capsys.readouterr().out
    assert "hasty" in listed and "Toss until it shows heads" in listed
    data = rl.Experiment("coin", "hasty", **BUDGET).data()
    assert data["method"][0]["name"].endswith("mine.py:Hasty") and data["method"][0]["label"] == "hasty"


def test_entry_points_are_read_when_a_name_is_not_built_in(here, monkeypatch, capsys):
    (here / "points_of_own.py").write_text(OWN)
    monkeypatch.syspath_prepend(here)
    points = [
        importlib.metadata.EntryPoint("coin-toss", "points_of_own:Coin", "jaxrl_tab.environments"),
        importlib.metadata.EntryPoint("hasty", "points_of_own:Hasty", "jaxrl_tab.methods"),
        importlib.metadata.EntryPoint("gone", "points_of_own:Gone", "jaxrl_tab.methods"),
    ]
    asked = []

    def entry_points(group, name=None):
        asked.append(name)
        return [x for x in points if x.group == group and name in (None, x.name)]

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    rl.make("random-walk")
    assert not asked
    assert type(rl.make("coin-toss")).__name__ == "Coin"
    data = rl.Experiment("coin-toss", "hasty", **BUDGET).data()
    assert [data[key][0]["name"] for key in ("environment", "method")] == [
        "points_of_own:Coin",
        "points_of_own:Hasty",
    ]
    assert cli.main(["list"]) == 0
    listed = capsys.readouterr().out
    assert "coin-toss" in listed and "hasty" in listed
    assert "not available: gone: there is no 'Gone' in points_of_own" in listed


# --- tables, and other libraries ---------------------------------------------------------------------


def test_a_table_in_a_file(here, capsys):
    """Broken once: without the check of what is loaded -> fails, for a successor is no state."""
    mdp = rl.interop.from_gymnasium("FrozenLake-v1")
    mdp.save("lake.npz")
    again = rl.make("lake.npz")
    for x, y in zip(jax.tree.leaves(mdp), jax.tree.leaves(again), strict=True):
        assert x.dtype == y.dtype and x.tobytes() == y.tobytes()
    assert again.max_steps == mdp.max_steps
    assert cli.main(["solve", "lake.npz", "--json"]) == 0
    solved = json.loads(capsys.readouterr().out)
    assert solved["optimal"]["start_value"] == pytest.approx(
        rl.planning.start_value(mdp, rl.planning.value_iteration(mdp)[0])
    )
    refused(lambda: mdp.save("lake.txt"), "must end in .npz")
    with np.load("lake.npz") as arrays:
        wrong = dict(arrays) | {"successors": arrays["successors"] + 1}
    np.savez("wrong.npz", **wrong)
    refused(
        lambda: rl.make("wrong.npz"),
        "wrong.npz is not a table that FiniteMDP.save wrote",
        "there is no successor 16",
    )
    typed = ["--alpha", "0.5", "--seeds", "2", "--steps", "50", "--quiet"]
    assert cli.main(["sweep", "lake.npz", "sarsa", *typed, "--out", "typed"]) == 0
    os.remove("lake.npz")
    table = {"name": "sarsa", "alpha": 0.5}
    given = rl.run(rl.Experiment(mdp, table, seeds=2, steps=50), "given")
    check(rl.resume("typed").datasets["lake/sarsa"], given.datasets["FiniteMDP/sarsa"])
    check(rl.resume("given").datasets["FiniteMDP/sarsa"], given.datasets["FiniteMDP/sarsa"])


@pytest.mark.slow
def test_environments_of_other_libraries_with_their_arguments(here, capsys):
    """On the command line and in a file: the same as `from_gymnasium` gives."""
    name = "gymnasium:FrozenLake-v1"
    values = []
    for option in ([], ["--is-slippery", "false"], ["--is-slippery", "false", "--desc", '["SFG"]']):
        assert cli.main(["solve", name, *option, "--gamma", "0.5", "--json"]) == 0
        values.append(json.loads(capsys.readouterr().out)["optimal"]["start_value"])
    assert values[1:] == [0.5**5, 0.5] and values[0] < values[1]  # 6 and 2 steps to a reward of 1
    Path("x.toml").write_text(
        f'seeds = 2\nsteps = 20\nmethod = "sarsa"\n[[environment]]\nname = "{name}"\nis_slippery = false\n'
        f'desc = ["SFG"]\n'
    )
    loaded = rl.Experiment.load("x.toml")
    (part,) = loaded.parts().values()
    assert part.env.num_states == 3 and part.env.num_actions == 4
    assert list(loaded.parts()) == ["FrozenLake-v1/sarsa"]
    assert rl.Experiment.from_data(loaded.data()).data() == loaded.data()
    assert rl.make("gymnax:FourRooms-misc", fail_prob=0.0).prob.max() == 1
    refused(lambda: rl.make(name, slippery=1), "has no parameter 'slippery'; did you mean 'is_slippery'?")


# --- experiments -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_typed_killed_resumed_and_selected(here, capsys):
    """The same, to the last bit, as the classes give in Python; though the file is gone in between."""
    code = (
        f"import sys; sys.path.insert(0, {os.path.dirname(__file__)!r}); import quick; quick.make_quick(); "
    )
    code += f"from jaxrl_tab import cli; cli.main({['sweep', *TYPED, '--out', 'run']!r})"
    process = subprocess.Popen([sys.executable, "-c", code])
    while not list(Path("run/shards").glob("0*.npz")):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not Path("run/report.html").exists()
    os.rename("mine.py", "elsewhere.py")
    outcome = rl.resume("run")
    assert Path("run/report.html").exists() and Path("run/sources/mine.py").read_text() == OWN
    assert "Hasty" in Path("run/report.html").read_text()
    os.rename("elsewhere.py", "mine.py")
    check(outcome.datasets["Coin/Hasty"], expected())
    assert outcome.fresh["Coin/Hasty"].sizes["seed"] == 70


def test_options_with_help(here, capsys):
    with pytest.raises(SystemExit):
        cli.main(["sweep", "mine.py:Coin", "mine.py:Hasty", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "--haste X [X ...] by what the error is multiplied. (of mine.py:Hasty; default: 1)" in text
    assert "--heads X [X ...] how likely heads are. (of mine.py:Coin; default: 0.5)" in text
    assert cli.main(["sweep", "random-walk", "mine.py:Hasty", "--hast", "1"]) == 2
    assert "there is no option --hast; did you mean '--haste'?" in capsys.readouterr().err


@pytest.mark.slow
def test_paths_in_a_file_start_from_its_folder(here):
    Path("deep").mkdir()
    Path("deep/x.toml").write_text(
        'seeds = 70\nsteps = 200\nenvironment = "../mine.py:Coin"\n\n[[method]]\nname = "../mine.py:Hasty"\n'
    )
    loaded = rl.Experiment.load("deep/x.toml")
    assert list(loaded.parts()) == ["Coin/Hasty"]
    outcome = rl.run(loaded, "run")
    assert rl.resume("run").datasets.keys() == outcome.datasets.keys()
    Path("deep/x.toml").write_text(
        'seeds = 70\nsteps = 200\nenvironment = "../mine.py:Coin"\nmethod = "nine.py:X"'
    )
    refused(lambda: rl.Experiment.load("deep/x.toml"), "deep/x.toml, line 4: there is no file deep/nine.py")


@pytest.mark.slow
def test_classes_and_instances(here):
    """What is given in Python is the same as what is named. Broken once: an instance's fields are left out."""
    coin, hasty = (names.find(k, f"mine.py:{c}").cls for k, c in ((ENVIRONMENT, "Coin"), (METHOD, "Hasty")))
    swept = {"name": hasty, "haste": [0.5, 1.0], "alpha": 0.5}
    first = rl.Experiment(coin(heads=0.25), swept, **BUDGET)
    assert first.data() == rl.Experiment({"name": coin, "heads": 0.25}, swept, **BUDGET).data()
    assert first.data()["environment"] == [
        {
            "name": f"{here}/mine.py:Coin",
            "label": "Coin",
            "sha256": modules.read(Path("mine.py")).sha256,
            "heads": 0.25,
            "max_steps": 100,
        }
    ]
    check(rl.run(first).datasets["Coin/Hasty"], expected())
    labelled = [{"name": hasty(haste=x, alpha=0.5), "label": str(x)} for x in (0.5, 1.0)]
    outcome = rl.run(rl.Experiment(coin(heads=0.25), labelled, **BUDGET), "run")
    for haste in (0.5, 1.0):
        check(outcome.datasets[f"Coin/{haste}"], expected().sel(haste=haste))
    built_in = rl.Experiment(
        rl.WindyGridworld(moves="king"), rl.Sarsa(alpha=0.25, epsilon=rl.schedules.glie()), **BUDGET
    )
    same = rl.Experiment(
        {"name": "windy-gridworld", "moves": "king"},
        {"name": "sarsa", "alpha": 0.25, "epsilon": "glie"},
        **BUDGET,
    )
    assert built_in.data() == same.data() and built_in.fingerprint == same.fingerprint


@rl.pytree
class Slope(rl.envs.Finite):
    """Arrays for fields: leaves of two types, and a static tuple."""

    costs: jax.Array
    rows: tuple = rl.static(default=((0, 1), (1, 0)))
    max_steps: int = rl.static(default=50)
    num_states, num_actions = 2, 1

    def initial(self):
        return jnp.array([1.0, 0.0])

    def outcomes(self, s, a):
        return jnp.ones(1), rl.Outcome(
            jnp.ones(1, int), -jnp.asarray(self.costs, float)[s][None], jnp.ones(1, bool)
        )


def test_arrays_are_recorded_with_their_type(here):
    """Broken once: without the type a third is another number -> fails."""
    slope = Slope(np.array([1 / 3, 0], np.float32), rows=((1, 2), (3, 4)))
    made = rl.Experiment(slope, "sarsa", **BUDGET)
    assert made.data()["environment"][0]["costs"]["dtype"] == "float32"
    Path("x.toml").write_text(made.to_toml())
    for again in (
        made,
        rl.Experiment.load("x.toml"),
        rl.Experiment.from_data(json.loads(json.dumps(made.data()))),
    ):
        (part,) = again.parts().values()
        assert part.env.costs.tobytes() == slope.costs.tobytes() and part.env.rows == slope.rows


def test_what_cannot_be_saved_is_refused_where_there_is_a_folder(here, monkeypatch):
    @rl.pytree
    class Inner(rl.Sarsa):
        pass

    @rl.pytree
    class Odd(Slope):
        how: object = rl.static(default=None)

    notebook = type(sys)("__main__")
    exec(OWN, vars(notebook))
    monkeypatch.setitem(sys.modules, "__main__", notebook)
    advice = "put it into a file of its own, and name it 'file.py:NAME'; or run it without a folder"
    for environment, method, message in (
        ("random-walk", Inner, "Inner is made inside a function: "),
        (notebook.Coin(), "sarsa", "Coin is made in a notebook or at a prompt: "),
        (
            Odd(np.zeros(2), how=lambda: 1),
            "sarsa",
            "this Odd cannot be made again from its class and its fields: ",
        ),
    ):
        one = rl.Experiment(environment, method, seeds=2, steps=20)
        assert refused(lambda one=one: rl.run(one, "run"), message).endswith(advice)
        assert not Path("run").exists()
        (ds,) = rl.run(one).datasets.values()
        assert ds.sizes["seed"] == 2


@pytest.mark.slow
def test_a_script_is_saved_by_its_file_and_must_be_guarded(here):
    """Broken once: without the check the script runs itself a second time -> fails."""
    run = "rl.run(rl.Experiment(Coin(), Hasty, seeds=2, steps=20), 'run')"
    Path("guarded.py").write_text(f"{OWN}\nif __name__ == '__main__':\n    {run}\n")
    Path("unguarded.py").write_text(f"{OWN}\n{run}\n")
    done = subprocess.run([sys.executable, "guarded.py"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert Path("run/sources/guarded.py").is_file()
    assert list(rl.resume("run").datasets) == ["Coin/Hasty"]
    shutil.rmtree("run")
    done = subprocess.run([sys.executable, "unguarded.py"], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].endswith(
        'unguarded.py computes when it is imported: put all that it runs below `if __name__ == "__main__":`'
    )
    assert not Path("run").exists()


def test_a_copy_or_a_file_that_was_changed_stops_resume(here):
    """Broken once: checksums of copies are not compared -> fails."""
    rl.run(experiment(), "run")
    os.remove("run/results.nc")
    Path("mine.py").write_text(OWN + "\n")
    refused(
        lambda: rl.resume("run"),
        f"{here}/mine.py was changed since: put it back as it was (its copy is run/sources/mine.py), "
        "or rename it to go on with the copy",
    )
    os.remove("mine.py")
    Path("run/sources/mine.py").write_text(OWN.replace("-jnp.ones", "jnp.ones"))
    refused(lambda: rl.resume("run"), "the copy of mine.py in run/sources is missing or was altered")
    Path("run/sources/mine.py").write_text(OWN)
    for damaged in ("run/resolved.json", "run/experiment.toml", "run/sources/sources.json"):
        before = Path(damaged).read_text()
        Path(damaged).write_text("x")
        assert list(rl.resume("run").datasets) == ["Coin/Hasty"]
        Path(damaged).write_text(before)


@pytest.mark.slow
def test_a_module_that_was_changed_stops_resume(here, monkeypatch):
    package = here / "changing_own"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "inner.py").write_text(OWN)
    monkeypatch.syspath_prepend(here)
    rl.run(rl.Experiment("changing_own.inner:Coin", "changing_own.inner:Hasty", **BUDGET), "run")
    assert Path("run/sources/inner.py").read_text() == OWN
    assert list(rl.resume("run").datasets) == ["Coin/Hasty"]
    (package / "inner.py").write_text(OWN + "\n")
    refused(
        lambda: rl.resume("run"),
        "inner.py was changed since: put it back as it was (its copy is run/sources/",
    )


@pytest.mark.slow
def test_another_process_loads_what_goes_along(here, tmp_path):
    """A job that is pickled needs nothing of the process, or the folder, in which it was made."""
    import pickle

    one = experiment()
    job = shards.Job(json.dumps(one.data()), None, files=one.files)
    Path("job").write_bytes(pickle.dumps(job))
    os.remove("mine.py")
    code = "import pickle, sys; job = pickle.load(open('job', 'rb')); print(list(job.parts), len(job.shards))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split("\n")[0].startswith("['Coin/Hasty']"), done.stderr


# --- compiled programs -------------------------------------------------------------------------------


def test_programs_of_own_classes_are_not_kept(here, tmp_path, monkeypatch):
    """A changed file must never be served what was compiled from another. Broken once: all modules are known."""
    monkeypatch.setattr(programs, "_folder", tmp_path)
    hasty = names.find(METHOD, "mine.py:Hasty").cls()
    assert programs._file((hasty, 1)) is None
    assert programs._file((rl.make("mine.py:Coin"), 1)) is None
    assert programs._file((rl.Sarsa(), 1)) is not None


@pytest.mark.slow
def test_the_digest_of_the_sources_covers_every_file_in_every_wing(tmp_path, monkeypatch):
    """Broken once: only the files of one folder are read -> fails."""
    package = tmp_path / "package"
    shutil.copytree(provenance.PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    assert package.joinpath("__init__.py").read_text().startswith('"""Tabular reinforcement-learning')
    monkeypatch.setattr(provenance, "PACKAGE", package)
    digest = provenance.sources.__wrapped__
    before = digest()
    assert before == provenance.sources()
    files = sorted(package.rglob("*.py"))
    assert {file.relative_to(package).parts[0] for file in files} >= {"core", "engine", "cli", "experiment"}
    for file in files:
        content = file.read_bytes()
        file.write_bytes(content + b"#")
        assert digest() != before, file
        file.write_bytes(content)
    assert digest() == before
