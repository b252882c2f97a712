"""Optimisers of optax, which turn the gradient of what is learned into a change of it.

They are written in two ways. Where a method has a step size, alpha, that is the learning rate, and an optimiser is the
call that makes it without one: "adam(b1=0.8)". Else it is the whole call, as optax has it: "optax:adam(0.01)"; or, in
Python, any transformation of gradients.
"""

import dataclasses
import functools
import inspect
import re
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import jax.numpy as jnp

from jaxrl_tab.core.errors import InputError, nearest, reason, shown
from jaxrl_tab.core.optax import read_call

if TYPE_CHECKING:
    import optax

T = TypeVar("T")
PREFIX = "optax:"


@dataclasses.dataclass(frozen=True)
class Transformation:
    """A transformation of gradients that was made in Python."""

    transformation: Any

    def __str__(self) -> str:
        return repr(self)


def whole(given: Any) -> str | Transformation:
    """An optimiser with its learning rate, as a method keeps it: "optax:adam(0.01)", or a transformation.

    Raises:
        InputError: it is none, or optax refuses its arguments.
    """
    if isinstance(given, str):
        if not given.startswith(PREFIX):
            problem = (
                f"an optimiser is written as optax has it, with its learning rate, such as {PREFIX}adam(0.01)"
            )
            raise InputError(f"{problem}, not {shown(given)}")
        text = PREFIX + _plain(given.removeprefix(PREFIX))
        _made(text)
        return text
    own = given if isinstance(given, Transformation) else Transformation(given)
    if not all(callable(getattr(own.transformation, name, None)) for name in ("init", "update")):
        problem = f'an optimiser is a text such as "{PREFIX}adam(0.01)" or a transformation of optax'
        raise InputError(f"{problem}, not {shown(given)}")
    try:
        _check(own.transformation)
    except Exception as error:
        raise InputError(f"the optimiser cannot be used: {reason(error)}") from None
    return own


def check_fits(optimizer: str | Transformation, learned: Any, who: str) -> None:
    """Raises InputError where an optimiser that was made in Python cannot change what is learned.

    One that is written is an optimiser of optax, which can change anything.

    Args:
        optimizer: as `whole` gives it.
        learned: a pytree of arrays, or of their shapes (`jax.ShapeDtypeStruct`).
        who: the method.
    """
    if not isinstance(optimizer, Transformation):
        return
    try:
        _check(optimizer.transformation, learned)
    except Exception as error:
        shapes = ", ".join(str(list(x.shape)) for x in jax.tree.leaves(learned))
        problem = f"the optimiser cannot be used for weights {shapes}: {reason(error)}"
        raise InputError(problem, who=who, field="optimizer") from None


def spelled(text: str) -> str:
    """The call that makes an optimiser in one spelling, whatever was typed: "adam(b1=0.8)".

    Raises:
        InputError: optax has no such optimiser, or refuses its arguments.
    """
    if not isinstance(text, str):
        raise InputError(f'an optimiser is written as a text, such as "adam", not {shown(text)}')
    plain = _plain(text)
    _made(plain)
    return plain


def _plain(text: str) -> str:
    """A call in one spelling: names are typed with hyphens too."""
    return re.sub(r"(?<=[a-z])-(?=[a-z])", "_", text).replace(" ", "").removesuffix("()")


def start(optimizer: str | Transformation, learned: Any) -> Any:
    """The state of an optimiser of what is learned, a pytree of arrays, before its first step."""
    return _made(optimizer).init(learned)


def change(optimizer: str | Transformation, gradient: T, state: Any, learned: T) -> tuple[T, Any]:
    """How what is learned changes in an ascent, and the state of the optimiser after that.

    An optimiser that is written without its learning rate has 1: a step size multiplies what this gives.

    Args:
        optimizer: as `spelled` or `whole` gives it.
        gradient: by all that is learned: a pytree of arrays, as `learned` is.
        state: of the optimiser.
        learned: before the change.
    """
    with jax.numpy_dtype_promotion("standard"):  # optax mixes its types
        descent = jax.tree.map(lambda x: -x, gradient)  # which is what optimisers do
        updates: Any
        updates, state = _made(optimizer).update(descent, state, learned)  # pyright: ignore[reportArgumentType]
    return updates, state


@functools.cache
def _made(optimizer: str | Transformation) -> "optax.GradientTransformation":
    """The optimiser itself."""
    import optax  # takes long, and is seldom needed

    if isinstance(optimizer, Transformation):
        return optimizer.transformation
    text, is_whole = optimizer.removeprefix(PREFIX), optimizer.startswith(PREFIX)
    such = "adam(0.01)" if is_whole else "adam(b1=0.8)"
    what = f"an optimiser in optax with its numbers in parentheses, such as {such}"
    name, numbers, keywords = read_call(text if text.endswith(")") else f"{text}()", what)
    takes = {n: _parameters(getattr(optax, n)) for n in dir(optax) if n[0] != "_"}
    names = [n for n, parameters in takes.items() if parameters[:1] == ["learning_rate"]]
    if name not in names:
        raise InputError(f"optax has no optimiser {shown(name)}; {nearest(name, names)}")
    rate = [] if is_whole else [1.0]
    given = numbers[0] if is_whole and numbers else keywords.get("learning_rate", 1.0)
    if given <= 0:
        raise InputError(f"{shown(text)}: learning_rate must be greater than 0, not {given:g}")
    try:
        made = getattr(optax, name)(*rate, *numbers, **keywords)
        _check(made)
    except Exception as error:  # some arguments are refused by optax, the others by Python or by JAX
        others = ", ".join(takes[name][len(rate) :])
        raise InputError(f"{shown(text)}: {reason(error)}; {name} takes {others}") from None
    return made


def _check(made: Any, learned: Any = None) -> None:
    """Raises an error unless it can change what is learned by its gradient, and keeps a state of one kind.

    By default that is a small table.
    """
    small = jax.ShapeDtypeStruct((2, 2), jax.dtypes.canonicalize_dtype(float))
    learned = small if learned is None else learned

    def states(x: Any) -> tuple[Any, Any]:
        first = made.init(x)
        return first, made.update(x, first, x)

    with jax.numpy_dtype_promotion("standard"):
        before, (updates, after) = jax.eval_shape(states, learned)
    kinds = [jax.tree.map(lambda x: (x.shape, x.dtype), state) for state in (before, after)]
    if kinds[0] != kinds[1]:
        raise InputError("its state after an update is of another kind than the one that it begins with")
    if jax.tree.map(lambda x: x.shape, updates) != jax.tree.map(lambda x: x.shape, learned):
        raise InputError("its updates are of another shape than what it updates")
    if not all(jnp.issubdtype(x.dtype, jnp.floating) for x in jax.tree.leaves(updates)):
        raise InputError("its updates are no real numbers")


def _parameters(function: Any) -> list[str]:
    try:
        return list(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return []
