"""A traced JAX program, read operation by operation, with an input in the place of each random draw.

`Reader.read` goes through a program with values of five kinds: arrays, keys, what depends on a key, and draws
of which nothing has been decided yet, uniform numbers or Gumbel ones. A rule in RULES says what becomes of a draw
in an operation: it is decided there (compared, turned into an index), moved, or left to its key.
"""

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

# Calls that are read operation by operation, and where their operations are.
CALLS = {
    "jit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}


# --- values in a program that is being read ----------------------------------------------------------
# An array stands for itself. Others are a draw that nothing has been decided about, or depend on the key.


class Key(NamedTuple):
    value: Any
    name: Any  # how it was derived: keys of equal names are equal


class Opaque(NamedTuple):
    value: Any  # depends on the key, and so may be another one in each run


@dataclass
class Draw:
    """One draw: what was chosen for it, and the ends between which its uniform number in [0, 1) then lies."""

    name: Any
    sites: list[int] = field(default_factory=list)  # the choices made of it
    is_read: bool = False  # whether its value itself was used
    low: Any = 0.0
    high: Any = 1.0


class Uniform(NamedTuple):
    value: Any  # left to the key
    start: Any  # low + (high - low) * a number in [0, 1)
    end: Any
    draw: Draw

    def map(self, function: Callable[[Any], Any]) -> "Uniform":
        return Uniform(function(self.value), function(self.start), function(self.end), self.draw)


class Gumbel(NamedTuple):
    value: Any
    logits: Any
    draw: Draw


class Reader:
    """One pass through a program.

    `choose(outcomes, size)` makes the next choice: its number, and int32 [size], each below `outcomes`.
    """

    def __init__(self, choose: Callable[[int, int], Any], left_to_keys: set | None):
        self.choose = choose
        # The names of the keys that decide their draws themselves, as in any run. None: all keys do.
        self.left_to_keys = left_to_keys
        self.draws: list[Draw] = []
        self.traced: list[Any] = []

    def new(self, name: Any) -> Draw:
        self.draws.append(draw := Draw(name))
        return draw

    def choice(self, draw: Draw, outcomes: int, size: int) -> Any:
        index, chosen = self.choose(outcomes, size)
        draw.sites.append(index)
        return chosen

    def unclear(self) -> set:
        """The names of keys that serve two draws, or one that is both decided upon and read as it is."""
        names = Counter(draw.name for draw in self.draws)
        return {x.name for x in self.draws if names[x.name] > 1 or (x.sites and x.is_read)}

    def name_of(self, x: Any) -> Any:
        """What tells `x` from other values from which a key is derived."""
        if isinstance(x, Key):
            return x.name
        if is_constant(x):
            return str(np.asarray(x).dtype), np.asarray(x).tobytes()
        place = next((i for i, other in enumerate(self.traced) if other is x), len(self.traced))
        if place == len(self.traced):
            self.traced.append(x)
        return place

    def read(self, jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Any]) -> list[Any]:
        values: dict[Any, Any] = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True))
        for eqn in jaxpr.eqns:
            inputs = [x.val if isinstance(x, Literal) else values[x] for x in eqn.invars]
            values.update(zip(eqn.outvars, self.outputs(eqn, inputs), strict=True))
        return [x.val if isinstance(x, Literal) else values[x] for x in jaxpr.outvars]

    def outputs(self, eqn: Any, inputs: list[Any]) -> list[Any]:
        """What one operation gives."""
        primitive = eqn.primitive.name
        rule = RULES.get((eqn.params["name"], len(inputs)) if primitive == "jit" else primitive)
        if rule and (result := rule(self, eqn, *inputs)) is not None:
            return [result]
        if (where := CALLS.get(primitive)) is not None:
            called: ClosedJaxpr = eqn.params[where]
            return self.read(called.jaxpr, called.consts, inputs)
        return self.compute(eqn, inputs)

    def compute(self, eqn: Any, inputs: list[Any]) -> list[Any]:
        values = [self.plain(x) for x in inputs]
        constant = not any(isinstance(x, Tracer) for x in values)
        # Of constants the result is a constant, too.
        with jax.ensure_compile_time_eval() if constant else contextlib.nullcontext():
            outputs = eqn.primitive.bind(*values, **eqn.params)
        outputs = outputs if eqn.primitive.multiple_results else [outputs]
        keyed = any(isinstance(x, Key) for x in inputs)
        opaque = any(isinstance(x, Opaque | Uniform | Gumbel) for x in inputs)
        derived = eqn.primitive.name, str(eqn.params), tuple(map(self.name_of, inputs))
        return [
            Key(x, (derived, i)) if keyed and not opaque and is_key(x) else
            Opaque(x) if keyed or opaque else x
            for i, x in enumerate(outputs)
        ]  # fmt: skip

    def plain(self, x: Any) -> Any:
        """The array itself. A draw is left to the key then."""
        if isinstance(x, Uniform | Gumbel):
            x.draw.is_read = True
        return x.value if isinstance(x, Key | Opaque | Uniform | Gumbel) else x

    def is_free(self, key: Any, *others: Any) -> bool:
        """Whether a draw from `key` can be chosen: it is no key of two draws, and nothing else is random."""
        left = self.left_to_keys
        can_be_chosen = left is not None and isinstance(key, Key) and key.name not in left
        return can_be_chosen and all(map(is_plain, others))


def is_plain(x: Any) -> bool:
    return not isinstance(x, Key | Opaque | Uniform | Gumbel)


def is_constant(x: Any) -> bool:
    return is_plain(x) and not isinstance(x, Tracer)


def is_key(x: Any) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


# --- rules: (reader, operation, inputs) -> its value, or None where the rule does not apply ------------


def _uniform(reader: Reader, eqn: Any, key: Any, start: Any, end: Any) -> Any:
    if not reader.is_free(key, start, end):
        return None
    value = reader.compute(eqn, [key, start, end])[0].value
    start, end = (jnp.broadcast_to(x, value.shape) for x in (start, end))
    return Uniform(value, start, end, reader.new(key.name))


def _gumbel(reader: Reader, eqn: Any, key: Any) -> Any:
    if not reader.is_free(key):
        return None
    value = reader.compute(eqn, [key])[0].value
    return Gumbel(value, jnp.zeros_like(value), reader.new(key.name))


def _randint(reader: Reader, eqn: Any, key: Any, least: Any, end: Any) -> Any:
    if not reader.is_free(key) or not all(is_constant(x) and np.size(x) == 1 for x in (least, end)):
        return None
    least, end = int(np.ravel(least)[0]), int(np.ravel(end)[0])
    out, draw = eqn.outvars[0].aval, reader.new(key.name)
    chosen = reader.choice(draw, max(1, end - least), math.prod(out.shape))
    draw.low, draw.high = jnp.zeros(chosen.shape), jnp.full(chosen.shape, 1 / max(1, end - least))
    return (least + chosen.reshape(out.shape)).astype(out.dtype)


def _less(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    """A uniform number is never equal to anything, so this is `<=` as well."""
    if isinstance(x, Uniform) and is_plain(y):
        return _is_below(reader, x, y)
    if isinstance(y, Uniform) and is_plain(x):
        return ~_is_below(reader, y, x)
    return None


def _greater(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    return _less(reader, eqn, y, x)


def _is_below(reader: Reader, u: Uniform, threshold: Any) -> Any:
    at = jnp.ravel(_place(u, threshold))
    before = reader.choice(u.draw, 2, at.size) == 1  # v < at
    u.draw.low = jnp.where(before, u.draw.low, jnp.maximum(u.draw.low, at))
    u.draw.high = jnp.where(before, jnp.minimum(u.draw.high, at), u.draw.high)
    before = before.reshape(u.value.shape)
    return jnp.where(u.end > u.start, before, ~before)


def _searchsorted(reader: Reader, eqn: Any, edges: Any, u: Any) -> Any:
    """How many of the edges are below u."""
    if not isinstance(u, Uniform) or not is_plain(edges) or u.value.shape or u.draw.sites:
        return None
    at, zero, one = _place(u, edges), jnp.zeros(1), jnp.ones(1)
    rising, falling = jnp.concatenate([zero, at, one]), jnp.concatenate([one, at, zero])
    i = reader.choice(u.draw, at.size + 1, 1)
    u.draw.low = jnp.where(u.end > u.start, rising[i], falling[i + 1])
    u.draw.high = jnp.where(u.end > u.start, rising[i + 1], falling[i])
    return i[0].astype(eqn.outvars[0].aval.dtype)


def _place(u: Uniform, x: Any) -> Any:
    """The v in [0, 1] at which u = start + (end - start) v is x."""
    return jnp.clip((x - u.start) / (u.end - u.start), 0, 1)


def _argmax(reader: Reader, eqn: Any, x: Any) -> Any:
    """The largest of Gumbel numbers plus logits is number i with probability softmax(logits)[i]."""
    if not isinstance(x, Gumbel) or x.value.ndim != 1 or x.draw.sites:
        return None
    p = jax.nn.softmax(x.logits)
    i = reader.choice(x.draw, len(p), 1)
    x.draw.low, x.draw.high = jnp.zeros(1), p[i]
    return i[0].astype(eqn.outvars[0].aval.dtype)


def _moved(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    """A uniform number that is moved or stretched lies between other ends."""
    shape = eqn.outvars[0].aval.shape

    def apply(x, y):
        return eqn.primitive.bind(*(jnp.broadcast_to(z, shape) for z in (x, y)), **eqn.params)

    if isinstance(x, Uniform) and is_plain(y) and x.value.shape == shape:
        return x.map(lambda z: apply(z, y))
    if isinstance(y, Uniform) and is_plain(x) and y.value.shape == shape:
        return y.map(lambda z: apply(x, z))
    return None


def _add(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    for g, other in ((x, y), (y, x)):
        if isinstance(g, Gumbel) and is_plain(other) and g.value.shape == eqn.outvars[0].aval.shape:
            return Gumbel(g.value + other, g.logits + other, g.draw)
    return _moved(reader, eqn, x, y)


def _mul(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    if not (is_plain(x) and is_plain(y)) and (zero := _settled(eqn, 0, x, y)) is not None:
        return zero
    return _moved(reader, eqn, x, y)


def _reshape(reader: Reader, eqn: Any, x: Any) -> Any:
    return x.map(lambda z: z.reshape(eqn.outvars[0].aval.shape)) if isinstance(x, Uniform) else None


def _select_n(reader: Reader, eqn: Any, which: Any, *cases: Any) -> Any:
    """The case that is chosen, where the condition is a constant."""
    if not is_constant(which) or not np.size(which) or np.ptp(np.asarray(which, int)):
        return None
    return cases[int(np.ravel(which)[0])]


def _and(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    return _settled(eqn, 0, x, y)


def _or(reader: Reader, eqn: Any, x: Any, y: Any) -> Any:
    return _settled(eqn, 1, x, y) if eqn.outvars[0].aval.dtype == bool else None


def _settled(eqn: Any, by: int, x: Any, y: Any) -> Any:
    """The input that is a constant `by`, for then the result is `by` as well: 0 of a product, 1 of `or`."""
    for z in (x, y):
        if is_constant(z) and (np.asarray(z) == by).all():
            with jax.ensure_compile_time_eval():
                return jnp.broadcast_to(z, eqn.outvars[0].aval.shape)
    return None


RULES = {
    # functions of jax.random and jax.numpy, by the name in the program and the number of inputs
    ("_uniform", 3): _uniform,
    ("_gumbel", 1): _gumbel,
    ("_randint", 3): _randint,
    ("searchsorted", 2): _searchsorted,
    # operations
    "lt": _less,
    "le": _less,
    "gt": _greater,
    "ge": _greater,
    "argmax": _argmax,
    "add": _add,
    "sub": _moved,
    "mul": _mul,
    "reshape": _reshape,
    "squeeze": _reshape,
    "select_n": _select_n,
    "and": _and,
    "or": _or,
}
