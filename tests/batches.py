"""Batches of runs, without the grid of a sweep around them."""

import jax

from jaxrl_tab import batch
from jaxrl_tab.engine import room


def run(env, algorithms, seeds, budget, **options):
    """(q, log) of runs with these seeds, int [n], and leaves of `algorithms`, [n] each."""
    root = jax.random.key(0)
    one = jax.tree.map(lambda x: x[0], algorithms)
    results, free = room.plan(
        [room.needs_of(env, one, root, budget)], len(seeds), devices=options.get("devices")
    )
    batch.run(env, algorithms, root, seeds, budget, results.write, room=free, **options)
    return results.arrays
