"""Learning without acting: from a log of what somebody else did, and again from what was remembered.

The lecture gives four reasons why off-policy learning matters (Silver, lecture 5, "Off-Policy Learning"):

1. *Learn from observing humans or other agents*: put their transitions or episodes into an `Experience`, and
   `learn` from it.
2. *Re-use experience generated from old policies*: `replay` it. (`collect` logs a run as an `Experience`.)
3. *Learn about the optimal policy while following an exploratory policy*: that is `train` with `QLearning`.
4. *Learn about multiple policies while following one policy*: `train` (or `learn`, or `replay`) with
   `ManyTargets`.
"""

from functools import partial
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxrl_tab.algorithms.control import ValueControl
from jaxrl_tab.core import rng, tables
from jaxrl_tab.core.checks import check_pytree, concrete, numbers
from jaxrl_tab.core.declared import LearnsFrom, of_method
from jaxrl_tab.core.errors import InputError, whole
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.policies import Policy, Table, as_table
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import (
    Algorithm,
    Available,
    Environment,
    Task,
    Transition,
    check_available,
    check_counted,
    fitted,
    init_learner,
    restricted,
)
from jaxrl_tab.engine.loop import learner_key
from jaxrl_tab.engine.train import train
from jaxrl_tab.envs import ENVS
from jaxrl_tab.methods import METHODS

L = TypeVar("L")


# --- learning from it --------------------------------------------------------------------------------
def learn(
    key: PRNGKeyArray,
    algorithm: Algorithm[L],
    experience: Experience,
    num_states: int,
    num_actions: int,
    *,
    passes: int = 1,
    available: Any = None,
) -> L:
    """Learns from experience of somebody else, transition by transition, in the order of the log.

    One-step methods that learn about a target policy of their own need no more than the transitions:
    QLearning, ExpectedSarsa, TargetQLearning, DoubleQLearning, ManyTargets. Those with importance sampling,
    OffPolicyMonteCarlo and the off-policy ones of `prediction`, need to know the policy that acted,
    `behaviour=policies.Table(b)`. Where a method has such a behaviour policy, the actions of the log must be
    possible under it. What can be learned at all depends on which pairs (s, a) the log holds.

    Args:
        key: a JAX key, for what the method itself draws.
        algorithm: the method with its hyperparameters.
        experience: the log.
        num_states: the number of states of the task, terminal ones included.
        num_actions: the number of its actions.
        passes: how often to go through the log. Schedules go on counting.
        available: which actions there are in each state, bool [S, A], where a state does not have all.

    Returns:
        The state of the learner (`.q` is float [S, A]).

    Raises:
        InputError: the method can learn only from what it did itself; or the log is not experience of such a
            task, or not of the behaviour policy that the method was given; or it holds an action that is not
            available.
    """
    rng.check_key(key)
    algorithm = _checked(algorithm, experience, num_states, num_actions, available)
    task = Task(int(num_states), int(num_actions), _longest_episode(experience))
    return _learn(key, algorithm, experience, task, whole("learn", "passes", passes))


def replay(
    key: PRNGKeyArray,
    algorithm: Algorithm[L],
    experience: Experience,
    num_states: int,
    num_actions: int,
    *,
    num_updates: int,
    available: Any = None,
) -> L:
    """Learns again and again from remembered transitions, each drawn uniformly (Lin 1992).

    For one-step off-policy methods: QLearning, ExpectedSarsa, TargetQLearning, DoubleQLearning, ManyTargets
    and `prediction.OffPolicyTD`.
    Schedules by episode count the ends of episodes that were drawn.

    Args:
        key: a JAX key.
        algorithm: the method with its hyperparameters.
        experience: the memory; of one old policy or of many, in any order.
        num_states: the number of states of the task, terminal ones included.
        num_actions: the number of its actions.
        num_updates: how many transitions to draw, with replacement.
        available: as in `learn`.

    Returns:
        The state of the learner (`.q` is float [S, A]).

    Raises:
        InputError: as `learn`; or the method learns from whole episodes.
    """
    rng.check_key(key)
    algorithm = _checked(algorithm, experience, num_states, num_actions, available)
    if of_method(algorithm).learns_from.in_episodes:
        raise InputError(
            f"replay draws single transitions, and {type(algorithm).__name__} learns from whole episodes: "
            "learn takes it; or give a one-step method such as QLearning"
        )
    task = Task(int(num_states), int(num_actions), max_steps=1)
    return _replay(key, algorithm, experience, task, whole("replay", "num_updates", num_updates))


def _checked(algorithm: Any, experience: Any, num_states: int, num_actions: int, available: Any) -> Any:
    """The method as it is among the actions that are available. Raises InputError as `learn` does."""
    check_pytree("algorithm", algorithm, METHODS)
    if not isinstance(experience, Experience):
        raise InputError(f"experience must be an Experience, not {type(experience).__name__}")
    name, method = type(algorithm).__name__, of_method(algorithm)
    if method.learns_from is LearnsFrom.ITSELF:
        raise InputError(
            f"{name} can learn only from what it did itself; take QLearning for the optimal policy, or "
            "ExpectedSarsa(target=policies.Table(pi)) for the values of any policy, that of the log too"
        )
    behaviour = method.behaviour if isinstance(method.behaviour, Table) else None
    if method.learns_from.needs_behaviour and behaviour is None:
        raise InputError(
            f"{name} weighs what it learns by the policy that acted, which must be given: "
            "behaviour=policies.Table(b)"
        )
    experience.check(num_states, num_actions, behaviour)
    if available is None:
        return algorithm
    is_available = numbers("learn", "available", available)
    check_available("learn: available", is_available, num_states, num_actions)
    experience.check_available(is_available)
    return restricted(algorithm, is_available.astype(bool))


def _longest_episode(experience: Experience) -> int:
    last = concrete(experience.last)
    if last is None:
        return experience.last.shape[-1]  # a tracer has no values yet; no episode is longer than the log
    return int(np.diff(np.flatnonzero(last), prepend=-1).max())


UPDATE, DRAW = 0, 1  # decisions, as `rng` numbers them


def _beginning(algorithm: Any, experience: Experience, task: Task) -> tuple[Any, Transition, int]:
    """The learner before it learns, the transitions that it learns from, and how many there are."""
    learner = init_learner(algorithm, task)
    transitions = experience.transitions(algorithm.gamma, learner.q.dtype)
    return learner, transitions, len(transitions.s)


# `passes` and `num_updates` are not static: another number of them needs no new program.
@partial(jax.jit, static_argnums=3, inline=True)
def _learn(key, algorithm, experience, task, passes):
    stream, (learner, transitions, size) = rng.stream(key), _beginning(algorithm, experience, task)

    def update(learner, numbered):
        i, t = numbered
        learner, _ = algorithm.update(rng.as_key(rng.word(stream, i, UPDATE)), learner, t)
        return learner, None

    def one_pass(k, learner):
        return lax.scan(update, learner, (k * size + jnp.arange(size), transitions))[0]

    return lax.fori_loop(0, passes, one_pass, learner)


@partial(jax.jit, static_argnums=3, inline=True)
def _replay(key, algorithm, experience, task, num_updates):
    stream, (learner, transitions, size) = rng.stream(key), _beginning(algorithm, experience, task)

    def update(i, learner):
        update_key, draw_key = (rng.as_key(rng.word(stream, i, decision)) for decision in (UPDATE, DRAW))
        drawn = jax.random.randint(draw_key, (), 0, size)
        t = jax.tree.map(lambda x: tables.entry(x, drawn), transitions)
        learner, _ = algorithm.update(update_key, learner, t)
        return learner

    return lax.fori_loop(0, num_updates, update, learner)


# --- logging a run -----------------------------------------------------------------------------------
def collect(
    key: PRNGKeyArray, behaviour: Algorithm | Table | Float[Any, "S A"], env: Environment, num_steps: int
) -> Experience:
    """Logs what a method or a fixed policy does in an environment.

    Args:
        key: a JAX key. With a method it is the run of `train(key, method, env, num_steps=num_steps)`.
        behaviour: a method, which learns as it goes; or the probabilities of a policy, [S, A] or a
            `policies.Table` of them.
        env: the environment.
        num_steps: how many steps to log. The log cuts the last episode short, as a time limit would.

    Raises:
        InputError: an argument is wrong.
    """
    method = _method(behaviour)
    check_pytree("env", env, ENVS)
    check_counted("collect", env)
    method = fitted(method, env)
    logged = _Logged(method, init_learner(method, env, lambda: learner_key(rng.stream(key))))
    _, log = train(key, logged, env, num_steps=num_steps, log_every=1, record=_transition)
    assert log.recorded is not None
    t = Transition(**log.recorded)
    return Experience(t.s, t.a, t.r, t.s_next, terminal=t.discount == 0, last=t.last.at[-1].set(True))


def _method(behaviour: Any) -> Any:
    """What acts, as a method."""
    if isinstance(behaviour, type | str) or hasattr(behaviour, "update"):
        check_pytree("behaviour", behaviour, METHODS)
        return behaviour
    if isinstance(behaviour, Policy) and not isinstance(behaviour, Table):
        raise InputError(
            f"collect: {type(behaviour).__name__} chooses by Q, and nobody has learned one here; give its "
            "probabilities [S, A], such as planning.epsilon_greedy_policy(q, 0.1), or a method"
        )
    return _Acts(behaviour=as_table("behaviour", behaviour))


@pytree
class _Acts(ValueControl):
    """Acts and learns nothing."""

    acts_after_update: ClassVar[bool] = True

    def update(self, key, state, t: Transition):
        return state, self.policy(key, state, t.s_next)


class _LoggedState(NamedTuple):
    """What a method learned, and its last transition."""

    learner: Any
    t: Transition

    @property
    def q(self) -> Float[Array, "S A"]:
        return self.learner.q


def _transition(state: _LoggedState) -> dict[str, Array]:
    return state.t._asdict()


@pytree
class _Logged:
    """A method whose last transition can be seen."""

    method: Any
    start: Any  # the state of its learner before the first step

    @property
    def gamma(self) -> float:
        """1, so that gamma' tells terminal states, whatever the method's gamma is."""
        return 1.0

    @property
    def exploring_starts(self) -> bool:
        return of_method(self.method).exploring_starts

    def fitted_to(self, env: Any) -> Self:
        return self  # its method was, before it began

    def restricted_to(self, available: Available) -> Self:
        return self

    def init(self, num_states: int, num_actions: int) -> _LoggedState:
        zero, real = jnp.int32(0), jnp.zeros((), self.start.q.dtype)
        return _LoggedState(self.start, Transition(zero, zero, real, zero, real, jnp.bool(False)))

    def policy(self, key, state: _LoggedState, s: Int[Array, ""]) -> Int[Array, ""]:
        return self.method.policy(key, state.learner, s)

    def update(self, key, state: _LoggedState, t: Transition):
        discount = jnp.asarray(self.method.gamma, t.discount.dtype) * t.discount
        learner, a_next = self.method.update(key, state.learner, t._replace(discount=discount))
        return _LoggedState(learner, t), a_next
