"""Pictures that a process beside this one draws: the same, whatever happens to it."""

import contextlib
import signal
import subprocess
import sys
import time

import psutil
import pytest

import jaxrl_tab as rl
from jaxrl_tab.cli import _draws
from jaxrl_tab.core.errors import RunError
from jaxrl_tab.experiment import files, painter

EXPERIMENT = rl.Experiment("random-walk", {"name": "td", "alpha": [0.1, 0.2]}, seeds=3, steps=40)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The pictures that this process draws."""
    return made(tmp_path_factory.mktemp("alone") / "run")


def made(folder, experiment=EXPERIMENT):
    rl.run(experiment, folder, progress=False)
    assert (folder / "results.nc").exists() and not list(folder.glob(".pictures*"))
    return {file.name: file.read_bytes() for file in folder.glob("*.png")}


@pytest.fixture
def here(monkeypatch):
    """Which pictures this process draws."""
    environments = []
    draw = painter.Drawing.draw
    monkeypatch.setattr(
        painter.Drawing, "draw", lambda self: environments.append(type(self.env)) or draw(self)
    )
    return environments


@pytest.fixture
def beside(monkeypatch):
    """The process beside this one, within which block it is."""
    monkeypatch.setattr(painter, "cores", lambda: 2)
    with painter.beside():
        process = painter._beside.get()
        assert process and process.stdin
        yield process
    assert process.returncode is not None and process.stdin.closed


@pytest.mark.slow
def test_it_draws_the_same_pictures(tmp_path, drawn, beside, here):
    """To the last bit. Broken once: its answer is not asked for -> all is drawn again here."""
    assert len(drawn) > 2
    assert made(tmp_path / "run") == drawn
    assert not here and beside.returncode == 0


@pytest.mark.one_in(2)
@pytest.mark.parametrize("when", ["before", "while it draws"])
def test_where_it_is_killed_they_are_drawn_here(tmp_path, drawn, beside, here, when, monkeypatch):
    if when == "before":
        beside.kill()
    else:
        table = files._write_table
        monkeypatch.setattr(files, "_write_table", lambda *given: beside.kill() or table(*given))
    assert made(tmp_path / "run") == drawn
    assert len(here) == 1 and beside.returncode == -signal.SIGKILL


OWN = """
import jaxrl_tab as rl
from jaxrl_tab.envs.random_walk import RandomWalk

@rl.pytree
class Own(RandomWalk):
    pass
"""


@pytest.mark.slow
def test_what_it_cannot_import_is_drawn_here(tmp_path, beside, here):
    """A class in a file, which only this process has read."""
    (tmp_path / "own.py").write_text(OWN)
    experiment = rl.Experiment(f"{tmp_path}/own.py:Own", {"name": "td", "alpha": 0.1}, seeds=3, steps=40)
    assert made(tmp_path / "run", experiment)
    assert [cls.__name__ for cls in here] == ["Own"] and beside.returncode == 1


@pytest.mark.slow
def test_more_results_than_are_worth_sending_are_drawn_here(tmp_path, drawn, beside, here, monkeypatch):
    monkeypatch.setattr(painter, "LARGEST", 100)
    assert made(tmp_path / "run") == drawn
    assert len(here) == 1


def test_where_something_else_fails_it_ends_and_leaves_nothing(tmp_path, beside, monkeypatch):
    """Broken once: it is not killed -> it draws into the folder that was removed."""

    def fail(*given):
        raise RunError("the disk is full")

    monkeypatch.setattr(files, "_write_table", fail)
    with pytest.raises(RunError, match="the disk is full"):
        rl.run(EXPERIMENT, tmp_path / "run", progress=False)
    assert beside.returncode is not None
    assert not list((tmp_path / "run").glob(".pictures*")) and not list((tmp_path / "run").glob("*.png"))


def test_on_one_core_there_is_none(monkeypatch):
    monkeypatch.setattr(painter, "cores", lambda: 1)
    with painter.beside():
        assert painter._beside.get() is None


@pytest.mark.parametrize("when", ["it waits", "it draws"])
def test_it_ends_when_nobody_is_left_to_ask_it(when):
    """The process that started it is killed. Broken once, each: its own end of the pipe is left to it -> it waits; what

    it is given is the end of its input -> it draws on.
    """
    program = (
        "import os, pickle, time; from functools import partial; from types import SimpleNamespace\n"
        "from jaxrl_tab.experiment import painter\n"
        "painter.cores = lambda: 2\n"
        "with painter.beside():\n"
        "    process, slow = painter._beside.get(), SimpleNamespace(draw=partial(time.sleep, 60))\n"
        f"    if {when == 'it draws'}: painter._send(process, pickle.dumps([slow]))\n"
        "    print(process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    process = int(done.stdout)
    with contextlib.suppress(psutil.NoSuchProcess):
        left = psutil.Process(process)
        while left.status() != psutil.STATUS_ZOMBIE:  # it has ended, and nobody has asked how
            assert time.time() - left.create_time() < 50, "it is still there"
            time.sleep(0.1)


@pytest.mark.parametrize(
    ("words", "draws"),
    [
        ("sweep windy-gridworld sarsa --out run", True),
        ("resume run", True),
        ("sweep windy-gridworld sarsa", False),
        ("sweep windy-gridworld sarsa --out run --dry-run", False),
        ("sweep windy-gridworld sarsa --out run --no-pictures", False),
        ("solve windy-gridworld --out run", False),
    ],
)
def test_which_commands_have_it(words, draws):
    name, *rest = words.split()
    assert _draws(name, rest) is draws
