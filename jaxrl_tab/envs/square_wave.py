"""The square wave: a function of one number, learned from examples (book, example 9.3)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome

EXTENT = 2.0
PLACES = 1000  # at which the function is compared with what was learned of it


@pytree
class SquareWave(Shown):
    """A number from [0, 2), and then its target, with a single step an episode: 1 in the middle, and else 0.

    So there is nothing to choose and nothing to look ahead to: the reward is the target, and the value of a state is
    what a function of one number is at it. All numbers are equally likely.
    """

    width: float = static(default=1.0, greater_than=0, at_most=EXTENT, help="How wide the wave is.")

    num_states = 0  # they cannot be counted
    num_actions = 1
    max_steps = 1
    low = (0.0,)
    high = (EXTENT,)
    number_names = ("number",)

    def reset(self, key: Key[Array, ""]) -> Float[Array, " 1"]:
        u = (jax.random.bits(key, dtype=jnp.uint32) >> 8).astype(float) * 2**-24
        return (u * EXTENT)[None]

    def step(self, key: Key[Array, ""], s: Float[Array, " 1"], a: Int[Array, ""]) -> Outcome:
        return Outcome(s, wave(s[0], self.width), jnp.asarray(True))

    def known_values(self) -> tuple[Float[Array, "N 1"], Float[Array, " N"]]:
        """Numbers that lie equally dense, and the targets there."""
        x = (jnp.arange(PLACES) + 0.5) * (EXTENT / PLACES)
        return x[:, None], wave(x, self.width)


def wave(x: Float[Array, "..."], width: float = 1.0) -> Float[Array, "..."]:
    """The target at a number: 1 from 0.5 to 1.5, where it is 1 wide."""
    left = (EXTENT - width) / 2
    return ((x >= left) & (x < EXTENT - left)).astype(float)
