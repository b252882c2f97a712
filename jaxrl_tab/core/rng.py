"""Random numbers for the loop: one word a decision.

Splitting a key in every step costs more than the step. Instead the word of a decision is Threefry-2x32 of
(run key, step, decision) and of nothing else: no word depends on how steps or runs are grouped, and none is used
twice. A call gives two words: they serve two decisions of the same step.

Each word is then handed on as a JAX **key** of its own kind, so environments and methods take a `key` and
call `jax.random` on it as usual. Asked for one 32-bit draw, such a key gives its word itself, for nothing.
Asked for more (several draws, a split, a fold), it seeds Threefry with the word. A decision therefore
carries 32 bits of entropy, independent of all other decisions.
"""

import math
from typing import Any, TypeAlias

import jax
import jax.extend as jex
import jax.numpy as jnp
from jaxtyping import Array, Int, Key, PRNGKeyArray, UInt32

from jaxrl_tab.core.errors import InputError, shown

Stream: TypeAlias = tuple[UInt32[Array, ""], UInt32[Array, ""]]

# Second halves of the Threefry keys that a word seeds, so that draws, splits, folds and pairs never share a stream.
_BITS, _SPLIT, _FOLD, _PAIR = 0x9E3779B9, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A


@jax.jit  # traced once for all its callers, and inlined by the compiler
def threefry(key: tuple[Array, Array], count0: Array, count1: Array) -> tuple[Array, Array]:
    """Threefry-2x32 with 20 rounds (Salmon et al. 2011), uint32 throughout; shapes broadcast.

    The generator behind `jax.random`, written out: there it is a loop with a rule about shapes, here the
    compiler sees one expression of vector operations.
    """
    k0, k1 = key
    keys = (k0, k1, k0 ^ k1 ^ jnp.uint32(0x1BD11BDA))
    x0, x1 = count0 + k0, count1 + k1
    for group in range(5):
        for rotation in ((13, 15, 26, 6), (17, 29, 16, 24))[group % 2]:
            x0 = x0 + x1
            x1 = (x1 << jnp.uint32(rotation) | x1 >> jnp.uint32(32 - rotation)) ^ x0
        x0 = x0 + keys[(group + 1) % 3]
        x1 = x1 + keys[(group + 2) % 3] + jnp.uint32(group + 1)
    return x0, x1


# --- a word as a key ---------------------------------------------------------------------------------


def _hash(word: Array, purpose: int, size: int) -> Array:
    """`size` words from one, uint32 [size]."""
    count = jnp.arange((size + 1) // 2, dtype=jnp.uint32)
    return jnp.concatenate(threefry((word, jnp.uint32(purpose)), count, jnp.zeros_like(count)))[:size]


def _seed(seed: Array) -> Array:
    return seed.astype(jnp.uint32)[None]


def _random_bits(key: Array, bit_width: int, shape: tuple[int, ...]) -> Array:
    (word,) = key
    if bit_width == 32 and math.prod(shape) == 1:
        return word.reshape(shape)
    size = math.prod(shape)
    if bit_width == 64:
        high, low = jnp.split(_hash(word, _BITS, 2 * size), 2)
        return (high.astype(jnp.uint64) << 32 | low).reshape(shape)
    bits = _hash(word, _BITS, size).reshape(shape)
    return bits if bit_width == 32 else bits.astype({8: jnp.uint8, 16: jnp.uint16}[bit_width])


def _split(key: Array, shape: tuple[int, ...]) -> Array:
    size = math.prod(shape)
    return _hash(key[0], _SPLIT, size).reshape(*shape, 1)


def _fold_in(key: Array, data: Any) -> Array:
    word, _ = threefry((key[0], jnp.uint32(_FOLD)), data.astype(jnp.uint32), jnp.uint32(0))
    return word[None]


_word_impl = jex.random.define_prng_impl(
    key_shape=(1,),
    seed=_seed,
    split=_split,
    random_bits=_random_bits,
    fold_in=_fold_in,
    name="jaxrl_tab_word",
    tag="word",
)


def key(seed: int) -> Key[Array, ""]:
    """`jax.random.key(seed)` as JAX has it by default: of Threefry, whatever generator and offset are chosen."""
    return from_data(jnp.array([0, seed], jnp.uint32))


def from_data(data: UInt32[Array, "2"]) -> Key[Array, ""]:
    """The key of Threefry with these two words."""
    return jax.random.wrap_key_data(data, impl="threefry2x32")


def as_key(word: UInt32[Array, "*n"]) -> Key[Array, "*n"]:
    """Random words as keys: one draw of 32 bits from each returns the word itself."""
    return jax.random.wrap_key_data(word[..., None], impl=_word_impl)


def pair(word: UInt32[Array, ""], i: Int[Array, ""], k: Int[Array, ""]) -> tuple[Array, Array]:
    """Two words for a place (i, k) of all that one word is asked for, where a loop draws them one after another."""
    return threefry((word, jnp.uint32(_PAIR)), i.astype(jnp.uint32), k.astype(jnp.uint32))


def is_threefry(key: PRNGKeyArray) -> bool:
    """Whether it is a key of Threefry, of the new kind or the old."""
    return str(jax.random.key_impl(key)) == "threefry2x32"


def check_key(key: Any) -> None:
    """Raises InputError unless `key` is one JAX key, of the new kind (`key`) or the old (`PRNGKey`)."""
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and not key.ndim:
        return  # what most give; to ask for its data takes longer
    try:
        *batch, _ = jax.random.key_data(key).shape
    except (TypeError, ValueError):
        raise InputError(f"key must be a JAX key such as jax.random.key(0), not {shown(key)}") from None
    if batch:
        raise InputError(
            f"key must be one key, not a batch of shape {tuple(batch)}: jax.vmap goes over its keys"
        )


def stream(key: PRNGKeyArray) -> Stream:
    """The two words that name a run's random stream, from a JAX key of any kind.

    (Threefry has two ways to draw several words; it is always the newer one, whatever JAX is set to.)
    """
    with jax.threefry_partitionable(True):
        word0, word1 = jax.random.bits(key, (2,), jnp.uint32)
    return word0, word1


def word(stream: Stream, step: Int[Array, "*k"], decision: int) -> UInt32[Array, "*k"]:
    """The word of a decision in each step, uint32 of their shape. Decisions are numbered by whoever makes them.

    Decisions 2k and 2k + 1 are the two words of one call: what is decided in the same step costs one.
    """
    return threefry(stream, step.astype(jnp.uint32), jnp.uint32(decision // 2))[decision % 2]
