"""What the methods share that learn the average reward of a step beside Q (book, sections 10.3 and 10.4)."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core.clock import Clock
from jaxrl_tab.core.pytree import field, pytree


class RateState(NamedTuple):
    """A learner that keeps one table of differential action values, and the average reward.

    Attributes:
        q: Q, float [S, A]: how much more than the average comes from (s, a) on.
        rate: R-bar, the average reward of a step as it is estimated, float [].
        clock: what the schedules of alpha and epsilon count.
    """

    q: Float[Array, "S A"]
    rate: Float[Array, ""]
    clock: Clock


@pytree
class AverageReward(TDControl):
    """One-step control by the average reward of a step, in tasks that do not end. A method adds its `update`.

    Nothing is discounted, and what is learned are differences from the average: the sum of R - R-bar from (s, a) on.
    R-bar itself is recorded at the end of every row of the log, as `rate`. See `planning.relative_value_iteration`
    and `planning.average_reward` for the exact numbers.
    """

    gamma: float = field(default=1.0, at_least=1, at_most=1, help="Discount rate: there is none.")

    in_the_long_run: ClassVar[bool] = True
    records: ClassVar[tuple[str, ...]] = ("rate",)

    def init(self, num_states: int, num_actions: int) -> RateState:
        q, clock = super().init(num_states, num_actions)
        return RateState(q, jnp.zeros((), q.dtype), clock)
