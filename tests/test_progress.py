"""One kind of progress report everywhere, and a bar where a person looks on."""

import io
import itertools
import sys
import types

import pytest

import jaxrl_tab as rl
from jaxrl_tab.show.progress import Progress, reporting


def test_a_sweep_reports_runs_and_steps(windy):
    """Broken once: the steps of the last block alone, or runs of one program alone -> fails."""
    reports = []
    grid = {"epsilon": [0.25, rl.schedules.glie()]}  # two programs
    rl.sweep(windy, "sarsa", grid, num_seeds=3, num_steps=40, progress=reports.append)
    assert reports[0] == Progress("sarsa in windy-gridworld", 0, 6)
    assert [(state.done, state.steps) for state in reports[1:]] == [(3, 120), (6, 240)]
    assert reports[-1].left == 0
    assert all(before.seconds <= after.seconds for before, after in itertools.pairwise(reports))


def test_what_is_no_function_is_refused_before_anything_is_computed(windy):
    with pytest.raises(rl.InputError, match="progress must be a function of a Progress, or False for no bar"):
        rl.sweep(windy, "sarsa", num_seeds=1, num_steps=10, progress=3)


def test_the_numbers_beside_a_bar():
    state = Progress("sarsa", 5, 10, steps=3_000_000, seconds=2.0, left=61.4, diverged=2)
    assert state.details == "runs, 1.5 million steps/s, 0:01:01 left, 2 diverged"
    assert Progress("sarsa", 10, 10).details == "runs"


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_bar_in_a_terminal_and_nowhere_else(monkeypatch):
    """Broken once: a bar also where stderr is a file -> fails."""
    for stderr, shown in (Terminal(), True), (io.StringIO(), False):
        monkeypatch.setattr(sys, "stderr", stderr)
        with reporting(None) as report:
            report(Progress("sarsa in windy-gridworld", 1, 2))
        assert ("sarsa in windy-gridworld" in stderr.getvalue()) is shown
        with reporting(False) as report:
            report(Progress("another", 1, 2))
        assert "another" not in stderr.getvalue()


def test_a_bar_below_the_cell_of_a_notebook(monkeypatch):
    from IPython import display

    updates = []
    handle = types.SimpleNamespace(update=lambda html: updates.append(html.data))
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: types.SimpleNamespace(kernel=None))
    monkeypatch.setattr(display, "display", lambda html, display_id: handle)
    with reporting(None) as report:
        report(Progress("<mine>", 1, 2))
    assert updates == ['<progress value="1" max="2"></progress> &lt;mine&gt; 1/2 runs', ""]


def test_an_experiment_tells_of_the_runs_within_a_shard():
    """Broken once: `Job` hands no progress on -> fails."""
    reports = []
    rl.run(rl.Experiment("windy-gridworld", "q-learning", seeds=2000, steps=100), progress=reports.append)
    done = [report.done for report in reports]
    assert done == sorted(done)
    assert (done[0], done[-1]) == (0, 2000)
    assert len(set(done)) > 3  # and there is one shard
    within = [report for report in reports if 0 < report.done < 2000]
    assert all(report.steps == 100 * report.done and report.left > 0 for report in within)
    assert all(report.seconds > 0 and report.label == "windy-gridworld/q-learning" for report in within)
