"""A function of JAX arrays, compiled by `lanes` and by XLA, and what both give for the same lanes."""

import re
from typing import Any
from unittest import mock

import jax
import numpy as np

from jaxrl_tab.lanes import kernel
from jaxrl_tab.lanes.program import MANY
from jaxrl_tab.lanes.program import compile as compile_lanes
from jaxrl_tab.lanes.target import Target, host

GUARD = 4096  # bytes on each side of an array, which a kernel must leave alone


def narrow() -> Target:
    """This processor with its shortest vectors: code for them is made several times as fast."""
    wide = re.compile(r"\+(avx512\w*|avx10\w*|avx2|evex512|vaes|vpclmulqdq|gfni|amx\w*)(?=,|$)")
    return host()._replace(features=wide.sub(r"-\1", host().features))


class Guarded:
    """NumPy for a kernel, with guards around all memory that it writes."""

    def __init__(self) -> None:
        self.memory: list[np.ndarray] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def empty(self, shape: Any, dtype: Any) -> np.ndarray:
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        self.memory.append(np.full(size + 2 * GUARD, 0xA5, np.uint8))
        return self.memory[-1][GUARD : GUARD + size].view(dtype).reshape(shape)

    def zeros(self, shape: Any, dtype: Any) -> np.ndarray:
        x = self.empty(shape, dtype)
        x[...] = 0
        return x

    def copy(self, x: np.ndarray) -> np.ndarray:
        y = self.empty(x.shape, x.dtype)
        y[...] = x
        return y

    def check(self) -> None:
        for memory in self.memory:
            assert (memory[:GUARD] == 0xA5).all(), "written before an array"
            assert (memory[-GUARD:] == 0xA5).all(), "written behind an array"


def by_lanes(
    function: Any, *args: np.ndarray, shared: Any = (), target: Target | None = None, lanes: int = MANY
) -> list[np.ndarray]:
    """What the machine code of `lanes` gives, for arguments with a leading axis of lanes.

    Nothing may be written beside the memory that it is given.

    Args:
        function: of one lane's arrays.
        args: its arguments; their number of lanes is padded to whole blocks with lanes of zeros.
        shared: further arguments, the same in all lanes.
        target: the processor for which it is compiled, by default this one with short vectors.
        lanes: for how many it is compiled; 1: for one alone, and they follow one another.
    """
    count = len(args[0])
    closed = jax.make_jaxpr(function)(*(x[0] for x in args), *shared)
    varying = [True] * len(args) + [False] * len(shared)
    others, target = [None] * len(args) + list(shared), target or narrow()
    program = compile_lanes(closed, varying, others, target=target, lanes=lanes)
    more = -count % program.lanes
    full = [np.concatenate([x, np.zeros((more, *x.shape[1:]), x.dtype)]) for x in args]
    guarded = Guarded()
    with mock.patch.object(kernel, "np", guarded):
        results = kernel.Kernel(program)(*map(guarded.copy, full))
    guarded.check()
    return [y[:count] for y in results]


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


def assert_as_xla(
    function: Any, *args: np.ndarray, shared: Any = (), target: Target | None = None, lanes: int = MANY
) -> None:
    found = by_lanes(function, *args, shared=shared, target=target, lanes=lanes)
    assert_same_bits(found, by_xla(function, *args, shared=shared))
