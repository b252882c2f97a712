"""Random numbers for the loop: one word a decision, drawn in bulk.

Splitting a key in every step costs more than the step. Instead the words of many steps are drawn in one
vectorised call of Threefry-2x32 (Salmon et al. 2011, the generator behind `jax.random`), as a function of
(run key, step, pair of decisions) alone: no word depends on how steps are grouped, and none is used twice.

Each word is then handed on as a JAX **key** of its own kind, so environments and methods take a `key` and
call `jax.random` on it as usual. Asked for one 32-bit draw, such a key gives its word itself, for nothing.
Asked for more (several draws, a split, a fold), it seeds Threefry with the word. A decision therefore
carries 32 bits of entropy, independent of all other decisions.
"""

import math

import jax
import jax.extend as jex
import jax.numpy as jnp
from jaxtyping import Array, Int, Key, UInt32

_threefry = jex.random.threefry_2x32

# Second halves of the Threefry keys that a word seeds, so that draws, splits and folds never share a stream.
_BITS, _SPLIT, _FOLD = 0x9E3779B9, 0xBB67AE85, 0x3C6EF372


def _hash(word: Array, purpose: int, counts: Array) -> Array:
    return _threefry((word, jnp.uint32(purpose)), counts)


def _count(size: int) -> Array:
    return jnp.arange(size + size % 2, dtype=jnp.uint32)  # Threefry takes and gives pairs


def _seed(seed: Array) -> Array:
    return seed.astype(jnp.uint32)[None]


def _random_bits(key: Array, bit_width: int, shape: tuple[int, ...]) -> Array:
    (word,) = key
    if bit_width == 32 and math.prod(shape) == 1:
        return word.reshape(shape)
    size = math.prod(shape)
    if bit_width == 64:
        high, low = jnp.split(_hash(word, _BITS, _count(2 * size)), 2)
        return (high.astype(jnp.uint64) << 32 | low).reshape(shape)
    bits = _hash(word, _BITS, _count(size))[:size].reshape(shape)
    return bits if bit_width == 32 else bits.astype({8: jnp.uint8, 16: jnp.uint16}[bit_width])


def _split(key: Array, shape: tuple[int, ...]) -> Array:
    size = math.prod(shape)
    return _hash(key[0], _SPLIT, _count(size))[:size].reshape(*shape, 1)


def _fold_in(key: Array, data: Array) -> Array:
    return _hash(key[0], _FOLD, jnp.stack([data.astype(jnp.uint32), jnp.uint32(0)]))[:1]


_word_impl = jex.random.define_prng_impl(
    key_shape=(1,),
    seed=_seed,
    split=_split,
    random_bits=_random_bits,
    fold_in=_fold_in,
    name="jaxrl_tab_word",
    tag="word",
)


def as_key(word: UInt32[Array, "*n"]) -> Key[Array, "*n"]:
    """Random words as keys: one draw of 32 bits from each returns the word itself."""
    return jax.random.wrap_key_data(word[..., None], impl=_word_impl)


def stream(key: Key[Array, ""]) -> tuple[UInt32[Array, ""], UInt32[Array, ""]]:
    """The two words that name a run's random stream, from a JAX key of any kind."""
    word0, word1 = jax.random.bits(key, (2,), jnp.uint32)
    return word0, word1


def words(
    stream: tuple[Array, Array], steps: Int[Array, " n"], pair: int
) -> tuple[UInt32[Array, " n"], UInt32[Array, " n"]]:
    """Two independent words for each of `steps`, uint32 [n] each; `pair` names which decisions they serve."""
    steps = steps.astype(jnp.uint32)
    both = _threefry(stream, jnp.concatenate([steps, jnp.full_like(steps, pair)]))
    first, second = jnp.split(both, 2)
    return first, second
