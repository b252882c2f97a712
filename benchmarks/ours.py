"""Our side of the benchmark: the public way, `jaxrl_tab.sweep`."""

import jax
import numpy as np

import jaxrl_tab as rl
from benchmarks.task import ALPHA, EPSILON, STEPS, Round, Timing


def ours(method: str, lanes: int, cores: int) -> Round:
    """`sweep` with one device a core. A round includes a log of 80 rows a lane and its copy to the host."""
    if cores > 1:
        rl.use_all_cores()
    if jax.local_device_count() != cores:
        raise RuntimeError(f"there are {jax.local_device_count()} JAX devices for {cores} cores")
    env = rl.make("windy-gridworld")

    def sweep(num_seeds: int, seed: int) -> rl.SweepResult:
        grid = {"alpha": ALPHA, "epsilon": EPSILON}
        return rl.sweep(env, method, grid, num_seeds=num_seeds, num_steps=STEPS, seed=seed)

    def run(seed: int) -> Timing:
        result = sweep(lanes, seed)
        return Timing(result.seconds, np.asarray(result.log.episodes).sum(-1))

    sweep(1, 0)  # compiles: the program is the same for any number of seeds
    return run
