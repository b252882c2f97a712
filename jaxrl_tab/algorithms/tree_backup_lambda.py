"""Tree-backup(lambda): traces without ratios, whatever policy acts (book, section 12.10; Precup et al. 2000)."""

from typing import ClassVar

from jaxrl_tab.algorithms.off_policy_traces import ExpectedTraces
from jaxrl_tab.algorithms.traces import TraceState
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class TreeBackupLambda(ExpectedTraces):
    """Off-policy control with traces that go on by the probability of the action under the target: TB(lambda).

    delta = R + gamma sum_a pi(a | S') Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda pi(A | S) z(s, a) + 1[(s, a) = (S, A)]
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)      (book, section 12.10)

    pi is any `target`, by default the greedy policy, with which it is Watkins's Q(lambda) but for ties and for A',
    which is drawn from the behaviour policy after the update. pi is that of the moment when A was chosen.
    """

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES
    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, each action"),
        "Of the actions of a state the one that was taken goes on, and the others count with their values.",
    )

    def update(self, key, state: TraceState, t: Transition):
        return self.traced(key, state, t, c=tables.entry(self.target_probs(state, t.s), t.a))
