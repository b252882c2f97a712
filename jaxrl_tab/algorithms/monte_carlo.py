"""Monte Carlo control: learn from whole returns (book, sections 5.3 and 5.4; Silver, lecture 5)."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.whole_returns import FIRST_VISIT, MonteCarloState, WholeReturns
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Rate
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.core.types import Transition


@pytree
class MonteCarlo(WholeReturns):
    """Generalised policy iteration on whole returns: G = R_1 + gamma R_2 + ..., Q(S, A) <- mean of the G's.

    At the end of the episode, for its steps from the last to the first:

        G <- R_{t+1} + gamma G
        N(S_t, A_t) <- N(S_t, A_t) + 1
        Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G - Q(S_t, A_t)]      (alpha = 1/N unless another is given)

    With `epsilon=schedules.glie()` this is the lecture's GLIE Monte Carlo control. The policy is improved
    after every `batch` episodes, and does not change in between, schedules included: with many it is policy
    iteration. (Q still has the returns of earlier policies in it; a constant alpha forgets them.)

    Where a time limit cuts an episode short, the mean value of the state in which it did counts as the rest.
    """

    alpha: Rate = field(
        default=sample_average(), help="Step size. By default 1/N(s, a): Q is the mean of the returns."
    )
    first_visit: bool = static(default=False, help=FIRST_VISIT)
    batch: int = static(default=1, at_least=1, help="Episodes per improvement of the policy.")
    exploring_starts: bool = static(
        default=False,
        help="Every episode starts in any state, with any action, equally likely (book, section 5.3); epsilon "
        "may then be 0.",
    )

    acts_after_update: ClassVar[bool] = True
    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., end",
        "The whole return. A value is looked up only where a time limit cuts it off.",
    )

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> MonteCarloState:
        state = super().init(num_states, num_actions, max_steps)
        return state if self.batch == 1 else state._replace(acting=(state.q, state.clock))

    def probs(self, state: Any, s: Int[Array, ""]) -> Float[Array, " A"]:
        q, clock = state.acting or (state.q, state.clock)
        return self.selection.probs(tables.row(q, s), clock, s)

    def rest(self, state: MonteCarloState, t: Transition) -> Float[Array, ""]:
        return t.discount * (self.probs(state, t.s_next) @ tables.row(state.q, t.s_next))

    def update(self, key, state: MonteCarloState, t: Transition):
        state = self.learned(state, t)
        if state.acting is not None:
            improve, present = t.last & (state.clock.episode % self.batch == 0), (state.q, state.clock)
            acting = jax.tree.map(lambda new, old: jnp.where(improve, new, old), present, state.acting)
            state = state._replace(acting=acting)
        return state, self.policy(key, state, t.s_next)
