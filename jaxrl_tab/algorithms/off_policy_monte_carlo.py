"""Off-policy Monte Carlo: whole returns of one policy, weighted so that they speak of another."""

from typing import ClassVar, Literal

from jaxtyping import Array, Float

from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.algorithms.whole_returns import FIRST_VISIT, MonteCarloState, WholeReturns
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Rate
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.core.types import Transition

Weighting = Literal["weighted", "ordinary", "per-decision"]


@pytree
class OffPolicyMonteCarlo(OffPolicyControl, WholeReturns):
    """Monte Carlo that learns about a target policy pi from episodes of a behaviour policy b.

    At the end of the episode, for its steps from the last to the first, beginning with W = 1:

        G <- R_{t+1} + gamma G
        C(S_t, A_t) <- C(S_t, A_t) + W
        Q(S_t, A_t) <- Q(S_t, A_t) + W / C(S_t, A_t) [G - Q(S_t, A_t)]
        W <- W pi(A_t | S_t) / b(A_t | S_t)

    That is weighted importance sampling with the greedy target, by default (book, boxes of sections 5.6 and
    5.7); it is biased, and its error is far smaller. "ordinary" averages W G (book, equation 5.5), and is
    unbiased; "per-decision" averages G with a ratio on each reward for the actions up to it alone, which is
    G <- R_{t+1} + gamma rho_{t+1} G (book, section 5.9). A target that depends on Q is as Q is when the
    walk back comes to its state, as in the box.

    Where a time limit cuts an episode short, the mean value under pi of the state in which it did counts as
    the rest.
    """

    alpha: Rate = field(
        default=sample_average(),
        help="Step size. By default 1/N(s, a): what is averaged counts equally. Weighted averages then have "
        "the book's W/C, with C = the sum of all W so far.",
    )
    weighting: Weighting = static(default="weighted", help="The kind of importance sampling.")
    first_visit: bool = static(default=False, help=FIRST_VISIT)

    weighs_by_ratios: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., end",
        "Another policy b acts. The return counts by the product of π(A | S) / b(A | S) over the actions after A_t, so "
        "that with the greedy π nothing is learned from what comes before an action that is not greedy.",
    )

    @property
    def multiplies_returns(self) -> bool:
        return self.weighting != "weighted"

    def update(self, key, state: MonteCarloState, t: Transition):
        b = tables.entry(self.probs(state, t.s), t.a)
        state = self.learned(state, t, self.pi, b)
        return state, self.policy(key, state, t.s_next)

    def rest(self, state: MonteCarloState, t: Transition) -> Float[Array, ""]:
        return t.discount * (self.target_probs(state, t.s_next) @ tables.row(state.q, t.s_next))
