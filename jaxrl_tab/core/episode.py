"""The memory of the current episode, for methods that learn when it is over.

Such a method gives its update two things: what to remember of each step, and a function that walks back over
the steps. Both happen in one pass through `tables.lane_by_lane`: a run whose episode is over walks back, the
others only write their step.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from jaxrl_tab.core import tables

T = TypeVar("T")


class Episode(NamedTuple):
    """The steps of the current episode, up to now.

    Attributes:
        steps: a pytree of arrays [max_steps]: what is remembered of each step.
        length: how many steps there are, int32 [].
    """

    steps: Any
    length: Int[Array, ""]


def start(max_steps: int, step: Any) -> Episode:
    """An empty memory for up to `max_steps` steps that look like `step`, a pytree of scalars."""
    steps = jax.tree.map(lambda x: jnp.zeros(max_steps, jnp.result_type(x)), step)
    return Episode(steps, jnp.int32(0))


def learn(
    walk: Callable[..., T], learned: T, episode: Episode, step: Any, last: Bool[Array, ""], *inputs: Any
) -> tuple[T, Episode]:
    """Remembers `step`; where the episode is over, changes `learned` by `walk` and forgets the episode.

    Args:
        walk: `walk(lane, learned, steps, length, *inputs) -> learned`, as in `tables.lane_by_lane`: all arrays
            have a leading axis of lanes, but for `length`, the number of steps of this lane: 0 where its
            episode goes on. See `backward`.
        learned: a pytree of tables.
        episode: the steps before this one.
        step: this one.
        last: whether the episode ends with it.
        inputs: pytrees of what `walk` reads.
    """
    body = partial(_write_and_walk, walk)
    learned, steps = tables.lane_by_lane(body, (learned, episode.steps), step, episode.length, last, *inputs)
    return learned, Episode(steps, jnp.where(last, 0, episode.length + 1))


def _write_and_walk(walk, lane, changed, step, at, last, *inputs):
    learned, steps = changed
    here = tables.entry(at, lane)
    steps = jax.tree.map(lambda xs, x: tables.write(xs, tables.entry(x, lane), lane, here), steps, step)
    length = jnp.where(tables.entry(last, lane), here + 1, 0)
    return walk(lane, learned, steps, length, *inputs), steps


def backward(step: Callable[[Int[Array, ""], T], T], length: Int[Array, ""], carry: T) -> T:
    """`carry = step(i, carry)` for i = length - 1, ..., 0."""
    return lax.fori_loop(jnp.int32(0), length, lambda i, carry: step(length - 1 - i, carry), carry)


def count(
    visits: Int[Array, "L S A"] | None, counts: Bool[Array, ""], *at: Int[Array, ""]
) -> tuple[Int[Array, "L S A"] | None, Int[Array, ""] | None]:
    """N <- N + 1 where it `counts`, on the walk back, and N after that; None where no visits are counted."""
    if visits is None:
        return None, None
    visits = tables.write(visits, tables.entry(visits, *at) + counts.astype(visits.dtype), *at)
    return visits, tables.entry(visits, *at)  # from the new table: see `lane_by_lane`


def visit(
    seen: Int[Array, "S A"] | None, number: Int[Array, ""], s: Int[Array, ""], a: Int[Array, ""]
) -> tuple[Int[Array, "S A"] | None, Bool[Array, ""]]:
    """Notes that (s, a) occurs in episode `number` = 1, 2, ..., and says whether for the first time, bool [].

    `seen` holds the last episode in which each pair occurred, 0 for none. Where it is None, because every
    visit counts, the answer is always True.
    """
    if seen is None:
        return None, jnp.bool(True)
    before = tables.entry(seen, s, a)
    now = jnp.maximum(before, number)  # which is `number`: what is written needs what is read, so no copy
    return tables.put(seen, now, s, a), before != number
