"""Optimisers of optax, which turn the gradient of a table into a change of it."""

import functools
import inspect
import re
from typing import TYPE_CHECKING, Any

import jax
from jaxtyping import Array, Float

from jaxrl_tab.core.errors import InputError, nearest, reason, shown
from jaxrl_tab.core.optax import read_call

if TYPE_CHECKING:
    import optax


def spelled(text: str) -> str:
    """The call that makes an optimiser in one spelling, whatever was typed: "adam(b1=0.8)".

    Raises:
        InputError: optax has no such optimiser, or refuses its arguments.
    """
    if not isinstance(text, str):
        raise InputError(f'an optimiser is written as a text, such as "adam", not {shown(text)}')
    plain = re.sub(r"(?<=[a-z])-(?=[a-z])", "_", text).replace(" ", "")  # names are typed with hyphens too
    plain = plain.removesuffix("()")
    _made(plain)
    return plain


def start(optimizer: str, table: Float[Array, "S A"]) -> Any:
    """The state of an optimiser of this table, before its first step."""
    return _made(optimizer).init(table)


def change(
    optimizer: str, gradient: Float[Array, "S A"], state: Any, table: Float[Array, "S A"]
) -> tuple[Float[Array, "S A"], Any]:
    """How a table changes in an ascent with step size 1, [S, A], and the state of the optimiser after that."""
    with jax.numpy_dtype_promotion("standard"):  # optax mixes its types
        updates: Any
        updates, state = _made(optimizer).update(-gradient, state, table)  # which descends
    return updates, state


@functools.cache
def _made(text: str) -> "optax.GradientTransformation":
    """The optimiser that a call makes, with learning rate 1: a step size multiplies what it gives."""
    import optax  # takes long, and is seldom needed

    what = "an optimiser in optax with its numbers in parentheses, such as adam(b1=0.8)"
    name, numbers, keywords = read_call(text if text.endswith(")") else f"{text}()", what)
    takes = {n: _parameters(getattr(optax, n)) for n in dir(optax) if n[0] != "_"}
    names = [n for n, parameters in takes.items() if parameters[:1] == ["learning_rate"]]
    if name not in names:
        raise InputError(f"optax has no optimiser {shown(name)}; {nearest(name, names)}")
    table = jax.ShapeDtypeStruct((2, 2), jax.dtypes.canonicalize_dtype(float))
    try:
        made = getattr(optax, name)(1.0, *numbers, **keywords)
        with jax.numpy_dtype_promotion("standard"):
            jax.eval_shape(lambda x: made.update(x, made.init(x), x), table)
    except Exception as error:  # some arguments are refused by optax, the others by Python or by JAX
        others = ", ".join(takes[name][1:])
        raise InputError(f"{shown(text)}: {reason(error)}; {name} takes {others}") from None
    return made


def _parameters(function: Any) -> list[str]:
    try:
        return list(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return []
