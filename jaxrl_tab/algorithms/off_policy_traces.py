"""What the methods with traces share that learn from the mean over actions, on-policy or off (book, section 12.9)."""

from jaxtyping import Array, Float

from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.algorithms.traces import TraceControl, TraceState
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class ExpectedTraces(OffPolicyControl, TraceControl):
    """Control whose error has the mean value of S' under the target policy, and whose traces go on by a factor c.

    delta = R + gamma sum_a pi(a | S') Q(S', a) - Q(S, A)
    z(s, a) <- gamma lambda c z(s, a) + 1[(s, a) = (S, A)]
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)

    A method says what c is, of pi and b for the action A that was taken in S, as they were then (Munos et al. 2016,
    equation 3 and table 1).
    """

    def traced(self, key, state: TraceState, t: Transition, c: Float[Array, ""] | float):
        """The learner after a step, and A', which is drawn from the behaviour policy after the update."""
        state = state._replace(values=state.values.faded(c))
        state = self.begin(state, t)
        q_next = self.target_probs(state, t.s_next) @ self.row(state, t.s_next)
        delta = t.r + t.discount * q_next - self.value(state, t.s, t.a)
        state = self.learn(state, t, delta)
        return state, self.policy(key, state, t.s_next)
