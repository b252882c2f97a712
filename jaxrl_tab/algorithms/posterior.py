"""Draws from the posterior of a model, given what followed each pair.

What is drawn depends on a word and the counts alone, to the last bit, whichever compiler works it out. So numbers are
drawn one after another and summed up in that order; and `log` and `exp` are written out here, for what XLA makes of its
own depends on what stands around them: in a b + c d it rounds one of the products, and not always the same one.
"""

import math

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Float32, Int, UInt32

from jaxrl_tab.algorithms.models import Counts
from jaxrl_tab.core import rng, tables

MOST_TRIES = 100  # far more than are ever needed, but for what is no number
LOG_2 = math.log(2)
LOG_2_HIGH = 0.693359375  # few digits, so that its products with whole numbers are exact


def rounded(x: Float32[Array, ""]) -> Float32[Array, ""]:
    """`x` > -1e30: where it is a product that is added, or has constants added to it, now one thing after the other."""
    return jnp.maximum(x, -1e30)


def log(x: Float32[Array, ""]) -> Float32[Array, ""]:
    """The logarithm of a number > 0 of full precision, from 2 atanh((m - 1) / (m + 1)) = log m."""
    bits = lax.bitcast_convert_type(x, jnp.int32)
    exponent = (bits - 0x3F3504F3) >> 23  # so that x = 2^exponent m, with m from root 1/2 to root 2
    m = lax.bitcast_convert_type(bits - (exponent << 23), jnp.float32)
    s = (m - 1) / (m + 1)
    total = jnp.float32(2 / 9)
    for k in (7, 5, 3, 1):
        total = total * (s * s) + 2 / k
    return rounded(total * s) + exponent.astype(x.dtype) * LOG_2


def exp(x: Float32[Array, ""]) -> Float32[Array, ""]:
    """The exponential of a number < 88; of numbers below -80 that of -80."""
    x = jnp.maximum(x, -80)
    exponent = jnp.floor(x * (1 / LOG_2) + 0.5)
    rest = x - exponent * LOG_2_HIGH - exponent * (LOG_2 - LOG_2_HIGH)
    total = jnp.float32(1 / math.factorial(7))
    for k in range(6, -1, -1):
        total = total * rest + 1 / math.factorial(k)
    return total * lax.bitcast_convert_type((exponent.astype(jnp.int32) + 127) << 23, jnp.float32)


def uniform(word: UInt32[Array, ""]) -> Float32[Array, ""]:
    """A number between 0 and 1, and neither of them, from 23 bits of a word."""
    return (2 * (word >> 9) + 1).astype(jnp.float32) * 2**-24


def log_gamma(word: UInt32[Array, ""], place: Int[Array, ""], shape: Float[Array, ""]) -> Float32[Array, ""]:
    """The logarithm of a draw from the gamma distribution of this shape > 0 and scale 1.

    By Cheng (1977, The generation of gamma variables with non-integral shape parameter) of the shape + 1, for which
    seven to nine of ten proposals are accepted; times u^(1 / shape). The logarithm, for draws of small shapes may be
    smaller than any number.

    Args:
        word, place: of the draw; see `rng.pair`.
        shape: of the distribution.
    """
    shape = rounded(shape.astype(jnp.float32))
    root = jnp.sqrt(2 * shape + 1)
    slope = jnp.sqrt(1 / (2 * shape + 1))  # not 1 / root, of which each processor has its own approximation

    def propose(carry):
        k, _, _ = carry
        u, other = map(uniform, rng.pair(word, place, k))
        v = rounded(slope * log(u / (1 - u)))
        ratio = shape + (1 - math.log(4)) + (shape + 1 + root) * v - (shape + 1) * exp(v)
        return k + 1, ratio >= log(u * u * other), v

    start = jnp.int32(1), jnp.bool_(False), jnp.zeros_like(shape)
    _, _, v = lax.while_loop(lambda carry: ~carry[1] & (carry[0] < MOST_TRIES), propose, start)
    u = uniform(rng.pair(word, place, jnp.int32(0))[0])
    return log(shape + 1) + v + log(u) / shape


def normal(word: UInt32[Array, ""], place: Int[Array, ""]) -> Float32[Array, ""]:
    """A draw from the standard normal distribution: half its square is a gamma variable of the shape 1/2."""
    size = jnp.sqrt(2 * exp(log_gamma(word, place, jnp.float32(0.5))))
    return jnp.where(rng.pair(word, place, jnp.int32(0))[1] & 1 == 1, size, -size)


def drawn_model(
    word: UInt32[Array, ""],
    model: Counts,
    samples: int,
    prior: Float[Array, ""],
    r0: Float[Array, ""],
    spread: Float[Array, ""],
) -> tuple[Float[Array, "S AK Z"], Float[Array, "S AK"]]:
    """The probabilities of the next states and the mean reward of each pair, as they may be: so many draws of each.

    p(. | s, a) ~ Dirichlet(N(s, a, .) + prior / S)
    r(s, a) ~ Normal((r0 + sum of rewards) / (1 + N(s, a)), spread^2 / (1 + N(s, a)))

    Args:
        word: a random word.
        model: what followed each pair.
        samples: how many draws there are of each pair; they lie side by side, as so many actions.
        prior: how many transitions count as much as what is expected of them before there is one.
        r0, spread: what is expected of a reward before there is one, and its standard deviation.
    """
    num_states, num_actions, _ = model.n.shape
    dtype, number = model.n.dtype, num_states * num_actions * samples

    def draw(p, drawn):
        """All of pair p: logarithms of gamma variables, these over the largest, and these over their sum."""
        prob, reward = drawn
        s, a = p // (num_actions * samples), p // samples % num_actions

        def one(z, carry):
            prob, visits, largest = carry
            n = tables.entry(model.n, s, a, z)
            x = log_gamma(word, p * num_states + z, n + prior / num_states)
            return tables.write(prob, x, p, z), visits + n, jnp.maximum(largest, x)

        def over_largest(z, carry):
            prob, total = carry
            x = exp(tables.entry(prob, p, z).astype(jnp.float32) - largest)
            return tables.write(prob, x, p, z), total + x

        def over_sum(z, prob):
            return tables.write(prob, tables.entry(prob, p, z) / total.astype(dtype), p, z)

        zero = jnp.zeros((), jnp.float32)
        prob, visits, largest = lax.fori_loop(
            0, num_states, one, (prob, jnp.zeros((), dtype), zero - jnp.inf)
        )
        prob, total = lax.fori_loop(0, num_states, over_largest, (prob, zero))
        prob = lax.fori_loop(0, num_states, over_sum, prob)
        known = visits + 1
        mean, error = (r0 + tables.entry(model.r, s, a)) / known, spread * jnp.sqrt(1 / known)
        z = normal(word, number * num_states + p).astype(dtype)
        return prob, tables.write(reward, mean + error * z, p)

    empty = jnp.zeros((number, num_states), dtype), jnp.zeros(number, dtype)
    prob, reward = lax.fori_loop(0, number, draw, empty)
    return prob.reshape(num_states, -1, num_states), reward.reshape(num_states, -1)
