"""The random draws of a JAX function, enumerated: what it may give, with exact probabilities.

A step function of gymnax takes a key and does not say what it draws from it. But its program does, as soon as
JAX has traced it: there `jax.random.randint` is a call named `_randint`, and so on. `Program` reads it
operation by operation, puts an input in the place of each draw, and works out how probable each value of that
input is. No draw is estimated from samples.

What is understood: `randint` (and so `choice`), `uniform` where it is compared with thresholds (and so
`bernoulli`; also after adding, subtracting, multiplying), `choice(p=...)`, `categorical`. Anything else, a
normal number, a shuffle, a draw within a loop or a branch, is left to the key, and so is a key that serves two
draws; what depends on those is known to be not exact. (Keys are known to be the same where they are derived
in the same way, as `split(key)[0]` twice.) What a draw has no influence on is found from the program too: a
branch of `where` that a constant excludes, a product with a constant 0, `and` False.

Probabilities are those of the real numbers that draws stand for; what 32 bits make of them is within 2e-7.
"""

import contextlib
import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from jaxrl_tab.core import rng

MOST = 16_384  # combinations of the draws of one call; a function that has more is left to its key
DENOMINATOR = 1000  # of the fractions that float32 numbers are read as, at most
# Calls that are read operation by operation, and where their operations are.
CALLS = {
    "jit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}


def exact(x: np.ndarray) -> np.ndarray:
    """Float32 numbers as float64, where 0.33333334 is 1/3: the fraction that float32 rounds to the number.

    That is the closest one with a denominator of at most DENOMINATOR, if there is one. Other numbers stay.
    """
    x32 = np.asarray(x, np.float32)
    values, index = np.unique(x32, return_inverse=True)
    read = values.astype(np.float64)
    for i, value in enumerate(values):
        if np.isfinite(value):
            nearest = float(Fraction(float(value)).limit_denominator(DENOMINATOR))
            read[i] = nearest if np.float32(nearest) == value else value
    return read[index].reshape(x32.shape)


class Enumeration(NamedTuple):
    """A function whose draws are inputs.

    Attributes:
        choices: int32 [n, d]: all n combinations of what its d draws may give.
        function: (choice int32 [d], key, *args) -> (outputs, low, high), where `outputs` is a list of those
            asked for. Each of some independent uniform numbers has to be between its low and high for this
            choice, float32 [u] each: `probabilities` says how probable that is.
        is_exact: whether an output is a function of the choice alone, and not of the key, for each.
    """

    choices: np.ndarray
    function: Callable[..., tuple[list[Any], Any, Any]]
    is_exact: list[bool]


def probabilities(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """How probable all choices are, float64 [..., n], from the ends that `function` gave, [..., n, u]."""
    prob = np.maximum(0.0, exact(high) - exact(low)).prod(axis=-1)
    return prob / prob.sum(axis=-1, keepdims=True)


# --- values in a program that is being read ----------------------------------------------------------
# An array stands for itself. Others are a draw that nothing has been decided about, or depend on the key.


class _Key(NamedTuple):
    value: Any
    name: Any  # how it was derived: keys of equal names are equal


class _Opaque(NamedTuple):
    value: Any  # depends on the key, so it is one of many


@dataclass
class _Draw:
    """One draw: which uniform numbers in [0, 1) it needs, and what the choice made of it says of them."""

    name: Any
    sites: list[int] = field(default_factory=list)  # the choices made of it
    is_read: bool = False  # whether its value itself was used
    low: Any = 0.0
    high: Any = 1.0


class _Uniform(NamedTuple):
    value: Any  # left to the key
    start: Any  # low + (high - low) * a number in [0, 1)
    end: Any
    draw: _Draw

    def map(self, function: Callable[[Any], Any]) -> "_Uniform":
        return _Uniform(function(self.value), function(self.start), function(self.end), self.draw)


class _Gumbel(NamedTuple):
    value: Any
    logits: Any
    draw: _Draw


class _Reader:
    """One pass through a program.

    `choose(outcomes, size)` makes the next choice: its number, and int32 [size], each below `outcomes`.
    """

    def __init__(self, choose: Callable[[int, int], Any], left: set | None):
        self.choose = choose
        self.left = left  # the names of the keys whose draws are left to them; None for all keys
        self.draws: list[_Draw] = []
        self.traced: list[Any] = []

    def new(self, name: Any) -> _Draw:
        self.draws.append(draw := _Draw(name))
        return draw

    def choice(self, draw: _Draw, outcomes: int, size: int) -> Any:
        index, chosen = self.choose(outcomes, size)
        draw.sites.append(index)
        return chosen

    def unclear(self) -> set:
        """The names of keys that serve two draws, or one that is both decided upon and read as it is."""
        names = Counter(draw.name for draw in self.draws)
        return {x.name for x in self.draws if names[x.name] > 1 or (x.sites and x.is_read)}

    def name_of(self, x: Any) -> Any:
        """What tells `x` from other values from which a key is derived."""
        if isinstance(x, _Key):
            return x.name
        if _is_known(x):
            return str(np.asarray(x).dtype), np.asarray(x).tobytes()
        place = next((i for i, other in enumerate(self.traced) if other is x), len(self.traced))
        if place == len(self.traced):
            self.traced.append(x)
        return place

    def read(self, jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Any]) -> list[Any]:
        known: dict[Any, Any] = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True))
        for eqn in jaxpr.eqns:
            inputs = [x.val if isinstance(x, Literal) else known[x] for x in eqn.invars]
            known.update(zip(eqn.outvars, self.outputs(eqn, inputs), strict=True))
        return [x.val if isinstance(x, Literal) else known[x] for x in jaxpr.outvars]

    def outputs(self, eqn: Any, inputs: list[Any]) -> list[Any]:
        """What one operation gives."""
        primitive = eqn.primitive.name
        rule = RULES.get((eqn.params["name"], len(inputs)) if primitive == "jit" else primitive)
        if rule and (found := rule(self, eqn, *inputs)) is not None:
            return [found]
        if (where := CALLS.get(primitive)) is not None:
            called: ClosedJaxpr = eqn.params[where]
            return self.read(called.jaxpr, called.consts, inputs)
        return self.compute(eqn, inputs)

    def compute(self, eqn: Any, inputs: list[Any]) -> list[Any]:
        values = [self.plain(x) for x in inputs]
        constant = not any(isinstance(x, Tracer) for x in values)
        with jax.ensure_compile_time_eval() if constant else contextlib.nullcontext():  # it stays known
            given = eqn.primitive.bind(*values, **eqn.params)
        given = given if eqn.primitive.multiple_results else [given]
        keyed = any(isinstance(x, _Key) for x in inputs)
        opaque = any(isinstance(x, _Opaque | _Uniform | _Gumbel) for x in inputs)
        derived = eqn.primitive.name, str(eqn.params), tuple(map(self.name_of, inputs))
        return [
            _Key(x, (derived, i)) if keyed and not opaque and _is_key(x) else
            _Opaque(x) if keyed or opaque else x
            for i, x in enumerate(given)
        ]  # fmt: skip

    def plain(self, x: Any) -> Any:
        """The array itself. A draw is left to the key then."""
        if isinstance(x, _Uniform | _Gumbel):
            x.draw.is_read = True
        return x.value if isinstance(x, _Key | _Opaque | _Uniform | _Gumbel) else x

    def is_free(self, key: Any, *others: Any) -> bool:
        """Whether a draw from `key` can be chosen: it is no key of two draws, and nothing else is random."""
        is_left = self.left is None or not isinstance(key, _Key) or key.name in self.left
        return not is_left and all(map(_is_plain, others))


def _is_plain(x: Any) -> bool:
    return not isinstance(x, _Key | _Opaque | _Uniform | _Gumbel)


def _is_known(x: Any) -> bool:
    return _is_plain(x) and not isinstance(x, Tracer)


def _is_key(x: Any) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


# --- rules: (reader, operation, inputs) -> its value, or None where the rule does not apply ------------


def _uniform(reader: _Reader, eqn: Any, key: Any, start: Any, end: Any) -> Any:
    if not reader.is_free(key, start, end):
        return None
    value = reader.compute(eqn, [key, start, end])[0].value
    start, end = (jnp.broadcast_to(x, value.shape) for x in (start, end))
    return _Uniform(value, start, end, reader.new(key.name))


def _gumbel(reader: _Reader, eqn: Any, key: Any) -> Any:
    if not reader.is_free(key):
        return None
    value = reader.compute(eqn, [key])[0].value
    return _Gumbel(value, jnp.zeros_like(value), reader.new(key.name))


def _randint(reader: _Reader, eqn: Any, key: Any, least: Any, end: Any) -> Any:
    if not reader.is_free(key) or not all(_is_known(x) and np.size(x) == 1 for x in (least, end)):
        return None
    least, end = int(np.ravel(least)[0]), int(np.ravel(end)[0])
    out, draw = eqn.outvars[0].aval, reader.new(key.name)
    chosen = reader.choice(draw, max(1, end - least), math.prod(out.shape))
    draw.low, draw.high = jnp.zeros(chosen.shape), jnp.full(chosen.shape, 1 / max(1, end - least))
    return (least + chosen.reshape(out.shape)).astype(out.dtype)


def _less(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    """A uniform number is never equal to anything, so this is `<=` as well."""
    if isinstance(x, _Uniform) and _is_plain(y):
        return _is_below(reader, x, y)
    if isinstance(y, _Uniform) and _is_plain(x):
        return ~_is_below(reader, y, x)
    return None


def _greater(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    return _less(reader, eqn, y, x)


def _is_below(reader: _Reader, u: _Uniform, threshold: Any) -> Any:
    at = jnp.ravel(_place(u, threshold))
    before = reader.choice(u.draw, 2, at.size) == 1  # v < at
    u.draw.low = jnp.where(before, u.draw.low, jnp.maximum(u.draw.low, at))
    u.draw.high = jnp.where(before, jnp.minimum(u.draw.high, at), u.draw.high)
    before = before.reshape(u.value.shape)
    return jnp.where(u.end > u.start, before, ~before)


def _searchsorted(reader: _Reader, eqn: Any, edges: Any, u: Any) -> Any:
    """How many of the edges are below u."""
    if not isinstance(u, _Uniform) or not _is_plain(edges) or u.value.shape or u.draw.sites:
        return None
    at, zero, one = _place(u, edges), jnp.zeros(1), jnp.ones(1)
    rising, falling = jnp.concatenate([zero, at, one]), jnp.concatenate([one, at, zero])
    i = reader.choice(u.draw, at.size + 1, 1)
    u.draw.low = jnp.where(u.end > u.start, rising[i], falling[i + 1])
    u.draw.high = jnp.where(u.end > u.start, rising[i + 1], falling[i])
    return i[0].astype(eqn.outvars[0].aval.dtype)


def _place(u: _Uniform, x: Any) -> Any:
    """The v in [0, 1] at which u = start + (end - start) v is x."""
    return jnp.clip((x - u.start) / (u.end - u.start), 0, 1)


def _argmax(reader: _Reader, eqn: Any, x: Any) -> Any:
    """The largest of Gumbel numbers plus logits is number i with probability softmax(logits)[i]."""
    if not isinstance(x, _Gumbel) or x.value.ndim != 1 or x.draw.sites:
        return None
    p = jax.nn.softmax(x.logits)
    i = reader.choice(x.draw, len(p), 1)
    x.draw.low, x.draw.high = jnp.zeros(1), p[i]
    return i[0].astype(eqn.outvars[0].aval.dtype)


def _moved(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    """A uniform number that is moved or stretched lies between other ends."""
    shape = eqn.outvars[0].aval.shape

    def apply(x, y):
        return eqn.primitive.bind(*(jnp.broadcast_to(z, shape) for z in (x, y)), **eqn.params)

    if isinstance(x, _Uniform) and _is_plain(y) and x.value.shape == shape:
        return x.map(lambda z: apply(z, y))
    if isinstance(y, _Uniform) and _is_plain(x) and y.value.shape == shape:
        return y.map(lambda z: apply(x, z))
    return None


def _add(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    for g, other in ((x, y), (y, x)):
        if isinstance(g, _Gumbel) and _is_plain(other) and g.value.shape == eqn.outvars[0].aval.shape:
            return _Gumbel(g.value + other, g.logits + other, g.draw)
    return _moved(reader, eqn, x, y)


def _mul(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    if not (_is_plain(x) and _is_plain(y)) and (zero := _settled(eqn, 0, x, y)) is not None:
        return zero
    return _moved(reader, eqn, x, y)


def _reshape(reader: _Reader, eqn: Any, x: Any) -> Any:
    return x.map(lambda z: z.reshape(eqn.outvars[0].aval.shape)) if isinstance(x, _Uniform) else None


def _select_n(reader: _Reader, eqn: Any, which: Any, *cases: Any) -> Any:
    """The case of a condition that is known."""
    if not _is_known(which) or not np.size(which) or np.ptp(np.asarray(which, int)):
        return None
    return cases[int(np.ravel(which)[0])]


def _and(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    return _settled(eqn, 0, x, y)


def _or(reader: _Reader, eqn: Any, x: Any, y: Any) -> Any:
    return _settled(eqn, 1, x, y) if eqn.outvars[0].aval.dtype == bool else None


def _settled(eqn: Any, by: int, x: Any, y: Any) -> Any:
    """The input that is known to be `by`, which is what comes out then."""
    for z in (x, y):
        if _is_known(z) and (np.asarray(z) == by).all():
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


# --- a program ---------------------------------------------------------------------------------------


class Program:
    """A function of a key and arrays, traced and read.

    Args:
        function: (key, *args) -> a pytree of arrays.
        args: examples of the other arguments: pytrees of arrays, or of their shapes and dtypes.

    Attributes:
        is_exact: of each leaf of what it gives, whether choices alone decide it, and not the key.
    """

    def __init__(self, function: Callable[..., Any], *args: Any):
        leaves, treedef = jax.tree.flatten(args)

        def flat(key, *leaves):
            return jax.tree.leaves(function(key, *jax.tree.unflatten(treedef, leaves)))

        self._examples = [jax.eval_shape(lambda: rng.key(0)), *leaves]
        self._closed = jax.make_jaxpr(flat)(*self._examples)
        left: set | None = set()
        while unclear := self._first_pass(left):
            left |= unclear
        self._second_pass(left)

    def _read(self, reader: _Reader, inputs: Sequence[Any]) -> list[Any]:
        key, *leaves = inputs
        return reader.read(self._closed.jaxpr, self._closed.consts, [_Key(key, "given"), *leaves])

    def _first_pass(self, left: set) -> set:
        """Finds the choices to be made. Returns the names of draws that had better be left to their keys."""
        self._sites: list[tuple[int, int]] = []

        def run(number, *inputs):
            def choose(outcomes, size):
                self._sites.append((outcomes, size))
                return len(self._sites) - 1, jnp.broadcast_to(number, (size,))

            reader = _Reader(choose, left)
            for x in self._read(reader, inputs):
                reader.plain(x)
            names.update(reader.unclear())

        names: set = set()
        jax.make_jaxpr(run)(jax.ShapeDtypeStruct((), jnp.int32), *self._examples)
        return names - left

    def _second_pass(self, left: set | None) -> None:
        """Makes the program with an input for each choice."""
        self.is_exact: list[bool] = []
        self._made: list[list[int]] = []  # the choices of each draw

        def run(choices, *inputs):
            reader = _Reader(lambda outcomes, size: next(chosen), left)
            chosen = enumerate(choices)
            given = self._read(reader, inputs)
            self.is_exact = list(map(_is_plain, given))
            made = [draw for draw in reader.draws if draw.sites]
            bounds = [jnp.broadcast_to(x, choices[y.sites[0]].shape) for y in made for x in (y.low, y.high)]
            self._made = [draw.sites for draw in made]
            return [reader.plain(x) for x in given], bounds

        choices = [jax.ShapeDtypeStruct((size,), jnp.int32) for _, size in self._sites]
        self._program = jax.make_jaxpr(run)(choices, *self._examples)

    def _needed(self, outputs: Sequence[int]) -> tuple[set[int], list[int]]:
        """The inputs on which these outputs depend, or the probability of a choice on which they do.

        Also the places of these probabilities among the outputs, low and high of each.
        """
        jaxpr, bounds = self._program.jaxpr, []
        while True:
            needed = {
                jaxpr.outvars[i] for i in (*outputs, *bounds) if not isinstance(jaxpr.outvars[i], Literal)
            }
            for eqn in reversed(jaxpr.eqns):
                if not needed.isdisjoint(eqn.outvars):
                    needed.update(x for x in eqn.invars if not isinstance(x, Literal))
            inputs = {i for i, x in enumerate(jaxpr.invars) if x in needed}
            drawn = [i for i, sites in enumerate(self._made) if not inputs.isdisjoint(sites)]
            more = [len(self.is_exact) + 2 * i + end for i in drawn for end in (0, 1)]
            if more == bounds:
                return inputs, bounds
            bounds = more

    def arguments(self, outputs: Sequence[int]) -> set[int]:
        """The leaves of `args` on which these leaves of what it gives depend, in distribution."""
        inputs, _ = self._needed(outputs)
        return {i - len(self._sites) - 1 for i in inputs if i > len(self._sites)}

    def enumerate(self, outputs: Sequence[int]) -> Enumeration:
        """The distribution of these leaves of what it gives, given its arguments."""
        inputs, bounds = self._needed(outputs)
        sites = [i for i in range(len(self._sites)) if i in inputs]
        if math.prod(float(n) ** size for n, size in map(self._sites.__getitem__, sites)) > MOST:
            self._sites = []
            self._second_pass(left=None)
            return self.enumerate(outputs)

        ranges = [range(n) for i in sites for n in [self._sites[i][0]] * self._sites[i][1]]
        every = list(itertools.product(*ranges))
        choices = np.array(every, np.int32).reshape(len(every), len(ranges))
        program = jaxpr_as_fun(self._program)

        def function(choice, key, *args):
            ends = itertools.accumulate((self._sites[i][1] for i in sites), initial=0)
            parts = {i: choice[a:b] for i, (a, b) in zip(sites, itertools.pairwise(ends), strict=True)}
            given = [parts.get(i, jnp.zeros(size, jnp.int32)) for i, (_, size) in enumerate(self._sites)]
            given = program(*given, key, *jax.tree.leaves(args))
            low, high = (jnp.concatenate([jnp.zeros(0), *(given[i] for i in bounds[e::2])]) for e in (0, 1))
            return [given[i] for i in outputs], low, high

        return Enumeration(choices, function, [self.is_exact[i] for i in outputs])
