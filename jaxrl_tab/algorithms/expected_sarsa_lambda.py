"""Expected Sarsa(lambda), on-policy and off (book, section 12.9)."""

from typing import ClassVar

from jaxrl_tab.algorithms.off_policy_traces import ExpectedTraces
from jaxrl_tab.algorithms.traces import TraceState
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class ExpectedSarsaLambda(ExpectedTraces):
    """Sarsa(lambda) whose error has the mean over A', not the one that is drawn.

    delta = R + gamma sum_a pi(a | S') Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda rho z(s, a) + 1[(s, a) = (S, A)]
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)      (book, equations 12.28 and 12.29)

    pi is the behaviour policy (on-policy, the default: rho = 1), or any other `target`, with rho = pi(A | S) / b(A | S)
    as it was when A was chosen. Products of such ratios may grow without bound: `Retrace` cuts them at 1. A' is drawn
    from the behaviour policy after the update.
    """

    on_policy: ClassVar[bool] = True
    weighs_by_ratios: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action", last="state, each action"),
        "π is the policy that acts. With another target an action that was taken, but for the first, goes on by "
        "π(A | S) / b(A | S), and the mean over actions takes the rest.",
    )

    def update(self, key, state: TraceState, t: Transition):
        rho = 1.0 if self.target is None else self.ratio(state, t.s, t.a)
        return self.traced(key, state, t, c=rho)
