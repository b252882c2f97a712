"""Everything that is registered is compiled by `lanes`, and works in the memory that was forecast."""

import subprocess
import sys

import lanes_pairs
import pytest

from jaxrl_tab.envs import ENVS


@pytest.mark.parametrize("env", ENVS)
def test_every_method_is_compiled_in_the_memory_that_was_forecast(env):
    """By steps or by episodes. What does not fit the environment is refused as such, and is no pair.

    Broken once: no rule for argmax -> each fails; a table that is copied in each step -> fails.
    """
    done = subprocess.run(
        [sys.executable, lanes_pairs.__file__, env], capture_output=True, text=True, timeout=600
    )
    *problems, compiled = done.stdout.splitlines() or [""]
    assert done.returncode == 0 and problems == [], done.stdout + done.stderr
    assert int(compiled) == len(list(lanes_pairs.pairs(env)))
