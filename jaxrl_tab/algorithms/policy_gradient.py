"""What the methods share that learn a policy itself, by its gradient (book, sections 2.8 and 13.1 to 13.5)."""

import dataclasses
import re
from typing import Any, ClassVar, NamedTuple, Protocol, Self, TypeVar, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import clock, optimizers, policies, tables
from jaxrl_tab.core.checks import assign
from jaxrl_tab.core.clock import Clock, Rate
from jaxrl_tab.core.declared import Learns
from jaxrl_tab.core.errors import InputError, unfit
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.policies import Softmax
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Available, Transition

_GROUPS = re.compile(r"[0-9]{1,6}(,[0-9]{1,6})*")


class Preferences(NamedTuple):
    """A policy in a table: pi(a | s) is proportional to exp(theta(s, a)).

    Attributes:
        theta: the preferences, float [S, A]; a row for each group of states, where there are groups.
        optimizer: the state of the optimiser; None where there is none.
        rows: the row of each state, int32 [S]; None where each has its own.
    """

    theta: Float[Any, "*batch G A"]
    optimizer: Any
    rows: Int[Any, "*batch S"] | None

    @property
    def of_states(self) -> Float[Any, "... S A"]:
        """The preferences in each state; of a batch [..., S, A]."""
        if self.rows is None:
            return self.theta
        return jnp.take_along_axis(self.theta, self.rows[..., None], axis=-2)

    def row_of(self, s: Int[Array, ""]) -> Int[Array, ""]:
        """The row of a state."""
        return s if self.rows is None else tables.entry(self.rows, s)


@runtime_checkable
class PreferenceLearner(Protocol):
    """What every state of such a learner has: a NamedTuple with a policy and a clock."""

    @property
    def policy(self) -> Preferences: ...
    @property
    def clock(self) -> Clock: ...
    @property
    def q(self) -> Float[Any, "... S A"]: ...
    def _replace(self, **fields: Any) -> Any: ...


L = TypeVar("L", bound=PreferenceLearner)


@pytree
class PolicyGradient(Shown):
    """Control that learns no values of actions but preferences for them, theta [S, A].

    pi(a | s, theta) = exp(theta(s, a)) / sum_b exp(theta(s, b))      (book, equations 13.2 and 2.11)

    d ln pi(a | s, theta) / d theta(s, b) = 1[a = b] - pi(b | s, theta)      (book, equation 13.9, for a table)

    It acts by pi, which explores by itself: there is neither an epsilon nor any other behaviour policy. A method adds
    what it learns from a transition.

    In logs and results theta is `q`, as every table that is learned is; the policy that is greedy to it takes the most
    probable actions.
    """

    alpha: Rate = field(default=0.1, greater_than=0, help="Step size of the policy.")
    gamma: float = field(default=1.0, at_least=0, at_most=1, help="Discount rate.")
    theta0: float = field(
        default=0.0,
        help="Initial preference for every action, with which all are equally likely; or for one run a table of "
        "them [S, A].",
    )
    optimizer: str | None = static(
        default=None,
        help='The optimiser of the policy, as the call that makes it in optax, such as "adam" or "sgd(momentum=0.9)"; '
        "alpha is its learning rate. Plain gradient ascent, as in the book, where none is given.",
    )
    groups: str | None = static(
        default=None,
        help="States that the method cannot tell apart: for each state the number of its row in all tables, such as "
        '"0,0,0,1" (state aggregation: book, section 9.3). By default each has its own.',
    )

    learns: ClassVar[Learns] = Learns.PREFERENCES
    acts_after_update: ClassVar[bool] = True

    def __post_init__(self):
        if self.groups is not None and not (isinstance(self.groups, str) and _GROUPS.fullmatch(self.groups)):
            raise unfit(type(self).__name__, "groups", 'whole numbers such as "0,0,1,2"', self.groups)
        if self.optimizer is not None:
            try:
                assign(self, optimizer=optimizers.spelled(self.optimizer))
            except InputError as error:
                raise error.renamed(type(self).__name__, "optimizer") from None

    @property
    def selection(self) -> Softmax:
        """The policy that acts, as a function of theta."""
        return Softmax(1.0)

    def restricted_to(self, available: Available) -> Self:
        """The method where states have these actions only, bool [S, A]: it takes no other."""
        if self.groups is not None:
            problem = "groups need a task in which every state has every action"
            raise InputError(problem, who=type(self).__name__, field="groups")
        return dataclasses.replace(self, theta0=policies.among(self.theta0, available))

    def begun(self, num_states: int, num_actions: int) -> tuple[Preferences, Clock]:
        """The policy and the clock before the first step."""
        rows = None if self.groups is None else self._rows(num_states)
        count = num_states if rows is None else int(rows.max()) + 1
        theta = jnp.full((count, num_actions), self.theta0, dtype=float)
        optimizer = None if self.optimizer is None else optimizers.start(self.optimizer, theta)
        policy = Preferences(theta, optimizer, None if rows is None else jnp.asarray(rows))
        return policy, clock.start(count, num_actions, self.by_visit)

    def _rows(self, num_states: int) -> Int[np.ndarray, " S"]:
        """The row of each state."""
        assert self.groups is not None
        rows = np.array(self.groups.split(","), np.int32)
        if len(rows) != num_states:
            problem = f"groups has {len(rows)} numbers, and the task has {num_states} states"
            raise InputError(problem, who=type(self).__name__, field="groups")
        return rows

    @property
    def by_visit(self) -> bool:
        """Whether a step size goes by visits."""
        return clock.goes_by_visit(self.alpha)

    def probs(self, state: PreferenceLearner, s: Int[Array, ""]) -> Float[Array, " A"]:
        """pi(. | s, theta), float [A]."""
        row = state.policy.row_of(s)
        return self.selection.probs(tables.row(state.policy.theta, row), state.clock, row)

    def policy(self, key: Key[Array, ""], state: PreferenceLearner, s: Int[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, self.probs(state, s))

    def update(self, key, state, t: Transition):
        rows = state.policy
        state = self.learned(state, t._replace(s=rows.row_of(t.s), s_next=rows.row_of(t.s_next)))
        return state, self.policy(key, state, t.s_next)

    def learned(self, state: Any, t: Transition) -> Any:
        """The learner after a transition, in which a state is the number of its row."""
        raise NotImplementedError

    def begin(self, state: L, t: Transition) -> L:
        """Counts the step and the visit of (S, A), before anything is learned from them."""
        return state._replace(clock=clock.begin_step(state.clock, t.s, t.a))

    def ascended(self, policy: Preferences, gradient: Float[Array, "S A"], alpha: Any) -> Preferences:
        """The policy after a step of size alpha along a gradient of the whole table, by the optimiser."""
        assert self.optimizer is not None
        by_one, optimizer = optimizers.change(self.optimizer, gradient, policy.optimizer, policy.theta)
        return policy._replace(theta=policy.theta + alpha * by_one, optimizer=optimizer)

    def reinforced(self, state: PreferenceLearner, t: Transition, x: Float[Array, ""]) -> Preferences:
        """theta <- theta + alpha x grad ln pi(A | S, theta), or what the optimiser makes of that gradient."""
        policy, alpha = state.policy, clock.step_size(self.alpha, state.clock, t.s, t.a)
        gradient = x * grad_log(tables.row(policy.theta, t.s), t.a)  # in row S; it is 0 in all others
        if self.optimizer is None:
            return policy._replace(theta=tables.add_row(policy.theta, t.s, alpha * gradient))
        here = jnp.arange(len(policy.theta), dtype=jnp.int32) == t.s
        return self.ascended(policy, jnp.where(here[:, None], gradient, 0), alpha)


@pytree
class ValueBaseline(PolicyGradient):
    """A policy that is learned beside values of states, V, with which it compares what follows its actions."""

    alpha_v: Rate = field(
        default=0.1,
        greater_than=0,
        help="Step size of V; a schedule that goes by visits counts those of the state.",
    )
    v0: float = field(default=0.0, help="Initial value of every entry of V.")

    @property
    def by_visit(self) -> bool:
        return super().by_visit or clock.goes_by_visit(self.alpha_v)


def grad_log(theta: Float[Array, " A"], a: Int[Array, ""]) -> Float[Array, " A"]:
    """The gradient of ln pi(a | s, theta) by theta(s, .), from that row: [A] -> [A]."""
    taken = jnp.arange(len(theta), dtype=jnp.int32) == a
    return taken.astype(theta.dtype) - policies.softmax(theta, 1.0)
