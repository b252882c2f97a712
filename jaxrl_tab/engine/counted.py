"""A method that also counts how often it took each action, and what records its table with these counts.

The counts stand beside the state of the learner, which neither sees nor touches them: so what is learned is, to the
last bit, what the method learns alone.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import tables
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Available, Task, Transition, fitted, init_learner
from jaxrl_tab.engine.budget import Tables


class CountedState(NamedTuple):
    """The state of a learner, and N(s, a), int32 [S, A]: how often action a was taken in state s."""

    learner: Any
    visits: Int[Array, "S A"]

    @property
    def q(self) -> Float[Array, "S A"]:
        return self.learner.q


@pytree
class Counted:
    """A method that counts what it does. What it does not have itself, it has from `method`.

    Attributes:
        method: the method.
    """

    method: Any
    records: ClassVar[tuple[str, ...]] = ()  # what the method records is in the results already

    @property
    def gamma(self) -> Any:
        return self.method.gamma

    @property
    def works_with(self) -> Callable[[CountedState], Any] | None:
        """As the method declares it; it knows the state of its learner alone."""
        gives = of_method(self.method).works_with
        return gives and (lambda state: gives(state.learner))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "method":  # while it is being made it has no method
            raise AttributeError(name)
        return getattr(self.method, name)

    def fitted_to(self, env: Any) -> Self:
        return dataclasses.replace(self, method=fitted(self.method, env))

    def restricted_to(self, available: Available) -> Self:
        return self  # its method was, when it was fitted

    def init(self, num_states: int, num_actions: int, max_steps: int, key: Key[Array, ""]) -> CountedState:
        learner = init_learner(self.method, Task(num_states, num_actions, max_steps), lambda: key)
        return CountedState(learner, jnp.zeros((num_states, num_actions), jnp.int32))

    def row(self, state: CountedState, s: Int[Array, ""]) -> Float[Array, " A"]:
        return self.method.row(state.learner, s)

    def policy(self, key: Key[Array, ""], state: CountedState, s: Int[Array, ""]) -> Int[Array, ""]:
        return self.method.policy(key, state.learner, s)

    def update(
        self, key: Key[Array, ""], state: CountedState, t: Transition
    ) -> tuple[CountedState, Int[Array, ""]]:
        learner, a_next = self.method.update(key, state.learner, t)
        return CountedState(learner, tables.add(state.visits, t.s, t.a, jnp.int32(1))), a_next


@dataclasses.dataclass(frozen=True)
class TablesAndVisits(Tables):
    """Records the table of a `Counted` method, and N."""

    def of(self, method: Any, learner: CountedState) -> dict[str, Array]:
        return super().of(method, learner) | {"visits": learner.visits}
