"""The k-armed test bed whose arms drift (book, exercise 2.5)."""

import dataclasses
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Key, UInt32

from jaxrl_tab.core import rng
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.envs.bandit import NormalBandit

LEAST = np.nextafter(np.float32(-1), np.float32(0))  # above -1, of which erf_inv is infinite
LEVELS = 24  # a walk is known for 2^24 plays, and each play costs as many normal numbers


@pytree
class DriftingTestbed(NormalBandit):
    """Pull one of several arms, whose mean rewards wander while a run goes on.

    All q*(a) start at 0, and with each play of any arm each of them takes a step of its own, from N(0, 0.01^2). A
    reward is drawn from N(q*(a), 1). Each run has walks of its own, drawn from its key, and they are the same whatever
    is pulled, and for every method: `env.instance(key).at(step).means` are q* in a step of that run.

    A walk is a function of its key and the number of the step: its end is drawn first, then its middle given both
    ends, then the middle of the half in which the step lies, and so on, 24 times. (The middle of a walk of n steps
    whose ends are known is normal around their mean, with variance n/4 of that of a step.) So nothing is stored, and
    a walk is that of the book for 2^24 = 16 777 216 steps; there it stays.

    The environment itself, which has no walk yet, has means of 0, as `solve` shows it. A sweep records no exact values,
    for none hold in all of its steps.
    """

    arms: int = static(default=10, at_least=1, help="Number of arms.")
    drift: float = field(
        default=0.01, at_least=0, help="Standard deviation of the steps of q*, one for each play."
    )
    walk: UInt32[Array, ""] | None = field(
        default=None, help="The random word of the walks; `instance` draws it."
    )
    now: Int[Array, ""] | None = field(default=None, help="The step of the run that `at` was asked for.")

    def __post_init__(self):
        for name, kind, maker in (("walk", jnp.uint32, "instance"), ("now", jnp.integer, "at")):
            x = getattr(self, name)
            if x is not None and not (
                getattr(x, "shape", None) == () and jnp.issubdtype(getattr(x, "dtype", object), kind)
            ):
                raise InputError(
                    f"{name} is not given: `{maker}` makes it", who=type(self).__name__, field=name
                )

    def instance(self, key: Key[Array, ""]) -> Self:
        """The environment with walks drawn from `key`."""
        return dataclasses.replace(self, walk=jax.random.bits(key))

    def at(self, step: Int[Array, ""]) -> Self:
        """The environment in a step of the run, int [], counted from 0."""
        return dataclasses.replace(self, now=step)

    @property
    def num_actions(self) -> int:
        return self.arms

    @property
    def means(self) -> Float[Array, " arms"]:
        """q*, the mean rewards of all arms."""
        return jax.vmap(self._mean)(jnp.arange(self.arms))

    def rewards(self, a: Int[Array, ""]) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        return jnp.ones(1), self._mean(a)[None]

    def _mean(self, a: Int[Array, ""]) -> Float[Array, ""]:
        """Where the walk of arm `a` is: in float32, in which other numbers are drawn than in float64."""
        if self.walk is None or self.now is None:
            return jnp.zeros((), float)
        key, now = jax.random.fold_in(rng.as_key(self.walk), a), jnp.asarray(self.now, jnp.int32)

        def normal(place: Int[Array, ""], variance: Float[Array, ""]) -> Float[Array, ""]:
            """A number from N(0, variance). (`jax.random.normal` takes a factor more, and XLA may order them anew.)"""
            u = jax.random.uniform(jax.random.fold_in(key, place), (), jnp.float32, LEAST, 1.0)
            return jnp.sqrt(2 * variance) * lax.erf_inv(u)

        def halve(level: Int[Array, ""], part: tuple[Array, ...]) -> tuple[Array, ...]:
            """Of a part of the walk, its first place and where the walk is at both ends, the half with the step."""
            first, at_first, at_end = part
            steps = jnp.int32(2**LEVELS) >> level
            middle = first + steps // 2
            at_middle = (at_first + at_end) / 2 + normal(middle, steps.astype(jnp.float32) / 4)
            is_later = now >= middle
            return (
                jnp.where(is_later, middle, first),
                jnp.where(is_later, at_middle, at_first),
                jnp.where(is_later, at_end, at_middle),
            )

        end = normal(jnp.int32(2**LEVELS), jnp.float32(2.0**LEVELS))
        _, at_now, at_end = lax.fori_loop(0, LEVELS, halve, (jnp.int32(0), jnp.zeros_like(end), end))
        return self.drift * jnp.where(now < 2**LEVELS, at_now, at_end).astype(float)
