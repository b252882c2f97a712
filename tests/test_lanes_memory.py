"""Memory that is changed in place: an old version of an array still has the old numbers, and no index leaves it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from lanes_tools import assert_as_xla

from jaxrl_tab.lanes.analysis import Facts, operations
from jaxrl_tab.lanes.lower import lower

pytestmark = pytest.mark.usefixtures("optimised")

LANES, SIZE = 40, 50  # more numbers than are taken apart
RNG = np.random.default_rng(0)
X = RNG.normal(size=(LANES, SIZE)).astype(np.float32)
N = RNG.integers(0, 9, LANES).astype(np.int32)


def after_a_write(x, i):
    new = x.at[i].set(7.0)
    return x[3] + new[3], x[i], new[i]


def several_versions(x, i):
    a = x.at[3].set(1.0)
    b = a.at[4].set(2.0)
    c = a.at[5].set(3.0)
    return a, b, c, a[4] + b[4] * c[5] + x[3]


def within_a_loop(x, i):
    def body(k, carried):
        x, total = carried
        new = x.at[(i + k) % SIZE].add(1.0)
        return new, total + x[(i + k) % SIZE] * new[k]

    return lax.fori_loop(0, 6, body, (x + 1, 0.0))


def a_constant_of_a_loop(x, i):
    y = x.at[i].set(2.0)

    def body(k, total):
        return total + y.at[k].set(100.0)  # each turn changes the same old array

    return lax.fori_loop(0, 4, body, x)


def one_array_twice(x, i):
    y = x * 2

    def body(k, carried):
        a, b = carried
        return a.at[k].set(b[k + 1]), b.at[k + 1].set(a[k] - 1)

    return lax.fori_loop(0, 4, body, (y, y)), y


def exchanged(x, i):
    return lax.fori_loop(0, i, lambda k, c: (c[1], c[0].at[k % SIZE].add(c[1][0])), (x * 2, x + 1))


def of_a_lazy_array(x, i):
    shifted = lax.rev(x * 2, (0,))  # it is worked out when it is read
    y = x * 2
    new = lax.fori_loop(0, 5, lambda k, y: y.at[k].set(shifted[k]), y)
    return new, shifted, y[2]


def in_a_branch(x, i):
    y = x + 1
    new = lax.cond(i % 2 == 0, lambda y: y.at[i].set(0.0), lambda y: y, y)
    return new, y[2]


def in_one_of_several(x, i):
    y = x + 1
    cases = [lambda y: y.at[i].set(0.0), lambda y: y.at[1].add(y[2]), lambda y: y, lambda y: y[::-1]]
    new = lax.switch(i, cases, y)
    return lax.switch(i % 4, cases, new), new, y


def in_a_branch_of_a_loop(x, i):
    def body(k, y):
        return lax.cond(y[k] > 0, lambda y: y.at[k + 1].add(y[i]), lambda y: y, y)

    return lax.fori_loop(0, i % 7, body, x * 1)


def loops_of_different_lengths(x, i):
    def body(carried):
        k, y = carried
        inner = lax.while_loop(lambda c: c[0] < k % 3, lambda c: (c[0] + 1, c[1].at[c[0]].mul(2.0)), (0, y))[
            1
        ]
        return k + 1, inner.at[k].set(y[k] + inner[0])

    return lax.while_loop(lambda c: (c[0] < 9) & (c[1][c[0]] < 1), body, (0, x * 1))


def rows_of_a_scan(x, i):
    y = x * 2

    def step(y, k):
        new = y.at[k].set(y[k - 1])
        return new, (y, new[k])  # the old array is a row

    return lax.scan(step, y, jnp.arange(3) + i % 5), y


FUNCTIONS = [
    after_a_write,
    several_versions,
    within_a_loop,
    a_constant_of_a_loop,
    one_array_twice,
    exchanged,
    of_a_lazy_array,
    in_a_branch,
    in_one_of_several,
    in_a_branch_of_a_loop,
    loops_of_different_lengths,
    rows_of_a_scan,
]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_an_old_version_of_an_array_has_the_old_numbers(function):
    """Broken once: `Stored.check` raises nothing, or `to_change` asks not whose memory it is -> fails."""
    assert_as_xla(function, X, N)


def test_nothing_is_copied_that_nobody_else_uses():
    """A loop that writes one entry a turn copies its array once, before it."""

    def function(x, i):
        return lax.fori_loop(0, 1000, lambda k, y: y.at[(i + k) % SIZE].add(1.0), x)

    code = lower(jax.make_jaxpr(function)(X[0], N[0]), [True, True], [None, None])
    assert code.copied == frozenset()


def put(x, number, i):
    return lax.dynamic_update_slice(x, number[None], (i,))


def taken(x, i):
    return lax.dynamic_slice(x, (i,), (1,))[0]


def test_what_was_just_written_is_not_read_again():
    """Broken once: it is read -> fails."""

    def function(x, i):
        return taken(put(x, x[3] + 1, i), i)

    code = lower(jax.make_jaxpr(function)(X[0], N[0]), [True, True], [None, None])
    facts = Facts(code.region)
    loads = [value for value in operations(code.region) if value.op == "load" and value in facts.live]
    assert len(loads) == 1  # of x[3]


def written_over(x, i):
    """At the same place, under another name."""
    return taken(put(put(x, x[3] + 1, i), x[4] * 2, i * i // jnp.maximum(i, 1)), i)


def written_in_a_loop(x, i):
    """In each turn it is read what the turn before has written."""
    x = put(x, x[3] + 1, i)
    return lax.fori_loop(0, i, lambda k, x: put(x, taken(x, i) * 2 + taken(x, i + k % 2), i), x)[:5], taken(
        x, i
    )


@pytest.mark.parametrize("function", [written_over, written_in_a_loop])
def test_what_was_written_over_is_read_again(function):
    """Broken once: a number that was written is known under its index whatever is written later -> fails."""
    assert_as_xla(function, X, N)


def written(x, i, y, mode):
    return [
        x.at[i].set(y[0], mode=mode),
        x.at[i].add(y[0], mode=mode),
        x.at[jnp.stack([i, i + 1, -i])].set(y, mode=mode),
        lax.dynamic_update_slice(x, y, (i,)),
        lax.fori_loop(0, 5, lambda k, x: x.at[i * k].set(y[0], mode=mode), x),
        lax.while_loop(
            lambda c: c[0] < i, lambda c: (c[0] * 2 + 1, c[1].at[c[0]].set(y[1], mode=mode)), (1, x)
        )[1],
        lax.scan(lambda x, k: (lax.dynamic_update_slice(x, y, (k * i,)), x[k]), x, jnp.arange(6)),
    ]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("size", [5, SIZE])
@pytest.mark.parametrize("mode", ["drop", "clip"])
def test_no_index_leaves_the_memory(size, mode):
    """In range, out of range and far out: what XLA gives, and nothing else is written."""
    far = np.array([2**31 - 1, -(2**31), -1, size, size - 1, -size, -size - 1, 2**30], np.int32)
    i = np.concatenate([far, RNG.integers(-3 * size, 3 * size, LANES - len(far)).astype(np.int32)])
    assert_as_xla(partial(written, mode=mode), X[:, :size], i, X[:, :3])
