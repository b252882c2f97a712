"""The one-state loop with infinite variance (book, example 5.5)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import Numbers, unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart


@pytree
class InfiniteVariance(FixedStart):
    """Go left round a loop, until it lets go with a reward of 1, or right and end with 0.

    From state 0 left (action 0) leads back with probability `back` and reward 0, and otherwise to the end,
    state 1, with reward 1. Right (action 1) ends with reward 0. With gamma 1 "always left" has the value 1.
    Seen from a behaviour that goes either way with probability 1/2, a return of 1 after k steps has the
    importance ratio 2^k and the probability back^(k-1) (1 - back) / 2^k, so the mean of its square is the
    sum over k of 2 (1 - back) (2 back)^(k-1): infinite from `back` = 1/2 on. An ordinary importance-sampling
    average then tends to 1 with certainty, but its error has no variance to shrink. `back` is a leaf: `vmap`
    can batch it.
    """

    back: Numbers = field(default=0.9, at_least=0, less_than=1, help="Probability that left leads back.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_states, num_actions, start_state = 2, 2, 0

    @property
    def action_names(self) -> tuple[str, ...]:
        return "left", "right"

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        over, left = s == 1, a == 0
        back = jnp.where(left, unbatched(self, "back", ndim=0), 0)
        s_next = jnp.where(over, 1, jnp.array([0, 1], jnp.int32))
        reward = jnp.where(left & ~over, jnp.array([0, 1], float), 0)
        return jnp.stack([back, 1 - back]), Outcome(s_next, reward, s_next == 1)
