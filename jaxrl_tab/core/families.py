"""Schedules that a few numbers describe: what they are, how they end, and how they are typed."""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import concrete
from jaxrl_tab.core.clock import ClockName, Schedule
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static

_CLOCK = "What n counts."


class Tail(NamedTuple):
    """How a schedule ends.

    Attributes:
        order: the p for which its values fall like 1/n^p: 0 where they stay above 0, infinity where they are
            0 from some n on or fall faster than every power.
        words: the same for people, to follow the name of the quantity.
    """

    order: float
    words: str


def tail_at(level: float, otherwise: str) -> Tail:
    """The tail of what settles at `level`; `otherwise` says what it does where that is 0."""
    return Tail(0.0, f"stays at {level:g}") if level > 0 else Tail(np.inf, otherwise)


class Family:
    """A schedule that a few numbers describe. Its `str` is what one types for it: harmonic:100:visit."""

    clock: ClockName

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        """Its value for the count n."""
        raise NotImplementedError

    def tail(self) -> Tail:
        """Raises InputError where its numbers are not plain ones: a batch, or traced."""
        raise NotImplementedError

    def formula(self) -> str:
        """Its value for n, for people. Raises InputError as `tail`."""
        raise NotImplementedError

    def __str__(self) -> str:
        fields = numbers_of(type(self))
        digits = [text for field in fields if (text := typed(getattr(self, field)))]
        if len(digits) < len(fields):
            return repr(self)  # a batch, or traced: nobody typed it
        (name,) = (name for name, cls in FAMILIES.items() if cls is type(self))
        long = ":".join([name, *digits, self.clock])
        return next((short for short, other in SHORT.items() if other == long), long)

    def _plain(self, name: str) -> float:
        value = concrete(getattr(self, name))
        if value is None or value.ndim:
            problem = f"{name} must be one plain number to tell this"
            raise InputError(problem, who=type(self).__name__, field=name)
        return float(value)


@pytree
class Power(Family):
    """scale / n**power: harmonic for power 1, the book's 1/n (section 2.5)."""

    power: float = field(default=1.0, greater_than=0, help="How fast it falls.")
    scale: float = field(default=1.0, greater_than=0, help="Its value for n = 1.")
    clock: ClockName = static(default="episode", help=_CLOCK)

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        return self.scale * jnp.asarray(n, float) ** -jnp.asarray(self.power, float)

    def tail(self) -> Tail:
        power = self._plain("power")
        return Tail(power, "falls like 1/n" if power == 1 else f"falls like 1/n^{power:g}")

    def formula(self) -> str:
        power = self._plain("power")
        return f"{self._plain('scale'):g} / n" + (f"^{power:g}" if power != 1 else "")


@pytree
class Harmonic(Family):
    """n0 / (n0 + n - 1): 1 at first, 1/2 after n0 counts, and like n0/n in the end; 1/n for n0 = 1.

    As an exploration rate by visit it is N0 / (N0 + N(s)), where N(s) counts the earlier visits of the state
    (Silver, assignment Easy21, with N0 = 100).
    """

    n0: float = field(default=100.0, greater_than=0, help="The count after which it is 1/2.")
    clock: ClockName = static(default="visit", help=_CLOCK)

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        return self.n0 / (self.n0 + jnp.asarray(n - 1, float))

    def tail(self) -> Tail:
        return Tail(1.0, "falls like 1/n")

    def formula(self) -> str:
        n0 = self._plain("n0")
        return "1 / n" if n0 == 1 else f"{n0:g} / ({n0:g} + n - 1)"


@pytree
class Linear(Family):
    """From `start` at n = 1 in a straight line to `end` at n = steps + 1, and `end` from then on."""

    start: float = field(at_least=0, help="Its value for n = 1.")
    end: float = field(at_least=0, help="Its value in the end.")
    steps: float = field(at_least=1, help="After how many counts it is `end`.")
    clock: ClockName = static(default="episode", help=_CLOCK)

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        done = jnp.minimum(jnp.asarray(n - 1, float) / self.steps, 1)
        return (1 - done) * self.start + done * self.end

    def tail(self) -> Tail:
        return tail_at(self._plain("end"), f"is 0 after n = {self._plain('steps'):g}")

    def formula(self) -> str:
        start, end, steps = map(self._plain, ("start", "end", "steps"))
        return f"from {start:g} at n = 1 in a straight line to {end:g} at n = {steps + 1:g}, and {end:g} from then on"


@pytree
class Exponential(Family):
    """start rate**(n - 1), but never below `end`."""

    start: float = field(greater_than=0, help="Its value for n = 1.")
    rate: float = field(greater_than=0, less_than=1, help="The ratio of each value to the one before.")
    end: float = field(default=0.0, at_least=0, help="The value below which it never falls.")
    clock: ClockName = static(default="episode", help=_CLOCK)

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        decayed = self.start * jnp.asarray(self.rate, float) ** jnp.asarray(n - 1, float)
        return jnp.maximum(decayed, self.end)

    def tail(self) -> Tail:
        return tail_at(self._plain("end"), f"falls like {self._plain('rate'):g}^n")

    def formula(self) -> str:
        start, rate, end = map(self._plain, ("start", "rate", "end"))
        falling = f"{rate:g}^(n - 1)" if start == 1 else f"{start:g} {rate:g}^(n - 1)"
        return falling + (f", but never below {end:g}" if end else "")


@pytree
class Unbiased(Family):
    """alpha / (1 - (1 - alpha)**n): 1 at first, and alpha in the end (book, exercise 2.7).

    As a step size by visit it is alpha / o_n with o_n = o_{n-1} + alpha (1 - o_{n-1}), o_0 = 0: an average of the
    targets in which each counts 1 / (1 - alpha) times as much as the one before, as with a constant alpha, but without
    the initial value, which the first target replaces.
    """

    alpha: float = field(greater_than=0, at_most=1, help="The value to which it falls.")
    clock: ClockName = static(default="visit", help=_CLOCK)

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        alpha = jnp.asarray(self.alpha, float)
        return alpha / -jnp.expm1(jnp.asarray(n, float) * jnp.log1p(-alpha))

    def tail(self) -> Tail:
        return tail_at(self._plain("alpha"), "")

    def formula(self) -> str:
        alpha = self._plain("alpha")
        return f"{alpha:g} / (1 - {1 - alpha:g}^n)"


FAMILIES: dict[str, type[Family]] = {
    "power": Power,
    "harmonic": Harmonic,
    "linear": Linear,
    "exponential": Exponential,
    "unbiased": Unbiased,
}

SHORT = {"glie": "harmonic:1:episode", "sample-average": "harmonic:1:visit"}


def typed(rate: Any) -> str | None:
    """A number or a schedule as it is typed, "0.1"; None where it is a batch of numbers, or traced."""
    if isinstance(rate, Schedule):
        return str(rate)
    number = concrete(rate)
    if number is None or number.ndim:
        return None
    return np.format_float_positional(number.flat[0], trim="-")


def numbers_of(cls: type[Family]) -> dict[str, Any]:
    """The numbers of a family, in order, each with its default."""
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    return {f.name: f.default for f in fields if f.name != "clock"}
