"""Q(lambda): Q-learning with eligibility traces, by Watkins, by Peng, and naive (book, section 12.10)."""

from typing import ClassVar, Literal

from jaxrl_tab.algorithms.traces import TraceControl, TraceState
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Transition


@pytree
class QLambda(TraceControl):
    """Q-learning whose error is credited to earlier pairs too; Watkins's, back to the last action that was not greedy.

    delta = R + gamma max_a Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda z(s, a) + 1[(s, a) = (S, A)],  but z = 0 before that if A is not greedy
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)          (book, 1st edition, section 7.6)

    What follows an exploring action says nothing about the greedy policy, so Watkins (1989) cuts the traces there.
    A' is drawn from the behaviour policy before the update, and it is by the Q of that moment that it is greedy or
    not; a tie with the greedy action is greedy.

    The other versions never cut. The naive one (book, 1st edition, section 7.6) is the same otherwise. Peng's (Peng and
    Williams 1996) credits the other pairs with an error of greedy values, and this pair with its own:

    Q(s, a) <- Q(s, a) + alpha [R + gamma max_a Q(S', a) - max_a Q(S, a)] z(s, a),  with z as before this step
    Q(S, A) <- Q(S, A) + alpha delta

    It is the mean of the n-step returns that end with a maximum, whatever actions are on the way; so of neither it is
    known that Q goes to q* while it explores.
    """

    version: Literal["watkins", "peng", "naive"] = static(
        default="watkins",
        help="Watkins's cuts the traces at an action that is not greedy; Peng's and the naive one do not.",
    )

    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action", last="state, max action")
        | {"or λ^(n−1)": "action, state, action, ..., state, max action"},
        "The last column is that of the end of the episode, or of the first action A_t+n that is not greedy, "
        "whichever comes first; of Peng's and of the naive version, that of the end.",
    )

    def update(self, key, state: TraceState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        row_next = self.row(state, t.s_next)
        q_next = policies.largest(row_next)
        delta = t.r + t.discount * q_next - self.value(state, t.s, t.a)
        if self.version == "peng":
            # The others are told of another error; what that is less for this pair, it is told alone.
            less = policies.largest(self.row(state, t.s)) - self.value(state, t.s, t.a)
            alpha = self.step_size(state, t)
            state, delta = (
                state._replace(values=state.values.added(self.x(t.s), t.a, alpha * less)),
                delta - less,
            )
        cut = self.version == "watkins" and tables.entry(row_next, a_next) != q_next
        return self.learn(state, t, delta, cut), a_next
