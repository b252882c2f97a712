"""The vocabulary of the package: what an environment answers, what a method learns from.

Everything here is written for **one** transition; `jax.vmap` makes the batches. Symbols follow
Sutton and Barto (2018): S, A, R, S', A', gamma, alpha, epsilon, pi, delta.
"""

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import Protocol, runtime_checkable  # quick ones, as since Python 3.12

from jaxrl_tab.core import rng
from jaxrl_tab.core.checks import concrete, first
from jaxrl_tab.core.declared import name_of, of_environment, of_method
from jaxrl_tab.core.errors import InputError, shown

T = TypeVar("T")

L = TypeVar("L")

Available: TypeAlias = Bool[Array, "S A"] | Bool[np.ndarray, "S A"]
"""Which actions there are in each state."""


State: TypeAlias = Int[Array, ""] | Float[Array, " d"]
"""A state: its number, int32 []; or, where states cannot be counted, the numbers that it is, float [d]."""


# --- what environments and methods exchange ----------------------------------------------------------
class Outcome(NamedTuple):
    """What an environment answers to an action.

    Attributes:
        s_next: the state S' that was entered, a `State`; terminal states are states too.
        reward: R, float [].
        terminal: whether S' is terminal, bool []. A time limit is not the environment's business here.
    """

    s_next: Int[Array, "*k"] | Float[Array, "*k d"]
    reward: Float[Array, "*k"]
    terminal: Bool[Array, "*k"]


class Transition(NamedTuple):
    """What a method learns from: (S, A, R, S', gamma').

    Attributes:
        s: S, a `State`.
        a: A, int32 [].
        r: R, float [].
        s_next: S', a `State`: the one before any reset.
        discount: gamma', float []: gamma, and 0 only where S' is terminal. At a time limit it stays gamma,
            so a method that multiplies its bootstrap with it does the right thing in both cases.
        last: whether the episode ends here, by S' or by the time limit, bool [].
    """

    s: State
    a: Int[Array, ""]
    r: Float[Array, ""]
    s_next: State
    discount: Float[Array, ""]
    last: Bool[Array, ""]


class Task(NamedTuple):
    """How large a task is: what a method must know of it before it learns.

    Attributes:
        num_states: the number of states, terminal ones included.
        num_actions: the number of actions.
        max_steps: the longest that an episode may get, in steps.
    """

    num_states: int
    num_actions: int
    max_steps: int


@runtime_checkable
class Environment(Protocol):
    """A task: a frozen pytree whose numbers are leaves and whose sizes are static.

    What else it can do, it declares (`declared.OfEnvironment`).

    It may have a method `instance(key) -> Environment`, which draws the problem of one run; `train` calls it
    once. `mean_optimal_value(gamma) -> float` may then say the mean over problems of v* from the start.

    It may have a method `at(step) -> Environment`, which gives the task in a step of a run: a task that changes. Its
    sizes and its starts stay the same; each step is drawn from what it is then.

    Where a state does not have every action, a method `available(s) -> bool [A]` says which there are in `s`,
    at least one, in terminal states too. Nobody then takes another one, and no maximum and no mean counts it:
    see `restricted`.

    Attributes:
        num_states: the number of states, terminal ones included; 0 where they cannot be counted, for a state is some
            numbers, between its `low` and `high` (see `declared.OfEnvironment`). Then it takes a method of `approx`.
        num_actions: the number of actions, the same in every state.
        max_steps: the time limit of an episode, in steps; reaching it truncates and does not terminate.
    """

    @property
    def num_states(self) -> int: ...
    @property
    def num_actions(self) -> int: ...
    @property
    def max_steps(self) -> int: ...

    def reset(self, key: Key[Array, ""]) -> State:
        """Draws a start state."""
        ...

    def step(self, key: Key[Array, ""], s: Any, a: Int[Array, ""]) -> Outcome:
        """Draws what follows action `a` in state `s`."""
        ...


@runtime_checkable
class FiniteEnvironment(Environment, Protocol):
    """An environment that states its dynamics, so that exact values exist."""

    def initial(self) -> Float[Array, " S"]:
        """The exact distribution of the start state, float [S]."""
        ...

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """The K possible outcomes of `a` in `s`: their probabilities, float [K], and an Outcome of [K] each.

        A terminal state leads to itself with reward 0.
        """
        ...


@runtime_checkable
class Algorithm(Protocol[L]):
    """A control method: a frozen pytree. The instance *is* its hyperparameters, so `vmap` batches them.

    Attributes:
        gamma: the discount rate, in [0, 1].

    What else there is to know about it, it declares by attributes of its class: see `declared.OfMethod`.

    Where the environment says which actions are `available`, the method is asked for one like itself that takes
    and counts no others: `restricted_to(available) -> Algorithm`, available bool [S, A].
    """

    @property
    def gamma(self) -> Any: ...

    def init(self, num_states: int, num_actions: int) -> L:
        """The state of the learner before the first step. It has a field `q`, float [S, A].

        A method that remembers whole episodes also takes `max_steps`: how long they may get; and one that begins with
        random weights a `key`.
        """
        ...

    def policy(self, key: Key[Array, ""], state: L, s: Any) -> Int[Array, ""]:
        """Draws an action for `s` from the behaviour policy, int32 []."""
        ...

    def update(self, key: Key[Array, ""], state: L, t: Transition) -> tuple[L, Int[Array, ""]]:
        """Learns from `t`, and gives A', the action to take in `t.s_next`, int32 [].

        Where the episode ends (`t.last`) A' is not taken: the driver resets and asks `policy`.
        """
        ...


def init_learner(
    algorithm: Algorithm[L], task: Environment | Task, key: Callable[[], Key[Array, ""]] = lambda: rng.key(0)
) -> L:
    """The state of the learner before its first step in the task.

    Args:
        algorithm: the method, fitted to the task.
        task: how large it is.
        key: gives a key, where the method begins with something random. By default that of nobody's run, for where
            only shapes matter.
    """
    takes = inspect.signature(algorithm.init).parameters
    more: dict[str, Any] = {"max_steps": task.max_steps} if "max_steps" in takes else {}
    if "key" in takes:
        more["key"] = key()
    return algorithm.init(task.num_states, task.num_actions, **more)


def available_actions(env: Any) -> Bool[Array, "S A"] | None:
    """Which actions are available in each state, or None where the environment does not say, which means all.

    Raises:
        InputError: what `available` gives has the wrong shape, or a state has no action.
    """
    if (available := of_environment(env).available) is None or not env.num_states:
        return None
    is_available = jax.vmap(available)(jnp.arange(env.num_states, dtype=jnp.int32)).astype(bool)
    check_available(f"{type(env).__name__}: available", is_available, env.num_states, env.num_actions)
    return is_available


def fitted(method: T, env: Any) -> T:
    """A method as it acts in an environment.

    It takes available actions only; and where it has a method `fitted_to(env)`, it is what that gives: where its values
    are functions of features, these are features of what is observed there.

    Raises:
        InputError: method and environment do not fit.
    """
    if not env.num_states and of_method(method).features is None:
        raise InputError(
            f"{type(method).__name__} keeps a table, and the states of {name_of(env)} cannot be counted: take a "
            "method whose values are functions of features, such as those of rl.approx"
        )
    fit = getattr(method, "fitted_to", None)
    return restricted(method if fit is None else fit(env), available_actions(env))


def table_of(method: Any, num_states: int, learner: Any) -> Float[Array, "*tables _ _"]:
    """What was learned, as a table: Q [S, A], or V [S, 1]; weights [n, A] where states cannot be counted."""
    if of_method(method).features is None or not num_states:
        return learner.q
    return jax.vmap(method.row, (None, 0))(learner, jnp.arange(num_states, dtype=jnp.int32))


def stand_ins(available: Available) -> Int[Array, "S A"]:
    """What replaces each action, int32 [S, A]: itself where it is available, else the first that is."""
    actions = jnp.arange(available.shape[1], dtype=jnp.int32)
    return jnp.where(
        available, actions, jnp.where(available, actions, len(actions) - 1).min(1, keepdims=True)
    )


def check_available(what: str, available: Any, num_states: int, num_actions: int) -> None:
    """Raises InputError unless these are booleans [S, A], with an action in every state."""
    is_available = concrete(available)
    if (shape := np.shape(available)) != (num_states, num_actions):
        raise InputError(f"{what} must be booleans [S, A] = [{num_states}, {num_actions}], not {list(shape)}")
    if is_available is None:
        return
    if not np.isin(is_available, (0, 1)).all():
        raise InputError(f"{what} must be True or False in each place, not {shown(is_available)}")
    if (s := first(np.asarray(~is_available.any(1)))) is not None:
        raise InputError(f"{what} must name an action in every state, in terminal ones too; {s[0]} has none")


def check_counted(who: str, env: Any) -> None:
    """Raises InputError where the states of an environment cannot be counted."""
    if not env.num_states:
        problem = f"it is for states that can be counted, and those of {name_of(env)} cannot"
        raise InputError(problem, who=who)


def restricted(chooser: T, available: Available | None) -> T:
    """A method or a policy that takes these actions only; unchanged where `available` is None, meaning all.

    Raises:
        InputError: it cannot be restricted, for it has no method `restricted_to`; or it takes another action.
    """
    if available is None:
        return chooser
    if not hasattr(chooser, "restricted_to"):
        raise InputError(
            f"{type(chooser).__name__} cannot be told that some states do not have every action: give it a "
            "method restricted_to(available), available bool [S, A], that returns what takes no other"
        )
    return chooser.restricted_to(available)  # pyright: ignore[reportAttributeAccessIssue]
