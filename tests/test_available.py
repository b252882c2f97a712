"""Actions that a state does not have: no behaviour takes them, and no target does."""

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import policies
from jaxrl_tab.policies import EpsilonGreedy, Table

# s0 -(-1)-> s1 -(-5)-> end. In s1 action 1 would give 0 for ever, and is not available.
CHAIN = rl.FiniteMDP(
    np.array([[[0, 1, 0], [0, 1, 0]], [[0, 0, 1], [0, 0, 1]], [[0, 0, 1], [0, 0, 1]]], float),
    np.array([[-1.0, -1.0], [-5.0, -5.0], [0.0, 0.0]]),
    terminal=[2],
)
AVAILABLE = np.array([[True, True], [True, False], [True, True]])


@pytest.mark.parametrize("name", rl.ALGORITHMS)
def test_no_method_learns_from_an_action_that_is_not_there(name):
    """Broken once: Q0 = 0 there as elsewhere -> Q(s0) is -1 for q-learning, and six methods fail."""
    parameters = {} if name.endswith("monte-carlo") else {"alpha": 0.5}
    method = rl.ALGORITHMS[name](behaviour=EpsilonGreedy(0.5, AVAILABLE), **parameters)
    budget = {"num_steps": 400, "log_every": 400, "exact": name == "sarsa"}  # of one: it is slow to compile
    state, log = jax.jit(lambda key: rl.train(key, method, CHAIN, **budget))(jax.random.key(0))
    np.testing.assert_allclose(state.q[0], -6, rtol=1e-5)
    np.testing.assert_allclose(state.q[1], [-5, policies.UNAVAILABLE], rtol=1e-5)
    if budget["exact"]:
        assert log.q_error[-1] < 1e-4
        assert log.greedy_value[-1] == -6


def test_coverage_knows_which_actions_there_are():
    """Broken once: `available` not looked at -> fails."""
    behaviour = EpsilonGreedy(0.1, AVAILABLE)
    needs_it = Table(np.tile([0.0, 1.0], (3, 1)))
    for method in (rl.OffPolicyMonteCarlo, rl.TargetQLearning, rl.ExpectedSarsa):
        with pytest.raises(rl.InputError, match="leaves out action 1 in state 1, which target can take"):
            method(behaviour=behaviour, target=needs_it)
        method(behaviour=behaviour, target=policies.Greedy())
        method(behaviour=behaviour, target=Table(np.tile([1.0, 0.0], (3, 1))))
