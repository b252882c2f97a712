"""Semi-gradient control: the methods of the lecture with a Q that is linear in features (book, chapters 10 and 12)."""

from typing import ClassVar, Literal

from jaxrl_tab.algorithms.differential_sarsa import DifferentialSarsa
from jaxrl_tab.algorithms.expected_sarsa import ExpectedSarsa
from jaxrl_tab.algorithms.q_learning import QLearning
from jaxrl_tab.algorithms.sarsa import Sarsa
from jaxrl_tab.algorithms.true_online_sarsa_lambda import TrueOnlineSarsaLambda
from jaxrl_tab.approx.optimized import OptimizedControl, OptimizedNStepControl, OptimizedTraceControl
from jaxrl_tab.approx.semi_gradient import SemiGradientControl
from jaxrl_tab.core.pytree import pytree, static


@pytree
class SemiGradientSarsa(OptimizedControl, Sarsa):
    """Sarsa whose Q is linear in features of the state.

    w(., A) <- w(., A) + alpha [R + gamma q(S', A') - q(S, A)] x(S),  q(s, a) = x(s) . w(., a)
                                                                            (book, box of section 10.1)

    A' is drawn from the behaviour policy before the update, and is the action that is then taken.
    """


@pytree
class SemiGradientExpectedSarsa(OptimizedControl, ExpectedSarsa):
    """Expected Sarsa whose Q is linear in features of the state.

    w(., A) <- w(., A) + alpha [R + gamma sum_a pi(a | S') q(S', a) - q(S, A)] x(S)      (book, section 10.1)

    pi is the policy that acts, or any other `target`; with another it learns off-policy, where with features it may
    diverge: see `SemiGradientQLearning`.
    """


@pytree
class SemiGradientQLearning(OptimizedControl, QLearning):
    """Q-learning whose Q is linear in features of the state.

    w(., A) <- w(., A) + alpha [R + gamma max_a q(S', a) - q(S, A)] x(S)      (book, section 11.1)

    It bootstraps, learns about another policy than the one that acts, and approximates: the "deadly triad", with which
    no step size is safe in general (section 11.3). Near the greedy policy it is seldom seen to diverge.
    """


@pytree
class SemiGradientNStepSarsa(OptimizedNStepControl):
    """n-step Sarsa whose Q is linear in features of the state.

    G_{t:t+n} = R_{t+1} + ... + gamma^{n-1} R_{t+n} + gamma^n q(S_{t+n}, A_{t+n})      (book, equation 10.4)
    w(., A_t) <- w(., A_t) + alpha [G_{t:t+n} - q(S_t, A_t)] x(S_t)      (book, equation 10.5)

    Which step learns when is as in `NStepSarsa`. With n at least as long as an episode it is gradient Monte Carlo.
    """


@pytree
class SemiGradientSarsaLambda(OptimizedTraceControl):
    """Sarsa(lambda) whose Q is linear in features of the state.

    delta = R + gamma q(S', A') - q(S, A)
    z(., .) <- gamma lambda z,  then z(., A) <- z(., A) + x(S)      (accumulating)
    w <- w + alpha delta z      (book, section 12.7)

    A replacing trace of a feature that is 1 is 1 (figure 12.10); where it is clearing, those of the other actions are
    0 (figure 12.11; Singh and Sutton 1996); with dutch ones it is true online Sarsa(lambda).
    """

    offline: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]

    trace: Literal["accumulating", "replacing", "clearing", "dutch"] = static(  # pyright: ignore[reportIncompatibleVariableOverride]
        default="replacing",
        help="The trace of a feature that comes again grows by it; or is 1; or is 1, and 0 for the other actions; or "
        "grows by 1 - alpha z . x(S) times it.",
    )


@pytree
class SemiGradientTrueOnlineSarsaLambda(SemiGradientControl, TrueOnlineSarsaLambda):
    """True online Sarsa(lambda) whose Q is linear in features of the state.

    delta = R + gamma q(S', A') - q(S, A)
    z <- gamma lambda z,  then z(., A) <- z(., A) + [1 - alpha z(., A) . x(S)] x(S)
    w <- w + alpha (delta + q(S, A) - q_old) z,  then w(., A) <- w(., A) - alpha (q(S, A) - q_old) x(S)
    q_old <- q(S', A')      (book, box of section 12.7; van Seijen et al. 2016)

    It follows no gradient, for alpha is a part of its traces: so there is no `optimizer`.
    """


@pytree
class DifferentialSemiGradientSarsa(SemiGradientControl, DifferentialSarsa):
    """Sarsa by the average reward of the policy that acts, with a Q that is linear in features of the state.

    delta = R - R-bar + q(S', A') - q(S, A)
    R-bar <- R-bar + beta delta
    w(., A) <- w(., A) + alpha delta x(S)      (book, box of section 10.3)

    For tasks that do not end.
    """
