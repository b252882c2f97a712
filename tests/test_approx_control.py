"""Control with features by the average reward, against the table and a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import test_approx

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.core.types import Transition, fitted, init_learner

KEY = jax.random.key(0)


def test_differential_sarsa_with_one_hot_features_is_the_table():
    """To the last bit, so that figure 10.5 is that of the table."""
    env, rates = rl.AccessControl(), {"alpha": 0.1, "beta": 0.02}
    mine, log = rl.train(KEY, rl.DifferentialSarsa(**rates), env, num_steps=400)
    theirs, other = rl.train(KEY, approx.DifferentialSemiGradientSarsa(**rates), env, num_steps=400)
    np.testing.assert_array_equal(mine.q, theirs.q)
    for x, y in zip(jax.tree.leaves(log), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(x, y)


def test_differential_sarsa_learns_what_a_plain_loop_learns():
    """After each of 300 transitions, in float64. Broken once: the rate moved by alpha instead of beta -> fails."""
    transitions = test_approx.steps(300, gamma=1.0)
    with jax.enable_x64():
        made = approx.DifferentialSemiGradientSarsa(features="tile-coding(4, 5)", alpha=0.05, beta=0.02)
        method = fitted(made, rl.WindyGridworld())
        arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))

        def one(state, step):
            state, a_next = method.update(step[0], state, step[1])
            return state, (state.q, state.rate, a_next)

        state, keys = init_learner(method, rl.WindyGridworld()), jax.random.split(KEY, len(transitions))
        _, found = jax.jit(lambda *steps: jax.lax.scan(one, state, steps))(keys, arrays)
        q, rate, a_next = map(np.asarray, found)
        x = method.features.matrix
    w, mean = np.zeros((x.shape[1], 4)), 0.0
    for i, (s, a, r, s_next, discount, _) in enumerate(transitions):
        delta = r - mean + discount * x[s_next] @ w[:, a_next[i]] - x[s] @ w[:, a]
        mean += 0.02 * delta
        w[:, a] += 0.05 * delta * x[s]
        np.testing.assert_allclose(q[i], w, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(rate[i], mean, rtol=1e-9, atol=1e-11)
