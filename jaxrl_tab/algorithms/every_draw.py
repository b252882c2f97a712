"""Every draw of a method, instead of one: all that `policies.sample` and `policies.coin` may give in it, each once."""

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import jax
import jax.extend as jex
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.policies import choose

T = TypeVar("T")


def over_draws(draw: Callable[[], T]) -> tuple[Float[Array, " P"], T]:
    """What `draw()` gives for each of the P ways in which its draws may fall, [P, ...], and how probable each is."""
    sizes: list[int] = []

    def note(weights: Array) -> Array:
        sizes.append(len(weights))
        return jnp.int32(0)

    def follow(path: Int[Array, " draws"]) -> tuple[Float[Array, ""], T]:
        chosen, chance = iter(path), jnp.ones(())

        def take(weights: Array) -> Array:
            nonlocal chance
            i = next(chosen)
            chance *= weights[i] / weights.sum()
            return i

        with _choosing(take):
            x = draw()
        return chance, x

    with _choosing(note):
        jax.eval_shape(draw)
    paths = jnp.indices(sizes, dtype=jnp.int32).reshape(len(sizes), math.prod(sizes)).T
    return jax.vmap(follow)(paths)


@contextlib.contextmanager
def _choosing(by: Callable[[Array], Array]) -> Iterator[None]:
    token = choose.set(by)
    try:
        yield
    finally:
        choose.reset(token)


def _refuse(*_: Any) -> Array:
    raise InputError("this method draws in another way than by policies.sample and policies.coin")


_SILENT = jex.random.define_prng_impl(
    key_shape=(1,),
    seed=_refuse,
    split=lambda key, shape: jnp.zeros((*shape, 1), jnp.uint32),
    random_bits=_refuse,
    fold_in=lambda key, data: key,
    name="jaxrl_tab_silent",
    tag="silent",
)


def no_words() -> Array:
    """A key from which nothing can be drawn: with a random number in it the result would not be exact."""
    return jax.random.wrap_key_data(jnp.zeros(1, jnp.uint32), impl=_SILENT)
