"""What an experiment records by a function of somebody's own: in its folder, its shards and its plan."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import quick

import jaxrl_tab as rl
from jaxrl_tab import cli, export, plot
from jaxrl_tab.core import memory
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.experiment import plan, shards

OWN = """
import jax.numpy as jnp

def q_of_start(state):
    q = state.q[30]
    return {"q_start": q, "at_step": state.clock.step, "tried": state.q < 0, "odd": jnp.stack([q[0] / 0, q[0] * 0 / 0])}

def raises(state):
    return {"x": [0][state.q.shape[0]]}

def of_the_step(state):
    return {"x": jnp.ones(state.clock.step)}

Number = 5
"""
SARSA = {"name": "sarsa", "alpha": [0.25, 0.5]}
BUDGET = {"seeds": 70, "steps": 250}  # two shards, where they are small; rows of 100, 100 and 50 steps


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working directory with a file mine.py; shards of 64 runs, and a picture that takes no time."""
    (tmp_path / "mine.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shards, "SHARD_STEPS", 64 * 250)
    monkeypatch.setattr(plot, "save_all", quick.picture)
    shards.forget_parts()
    yield tmp_path
    shards.forget_parts()


def experiment(record="mine.py:q_of_start", **more):
    return rl.Experiment(
        **({"environment": "windy-gridworld", "method": SARSA, "record": record} | BUDGET | more)
    )


def check_the_same(ds, other):
    assert set(ds.variables) == set(other.variables)
    for name, x in ds.variables.items():
        assert (x.dims, x.dtype) == (other[name].dims, other[name].dtype), name
        assert x.values.tobytes() == other[name].values.tobytes(), name


@pytest.mark.slow
def test_numbers_are_those_of_the_learner_at_the_end_of_each_row(here):
    """Those of a row are the final ones of a run that ends with it, for a run is the same however long it is.

    Broken once: what is recorded is left out where shards are put together -> fails.
    """
    ds = rl.run(experiment()).datasets["windy-gridworld/sarsa"]
    assert ds.q_start.dims == ("alpha", "seed", "row", "q_start_0")
    assert ds.tried.dims == ("alpha", "seed", "row", "tried_0", "tried_1") and ds.tried.dtype == bool
    assert ds.at_step.dtype == np.int32
    np.testing.assert_array_equal(ds.at_step, np.broadcast_to([100, 200, 250], (2, 70, 3)))
    for row, steps in enumerate((100, 200, 250)):
        q = rl.run(experiment(None, steps=steps)).datasets["windy-gridworld/sarsa"].q.values
        np.testing.assert_array_equal(ds.q_start[..., row, :], q[:, :, 30])
        np.testing.assert_array_equal(ds.tried[..., row, :, :], q < 0)
    # What is not finite is recorded as it is, and says nothing about the learner.
    assert np.isneginf(ds.odd[..., 2, 0]).any() and np.isnan(ds.odd[..., 1]).all() and not ds.diverged.any()


@pytest.mark.slow
def test_killed_and_resumed_the_same_and_the_same_in_the_file(here):
    """Broken once: without the forms of recorded arrays in `_shapes` every shard is taken for damaged -> fails."""
    whole = rl.run(experiment(), "whole", progress=False).datasets["windy-gridworld/sarsa"]

    def kill(state):
        if list(Path("run/shards").glob("*.npz")):  # some runs are told of before their shard is written
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rl.run(experiment(), "run", progress=kill)
    kept = {path: path.stat().st_mtime_ns for path in Path("run/shards").iterdir()}
    assert 0 < len(kept) < len(list(Path("whole/shards").iterdir()))
    os.rename("mine.py", "elsewhere.py")
    check_the_same(rl.resume("run").datasets["windy-gridworld/sarsa"], whole)
    assert kept == {path: path.stat().st_mtime_ns for path in kept}
    assert Path("run/sources/mine.py").read_text() == OWN
    for folder in ("run", "whole"):
        check_the_same(export.load(f"{folder}/results.nc")["sarsa"].load(), whole)
    table = export.to_pandas(whole, per="seed")
    assert (table.final_at_step == 250).all() and "final_q_start" not in table


def test_typed_in_a_file_and_in_python_are_the_same(here):
    """Broken once: the function's checksum is not in the data -> fails."""
    function = experiment().references["mine.py:q_of_start"].cls
    given = experiment(function)
    assert given.data()["record"]["name"] == f"{here}/mine.py:q_of_start"
    assert given.data()["record"]["sha256"] == experiment().data()["record"]["sha256"]
    Path("x.toml").write_text(
        'seeds = 70\nsteps = 250\nrecord = "mine.py:q_of_start"\nenvironment = "windy-gridworld"\n'
        '[[method]]\nname = "sarsa"\nalpha = [0.25, 0.5]\n'
    )
    assert rl.Experiment.load("x.toml").fingerprint == experiment().fingerprint
    Path("y.toml").write_text(experiment().to_toml())
    assert rl.Experiment.load("y.toml").fingerprint == experiment().fingerprint
    assert rl.Experiment.from_data(json.loads(json.dumps(experiment().data()))) == experiment()
    assert "record" not in experiment(None).data()
    typed = ["sweep", "windy-gridworld", "sarsa", "--alpha", "0.25", "0.5", "--seeds", "70", "--steps", "250"]
    typed += ["--record", "mine.py:q_of_start", "--select", "--quiet"]
    assert cli.main([*typed, "--out", "run"]) == 0
    fresh = export.load("run/fresh.nc")["sarsa"]
    np.testing.assert_array_equal(fresh.at_step, np.broadcast_to([100, 200, 250], (70, 3)))
    check_the_same(
        export.load("run/results.nc")["sarsa"].load(), rl.run(given).datasets["windy-gridworld/sarsa"]
    )
    assert cli.main(["sweep", "x.toml", "--record", "mine.py:q_of_start"]) == 2


@pytest.mark.slow
def test_another_process_loads_the_function(here):
    one = experiment()
    Path("job").write_bytes(pickle.dumps(shards.Job(json.dumps(one.data()), None, files=one.files)))
    os.remove("mine.py")
    code = "import pickle; job = pickle.load(open('job', 'rb')); print(job(0)['recorded.q_start'].shape)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip().endswith("(140, 3, 4)"), done.stderr  # all runs, for shards are large there


def test_its_bytes_are_in_the_plan_and_in_the_size_of_shards(here):
    """A row has 4 + 1 numbers of 4 bytes, 70 x 4 of one byte, and 2 of 4. Broken once: shards as without -> fails."""
    with_it, without = (
        plan.plan(experiment(record).parts()).parts for record in ("mine.py:q_of_start", None)
    )
    (found,), (other,) = with_it.values(), without.values()
    assert found.results - other.results == 140 * 3 * (5 * 4 + 280 + 2 * 4)
    assert found.working > other.working
    (part,), (bare,) = experiment().parts().values(), experiment(None).parts().values()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "SHARD_STEPS", 2**40)
        patch.setattr(shards, "SHARD_BYTES", 128 * 4 * (280 + 3 * 7))
        assert shards.shard_runs(bare) == 128
        patch.setattr(shards, "SHARD_BYTES", 192 * 4 * (280 + 3 * (7 + 287)))
        assert shards.shard_runs(part) == 192
    room = memory.size(jax.ShapeDtypeStruct((), np.float32)) * 64 * 280
    with pytest.raises(InputError, match="runs at a time on each device"):
        rl.run(experiment(), memory=room)


@pytest.mark.slow
def test_large_arrays_of_all_types_are_in_the_file(here, monkeypatch):
    """Those that are written piece by piece, too. Broken once: true and false piece by piece -> fails."""
    monkeypatch.setattr(memory, "BLOCK", 1000)
    Path("types.py").write_text(
        "import jax.numpy as jnp\ndef types(state):\n    n = state.clock.step\n    return {'yes': state.q < 0, "
        "'small': n.astype('int8'), 'plus': n.astype('uint32'), 'python': 1.5}"
    )
    ds = rl.run(experiment("types.py:types"), "run").datasets["windy-gridworld/sarsa"]
    check_the_same(export.load("run/results.nc")["sarsa"].load(), ds)
    assert (
        ds.python.dims == ("alpha", "seed", "row")
        and ds.small.dtype == np.int8
        and (ds.plus[..., 2] == 250).all()
    )


def bad(what):
    return lambda state: {"x": what}


MUST = "record: x must be a number or an array of numbers, not "


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (bad("text"), f"{MUST}'text'"),
        (bad({"y": 1}), f"{MUST}{{'y': 1}}"),
        (bad(None), f"{MUST}None"),
        (bad(jnp.ones((3, 0))), f"{MUST}float32[3, 0]"),
        (bad(1j), f"{MUST}complex64[]"),
        (bad(jnp.ones(2, jnp.bfloat16)), f"{MUST}bfloat16[2]"),
        (bad(jnp.ones(2, jnp.float16)), f"{MUST}float16[2]"),
        (bad(jax.random.key(0)), f"{MUST}key<fry>[]"),
        (lambda state: None, "record must be a function from the state of the learner to a dict of arrays"),
        (lambda state: {"alpha": 1}, "record: 'alpha' is already a name in the results; choose another one"),
        (lambda state: {"state": 1}, "record: 'state' is already a name in the results; choose another one"),
        (
            lambda state: {"x": state.q, "x_1": 1},
            "record: 'x_1' is already a name in the results; choose another one",
        ),
        (
            lambda state: {5: 1},
            "record: a name has letters, digits, '_', '-' and '.', such as 'q_start', not 5",
        ),
        (
            lambda state: {"a/b": 1},
            "record: a name has letters, digits, '_', '-' and '.', such as 'q_start', not 'a/b'",
        ),
        (lambda state: state.nothing, "record: <lambda> raised AttributeError: "),
        (lambda state: {"x": 1 / 0}, "record: <lambda> raised ZeroDivisionError: division by zero"),
        (lambda state: {"x": state.q[state.q > 0]}, "record: <lambda> raised NonConcreteBooleanIndexError: "),
    ],
)
def test_what_cannot_be_recorded_is_one_line_before_anything_is_compiled(record, message, windy, monkeypatch):
    monkeypatch.setattr(jax.stages.Lowered, "compile", lambda *_: pytest.fail("something is compiled"))
    for run in (
        lambda: rl.train(jax.random.key(0), rl.Sarsa(), windy, num_steps=10, record=record),
        lambda: rl.sweep(windy, "sarsa", num_seeds=2, num_steps=10, record=record),
        lambda: rl.run(experiment(record)),
    ):
        with pytest.raises(InputError) as error:
            run()
        assert str(error.value).startswith(message) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mine.py:q_of_star", "line 3: there is no 'q_of_star' in mine.py; did you mean 'q_of_start'?"),
        ("mine.py:Number", "line 3: mine.py:Number is not a function"),
        ("mine.py", "line 3: mine.py is a file: name what is in it as well, as in 'mine.py:NAME'"),
        ("none.py:x", "line 3: there is no file none.py"),
        (
            "q",
            "line 3: 'q' is not a function that records; give a function, or its name, 'file.py:function' or ",
        ),
        ("mine.py:raises", "line 3: record: raises raised IndexError: list index out of range"),
        (
            "mine.py:of_the_step",
            "line 3: record: of_the_step raised TypeError: Shapes must be 1D sequences of",
        ),
    ],
)
def test_what_a_file_names_wrong_is_said_with_its_line(here, name, message, capsys):
    Path("x.toml").write_text(
        f'steps = 10\nseeds = 2\nrecord = "{name}"\nenvironment = "windy-gridworld"\nmethod = "sarsa"\n'
    )
    assert cli.main(["sweep", "x.toml", "--dry-run"]) == 2
    line = capsys.readouterr().err
    assert message in line and line.count("\n") == 1
    assert cli.main(["sweep", "windy-gridworld", "sarsa", "--record", name, "--dry-run"]) == 2
    assert message.removeprefix("line 3: ") in capsys.readouterr().err


@pytest.mark.slow
def test_what_cannot_be_saved_is_refused_where_there_is_a_folder(here):
    """It runs without one. Broken once: no refusal of what is below a function -> fails."""
    inner = lambda state: {"best": state.q.max()}
    advice = "put it into a file of its own, and name it 'file.py:NAME'; or run it without a folder"
    with pytest.raises(InputError) as error:
        rl.run(experiment(inner), "run")
    assert str(error.value) == f"<lambda> is made inside a function: {advice}"
    assert not Path("run").exists()
    ds = rl.run(experiment(inner)).datasets["windy-gridworld/sarsa"]
    assert ds.best.dims == ("alpha", "seed", "row")
    for wrong in (5, {"name": "mine.py:q_of_start", "every": 2}):
        with pytest.raises(InputError, match="a function, or its name"):
            experiment(wrong)
