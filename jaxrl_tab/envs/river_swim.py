"""River swim: swim against the current to what is worth it (Strehl and Littman 2008)."""

import functools
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Finite

LEFT, RIGHT = range(2)


class Numbers(NamedTuple):
    """A variant of the task, as it was published.

    Attributes:
        first, middle, last: the probabilities of what swimming right does: one state left, none, one right.
        small: the reward of swimming left in the first state.
        large: that of swimming right in the last one.
        staying: whether `large` is given only where the swimmer stays there.
        starts: in which states episodes start, each equally likely.
    """

    first: tuple[float, float, float]
    middle: tuple[float, float, float]
    last: tuple[float, float, float]
    small: float
    large: float
    staying: bool
    starts: tuple[int, ...]


VARIANTS = {
    "strehl-littman": Numbers((0, 0.7, 0.3), (0.1, 0.6, 0.3), (0.7, 0.3, 0), 5, 10_000, True, (1, 2)),
    "osband": Numbers((0, 0.4, 0.6), (0.05, 0.6, 0.35), (0.4, 0.6, 0), 0.005, 1, False, (0,)),
}


@pytree
class RiverSwim(Finite):
    """Swim right against the current for much, or left with it for little: a task that does not end.

    The states are in a row. Left (action 0) always leads one to the left, and pays a little in the first state. Right
    (action 1) mostly leads nowhere, sometimes one to the right, sometimes one to the left; only in the last state it
    pays, and much. Who only tries now and then hardly gets there. Two variants are usual:

    - "strehl-littman" (2008, figure 1): right leads right with 0.3 and left with 0.1, in the first state right with
      0.3 and in the last left with 0.7; 5 in the first state, 10 000 where one stays in the last; starts in 1 or 2.
    - "osband" (Osband, Russo and Van Roy 2013): 0.35 and 0.05, in the first state right with 0.6, in the last left with
      0.4; 0.005 for left in the first state, 1 for right in the last; starts in state 0.

    The best policy swims right everywhere. It earns 668.807 a step in the first variant and 0.428622 in the second.
    """

    variant: Literal["strehl-littman", "osband"] = static(
        default="strehl-littman", help="Whose numbers they are."
    )
    states: int = static(default=6, at_least=3, help="Number of states.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = 2
    continuing = True

    @property
    def num_states(self) -> int:
        return self.states

    @property
    def action_names(self) -> tuple[str, ...]:
        return "left", "right"

    def initial(self) -> Float[Array, " S"]:
        starts = VARIANTS[self.variant].starts
        return jnp.zeros(self.states, dtype=float).at[np.array(starts)].set(1 / len(starts))

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """One state left, none, one right."""
        prob, reward = (jnp.asarray(x, float)[s, a] for x in _tables(self.variant, self.states))
        s_next = jnp.clip(jnp.asarray(s, jnp.int32) + jnp.arange(-1, 2, dtype=jnp.int32), 0, self.states - 1)
        return prob, Outcome(s_next, reward, jnp.zeros(3, bool))


@functools.lru_cache(maxsize=64)
def _tables(variant: str, states: int) -> tuple[np.ndarray, np.ndarray]:
    """The probability and the reward of each outcome, float64 [S, A, 3]."""
    numbers = VARIANTS[variant]
    prob, reward = np.zeros((2, states, 2, 3))
    prob[1:, LEFT, 0] = prob[0, LEFT, 1] = 1
    prob[0, RIGHT], prob[1:-1, RIGHT], prob[-1, RIGHT] = numbers.first, numbers.middle, numbers.last
    reward[0, LEFT] = numbers.small
    reward[-1, RIGHT, 1 if numbers.staying else 0 :] = numbers.large
    return prob, reward
