"""Sarsa(lambda) and Q(lambda): against their plain loops, against the forward view, and by hand.

Every test was seen to fail on code broken in the way that its docstring tells ("Broken once").
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from test_reference import ENVS, STEPS, random_mdp, task_of, words_of

import jaxrl_tab as rl
from jaxrl_tab.policies import Table
from jaxrl_tab.schedules import Optax, Power
from jaxrl_tab.types import Transition

SARSA = [("sarsa-lambda", {"trace": trace}) for trace in ("accumulating", "replacing", "dutch")]
OFFLINE = ("sarsa-lambda", {"offline": True})
WATKINS = [("q-lambda", {"trace": trace}) for trace in ("accumulating", "replacing")]
KINDS = {" ".join(map(str, [name, *kind.values()])): (name, kind) for name, kind in [*SARSA, OFFLINE, *WATKINS]}

# --- decision for decision ---------------------------------------------------------------------------

GAMMAS, LAMBDAS = (0.0, 0.5, 0.9, 1.0), (0.75, 1.0, 0.5, 0.875)
ALPHAS = (0.5, 0.25, 0.25, 0.125)


@pytest.fixture(scope="module")
def tasks():
    with jax.enable_x64():
        envs = {name: make() for name, make in ENVS.items()}
        return {name: (env, task_of(env)) for name, env in envs.items()}


@pytest.mark.parametrize("env_name", ENVS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_step_agrees_with_the_plain_loop(kind, env_name, tasks):
    """In float64: XLA rounds a product and a sum once where the loop rounds twice, and in float32 that breaks

    ties which a decision hangs on.
    """
    (name, fields), (env, task) = KINDS[kind], tasks[env_name]

    def run(key, alpha, gamma, lam):
        method = rl.ALGORITHMS[name](alpha=alpha, epsilon=0.25, gamma=gamma, q0=0.5, lam=lam, **fields)
        return rl.train(key, method, env, num_steps=STEPS, log_every=STEPS)

    with jax.enable_x64():
        keys = jax.random.split(jax.random.key(7), len(GAMMAS))
        state, log = jax.jit(jax.vmap(run))(keys, *map(jnp.array, (ALPHAS, GAMMAS, LAMBDAS)))
        words = [words_of(key) for key in keys]
    for i, (alpha, gamma, lam) in enumerate(zip(ALPHAS, GAMMAS, LAMBDAS, strict=True)):
        rates = reference.Rates(lambda *_, alpha=alpha: alpha, lambda *_: 0.25)
        q, _, finished = reference.trace_control(
            name, task, env.num_actions, rates, gamma, lam, STEPS, words[i], q0=0.5, **fields
        )
        assert len(finished) > 0
        assert log.episodes[i, 0] == len(finished)
        assert log.lengths[i, 0] == sum(n for _, n in finished)
        np.testing.assert_allclose(log.returns[i, 0], sum(g for g, _ in finished), rtol=1e-10)
        np.testing.assert_allclose(state.q[i], q, rtol=1e-10, atol=1e-10)
