"""Numbers that change with experience: step sizes and exploration rates.

Wherever a method takes `alpha` or `epsilon` it takes a number or a schedule. A schedule has a **clock**:

- `"step"`: n is the number of this step, 1 for the first;
- `"episode"`: n is the number of this episode, 1 for the first;
- `"visit"`: for a step size, n = N(s, a), the visits of the pair so far, this one included; for an
  exploration rate, n = N(s) + 1 where N(s) counts the earlier visits of the state.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab import tables
from jaxrl_tab.types import InputError, concrete, pytree, static

ClockName: TypeAlias = Literal["step", "episode", "visit"]
CLOCKS = ("step", "episode", "visit")


@runtime_checkable
class Schedule(Protocol):
    """A pytree with a `clock` and a value for each count n = 1, 2, ..."""

    @property
    def clock(self) -> ClockName: ...

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]: ...


Rate: TypeAlias = "float | Float[Array, ''] | Schedule"


def _check_clock(clock: str) -> None:
    if clock not in CLOCKS:
        raise InputError(f"a schedule's clock is 'step', 'episode' or 'visit', not {clock!r}")


@pytree
class Power:
    """scale / n**power: harmonic for power 1, the book's 1/n (section 2.5)."""

    power: float = 1.0
    scale: float = 1.0
    clock: ClockName = static(default="episode")

    def __post_init__(self):
        _check_clock(self.clock)
        for name, value in (("power", concrete(self.power)), ("scale", concrete(self.scale))):
            if value is not None and not np.all((value > 0) & np.isfinite(value)):
                raise InputError(f"Power: {name} must be a positive number, not {value}")

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        return self.scale * jnp.asarray(n, float) ** -jnp.asarray(self.power, float)


@pytree
class Optax:
    """Any optax schedule, or any function of a count that starts at 0 and is written in jax.numpy."""

    schedule: Callable[[Any], Any] = static()
    clock: ClockName = static(default="step")

    def __post_init__(self):
        _check_clock(self.clock)
        if not callable(self.schedule):
            raise InputError(f"Optax: schedule must be a function of a count, not {self.schedule!r}")

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        return jnp.asarray(self.schedule(n - 1), float)


def glie() -> Power:
    """epsilon_k = 1/k in episode k: greedy in the limit with infinite exploration (Silver, lecture 5)."""
    return Power(clock="episode")


def sample_average() -> Power:
    """alpha = 1/N(s, a): each entry is the mean of its targets (book, section 2.4)."""
    return Power(clock="visit")


def check_number(obj, name: str, ok, wanted: str) -> None:
    """Raises InputError unless field `name` of `obj` is a schedule, a tracer, or numbers that are `ok`."""
    value = getattr(obj, name)
    if callable(value) and not isinstance(value, Schedule):
        raise InputError(
            f"{type(obj).__name__}: {name} is a function; wrap it: schedules.Optax(f, clock='step')"
        )
    if isinstance(value, Schedule) or (number := concrete(value)) is None:
        return
    if number.dtype.kind not in "fiu" or not bool(ok(number).all()) or not np.isfinite(number).all():
        raise InputError(f"{type(obj).__name__}: {name} must be {wanted}, not {value!r}")


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


def goes_by_visit(rate: Rate) -> bool:
    """Whether `rate` needs the table of visits."""
    return isinstance(rate, Schedule) and rate.clock == "visit"


def begin_step(clock: Clock, s: Int[Array, ""], a: Int[Array, ""]) -> Clock:
    """Counts one step and one visit of (s, a)."""
    visits = None if clock.visits is None else tables.add(clock.visits, s, a, jnp.int32(1))
    return clock._replace(step=clock.step + 1, visits=visits)


def end_step(clock: Clock, last: Bool[Array, ""]) -> Clock:
    """Counts an episode where it is over."""
    return clock._replace(episode=clock.episode + last.astype(jnp.int32))


def step_size(rate: Rate, clock: Clock, s: Int[Array, ""], a: Int[Array, ""]) -> Float[Array, ""] | float:
    """alpha for the update of (s, a) in the step that has begun."""
    if not isinstance(rate, Schedule):
        return rate
    if rate.clock == "visit":
        assert clock.visits is not None
        return rate(tables.entry(clock.visits, s, a))
    return rate(clock.step if rate.clock == "step" else clock.episode + 1)


def of_state(rate: Rate, clock: Clock, s: Int[Array, ""]) -> Float[Array, ""] | float:
    """What `rate` is for the choice of the next action, in state s."""
    if not isinstance(rate, Schedule):
        return rate
    if rate.clock == "visit":
        assert clock.visits is not None
        return rate(tables.row(clock.visits, s).sum() + 1)
    return rate(1 + (clock.step if rate.clock == "step" else clock.episode))


def exploration(rate: Rate, clock: Clock, s: Int[Array, ""]) -> Float[Array, ""] | float:
    """epsilon for the choice of the next action, in state s; what a schedule gives is clipped to [0, 1]."""
    return jnp.clip(of_state(rate, clock, s), 0, 1) if isinstance(rate, Schedule) else rate
