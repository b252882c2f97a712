"""What the semi-gradient methods share: values that are linear in features of a state (book, chapters 9, 10 and 12).

A method of control reads and changes Q through three things alone: what stands for a state (`x`), what is learned
before the first step (`initial`), and the step size. So with these a method whose Q is a table becomes one whose Q is
a linear function, and its update stays what it is: each step moves the weights along the gradient of Q(S, A), which is
x(S), and takes the target as given, though it depends on the weights, too. Hence "semi-gradient".
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, Self, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.algorithms.control import Learner, ValueControl
from jaxrl_tab.algorithms.prediction import Prediction, ValueState
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.approx import weights
from jaxrl_tab.approx.features import OneHot, matrix, read
from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.checks import assign, concrete
from jaxrl_tab.core.clock import goes_by_visit
from jaxrl_tab.core.declared import name_of, of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.linear import X
from jaxrl_tab.core.notebook import Shown
from jaxrl_tab.core.policies import EpsilonGreedy
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Available, Environment, State, Transition, fitted
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.projected import LinearValues

OF_FEATURES = (
    "The features of a state of which values are a linear function, such as tile-coding(8, tiles=8): see "
    "`approx.features`; in Python also a matrix of them [S, n]."
)
PER_TILING = (
    "Whether alpha is divided by the number of features that are 1 at once, so that it is the part of an error that an "
    "update takes away, as on the axes of figures 10.3 and 10.4."
)
EPSILON_GREEDY_ALONE = "where states do not have every action it acts by an epsilon-greedy policy alone"
W0 = (
    "Weights at the start, instead of a first value of every state: a number for all; or one for each feature, or for "
    "each feature and action, as text such as 1,1,10 or 1,2;3,4;5,6; in Python also an array [n] or [n, A]."
)


Weights: TypeAlias = str | float | Sequence[Any] | np.ndarray | Array
"""Weights at the start, as they are given. They are kept as text, which is empty where none are given."""


def check_counts(method: ValueControl, env: Environment) -> None:
    """Raises InputError where something goes by visits, and the states of the environment cannot be counted."""
    rates = [*method.rates, *(getattr(p, "epsilon", None) for p in method.all_policies)]
    if not env.num_states and (
        any(map(goes_by_visit, rates)) or any(p.by_visit for p in method.all_policies)
    ):
        raise InputError(
            f"what goes by visits needs states that can be counted, and those of {name_of(env)} cannot: "
            "count steps or episodes",
            who=type(method).__name__,
        )


@pytree
class Linear(Shown):
    """What a method has whose values are linear in features."""

    features: Any = static(default="one-hot", help=OF_FEATURES)
    per_tiling: bool = static(default=False, help=PER_TILING)
    w0: Weights = static(default="", help=W0)

    def __post_init__(self):
        try:
            assign(self, features=read(self.features))
        except InputError as error:
            raise error.renamed(type(self).__name__, "features") from None
        if self.per_tiling and self.features.active is None:
            problem = f"features {self.features} are not 1 or 0, so alpha cannot be divided by how many are 1"
            raise InputError(problem, who=type(self).__name__, field="per_tiling")
        trace = getattr(self, "trace", "")
        if trace in ("replacing", "clearing") and self.features.active is None:
            problem = (
                f"a {trace} trace is for features that are 1 or 0, and {self.features} are numbers: take an "
                "accumulating or a dutch one"
            )
            raise InputError(problem, who=type(self).__name__, field="trace")
        if not isinstance(self.w0, str) or self.w0:
            assign(self, w0=weights.as_text(type(self).__name__, self.w0))
            name, first = self._first_value
            if first is not None and np.any(first != 0):
                raise InputError(f"give {name} or w0, not both", who=type(self).__name__, field="w0")
        super().__post_init__()  # pyright: ignore[reportAttributeAccessIssue]

    def fitted_to(self, env: Environment) -> Self:
        """The method where its features are those of the states of an environment.

        Raises:
            InputError: they cannot be; or what the method needs a table for.
        """
        own: Any = self
        features, who = own.features.fitted(env), type(self).__name__
        name, first = self._first_value
        if np.ndim(getattr(self, name)) and not isinstance(features, OneHot):
            problem = f"{name} is a table, and values are functions of the features {features}: give one number, or w0"
            raise InputError(problem, who=who, field=name)
        if features.unit is None and first is not None and np.any(first != 0):
            problem = (
                f"no weights of the features {features} give every state the value {first}: leave it at 0"
            )
            raise InputError(problem, who=who, field=name)
        if self.w0:
            size = env.num_states if isinstance(features, OneHot) else features.size
            weights.weights(cast(str, self.w0), size, 1 if name == "v0" else env.num_actions, who)
        return dataclasses.replace(own, features=features)

    @property
    def _first_value(self) -> tuple[str, Any]:
        """The field with the first value of every state, and what is in it; None where that is traced."""
        name = "v0" if hasattr(self, "v0") else "q0"
        return name, concrete(getattr(self, name))


@pytree
class LinearControl(Linear, ValueControl):
    """Control whose Q is linear in features of the state, with weights of their own for each action.

    q(s, a) = x(s) . w(., a)      (book, section 9.4)
    """

    def fitted_to(self, env: Environment) -> Self:
        check_counts(self, env)
        return super().fitted_to(env)

    def restricted_to(self, available: Available, **more: Any) -> Self:
        if not isinstance(self.selection, EpsilonGreedy):
            raise InputError(EPSILON_GREEDY_ALONE, who=type(self).__name__, field="behaviour")
        return super().restricted_to(available, q0=self.q0, **more)

    def initial(self, num_states: int, num_actions: int) -> Float[Array, "n A"]:
        features = self.features
        if self.w0:
            size = num_states if isinstance(features, OneHot) else features.size
            return jnp.asarray(
                weights.weights(cast(str, self.w0), size, num_actions, type(self).__name__), float
            )
        if isinstance(features, OneHot):
            return super().initial(num_states, num_actions)
        unit = np.zeros(features.size) if features.unit is None else features.unit
        w = jnp.asarray(self.q0, float) * jnp.asarray(unit, float)
        return jnp.broadcast_to(w[:, None], (features.size, num_actions))

    def x(self, s: State) -> X:
        return self.features(s)

    @property
    def nowhere(self) -> X:
        return self.features.nowhere

    def row(self, state: Any, s: State) -> Float[Array, " A"]:
        row = super().row(state, s)
        if (available := self.available) is None:
            return row
        return jnp.where(tables.row(jnp.asarray(available, float), s) > 0, row, policies.UNAVAILABLE)


@pytree
class SemiGradientControl(LinearControl, TDControl):
    """Control whose Q is linear in features of the state, and which learns by a step size."""

    def step_size(self, state: Learner, t: Transition) -> Float[Array, ""] | float:
        alpha = super().step_size(state, t)
        return alpha / self.features.active if self.per_tiling else alpha


@pytree
class SemiGradientPrediction(Linear, Prediction):
    """Prediction whose V is linear in features of the state: v(s) = x(s) . w      (book, section 9.4).

    Where states cannot be counted, nobody can say what a policy does in each: there all actions are equally likely.
    """

    measures: ClassVar[tuple[str, ...]] = (
        "v_error",
        "value_error",
        "bellman_error",
        "projected_bellman_error",
    )

    def fitted_to(self, env: Environment) -> Self:
        if not env.num_states and (
            name := next((x for x in ("pi", "behaviour") if getattr(self, x, None)), "")
        ):
            problem = f"{name} cannot be given for each state, for those of {name_of(env)} cannot be counted"
            raise InputError(problem, who=type(self).__name__, field=name)
        fitted: Any = super().fitted_to(env)
        return cast(Self, Prediction.fitted_to(fitted, env))

    def init(self, num_states: int, num_actions: int, max_steps: int = 1000) -> ValueState:
        state = super().init(num_states, num_actions, max_steps)
        everywhere = jnp.full((1, num_actions), 1 / num_actions, state.acting.dtype)
        return state if num_states else state._replace(acting=everywhere)

    def policy(self, key: Key[Array, ""], state: ValueState, s: State) -> Int[Array, ""]:
        return super().policy(key, state, s if jnp.ndim(s) == 0 else jnp.int32(0))

    def linear_values(self, env: Environment) -> LinearValues:
        """What is exact about the values that it learns: the best weights, the TD fixed point, errors of any weights.

        Raises:
            InputError: as `planning.linear_values`; or `env` changes while a run goes on.
        """
        planning.check_lasting(env)
        own = fitted(self, env)
        with jax.enable_x64():
            b = own.policies(env)[1]
        pi, features = own.probabilities(env), matrix(own.features, env)
        return planning.linear_values(env, pi, features, float(own.gamma), behaviour=b)

    def measurer(self, env: Environment):
        """What `train(exact=True)` records: the errors that are `measures`, from the state.

        Where states cannot be counted it is the root of the mean squared error of V in those whose values are known.
        """
        if not env.num_states and (known := of_environment(env).known_values):
            states, values = known()

            @planning.in_turn
            def error(state: ValueState) -> tuple[Float[Array, ""], ...]:
                learned = jax.vmap(self.row, (None, 0))(state, states)[:, 0]
                return (jnp.sqrt(((learned - values) ** 2).mean()),)

            return lambda state: {"v_error": error(state)[0]}
        planning.check_finite(env)
        with planning.doubled():
            pi, b = self.policies(env)
        features = None if isinstance(self.features, OneHot) else matrix(self.features, env)
        measure = planning.linear_value_measurer(env, pi, self.gamma, features, b)
        errors = lambda state: measure(self.everywhere(state, env.num_states))
        return lambda state: dict(zip(self.measures, errors(state), strict=True))

    def everywhere(self, state: ValueState, num_states: int) -> Float[Array, " S"]:
        return jax.vmap(self.row, (None, 0))(state, jnp.arange(num_states, dtype=jnp.int32))[:, 0]
