"""The operations on a table of values: read a row or an entry, add to an entry. And how lanes batch them.

`q.at[s, a].add(x)` under `vmap` is a scatter, and XLA's CPU backend neither fuses a scatter nor keeps it in
the one kernel that a whole loop of steps is compiled to. A loop over the lanes that writes one entry each
stays in that kernel: it is what a person would write in C. Writing therefore brings its own
batching rule; outside `vmap` it is the plain indexing that it looks like.
"""

from functools import partial

import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Int, Num


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


@custom_vmap
def put(table: Num[Array, "..."], block: Num[Array, "..."], *corner: Int[Array, ""]) -> Num[Array, "..."]:
    """`table` with `block` (as many axes, none longer) written at `corner`, an index for each axis."""
    corner = tuple(index.astype(jnp.int32) for index in corner)  # of one type, also under x64
    return lax.dynamic_update_slice(table, block, corner, allow_negative_indices=False)


@custom_vmap
def _put_lanes(table: Array, block: Array, *corner: Array) -> Array:
    """`put` for a leading axis of lanes, one after another."""

    def write(lane, table):
        pick = partial(lax.dynamic_index_in_dim, index=lane, allow_negative_indices=False)
        start = (lane, *(pick(index, keepdims=False).astype(jnp.int32) for index in corner))
        return lax.dynamic_update_slice(table, pick(block), start, allow_negative_indices=False)

    return lax.fori_loop(jnp.int32(0), jnp.int32(table.shape[0]), write, table)


def _with_lanes(axis_size: int, batched: list[bool], *args: Array) -> list[Array]:
    return [
        x if has_lanes else jnp.broadcast_to(x, (axis_size, *x.shape))
        for x, has_lanes in zip(args, batched, strict=True)
    ]


@put.def_vmap
def _(axis_size, batched, *args):
    return _put_lanes(*_with_lanes(axis_size, batched, *args)), True


@_put_lanes.def_vmap
def _(axis_size, batched, *args):
    """A second `vmap` only makes more lanes."""
    args = _with_lanes(axis_size, batched, *args)
    merged = _put_lanes(*(x.reshape(-1, *x.shape[2:]) for x in args))
    return merged.reshape(args[0].shape), True
