"""A task that ends after a given number of steps: any finite environment, and how many of them were taken."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.checks import build
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError, shown, unfit, whole
from jaxrl_tab.core.names import Reference
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Available, Environment, Outcome
from jaxrl_tab.envs.base import Finite, Panel, samples_outcomes
from jaxrl_tab.exact.model import check_finite

PREFIX = "finite-horizon"
FORM = f"{PREFIX}:STEPS:ENV, such as {PREFIX}:20:river-swim"
MOST_SHOWN = 40  # steps in tables, and
MOST_STATES_SHOWN = 500  # states; more are a list
MOST_STATES = 2**31 - 1  # which int32 can number


@pytree
class FiniteHorizon(Finite):
    """A task that ends after so many steps: a real end, after which nothing comes, and no time limit.

    What is best may then depend on the time that is left, so a state says both: after h steps in state s of the
    `env` it is number h x S + s, for h from 0 to `horizon` - 1. The last state of all is terminal, and is where every
    episode ends, after `horizon` steps or in a terminal state of `env`. So any method finds the best policy of the task
    with a finite horizon, and exact values are those of `planning.finite_horizon`. The time limit of `env` does not
    count.

    Where an environment is named, it is "finite-horizon:20:river-swim", with the parameters of river swim.
    """

    env: Any = field(help="The task that goes on no longer.")
    horizon: int = static(at_least=1, help="H, after how many steps it ends.")

    def __post_init__(self):
        if not isinstance(self.env, Environment):
            raise unfit(type(self).__name__, "env", "an environment such as RiverSwim()", self.env)
        check_finite(self.env)
        if self.num_states > MOST_STATES:
            problem = f"{self.horizon:,} steps in {self.env.num_states:,} states are more states than can be numbered"
            raise InputError(problem, who=type(self).__name__, field="horizon")

    @property
    def num_states(self) -> int:
        return self.horizon * self.env.num_states + 1

    @property
    def num_actions(self) -> int:
        return self.env.num_actions

    @property
    def max_steps(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.horizon

    @property
    def action_names(self) -> tuple[str, ...]:
        return of_environment(self.env).action_names

    @property
    def instance(self) -> Callable[[Key[Array, ""]], "FiniteHorizon"] | None:
        return self._as_long(of_environment(self.env).instance)

    @property
    def at(self) -> Callable[[Int[Array, ""]], "FiniteHorizon"] | None:
        return self._as_long(of_environment(self.env).at)

    def _as_long(self, make: Callable[..., Any] | None) -> Callable[[Any], "FiniteHorizon"] | None:
        """`make`, where it is there, but what it makes ends as this does."""
        return None if make is None else lambda x: dataclasses.replace(self, env=make(x))

    @property
    def available(self) -> Callable[[Int[Array, ""]], Available] | None:
        available = of_environment(self.env).available
        return None if available is None else lambda s: available(s % self.env.num_states)

    def panels(self) -> tuple[Panel, ...]:
        """Those of the environment for each number of steps; where it has none, one with a row for each."""
        states, declared = self.env.num_states, of_environment(self.env)
        if self.horizon > MOST_SHOWN or self.num_states > MOST_STATES_SHOWN:
            return ()
        if not (panels := declared.panels()):
            rows = tuple(map(str, range(self.horizon)))
            columns = tuple(map(declared.state_name or str, range(states)))
            every = np.arange(self.horizon * states).reshape(self.horizon, states)
            return (Panel("", every, rows, columns, down="step", along="state"),)
        return tuple(
            panel._replace(
                title=", ".join(filter(None, [panel.title, f"step {h}"])), states=panel.states + h * states
            )
            for h in range(self.horizon)
            for panel in panels
        )

    def state_name(self, s: int) -> str:
        h, own = divmod(s, self.env.num_states)
        name = of_environment(self.env).state_name or str
        return "end" if h == self.horizon else f"step {h}, state {name(own)}"

    def initial(self) -> Float[Array, " S"]:
        return jnp.zeros(self.num_states, dtype=float).at[: self.env.num_states].set(self.env.initial())

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return self.env.reset(key)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        s = jnp.asarray(s, jnp.int32)
        prob, outcome = self.env.outcomes(s % self.env.num_states, a)
        return prob, self._later(s, outcome)

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        s = jnp.asarray(s, jnp.int32)
        return self._later(s, self.env.step(key, s % self.env.num_states, a))

    @property
    def samples_outcomes(self) -> bool:
        return samples_outcomes(self.env)

    def tabulated_step(self) -> Callable[[Key[Array, ""], Int[Array, ""], Int[Array, ""]], Outcome]:
        """`step` from the table of the environment, which is so many times smaller than that of all steps."""
        step = self.env.tabulated_step()
        return lambda key, s, a: self._later(s, step(key, s % self.env.num_states, a))

    def _later(self, s: Int[Array, ""], outcome: Outcome) -> Outcome:
        """What the environment answered in state `s`, with the steps counted."""
        states, end = self.env.num_states, jnp.int32(self.num_states - 1)
        h, own = s // states, s % states
        # A terminal state of the environment is one at each step, and so leads to itself.
        stays = outcome.terminal & (outcome.s_next == own) & (s != end)
        over = outcome.terminal | (h >= self.horizon - 1)
        s_next = jnp.where(stays, s, jnp.where(over, end, outcome.s_next + (h + 1) * states))
        return Outcome(s_next.astype(jnp.int32), jnp.where(s == end, 0, outcome.reward), over)


def of_name(rest: str, find: Callable[[str], Reference]) -> Reference:
    """What "finite-horizon:20:river-swim" stands for: a class with the parameters of what is named at its end.

    Args:
        rest: the name after the first colon.
        find: what the name of an environment stands for.

    Raises:
        InputError: it is of no such form, or names no environment.
    """
    steps, _, name = rest.partition(":")
    if not steps.isdecimal() or not name:
        raise InputError(f"{shown(f'{PREFIX}:{rest}')} is not of the form {FORM}")
    horizon, inner = whole(None, "the number of steps", int(steps)), find(name)

    def new(cls: type, **parameters: Any) -> FiniteHorizon:
        return FiniteHorizon(build(inner.cls, name, parameters), horizon)

    fields = [
        (f.name, f.type, dataclasses.field(default=f.default, metadata=f.metadata, compare=f.compare))
        for f in dataclasses.fields(inner.cls)
        if f.name != "max_steps"
    ]
    about = f"{inner.cls.__name__} that ends after {horizon} steps."
    cls = dataclasses.make_dataclass(
        inner.cls.__name__, fields, namespace={"__new__": new, "__doc__": about, "__module__": __name__}
    )
    label = f"{inner.label},horizon={horizon}"
    return inner._replace(name=f"{PREFIX}:{horizon}:{inner.name}", cls=cls, label=label)
