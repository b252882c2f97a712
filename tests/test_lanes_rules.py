"""Every rule of the lane compiler gives XLA's bits, at the edges, too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from lanes_cases import CASES
from lanes_tools import assert_as_xla
from marks import slow_but

from jaxrl_tab.core import linear, tables
from jaxrl_tab.lanes.code import Unsupported
from jaxrl_tab.lanes.lower import lower
from jaxrl_tab.lanes.registry import RULES
from jaxrl_tab.lanes.versions import JAXLIB

pytestmark = pytest.mark.usefixtures("optimised")


def test_every_rule_has_a_case():
    assert set(RULES) == set(CASES)


# Whose rules are those of others, with another operation: of cummin, scatter-add, reduce_sum, argmax.
ALIKE = {"cumsum", "cumprod", "cummax", "scatter", "scatter-mul", "scatter-min", "scatter-max", "scatter-sub"}
ALIKE |= {"reduce_prod", "reduce_min", "reduce_max", "reduce_or", "reduce_and", "reduce_xor", "argmin"}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", slow_but(set(RULES) - ALIKE, sorted(RULES)))
def test_a_rule_gives_the_bits_of_xla(name, monkeypatch):
    """All cases of a primitive are compiled together, for the same number of lanes."""
    used, rule = [], RULES[name]
    monkeypatch.setitem(RULES, name, lambda *args: used.append(True) or rule(*args))
    functions, args = zip(*((function, args) for function, *args in CASES[name]), strict=True)
    lanes = max(len(x) for xs in args for x in xs)
    counts = np.cumsum([0, *map(len, args)])

    def all_cases(*xs):
        return [function(*xs[a:b]) for function, a, b in zip(functions, counts[:-1], counts[1:], strict=True)]

    assert_as_xla(all_cases, *(np.resize(x, (lanes, *x.shape[1:])) for xs in args for x in xs))
    assert used


@jax.custom_jvp
def doubled(x):
    return x * 2


@jax.custom_vjp
def tripled(x):
    return x * 3


doubled.defjvp(lambda x, dx: (doubled(*x), dx[0] * 2))
tripled.defvjp(lambda x: (tripled(x), None), lambda _, dx: (dx * 3,))


def test_what_a_function_merely_calls_is_compiled():
    def calls(x):
        gradient = jax.grad(lambda x: tripled(doubled(x)).sum())(x)
        return jax.checkpoint(lambda x: x + 1)(x), jax.nn.relu(x), doubled(x), tripled(x), gradient

    assert_as_xla(calls, np.random.default_rng(0).normal(size=(20, 40)).astype(np.float32))


CHOICES = [  # c is a bool; between what has an operand in common, and what has not
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + k, d * e + k),
    lambda c, a, b, d, e, k, m: jnp.where(c, k + a * b, d * e + k),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b - k, d * e - k),
    lambda c, a, b, d, e, k, m: jnp.where(c, k - a * b, k - d * e),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b - k, k - d * e),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + 1, d * e + 1),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + k, d + k),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + k, a * d + k),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + k, k),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + d * e, d * e + k),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b, b * d) + k,
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b, d * e) + k,
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b, a) + k,
    lambda c, a, b, d, e, k, m: jnp.where(c, a / b, d / b) + k,
    lambda c, a, b, d, e, k, m: jnp.where(c, (a * b + k) * m + k, (d * e + k) * m + k),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + k, jnp.where(a > 0, d * e + k, m * e + k)),
    lambda c, a, b, d, e, k, m: jnp.where(c, a * b + k, d * e + k) * jnp.where(c, a * m, d * m) + b,
    lambda c, a, b, d, e, k, m: (lambda x: jnp.where(c, x, d * e + k) * x)(a * b + k),
    lambda c, a, b, d, e, k, m: (lambda x: jnp.where(c, x + k, d * e + k) * x)(a * b),
    lambda c, a, b, d, e, k, m: jnp.stack([a * b + k, d * e + k])[c.astype(jnp.int32)],
    lambda c, a, b, d, e, k, m: lax.cond(c, lambda: a * b + k, lambda: d * e + k),
    lambda c, a, b, d, e, k, m: lax.cond(c, lambda: a * b, lambda: d * b) + k,
]


def test_a_choice_between_sums_or_products_is_rounded_as_by_xla():
    """Broken once: what is common stays where it is; is taken out where somebody else uses the sum, or where it is

    an entry at an index that is chosen -> fails.
    """
    rng, shape = np.random.default_rng(0), (256, len(CHOICES))

    def all_choices(which, x):
        return [choice(c, *row) for choice, c, row in zip(CHOICES, which, x, strict=True)]

    assert_as_xla(all_choices, rng.random(shape) < 0.5, rng.normal(size=(*shape, 6)).astype(np.float32))


LOOPS = [  # x [7] and p [7], whose products go into loops, from turn to turn, or out of them; n turns
    lambda x, p, n: lax.fori_loop(0, n, lambda k, y: y + p[3], x[0]),
    lambda x, p, n: lax.fori_loop(0, 1, lambda k, y: y + p[3], x[0]),
    lambda x, p, n: lax.fori_loop(0, 2, lambda k, y: y + p[3], x[0]),
    lambda x, p, n: lax.fori_loop(0, 9, lambda k, y: y + p[3], x[0]),
    lambda x, p, n: lax.fori_loop(0, n, lambda k, y: y + p[k], x[0]),
    lambda x, p, n: lax.fori_loop(0, 7, lambda k, y: y + p[k], x[0]),
    lambda x, p, n: lax.fori_loop(0, 3, lambda k, y: (y[0] + y[1], y[1] * x[1]), (x[0], p[3]))[0],
    lambda x, p, n: lax.fori_loop(0, 3, lambda k, y: y * x[1], x[0]) + x[2],
    lambda x, p, n: lax.scan(lambda y, z: (y + z * p[3], None), x[0], x)[0],
    lambda x, p, n: linear.total(jnp.tile(p, 10)),
    lambda x, p, n: jnp.tile(x, 10) + p[3],
    lambda x, p, n: tables.lane_by_lane(_added, x, p[3])[2],
    lambda x, p, n: tables.lane_by_lane(_learned, x, p)[n],
]


def _added(lane, table, number):
    return tables.write(
        table, tables.entry(table, lane, jnp.int32(2)) + tables.entry(number, lane), lane, jnp.int32(2)
    )


def _learned(lane, table, numbers):
    """An update of two active features, as n-step TD and gradient Monte Carlo make it."""
    ones, only = linear.Active(jnp.int32([2, 5])), jnp.int32(0)
    w = table[..., None]
    error = tables.entry(numbers, lane, jnp.int32(1)) - linear.entry(w, ones, only, lane)
    return linear.add(w, ones, only, tables.entry(numbers, lane, jnp.int32(3)) * error, lane)[..., 0]


def test_products_are_rounded_before_a_loop_as_by_xla():
    """Also in a loop that is written out, and where `vmap` alone makes one.

    Broken once: not rounded before a loop, between its turns where it is written out, before what XLA does lane by
    lane, or before all places of a large array -> fails.
    """
    rng, shape = np.random.default_rng(0), (64, len(LOOPS), 7)

    def all_loops(x, y, n):
        return [loop(a, a * b, n) for loop, a, b in zip(LOOPS, x, y, strict=True)]

    x, y = rng.normal(size=(2, *shape)).astype(np.float32)
    assert_as_xla(all_loops, x, y, rng.integers(0, 7, 64).astype(np.int32))


MANY = 2**16  # numbers: all kinds of bits, those of an interval, and those of the size that programs have


def many_numbers():
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, MANY, dtype=np.uint32).view(np.float32)
    return (
        bits,
        rng.permutation(bits),
        rng.uniform(-1, 1, MANY).astype(np.float32),
        (rng.normal(size=MANY) * 30).astype(np.float32),
    )


def test_functions_of_many_numbers_have_the_bits_of_xla():
    """Broken once: the last coefficient of `log1p` a bit off -> fails."""
    one = [
        lax.exp,
        lax.exp2,
        lax.log,
        lax.log1p,
        lax.tanh,
        lax.logistic,
        lax.erf,
        lax.erf_inv,
        lax.sqrt,
    ]
    if JAXLIB < (0, 12):
        one.append(lax.expm1)
    two = [lax.add, lax.mul, lax.div, lax.rem, lax.pow]

    def all_of_them(a, b, c, d):
        return [f(x) for f in one for x in (a, c, d)], [
            f(x, y) for f in two for x, y in ((a, b), (c, d), (d, c))
        ]

    assert_as_xla(all_of_them, *many_numbers())


UNSUPPORTED = {
    "random keys are no results that are compiled": lambda x: jax.random.key(0),
    "the primitive fft is not compiled": lambda x: jnp.fft.fft(x),
    "the primitive tan is not compiled": lambda x: jnp.tan(x),
    "numbers of the type uint8 are not compiled": lambda x: (x > 0).astype(np.uint8) + 1,
    "running sums of more than 256 real numbers are not compiled": lambda x: jnp.cumsum(jnp.tile(x, 100)),
    "the sorting of more than 32 numbers is not compiled": lambda x: jnp.sort(jnp.tile(x, 10)),
}


@pytest.mark.parametrize("message", UNSUPPORTED)
def test_what_is_not_compiled_is_named(message):
    with pytest.raises(Unsupported, match=message):
        lower(jax.make_jaxpr(UNSUPPORTED[message])(np.ones(5, np.float32)), [True], [None])
