"""Watkins's Q(lambda): Q-learning with eligibility traces (book, section 12.10; Watkins 1989)."""

from typing import ClassVar

from jaxrl_tab.algorithms.traces import TraceControl, TraceState
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class QLambda(TraceControl):
    """Q-learning whose error is credited to earlier pairs too, back to the last action that was not greedy.

    delta = R + gamma max_a Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda z(s, a) + 1[(s, a) = (S, A)],  but z = 0 before that if A is not greedy
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)          (book, 1st edition, section 7.6)

    What follows an exploring action says nothing about the greedy policy, so traces are cut there. A' is
    drawn from the behaviour policy before the update, and it is by the Q of that moment that it is greedy or
    not; a tie with the greedy action is greedy.
    """

    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action", last="state, max action")
        | {"or λ^(n−1)": "action, state, action, ..., state, max action"},
        "The last column is that of the end of the episode, or of the first action A_t+n that is not greedy, "
        "whichever comes first.",
    )

    def update(self, key, state: TraceState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        row_next = state.values.row(t.s_next)
        q_next = policies.largest(row_next)
        delta = t.r + t.discount * q_next - state.values.entry(t.s, t.a)
        is_greedy = tables.entry(row_next, a_next) == q_next
        return self.learn(state, t, delta, cut=~is_greedy), a_next
