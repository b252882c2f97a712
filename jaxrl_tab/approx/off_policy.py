"""Prediction off-policy with features: what diverges, and what does not (book, chapter 11).

One policy b acts while the values of another, pi, are learned. Each step counts by the ratio of the two,
rho = pi(A | S) / b(A | S).
"""

from typing import Any, ClassVar, NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrl_tab.algorithms.control import Learner
from jaxrl_tab.algorithms.prediction import OffPolicyPrediction, ValueState
from jaxrl_tab.algorithms.traces import TraceControl
from jaxrl_tab.approx.control import SemiGradientSarsa
from jaxrl_tab.approx.semi_gradient import SemiGradientPrediction
from jaxrl_tab.core import clock, linear, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.clock import Clock, Rate, end_step
from jaxrl_tab.core.credited import Credited
from jaxrl_tab.core.declared import LearnsFrom, name_of
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Environment, Transition


@pytree
class _OfStates(SemiGradientSarsa):
    """What these methods learn with: one action, of which each step counts by a ratio."""

    def error(self, state: Learner, t: Transition) -> Float[Array, ""]:
        """delta = R + gamma v(S') - v(S)."""
        return t.r + t.discount * self.value(state, t.s_next, t.a) - self.value(state, t.s, t.a)

    def weighed(self, state: Any, t: Transition, rho: Float[Array, ""]) -> Any:
        """The learner after a step that counts by this ratio."""
        return self.change(state, t, self.step_size(state, t) * rho * self.error(state, t))


@pytree
class OffPolicyLinear(SemiGradientPrediction, OffPolicyPrediction):
    """What the methods share whose V is linear in features while another policy acts."""

    multiplies_returns: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS_OF_B
    backup: ClassVar[Backup] = Backup(
        "state, action, state",
        "Another policy b acts: the error is multiplied by the ratio π(A | S) / b(A | S).",
    )

    def fitted_to(self, env: Environment) -> Self:
        if not env.num_states:
            problem = (
                f"it compares two policies state by state, and the states of {name_of(env)} cannot be counted"
            )
            raise InputError(problem, who=type(self).__name__)
        return super().fitted_to(env)

    def update(self, key, state: ValueState, t: Transition):
        assert state.target is not None
        rho = tables.entry(state.target, t.s, t.a) / tables.entry(state.acting, t.s, t.a)
        control, t = self.control(), t._replace(a=jnp.zeros_like(t.a))
        learner = control.weighed(control.begin(state.learner, t), t, rho)
        state = state._replace(learner=learner)
        return state, self.policy(key, state, t.s_next)


@pytree
class SemiGradientOffPolicyTD(OffPolicyLinear):
    """TD(0) with importance sampling, whose V is linear in features of the state.

    w <- w + alpha rho [R + gamma v(S') - v(S)] x(S),  v(s) = x(s) . w      (book, equation 11.2)

    It bootstraps, learns about another policy than the one that acts, and approximates: the "deadly triad", with which
    it may diverge, however small alpha is. In `Baird` it does.
    """

    method: ClassVar[type] = _OfStates


class GradientState(NamedTuple):
    """A learner with second weights, whose x . v is an estimate of the error in a state.

    Attributes:
        q: the weights w, float [n, 1].
        clock: what the schedules of alpha and beta count.
        v: the second weights, float [n, 1].
    """

    q: Float[Array, "n 1"]
    clock: Clock
    v: Float[Array, "n 1"]


@pytree
class _Gradient(_OfStates):
    """What gradient TD learns with. A method adds the step of w along x(S)."""

    beta: Rate = field(default=0.05, greater_than=0, help="Step size of the second weights.")

    @property
    def rates(self) -> tuple[Rate, ...]:
        return (self.alpha, self.beta)

    def init(self, num_states: int, num_actions: int) -> GradientState:
        w, clock = super().init(num_states, num_actions)
        return GradientState(w, clock, jnp.zeros_like(w))

    def along(self, delta: Float[Array, ""], estimate: Float[Array, ""]) -> Float[Array, ""]:
        """What the step of w along x(S) is made of: the error, or its estimate x(S) . v."""
        raise NotImplementedError

    def weighed(self, state: GradientState, t: Transition, rho: Float[Array, ""]) -> GradientState:
        delta, x, x_next = self.error(state, t), self.x(t.s), self.x(t.s_next)
        estimate = linear.entry(state.v, x, t.a)
        beta = clock.step_size(self.beta, state.clock, t.s, t.a)
        step = self.step_size(state, t) * rho
        v = linear.add(state.v, x, t.a, beta * rho * (delta - estimate))
        q = linear.add(state.q, x, t.a, step * self.along(delta, estimate))
        q = linear.add(q, x_next, t.a, -step * t.discount * estimate)
        return GradientState(q, end_step(state.clock, t.last), v)


@pytree
class _GTD2(_Gradient):
    def along(self, delta: Float[Array, ""], estimate: Float[Array, ""]) -> Float[Array, ""]:
        return estimate


@pytree
class _TDC(_Gradient):
    def along(self, delta: Float[Array, ""], estimate: Float[Array, ""]) -> Float[Array, ""]:
        return delta


@pytree
class GTD2(OffPolicyLinear):
    """Gradient TD, second version: it goes down the mean squared projected Bellman error, and so does not diverge.

    v <- v + beta rho [delta - v . x(S)] x(S),  delta = R + gamma x(S') . w - x(S) . w
    w <- w + alpha rho [x(S) - gamma x(S')] x(S) . v      (book, section 11.7; Sutton et al. 2009)

    w learns from the v before the step. v has to be the quicker one: beta should be larger than alpha. But where beta
    rho times the squared length of x(S) is above 2, v itself goes astray, in a run if not on average.
    """

    beta: Rate = field(default=0.05, greater_than=0, help="Step size of the second weights.")

    method: ClassVar[type] = _GTD2


@pytree
class TDC(GTD2):
    """TD(0) with gradient correction: it goes down the mean squared projected Bellman error, and so does not diverge.

    v <- v + beta rho [delta - v . x(S)] x(S),  delta = R + gamma x(S') . w - x(S) . w
    w <- w + alpha rho [delta x(S) - gamma x(S') x(S) . v]      (book, section 11.7; Sutton et al. 2009)

    It is also called GTD(0). w learns from the v before the step, and beta should be as in `GTD2`.
    """

    method: ClassVar[type] = _TDC


class EmphaticState(NamedTuple):
    """A learner with traces that knows how much the next step is emphasised.

    Attributes:
        values: w, and the traces as z / (rho M), to which a step adds x(S), whatever its ratio; each float [n, 1].
        clock: what the schedule of alpha counts.
        followed: rho gamma F of the step before, 0 at the start of an episode, float [].
    """

    values: Credited
    clock: Clock
    followed: Float[Array, ""]

    @property
    def q(self) -> Float[Any, "... n 1"]:
        """The weights w, float [n, 1]; of a batch [..., n, 1]."""
        return self.values.q


@pytree
class _Emphatic(_OfStates, TraceControl):  # pyright: ignore[reportIncompatibleMethodOverride] (of `learn`)
    trace: ClassVar = "accumulating"  # pyright: ignore[reportIncompatibleVariableOverride]

    def init(self, num_states: int, num_actions: int) -> EmphaticState:
        values, clock = super().init(num_states, num_actions)
        return EmphaticState(values, clock, jnp.zeros_like(values.credit))

    def emphasis(self, followed: Float[Array, ""]) -> Float[Array, ""]:
        """M of a step, from rho gamma F of the one before."""
        return self.lam + (1 - self.lam) * (1 + followed)

    def weighed(self, state: EmphaticState, t: Transition, rho: Float[Array, ""]) -> EmphaticState:
        emphasis = self.emphasis(state.followed)
        step = self.step_size(state, t) * emphasis * rho * self.error(state, t)
        values = state.values.learned(self.x(t.s), t.a, 1.0, 1.0, step)
        followed = jnp.where(t.last, 0, rho * t.discount * (1 + state.followed))
        fades = t.discount * self.lam * rho * emphasis / self.emphasis(followed)
        return EmphaticState(
            values.faded(jnp.where(t.last, 0, fades)), end_step(state.clock, t.last), followed
        )


@pytree
class EmphaticTD(OffPolicyLinear):
    """Emphatic TD(lambda): states count as often as pi would come to them, had it begun in any that b comes to.

    F <- gamma rho F + 1      (rho of the step before; F = 1 at the start of an episode)
    M = lambda + (1 - lambda) F
    z <- rho (gamma lambda z + M x(S))
    w <- w + alpha [R + gamma v(S') - v(S)] z      (book, section 12.11; Sutton, Mahmood and White 2016)

    With lambda = 0 it is one-step emphatic TD, w <- w + alpha M rho delta x(S), of section 11.8. In expectation it does
    not diverge where alpha is small enough. But F is a product of ratios, whose variance may be so large that no run
    comes near: in `Baird` none does.
    """

    lam: float = field(default=0.0, at_least=0, at_most=1, help="lambda.")

    method: ClassVar[type] = _Emphatic
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    backup: ClassVar[Backup] = Backup(
        lambda_return("state", "action, state"),
        "Another policy b acts. Traces carry each error back to earlier states, times the ratios π(A | S) / b(A | S) "
        "and the emphasis of each; with λ = 0 there is the first column alone.",
    )
