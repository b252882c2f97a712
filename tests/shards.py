"""Work for executors, in a module of its own: other processes must be able to import it."""

import os
import time
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab.engine import backend, programs


def learn(task):
    """A real shard: 140 runs of 100 steps."""
    result = rl.sweep(
        rl.make("windy-gridworld"), rl.Sarsa, {"alpha": [0.25, 0.5]}, num_seeds=70, num_steps=100, seed=task
    )
    return {"q": result.q, "rewards": result.log.rewards}


def square(task):
    return {"square": np.array(task**2)}


def begun(task, folder):
    """Notes each time that a task is begun, in a file `TASK-TIME`, and gives the process."""
    (Path(folder) / f"{task}-{time.time_ns()}").write_text(str(os.getpid()))
    return {"pid": np.array(os.getpid())}


def times(task, folder):
    return len(list(Path(folder).glob(f"{task}-*")))


def waits(task, folder, wait):
    """Some of the tasks wait for ever where they are begun for the first time."""
    begun(task, folder)
    if task in wait and times(task, folder) == 1:
        time.sleep(600)
    return learn(task)


def begun_on_ray(task):
    """How Ray lets others in, and on which addresses the processes of this cluster listen."""
    import psutil

    node = psutil.Process().parent()
    assert node
    listens = {
        one.laddr.ip
        for process in (node, *node.children(recursive=True))
        for one in process.net_connections("tcp")
        if one.status == psutil.CONN_LISTEN
    }
    return {"mode": np.array([os.environ.get("RAY_AUTH_MODE", "none")]), "listens": np.array(sorted(listens))}


def waits_on_node(task, work, folder, node):
    """Tasks wait for ever on this Ray node, and elsewhere until there is one on it."""
    import ray

    if ray.get_runtime_context().get_node_id() == node:
        begun(task, folder)
        time.sleep(600)
    the_process(folder, "*")
    return work(task)


def compiles(task, folder):
    """How many programs were made, and by what; task 0 looks for none, and task 1 waits until it is done."""
    made, put = [], programs._put
    if task:
        the_process(folder, "done")
    noted = mock.patch.object(programs, "_put", lambda *what: made.append(what) or put(*what))
    with noted, mock.patch.object(programs, "_found", programs._found if task else lambda *_: None):
        rl.sweep(rl.make("windy-gridworld"), rl.Sarsa, {"alpha": 0.5}, num_seeds=2, num_steps=101)
    begun("done", folder)
    return {"made": np.array(len(made)), "by": np.array(backend.chosen()), "pid": np.array(os.getpid())}


def dies(task, folder, deaths):
    """Task 1 takes its process down, so many times."""
    begun(task, folder)
    if task == 1 and times(task, folder) <= deaths:
        os.kill(os.getpid(), 9)
    return square(task)


def dies_in(task, folder, doomed):
    """Takes the process down in this task."""
    return dies(task - doomed + 1, folder, deaths=9)


def fails(task, folder):
    begun(task, folder)
    if task == 1:
        raise ValueError("no such thing")
    return square(task)


def settings(task):
    """What a result may depend on: the float type, XLA's flags; and how many devices there are."""
    flags = os.environ.get("XLA_FLAGS", "")
    return {
        "zero": np.asarray(jnp.zeros(())),
        "flags": np.array(flags),
        "devices": np.array(jax.device_count()),
    }


def same(given, tasks):
    """Checks that these are the results of `learn`, each once, to the last bit."""
    given = dict(list(given))
    assert sorted(given) == sorted(tasks)
    for task in tasks:
        for name, array in learn(task).items():
            assert np.asarray(given[task][name]).tobytes() == np.asarray(array).tobytes()


def ended(pid, seconds=60):
    """Whether a process ends within that time."""
    for _ in range(seconds * 10):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.1)
    return False


def the_process(folder, task, seconds=60):
    """The process in which a task was begun, as soon as it was."""
    for _ in range(seconds * 20):
        for file in Path(folder).glob(f"{task}-*"):
            if pid := file.read_text():
                return int(pid)
        time.sleep(0.05)
    raise AssertionError(f"task {task} was not begun")
