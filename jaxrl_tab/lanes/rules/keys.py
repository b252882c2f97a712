"""Random keys and bits.

A key of the generator of JAXRL-Tab is one word, and so is a number of its array. A key of Threefry has two: an
array of such keys is one of first and one of second words (`Parts`).
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxrl_tab.lanes.arrays import Array, Known, Parts, Plain, made_by, reshaped, size_of
from jaxrl_tab.lanes.code import Unsupported, Value
from jaxrl_tab.lanes.functions import Numbers
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.rules.numbers import impl_of
from jaxrl_tab.lanes.rules.places import cut_out, joined

_traced: dict[Any, Any] = {}


def wrapped(code: Lowering, data: Plain) -> Array:
    """Keys, of their words along the last axis."""
    *shape, count = data.shape
    words = [reshaped(cut_out(code, data, len(shape), k, (*shape, 1)), shape) for k in range(count)]
    return words[0] if count == 1 else Parts(tuple(words))


def unwrapped(code: Lowering, keys: Array) -> Plain:
    """The words of keys, along a last axis."""
    words = keys.arrays if isinstance(keys, Parts) else (keys,)
    shape = (*keys.shape, len(words))
    return joined(code, shape, len(shape) - 1, [reshaped(x, (*keys.shape, 1)) for x in words])


def _by_tracing(
    code: Lowering, equation: Any, name: Any, function: Callable[..., Any], keys: Array, *args: Plain
) -> Plain:
    """What a function of one key's words gives, for each of the keys: from its own jaxpr.

    It is traced as JAX was set when the equation was, for there are two ways to draw several words.
    """
    for _ in keys.shape:
        function = jax.vmap(function)
    data = (unwrapped(code, keys), *args)
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in data]
    key = name, equation.ctx.threefry_partitionable, *((x.shape, x.dtype.name) for x in shapes)
    if key not in _traced:
        with equation.ctx.manager:
            _traced[key] = jax.make_jaxpr(function)(*shapes)
    return code.closed(_traced[key], *data)[0]


@rule("random_wrap", of_parts=True)
def random_wrap(code: Lowering, equation: Any, data: Plain) -> Array:
    return wrapped(code, data)


@rule("random_unwrap", of_parts=True)
def random_unwrap(code: Lowering, equation: Any, keys: Array) -> Plain:
    return unwrapped(code, keys)


@rule("random_seed")
def random_seed(code: Lowering, equation: Any, seeds: Plain) -> Array:
    impl = impl_of(equation.outvars[0].aval)
    closed = jax.make_jaxpr(impl.seed)(jax.ShapeDtypeStruct((), seeds.dtype))
    if seeds.shape:
        raise Unsupported("keys of several seeds at once are not compiled")
    return wrapped(code, code.closed(closed, seeds)[0])


@rule("random_bits", of_parts=True)
def random_bits(code: Lowering, equation: Any, keys: Array) -> Plain:
    width, shape = equation.params["bit_width"], tuple(equation.params["shape"])
    impl = impl_of(equation.invars[0].aval)
    return _by_tracing(
        code,
        equation,
        ("bits", impl.name, width, shape),
        lambda key: impl.random_bits(key, width, shape),
        keys,
    )


@rule("random_split", of_parts=True)
def random_split(code: Lowering, equation: Any, keys: Array) -> Array:
    shape, impl = tuple(equation.params["shape"]), impl_of(equation.invars[0].aval)
    return wrapped(
        code,
        _by_tracing(code, equation, ("split", impl.name, shape), lambda key: impl.split(key, shape), keys),
    )


@rule("random_fold_in", of_parts=True)
def random_fold_in(code: Lowering, equation: Any, keys: Array, data: Plain) -> Array:
    impl = impl_of(equation.invars[0].aval)
    return wrapped(code, _by_tracing(code, equation, ("fold", impl.name), impl.fold_in, keys, data))


@rule("threefry2x32")
def threefry(code: Lowering, equation: Any, *words: Plain) -> list[Plain]:
    """Threefry-2x32 with 20 rounds (Salmon et al. 2011): (key, key, count, count) -> two words."""
    shape = equation.outvars[0].aval.shape

    def word(k: int) -> Callable[[Value], Value]:
        def at(i: Value) -> Value:
            numbers = (x.item(0) if size_of(x.shape) == 1 else x.read(i) for x in words)
            return _threefry(*(Numbers(code, x) for x in numbers))[k].value

        return at

    return [made_by(code, shape, np.uint32, word(k)) for k in range(2)]


def _threefry(key0: Numbers, key1: Numbers, x0: Numbers, x1: Numbers) -> tuple[Numbers, Numbers]:
    keys = (key0, key1, key0 ^ key1 ^ 0x1BD11BDA)
    x0, x1 = x0 + key0, x1 + key1
    for group in range(5):
        for rotation in ((13, 15, 26, 6), (17, 29, 16, 24))[group % 2]:
            x0 = x0 + x1
            x1 = (x1 << rotation | x1 >> 32 - rotation) ^ x0
        x0 = x0 + keys[(group + 1) % 3]
        x1 = x1 + keys[(group + 2) % 3] + (group + 1)
    return x0, x1


@rule("iota_2x32_shape")
def counts(code: Lowering, equation: Any) -> list[Plain]:
    """How JAX counts for its generator: 0, 1, ... in two words, the upper and the lower."""
    shape: Sequence[int] = equation.params["shape"]
    counted = np.arange(size_of(shape), dtype=np.uint64).reshape(shape)
    return [Known((counted >> np.uint64(32)).astype(np.uint32), code), Known(counted.astype(np.uint32), code)]
