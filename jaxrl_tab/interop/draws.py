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

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal, jaxpr_as_fun

from jaxrl_tab.core import rng
from jaxrl_tab.interop.reader import Key, Reader, is_plain

MOST = 16_384  # combinations of the draws of one call; a function that has more is left to its key
DENOMINATOR = 1000  # of the fractions that float32 numbers are read as, at most


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
        # A draw that is left to its key may make another one unclear that was chosen before.
        left_to_keys: set | None = set()
        while unclear := self._first_pass(left_to_keys):
            left_to_keys |= unclear
        self._second_pass(left_to_keys)

    def _read(self, reader: Reader, inputs: Sequence[Any]) -> list[Any]:
        key, *leaves = inputs
        return reader.read(self._closed.jaxpr, self._closed.consts, [Key(key, "given"), *leaves])

    def _first_pass(self, left_to_keys: set) -> set:
        """Finds the choices to be made. Returns the names of draws that had better be left to their keys."""
        self._sites: list[tuple[int, int]] = []

        def run(number, *inputs):
            def choose(outcomes, size):
                self._sites.append((outcomes, size))
                return len(self._sites) - 1, jnp.broadcast_to(number, (size,))

            reader = Reader(choose, left_to_keys)
            for x in self._read(reader, inputs):
                reader.plain(x)
            names.update(reader.unclear())

        names: set = set()
        jax.make_jaxpr(run)(jax.ShapeDtypeStruct((), jnp.int32), *self._examples)
        return names - left_to_keys

    def _second_pass(self, left_to_keys: set | None) -> None:
        """Makes the program with an input for each choice."""
        self.is_exact: list[bool] = []
        self._made: list[list[int]] = []  # the choices of each draw

        def run(choices, *inputs):
            reader = Reader(lambda outcomes, size: next(chosen), left_to_keys)
            chosen = enumerate(choices)
            outputs = self._read(reader, inputs)
            self.is_exact = list(map(is_plain, outputs))
            made = [draw for draw in reader.draws if draw.sites]
            bounds = [jnp.broadcast_to(x, choices[y.sites[0]].shape) for y in made for x in (y.low, y.high)]
            self._made = [draw.sites for draw in made]
            return [reader.plain(x) for x in outputs], bounds

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
            self._second_pass(left_to_keys=None)
            return self.enumerate(outputs)

        ranges = [range(n) for i in sites for n in [self._sites[i][0]] * self._sites[i][1]]
        every = list(itertools.product(*ranges))
        choices = np.array(every, np.int32).reshape(len(every), len(ranges))
        program = jaxpr_as_fun(self._program)

        def function(choice, key, *args):
            ends = itertools.accumulate((self._sites[i][1] for i in sites), initial=0)
            parts = {i: choice[a:b] for i, (a, b) in zip(sites, itertools.pairwise(ends), strict=True)}
            inputs = [parts.get(i, jnp.zeros(size, jnp.int32)) for i, (_, size) in enumerate(self._sites)]
            results = program(*inputs, key, *jax.tree.leaves(args))
            low, high = (jnp.concatenate([jnp.zeros(0), *(results[i] for i in bounds[e::2])]) for e in (0, 1))
            return [results[i] for i in outputs], low, high

        return Enumeration(choices, function, [self.is_exact[i] for i in outputs])
