"""Memory: known before anything is compiled, kept to, and without influence on the numbers."""

import subprocess
import sys
import tempfile
from types import SimpleNamespace

import jax
import numpy as np
import psutil
import pytest

import jaxrl_tab as rl
from jaxrl_tab.core import memory
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import by_lanes, by_xla, room
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.part import leaves_as_arrays
from jaxrl_tab.experiment import shards
from jaxrl_tab.methods import METHODS

pytestmark = pytest.mark.usefixtures("optimised")

BUDGET = {"num_steps": 200, "log_every": 100}


def chain(states):
    """A ring of states with four actions that all do the same."""
    to_next = np.roll(np.eye(states), 1, axis=1)
    return rl.FiniteMDP(np.repeat(to_next[:, None], 4, axis=1), np.ones((states, 4)))


SHAPES = {  # tables and log; traces in many states; episodes and their memory; a linear system in each row
    "sarsa": ("windy-gridworld", rl.Sarsa(), Budget(8000, None, 100, exact=False)),
    "sarsa-lambda": (chain(1000), rl.SarsaLambda(), Budget(2000, None, 100, exact=False)),
    "monte-carlo": ("blackjack", rl.MonteCarlo(), Budget(None, 1000, 1, exact=False)),
    "exact": ("windy-gridworld", rl.Sarsa(), Budget(800, None, 100, exact=True)),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("case", "blocks"),
    [
        ("sarsa", 1),
        ("monte-carlo", 1),
        pytest.param("sarsa-lambda", room.BLOCKS, marks=pytest.mark.slow),
        pytest.param("exact", 1, marks=pytest.mark.slow),
    ],
)
def test_the_bytes_of_a_call_are_known_within_a_tenth(case, blocks):
    """Against what XLA says of the compiled program.

    Broken once: episodes carried once, no linear system, no state of the learner -> each fails.
    """
    env, method, budget = SHAPES[case]
    env = rl.make(env) if isinstance(env, str) else env
    root, method = jax.random.key(0), jax.tree.map(np.float32, method)
    devices, lanes = tuple(jax.devices()[:1]), (1, blocks, room.LANES)
    one = room.needs_of(env, method, root, budget)
    many = jax.tree.map(lambda x: np.full(lanes, x), (np.uint32(0), method))
    found = by_xla._compiled(
        devices, budget, room.signature(room.program_arguments(budget, root, *many, env))
    ).memory_analysis()
    total = found.argument_size_in_bytes + found.output_size_in_bytes + found.temp_size_in_bytes
    np.testing.assert_allclose(one.call.bytes(room.LANES, blocks), total, rtol=0.1)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", [*METHODS])
def test_what_a_run_gives_and_carries_is_known_without_tracing_it(name):
    """Against the run, traced. Broken once: a table that the state does not hold, as of double Q-learning, forgotten,

    or rows not rounded up -> fails.
    """
    env = rl.make("deep-sea" if of_method(METHODS[name]).needs_horizon else "random-walk")
    method = leaves_as_arrays(METHODS[name]())
    record = lambda state: {"table": state.q, "some": state.q[0] > 0}
    for length in ({"num_steps": 250, "record": record}, {"num_episodes": 7, "log_every": 2}):
        budget = Budget(**length)
        signature = room.signature(
            room.program_arguments(budget, jax.random.key(0), np.uint32(0), method, env)
        )
        traced = room.traced_program(budget, signature)
        results, _ = traced.out_info
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), results)
        needs = room.needs_of_program(budget, signature)
        assert needs.results == shapes
        carried = {
            id(x): x.aval for x in traced.jaxpr.jaxpr.outvars
        }  # the table once, where it is in the state
        if budget.record is None:
            works_with = of_method(method).works_with or (lambda state: ())
            beside = memory.size(jax.eval_shape(works_with, traced.out_info[1]))
            assert needs.call.working == room._working(env, budget, memory.size(carried)) + beside


def leaves(result):
    return jax.tree.leaves((result.q, result.log))


@pytest.fixture(scope="module")
def grid(windy):
    """Two programs, whose runs lie among one another; 2 x 3 x 300 runs. By XLA, if nothing else is said."""
    swept = {"alpha": [0.5, 0.3], "epsilon": [0.1, rl.schedules.glie(), 0.7]}
    by_xla = {"backend": "xla"}
    return lambda **options: rl.sweep(windy, "sarsa", swept, num_seeds=300, **BUDGET, **by_xla | options)


@pytest.fixture(scope="module")
def all_at_once(grid):
    return grid()


@pytest.fixture
def widths(monkeypatch):
    """Notes (lanes, blocks of them in a call at most) of each program."""
    noted, width = [], room.width_of_call
    monkeypatch.setattr(by_xla, "width_of_call", lambda *x: noted.append(width(*x)) or noted[-1])
    return noted


@pytest.mark.slow
def test_the_numbers_are_the_same_in_any_room(grid, all_at_once, widths, caplog):
    """One block at a time, and all results in files.

    Broken once: places in a program for those in the grid, one device's results for another's -> each fails.
    """
    little = grid(memory=500_000)
    assert widths == [(room.LANES, 1)] * 2
    assert caplog.messages == [
        "the results of 1800 runs need 2.09 MB; there is room for 500 kB in memory, "
        f"so they are kept in files in {tempfile.gettempdir()}"
    ]
    for result in (little, grid(memory=500_000, backend="lanes")):
        for x, y in zip(leaves(result), leaves(all_at_once), strict=True):
            np.testing.assert_array_equal(x, y)


def test_what_is_free_in_the_machine_is_asked_of_linux(monkeypatch, tmp_path):
    """Broken once: MemFree, or MemTotal, or kilobytes taken for bytes -> fails."""
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    memory.MEMINFO.write_text("MemTotal:  9 kB\nMemFree:  2 kB\nMemAvailable:  5 kB\nHugePages_Total: 0\n")
    assert memory.free() == memory.free(jax.devices("cpu")) == 5 * 1024


@pytest.mark.parametrize(
    "text", [None, "MemTotal: 9 kB\nMemFree: 2 kB\n", "MemTotal: 9 kB\nMemAvailable: 10 kB\n"]
)
def test_where_linux_does_not_say_what_is_free_psutil_is_asked(text, monkeypatch, tmp_path):
    """On macOS and Windows, on an old kernel, and in a container in which there is more than in all.

    Broken once: what there is in all taken for what is free -> fails; psutil asked only without a file -> fails.
    """
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    if text is not None:
        memory.MEMINFO.write_text(text)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=9000, available=5000))
    assert memory.free() == memory.free(jax.devices("cpu")) == 5000
    device = SimpleNamespace(platform="gpu", memory_stats=lambda: {"bytes_limit": 700, "bytes_in_use": 300})
    unlimited = SimpleNamespace(platform="gpu", memory_stats=lambda: None)
    assert memory.free([unlimited, device]) == 400


def test_files_have_no_names_and_can_be_written_in_any_order(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    like = {"a": jax.ShapeDtypeStruct((2,), np.float32), "none": jax.ShapeDtypeStruct((0,), np.int32)}
    results = memory.Results(like, 5, on_disk=True)
    give = lambda runs: {"a": np.stack([runs, -runs], 1).astype(np.float32), "none": np.zeros((len(runs), 0))}
    for runs in ([3, 1], [4], [0, 2]):
        results.write(np.array(runs), give(np.array(runs)))
    arrays = results.arrays
    del results
    np.testing.assert_array_equal(arrays["a"], give(np.arange(5))["a"])
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_on_a_gpu_all_runs_that_fit_go_side_by_side(grid, all_at_once, widths, monkeypatch):
    """Rather, on a CPU that is taken for one, and there bitwise the same as in blocks."""
    monkeypatch.setattr(room, "_on_cpu", lambda devices: False)
    for options, expected in ({}, [(1024, 1), (512, 1)]), ({"memory": 500_000}, [(128, 1)] * 2):
        widths.clear()
        result = grid(**options)
        assert widths == expected
        for x, y in zip(leaves(result), leaves(all_at_once), strict=True):
            np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize(
    ("text", "count"),
    [("4GB", 4 * 10**9), ("1.5 GiB", 3 * 2**29), (".5kb", 500), ("2mib", 2**21), ("7B", 7), ("1TB", 10**12)],
)
def test_sizes(text, count):
    assert memory.parse(text) == count


@pytest.mark.parametrize("text", ["4", "GB", "4 G", "-1GB", "0MB", "1.2.3GB", "", "nanGB", "1e3MB"])
def test_what_is_no_size(text):
    with pytest.raises(InputError, match=r"must be a number with a unit \(B, kB, .*\), such as 4GB, not '"):
        memory.parse(text)


def test_sizes_in_words():
    assert [memory.words(x) for x in (0, 999, 1500, 25 * 10**8)] == ["0 B", "999 B", "1.5 kB", "2.5 GB"]


def test_what_does_not_fit_is_refused(grid, monkeypatch):
    for module, name in ((by_xla, "_compiled"), (by_lanes, "kernel")):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("something was compiled"))
    with pytest.raises(
        InputError, match=r"^64 runs at a time on each device \(2\) need .* kB, more than the 100"
    ):
        grid(memory=100_000)
    monkeypatch.setattr(memory, "disk", lambda: ("/the/disk", 10**6))
    with pytest.raises(InputError, match="room for 500 kB in memory and 1 MB in /the/disk: take fewer seeds"):
        grid(memory=500_000)
    shapes = {"record": lambda state: {"all": state.memory.g}, "num_seeds": 1, "num_steps": 9}
    with pytest.raises(InputError, match="what record gives must be of the same shape in all runs"):
        rl.sweep(rl.make("windy-gridworld"), "n-step-sarsa", {"n": [2, 3]}, **shapes)
    with pytest.raises(InputError, match="memory must be a number of bytes, at least 1, not '4GB'"):
        grid(memory="4GB")


@pytest.mark.slow
def test_a_sweep_streams_through_in_bounded_memory():
    """200 000 runs, in a process of its own: 260 MB of results, and at its peak it takes no 96 MB for them.

    That is the 64 MB of its plan, and pages of the files that it writes.

    Broken once: files kept in memory after writing, results in memory -> each fails.
    """
    code = """if True:
        import resource, jaxrl_tab as rl
        peak = lambda: 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        runs = {"num_steps": 20, "log_every": 2, "memory": 64_000_000}
        rl.sweep(rl.make("windy-gridworld"), "sarsa", num_seeds=1000, **runs)  # by the same program
        before = peak()
        result = rl.sweep(rl.make("windy-gridworld"), "sarsa", num_seeds=200_000, **runs)
        print(result.q.nbytes + sum(x.nbytes for x in result.log[:5]), peak() - before)
        print(result.log.steps[::1000].sum(), abs(result.q[-1]).sum() > 0)
    """
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    needed, taken, *results = run.stdout.split()
    assert int(needed) == 264_000_000
    assert int(taken) < 96_000_000
    assert results == ["4000", "True"]


@pytest.mark.slow
def test_an_experiment_ends_in_bounded_memory(tmp_path):
    """2 x 50 000 runs with tables, intervals, pictures and the report: 114 MB of results, in 50 MB and a shard.

    Beside what Python, JAX and the libraries hold once they have done all of it; and a block of what is looked at.
    Broken once: all tables looked at at once, by the pictures or by the report -> each fails.
    """
    code = """if True:
        import resource, sys, jaxrl_tab as rl
        peak = lambda: 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        method = {"name": "sarsa", "alpha": [0.25, 0.5]}
        run = lambda seeds, name: rl.run(
            rl.Experiment("windy-gridworld", method, seeds=seeds, steps=20),
            f"{sys.argv[1]}/{name}",
            memory=50_000_000,
        )
        run(2000, "few")
        before = peak()
        run(50_000, "many")
        print(peak() - before)
    """
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert "are kept in files" in run.stderr
    assert int(run.stdout) < 50_000_000 + shards.SHARD_BYTES + 2 * memory.BLOCK


@pytest.mark.slow
def test_results_in_files_are_written_some_at_a_time(tmp_path):
    """112 MB of tables. Broken once: as a whole -> 110 MB are taken for it."""
    code = """if True:
        import pathlib, resource, sys, jax, numpy as np, xarray as xr
        from jaxrl_tab.core import memory
        from jaxrl_tab.core import netcdf
        peak = lambda: 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        def save(runs, name):
            like = {"q": jax.ShapeDtypeStruct((70, 4), np.float32)}
            q = memory.Results(like, runs, on_disk=True).arrays["q"].reshape(2, runs // 2, 70, 4)
            ds = xr.Dataset({"q": (("alpha", "seed", "state", "action"), q)})
            netcdf.save(ds, "sarsa", pathlib.Path(sys.argv[1]) / name, {})
        save(20_000, "few.nc")
        before = peak()
        save(100_000, "many.nc")
        print(peak() - before)
    """
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert int(run.stdout) < memory.BLOCK
