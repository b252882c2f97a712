"""Numbers that change with experience: step sizes and exploration rates.

Wherever a method takes `alpha` or `epsilon` it takes a number or a schedule. A schedule has a **clock**:

- `"step"`: n is the number of this step, 1 for the first;
- `"episode"`: n is the number of this episode, 1 for the first;
- `"visit"`: for a step size, n = N(s, a), the visits of the pair so far, this one included; for an
  exploration rate, n = N(s) + 1 where N(s) counts the earlier visits of the state.

The families `Power`, `Harmonic`, `Linear`, `Exponential` and `Unbiased` are written as they are typed on the command
line (`str`, `parse`), and `is_glie` and `is_robbins_monro` tell whether they meet the conditions under which
control converges. A schedule of optax can be typed too, and any other function is a schedule (`Optax`), but
nothing can be told about their limits.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core.checks import KINDS, Kind, as_array, build, check_number
from jaxrl_tab.core.clock import (
    CLOCKS,
    Clock,
    ClockName,
    Rate,
    Schedule,
    at_visit,
    begin_step,
    end_step,
    exploration,
    goes_by_visit,
    of_state,
    start,
    step_size,
)
from jaxrl_tab.core.errors import InputError, nearest, shown
from jaxrl_tab.core.families import (
    FAMILIES,
    SHORT,
    Exponential,
    Family,
    Harmonic,
    Linear,
    Power,
    Tail,
    Unbiased,
    numbers_of,
    tail_at,
    typed,
)
from jaxrl_tab.core.optax import Optax

__all__ = [
    "CLOCKS",
    "FAMILIES",
    "SHORT",
    "Clock",
    "ClockName",
    "Exponential",
    "Family",
    "Harmonic",
    "Linear",
    "Optax",
    "Power",
    "Rate",
    "Schedule",
    "Tail",
    "Unbiased",
    "Verdict",
    "at_visit",
    "begin_step",
    "end_step",
    "exploration",
    "form",
    "forms",
    "glie",
    "goes_by_visit",
    "is_glie",
    "is_named",
    "is_robbins_monro",
    "of_state",
    "parse",
    "read",
    "sample_average",
    "start",
    "step_size",
    "typed",
]


NAMES = (*FAMILIES, "optax")  # with which a schedule begins as it is typed


def glie() -> Harmonic:
    """epsilon_k = 1/k in episode k: greedy in the limit with infinite exploration (Silver, lecture 5)."""
    return Harmonic(1.0, clock="episode")


def sample_average() -> Harmonic:
    """alpha = 1/N(s, a): each entry is the mean of its targets (book, section 2.4)."""
    return Harmonic(1.0, clock="visit")


def is_named(text: str) -> bool:
    """Whether `text` is meant to be a schedule: it has numbers with colons, or a schedule's name."""
    return ":" in text or text in SHORT or text in NAMES


def parse(text: str) -> Family | Optax:
    """A schedule from what is typed: "glie", "sample-average", or a family, its numbers and its clock.

    So "harmonic:100:visit", "power:0.8:episode", "linear:1:0.05:500:step". Numbers that have a default may be
    left off at the end; the clock may not. A schedule of optax is a call, "optax:cosine_decay_schedule(0.5,
    8000):episode", and goes by steps where no clock follows it.

    Raises:
        InputError: `text` is none of these; the message says what would be right.
    """
    if not isinstance(text, str):
        raise InputError(f"a schedule is written as a text, such as 'glie', not {shown(text)}")
    text = text.replace("_", "-")
    name, *numbers = SHORT.get(text, text).split(":")
    if name not in NAMES:
        raise InputError(f"there is no schedule {shown(text)}; {nearest(name, [*SHORT, *NAMES])}")
    wrong = f"{shown(text)} is not of the form {form(name)}, where CLOCK is one of {', '.join(CLOCKS)}"
    if name == "optax":
        if len(numbers) not in (1, 2):
            raise InputError(wrong)
        return build(Optax, name, dict(zip(("schedule", "clock"), numbers, strict=False)))
    fields, clock = numbers_of(FAMILIES[name]), numbers.pop() if numbers else None
    try:
        values = dict(zip(fields, map(float, numbers), strict=False))
    except ValueError:
        values = {}
    needed = list(fields.values()).count(dataclasses.MISSING)
    if clock not in CLOCKS or len(values) < max(len(numbers), needed):
        missing = "" if clock in CLOCKS else ": no clock stands at its end"
        raise InputError(wrong + missing)
    return build(FAMILIES[name], name, {**values, "clock": clock})


def read(text: str) -> float | Family | Optax:
    """A number or a schedule from what is typed: "0.5", "glie".

    Raises:
        InputError: `text` is neither; the message says what would be right.
    """
    if is_named(text.replace("_", "-")):
        return parse(text)
    try:
        return float(text)
    except ValueError:
        hint = nearest(text, [*SHORT, *NAMES], otherwise=f"a schedule is {forms()}")
        raise InputError(f"{shown(text)} is neither a number nor a schedule; {hint}") from None


def forms() -> str:
    """How a schedule may be typed."""
    written = ", ".join([*SHORT, *map(form, NAMES)])
    return f"one of {written}, where CLOCK is one of {', '.join(CLOCKS)}"


def form(name: str) -> str:
    """How a schedule that begins with `name` is typed: "power[:POWER[:SCALE]]:CLOCK"."""
    if name == "optax":
        return "optax:NAME(NUMBERS)[:CLOCK]"
    numbers = numbers_of(FAMILIES[name])
    needed = [f":{n.upper()}" for n, default in numbers.items() if default is dataclasses.MISSING]
    spare = [f"[:{n.upper()}" for n, default in numbers.items() if default is not dataclasses.MISSING]
    return "".join([name, *needed, *spare, "]" * len(spare), ":CLOCK"])


# --- what a method takes ------------------------------------------------------------------------------
def _check_rate(who: str | None, field: dataclasses.Field, value: Any) -> Any:
    """`value` where it is a schedule, a tracer, or numbers within the limits of the field; text as it is read."""
    if type(value) is float:  # whether it is a schedule takes longer to ask
        return check_number(who, field, value)
    if isinstance(value, Schedule) and not isinstance(value, type):
        return value
    name, kinds = field.name, "a number or a schedule"
    if isinstance(value, type):
        raise InputError(f"{name} must be {kinds}, not a class", who=who, field=name, wanted=kinds)
    if callable(value):
        wrapped = f"{name} is a function; wrap it: schedules.Optax(f, clock='step')"
        raise InputError(wrapped, who=who, field=name, wanted=kinds, value=value)
    if isinstance(value, str):
        try:
            value = read(value)
        except InputError as error:
            raise error.renamed(who, name) from None
    return value if isinstance(value, Schedule) else check_number(who, field, value, kinds)


KINDS[Rate] = Kind(_check_rate, "a number", ", or a schedule")


def check_single(what: str, obj: Any) -> None:
    """Raises InputError where a number of `obj`, or of a schedule or a policy in it, is an array of several.

    But what a table [S, A] holds at first may be such a table.
    """
    for f in dataclasses.fields(obj):
        value = getattr(obj, f.name)
        if f.metadata.get("static"):
            continue
        if dataclasses.is_dataclass(value):
            check_single(f"{what}: {f.name}", value)
        elif (
            f.type in (float, Rate)
            and (shape := np.shape(value))
            and not (f.name in ("q0", "theta0") and len(shape) == 2)
        ):
            raise InputError(
                f"{what}: {f.name} is an array of shape {shape}: one run takes one number; sweep(...) "
                "tries all of a list, and jax.vmap runs all of an array"
            )


# --- the two conditions under which control converges ------------------------------------------------
class Verdict(NamedTuple):
    """Whether a condition holds; true or false itself.

    Attributes:
        holds: the answer.
        why: the reason, and what is assumed.
    """

    holds: bool
    why: str

    def __bool__(self) -> bool:
        return self.holds


def is_glie(epsilon: Rate) -> Verdict:
    """Whether epsilon-greedy with this epsilon is greedy in the limit with infinite exploration (GLIE).

    Greedy in the limit: epsilon goes to 0. Infinite exploration: every action is tried infinitely often in
    every state that is visited infinitely often. A visit tries each action with probability epsilon / A or
    more, whatever came before, so this holds where the sum of epsilon **over the visits of the state** is
    infinite; where it is finite exploration stops (Singh, Jaakkola, Littman and Szepesvari 2000, appendix B).
    Of values that fall like 1/n^p the sum is infinite for p <= 1.

    - By visit, n counts the visits of the state itself, so the sum is the one that is needed. Where every
      state can be reached from every other, all pairs (s, a) are then tried infinitely often.
    - By step or by episode, the sum runs over those n alone at which the state is visited. It is infinite if
      the state is visited at a positive rate, whatever is learned. **That is assumed** here, as it is where
      the lecture calls epsilon_k = 1/k in episode k GLIE. It fails in states that only exploring leads to: a
      pair that is two exploring steps off the greedy path needs both in one episode. With two actions in each
      state that has probability 1/(2k)^2 in episode k, so as long as the greedy actions stay what they are
      the pair is never tried at all with probability (1 - 1/4) (1 - 1/16) (1 - 1/36) ... = 2/pi.

    The condition does not say how fast; neither does the theorem that rests on it.

    Args:
        epsilon: a number in [0, 1], or a schedule of a named family.

    Raises:
        InputError: it is an arbitrary function, of which nobody can tell; or no exploration rate.
    """
    order, words = _tail("is_glie", epsilon, lambda x: 0 <= x <= 1, "epsilon must be between 0 and 1")
    if order == 0:
        return Verdict(False, f"epsilon {words}: it explores for ever, but it never becomes greedy")
    if order > 1:
        return Verdict(False, f"epsilon {words}, so its sum is finite: from some time on it never explores")
    assert isinstance(epsilon, Family)  # of a number the order is 0 or infinite, which returned above
    everywhere = (
        "every state that is visited for ever"
        if epsilon.clock == "visit"
        else f"every state, {_assumption(epsilon)}"
    )
    why = f"epsilon {words}, to 0, and its sum is infinite: it becomes greedy, and tries all actions for ever"
    return Verdict(True, f"{why} in {everywhere}")


def is_robbins_monro(alpha: Rate) -> Verdict:
    """Whether this step size meets the conditions of Robbins and Monro (1951; book, equation 2.7).

    For every pair (s, a), **over the visits of the pair**: sum of alpha = infinity, to get away from any
    initial value, and sum of alpha^2 < infinity, for the noise to die down. Of values that fall like 1/n^p
    both hold for 1/2 < p <= 1.

    - By visit, n counts the visits of the pair itself, so these are the sums that are needed.
    - By step or by episode the sums run over those n alone at which the pair is visited. The sum of squares
      stays finite (an episode has no more steps than the time limit); the sum of alpha is infinite if the
      pair is visited at a positive rate. **That is assumed** here. It fails where exploration fades: with
      alpha = epsilon = 1/t at step t, a pair off the greedy path is visited at step t with a probability of
      the order of 1/t, and its step sizes add up like 1/t^2.

    Args:
        alpha: a number of at least 0, or a schedule of a named family.

    Raises:
        InputError: it is an arbitrary function, of which nobody can tell; or no step size.
    """
    order, words = _tail(
        "is_robbins_monro", alpha, lambda x: 0 <= x < np.inf, "alpha must be a number of at least 0"
    )
    if order <= 0.5:
        return Verdict(False, f"alpha {words}, so the sum of its squares is infinite: noise never dies down")
    if order > 1:
        return Verdict(False, f"alpha {words}, so its sum is finite: it may stop short of its goal")
    assert isinstance(alpha, Family)  # of a number the order is 0 or infinite, which returned above
    pairs = "that is visited for ever" if alpha.clock == "visit" else _assumption(alpha)
    why = f"alpha {words}, so its sum is infinite and that of its squares is finite"
    return Verdict(True, f"{why}, for every pair (s, a) {pairs}")


def _assumption(rate: Family) -> str:
    """What is assumed of a rate that does not go by visits."""
    return (
        f"assuming that each is visited at a positive rate per {rate.clock} whatever is learned "
        "(clock='visit' needs no such assumption)"
    )


def _tail(asker: str, rate: Any, fits: Callable[[float], bool], wanted: str) -> Tail:
    """The tail of a number that `fits`, or of a schedule of a named family."""
    if isinstance(rate, Family):
        return rate.tail()
    if callable(rate):
        kind = "a class" if isinstance(rate, type) else f"an arbitrary function ({type(rate).__name__})"
        families = ", ".join(cls.__name__ for cls in FAMILIES.values())
        raise InputError(
            f"{asker} cannot tell of {kind}: no number of its values decides about a limit; "
            f"give a number or a schedule of the families {families}"
        )
    number = as_array(rate)
    if number is None or number.ndim or number.dtype.kind not in "fiu" or not fits(float(number)):
        raise InputError(f"{asker}: {wanted}, or a schedule, not {shown(rate)}")
    return tail_at(float(number), "is 0")
