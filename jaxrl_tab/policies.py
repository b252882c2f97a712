"""Policies: the exact probabilities of the actions, and one way to draw from them.

A policy is a function from a row of action values Q(s, .) to probabilities, float [A]. What is drawn,
what Expected Sarsa averages over, and what `planning` evaluates are therefore the same numbers. Ties for the
maximum share its probability equally, everywhere.
"""

from functools import reduce
from itertools import accumulate
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

UNROLLED = 16  # rows up to this length are worked through entry by entry


def greedy(q: Float[Array, " A"]) -> Float[Array, " A"]:
    """The greedy policy: all maximal actions equally likely, [A] -> [A]."""
    best = (q == _reduce(jnp.maximum, q)).astype(q.dtype)
    return best / _reduce(jnp.add, best)


def epsilon_greedy(q: Float[Array, " A"], epsilon: Float[Array, ""] | float) -> Float[Array, " A"]:
    """epsilon / A for every action and the rest for the greedy ones, [A] -> [A] (book, section 5.4)."""
    return epsilon / q.shape[0] + (1 - epsilon) * greedy(q)


def sample(key: Key[Array, ""], weights: Float[Array, " n"]) -> Int[Array, ""]:
    """Draws an index with probability proportional to `weights` [n] >= 0, int32 [].

    By inversion, from one random word of which 24 bits count. The word is scaled to the sum of the weights,
    so an index of weight zero is never drawn, however the sum was rounded.
    """
    u = (jax.random.bits(key, dtype=jnp.uint32) >> 8).astype(weights.dtype) * 2**-24
    if len(weights) > UNROLLED:
        edges = jnp.cumsum(weights)
        return (u * edges[-1] >= edges[:-1]).sum(dtype=jnp.int32)
    *edges, total = accumulate(list(weights))
    return reduce(jnp.add, ((u * total >= edge).astype(jnp.int32) for edge in edges), jnp.int32(0))


def _reduce(op: Any, x: Array) -> Array:
    """Under `vmap` a row of A is one of many, and a reduction along so short an axis cannot be vectorised;

    entry by entry, each operation runs over all lanes at once.
    """
    return reduce(op, list(x)) if len(x) <= UNROLLED else op.reduce(x)
