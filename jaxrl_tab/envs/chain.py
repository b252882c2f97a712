"""The chain, where steps may slip (Dearden, Friedman and Russell 1998; Strens 2000)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import Numbers, unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart

FORWARD, BACK = range(2)


@pytree
class Chain(FixedStart):
    """Go forward along a chain for 10 at its end, or back to its beginning for 2: a task that does not end.

    Forward (action 0) leads to the next state for nothing, and in the last state stays there for 10. Back (action 1)
    leads to the first state for 2. With the probability `slip` an action does what the other one would.

    The best policy always goes forward. It earns slip 2 + (1 - slip)^S 10 a step, 3.6768 here: 3677 in 1000 steps,
    the unit in which Strens gives what is learned. Who looks only a little ahead goes back for 2 for ever.
    """

    states: int = static(default=5, at_least=2, help="Number of states.")
    slip: Numbers = field(
        default=0.2,
        at_least=0,
        at_most=1,
        help="Probability that an action does what the other one would do.",
    )
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions, start_state = 2, 0
    continuing = True

    @property
    def num_states(self) -> int:
        return self.states

    @property
    def action_names(self) -> tuple[str, ...]:
        return "forward", "back"

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """What forward does, and what back does."""
        slip = unbatched(self, "slip", ndim=0)
        s, last = jnp.asarray(s, jnp.int32), jnp.int32(self.states - 1)
        forward = jnp.where(a == FORWARD, 1 - slip, slip)
        s_next = jnp.stack([jnp.minimum(s + 1, last), jnp.zeros_like(s)])
        reward = jnp.stack([jnp.where(s == last, 10.0, 0.0), jnp.asarray(2.0)]).astype(float)
        return jnp.stack([forward, 1 - forward]), Outcome(s_next, reward, jnp.zeros(2, bool))
