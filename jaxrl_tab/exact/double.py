"""How exact numbers are traced: in float64, and the same whatever goes on beside them."""

import contextlib
from collections.abc import Callable, Iterator
from functools import partial, wraps
from typing import Any, TypeVar

import jax
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from jaxrl_tab.core import tables

T = TypeVar("T")


@contextlib.contextmanager
def doubled() -> Iterator[None]:
    """What is traced within is in float64, whatever the program around it is in.

    An environment that is written for 32 bits mixes in some 64-bit constants then, which is all right here.
    A TPU has no float64: there everything stays at the ambient precision.
    """
    with contextlib.ExitStack() as stack:
        if jax.default_backend() != "tpu":
            stack.enter_context(jax.enable_x64())
        stack.enter_context(jax.numpy_dtype_promotion("standard"))
        yield


def has_double() -> bool:
    """Whether float64 is what JAX makes of a number here, as within `doubled`."""
    return jax.dtypes.canonicalize_dtype(float) == np.float64


def in_turn(function: Callable[..., T]) -> Callable[..., T]:
    """The same function of pytrees of arrays. Under `vmap`, on a CPU, one lane is worked out after another.

    So its results are the same to the last bit however many lanes there are: XLA adds up a vector in an order that
    depends on what lies beside it, and solving a linear system may make much of that. And what a lane needs stays in
    the cache. The function may close over arrays that are traced, of which each lane has its own.
    """

    @wraps(function)
    def of_lanes(*args: Any) -> T:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        size = len(closed.consts)

        def one(*arrays: Any) -> list[Any]:
            return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, arrays[:size]))(*arrays[size:])

        def rule(axis_size: int, batched: Any, *arrays: Any) -> tuple[list[Any], list[bool]]:
            own = [x for x, has_lanes in zip(arrays, batched, strict=True) if has_lanes]

            def of_lane(work: Callable[..., list[Any]], own: list[Any]) -> list[Any]:
                rest = iter(own)
                both = zip(arrays, batched, strict=True)
                return work(*(next(rest) if has_lanes else x for x, has_lanes in both))

            with doubled():
                if tables.lanes_in_turn():  # with the rule, for there may be a `vmap` around this one
                    results = lax.map(partial(of_lane, again), own)
                else:
                    results = jax.vmap(partial(of_lane, one))(own)
            return results, [True] * len(results)

        again = tables.with_lanes(one, rule)
        results = again(*closed.consts, *jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return of_lanes
