"""Everything that is registered is compiled by `lanes`, and works in the memory that was forecast."""

import math

import pytest
from lanes_runs import runs_of

from jaxrl_tab.algorithms.prediction import METHODS
from jaxrl_tab.core.checks import InputError
from jaxrl_tab.engine import by_lanes
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.envs import ENVS
from jaxrl_tab.lanes import machine

BY = {
    "steps": Budget(250, None, 100, exact=False),  # the last row is shorter
    "episodes": Budget(None, 5, 2, exact=False),
}


class Unloaded:
    """A kernel that nobody calls."""

    def __init__(self, program):
        self.program = program


@pytest.fixture
def no_machine_code(monkeypatch):
    """All is done but for what LLVM does, which takes longest."""
    monkeypatch.setattr(machine, "object_code", lambda text, target: b"")
    monkeypatch.setattr(by_lanes, "Kernel", Unloaded)
    by_lanes._kernel.cache_clear()
    yield
    by_lanes._kernel.cache_clear()


def pairs():
    """(environment, method, budget): all pairs, and every other one by episodes; a row and a column have both."""
    for i, env in enumerate(ENVS):
        for k, method in enumerate(METHODS):
            for by in BY if env == "random-walk" or method == "sarsa" else [list(BY)[(i + k) % 2]]:
                yield pytest.param(env, method, by, id=f"{method} in {env} by {by}")


@pytest.mark.parametrize(("env", "method", "by"), list(pairs()))
def test_every_pair_is_compiled_in_the_memory_that_was_forecast(env, method, by, no_machine_code):
    """What fits no other is refused as such: a method that learns from pi where the actions are not pi's.

    Broken once: no rule for argmax, or for threefry2x32 -> fails; a table copied in each step -> fails.
    """
    try:
        runs = runs_of(env, method, BY[by])
    except InputError as refused:
        assert "action" in str(refused), refused
        pytest.skip(str(refused))
    compiled = by_lanes.ByLanes(runs, room=2**28, devices=[0])  # raises Unsupported where it is not compiled
    program = compiled._kernel.program
    assert program.scratch <= runs.needs.call.bytes(compiled.lanes, blocks=1)
    assert not program.calls  # all of it is ours
    kinds = [*program.inputs, *program.outputs]
    kept = sum(dtype.itemsize * math.prod(shape) for shape, dtype in kinds)
    assert kept <= runs.needs.call.kept + 8  # and the key of the root, which each lane has
