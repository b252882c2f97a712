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
    """An empty memory for up to `max_steps` steps that look like `step`, a pytree of numbers or vectors."""
    steps = jax.tree.map(lambda x: jnp.zeros((max_steps, *jnp.shape(x)), jnp.result_type(x)), step)
    return Episode(steps, jnp.int32(0))


class Walk(NamedTuple):
    """What a walk back over the episode of one lane goes by.

    Attributes:
        steps: the memory of all lanes, a pytree of arrays [lanes, max_steps].
        last: the last step of this lane, a pytree of scalars.
        lane: which lane it is.
        ends: whether its episode is over; else there is nothing to walk.
        before: how many steps there are before the last, int32 [].
    """

    steps: Any
    last: Any
    lane: Int[Array, ""]
    ends: Bool[Array, ""]
    before: Int[Array, ""]

    def back(self, take: Callable[[Any, T], T], carry: T) -> T:
        """`carry = take(step, carry)` for the steps of the episode, from the last to the first.

        The last one, which most often is the only one in short episodes, does not come out of the memory.
        """

        def earlier(i, carry):
            at = self.lane, self.before - 1 - i
            return take(jax.tree.map(lambda xs: tables.entry(xs, *at), self.steps), carry)

        first, ends = jnp.int32(0), self.ends.astype(jnp.int32)
        carry = lax.fori_loop(first, ends, lambda _, carry: take(self.last, carry), carry)
        return lax.fori_loop(first, ends * self.before, earlier, carry)


def learn(
    walk: Callable[..., T], learned: T, episode: Episode, step: Any, last: Bool[Array, ""], *inputs: Any
) -> tuple[T, Episode]:
    """Remembers `step`; where the episode is over, changes `learned` by `walk` and forgets the episode.

    Args:
        walk: `walk(lane, learned, episode, *inputs) -> learned`, as in `tables.lane_by_lane`: `episode` is a
            `Walk`, and all other arrays have a leading axis of lanes.
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
    step, at, last = jax.tree.map(lambda x: tables.entry(x, lane), (step, at, last))
    put = lambda xs, x: (tables.write_row if x.ndim else tables.write)(xs, x, lane, at)
    steps = jax.tree.map(put, steps, step)
    return walk(lane, learned, Walk(steps, step, lane, last, at), *inputs), steps


def count(
    visits: Int[Array, "L S A"] | None, counts: Bool[Array, ""] | None, *at: Int[Array, ""]
) -> tuple[Int[Array, "L S A"] | None, Int[Array, ""] | None]:
    """N <- N + 1 where it `counts` (None: everywhere), on the walk back, and N after that; None without visits."""
    if visits is None:
        return None, None
    more = 1 if counts is None else counts.astype(visits.dtype)
    visits = tables.write(visits, tables.entry(visits, *at) + more, *at)
    return visits, tables.entry(visits, *at)  # from the new table: see `lane_by_lane`


def visit(
    seen: Int[Array, "S A"] | None, number: Int[Array, ""], s: Int[Array, ""], a: Int[Array, ""]
) -> tuple[Int[Array, "S A"] | None, Bool[Array, ""] | None]:
    """Notes that (s, a) occurs in episode `number` = 1, 2, ..., and says whether for the first time, bool [].

    `seen` holds the last episode in which each pair occurred, 0 for none. Where it is None, because every
    visit counts, nothing is noted, and the answer is None.
    """
    if seen is None:
        return None, None
    before = tables.entry(seen, s, a)
    now = jnp.maximum(before, number)  # which is `number`: what is written needs what is read, so no copy
    return tables.put(seen, now, s, a), before != number
