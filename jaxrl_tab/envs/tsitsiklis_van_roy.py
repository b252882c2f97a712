"""The counterexample of Tsitsiklis and Van Roy (book, example 11.1; Tsitsiklis and Van Roy 1996)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import Numbers, unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart

FIRST, SECOND, END = range(3)


@pytree
class TsitsiklisVanRoy(FixedStart):
    """Two states worth w and 2w by their one feature, with which least squares and dynamic programming diverge.

    There is one action and no reward. It leads from the first state, 0, to the second, 1, which stays where it is, but
    for the probability `ends` of coming to the end, state 2. So both values are 0, and w = 0 is right. Yet a w that
    makes w and 2w the nearest to gamma 2w and (1 - ends) gamma 2w, both states counting the same, is (6 - 4 ends) / 5
    gamma times the w before: it grows where gamma > 5 / (6 - 4 ends).
    """

    ends: Numbers = field(
        default=0.01, greater_than=0, at_most=1, help="Probability that the second state ends."
    )
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_states, num_actions, start_state = 3, 1, FIRST

    @property
    def features(self) -> Float[np.ndarray, "3 1"]:
        """1, 2, and 0 at the end, float64 [3, 1]."""
        return np.array([[1.0], [2.0], [0.0]])

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        ends = unbatched(self, "ends", ndim=0)
        over = s == END
        ends = jnp.where(over, 1.0, jnp.where(s == SECOND, ends, 0.0))
        s_next = jnp.array([SECOND, END], jnp.int32)
        return jnp.stack([1 - ends, ends]), Outcome(s_next, jnp.zeros(2, float), s_next == END)
