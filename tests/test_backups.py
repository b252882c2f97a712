"""The sampled backup of a one-step method, averaged over everything that is random in it, is the full backup.

Lecture 5's table: Sarsa and Expected Sarsa sample the Bellman expectation equation, Q-learning the Bellman
optimality equation. With alpha = 1 an update leaves its target in the entry, and one random word decides A',
so the average is a finite sum.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning, rng
from jaxrl_tab.types import Transition

GAMMA, EPSILON = 0.9, 0.3
ENVS = {
    "windy": lambda: rl.WindyGridworld(
        stochastic=True, shape=(3, 4), wind=(0, 1, 2, 0), start=(2, 0), goal=(1, 3)
    ),
    "cliff": lambda: rl.CliffWalking(shape=(2, 4)),
    "walk": lambda: rl.RandomWalk(states=5),
}


def expected_target(algorithm, model, q):
    """sum over outcomes and over A' of (their probability) x (what one update with alpha = 1 writes), [S, A];

    and whether every word did draw the A' that it was made for (which holds before the update: for Sarsa).
    """
    s_count, a_count, k_count = model.prob.shape
    state = algorithm.init(s_count, a_count)._replace(q=q)
    pi = jax.vmap(lambda s: algorithm.probs(state, s))(jnp.arange(s_count))
    edges = jnp.cumsum(pi, axis=1)

    def target(s, a, k, b):
        s_next, r = model.s_next[s, a, k], model.reward[s, a, k]
        middle = edges[s_next, b] - pi[s_next, b] / 2  # the word in the middle of the interval that draws b
        key = rng.as_key((middle * 2.0**32).astype(jnp.uint32))
        discount = jnp.where(model.terminal[s, a, k], 0, algorithm.gamma)
        t = Transition(s, a, r, s_next, discount, model.terminal[s, a, k])
        new, a_next = algorithm.update(key, state, t)
        return new.q[s, a], a_next == b, model.prob[s, a, k] * pi[s_next, b]

    every = [jnp.arange(n) for n in (s_count, a_count, k_count, a_count)]
    grid = jnp.meshgrid(*every, indexing="ij")
    targets, drawn, weight = jax.vmap(target)(*(x.ravel() for x in grid))
    return (targets * weight).reshape(s_count, a_count, -1).sum(-1), drawn.all()


@pytest.mark.parametrize("env_name", ENVS)
@pytest.mark.parametrize("name", rl.ALGORITHMS)
def test_expected_sampled_backup_is_the_full_backup(name, env_name):
    with jax.enable_x64():
        model = planning.enumerate_model(ENVS[env_name]())
        q = jax.random.normal(jax.random.key(0), model.prob.shape[:2], float)
        algorithm = rl.ALGORITHMS[name](alpha=1.0, epsilon=EPSILON, gamma=GAMMA)
        got, drawn = jax.jit(lambda model, q: expected_target(algorithm, model, q))(model, q)
        pi = planning.epsilon_greedy_policy(np.asarray(q), EPSILON)
    v = np.asarray(q).max(1) if name == "q-learning" else (pi * np.asarray(q)).sum(1)
    want = planning.backup(jax.tree.map(np.asarray, model), v, GAMMA)
    np.testing.assert_allclose(got, want, atol=1e-12)
    assert drawn or name != "sarsa"
