"""The recycling robot (book, example 3.3)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.core.checks import unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart, Panel

HIGH, LOW = range(2)
SEARCH, WAIT, RECHARGE = range(3)


@pytree
class RecyclingRobot(FixedStart):
    """Search for cans, wait for them, or go and recharge; a robot that runs down is rescued, at a cost.

    States are the battery, high and low; actions are to search, to wait, and to recharge, which there is only where it
    is low. Searching leaves a high battery high with probability `alpha` of the book, here `stays_high`, and a low one
    low with `beta`, here `stays_low`; else the high one is low, and the low one is empty: the robot is carried home,
    where it is charged, for a reward of -3. To wait changes nothing, and recharging gives 0. The book leaves the
    probabilities and the other rewards open, but that searching gives more cans than waiting.

    It goes on for ever, and needs a gamma below 1. It starts with a high battery.
    """

    stays_high: float = field(
        default=0.7, at_least=0, at_most=1, help="Probability that searching leaves a high battery high."
    )
    stays_low: float = field(
        default=0.6, at_least=0, at_most=1, help="Probability that searching leaves a low battery low."
    )
    search_reward: float = field(default=2.0, help="Cans found by searching, on average.")
    wait_reward: float = field(default=1.0, help="Cans brought while it waits, on average.")
    rescue_reward: float = field(default=-3.0, help="Reward of running down.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_states, num_actions, start_state = 2, 3, HIGH
    continuing = True

    @property
    def action_names(self) -> tuple[str, ...]:
        return "search", "wait", "recharge"

    def panels(self) -> tuple[Panel, ...]:
        return (Panel("", np.array([[HIGH, LOW]]), ("",), ("high", "low"), "", "battery"),)

    def available(self, s: Int[Array, ""]) -> Bool[Array, " A"]:
        """The actions that there are in `s`, bool [3]: to recharge only where the battery is low."""
        return (jnp.arange(3) != RECHARGE) | (s == LOW)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        high, low, search, wait, rescue = (
            unbatched(self, name, ndim=0)
            for name in ("stays_high", "stays_low", "search_reward", "wait_reward", "rescue_reward")
        )
        s, searches = jnp.asarray(s, jnp.int32), a == SEARCH
        stays = jnp.where(searches, jnp.where(s == HIGH, high, low), jnp.where(a == WAIT, 1.0, 0.0))
        reward = jnp.where(searches, search, jnp.where(a == WAIT, wait, 0.0))
        other = jnp.where(searches, jnp.where(s == HIGH, search, rescue), 0.0)
        return jnp.stack([stays, 1 - stays]), Outcome(
            jnp.stack([s, 1 - s]), jnp.stack([reward, other]), jnp.zeros(2, bool)
        )
