"""The operations on a table of values: read a row or an entry, add to an entry. And how lanes batch them.

`q.at[s, a].add(x)` under `vmap` is a scatter, and XLA's CPU backend neither fuses a scatter nor keeps it in
the one kernel that a whole loop of steps is compiled to. A loop over the lanes that writes one entry each
stays in that kernel: it is what a person would write in C. Writing therefore brings its own
batching rule; outside `vmap` it is the plain indexing that it looks like.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Int, Num

T = TypeVar("T")


def row(table: Num[Array, "S A"], s: Int[Array, ""]) -> Num[Array, " A"]:
    """`table[s]`, [A]. `s` must be a state: it is not checked."""
    return lax.dynamic_index_in_dim(table, s, keepdims=False, allow_negative_indices=False)


def entry(table: Num[Array, "*n"], *index: Int[Array, ""]) -> Num[Array, ""]:
    """`table[index]`, []. `index` must be in range: it is not checked."""
    return table.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def add(
    table: Num[Array, "S A"], s: Int[Array, ""], a: Int[Array, ""], x: Num[Array, ""]
) -> Num[Array, "S A"]:
    """`table` with `x` added to entry (s, a). Both must be in range: they are not checked."""
    return put(table, (entry(table, s, a) + x.astype(table.dtype))[None, None], s, a)


def put(table: Num[Array, "..."], block: Num[Array, "..."], *corner: Int[Array, ""]) -> Num[Array, "..."]:
    """`table` with `block` (as many axes, none longer) written at `corner`, an index for each axis."""
    return lane_by_lane(_put, table, block, corner)


def write(table: Num[Array, "..."], x: Num[Array, ""], *index: Int[Array, ""]) -> Num[Array, "..."]:
    """`table` with entry `index` set to `x`, inside the body of `lane_by_lane` and other plain loops."""
    block = x.astype(table.dtype).reshape((1,) * table.ndim)
    return lax.dynamic_update_slice(table, block, _int32(index), allow_negative_indices=False)


def lane_by_lane(body: Callable[..., T], tables: T, *given: Any) -> T:
    """`tables` changed by `body`, for one run; under `vmap`, for one lane after another, in place.

    Where lanes differ in what they do, in how many entries they write or how long they loop, `vmap` makes all
    of them do the longest and select. Here each does its own, as in a program written in C.

    Args:
        body: `body(lane, tables, *given) -> tables`, written with a leading axis of lanes in all arrays: it
            reads with `entry(x, lane, ...)` and `write`s at `lane` and nowhere else. It must not close over
            anything that is traced. What it needs of a table it has written it should read from the new one:
            a use of the old one after the write makes XLA copy the whole table, every time.
        tables: a pytree of arrays.
        given: pytrees of what the body reads.
    """

    def one(tables, *given):
        tables, *given = jax.tree.map(lambda x: jnp.asarray(x)[None], (tables, *given))
        return jax.tree.map(lambda x: x[0], body(jnp.int32(0), tables, *given))

    def lanes(tables, *given):
        count = jnp.int32(jax.tree.leaves(tables)[0].shape[0])
        return lax.fori_loop(jnp.int32(0), count, lambda lane, tables: body(lane, tables, *given), tables)

    def one_rule(axis_size, batched, *args):
        return _with_lanes(lanes, lanes_rule)(*_broadcast(axis_size, batched, args)), _all_true(tables)

    def lanes_rule(axis_size, batched, *args):
        """A second `vmap` only makes more lanes."""
        args = _broadcast(axis_size, batched, args)
        merged = _with_lanes(lanes, lanes_rule)(*jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), args))
        split = jax.tree.map(lambda x, like: x.reshape(like.shape), merged, args[0])
        return split, _all_true(tables)

    return _with_lanes(one, one_rule)(tables, *given)


def _with_lanes(function: Callable[..., T], rule: Callable[..., Any]) -> Callable[..., T]:
    function = custom_vmap(function)
    function.def_vmap(rule)
    return function


def _broadcast(axis_size: int, batched: Any, args: Any) -> Any:
    def broadcast(x, has_lanes):
        return x if has_lanes else jnp.broadcast_to(x, (axis_size, *jnp.shape(x)))

    return jax.tree.map(broadcast, args, tuple(batched))


def _all_true(tables: Any) -> Any:
    return jax.tree.map(lambda _: True, tables)


def _put(lane: Array, table: Array, block: Array, corner: tuple[Array, ...]) -> Array:
    block = lax.dynamic_index_in_dim(block, lane, allow_negative_indices=False)
    start = (lane, *(entry(index, lane) for index in corner))
    return lax.dynamic_update_slice(table, block, _int32(start), allow_negative_indices=False)


def _int32(index: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(x.astype(jnp.int32) for x in index)  # of one type, also under x64
