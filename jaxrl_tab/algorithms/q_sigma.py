"""Q(sigma): from tree backup to sampling, step by step (book, section 7.6; De Asis et al. 2018)."""

from typing import ClassVar, NamedTuple

from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.n_step import Branching, NStepState
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Rate, exploration
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Transition


class Steps(NamedTuple):
    """The last n steps: S and A, int32 [n]; alpha, R, the ratio pi(A | S) / b(A | S) and sigma of A, float [n]."""

    s: Int[Array, "*n"]
    a: Int[Array, "*n"]
    alpha: Float[Array, "*n"]
    r: Float[Array, "*n"]
    ratio: Float[Array, "*n"]
    sigma: Float[Array, "*n"]


@pytree
class QSigma(Branching):
    """n-step control that samples at each step by a part sigma, and takes the mean over actions by the rest.

    G_{t:h} = R_{t+1} + gamma {sum_a pi(a | S_{t+1}) Q(S_{t+1}, a) + c_{t+1} [G_{t+1:h} - Q(S_{t+1}, A_{t+1})]},
    c_t = sigma_t rho_t + (1 - sigma_t) pi(A_t | S_t)      (book, equation 7.17)

    Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G_{t:t+n} - Q(S_t, A_t)]

    sigma = 0 is tree backup; sigma = 1 is n-step Sarsa with ratios for each decision and control variates (equation
    7.14). pi is the behaviour policy (on-policy, the default: rho = 1), or any other `target`, with rho = pi(A | S) /
    b(A | S) as it was when A was chosen.

    The paper has no control variates: what is sampled counts as it was drawn, and {...} above is

    sigma rho G + (1 - sigma) [sum_a pi(a | S) Q(S, a) + pi(A | S) (G - Q(S, A))]

    The last state counts by its mean, whatever sigma is, so that n = 1 is Expected Sarsa; in the paper it too is drawn
    by a part sigma.

    pi and Q are those of the moment of the update; steps learn as in `NStepSarsa`, and A' is drawn from the
    behaviour policy after the update.
    """

    sigma: Rate = field(
        default=0.5,
        at_least=0,
        at_most=1,
        help="How much it samples: 0 is tree backup, 1 is Sarsa. A schedule gives what it was when the action was "
        'chosen; the dynamic one of the paper, .95 times as much with each episode, is "exponential:1:0.95:episode".',
    )

    control_variates: bool = static(
        default=True,
        help="Count what is sampled by how far it is from its mean (the book), or as it is (the paper).",
    )

    remembers: ClassVar[type] = Steps
    on_policy: ClassVar[bool] = True
    weighs_by_ratios: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    backup: ClassVar[Backup] = Backup(
        "action, state, each action, ..., state, each action",
        "The action that was taken goes on with the weight σ ρ + (1 − σ) π(A | S), where ρ = π(A | S) / b(A | S) is 1 "
        "if π acts: σ = 1 samples, σ = 0 is tree backup.",
    )

    @property
    def rates(self) -> tuple[Rate, ...]:
        return (*super().rates, self.sigma)

    def update(self, key, state: NStepState, t: Transition):
        ratio = 1.0 if self.target is None else self.ratio(state, t.s, t.a)
        sigma = exploration(self.sigma, state.clock, t.s)
        follow = _with_control_variates if self.control_variates else _as_drawn
        state = self.branched(self.begin(state, t), t, follow, ratio=ratio, sigma=sigma)
        return state, self.policy(key, state, t.s_next)


def _with_control_variates(expected, q, pi, g, step):
    return expected + (step.sigma * step.ratio + (1 - step.sigma) * pi) * (g - q)


def _as_drawn(expected, q, pi, g, step):
    return step.sigma * step.ratio * g + (1 - step.sigma) * (expected + pi * (g - q))
