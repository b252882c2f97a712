"""n-step Sarsa: between Sarsa and Monte Carlo (book, section 7.2; Silver, lecture 5)."""

from typing import ClassVar

from jaxrl_tab.algorithms.n_step import NStepControl, NStepState, Sums, bootstrapped
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


@pytree
class NStepSarsa(NStepControl):
    """On-policy control that learns from n rewards and the value after them.

    G_{t:t+n} = R_{t+1} + ... + gamma^{n-1} R_{t+n} + gamma^n Q(S_{t+n}, A_{t+n})      (book, equation 7.4)

    Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G_{t:t+n} - Q(S_t, A_t)]      (book, equation 7.5)

    S_t, A_t learns n - 1 steps later. Where the episode ends, the steps that are left learn too, the oldest
    first: up to a terminal state from fewer rewards and no value; at a time limit from the value of the state
    that was reached. n = 1 is Sarsa; with n at least as long as an episode it is Monte Carlo.

    A schedule of alpha gives what it was when the pair was visited.
    """

    remembers: ClassVar[type] = Sums
    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., state, action",
        "Where a terminal state comes before that, the rewards up to it, and no value.",
    )

    def update(self, key, state: NStepState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        memory = self.remember(state, t, g=0, weight=1).rewarded(t)
        return self.learned(state, t, memory, bootstrapped, self.x(t.s_next), a_next), a_next
