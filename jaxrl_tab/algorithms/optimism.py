"""What the methods share that explore with a guarantee: they act greedily by upper bounds of the action values."""

import dataclasses
from typing import Any, ClassVar, Self

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.algorithms.control import Learner
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.policies import Greedy
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Available


@pytree
class Optimistic(Shown):
    """Control with a finite horizon H that takes whatever may still be best: greedy to Q, which holds upper bounds.

    Q begins at the most that an episode may give, H where no reward is above 1, and what is learned has a bonus, which
    shrinks as a pair is tried. With probability 1 - p or more, no entry is then ever below the best value; and as it
    always takes the largest, it either earns much or learns much. There is neither an epsilon nor any other policy.

    Rewards must be from 0 to `r_max`. In place of T, the number of steps in all, which a method here is not told,
    stands that of the steps until the end of the present episode; it counts by its logarithm alone.
    """

    c: float = field(
        default=1.0, at_least=0, help="Factor of the bonus; far smaller serves better in practice."
    )
    p: float = field(
        default=0.05, greater_than=0, less_than=1, help="Probability with which the guarantee may fail."
    )
    r_max: float = field(default=1.0, greater_than=0, help="The largest reward of a step; none is below 0.")
    gamma: float = field(default=1.0, at_least=0, at_most=1, help="Discount rate; the guarantee is for 1.")
    available: Any = field(
        default=None,
        help="The actions of each state, bool [S, A]; what an environment says need not be said again.",
    )

    needs_horizon: ClassVar[bool] = True
    acts_after_update: ClassVar[bool] = True

    @property
    def selection(self) -> Greedy:
        """The policy that acts."""
        return Greedy()

    def restricted_to(self, available: Available) -> Self:
        """The method where states have these actions only, bool [S, A]: it takes no other, and counts no other."""
        return dataclasses.replace(self, available=available)

    def begun(self, num_states: int, num_actions: int, horizon: int) -> Float[Array, "S A"]:
        """Q before the first step. Raises InputError where these are not as many states for each step, and the end."""
        if (num_states - 1) % horizon:
            problem = f"{num_states:,} states are not as many for each of {horizon:,} steps, and the end"
            raise InputError(problem, who=type(self).__name__)
        q = jnp.full((num_states, num_actions), self.r_max * horizon, dtype=float)
        return q if self.available is None else policies.among(q, self.available)

    def probs(self, state: Learner, s: Int[Array, ""]) -> Float[Array, " A"]:
        """The policy pi(. | s), float [A]."""
        return policies.greedy(tables.row(state.q, s))

    def policy(self, key: Key[Array, ""], state: Learner, s: Int[Array, ""]) -> Int[Array, ""]:
        return policies.sample(key, self.probs(state, s))
