"""Values that are linear in features of a state: read them, and change them along its features.

With a vector of n features x(s) and weights w [n, A] the value of an action is q(s, a) = x(s) . w(., a), and its
gradient with respect to w(., a) is x(s) (book, section 9.4). A table is the case of one feature for each state, which
is 1 there and 0 elsewhere: so where the number of a state stands for its features, w is the table, and nothing is
added up.

All sums go from the first feature to the last, so that they have the same bits wherever they are worked out.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, Shaped

from jaxrl_tab.core import tables

UNROLLED = 16  # so many active features are worked through one by one; more of them in a loop


class Active(NamedTuple):
    """Features of which a few are 1, and all others 0: those of tile coding.

    Attributes:
        ones: which are 1, int32 [k], each once.
    """

    ones: Int[Array, "*k"]


X: TypeAlias = Int[Array, ""] | Active | Float[Array, " n"]
"""What stands for a state: its number, the features that are active, or all features, float [n]."""


def is_number(x: X) -> bool:
    """Whether it is the number of a state, or of the one feature that is active."""
    return not isinstance(x, Active) and x.ndim == 0


def row(w: Shaped[Array, "n A"], x: X) -> Shaped[Array, " A"]:
    """The values of all actions, x . w(., a), [A]."""
    if isinstance(x, Active):
        return _added_up(lambda i: tables.row(w, i), x)
    return tables.row(w, x) if x.ndim == 0 else (x[:, None] * w).sum(0)


def entry(
    w: Shaped[Array, "*lanes n A"], x: X, a: Int[Array, ""], *lane: Int[Array, ""]
) -> Shaped[Array, ""]:
    """The value of an action, x . w(., a), []; inside the body of `tables.lane_by_lane` that of a `lane`."""
    if isinstance(x, Active):
        return _added_up(lambda i: tables.entry(w, *lane, i, a), x)
    return tables.entry(w, *lane, x, a) if x.ndim == 0 else (x * _column(w, a, *lane)).sum()


def add(
    w: Shaped[Array, "*lanes n A"], x: X, a: Int[Array, ""], step: Shaped[Array, ""], *lane: Int[Array, ""]
) -> Shaped[Array, "*lanes n A"]:
    """w(., a) <- w(., a) + step x; inside the body of `tables.lane_by_lane` those of a `lane`."""
    added = lambda times_x, w: (w + times_x(step).astype(w.dtype),)
    return change(added, (w,), x, a, *lane)[0]


def change(
    formula: Callable[..., tuple[Array, ...]],
    ws: tuple[Array, ...],
    x: X,
    a: Int[Array, ""],
    *lane: Int[Array, ""],
) -> tuple[Array, ...]:
    """Several weights, changed together for an action, at the features that are not 0.

    Args:
        formula: (times_x, *weights) -> weights, for one feature or all of them: `times_x(y)` is y times the feature.
        ws: the weights, [n, A] each.
        x: the features.
        a: the action.
        lane: where this is in the body of `tables.lane_by_lane`, the lane.
    """
    if isinstance(x, Active):
        # One after another, though all could be read before one is written, which is 8 % faster: then XLA rounds
        # the product of step size and error by itself, and `lanes`, which knows nothing of that, has other bits.
        return _one_by_one(lambda ws, i: change(formula, ws, i, a, *lane), ws, x)
    if x.ndim == 0:
        put = tables.write if lane else tables.put
        new = formula(lambda y: y, *(tables.entry(w, *lane, x, a) for w in ws))
        return tuple(put(w, y, *lane, x, a) for w, y in zip(ws, new, strict=True))
    new = formula(lambda y: y * x, *(_column(w, a, *lane) for w in ws))
    return tuple(_with_column(w, y, a, *lane) for w, y in zip(ws, new, strict=True))


def change_rows(formula: Callable[..., tuple[Array, ...]], ws: tuple[Array, ...], x: X) -> tuple[Array, ...]:
    """Several weights, changed together for all actions, at the features that are 1; there must be no others but 0.

    Args:
        formula: (*rows) -> rows, [A] each, for one feature.
        ws: the weights, [n, A] each.
        x: the features.
    """
    if isinstance(x, Active):
        return _one_by_one(lambda ws, i: change_rows(formula, ws, i), ws, x)
    new = formula(*(tables.row(w, x) for w in ws))
    return tuple(tables.put_at(w, y, x) for w, y in zip(ws, new, strict=True))


def all_of(x: X, size: int, dtype: Any) -> Float[Array, " n"]:
    """All n features, those that are 0 too, of a `size` n."""
    if not isinstance(x, Active) and x.ndim:
        return x
    ones = x.ones[:, None] if isinstance(x, Active) else x[None, None]
    return (ones == jnp.arange(size, dtype=jnp.int32)[None]).any(0).astype(dtype)


def _one_by_one(
    one: Callable[[Any, Array], tuple[Array, ...]], ws: tuple[Array, ...], x: Active
) -> tuple[Array, ...]:
    """The weights after `one` active feature after another."""
    if len(x.ones) <= UNROLLED:
        return reduce(one, list(x.ones), ws)
    return lax.fori_loop(0, len(x.ones), lambda k, ws: one(ws, x.ones[k]), ws)


def _added_up(read: Callable[[Array], Array], x: Active) -> Array:
    """The sum of what is read at the active features."""
    first, *rest = list(x.ones[:UNROLLED])
    total = reduce(lambda total, i: total + read(i), rest, read(first))
    if len(x.ones) <= UNROLLED:
        return total
    return lax.fori_loop(UNROLLED, len(x.ones), lambda k, total: total + read(x.ones[k]), total)


def _at(a: Array, *lane: Array) -> tuple[Array, ...]:
    """Where the weights of an action begin."""
    return (*(i.astype(jnp.int32) for i in lane), jnp.int32(0), a.astype(jnp.int32))


def _column(w: Array, a: Array, *lane: Array) -> Array:
    """w(., a), [n]."""
    sizes = (*(1 for _ in lane), w.shape[-2], 1)
    return lax.dynamic_slice(w, _at(a, *lane), sizes, allow_negative_indices=False).reshape(-1)


def _with_column(w: Array, column: Array, a: Array, *lane: Array) -> Array:
    block = column.reshape(*(1 for _ in lane), -1, 1)
    return lax.dynamic_update_slice(w, block, _at(a, *lane), allow_negative_indices=False)
