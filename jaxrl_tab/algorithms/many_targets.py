"""Many target policies from one stream of experience (Silver, lecture 5: off-policy learning)."""

import dataclasses
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.algorithms.control import TDState
from jaxrl_tab.algorithms.expected_sarsa import ExpectedSarsa
from jaxrl_tab.core import coverage, policies, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.checks import as_array, first, is_distribution
from jaxrl_tab.core.clock import Clock, Rate
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.errors import InputError, shown, unfit
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Available, Transition, restricted


class ManyTargetsState(NamedTuple):
    """A learner that keeps a table of action values for each target policy.

    Attributes:
        q: Q of each policy, float [P, S, A].
        clock: what the schedules of alpha count; all tables learn at the same visits.
    """

    q: Float[Array, "P S A"]
    clock: Clock


@pytree
class ManyTargets(Shown):
    """Learns about P target policies at once, while one behaviour policy acts.

    For every p (Expected Sarsa, book, equation 6.9):

    Q_p(S, A) <- Q_p(S, A) + alpha [R + gamma sum_a pi_p(a | S') Q_p(S', a) - Q_p(S, A)]

    Each Q_p goes to the action values of pi_p, as if it had been learned alone: the behaviour policy only
    decides which pairs are visited how often.

    Raises:
        InputError: a number is out of range, `targets` are no policies, or the behaviour policy leaves out an
            action that a target can take; the message names the policy, the state and the action.
    """

    targets: Any = field(
        help="pi_p(a | s) of each policy, float [P, S, A]; every row sums to 1, those of terminal states too."
    )
    behaviour: Table | None = field(
        default=None,
        help="The policy that acts, `policies.Table(b)` with b > 0 wherever some pi_p > 0; None: all actions "
        "are equally likely.",
    )
    alpha: Rate = field(default=0.1, greater_than=0, help="Step size.")
    gamma: float = field(default=1.0, at_least=0, at_most=1, help="Discount rate.")
    q0: float = field(default=0.0, help="Initial value of every entry.")

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, each action",
        "Each target policy π has a table of its own, and all learn from each step.",
    )

    def __post_init__(self):
        if not isinstance(self.behaviour, Table | None):
            wanted = "policies.Table(b), for there is no one Q to choose by"
            raise unfit("ManyTargets", "behaviour", wanted, self.behaviour)
        if (pi := as_array(self.targets)) is None:
            return
        if pi.ndim != 3 or not pi.size or pi.dtype.kind not in "biuf":
            problem = f"targets must be numbers [P, S, A], not of shape {pi.shape}"
            raise InputError(problem, who="ManyTargets", field="targets")
        if (i := first(~is_distribution(pi))) is not None:
            problem = (
                f"the probabilities of policy {i[0]} in state {i[1]} are not a distribution: {shown(pi[i])}"
            )
            raise InputError(problem, who="ManyTargets", field="targets")
        object.__setattr__(self, "targets", pi)
        for p, target in enumerate(pi):
            coverage.check_coverage(f"ManyTargets: target {p}", Table(target), self.selection)

    @property
    def selection(self) -> Table:
        """The behaviour policy: as given, or else uniform."""
        if self.behaviour is not None:
            return self.behaviour
        _, num_states, num_actions = jnp.shape(self.targets)
        return Table(np.full((num_states, num_actions), 1 / num_actions))

    def restricted_to(self, available: Available) -> Self:
        """The method where states have these actions only, bool [S, A]."""
        policies.check_among("ManyTargets: targets", self.targets, available)
        uniform = policies.uniform(available)
        behaviour = uniform if self.behaviour is None else restricted(self.behaviour, available)
        return dataclasses.replace(self, behaviour=behaviour, q0=policies.among(self.q0, available))

    def about(self, target: Float[Array | np.ndarray, "S A"]) -> ExpectedSarsa:
        """The method that learns about one of the policies alone."""
        return ExpectedSarsa(
            alpha=self.alpha, gamma=self.gamma, q0=self.q0, target=Table(target), behaviour=self.selection
        )

    def init(self, num_states: int, num_actions: int) -> ManyTargetsState:
        q, clock = self.about(self.targets[0]).init(num_states, num_actions)
        return ManyTargetsState(jnp.broadcast_to(q, jnp.shape(self.targets)), clock)

    def policy(self, key: Key[Array, ""], state: ManyTargetsState, s: Int[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, self.selection.probs(tables.row(state.q[0], s), state.clock, s))

    def update(self, key, state: ManyTargetsState, t: Transition):
        def learn(target, q):
            own, a_next = self.about(target).update(key, TDState(q, state.clock), t)
            return own.q, own.clock, a_next

        each = jax.vmap(learn, out_axes=(0, None, None))  # one clock and one A' for all
        q, clock, a_next = each(jnp.asarray(self.targets, state.q.dtype), state.q)
        return ManyTargetsState(q, clock), a_next
