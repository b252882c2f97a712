"""Sparse linear systems of many states: what is iterated is right, state by state, by the numbers of that state."""

import numpy as np
import pytest
from scipy import sparse

from jaxrl_tab.exact import systems


@pytest.mark.parametrize("spread", [0, 6])
def test_random_successors_need_no_elimination(spread, monkeypatch):
    """Against plain sweeps in long doubles, also where rewards are of very different sizes.

    Broken once: what BiCGSTAB gives at first is taken -> fails.
    """
    n, gamma, rng = 4000, 0.9, np.random.default_rng(0)
    successors, prob = rng.integers(n, size=(n, 5)), rng.dirichlet(np.ones(5), n).astype(np.longdouble)
    constant = rng.normal(size=n) * 10.0 ** rng.uniform(-spread, spread, n)
    expected = size = np.zeros(n, np.longdouble)
    for _ in range(500):
        expected = constant + gamma * (prob * expected[successors]).sum(1)
        size = abs(constant) + gamma * (prob * size[successors]).sum(1)
    entries = (gamma * prob.astype(float)).ravel(), (np.repeat(np.arange(n), 5), successors.ravel())
    monkeypatch.setattr(systems, "_eliminating", lambda matrix: pytest.fail("it was eliminated"))
    x = systems.sparse_solver(sparse.csc_array(entries, shape=(n, n)))(constant)
    assert (abs(x - expected) <= 1e-13 * size).all()


def test_a_corridor_is_eliminated_and_so_is_what_does_not_converge():
    """A walk of 6000 steps, of which BiCGSTAB takes some hundred."""
    n = 6000
    corridor = sparse.csc_array((np.ones(n - 1), (np.arange(n - 1), np.arange(1, n))), shape=(n, n))
    assert systems._is_narrow(corridor)
    np.testing.assert_array_equal(systems._iterating(corridor)(np.ones(n)), np.arange(n, 0, -1))
