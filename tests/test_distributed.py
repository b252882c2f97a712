"""Two processes of one `jax.distributed` job, on this machine."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import shards

from jaxrl_tab import executors
from jaxrl_tab.core.errors import RunError

PROGRAM = """
import functools, sys
import jax
jax.config.update("jax_num_cpu_devices", 2)
import numpy as np
import shards
from jaxrl_tab import executors
from jaxrl_tab.core.errors import InputError

folder, port, process, what, doomed = sys.argv[1:]
work = {
    "learn": shards.learn,
    "die": functools.partial(shards.dies_in, folder=folder, doomed=int(doomed)),
}[what]
if what == "learn":
    try:
        executors.Distributed(f"127.0.0.1:{port}", 2, 2)
    except InputError as error:
        print(error)
with executors.Distributed(f"127.0.0.1:{port}", 2, int(process)) as executor:
    if not executor.serve():
        if what == "learn":
            given = executor.run(shards.square, range(9))
            next(given)  # and no more of them
            given.close()
        for task, arrays in executor.run(work, [0, 1, 2, 3]):
            np.savez(f"{folder}/{task}.npz", **arrays)
        list(executor.run(functools.partial(shards.fails, folder=folder), [0, 1]))
print("ended", process)
"""


@pytest.fixture
def start(tmp_path):
    """Starts both processes; they are gone after the test, in any case."""
    started = []

    def start(what, doomed=0):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        env = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]),
            "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        }
        for process in "01":
            command = [sys.executable, "-c", PROGRAM, str(tmp_path), str(port), process, what, str(doomed)]
            started.append(
                subprocess.Popen(
                    command,
                    env=env,
                    cwd=tmp_path,  # where Python looks before all
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )
        return started

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_both_compute_to_the_last_bit_and_an_error_ends_both(start, tmp_path):
    """After a process that JAX does not take, and another piece of work that was broken off."""
    first, second = start("learn")
    said, errors = first.communicate(timeout=120)
    assert "distributed: process_id and num_processes must be nonnegative" in said
    assert "RunError: shard 1 failed: ValueError: no such thing" in errors
    assert first.returncode == 1
    assert "ended 1" in second.communicate(timeout=60)[0]
    shards.same(((task, np.load(tmp_path / f"{task}.npz")) for task in range(4)), range(4))


@pytest.mark.slow
@pytest.mark.one_in(2)
@pytest.mark.parametrize("dies", [0, 1])
def test_a_death_ends_both_and_leaves_what_was_given(start, tmp_path, dies):
    both = start("die", doomed=2 + dies)  # the tasks of the second round
    for process in both:
        process.communicate(timeout=120)
    assert both[dies].returncode == -signal.SIGKILL
    assert both[1 - dies].returncode != 0
    assert sorted(file.name for file in tmp_path.glob("*.npz")) == ["0.npz", "1.npz"]


def test_what_jax_refuses_is_said_in_a_line():
    jax.devices()
    with pytest.raises(RunError, match="must be called before any JAX calls"):
        executors.get("distributed", address="127.0.0.1:9", num_processes=2, process_id=0)
