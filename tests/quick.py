"""For the tests of faults: the command line with small shards, and a run that is killed again and again.

    python quick.py ARGUMENTS OF THE COMMAND
    python quick.py kill FOLDER TIMES

The second works on one folder after another in `FOLDER`, each from a process of its own that it kills with
SIGKILL at a random moment, and goes on until that happened so many times and the last folder is finished.
"""

import os
import signal
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import xarray  # noqa: F401  So that none of the processes has to.

import jaxrl_tab as rl
from jaxrl_tab import cli, plot, report
from jaxrl_tab.engine import by_xla, programs
from jaxrl_tab.experiment import runner, shards

SELECTED = rl.Experiment(
    "windy-gridworld",
    [{"name": "sarsa", "alpha": [0.25, 0.5]}, "q-learning"],
    seeds=70,
    steps=200,
    select={"fresh_seeds": 66},
)


def make_quick() -> None:
    """Shards of one block, and no pictures and report."""
    shards.SHARD_STEPS = 64 * 200
    plot.save_all = picture
    report.write_methods = page


def picture(_datasets, _env, folder, _formats):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "overview.png").write_bytes(b"a picture")


def page(folder, *_):
    (folder / "report.html").write_text("a report")


def conduct(folder: Path) -> None:
    by_xla.use_all_cores()
    programs.keep()
    if folder.exists():
        runner.resume(folder)
    else:
        runner.run(SELECTED, folder)


def start(folder: Path) -> int:
    """A process that conducts the experiment. A copy of this one, which has not started JAX."""
    warnings.simplefilter("ignore")  # JAX says that this would not do if it had
    if pid := os.fork():
        return pid
    try:
        conduct(folder)
    except BaseException:
        os._exit(1)
    os._exit(0)


def kill_after(seconds: float, pid: int) -> None:
    """Kills a child once it has used so many seconds of CPU, however busy the machine is; or has ended."""
    while True:
        state, *numbers = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        if state == "Z" or sum(map(int, numbers[10:12])) >= seconds * os.sysconf("SC_CLK_TCK"):
            return os.kill(pid, signal.SIGKILL)
        time.sleep(0.002)


def kill(folder: Path, times: int) -> None:
    """Conducts it undisturbed in `folder/whole`, twice to know how long it takes; then with kills."""
    length = 0.0
    for name in ("first", "whole"):
        _, status, used = os.wait4(start(folder / name), 0)
        assert status == 0
        length = used.ru_utime + used.ru_stime
    random, killed, number = np.random.default_rng(0), 0, 0
    while True:
        path = folder / f"killed-{number}"
        pid = start(path)
        if killed < times:
            kill_after(random.uniform(0, length), pid)
        status = os.waitpid(pid, 0)[1]
        if os.WIFSIGNALED(status):
            killed += 1
            continue
        assert status == 0
        if killed == times:
            return
        number += 1


if __name__ == "__main__":
    make_quick()
    if sys.argv[1] == "kill":
        sys.exit(kill(Path(sys.argv[2]), int(sys.argv[3])))
    sys.exit(cli.main())
