"""Two loops of different length: the best in the long run, or for who discounts (Mahadevan 1996)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import Numbers, unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart

SHORT, LONG = range(2)


@pytree
class TwoLoops(FixedStart):
    """Go round a short loop for little or a long one for much: a task that does not end.

    There is one choice, in state 0: short (action 0) or long (action 1). Then every action leads on along the loop,
    and its last step comes back to state 0 and pays. So a robot may serve a printer, 5 steps for 5, or fetch the mail,
    10 steps for 20 (after Mahadevan 1996; written from memory, for no public copy of that page was found). In the long
    run the long loop is the better one, with 2 a step and not 1; but with gamma^5 < 1/3, up to 0.8027, the short one
    has the larger discounted value.
    """

    short: int = static(default=5, at_least=1, help="Steps of the short loop.")
    long: int = static(default=10, at_least=1, help="Steps of the long loop.")
    short_reward: Numbers = field(default=5.0, help="What the short loop pays.")
    long_reward: Numbers = field(default=20.0, help="What the long loop pays.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions, start_state = 2, 0
    continuing = True

    @property
    def num_states(self) -> int:
        return self.short + self.long - 1

    @property
    def action_names(self) -> tuple[str, ...]:
        return "short", "long"

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """Between its ends the short loop has the states 1 to short - 1, and the long one those after them."""
        s, first = jnp.asarray(s, jnp.int32), jnp.int32(self.short)
        is_long = jnp.where(s == 0, a == LONG, s >= first)
        entered = jnp.where((s == 0) & is_long, first, s + 1)
        ends = jnp.where(is_long, jnp.int32(self.num_states), first)
        is_back = entered >= ends
        pays = jnp.where(
            is_long,
            unbatched(self, "long_reward", ndim=0),
            unbatched(self, "short_reward", ndim=0),
        )
        reward = jnp.where(is_back, pays, 0).astype(float)
        return jnp.ones(1), Outcome(jnp.where(is_back, 0, entered)[None], reward[None], jnp.zeros(1, bool))
