"""The mountain car (book, example 10.1; Moore 1990)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT

GOAL = 0.5
WIDTH, HEIGHT = 60, 9  # of a drawing, in characters


@pytree
class MountainCar(Shown):
    """Drive a car with a weak engine up a steep hill: it must first back up the slope behind it.

    A state is the position of the car, -1.2 to 0.5, and its velocity, -0.07 to 0.07. An action pushes it back (0), not
    at all (1), or forward (2), and each step gives -1. An episode starts at rest, anywhere in [-0.6, -0.4) with equal
    probability, and ends where the position is 0.5.

        velocity <- bound[velocity + 0.001 (A - 1) - 0.0025 cos(3 position)]
        position <- bound[position + velocity];  at the left bound the velocity becomes 0
    """

    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_states = 0  # they cannot be counted
    num_actions = 3
    low = (-1.2, -0.07)
    high = (GOAL, 0.07)
    number_names = ("position", "velocity")
    action_names = ("back", "none", "forward")

    def reset(self, key: Key[Array, ""]) -> Float[Array, " 2"]:
        u = (jax.random.bits(key, dtype=jnp.uint32) >> 8).astype(float) * 2**-24
        return jnp.stack([u * 0.2 - 0.6, jnp.zeros_like(u)])

    def step(self, key: Key[Array, ""], s: Float[Array, " 2"], a: Int[Array, ""]) -> Outcome:
        position, velocity = s
        push = 0.001 * (a.astype(s.dtype) - 1)
        velocity = jnp.clip(velocity + push - 0.0025 * jnp.cos(3 * position), -0.07, 0.07)
        position = jnp.clip(position + velocity, -1.2, GOAL)
        velocity = jnp.where(position <= -1.2, 0, velocity)
        return Outcome(jnp.stack([position, velocity]), -jnp.ones_like(position), position >= GOAL)

    def picture(self, s: Float[np.ndarray, " 2"]) -> tuple[str, ...]:
        """The hill, sin(3 position), with the car on it, and the flag at the goal."""
        row = lambda x: round((1 - np.sin(3 * x)) / 2 * (HEIGHT - 1))
        lines = [[" "] * WIDTH for _ in range(HEIGHT)]
        for k, x in enumerate(np.linspace(self.low[0], GOAL, WIDTH)):
            lines[row(x)][k] = "·"
        lines[row(GOAL)][-1] = "⚑"
        column = round((float(s[0]) - self.low[0]) / (GOAL - self.low[0]) * (WIDTH - 1))
        lines[row(float(s[0]))][column] = "●"
        return tuple("".join(line).rstrip() for line in lines)
