"""What the methods share that learn about a policy of their own choice: the target policy."""

from typing import Any, ClassVar, Self

from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.control import Learner
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import tables
from jaxrl_tab.core.coverage import check_coverage
from jaxrl_tab.core.policies import EpsilonGreedy, Greedy, Policy, Table
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Available, State, restricted


@pytree
class OffPolicyControl(TDControl):
    """One-step control that learns about a target policy pi, while the behaviour policy b acts.

    There is no ratio pi / b in the target of a one-step method for Q: the action A that it learns about was
    given, and what follows is taken from pi. All it needs is that b tries every action that pi takes. A
    behaviour that is a table, or that has some of the actions only, is checked for that.

    Methods that weigh what happened by such ratios declare it; then every behaviour is checked.
    """

    on_policy: ClassVar[bool] = False  # whether it learns about the policy that acts where it has no target
    weighs_by_ratios: ClassVar[bool] = False

    target: Policy | None = field(
        default=None,
        help="The policy that is learned about (see `policies`); if not given the greedy one, in Expected "
        "Sarsa and Q(sigma) the one that acts.",
    )

    def __post_init__(self):
        super().__post_init__()
        acting = self.selection
        some = isinstance(acting, EpsilonGreedy) and acting.available is not None
        if isinstance(acting, Table) or some or self._has_ratios:
            check_coverage(type(self).__name__, self.pi, acting)

    @property
    def pi(self) -> Policy:
        """The target policy: as given, or else the policy that acts, or the greedy one."""
        if self.target is not None:
            return self.target
        return self.selection if self.on_policy else Greedy()

    @property
    def multiplies_returns(self) -> bool:
        return self._has_ratios

    @property
    def _has_ratios(self) -> bool:
        """Whether it weighs by ratios, and not all are 1."""
        return self.weighs_by_ratios and (self.target is not None or not self.on_policy)

    @property
    def all_policies(self) -> tuple[Policy, ...]:
        return (*super().all_policies, self.pi)

    def restricted_to(self, available: Available, **more: Any) -> Self:
        target = None if self.target is None else restricted(self.target, available)
        return super().restricted_to(available, target=target, **more)

    def target_probs(self, state: Learner, s: State) -> Float[Array, " A"]:
        """The target policy pi(. | s), float [A]."""
        return self.pi.probs(self.row(state, s), state.clock, s)

    def ratio(self, state: Learner, s: Int[Array, ""], a: Int[Array, ""]) -> Float[Array, ""]:
        """rho = pi(a | s) / b(a | s) of an action that b chose, float []."""
        return tables.entry(self.target_probs(state, s), a) / tables.entry(self.probs(state, s), a)
