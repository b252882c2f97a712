"""Schedules of optax, and functions of one's own, as step sizes and exploration rates."""

import ast
import contextlib
import inspect
import math
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import assign
from jaxrl_tab.core.clock import ClockName
from jaxrl_tab.core.errors import InputError, nearest, reason, shown, unfit
from jaxrl_tab.core.pytree import pytree, static


@pytree
class Optax:
    """Any optax schedule, or any function of a count that starts at 0 and is written in jax.numpy.

    Raises:
        InputError: `schedule` is neither, or optax has no such schedule, or refuses its arguments.
    """

    schedule: Callable[[Any], Any] | str = static(
        help="The function; or, as text, the call that makes it in optax, with numbers as its arguments: "
        '"cosine_decay_schedule(0.5, 8000)". Only text can be typed, and written to a file.'
    )
    clock: ClockName = static(default="step", help='What is counted: "step", "episode" or "visit".')

    def __post_init__(self):
        if isinstance(self.schedule, str):
            text = re.sub(r"(?<=[a-z])-(?=[a-z])", "_", self.schedule)  # names are typed with hyphens too
            _make(text)
            call = ast.parse(text, mode="eval")
            assign(self, schedule=ast.unparse(call).replace(" ", ""))  # one spelling, whatever was typed
        elif not callable(self.schedule):
            raise unfit("Optax", "schedule", "a function of a count", self.schedule)

    def __call__(self, n: Int[Array, ""]) -> Float[Array, ""]:
        schedule = _make(self.schedule) if isinstance(self.schedule, str) else self.schedule
        with jax.numpy_dtype_promotion("standard"):  # the function is somebody else's
            return jnp.asarray(schedule(n - 1), float)

    def __str__(self) -> str:
        if not isinstance(self.schedule, str):
            return repr(self)
        return f"optax:{self.schedule}" + ("" if self.clock == "step" else f":{self.clock}")


def _make(text: str) -> Callable[[Any], Any]:
    """The schedule that a call in optax makes."""
    import optax  # takes long, and is seldom needed

    what = "a schedule in optax with its numbers in parentheses, such as cosine_decay_schedule(0.5, 8000)"
    name, numbers, keywords = read_call(text, what)
    names = [x for x in dir(optax.schedules) if x.endswith(("_schedule", "_decay")) and x[0] != "_"]
    if name not in names:
        raise InputError(f"optax has no schedule {shown(name)}; {nearest(name, names)}")
    function = getattr(optax.schedules, name)
    try:
        schedule = function(*numbers, **keywords)
        with jax.numpy_dtype_promotion("standard"):
            jax.eval_shape(schedule, jax.ShapeDtypeStruct((), jnp.int32))
    except Exception as error:  # some arguments are refused by optax, the others by Python or by JAX
        takes = ", ".join(inspect.signature(function).parameters)
        raise InputError(f"{shown(text)}: {reason(error)}; {name} takes {takes}") from None
    return schedule


def read_call(
    text: str, what: str, takes_more: bool = False, typed: str | None = None
) -> tuple[str, list[Any], dict[str, Any]]:
    """The name, the arguments and the keyword arguments of a call; nothing in `text` is evaluated.

    They are numbers, or, where it `takes_more`, also texts and tuples of numbers.

    Raises:
        InputError: `text` is not the name of `what`. The message has what was `typed`, by default `text`.
    """
    with contextlib.suppress(AttributeError, ValueError, SyntaxError, RecursionError, MemoryError):
        call: Any = ast.parse(text, mode="eval").body
        numbers = [ast.literal_eval(x) for x in call.args]
        keywords = {x.arg: ast.literal_eval(x.value) for x in call.keywords}
        given = [*numbers, *keywords.values()]
        if takes_more:
            given = [y for x in given for y in (x if isinstance(x, tuple) else [x]) if not isinstance(y, str)]
        is_number = [isinstance(x, int | float) and abs(x) < math.inf for x in given]
        if all(is_number) and len(keywords) == len(call.keywords):
            return call.func.id, numbers, keywords
    raise InputError(f"{shown(text if typed is None else typed)} is not the name of {what}")
