"""n-step tree backup: off-policy learning without importance sampling (book, section 7.5; Precup et al. 2000)."""

from typing import ClassVar, NamedTuple

from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.n_step import Branching, NStepState
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition


class Steps(NamedTuple):
    """The last n steps: S and A, int32 [n]; alpha and R, float [n]."""

    s: Int[Array, "*n"]
    a: Int[Array, "*n"]
    alpha: Float[Array, "*n"]
    r: Float[Array, "*n"]


@pytree
class TreeBackup(Branching):
    """Off-policy control that learns from all actions at each of n states, and so needs no ratios.

    G_{t:t+n} = R_{t+1} + gamma sum_{a != A_{t+1}} pi(a | S_{t+1}) Q(S_{t+1}, a)
                + gamma pi(A_{t+1} | S_{t+1}) G_{t+1:t+n}      (book, equation 7.16)

    Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G_{t:t+n} - Q(S_t, A_t)]

    pi is any `target`, by default the greedy policy (book, box of section 7.5), so that it looks no further than the
    first action that is not greedy. Whatever acts, it learns rightly. n = 1 is Expected Sarsa of the target, which is
    Q-learning by default. pi and Q are those of the moment of the update; steps learn as in `NStepSarsa`, and A' is
    drawn from the behaviour policy after the update.
    """

    remembers: ClassVar[type] = Steps
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES
    backup: ClassVar[Backup] = Backup(
        "action, state, each action, ..., state, each action",
        "Of the actions of a state the one that was taken goes on, and the others count with their values; π is "
        "greedy, or any target.",
    )

    def update(self, key, state: NStepState, t: Transition):
        state = self.branched(self.begin(state, t), t, _follow)
        return state, self.policy(key, state, t.s_next)


def _follow(expected, q, pi, g, step):
    """The values of all actions, and G in place of that of the one that was taken."""
    return expected + pi * (g - q)
