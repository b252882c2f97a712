"""On a real Ray cluster of two nodes, on this machine: workers and nodes that go away lose nothing."""

import functools
import os
import signal
import socket
import threading
import time

import jax
import numpy as np
import pytest
import shards

from jaxrl_tab import executors
from jaxrl_tab.types import InputError, RunError

ray = pytest.importorskip("ray")
cluster_utils = pytest.importorskip("ray.cluster_utils")


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


def test_settings_go_along_and_few_tasks_are_ahead(cluster, tmp_path):
    """With a connection that ends with each run."""
    executor = executors.Ray(cluster.address)
    jax.config.update("jax_enable_x64", True)
    try:
        ((_, seen),) = executor.run(shards.settings, [0])
    finally:
        jax.config.update("jax_enable_x64", False)
    assert seen["zero"].dtype == np.float64
    assert str(seen["flags"]) == os.environ["XLA_FLAGS"]
    assert seen["devices"] == 1

    given = executor.run(functools.partial(shards.begun, folder=tmp_path), range(50))
    next(given)
    time.sleep(1)
    assert len(list(tmp_path.iterdir())) <= 1 + 2 * 2  # the one given, and two for each of two cores
    assert len(list(given)) == 49
    assert not ray.is_initialized()


def test_a_worker_is_killed(connection, tmp_path):
    kill = lambda: os.kill(shards.the_process(tmp_path, 2), signal.SIGKILL)
    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    work = functools.partial(shards.waits, folder=tmp_path, wait=[2])
    shards.same(connection.run(work, range(4)), range(4))
    killer.join()
    assert shards.times(2, tmp_path) == 2


def test_a_worker_that_always_dies_is_given_up(connection, tmp_path):
    work = functools.partial(shards.dies, folder=tmp_path, deaths=9)
    with pytest.raises(RunError, match=r"shard 1 was lost 2 times"):
        list(executors.Ray(max_retries=1).run(work, [1]))
    assert shards.times(1, tmp_path) == 2


def test_an_error_is_raised_and_not_tried_again(connection, tmp_path):
    work = functools.partial(shards.fails, folder=tmp_path)
    with pytest.raises(RunError, match=r"(?m)^shard 1 failed: ValueError: no such thing$"):
        list(connection.run(work, [0, 1]))
    assert shards.times(1, tmp_path) == 1


def test_what_is_under_way_is_given_up(connection, tmp_path):
    given = connection.run(functools.partial(shards.waits, folder=tmp_path, wait=[1]), [0, 1])
    assert next(given)[0] == 0
    pid = shards.the_process(tmp_path, 1)
    given.close()
    assert shards.ended(pid)
    assert ray.is_initialized()  # the connection is not the executor's


def test_a_node_goes_away(cluster, connection, tmp_path):
    """The last test: the cluster is smaller after it."""
    (node,) = cluster.worker_nodes

    def remove():
        shards.the_process(tmp_path, "*")
        cluster.remove_node(node, allow_graceful=False)

    remover = threading.Thread(target=remove, daemon=True)
    remover.start()
    work = functools.partial(shards.waits_on_node, folder=tmp_path, node=node.node_id)
    shards.same(connection.run(work, range(4)), range(4))
    remover.join()
    assert not cluster.worker_nodes


def test_addresses_where_nothing_answers_are_refused_at_once():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(RunError, match=f"no Ray cluster at 127.0.0.1:{port}: Connection refused"):
        executors.get("ray", address=f"127.0.0.1:{port}")
    with pytest.raises(InputError, match=r"HOST:PORT or ray://HOST:PORT, not 'somewhere'"):
        executors.get("ray", address="somewhere")
    with pytest.raises(InputError, match=r"num_cpus"):
        executors.get("ray", num_cpus=0)
