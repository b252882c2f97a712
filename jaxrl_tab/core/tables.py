"""The operations on a table of values: read a row or an entry, add to an entry. And how lanes batch them.

For one run they are plain indexing. Under `vmap`, XLA's CPU backend would make a scatter of a write, which it
neither fuses nor keeps in the one kernel that a whole loop of steps is compiled to; and it would fuse a read
into each of the expressions that use it, and work out its address in each. So they bring a batching rule of
their own: a loop over the lanes that does nothing but move entries between the tables and vectors over lanes.
All arithmetic then runs on those. On other platforms they are the gather and the scatter that they look like.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Int, Shaped, UInt32

T = TypeVar("T")

GROUP = 8  # lanes in one turn of a loop over lanes: fewer do not hide what a turn costs, more do not gain
LONG_ROW = 16  # rows with more entries than this are left to XLA


def row(table: Shaped[Array, "S A"], s: Int[Array, ""]) -> Shaped[Array, " A"]:
    """`table[s]`, [A]. `s` must be a state: it is not checked."""
    return entry(table, s)


def entry(table: Shaped[Array, "..."], *index: Int[Array, ""]) -> Shaped[Array, "..."]:
    """`table[index]`, [] where there is an index for each axis. They must be in range: it is not checked."""
    return _read(jnp.asarray(table), *index)


def add(
    table: Shaped[Array, "S A"], s: Int[Array, ""], a: Int[Array, ""], x: Shaped[Array, ""]
) -> Shaped[Array, "S A"]:
    """`table` with `x` added to entry (s, a). Both must be in range: they are not checked."""
    return put(table, entry(table, s, a) + x.astype(table.dtype), s, a)


def add_row(table: Shaped[Array, "S A"], s: Int[Array, ""], x: Shaped[Array, " A"]) -> Shaped[Array, "S A"]:
    """`table` with `x` added to row s, which must be in range: it is not checked."""
    return lane_by_lane(_put_row, table, s, row(table, s) + x)


def _put_row(lane: Array, table: Array, s: Array, x: Array) -> Array:
    return write_row(table, entry(x, lane), lane, entry(s, lane))


def put(table: Shaped[Array, "..."], x: Shaped[Array, ""], *index: Int[Array, ""]) -> Shaped[Array, "..."]:
    """`table` with entry `index` set to `x`. The index must be in range: it is not checked."""
    return _write(table, x.astype(table.dtype), *index)


def put_at(
    table: Shaped[Array, "N ..."], x: Shaped[Array, "..."], i: Int[Array, ""]
) -> Shaped[Array, "N ..."]:
    """`table` with `table[i]` set to `x`, a number or a row. `i` must be in range: it is not checked."""
    return put(table, x, i) if x.ndim == 0 else lane_by_lane(_put_row, table, i, x)


def write(table: Shaped[Array, "..."], x: Shaped[Array, ""], *index: Int[Array, ""]) -> Shaped[Array, "..."]:
    """`table` with entry `index` set to `x`, inside the body of `lane_by_lane` and other plain loops."""
    block = x.astype(table.dtype).reshape((1,) * table.ndim)
    index = tuple(x.astype(jnp.int32) for x in index)  # of one type, also under x64
    return lax.dynamic_update_slice(table, block, index, allow_negative_indices=False)


def write_row(
    table: Shaped[Array, "..."], x: Shaped[Array, " A"], *index: Int[Array, ""]
) -> Shaped[Array, "..."]:
    """`table` with row `index` set to `x`, where `write` may be used."""
    block = x.astype(table.dtype).reshape((1,) * (table.ndim - 1) + x.shape)
    at = (*(i.astype(jnp.int32) for i in index), jnp.int32(0))
    return lax.dynamic_update_slice(table, block, at, allow_negative_indices=False)


def lane_by_lane(body: Callable[..., T], tables: T, *inputs: Any) -> T:
    """`tables` changed by `body`, for one run; under `vmap`, for one lane after another, in place.

    Where lanes differ in what they do, in how many entries they write or how long they loop, `vmap` makes all
    of them do the longest and select. Here each does its own, as in a program written in C.

    Args:
        body: `body(lane, tables, *inputs) -> tables`, written with a leading axis of lanes in all arrays: it
            reads with `entry(x, lane, ...)` and `write`s at `lane` and nowhere else. It must not close over
            anything that is traced. What it needs of a table it has written it should read from the new one:
            a use of the old one after the write makes XLA copy the whole table, every time.
        tables: a pytree of arrays.
        inputs: pytrees of what the body reads.
    """

    # Only the arrays are passed: derivatives of `custom_vmap` trip over a None among them.
    leaves, structure = jax.tree.flatten((tables, inputs))
    size = jax.tree.structure(tables).num_leaves

    def changed(lane, tables, inputs):
        tables, inputs = jax.tree.unflatten(structure, [*tables, *inputs])
        return jax.tree.leaves(body(lane, tables, *inputs))

    def one(*arrays):
        arrays = [jnp.asarray(x)[None] for x in arrays]
        return [x[0] for x in changed(jnp.int32(0), arrays[:size], arrays[size:])]

    def lanes(*arrays):
        if not lanes_in_turn():
            return jax.vmap(one)(*arrays)
        tables, inputs = list(arrays[:size]), arrays[size:]
        count = jnp.int32(tables[0].shape[0])
        return lax.fori_loop(jnp.int32(0), count, lambda lane, tables: changed(lane, tables, inputs), tables)

    def one_rule(axis_size, batched, *args):
        return with_lanes(lanes, lanes_rule)(*_broadcast(axis_size, batched, args)), [True] * size

    def lanes_rule(axis_size, batched, *args):
        """A second `vmap` only makes more lanes."""
        args = _broadcast(axis_size, batched, args)
        merged = with_lanes(lanes, lanes_rule)(*(x.reshape(-1, *x.shape[2:]) for x in args))
        split = [x.reshape(like.shape) for x, like in zip(merged, args[:size], strict=True)]
        return split, [True] * size

    return jax.tree.unflatten(jax.tree.structure(tables), with_lanes(one, one_rule)(*leaves))


def changed_where(
    condition: Bool[Array, ""],
    change: Callable[..., Shaped[Array, "..."]],
    table: Shaped[Array, "..."],
    *inputs: Shaped[Array, "..."],
) -> Shaped[Array, "..."]:
    """`change(table, *inputs)` where a condition holds; where it does not, `table`, of which nothing is touched.

    Args:
        condition: whether the table changes.
        change: what it becomes, for one run; it must not close over anything that is traced.
        table: a table.
        inputs: arrays that `change` needs besides.
    """

    def body(lane: Array, table: Array, condition: Array, *inputs: Array) -> Array:
        # A loop of one turn, for XLA would copy the tables of all lanes for `lax.cond`.
        def once(carried: tuple[Array, Array]) -> tuple[Array, Array]:
            table = carried[1]
            new = change(*(entry(x, lane) for x in (table, *inputs)))
            put = partial(lax.dynamic_update_index_in_dim, allow_negative_indices=False)
            return jnp.bool_(False), put(table, new, lane, 0)

        return lax.while_loop(lambda carried: carried[0], once, (entry(condition, lane), table))[1]

    return lane_by_lane(body, table, condition, *inputs)


def lanes_in_turn() -> bool:
    """Whether lanes go one after another: on a CPU. (`lax.platform_dependent` adds 2 s to compiling.)"""
    return jax.default_backend() == "cpu"


def with_lanes(function: Callable[..., T], rule: Callable[..., Any]) -> Callable[..., T]:
    """The function, with a rule for `vmap` as `custom_vmap` has it."""

    def of_lanes(axis_size: int, batched: Any, *args: Any) -> tuple[T, Any]:
        if any(jax.tree.leaves(batched)):
            return rule(axis_size, batched, *args)
        # Only derivatives have lanes, as in `jax.jacfwd`: then JAX makes a batch of what this does.
        result = function(*jax.tree.map(jnp.asarray, args))
        return result, jax.tree.map(lambda _: False, result)

    with_lanes = custom_vmap(function)
    with_lanes.def_vmap(of_lanes)
    return with_lanes


def _broadcast(axis_size: int, batched: Any, args: Any) -> Any:
    def broadcast(x, has_lanes):
        return x if has_lanes else jnp.broadcast_to(x, (axis_size, *jnp.shape(x)))

    return jax.tree.map(broadcast, args, tuple(batched))


# --- reading and writing, for one lane and for many --------------------------------------------------


def _read_plainly(table: Shaped[Array, "..."], *index: Int[Array, ""]) -> Shaped[Array, "..."]:
    return table.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def _read_rule(axis_size, batched, table, *index):
    table = jnp.asarray(table)  # what is constant in a method comes as a literal, which is no array
    return _read_list(
        *_as_list(axis_size, batched[0], table, _broadcast(axis_size, batched[1:], index))
    ), True


_read = with_lanes(_read_plainly, _read_rule)


def _write_plainly(
    table: Shaped[Array, "..."], x: Shaped[Array, ""], *index: Int[Array, ""]
) -> Shaped[Array, "..."]:
    return write(table, x, *index)


def _write_rule(axis_size, batched, table, x, *index):
    table, x, *index = _broadcast(axis_size, batched, (table, x, *index))
    entries, at = _as_list(axis_size, True, table, index)
    return _write_list(entries, at, x).reshape(table.shape), True


_write = with_lanes(_write_plainly, _write_rule)


def _as_list(axis_size: int, has_lanes: bool, table: Array, index: Any) -> tuple[Array, Array]:
    """The tables of all lanes as one list of what an index selects, and where in it each lane finds its own.

    Numbers without a sign: XLA keeps every index in range, which costs twice as much with one.
    """
    entries = table if has_lanes else table[None]
    at = jnp.zeros(axis_size, jnp.uint32)
    for size, x in zip(entries.shape[1:], index, strict=False):
        at = at * jnp.uint32(size) + x.astype(jnp.uint32)
    entries = entries.reshape(len(entries), -1, *entries.shape[1 + len(index) :])
    return _merge(axis_size, has_lanes, entries if has_lanes else entries[0], at)


def _merge(axis_size: int, has_lanes: bool, entries: Array, at: Array) -> tuple[Array, Array]:
    """Makes one list of the lists of all lanes, [lanes, N, ...], and moves `at`, [lanes, ...], to match."""
    if not has_lanes:
        return entries, at
    if math.prod(entries.shape[:2]) >= 2**32:
        raise ValueError(f"the tables of {axis_size} lanes have 2**32 entries or more: take fewer lanes")
    # A constant: to work out where each lane begins would cost as much as the rest of its address.
    first = np.arange(axis_size, dtype=np.uint32) * np.uint32(entries.shape[1])
    return entries.reshape(-1, *entries.shape[2:]), at + first.reshape(-1, *(1,) * (at.ndim - 1))


def _read_list_plainly(entries: Shaped[Array, "N ..."], at: UInt32[Array, "..."]) -> Shaped[Array, "..."]:
    """`entries[at]`."""
    if lanes_in_turn() and math.prod(entries.shape[1:]) <= LONG_ROW:
        return _read_lanes(entries, at.ravel()).reshape(*at.shape, *entries.shape[1:])
    return entries.at[at].get(mode="promise_in_bounds", wrap_negative_indices=False)


def _read_list_rule(axis_size, batched, entries, at):
    at = at if batched[1] else jnp.broadcast_to(at, (axis_size, *at.shape))
    return _read_list(*_merge(axis_size, batched[0], jnp.asarray(entries), at)), True


_read_list = with_lanes(_read_list_plainly, _read_list_rule)


def _write_list_plainly(
    entries: Shaped[Array, " N"], at: UInt32[Array, "..."], x: Shaped[Array, "..."]
) -> Shaped[Array, " N"]:
    """`entries` with `x` at `at`."""
    if lanes_in_turn():
        return _write_lanes(entries, at.ravel(), x.ravel())
    return entries.at[at].set(x, mode="promise_in_bounds", unique_indices=True)


def _write_list_rule(axis_size, batched, entries, at, x):
    entries, at, x = _broadcast(axis_size, batched, (entries, at, x))
    return _write_list(*_merge(axis_size, True, entries, at), x).reshape(entries.shape), True


_write_list = with_lanes(_write_list_plainly, _write_list_rule)


def _read_one(entries: Shaped[Array, "N ..."], at: UInt32[Array, ""]) -> Shaped[Array, "..."]:
    return lax.dynamic_index_in_dim(entries, at, keepdims=False, allow_negative_indices=False)


def _write_one(
    entries: Shaped[Array, " N"], at: UInt32[Array, ""], x: Shaped[Array, ""]
) -> Shaped[Array, " N"]:
    return lax.dynamic_update_slice(entries, x[None], (at,), allow_negative_indices=False)


def _read_lanes(entries: Array, at: Array) -> Array:
    """`entries[at]` [lanes, ...], of which the lanes lie side by side in memory."""
    rest = (jnp.uint32(0),) * (entries.ndim - 1)
    put = partial(lax.dynamic_update_slice, allow_negative_indices=False)

    def read(first, group, out):
        columns = [_read_one(entries, i)[..., None] for i in group[0]]
        if not rest:  # single numbers are written together
            return put(out, jnp.concatenate(columns), (first,))
        for k, column in enumerate(columns):
            out = put(out, column, (*rest, first + jnp.uint32(k)))
        return out

    out = lax.empty((*entries.shape[1:], len(at)), entries.dtype)
    return jnp.moveaxis(_over_lanes(read, out, at), -1, 0)


def _write_lanes(entries: Array, at: Array, x: Array) -> Array:
    def write(first, group, entries):
        for i, value in zip(*group, strict=True):
            entries = _write_one(entries, i, value)
        return entries

    return _over_lanes(write, entries, at, x)


def _over_lanes(body: Callable[..., Array], carry: Array, *vectors: Array) -> Array:
    """`carry = body(first lane, the entries of its lanes, carry)` for one group of lanes after another."""
    lanes = len(vectors[0])
    size = math.gcd(lanes, GROUP)

    def turn(g, carry):
        first = g * jnp.uint32(size)
        of_group = partial(lax.dynamic_slice_in_dim, start_index=first, slice_size=size)
        group = [of_group(x, allow_negative_indices=False) for x in vectors]
        return body(first, [[x[k] for k in range(size)] for x in group], carry)

    return lax.fori_loop(jnp.uint32(0), jnp.uint32(lanes // size), turn, carry)
