"""On a real Ray cluster of two nodes, on this machine: workers and nodes that go away lose nothing."""

import contextlib
import functools
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import jax
import numpy as np
import pytest
import quick
import shards
import test_own
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import cli, executors, export, plot, report
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.engine import programs
from jaxrl_tab.experiment.executors import ray as ray_executor
from jaxrl_tab.experiment.shards import _shards

ray = pytest.importorskip("ray")
cluster_utils = pytest.importorskip("ray.cluster_utils")
# JAX warns of threads in the fork by which the cluster starts its programs.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")


@pytest.fixture(scope="module")
def cluster():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.path.dirname(__file__), prepend=os.pathsep)  # the nodes find `shards`
        # What workers compile is found in the cache of the tests, too.
        patch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
        patch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
        one = cluster_utils.Cluster(
            initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
        )
        try:
            one.add_node(num_cpus=1)
            yield one
        finally:
            one.shutdown()


@pytest.fixture(scope="module")
def connection(cluster):
    """To the cluster, for several tests: their workers need not import JAX anew."""
    ray.init(cluster.address, log_to_driver=False)
    yield executors.Ray()
    ray.shutdown()


@pytest.mark.slow
def test_settings_go_along_and_few_tasks_are_ahead(connection, tmp_path):
    jax.config.update("jax_enable_x64", True)
    try:
        ((_, seen),) = connection.run(shards.settings, [0])
    finally:
        jax.config.update("jax_enable_x64", False)
    assert seen["zero"].dtype == np.float64
    assert str(seen["flags"]) == os.environ["XLA_FLAGS"]
    assert seen["devices"] == 1

    given = connection.run(functools.partial(shards.begun, folder=tmp_path), range(50))
    next(given)
    time.sleep(0.5)
    assert len(list(tmp_path.iterdir())) <= 1 + 2 * 2  # the one given, and two for each of two cores
    assert len(list(given)) == 49


@pytest.mark.slow
def test_workers_compile_by_lanes_and_one_finds_what_the_other_compiled(connection, tmp_path, monkeypatch):
    """Broken once: not kept in workers, where this process keeps -> the first keeps nothing."""
    monkeypatch.setattr(programs, "_folder", tmp_path)
    given = dict(connection.run(functools.partial(shards.compiles, folder=tmp_path), [0, 1]))
    assert given[0]["made"] > 0 and given[1]["made"] == 0
    assert given[0]["by"] == given[1]["by"] == "lanes" and given[0]["pid"] != given[1]["pid"]


@pytest.mark.slow
def test_a_worker_is_killed(connection, tmp_path):
    kill = lambda: os.kill(shards.the_process(tmp_path, 2), signal.SIGKILL)
    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    work = functools.partial(shards.waits, folder=tmp_path, wait=[2])
    shards.same(connection.run(work, range(4)), range(4))
    killer.join()
    assert shards.times(2, tmp_path) == 2


@pytest.mark.slow
def test_a_worker_that_always_dies_is_given_up(connection, tmp_path):
    work = functools.partial(shards.dies, folder=tmp_path, deaths=9)
    with pytest.raises(RunError, match=r"shard 1 was lost 1 times"):
        list(executors.Ray(max_retries=0).run(work, [1]))
    assert shards.times(1, tmp_path) == 1


@pytest.mark.slow
def test_an_error_is_raised_and_not_tried_again(connection, tmp_path):
    work = functools.partial(shards.fails, folder=tmp_path)
    with pytest.raises(RunError, match=r"(?m)^shard 1 failed: ValueError: no such thing$"):
        list(connection.run(work, [0, 1]))
    assert shards.times(1, tmp_path) == 1


@pytest.mark.weekly
def test_what_is_under_way_is_given_up(connection, tmp_path):
    given = connection.run(functools.partial(shards.waits, folder=tmp_path, wait=[1]), [0, 1])
    assert next(given)[0] == 0
    pid = shards.the_process(tmp_path, 1)
    given.close()
    assert shards.ended(pid)
    assert ray.is_initialized()  # the connection is not the executor's


@pytest.mark.weekly
def test_own_files_go_all_the_way_on_the_command_line(connection, cluster, tmp_path, monkeypatch):
    """A method, an environment and a recorder of one file, which imports another: typed, killed, resumed, reported.

    What half of 1 and of 2 give is what 0.5 and 1 give in Python, to the last bit. Broken once: resumed from the
    files as they are then, of which there are none -> fails.
    """
    (tmp_path / "mine.py").write_text(test_own.OWN)
    monkeypatch.chdir(tmp_path)
    expected = test_own.expected()
    (tmp_path / "helpers.py").write_text("def half(x):\n    return x / 2\n")
    own = test_own.OWN.replace("self.haste *", "half(self.haste) *")
    own += "\ndef q_at_end(state):\n    return {'q_at_end': state.q, 'at_step': state.clock.step}\n"
    (tmp_path / "mine.py").write_text("from helpers import half\n" + own)
    typed = ["mine.py:Coin", "mine.py:Hasty", "sarsa", "--record", "mine.py:q_at_end", "--heads", "0.25"]
    typed += ["--haste", "1", "2", "--alpha", "0.5", "--seeds", "70", "--steps", "200", "--select", "--quiet"]
    command = ["sweep", *typed, "--executor", "ray", "--address", cluster.address, "--out", "run"]
    process = subprocess.Popen([sys.executable, "-m", "jaxrl_tab", *command])
    while not list((tmp_path / "run" / "shards").glob("0*.npz")):
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not (tmp_path / "run" / "report.html").exists()
    for name in ("mine.py", "helpers.py"):
        (tmp_path / name).unlink()
    monkeypatch.setattr(plot, "save_all", quick.picture)
    _shards.cache_clear()
    assert cli.main(["resume", "run", "--executor", "ray", "--quiet"]) == 0
    report = (tmp_path / "run" / "report.html").read_text()
    assert "Hasty" in report and "--record mine.py:q_at_end" in report
    found = export.load("run/results.nc")
    assert list(found) == ["Hasty", "sarsa"]
    test_own.check(found["Hasty"], expected)
    np.testing.assert_array_equal(found["Hasty"].q_at_end[..., -1, :, :], expected.q)
    fresh = export.load("run/fresh.nc")["Hasty"]
    np.testing.assert_array_equal(fresh.at_step, np.broadcast_to([100, 200], (70, 2)))
    assert (tmp_path / "run" / "selection.csv").read_text().count("Hasty") == 1


def interrupted(run, *given, **named):
    """Runs until one shard more is there, and is interrupted."""
    before = []

    def interrupt(state):
        before.append(state.done)
        if state.done > before[0]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(*given, progress=interrupt, **named)


@pytest.mark.slow
def test_an_experiment_goes_from_one_kind_of_executor_to_another_and_grows(connection, tmp_path, monkeypatch):
    """Begun by a job of SLURM, interrupted on Ray, finished here, grown on Ray: as what is run here at once."""
    monkeypatch.setattr(plot, "save_all", quick.picture)
    monkeypatch.setattr(report, "write_methods", quick.page)
    monkeypatch.setenv("PYTHONPATH", os.path.dirname(__file__), prepend=os.pathsep)
    _shards.cache_clear()  # other tests cut the same experiment into smaller shards, which workers do not
    folder = tmp_path / "run"
    interrupted(
        rl.run, quick.SELECTED, folder, executor=executors.Slurm(tmp_path, cluster="local", max_jobs=1)
    )
    interrupted(rl.resume, folder, executor=connection)
    assert len(list((folder / "shards").iterdir())) == 2
    rl.resume(folder)
    found = rl.resume(folder, seeds=80, executor=connection)
    larger = {"seeds": 80, "select": {"fresh_seeds": 66}}
    expected = rl.run(rl.Experiment(**quick.SELECTED.data() | larger))
    for name in expected.datasets:
        xr.testing.assert_equal(found.datasets[name], expected.datasets[name])
        xr.testing.assert_equal(found.fresh[name], expected.fresh[name])


class Waits:
    """On Ray, where what is computed on one of the nodes waits there for ever."""

    def __init__(self, folder, node):
        self.about = {"folder": folder, "node": node}

    def run(self, work, tasks):
        return executors.Ray().run(functools.partial(shards.waits_on_node, work=work, **self.about), tasks)


@pytest.mark.slow
def test_a_node_goes_away_while_methods_are_compared(cluster, connection, tmp_path):
    """Between two looks nothing is lost, either. The last test: the cluster is smaller after it.

    Broken once: what was lost is not computed again -> fails.
    """
    methods = ["sarsa", {"name": "sarsa", "label": "greedier", "epsilon": 0.09}]
    until = {"difference": 1e-4, "most_seeds": 12}
    experiment = rl.Experiment("windy-gridworld", methods, seeds=8, steps=400, until_decided=until)
    (node,) = cluster.worker_nodes

    def remove():
        shards.the_process(tmp_path, "*")
        cluster.remove_node(node, allow_graceful=False)

    remover, looks = threading.Thread(target=remove, daemon=True), []
    remover.start()
    looked = lambda _, verdict: looks.append(verdict.seeds)
    found = rl.run(experiment, executor=Waits(tmp_path, node.node_id), looked=looked)
    remover.join()
    assert not cluster.worker_nodes
    expected = rl.run(experiment)
    assert len(looks) == 2 and str(found.verdicts) == str(expected.verdicts)
    for name in expected.fresh:
        xr.testing.assert_equal(found.fresh[name], expected.fresh[name])


def test_addresses_where_nothing_answers_are_refused_at_once():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(RunError, match=f"no Ray cluster at 127.0.0.1:{port}: Connection refused"):
        executors.get("ray", address=f"127.0.0.1:{port}")
    with pytest.raises(InputError, match=r"HOST:PORT or ray://HOST:PORT, not '127.0.0.1:99999'"):
        executors.get("ray", address="127.0.0.1:99999")
    with pytest.raises(InputError, match=r"HOST:PORT or ray://HOST:PORT, not 'somewhere'"):
        executors.get("ray", address="somewhere")
    with pytest.raises(InputError, match=r"num_cpus"):
        executors.get("ray", num_cpus=0)


@pytest.fixture
def listens():
    """Makes a server on this machine that says the same to everybody, and gives its address."""
    with contextlib.ExitStack() as ends:

        def make(says):
            server = ends.enter_context(socket.create_server(("127.0.0.1", 0)))

            def serve():
                with contextlib.suppress(OSError):
                    while True:
                        ends.enter_context(server.accept()[0]).sendall(says)

            threading.Thread(target=serve, daemon=True).start()
            return f"127.0.0.1:{server.getsockname()[1]}"

        yield make


GRPC = bytes(3) + b"\4" + bytes(5)


def test_addresses_where_something_else_listens_are_refused_soon(listens, monkeypatch):
    """Broken once: only connected -> half a minute later another line, or Ray tries for minutes."""
    monkeypatch.setattr(ray_executor, "_SECONDS", 0.5)
    with pytest.raises(RunError, match="something else listens there"):
        executors.get("ray", address=listens(b"HTTP/1.1 400 Bad Request\r\n\r\n"))
    with pytest.raises(RunError, match=r"there is no answer in 0\.5 seconds"):
        executors.get("ray", address=listens(b""))


@pytest.mark.parametrize(
    ("ray_does", "said"),
    [
        (
            "print('x: InvalidAuthToken: y', flush=True); import time; time.sleep(60)",
            "it wants its token: set RAY_",
        ),
        ("import time; time.sleep(60)", "no answer in 2 seconds"),
        ("raise RuntimeError('Version mismatch')", "RuntimeError: Version mismatch"),
    ],
)
def test_clusters_that_do_not_let_us_in_are_refused_soon(listens, monkeypatch, ray_does, said):
    """A token is needed; a server that is not Ray's; another version."""
    monkeypatch.setattr(ray_executor, "_PATIENCE", 2)
    monkeypatch.setattr(ray_executor, "_TRY", ray_does)
    with pytest.raises(RunError, match=f"^cannot connect to the Ray cluster at .*: {said}[^\n]*$"):
        executors.get("ray", address=listens(GRPC))


@pytest.mark.slow
def test_a_cluster_of_our_own_is_for_this_process_alone(cluster, tmp_path):
    """Though another runs here: with a token, on the loopback interface; and nothing is left or printed.

    Broken once: Ray asked for any cluster, the variables not set -> each fails.
    """
    code = """if True:
        import os, socket, shards
        from jaxrl_tab import executors
        auth = lambda: {name: x for name, x in os.environ.items() if name.startswith("RAY_AUTH")}
        given = executors.Ray().run(shards.begun_on_ray, [0])
        _, seen = next(given)
        given.close()
        assert not auth() and not __import__("ray").is_initialized()
        print(*seen["mode"], *seen["listens"])
    """
    environment = {name: x for name, x in os.environ.items() if not name.startswith("RAY_")}
    environment |= {
        "HOME": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path]),
    }
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    mode, *listens = done.stdout.split()
    assert mode == "token" and listens and set(listens) <= {"127.0.0.1", "::ffff:127.0.0.1"}
    assert done.stderr == "" and not (tmp_path / ".ray").exists()
