"""The README is true: its code runs, and CI runs its commands."""

import re
from pathlib import Path

import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab.cli import main
from jaxrl_tab.figures import FIGURES

ROOT = Path(rl.__file__).parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"^ *```{language}\n(.*?)^ *```", README, re.DOTALL | re.MULTILINE)


def test_the_library_example_runs(capsys):
    names = {}
    exec(blocks("python")[0], names)
    assert "alpha" in capsys.readouterr().out
    assert names["v"][30] == -7
    assert names["log"].episodes.sum() > 0


def test_the_example_environment_is_one(windy):
    names = {}
    exec(next(block for block in blocks("python") if "class Coin" in block), names)
    coin = names["Coin"](heads=0.25)
    assert rl.planning.value_iteration(coin)[0][0] == -4
    _, log = jax.jit(lambda key: rl.train(key, rl.Sarsa(), coin, num_steps=2000))(jax.random.key(0))
    assert abs(2000 / np.sum(log.episodes) - 4) < 4 * np.sqrt(12 / 500)


def test_the_sarsa_that_is_shown_is_the_sarsa_that_runs():
    shown = next(block for block in blocks("python") if "self.value(state" in block)
    assert "".join(shown.split()) in "".join(
        (ROOT / "jaxrl_tab/algorithms/sarsa.py")
        .read_text()
        .replace("state: Learner, t: Transition", "state, t")
        .split()
    )


def test_what_is_watched_is_what_is_shown(capsys):
    """Line by line, in this order; dots stand for lines that are left out.

    Broken once: two lines exchanged -> fails.
    """
    (command,) = [block for block in blocks("console") if "watch" in block]
    assert main(command.partition("#")[0].split()[1:]) == 0
    printed = iter([" ".join(line.split()) for line in capsys.readouterr().out.splitlines()])
    (shown,) = blocks("text")
    for line in shown.splitlines():
        is_rule = line.startswith("──")
        assert line in ("", "...") or is_rule or " ".join(line.split()) in printed, line


def test_all_that_is_registered_is_counted_and_named():
    """But figures, of which `list` is the place. Broken once: a method taken out of the table -> fails."""
    counts = len(rl.ALGORITHMS), len(rl.PREDICTION), len(rl.ENVS), len(FIGURES)
    text = " ".join(README.split())
    assert "{} methods of control, {} of prediction, {} environments, {} figures".format(*counts) in text
    names = [*rl.ALGORITHMS, *rl.PREDICTION, *rl.ENVS]
    assert not [name for name in names if f"`{name}`" not in text]


def test_ci_runs_the_commands():
    ci = (ROOT / ".ci/run").read_text()
    assert len(blocks("bash")) == 2
    for command in blocks("bash"):
        for part in command.strip().split(" && "):
            assert part.removesuffix(" --out runs/windy") in ci, part
