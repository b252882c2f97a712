"""By what runs are compiled: asked for, fallen back from, recorded, interrupted, and out of memory."""

import contextvars
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiny
from jax._src.dispatch import runtime_tokens
from lanes_runs import runs_of
from lanes_tools import assert_same_bits
from marks import slow_but_first

import jaxrl_tab as rl
from jaxrl_tab import batch, cli
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.engine import backend, by_lanes, provenance
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.experiment.executors.base import Job
from jaxrl_tab.lanes import calls, machine, program, registry, versions
from jaxrl_tab.lanes.emit import emit
from jaxrl_tab.lanes.kernel import Kernel

pytestmark = pytest.mark.usefixtures("optimised")

TWO_DOORS = {"num_steps": 20, "log_every": 10}


def swept(env="two-doors", method="sarsa", num_seeds=5, **options):
    env = rl.make(env) if isinstance(env, str) else env
    return rl.sweep(env, method, {"alpha": [0.1, 0.7]}, num_seeds=num_seeds, **TWO_DOORS | options)


def arrays(result):
    return [np.asarray(x) for x in jax.tree.leaves((result.q, result.log))]


@pytest.fixture
def used(monkeypatch):
    """Notes what compiles the runs."""
    noted = []

    def noting(name, cls):
        def make(*args):
            made = cls(*args)
            noted.append(name)  # not where it is refused
            return made

        return make

    for name in ("ByLanes", "ByXLA"):
        monkeypatch.setattr(batch, name, noting(name, getattr(batch, name)))
    backend.tell.cache_clear()
    return noted


# --- which one ---------------------------------------------------------------------------------------


def test_lanes_by_default_on_a_cpu_or_what_was_asked_for(used, monkeypatch):
    """The argument before the variable. Broken once: the variable before the argument -> fails."""
    monkeypatch.delenv("JAXRL_TAB_BACKEND", raising=False)
    asked = [
        ("auto", None),
        ("xla", None),
        ("auto", "xla"),
        ("lanes", "xla"),
        ("xla", "lanes"),
        ("auto", "auto"),
    ]
    for argument, variable in asked:
        if variable:
            monkeypatch.setenv("JAXRL_TAB_BACKEND", variable)
        swept(backend=argument)
    assert used == ["ByLanes", "ByXLA", "ByXLA", "ByLanes", "ByXLA", "ByLanes"]
    assert backend._asked.get() is None  # nothing of it is left


def test_bad_names_are_one_line_wherever_they_stand(tmp_path, capsys, monkeypatch):
    """Broken once: the variable of the environment not checked -> fails."""
    monkeypatch.setattr(batch, "_compiled", lambda *_: pytest.fail("something was compiled"))
    wrong = r"there is no backend 'lane'; did you mean 'lanes'\?"
    with pytest.raises(InputError, match=wrong):
        swept(backend="lane")
    with pytest.raises(InputError, match=r"backend 'lane' is unknown; did you mean 'lanes'\?"):
        rl.Experiment("two-doors", "sarsa", seeds=2, steps=20, backend="lane")
    file = tmp_path / "x.toml"
    file.write_text('environment = "two-doors"\nbackend = "lane"\n\n[[method]]\nname = "sarsa"\n')
    with pytest.raises(InputError, match=r"x\.toml, line 2: backend 'lane' is unknown; did"):
        rl.Experiment.load(file)
    assert cli.main(["sweep", "two-doors", "sarsa", "--backend", "lane"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "jaxrl-tab: sweep: backend 'lane' is unknown; did you mean 'lanes'?"
    monkeypatch.setenv("JAXRL_TAB_BACKEND", "lane")
    with pytest.raises(InputError, match=wrong):
        swept()
    assert cli.main(["sweep", "two-doors", "sarsa", "--seeds", "2", "--steps", "20"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "there is no backend 'lane'" in line


def test_an_experiment_says_it_in_its_file_and_the_command_in_an_option(tmp_path, used):
    file = tmp_path / "x.toml"
    file.write_text(
        'environment = "two-doors"\nbackend = "xla"\nseeds = 3\nsteps = 20\n\n[[method]]\nname = "sarsa"\n'
    )
    rl.run(rl.Experiment.load(file))
    sweep = ["sweep", "two-doors", "sarsa", "--seeds", "3", "--steps", "20", "--quiet"]
    assert cli.main([*sweep, "--backend", "xla"]) == cli.main(sweep) == 0
    assert used == ["ByXLA", "ByXLA", "ByLanes"]


def test_without_llvmlite_xla_does_it_and_says_so_once(used, monkeypatch, caplog):
    """And `lanes` is refused with what to install. Broken once: nothing said -> fails."""
    monkeypatch.setattr(backend, "is_installed", lambda: False)
    swept()
    swept()
    assert used == ["ByXLA", "ByXLA"]
    (line,) = caplog.messages
    assert "XLA" in line and "pip install llvmlite" in line
    with pytest.raises(InputError, match=r"^the backend 'lanes' needs llvmlite: pip install llvmlite$"):
        swept(backend="lanes")
    swept(backend="xla")
    assert len(caplog.messages) == 1


@pytest.mark.slow
def test_where_there_really_is_no_llvmlite():
    """In a process that cannot find it. Broken once: llvmlite imported by the package -> fails."""
    code = """if True:
        from importlib.machinery import PathFinder
        find = PathFinder.find_spec
        PathFinder.find_spec = lambda name, *x: None if name.split(".")[0] == "llvmlite" else find(name, *x)
        import jaxrl_tab as rl
        from jaxrl_tab.engine import provenance
        runs = {"num_seeds": 2, "num_steps": 20}
        print(rl.sweep(rl.make("two-doors"), "sarsa", **runs).q.shape)
        print(provenance.surroundings()["backend"], provenance.surroundings()["LLVM"] == "")
        try:
            rl.sweep(rl.make("two-doors"), "sarsa", **runs, backend="lanes")
        except rl.InputError as refused:
            print(refused)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    shape, surroundings, refused = done.stdout.splitlines()
    assert shape == "(2, 2, 2)" and surroundings == "xla True"
    assert refused == "the backend 'lanes' needs llvmlite: pip install llvmlite"
    assert done.stderr.count("pip install llvmlite") == 1


# --- what is not compiled ----------------------------------------------------------------------------


@rl.pytree
class Transformed(rl.envs.TwoDoors):
    """Doors whose rewards go through a Fourier transform, which is not compiled, and come out as they were."""

    def step(self, key, s, a):
        transition = super().step(key, s, a)
        there_and_back = jnp.fft.ifft(jnp.fft.fft(jnp.stack([transition.reward, 0.0]))).real
        return transition._replace(reward=jnp.round(there_and_back[0]))


@pytest.mark.slow
def test_what_is_not_compiled_says_so_once_and_is_right(used, caplog):
    """By XLA, with the bits of XLA. Broken once: said for each sweep -> fails."""
    first, second = arrays(swept(Transformed())), arrays(swept(Transformed()))
    assert used == ["ByXLA", "ByXLA"]
    reason = "Sarsa in Transformed is not compiled by lanes: the primitive fft is not compiled"
    assert caplog.messages == [f"{reason}; XLA compiles it"]
    for again in (second, arrays(swept(Transformed(), backend="xla"))):
        assert_same_bits(first, again)
    with pytest.raises(InputError, match=f"^{reason}; take the backend 'xla' or 'auto'$"):
        swept(Transformed(), backend="lanes")


# --- what is recorded --------------------------------------------------------------------------------


def test_where_xla_does_not_optimise_the_bits_are_its_own_too():
    """A product is then rounded before it is added to something, where a user's XLA does both at once.

    Broken once: `target` asks the flags of XLA alone; the setting left out of what is recorded -> fails.
    """
    runs = {"num_steps": 300, "log_every": 100, "env": "windy-gridworld"}
    with provenance.using({"jax_disable_most_optimizations": True}):
        assert provenance.settings()["jax_disable_most_optimizations"] is True
        assert_same_bits(*(arrays(swept(**runs, backend=name)) for name in ("lanes", "xla")))


def test_the_backend_and_its_version_are_recorded():
    """With no version where it does not count."""
    with backend.using("lanes"):
        ours = provenance.surroundings()
    with backend.using("xla"):
        theirs = provenance.surroundings()
    assert (ours["backend"], ours["LLVM"]) == ("lanes", machine.version())
    assert (theirs["backend"], theirs["LLVM"]) == ("xla", "")
    assert "backend was lanes, and is xla" in provenance.differences(ours, theirs)


def sessions(folder):
    return [
        session["surroundings"]
        for session in json.loads((folder / "provenance.json").read_text())["sessions"]
    ]


@pytest.mark.slow
def test_a_folder_goes_on_with_the_backend_that_it_was_begun_with(tmp_path, used, monkeypatch):
    """Whatever the environment says by then. Another LLVM is another version of it.

    Broken once: the backend not among the settings of a session -> fails.
    """
    with tiny.small():
        check_resume(tmp_path, used, monkeypatch)


def check_resume(tmp_path, used, monkeypatch):
    rl.run(tiny.EXPERIMENT, tmp_path / "run")
    shard, _ = (tmp_path / "run" / "shards").glob("*.npz")
    whole = np.load(shard)["q"]
    shard.unlink()
    monkeypatch.setenv("JAXRL_TAB_BACKEND", "xla")
    rl.resume(tmp_path / "run")
    assert used == ["ByLanes"] * 3
    assert [x["backend"] for x in sessions(tmp_path / "run")] == ["lanes", "lanes"]
    np.testing.assert_array_equal(np.load(shard)["q"], whole)
    shard.unlink()
    version = machine.version()
    monkeypatch.setattr(machine, "version", lambda: "1.2.3")
    with pytest.raises(InputError, match=f"LLVM was {version}, and is 1.2.3; .*--mixed"):
        rl.resume(tmp_path / "run")
    rl.resume(tmp_path / "run", mixed=True)
    assert sessions(tmp_path / "run")[-1]["LLVM"] == "1.2.3"


def test_work_takes_the_backend_with_it():
    """To the processes of Ray and SLURM. Broken once: not among the settings -> fails."""
    for name in ("xla", "lanes"):
        with backend.using(name):
            job = Job.of(lambda task: {"is lanes": np.array(backend.chosen() == "lanes")}, cores=2)
        assert job.settings["backend"] == name
        there = contextvars.Context().run(lambda job=job: (job._set_up(), job.work(0))[1])
        assert there["is lanes"] == (name == "lanes")


# --- errors, and Ctrl-C ------------------------------------------------------------------------------


class Mine(Exception):
    """Of somebody's own."""


def failing(x):
    raise Mine("not today")


def recorded(state):
    kind = jax.ShapeDtypeStruct((), np.float32)
    return {"x": jax.pure_callback(failing, kind, state.q.max(), vmap_method="sequential")}


@pytest.mark.slow
def test_a_record_that_calls_python_does_as_with_xla(used, caplog):
    """Broken once: what JAX says of it goes through -> NotImplementedError, and no run."""
    with pytest.raises(jax.errors.JaxRuntimeError, match="not today"):
        swept(record=recorded)
    runtime_tokens.clear()  # or JAX tells of it once more at the end of the process
    assert used == ["ByXLA"]
    assert "a call of Python from within is not compiled" in caplog.messages[0]


@pytest.mark.usefixtures("programs_folder")  # which is empty: the program is compiled
def test_what_llvm_refuses_xla_does(used, monkeypatch, caplog):
    """Broken once: its error goes through -> RuntimeError, and no run."""
    with monkeypatch.context() as patched:
        patched.setattr(program, "emit", lambda *args: emit(*args)._replace(text="define nonsense"))
        found = swept("cliff-walking")
    assert used == ["ByXLA"]
    assert "is not compiled by lanes: LLVM refuses its code: LLVM IR parsing error" in caplog.messages[0]
    assert_same_bits(arrays(found), arrays(swept("cliff-walking")))


@pytest.mark.usefixtures("programs_folder")
def test_what_a_newer_jax_writes_otherwise_xla_does_and_one_line_says_so(used, monkeypatch, caplog):
    """Under a JAX that is known it is a defect. Broken once: the guard left out -> KeyError, and no run."""

    def renamed(*_):
        raise KeyError("num_consts")

    monkeypatch.setitem(registry.RULES, "scan", renamed)
    with pytest.raises(KeyError, match="num_consts"):
        swept("cliff-walking")
    monkeypatch.setattr(versions, "JAX", (99, 0))
    swept("cliff-walking")
    assert used == ["ByXLA"]
    (line,) = caplog.messages
    assert re.search(
        r"is not compiled by lanes: JAX [\d.]+ is newer than [\d.]+, the newest known here", line
    )


@pytest.mark.slow
def test_an_error_in_what_xla_does_for_a_kernel_arrives_as_it_is(used, monkeypatch):
    """Also where the other thread still works, and nothing hangs.

    Broken once: all threads stopped by the one that failed -> `Stopped` arrives in its place.
    """

    def fails(_):
        return failing

    monkeypatch.setattr(calls, "callable_of", fails)
    by_lanes.kernel.cache_clear()
    for _ in range(20):
        with pytest.raises(Mine, match="not today"):
            swept(num_seeds=300, exact=True)
    by_lanes.kernel.cache_clear()


OWN = '''
import jax, jax.numpy as jnp
import jaxrl_tab as rl

endless = lambda x: jax.lax.while_loop(lambda x: x >= 0, lambda x: (x * 3 + 1) % 7, x)

@rl.pytree
class Stuck(rl.envs.TwoDoors):
    """Whoever opens a door waits for ever."""

    def step(self, key, s, a):
        return super().step(key, s, a + 0 * (WAITS))
'''
STUCK = {
    "some.py": "endless(a)",
    "all.py": "endless(jnp.int32(1))",
    "within.py": "jax.lax.while_loop(lambda x: x < 3, lambda x: x + 1 + 0 * endless(jnp.int32(1)), a)",
}
LONG = {
    "a block that takes long": "windy-gridworld sarsa --steps 1000000000 --log-every 500000000",
    "episodes that take long": "windy-gridworld sarsa --episodes 1000000000 --log-every 500000000",
    "a loop that never ends": "some.py:Stuck sarsa --steps 100",
    "one that never ends in any run": "all.py:Stuck sarsa --steps 100",
    "one in a loop that runs leave one by one": "within.py:Stuck sarsa --steps 100",
}


@pytest.mark.one_in(5)
@pytest.mark.parametrize("which", slow_but_first(LONG))
def test_ctrl_c_ends_a_kernel(tmp_path, which):
    """By itself: nothing has to end the process. Broken once: a loop does not ask -> hangs until it is killed."""
    for name, waits in STUCK.items():
        (tmp_path / name).write_text(OWN.replace("WAITS", waits))
    code = (
        "import sys; from jaxrl_tab import cli; from jaxrl_tab.engine import by_lanes\n"
        "run = by_lanes.ByLanes._run\n"
        "by_lanes.ByLanes._run = lambda *x: (print('begun', flush=True), run(*x))[1]\n"
        "sys.exit(cli.main(sys.argv[1:]))"
    )
    argv = ["sweep", *LONG[which].split(), "--seeds", "300", "--out", "run", "--backend", "lanes"]
    command = [sys.executable, "-c", code, *argv]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        guard = threading.Timer(120, running.kill)
        guard.start()
        # Two threads may say so at once, in one line.
        assert running.stdout and running.stdout.readline().startswith("begun")
        time.sleep(0.3)  # until it is in the middle of it
        running.send_signal(signal.SIGINT)
        _, said = running.communicate()
        guard.cancel()
    assert running.returncode == 130, said
    assert said == "jaxrl-tab: interrupted; what is finished is kept, `jaxrl-tab resume run` goes on\n"


# --- memory ------------------------------------------------------------------------------------------


@pytest.fixture
def little_memory(monkeypatch):
    """Kernels for which there is memory for so many runs at a time, at most."""
    call, most, asked = Kernel.__call__, [2**30], []

    def limited(self, *inputs, stop=None):
        asked.append(len(inputs[0]))
        if len(inputs[0]) > most[0]:
            raise MemoryError
        return call(self, *inputs, stop=stop)

    monkeypatch.setattr(Kernel, "__call__", limited)
    monkeypatch.setattr(by_lanes, "TASK_SECONDS", 1e9)  # as many at a time as there is room for
    return most, asked


def test_tasks_for_which_there_is_no_memory_are_halved(little_memory):
    """No run is lost, and none is another. Broken once: the second half forgotten -> fails."""
    most, asked = little_memory
    expected = arrays(swept(num_seeds=2000))
    lanes = min(asked)
    assert max(asked) > 4 * lanes
    asked.clear()
    most[0] = 2 * lanes
    assert_same_bits(arrays(swept(num_seeds=2000)), expected)
    assert max(asked) > most[0]
    most[0] = lanes - 1
    smallest = f"not enough memory for {lanes} runs at a time in each thread .2., the smallest"
    with pytest.raises(RunError, match=smallest):
        swept(num_seeds=2000)


def test_xlas_want_of_memory_is_one_too(monkeypatch):
    def fails(_):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 1 bytes.")

    monkeypatch.setattr(calls, "callable_of", lambda call: fails)
    by_lanes.kernel.cache_clear()
    with pytest.raises(RunError, match="there is not enough memory for"):
        swept(num_seeds=300, exact=True)
    by_lanes.kernel.cache_clear()


def test_more_threads_than_devices_share_the_room(monkeypatch):
    """As in a program with one device and many cores. Broken once: each takes all of it -> fails."""
    monkeypatch.setattr(by_lanes, "threads", lambda devices: 8)
    runs = runs_of("two-doors", "sarsa", Budget(20, None, 10, exact=False), 4000)
    one = runs.needs.call.bytes(64, blocks=1)
    room = 12 * one  # of each of the two devices
    compiled = by_lanes.ByLanes(runs, room, None)
    assert compiled.threads == 8
    scratch, results = compiled._kernel.program.scratch, compiled.lanes * runs.needs.call.kept
    assert room < 8 * (scratch + 2 * compiled.most * results) <= 2 * room
    assert by_lanes.ByLanes(runs, 2 * one, None).threads == 4
    assert by_lanes.ByLanes(runs, one // 4, None).threads == 1


@pytest.mark.slow
def test_as_many_threads_as_cores_unless_devices_were_chosen():
    code = "import jax, {first}; from jaxrl_tab.engine import by_lanes; print(by_lanes.threads())"
    run = lambda first, **env: subprocess.run(
        [sys.executable, "-c", code.format(first=first)],
        env={k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | env,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    assert run("os") == str(len(os.sched_getaffinity(0)))
    assert run("os; jax.config.update('jax_num_cpu_devices', 5)") == "5"
    assert run("os", XLA_FLAGS="--xla_force_host_platform_device_count=3") == "3"
    assert by_lanes.threads() == 2 and by_lanes.threads(jax.devices()[:1]) == 1


def test_a_quick_run_alone_starts_no_thread_once_it_is_known_to_be_quick(monkeypatch):
    """So many steps take as long as they did before; episodes may take longer, and one must be able to stop them.

    Broken once: episodes, and what took long, without a thread -> fails.
    """
    threads = []
    called = by_lanes._called
    monkeypatch.setattr(by_lanes, "_called", lambda *args: threads.append(args) or called(*args))

    def in_a_thread(**budget):
        threads.clear()
        rl.train(jax.random.key(0), rl.Sarsa(), rl.make("two-doors"), **budget)
        return bool(threads)

    assert [in_a_thread(num_steps=37) for _ in range(3)] == [True, False, False]
    assert [in_a_thread(num_episodes=3) for _ in range(2)] == [True, True]
    monkeypatch.setattr(by_lanes, "ASK_SECONDS", 0)
    assert in_a_thread(num_steps=37)
