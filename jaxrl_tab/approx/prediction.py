"""Semi-gradient prediction: the values of a given policy as a linear function of features (book, chapters 9 and 12)."""

from typing import ClassVar

from jaxrl_tab.algorithms.prediction import TD, NStepTD, TDLambda, TrueOnlineTDLambda
from jaxrl_tab.approx.control import (
    SemiGradientNStepSarsa,
    SemiGradientSarsa,
    SemiGradientSarsaLambda,
    SemiGradientTrueOnlineSarsaLambda,
)
from jaxrl_tab.approx.optimized import Optimized
from jaxrl_tab.approx.semi_gradient import SemiGradientPrediction
from jaxrl_tab.core.pytree import pytree


@pytree
class SemiGradientTD(Optimized, SemiGradientPrediction, TD):
    """TD(0) whose V is linear in features of the state.

    w <- w + alpha [R + gamma v(S') - v(S)] x(S),  v(s) = x(s) . w      (book, box of section 9.3)
    """

    method: ClassVar[type] = SemiGradientSarsa


@pytree
class SemiGradientNStepTD(Optimized, SemiGradientPrediction, NStepTD):
    """n-step TD whose V is linear in features of the state.

    w <- w + alpha [R_{t+1} + ... + gamma^n v(S_{t+n}) - v(S_t)] x(S_t)      (book, equation 9.15)
    """

    method: ClassVar[type] = SemiGradientNStepSarsa


@pytree
class SemiGradientTDLambda(Optimized, SemiGradientPrediction, TDLambda):
    """TD(lambda) whose V is linear in features of the state.

    z <- gamma lambda z + x(S)      (book, equation 12.5)
    w <- w + alpha [R + gamma v(S') - v(S)] z      (book, equation 12.7)
    """

    offline: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]

    method: ClassVar[type] = SemiGradientSarsaLambda


@pytree
class SemiGradientTrueOnlineTDLambda(SemiGradientPrediction, TrueOnlineTDLambda):
    """True online TD(lambda) whose V is linear in features of the state.

    z <- gamma lambda z + [1 - alpha gamma lambda z . x(S)] x(S)      (book, equation 12.11)
    w <- w + alpha (delta + v(S) - v_old) z - alpha (v(S) - v_old) x(S)      (book, box of section 12.5)

    It follows no gradient, for alpha is a part of its traces: so there is no `optimizer`.
    """

    method: ClassVar[type] = SemiGradientTrueOnlineSarsaLambda
