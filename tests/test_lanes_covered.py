"""Everything that is registered is compiled by `lanes`, and works in the memory that was forecast."""

import subprocess
import sys

import lanes_pairs
import pytest
from marks import slow_but

from jaxrl_tab.envs import ENVS

FIRST = (
    "windy-gridworld"  # in which some methods run; every method by steps and by episodes in the random walk
)


@pytest.fixture(scope="module")
def lines(request):
    """What the other process prints: a line for each problem, and how many pairs are compiled, by environment."""
    tests = [item for item in request.session.items if item.path == request.path]
    envs = [item.callspec.params["env"] for item in tests if not item.get_closest_marker("skip")]
    done = subprocess.run(
        [sys.executable, lanes_pairs.__file__, *envs], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = [line.partition(" ") for line in done.stdout.splitlines()]
    return {env: [line for name, _, line in lines if name == env] for env in ENVS}


@pytest.mark.parametrize("env", slow_but([FIRST], ENVS))
def test_every_method_is_compiled_in_the_memory_that_was_forecast(lines, env):
    """By steps or by episodes. What does not fit the environment is refused as such, and is no pair.

    Broken once: no rule for argmax -> each fails; a table that is copied in each step -> fails.
    """
    assert lines[env] == [str(len(list(lanes_pairs.pairs(env))))]
