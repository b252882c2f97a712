"""The random walk (book, examples 6.2 and 7.1)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import Numbers, unbatched
from jaxrl_tab.core.errors import unfit
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart


@pytree
class RandomWalk(FixedStart):
    """Step left or right by the toss of a coin, from the middle until either end; there is nothing to choose.

    The states in a row: 0 is the left end, 1 to `states` are between, `states` + 1 is the right end. Both
    ends are terminal. Entering the right one gives 1, entering the left one `left_reward`, all else 0. There
    is one action. With gamma 1 the value of state i is left_reward + (1 - left_reward) i / (states + 1).
    """

    states: int = static(
        default=19,
        at_least=1,
        help="Number of states between the ends, odd; 19 in example 7.1, 5 in example 6.2.",
    )
    left_reward: Numbers = field(
        default=-1.0, help="Reward at the left end; -1 in example 7.1, 0 in example 6.2."
    )
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = 1

    def __post_init__(self):
        if self.states % 2 == 0:
            requirement = "odd, so that there is a middle to start in"
            raise unfit(type(self).__name__, "states", requirement, self.states)

    @property
    def num_states(self) -> int:
        return self.states + 2

    @property
    def start_state(self) -> int:
        return (self.states + 1) // 2

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        left_reward = unbatched(self, "left_reward", ndim=0)
        left, right = 0, self.states + 1
        s = jnp.asarray(s, jnp.int32)
        over = (s == left) | (s == right)
        s_next = jnp.where(over, s, s + jnp.array([-1, 1], jnp.int32))
        reward = jnp.where(s_next == left, left_reward, jnp.where(s_next == right, 1.0, 0.0))
        terminal = (s_next == left) | (s_next == right)
        return jnp.full(2, 0.5, dtype=float), Outcome(s_next, jnp.where(over, 0.0, reward), terminal)
