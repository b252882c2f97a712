"""Q(lambda) with off-policy corrections: traces without ratios and without cuts (Harutyunyan et al. 2016)."""

from typing import ClassVar

from jaxrl_tab.algorithms.off_policy_traces import ExpectedTraces
from jaxrl_tab.algorithms.traces import TraceState
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class QPiLambda(ExpectedTraces):
    """Off-policy control whose traces go on whatever is done, as it were on-policy: Q^pi(lambda).

    delta = R + gamma sum_a pi(a | S') Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda z(s, a) + 1[(s, a) = (S, A)]
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)      (Harutyunyan et al. 2016)

    pi is any `target`, by default the greedy policy: then it is Q*(lambda), the naive `QLambda` but for A', which is
    drawn from the behaviour policy after the update. The rewards are those of b, and each error is corrected by the
    mean under pi; nothing is cut, and nothing multiplied by a ratio. That suffices where b is near pi: Q goes to q_pi
    for lambda < (1 - gamma) / (gamma x), with x the largest sum over the actions of a state of |pi - b|; `Retrace` is
    safe for all.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES
    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action", last="state, each action"),
        "From each action that was taken, but for the first, its value is taken off, and the mean over actions under "
        "π is added.",
    )

    def update(self, key, state: TraceState, t: Transition):
        return self.traced(key, state, t, c=1.0)
