"""Step sizes and exploration rates as a method uses them: numbers or schedules, and the clock that these read."""

from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, get_args, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.core import tables
from jaxrl_tab.core.types import State

ClockName: TypeAlias = Literal["step", "episode", "visit"]

CLOCKS = get_args(ClockName)


@runtime_checkable
class Schedule(Protocol):
    """A pytree with a `clock` and a value for each count n = 1, 2, ..."""

    @property
    def clock(self) -> ClockName: ...

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]: ...


Rate: TypeAlias = float | Float[Array, ""] | Schedule


class Clock(NamedTuple):
    """What has been experienced so far.

    Attributes:
        step: steps begun, int32 [].
        episode: episodes finished, int32 [].
        visits: N(s, a), int32 [S, A]; None where no schedule asks for it, for it costs a write per step.
    """

    step: Int[Array, ""]
    episode: Int[Array, ""]
    visits: Int[Array, "S A"] | None


def start(num_states: int, num_actions: int, by_visit: bool) -> Clock:
    """The clock at zero, with a table of visits where something goes by them."""
    visits = jnp.zeros((num_states, num_actions), jnp.int32) if by_visit else None
    return Clock(jnp.int32(0), jnp.int32(0), visits)


def goes_by_visit(rate: Any) -> bool:
    """Whether a Rate, or a batch of them, needs the table of visits."""
    return isinstance(rate, Schedule) and rate.clock == "visit"


def begin_step(clock: Clock, s: State, a: Int[Array, ""]) -> Clock:
    """Counts one step and one visit of (s, a)."""
    visits = None if clock.visits is None else tables.add(clock.visits, s, a, jnp.int32(1))
    return clock._replace(step=clock.step + 1, visits=visits)


def end_step(clock: Clock, last: Bool[Array, ""]) -> Clock:
    """Counts an episode where it is over."""
    return clock._replace(episode=clock.episode + last.astype(jnp.int32))


def step_size(rate: Rate, clock: Clock, s: State, a: Int[Array, ""]) -> Float[Array, ""] | float:
    """alpha for the update of (s, a) in the step that has begun."""
    if not goes_by_visit(rate):
        return at_visit(rate, clock, None)
    assert clock.visits is not None
    return at_visit(rate, clock, tables.entry(clock.visits, s, a))


def at_visit(rate: Rate, clock: Clock, n: Int[Array, ""] | None) -> Float[Array, ""] | float:
    """alpha for the update of a pair in its n-th visit; n is looked at only where the rate goes by visits."""
    if not isinstance(rate, Schedule):
        return rate
    if rate.clock == "visit":
        assert n is not None
        return rate(n)
    return rate(clock.step if rate.clock == "step" else clock.episode + 1)


def of_state(rate: Rate, clock: Clock, s: State) -> Float[Array, ""] | float:
    """What `rate` is for the choice of the next action, in state s."""
    if not isinstance(rate, Schedule):
        return rate
    if rate.clock == "visit":
        assert clock.visits is not None
        return rate(tables.row(clock.visits, s).sum() + 1)
    return rate(1 + (clock.step if rate.clock == "step" else clock.episode))


def exploration(rate: Rate, clock: Clock, s: State) -> Float[Array, ""] | float:
    """epsilon for the choice of the next action, in state s; what a schedule gives is clipped to [0, 1]."""
    return jnp.clip(of_state(rate, clock, s), 0, 1) if isinstance(rate, Schedule) else rate
