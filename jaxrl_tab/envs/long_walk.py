"""The random walk of a thousand states, which goes many at a time (book, example 9.1)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart


@pytree
class LongWalk(FixedStart):
    """Jump to one of the 100 states next to it on either side, from the middle of a thousand until beyond either end.

    The states in a row: 0 is the left end, 1 to `states` are between, `states` + 1 is the right end. Both ends are
    terminal. All 2 `jump` places are equally likely, and those beyond an end are that end. Entering the right one gives
    1, entering the left one -1, all else 0. There is nothing to choose: one action, as in `RandomWalk`, for which state
    goes to which is all that there is to it.
    """

    states: int = static(default=1000, at_least=1, help="Number of states between the ends.")
    jump: int = static(default=100, at_least=1, help="How many states it may go at a time.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = 1

    @property
    def num_states(self) -> int:
        return self.states + 2

    @property
    def start_state(self) -> int:
        return (self.states + 1) // 2

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        k = jnp.arange(2 * self.jump, dtype=jnp.int32)
        return jnp.full(2 * self.jump, 1 / (2 * self.jump), dtype=float), self._outcome(s, k)

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        # All are equally likely, so that none has to be looked for among their probabilities.
        return self._outcome(s, jax.random.randint(key, (), 0, 2 * self.jump, jnp.int32))

    def _outcome(self, s: Int[Array, ""], k: Int[Array, "*K"]) -> Outcome:
        """What jump number k leads to, from the farthest to the left to the farthest to the right."""
        left, right = 0, self.states + 1
        s = jnp.asarray(s, jnp.int32)
        over = (s == left) | (s == right)
        by = k - self.jump + (k >= self.jump)
        s_next = jnp.where(over, s, jnp.clip(s + by, left, right))
        reward = (s_next == right).astype(float) - (s_next == left).astype(float)
        return Outcome(s_next, jnp.where(over, 0.0, reward), (s_next == left) | (s_next == right))
