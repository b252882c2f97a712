"""Control with features by the average reward, against the table and a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import test_approx

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.core.types import Transition, fitted, init_learner

ENV = rl.WindyGridworld()  # the transitions are not its own
RATES = {"alpha": 0.05, "beta": 0.02}


def test_differential_sarsa_with_features():
    """After each of 300 transitions, in float64: with tiles as a plain loop, and with one-hot features as the table.

    So figure 10.5 is that of the table. Broken once: the rate moved by alpha instead of beta -> fails.
    """
    transitions = test_approx.steps(300, gamma=1.0)

    def learned(method, keys, arrays):
        def one(state, step):
            state, a_next = method.update(step[0], state, step[1])
            return state, (state.q, state.rate, a_next)

        return jax.lax.scan(one, init_learner(method, ENV), (keys, arrays))[1]

    with jax.enable_x64():
        arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))
        keys = jax.random.split(jax.random.key(0), len(transitions))
        tiles = fitted(approx.DifferentialSemiGradientSarsa(features="tile-coding(4, 5)", **RATES), ENV)
        one_hot = fitted(approx.DifferentialSemiGradientSarsa(**RATES), ENV)
        methods = tiles, one_hot, rl.DifferentialSarsa(**RATES)
        found, *twins = jax.jit(lambda *steps: [learned(method, *steps) for method in methods])(keys, arrays)
        x = tiles.features.matrix
    for mine, theirs in zip(*twins, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    w, mean = np.zeros((x.shape[1], 4)), 0.0
    for (s, a, r, s_next, discount, _), q, rate, after in zip(transitions, *found, strict=True):
        delta = r - mean + discount * x[s_next] @ w[:, after] - x[s] @ w[:, a]
        mean += 0.02 * delta
        w[:, a] += 0.05 * delta * x[s]
        np.testing.assert_allclose(q, w, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(rate, mean, rtol=1e-9, atol=1e-11)
