"""Prediction: learn the values v_pi of a given policy (Silver, lecture 4; book, chapters 5 to 7 and 12).

A table of state values is a table of action values with **one action**. Told that every action was the same
one, Sarsa is TD(0), n-step Sarsa is n-step TD, Sarsa(lambda) is TD(lambda), and Monte Carlo control averages
the returns of states. So a method here is a method of control that never hears which action was taken, while
pi acts. (Action values q_pi need nothing new: give a method of control `behaviour=policies.Table(pi)`.)

Off-policy, b acts while v_pi is learned; ratios rho = pi(A | S) / b(A | S) then come in.

    state, log = rl.train(key, rl.prediction.TD(pi=probs, alpha=0.1), env, num_episodes=100, exact=True)
    state.v, log.v_error          # V [S]; the root of its mean squared error at the end of each row
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.algorithms import (
    MonteCarlo,
    NStepSarsa,
    OffPolicyMonteCarlo,
    Sarsa,
    SarsaLambda,
    SarsaLambdaForward,
    TrueOnlineSarsaLambda,
)
from jaxrl_tab.algorithms.n_step_of_states import NStepOfStates
from jaxrl_tab.algorithms.off_policy_monte_carlo import Weighting
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.clock import Rate
from jaxrl_tab.core.coverage import check_coverage
from jaxrl_tab.core.declared import Learns, LearnsFrom, of_environment
from jaxrl_tab.core.errors import InputError, unfit
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.policies import EpsilonGreedy, Policy, Table
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.schedules import sample_average
from jaxrl_tab.core.types import (
    Available,
    Environment,
    State,
    Task,
    Transition,
    fitted,
    init_learner,
    restricted,
)
from jaxrl_tab.exact import planning

_FIRST_VISIT = "Only the return from the first time that a state occurs in an episode counts."


class ValueState(NamedTuple):
    """A learner of state values.

    Attributes:
        learner: the state of a method of control with one action; its Q is V, float [S, 1].
        acting: the policy that acts, float [S, A].
        target: the policy that is learned about, float [S, A]; None where it is the same.
    """

    learner: Any
    acting: Float[Array, "S A"]
    target: Float[Array, "S A"] | None

    @property
    def q(self) -> Float[Any, "... S 1"]:
        return self.learner.q

    @property
    def v(self) -> Float[Any, "... S"]:
        """V, float [S]; of a batch of learners [..., S]."""
        return self.learner.q[..., 0]


@pytree
class Prediction(Shown):
    """What all methods of prediction share.

    Each names its method of control, and passes on the hyperparameters that both have.
    """

    pi: Any = field(
        default=None,
        help="The policy whose values are learned: probabilities float [S, A], or a policies.Table of them; "
        "None: that of which the task says that it is asked about; else all actions are equally likely.",
    )
    alpha: Rate = field(default=0.1, greater_than=0, help="Step size.")
    gamma: float = field(default=1.0, at_least=0, at_most=1, help="Discount rate.")
    v0: float = field(default=0.0, help="Initial value of every entry of V.")

    learns: ClassVar[Learns] = Learns.STATES
    acts_after_update: ClassVar[bool] = True
    method: ClassVar[type]  # the method of control that learns V

    def __post_init__(self):
        _as_table(self, "pi")
        try:
            self.control()
        except InputError as error:  # it names the method of control, which the user did not
            raise error.renamed(type(self).__name__) from None

    def control(self, **policies: Table) -> Any:
        """The method of control that learns V, with the hyperparameters that both have, and these policies."""
        names = {field.name for field in dataclasses.fields(self.method)}
        shared = {name: getattr(self, name) for name in names - {"behaviour"} if hasattr(self, name)}
        return self.method(q0=self.v0, **shared, **policies)

    def fitted_to(self, env: Environment) -> Self:
        """The method with the policies of which the task says that they act and are asked about, where it has none."""
        stated = {"pi": of_environment(env).target_policy, "behaviour": of_environment(env).behaviour_policy}
        new = {name: x for name, x in stated.items() if x is not None and getattr(self, name, x) is None}
        return dataclasses.replace(self, **new) if new else self

    def restricted_to(self, available: Available, **more: Any) -> Self:
        """The method where states have these actions only, as `TDControl.restricted_to`."""
        return dataclasses.replace(self, pi=_among(self.pi, available), **more)

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ValueState:
        learner = init_learner(self.control(), Task(num_states, 1, max_steps))
        return ValueState(learner, _probabilities(self.pi, num_states, num_actions), None)

    def policy(self, key: Key[Array, ""], state: ValueState, s: Int[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, tables.row(state.acting, s))

    def update(self, key, state: ValueState, t: Transition):
        learner, _ = self.control().update(key, state.learner, t._replace(a=jnp.zeros_like(t.a)))
        state = state._replace(learner=learner)
        return state, self.policy(key, state, t.s_next)

    def row(self, state: ValueState, s: State) -> Float[Array, " 1"]:
        """V(s), as the one action value of what learns it, float [1]."""
        return self.control().row(state.learner, s)

    def exact_value(self, env: Environment) -> float:
        """v_pi from the start distribution, float64; -inf where pi may go round for ever at a cost."""
        method = fitted(self, env)
        return planning.policy_value(env, method.probabilities(env), self.gamma)

    def probabilities(self, env: Environment) -> Float[np.ndarray, "S A"]:
        """pi, float64 [S, A]; of a method that is `restricted_to` what the environment has."""
        with jax.enable_x64():
            return np.asarray(self.policies(env)[0])

    def policies(self, env: Environment) -> tuple[Float[Array, "S A"], Float[Array, "S A"] | None]:
        """pi, and the policy that acts, None where that is pi; of a method that is `restricted_to` what there is."""
        return _probabilities(self.pi, env.num_states, env.num_actions), None

    def measurer(self, env: Environment):
        """What `train(exact=True)` records: the root of the mean squared error of V, from the state."""
        planning.check_finite(env)
        with planning.doubled():
            pi, _ = self.policies(env)
        measure = planning.value_measurer(env, pi, self.gamma)
        return lambda state: {"v_error": measure(self.everywhere(state, env.num_states))}

    def everywhere(self, state: ValueState, num_states: int) -> Float[Array, " S"]:
        """V, float [S]."""
        return state.v


@pytree
class TD(Prediction):
    """TD(0), prediction that learns from one reward and the value after it: R + gamma V(S').

    V(S) <- V(S) + alpha [R + gamma V(S') - V(S)]      (book, equation 6.2)
    """

    method: ClassVar[type] = Sarsa
    backup: ClassVar[Backup] = Backup("state, action, state")


@pytree
class NStepTD(Prediction):
    """Prediction that learns from n rewards and the value after them.

    V(S_t) <- V(S_t) + alpha [R_{t+1} + ... + gamma^n V(S_{t+n}) - V(S_t)]      (book, equation 7.2)
    """

    n: int = static(default=4, at_least=1, help="How many rewards it looks ahead.")

    method: ClassVar[type] = NStepSarsa
    backup: ClassVar[Backup] = Backup("state, action, state, ..., action, state", NStepSarsa.backup.words)


@pytree
class TDLambda(Prediction):
    """TD(lambda), whose error is credited to all states of the episode so far, the more the later they came.

    delta = R + gamma V(S') - V(S)
    z(s) <- gamma lambda z(s) + 1[s = S]        (accumulating; Silver, lecture 4)
    V(s) <- V(s) + alpha delta z(s)      (book, section 12.2)
    """

    lam: float = field(default=0.9, at_least=0, at_most=1, help="lambda.")
    trace: Literal["accumulating", "replacing", "dutch"] = static(
        default="accumulating", help="The kind of traces; with dutch ones it is true online TD(lambda)."
    )
    offline: bool = static(
        default=False,
        help="Keep V as it is in an episode, and add the sum of all increments at its end: off-line TD(lambda) "
        "(Silver, lecture 4), not the book's off-line lambda-return algorithm; see `SarsaLambda`. It goes with "
        "accumulating traces.",
    )

    method: ClassVar[type] = SarsaLambda
    backup: ClassVar[Backup] = Backup(
        lambda_return("state", "action, state"), SarsaLambda.backup.words.replace("pairs", "states")
    )


@pytree
class TrueOnlineTDLambda(TDLambda):
    """TD(lambda) with dutch traces, at every step the lambda-returns that look as far as that step.

    delta = R + gamma V(S') - V(S)
    z(s) <- gamma lambda z(s) + [1 - alpha gamma lambda z(S)] 1[s = S]
    V(s) <- V(s) + alpha (delta + V(S) - V_old) z(s) - alpha (V(S) - V_old) 1[s = S]
    V_old <- V(S')      (book, section 12.5; van Seijen and Sutton 2014)

    It is `TDLambda(trace="dutch")`, by its name.
    """

    trace: ClassVar = "dutch"  # pyright: ignore[reportIncompatibleVariableOverride]
    offline: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]

    method: ClassVar[type] = TrueOnlineSarsaLambda
    backup: ClassVar[Backup] = Backup(TDLambda.backup.columns, TrueOnlineSarsaLambda.backup.words)


@pytree
class OfflineLambdaReturn(Prediction):
    """Prediction towards the lambda-return, which mixes all n-step returns, at the end of the episode.

    V(S_t) <- V(S_t) + alpha [G_t^lambda - V(S_t)] for t = 0, 1, ...      (book, section 12.1)

    The lambda-returns have the V of the start of the episode, and the updates are made one after another (equation
    12.4). Their sum by that V alone is `TDLambda(offline=True)`.
    """

    lam: float = field(default=0.9, at_least=0, at_most=1, help="lambda.")

    one_by_one: ClassVar[bool] = True
    method: ClassVar[type] = SarsaLambdaForward
    backup: ClassVar[Backup] = Backup(
        TDLambda.backup.columns, "At the end of the episode, by the V of its start, one state after another."
    )


@pytree
class MonteCarloPrediction(Prediction):
    """Prediction that learns from whole returns, at the end of the episode.

    V(S_t) <- V(S_t) + alpha [G_t - V(S_t)]      (book, section 5.1 and equation 6.1)
    """

    alpha: Rate = field(
        default=sample_average(), help="Step size. By default 1/N(s): V is the mean of the returns."
    )
    first_visit: bool = static(default=False, help=_FIRST_VISIT)

    method: ClassVar[type] = MonteCarlo
    backup: ClassVar[Backup] = Backup("state, action, state, ..., end", MonteCarlo.backup.words)


# --- off-policy --------------------------------------------------------------------------------------


@pytree
class OffPolicyPrediction(Prediction):
    """What the methods share that learn v_pi while another policy acts."""

    behaviour: Any = field(
        default=None,
        help="b, the policy that acts, as `pi` is given; b(a | s) > 0 wherever pi(a | s) > 0. None: that of which the "
        "task says that it acts; else all actions are equally likely.",
    )

    def __post_init__(self):
        _as_table(self, "behaviour")
        super().__post_init__()
        if self.behaviour is not None:
            any_action = EpsilonGreedy(1.0)
            check_coverage(type(self).__name__, any_action if self.pi is None else self.pi, self.behaviour)

    def restricted_to(self, available: Available, **more: Any) -> Self:
        return super().restricted_to(available, behaviour=_among(self.behaviour, available), **more)

    def policies(self, env: Environment) -> tuple[Float[Array, "S A"], Float[Array, "S A"] | None]:
        return super().policies(env)[0], _probabilities(self.behaviour, env.num_states, env.num_actions)

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ValueState:
        state = super().init(num_states, num_actions, max_steps)
        acting = _probabilities(self.behaviour, num_states, num_actions)
        return state._replace(acting=acting, target=state.acting)


@pytree
class OffPolicyTD(OffPolicyPrediction, TD):
    """TD(0) with importance sampling (Silver, lecture 5).

    V(S) <- V(S) + alpha [rho (R + gamma V(S')) - V(S)]

    One ratio for one step: its variance is far lower than that of whole returns.
    """

    multiplies_returns: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS_OF_B
    backup: ClassVar[Backup] = Backup(
        "state, action, state",
        "Another policy b acts: R + gamma V(S') is multiplied by the ratio π(A | S) / b(A | S).",
    )

    def update(self, key, state: ValueState, t: Transition):
        assert state.target is not None
        control, one = self.control(), jnp.zeros_like(t.a)
        rho = tables.entry(state.target, t.s, t.a) / tables.entry(state.acting, t.s, t.a)
        t = t._replace(a=one)
        learner = control.begin(state.learner, t)
        v_next = tables.entry(learner.q, t.s_next, one)
        delta = rho * (t.r + t.discount * v_next) - tables.entry(learner.q, t.s, one)
        state = state._replace(learner=control.learn(learner, t, delta))
        return state, self.policy(key, state, t.s_next)


@pytree
class NStepOffPolicyTD(OffPolicyPrediction, NStepTD):
    """n-step TD with importance sampling (book, sections 7.3 and 7.4).

    V(S_t) <- V(S_t) + alpha rho_{t:t+n-1} [G_{t:t+n} - V(S_t)]      (equation 7.9)

    rho is the product of the ratios pi(A | S) / b(A | S) over the n actions from A_t on. With `control_variates` there
    is one ratio for each decision, and where it is 0 the value stays instead of falling to 0:

    V(S_t) <- V(S_t) + alpha [G_{t:t+n} - V(S_t)],  G_{t:h} = rho_t (R_{t+1} + gamma G_{t+1:h}) + (1 - rho_t) V(S_t)
                                                                                                  (equation 7.13)

    (Off-policy TD, `OffPolicyTD`, multiplies the target alone, as the lecture does.)
    """

    control_variates: bool = static(default=False, help="One ratio for each decision, with control variates.")

    multiplies_returns: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    method: ClassVar[type] = NStepOfStates
    backup: ClassVar[Backup] = Backup(
        NStepTD.backup.columns,
        "Another policy b acts. The error counts by the product of π(A | S) / b(A | S) over the actions from A_t on.",
    )

    def update(self, key, state: ValueState, t: Transition):
        assert state.target is not None
        rho = tables.entry(state.target, t.s, t.a) / tables.entry(state.acting, t.s, t.a)
        learner = self.control().weighed(state.learner, t._replace(a=jnp.zeros_like(t.a)), rho)
        state = state._replace(learner=learner)
        return state, self.policy(key, state, t.s_next)


@pytree
class _OfStates(OffPolicyMonteCarlo):
    """Off-policy Monte Carlo with one entry a state, of which the ratio of its own action is a part."""

    of_states: ClassVar[bool] = True

    @property
    def all_policies(self) -> tuple[Policy, ...]:
        return ()  # tables, which do not go by visits, and have as many actions as the task

    def rest(self, state, t: Transition) -> Float[Array, ""]:
        return t.discount * tables.entry(state.q, t.s_next, self.column(t.a))

    def column(self, a: Int[Array, ""]) -> Int[Array, ""]:
        return jnp.zeros_like(a)


@pytree
class OffPolicyMonteCarloPrediction(OffPolicyPrediction):
    """Monte Carlo with importance sampling (book, section 5.5): the mean of returns G of b, weighted.

    V(s) = sum_t rho_{t:T-1} G_t / sum_t rho_{t:T-1}, over the visits t of s      (book, equation 5.6)

    "ordinary" averages rho_{t:T-1} G (book, equation 5.5): unbiased, and its variance may be infinite.
    "weighted" divides by the sum of the ratios (equation 5.6): biased, and far closer. "per-decision" weighs
    each reward by the ratios up to it (section 5.9).
    """

    alpha: Rate = field(
        default=sample_average(), help="Step size. By default 1/N(s): what is averaged counts equally."
    )
    weighting: Weighting = static(default="weighted", help="The kind of importance sampling.")
    first_visit: bool = static(default=False, help=_FIRST_VISIT)

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.EPISODES_OF_B
    method: ClassVar[type] = _OfStates
    backup: ClassVar[Backup] = Backup(
        "state, action, state, ..., end",
        "Another policy b acts: the return counts by the product of π(A | S) / b(A | S) over the actions from A_t on.",
    )

    @property
    def multiplies_returns(self) -> bool:
        return self.weighting != "weighted"

    def update(self, key, state: ValueState, t: Transition):
        control = self.control(behaviour=Table(state.acting), target=Table(state.target))
        learner, _ = control.update(key, state.learner, t)
        state = state._replace(learner=learner)
        return state, self.policy(key, state, t.s_next)


def _as_table(obj: Any, name: str) -> None:
    """Makes the probabilities in field `name` a Table."""
    value, who = getattr(obj, name), type(obj).__name__
    if value is None:
        return
    if not isinstance(value, Table | Sequence | np.ndarray | jax.Array):
        raise unfit(who, name, "probabilities [S, A], or a policies.Table of them", value)
    try:
        object.__setattr__(obj, name, value if isinstance(value, Table) else Table(value))
    except InputError as error:
        raise error.renamed(who, name) from None


def _among(table: Table | None, available: Available) -> Table:
    return policies.uniform(available) if table is None else restricted(table, available)


def _probabilities(table: Table | None, num_states: int, num_actions: int) -> Float[Array, "S A"]:
    if table is None:
        return jnp.full((num_states, num_actions), 1 / num_actions, dtype=float)
    table.check(num_states, num_actions)
    return jnp.asarray(table.probabilities, float)


OF_STATES: dict[str, type] = {
    "td": TD,
    "n-step-td": NStepTD,
    "td-lambda": TDLambda,
    "true-online-td-lambda": TrueOnlineTDLambda,
    "offline-lambda-return": OfflineLambdaReturn,
    "monte-carlo-prediction": MonteCarloPrediction,
    "off-policy-td": OffPolicyTD,
    "n-step-off-policy-td": NStepOffPolicyTD,
    "off-policy-monte-carlo-prediction": OffPolicyMonteCarloPrediction,
}
