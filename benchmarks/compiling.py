"""What it costs to compile a method, by either backend, and to find it compiled in a second start.

Each time in a fresh process, which has imported everything and has started JAX. What is measured is from the
call to the results of one short run, less the same call again: tracing and compiling, or reading what an
earlier process has kept.
"""

import json
import os
import subprocess
import sys
import time

from benchmarks.command import ROOT, folder
from benchmarks.rounds import Round, Timing

METHOD, LANES, STEPS = "q-learning", 64, 1000


def first(backend: str) -> Round:
    """With an empty cache: CPU seconds, of all threads."""
    return lambda number: Timing(_start(backend, number)["cpu"])


def again(backend: str) -> Round:
    """To be run after the same round of `first`, which fills the cache: seconds."""
    return lambda number: Timing(_start(backend, number)["wall"])


def _start(backend: str, number: int) -> dict[str, float]:
    """What a fresh process spends, CPU seconds and seconds."""
    cache = folder(number) / backend
    environment = os.environ | {"JAXRL_TAB_BACKEND": backend, "JAX_COMPILATION_CACHE_DIR": str(cache)}
    command = [sys.executable, "-m", "benchmarks.compiling"]
    done = subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


def _spent() -> dict[str, float]:
    import jax

    import jaxrl_tab as rl
    from benchmarks import ours
    from jaxrl_tab.engine import programs

    programs.keep()
    jax.block_until_ready(jax.random.bits(jax.random.key(0)))  # JAX has started
    rl.planning.exact_model(rl.make("windy-gridworld"))  # as the checks of a sweep do, for any method
    clocks = {"cpu": time.process_time, "wall": time.perf_counter}
    now = lambda: {name: clock() for name, clock in clocks.items()}
    begun = now()
    run = ours.on_devices(METHOD, lanes=LANES, steps=STEPS, devices=1)  # it compiles, and runs once
    compiled = now()
    run(0)
    ended = now()
    return {name: (compiled[name] - begun[name]) - (ended[name] - compiled[name]) for name in clocks}


if __name__ == "__main__":
    print(json.dumps(_spent()))
