"""Every method against its plain loop, decision for decision (dyadic step sizes: no rounding differs)."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

import jaxrl_tab as rl
from jaxrl_tab.core import rng
from jaxrl_tab.core.schedules import Optax, Power
from jaxrl_tab.engine.loop import BEFORE_RESET, BEFORE_START, IN_A_STEP

STEPS = 600


def uniforms(words):
    return (np.asarray(words) >> 8).astype(np.float32) * np.float32(2**-24)


def words_of(key, steps=STEPS):
    """The words of a run with this key, as numbers in [0, 1)."""
    stream = rng.stream(key)
    draw = lambda t, decision: uniforms(rng.word(stream, t, decision))
    of_steps = {name: draw(jnp.arange(steps), n) for name, n in IN_A_STEP._asdict().items()}
    before = {"first_reset": BEFORE_RESET, "first_action": BEFORE_START}
    return reference.Words(**of_steps, **{name: draw(jnp.int32(0), n) for name, n in before.items()})


def task_of(env):
    s, a = jnp.arange(env.num_states), jnp.arange(env.num_actions)
    prob, out = jax.jit(jax.vmap(jax.vmap(env.outcomes, (None, 0)), (0, None)))(s, a)
    columns = [np.broadcast_to(x, prob.shape).tolist() for x in (prob, *out)]
    table = [[list(zip(*(x[i][j] for x in columns), strict=True)) for j in a.tolist()] for i in s.tolist()]
    return reference.Task(table, np.asarray(env.initial()), env.max_steps)


def random_mdp():
    """Five states, the last one terminal, three actions, random start, and a time limit that is often met."""
    rand = np.random.default_rng(0)
    p = rand.dirichlet(np.ones(5), (5, 3))
    r = rand.integers(-4, 5, (5, 3, 5)) / 4
    return rl.FiniteMDP(p, r, terminal=[4], start=[0.25, 0.25, 0.25, 0.25, 0.0], max_steps=5)


ENVS = {
    "windy, stochastic, king": lambda: rl.WindyGridworld(moves="king", stochastic=True, max_steps=40),
    "cliff": lambda: rl.CliffWalking(max_steps=100),
    "random mdp": random_mdp,
}


@cache
def env_and_task(name):
    """One of ENVS, and the same for a plain loop."""
    env = ENVS[name]()
    return env, task_of(env)


GAMMAS = (0.0, 0.5, 0.9, 1.0)


def initial_tables(env):
    """Q0 for each of GAMMAS, [4, S, A]: 0.5 everywhere, so that there are ties.

    Where gamma q is rounded, what ties in one order of operations differs in another: there all entries start
    apart.
    """
    q0 = np.full((len(GAMMAS), env.num_states, env.num_actions), 0.5, np.float32)
    q0[GAMMAS.index(0.9)] = np.random.default_rng(2).normal(size=q0.shape[1:])
    return q0


@pytest.mark.parametrize(
    ("name", "env_name"),
    [*(("sarsa", name) for name in ENVS), ("q-learning", "random mdp"), ("expected-sarsa", "random mdp")],
)
def test_every_step_agrees_with_the_plain_loop(name, env_name):
    env, task = env_and_task(env_name)
    alphas, gammas, q0 = jnp.array([0.5, 0.25, 0.5, 0.125]), jnp.array(GAMMAS), initial_tables(env)
    keys = jax.random.split(jax.random.key(7), 4)

    def run(key, alpha, gamma, q0):
        method = rl.ALGORITHMS[name](alpha=alpha, epsilon=0.25, gamma=gamma, q0=q0)
        return rl.train(key, method, env, num_steps=STEPS, log_every=STEPS)

    state, log = jax.jit(jax.vmap(run))(keys, alphas, gammas, q0)
    episodes = 0
    for i in range(4):
        rates = reference.Rates(lambda *_, i=i: float(alphas[i]), lambda *_: 0.25)
        q, _, finished = reference.td_control(
            name,
            task,
            env.num_actions,
            rates,
            float(gammas[i]),
            STEPS,
            words_of(keys[i]),
            q0=q0[i],
        )
        # Sums of products may be rounded otherwise, in another order or as one operation.
        tolerance = 0 if GAMMAS[i] != 0.9 and name != "expected-sarsa" else 1e-4
        np.testing.assert_allclose(state.q[i], q, atol=tolerance, rtol=tolerance)
        assert log.episodes[i, 0] == len(finished)
        assert log.lengths[i, 0] == sum(n for _, n in finished)
        np.testing.assert_allclose(log.returns[i, 0], sum(g for g, _ in finished), rtol=1e-4, atol=1e-4)
        episodes += len(finished)
    assert episodes > 0


CLOCKS = {
    "step": lambda t, k, n: t,
    "episode": lambda t, k, n: k,
    "visit": lambda t, k, n: n,
}


@pytest.mark.parametrize(
    ("name", "clock"), [*(("sarsa", clock) for clock in CLOCKS), ("q-learning", "visit")]
)
def test_schedules_tick_where_the_plain_loop_ticks(name, clock):
    env, task = env_and_task("random mdp")
    method = rl.ALGORITHMS[name](
        alpha=Optax(lambda count: 0.5 ** (1 + count % 3), clock=clock), epsilon=Power(clock=clock)
    )
    key = jax.random.key(3)
    run = jax.jit(lambda key: rl.train(key, method, env, num_steps=STEPS, log_every=STEPS))
    state, _ = run(key)
    count = CLOCKS[clock]
    rates = reference.Rates(
        lambda *now: 0.5 ** (1 + (count(*now) - 1) % 3), lambda *now: np.float32(1) / np.float32(count(*now))
    )
    q, visits, _ = reference.td_control(name, task, 3, rates, 1.0, STEPS, words_of(key))
    np.testing.assert_array_equal(state.q, q)
    assert visits.sum() == STEPS
    if clock == "visit":
        np.testing.assert_array_equal(state.clock.visits, visits)
