"""Batches of runs, as `lanes` is given them."""

from typing import Any

import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.part import leaves_as_arrays
from jaxrl_tab.engine.runs import Runs
from jaxrl_tab.engine.sweep import prepare


def runs_of(env: Any, method: Any, budget: Budget, number: int = 200, **grid: Any) -> Runs:
    """So many seeds of a method with one setting."""
    env = rl.make(env) if isinstance(env, str) else env
    part = prepare(env, method, grid, budget, num_seeds=number)
    algorithm = jax.tree.map(lambda x: np.asarray(x)[None, None], leaves_as_arrays(part.configs[0]))
    seeds = np.arange(number, dtype=np.uint32)[None]
    return Runs(env, algorithm, part.root, seeds, budget, np.arange(number))
