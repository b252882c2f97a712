"""Derivatives of what is learned, with respect to the numbers of the method: `jvp`, `jacfwd`, and `vmap` of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from marks import slow_but

import jaxrl_tab as rl
from jaxrl_tab.core import tables
from jaxrl_tab.engine import backend

WALK, DOORS = rl.make("random-walk", states=5), rl.make("two-doors")
KEY = jax.random.key(3)
STEP = 3e-3


def learned(method, env, **numbers):
    """What a run of ten steps learns, as a function of the numbers: (table, exact error in each row)."""

    def run(x):
        given = {name: x[k] for k, name in enumerate(numbers)}
        state, log = rl.train(KEY, method(**given), env, num_steps=10, log_every=5, exact=True)
        return state.q, log.v_error if env is WALK else log.q_error

    return run, jnp.array(list(numbers.values()))


def differences(run, x):
    """The same by central differences: [outputs, numbers] each."""
    by_number = STEP * jnp.eye(x.size)
    moved = jnp.concatenate([x[None] + by_number, x[None] - by_number])
    above, below = zip(*(np.split(np.asarray(y), 2) for y in jax.jit(jax.vmap(run))(moved)), strict=True)
    return [np.moveaxis((a - b) / (2 * STEP), 0, -1) for a, b in zip(above, below, strict=True)]


CASES = {
    "td": {"alpha": 0.1},
    "n-step-td": {"alpha": 0.1},
    "td-lambda": {"alpha": 0.1, "lam": 0.5},
    "monte-carlo-prediction": {"alpha": 0.1},
    "expected-sarsa": {"alpha": 0.1},
    "sarsa-lambda": {"alpha": 0.1, "lam": 0.5},
    "double-q-learning": {"alpha": 0.1},
    "monte-carlo": {"alpha": 0.1},
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", slow_but(["td", "expected-sarsa", "monte-carlo"], CASES))
def test_they_are_what_small_changes_make(name):
    """Also of the exact error. With `jacfwd` derivatives have lanes, and the numbers have none.

    Broken once: `vmap` of a table's operation without lanes goes on for ever -> RecursionError; None among what goes
    lane by lane -> AssertionError in Monte Carlo; the maximum by JAX's rule -> TypeError of float64 and float32.
    """
    methods = rl.PREDICTION | rl.ALGORITHMS
    run, x = learned(methods[name], WALK if name in rl.PREDICTION else DOORS, **CASES[name])
    found = jax.jit(jax.jacfwd(run))(x)
    for slopes, expected in zip(found, differences(run, x), strict=True):
        np.testing.assert_allclose(slopes, expected, rtol=1e-3, atol=1e-3)
    assert abs(found[0]).max() > 0.05


@pytest.mark.slow
def test_of_a_grid_at_once():
    run, x = learned(rl.PREDICTION["td-lambda"], WALK, alpha=0.1, lam=0.5)
    grid = jnp.outer(jnp.array([1.0, 0.5, 2.0]), x)
    at_once = jax.jit(jax.vmap(jax.jacfwd(run)))(grid)
    for k in range(3):
        for of_grid, alone in zip(at_once, jax.jit(jax.jacfwd(run))(grid[k]), strict=True):
            np.testing.assert_allclose(of_grid[k], alone, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_jumps_of_the_policy_are_not_seen():
    """Of greedy values there are no others; of Sarsa's the actions change with epsilon, and no slope says so."""

    def run(epsilon):
        _, log = rl.train(
            KEY, rl.Sarsa(alpha=0.1, epsilon=epsilon), DOORS, num_steps=200, log_every=200, exact=True
        )
        return log.rewards[-1], log.greedy_value[-1]

    values, slopes = jax.jit(lambda x: jax.jvp(run, (x,), (1.0,)))(0.1)
    others = jax.jit(run)(0.9)
    assert slopes == (0, 0) and values[0] != others[0]


@pytest.mark.parametrize("lanes", [False, True])
def test_of_what_goes_lane_by_lane(lanes):
    """A loop whose length differs from lane to lane, with a None among its arrays."""

    def powers(x, n):
        body = lambda lane, table, n, _: lax.fori_loop(
            0, tables.entry(n, lane), lambda k, t: tables.write(t, tables.entry(t, lane) * 2, lane), table
        )
        return tables.lane_by_lane(body, x, n, None)

    x, n = jnp.array([1.0, 3.0]), jnp.array([2, 3])
    slope = lambda x, n: jax.jvp(lambda x: powers(x, n), (x,), (jnp.float32(1),))[1]
    found = jax.vmap(slope)(x, n) if lanes else jnp.stack([slope(x[0], n[0]), slope(x[1], n[1])])
    np.testing.assert_array_equal(found, [4, 8])


def test_with_lanes_they_are_left_to_xla():
    """Bitwise the same as by XLA. Broken once: without a rule for derivatives -> NotImplementedError."""
    x = jnp.array([0.1])
    plain = lambda x: rl.train(KEY, rl.PREDICTION["td"](alpha=x[0]), WALK, num_steps=10)[0].q
    ours = jax.jit(jax.jacfwd(lambda x: plain(x)))(x)
    with backend.using("xla"):
        theirs = jax.jit(jax.jacfwd(lambda x: plain(x)))(x)
    np.testing.assert_array_equal(ours, theirs)
    assert abs(ours).max() > 0
