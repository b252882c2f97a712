"""Every method in some environments, compiled by `lanes` but for what LLVM does, which takes longest.

    python lanes_pairs.py ENVIRONMENT ...

prints a line for each pair that is not compiled as it should be, and how many are, each after the environment. It is
a process of its own, for in the tests each call is checked against its annotations, and this makes many.
"""

import math
import sys
from collections.abc import Iterator

from lanes_runs import runs_of

from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import by_lanes
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.runs import Runs
from jaxrl_tab.envs import ENVS, make
from jaxrl_tab.lanes import machine
from jaxrl_tab.lanes.code import Unsupported
from jaxrl_tab.methods import METHODS

BUDGETS = {
    "steps": Budget(250, None, 100, exact=False),  # the last row is shorter
    "episodes": Budget(None, 5, 2, exact=False),
}

GOES_ON, HAS_HORIZON = "access-control", "deep-sea"


class Unloaded:
    """A kernel that nobody calls."""

    def __init__(self, program):
        self.program = program


def pairs(env: str) -> Iterator[tuple[str, str]]:
    """(method, budget): Sarsa and some of the others, in the next environment the next ones; in one all.

    So that each is in two environments besides that one, whatever their number: in one by steps, in the other by
    episodes; but none that is left to XLA. Where states cannot be counted it is those that have features. Methods of
    the average reward are in `GOES_ON` alone, and those that need a horizon in `HAS_HORIZON`.
    """
    every = max(1, len(ENVS) // 2)
    for k, method in enumerate(METHODS, list(ENVS).index(env)):
        declared = of_method(METHODS[method])
        if declared.left_to_xla:
            continue
        if not make(env).num_states:
            if declared.features is not None and not declared.multiplies_returns:
                yield method, list(BUDGETS)[k % 2]
        elif declared.in_the_long_run or declared.needs_horizon:
            alone = GOES_ON if declared.in_the_long_run else HAS_HORIZON
            yield from ((method, by) for by in BUDGETS if env == alone)
        elif env == "random-walk" or method == "sarsa":
            yield from ((method, by) for by in BUDGETS)
        elif k % every == 0:
            yield method, list(BUDGETS)[k // every % 2]


def problems(runs: Runs) -> Iterator[str]:
    """What is not as it should be."""
    try:
        compiled = by_lanes.ByLanes(runs, room=2**28, devices=[0])
    except Unsupported as reason:
        yield f"it is not compiled: {reason}"
        return
    program = compiled._kernel.program
    # Arrays begin at cache lines, and keep some distance from one another.
    forecast = runs.needs.call.bytes(compiled.lanes, blocks=1)
    if program.scratch > 1.01 * forecast + 2**14:
        yield f"it works with {program.scratch} bytes, and the forecast is {forecast}"
    kinds = [*program.inputs, *program.outputs]
    kept = sum(dtype.itemsize * math.prod(shape) for shape, dtype in kinds)
    if kept > runs.needs.call.kept + 8:  # the root's key, which each lane has
        yield f"a lane takes and gives {kept} bytes, and the forecast is {runs.needs.call.kept}"
    if program.calls:
        yield "something is left to XLA"


if __name__ == "__main__":
    machine.object_code = lambda text, target: b""
    by_lanes.Kernel = Unloaded
    for env in sys.argv[1:]:
        compiled = 0
        for method, by in pairs(env):
            told = {} if of_method(METHODS[method]).features is None else {"features": "tile-coding(4, 4)"}
            try:
                runs = runs_of(env, method, BUDGETS[by], **told)
            except InputError as refused:
                if "action" not in str(refused):
                    print(f"{env} {method} by {by}: {refused}")
                continue
            compiled += 1
            for problem in problems(runs):
                print(f"{env} {method} by {by}: {problem}")
        print(env, compiled)
