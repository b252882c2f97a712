"""What a program leaves to XLA, where it is compiled by lanes: for all lanes at once, between two loops of its own.

To XLA itself these are plain functions.
"""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

_NAME = "not_compiled_by_lanes"


def outside(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, left to XLA. It may only be called where all lanes come at the same time."""

    def not_compiled(*args: Any) -> Any:
        return function(*args)

    not_compiled.__name__ = _NAME
    return jax.jit(not_compiled)


def is_outside(equation: Any) -> bool:
    """Whether an equation of a jaxpr is a call of such a function."""
    return equation.primitive.name in ("jit", "pjit") and equation.params["name"] == _NAME


def prepared(make: Callable[..., Callable[..., Any]], *args: Any, like: Any) -> Callable[[Any], Any]:
    """`make(*args)`, a function of something `like` this, left to XLA as a whole.

    `make` is called once, and what it works out is handed on to each call of the function that it gives.
    """
    calls = []

    def prepare(*args: Any) -> Any:
        made = make(*args)
        closed, shape = jax.make_jaxpr(made, return_shape=True)(like)
        calls.append((closed.jaxpr, jax.tree.structure(shape)))
        return closed.consts

    results = outside(prepare)(*args)
    jaxpr, structure = calls[-1]

    def call(x: Any, results: Any) -> Any:
        closed = ClosedJaxpr(jaxpr, results)
        return jax.tree.unflatten(structure, jaxpr_as_fun(closed)(*jax.tree.leaves(x)))

    return lambda x: outside(call)(x, results)
