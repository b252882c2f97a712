"""Policies: the exact probabilities of the actions, and one way to draw from them.

A policy is a function from a row of action values Q(s, .) to probabilities, float [A]. What is drawn,
what Expected Sarsa averages over, and what `planning` evaluates are therefore the same numbers. Ties for the
maximum share its probability equally, everywhere.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key


def greedy(q: Float[Array, " A"]) -> Float[Array, " A"]:
    """The greedy policy: all maximal actions equally likely, [A] -> [A]."""
    best = (q == q.max()).astype(q.dtype)
    return best / best.sum()


def epsilon_greedy(q: Float[Array, " A"], epsilon: Float[Array, ""] | float) -> Float[Array, " A"]:
    """epsilon / A for every action and the rest for the greedy ones, [A] -> [A] (book, section 5.4)."""
    return epsilon / q.shape[0] + (1 - epsilon) * greedy(q)


def sample(key: Key[Array, ""], weights: Float[Array, " n"]) -> Int[Array, ""]:
    """Draws an index with probability proportional to `weights` [n] >= 0, int32 [].

    By inversion, from one random word of which 24 bits count. The word is scaled to the sum of the weights,
    so an index of weight zero is never drawn, however the sum was rounded.
    """
    u = (jax.random.bits(key, dtype=jnp.uint32) >> 8).astype(weights.dtype) * 2**-24
    total = jnp.cumsum(weights)
    return (u * total[-1] >= total[:-1]).sum(dtype=jnp.int32)
