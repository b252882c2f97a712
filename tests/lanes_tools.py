"""A function of JAX arrays, compiled by `lanes` and by XLA, and what both give for the same lanes."""

import re
from typing import Any

import jax
import numpy as np

from jaxrl_tab.lanes.kernel import Kernel
from jaxrl_tab.lanes.program import compile as compile_lanes
from jaxrl_tab.lanes.target import Target, host


def narrow() -> Target:
    """This processor with its shortest vectors: code for them is made several times as fast."""
    wide = re.compile(r"\+(avx512\w*|avx10\w*|avx2|evex512|vaes|vpclmulqdq|gfni|amx\w*)(?=,|$)")
    return host()._replace(features=wide.sub(r"-\1", host().features))


def by_lanes(
    function: Any, *args: np.ndarray, shared: Any = (), target: Target | None = None
) -> list[np.ndarray]:
    """What the machine code of `lanes` gives, for arguments with a leading axis of lanes.

    Args:
        function: of one lane's arrays.
        args: its arguments; their number of lanes is padded to whole blocks with lanes of zeros.
        shared: further arguments, the same in all lanes.
        target: the processor for which it is compiled, by default this one with short vectors.
    """
    count = len(args[0])
    closed = jax.make_jaxpr(function)(*(x[0] for x in args), *shared)
    varying = [True] * len(args) + [False] * len(shared)
    program = compile_lanes(closed, varying, [None] * len(args) + list(shared), target=target or narrow())
    more = -count % program.lanes
    full = [np.concatenate([x, np.zeros((more, *x.shape[1:]), x.dtype)]) for x in args]
    return [y[:count] for y in Kernel(program)(*full)]


def by_xla(function: Any, *args: np.ndarray, shared: Any = ()) -> list[np.ndarray]:
    """What XLA gives: `jax.jit(jax.vmap(function))`."""
    axes = (0,) * len(args) + (None,) * len(shared)
    return [np.asarray(y) for y in jax.tree.leaves(jax.jit(jax.vmap(function, axes))(*args, *shared))]


def assert_same_bits(results: Any, expected: Any) -> None:
    """Equal dtypes and bits; any NaN is as good as another."""
    for k, (x, y) in enumerate(zip(results, expected, strict=True)):
        assert x.dtype == y.dtype
        assert x.shape == y.shape
        same = x == y
        if x.dtype.kind == "f":
            words = f"i{x.dtype.itemsize}"
            same = (x.view(words) == y.view(words)) | (np.isnan(x) & np.isnan(y))
        places = np.argwhere(~same)[:5]
        shown = [(tuple(map(int, at)), x[tuple(at)], y[tuple(at)]) for at in places]
        assert same.all(), f"of result {k}, {(~same).sum()} of {same.size} differ: {shown}"


def assert_as_xla(function: Any, *args: np.ndarray, shared: Any = (), target: Target | None = None) -> None:
    assert_same_bits(
        by_lanes(function, *args, shared=shared, target=target), by_xla(function, *args, shared=shared)
    )
