"""Least-squares policy iteration, from a log and online: on the chains of its authors, and against plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_approx import KEY, steps

import jaxrl_tab as rl
from jaxrl_tab import approx, planning
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.types import Transition, fitted, init_learner

GAMMA = 0.9


def chain(states, paying):
    """Left and right, each of which succeeds nine times in ten and else does the other; some states pay 1."""
    prob = np.zeros((states, 2, states))
    for s in range(states):
        for a, step in enumerate((-1, 1)):
            for move, p in ((step, 0.9), (-step, 0.1)):
                prob[s, a, min(max(s + move, 0), states - 1)] += p
    reward = np.zeros((states, 2))
    reward[paying] = 1
    return rl.envs.FiniteMDP(prob, reward, max_steps=10_000)


def ten_of_each(env):
    """A log in which each pair has its outcomes exactly as often as they are probable, of ten."""
    model = planning.exact_model(env)
    available = np.ones(model.prob.shape[:2], bool) if model.available is None else model.available
    steps = []
    for s, a, k in np.argwhere((model.prob > 0) & available[:, :, None]):
        count = round(10 * model.prob[s, a, k])
        steps += [(s, a, model.reward[s, a, k], model.s_next[s, a, k], model.terminal[s, a, k])] * count
    return Experience(*map(np.array, zip(*steps, strict=True)), last=True)


@pytest.mark.parametrize(("states", "paying"), [(4, [1, 2]), (20, [0, 19])])
def test_with_a_table_it_is_policy_iteration(states, paying):
    """In closed form: such a log says the task itself. Broken once: the discount left out at S' -> fails."""
    env = chain(states, paying)
    found = approx.lspi(ten_of_each(env), env, gamma=GAMMA)
    _, q = planning.value_iteration(env, gamma=GAMMA)
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    assert found.is_settled
    toward = 1 - found.policy.argmax(1)  # 1 where it goes left
    assert toward.tolist() == {4: [0, 0, 1, 1], 20: [1] * 10 + [0] * 10}[states]


def test_with_few_features_it_finds_the_best_policy_of_the_long_chain():
    """As its authors did: polynomials of degree 4, and 5000 steps of somebody who takes any action (section 9.1)."""
    env, rand = chain(20, [0, 19]), np.random.default_rng(0)
    s, steps = 10, []
    for _ in range(5000):
        a = rand.integers(2)
        step = (1 if a else -1) * (1 if rand.random() < 0.9 else -1)
        s_next = min(max(s + step, 0), 19)
        steps.append((s, a, float(s in (0, 19)), s_next))
        s = s_next
    s, a, r, s_next = map(np.array, zip(*steps, strict=True))
    log = Experience(s, a, r, s_next, np.zeros(len(s), bool))
    found = approx.lspi(log, env, "polynomial(4)", gamma=GAMMA)
    assert found.is_settled
    assert found.rounds < 12
    assert (found.policy.argmax(1) == [0] * 10 + [1] * 10).all()
    x = (np.arange(20) / 19)[:, None] ** np.arange(5)
    features = lambda s, a: np.concatenate([x[s] * (a == 0), x[s] * (a == 1)])
    system, constant = np.zeros((10, 10)), np.zeros(10)
    for s0, a0, reward, s1 in steps:
        after = sum(found.policy[s1, k] * features(s1, k) for k in range(2))
        system += np.outer(features(s0, a0), features(s0, a0) - GAMMA * after)
        constant += reward * features(s0, a0)
    np.testing.assert_allclose(system @ found.w.T.ravel(), constant, atol=1e-6)


def test_an_action_that_a_state_does_not_have_is_none_of_its_best():
    """And an end is worth nothing: the gambler's values, exactly."""
    env = rl.make("gamblers-problem", goal=6)
    found = approx.lspi(ten_of_each(env), env, gamma=1.0)
    _, q = planning.value_iteration(env)
    available = np.asarray(planning.exact_model(env).available)
    played = available & ~np.isin(np.arange(7), (0, 6))[:, None]
    np.testing.assert_allclose(found.q[played], q[played], atol=1e-6)
    assert found.is_settled
    assert (found.policy[~available] == 0).all()


# --- online ----------------------------------------------------------------------------------------------


def test_online_it_learns_what_a_plain_loop_learns():
    """The weights after each of 200 transitions, in float64: the policy of its time is in A, and is improved by sevens.

    Broken once: at S' an action that is not the greedy one; ties that the first one gets; b that begins
    with 0 -> each fails.
    """
    env, transitions, gamma = rl.WindyGridworld(), steps(200), 0.9
    with jax.enable_x64():
        method = approx.LSPI(features="tile-coding(2, 2)", gamma=gamma, ridge=0.5, every=7, q0=0.25)
        method = fitted(method, env)
        arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))

        def one(state, t):
            state = method.update(KEY, state, t)[0]
            return state, state.q

        learned = jax.jit(lambda steps: jax.lax.scan(one, init_learner(method, env), steps)[1])
        found, x = np.asarray(learned(arrays)), method.features.matrix
    n = x.shape[1]
    w = np.full((n, 4), 0.25 / 2)
    a, b = 0.5 * np.eye(4 * n), 0.5 * w.ravel()
    of = lambda s, actions: np.outer(x[s], actions).ravel()
    for i, ((s, action, r, s_next, discount, _), q) in enumerate(zip(transitions, found, strict=True)):
        best = x[s_next] @ w == (x[s_next] @ w).max()
        now = of(s, np.eye(4)[action])
        a += np.outer(now, now - discount * of(s_next, best / best.sum()))
        b += r * now
        if i % 7 == 6:
            w = np.linalg.solve(a, b).reshape(n, 4)
        np.testing.assert_allclose(q, w, rtol=1e-7, atol=1e-9)


def test_online_it_comes_to_the_optimum():
    """With a table, of the chain of four: as near as the states were seen, and to the best policy."""
    env = chain(4, [1, 2])
    state, _ = rl.train(KEY, approx.LSPI(gamma=GAMMA, epsilon=0.5), env, num_steps=20_000, log_every=20_000)
    best = planning.value_iteration(env, gamma=GAMMA)[1]
    np.testing.assert_allclose(state.q, best, rtol=0.02)
    assert state.q.argmax(1).tolist() == [1, 1, 0, 0]


def test_refusals():
    env = chain(4, [1, 2])
    log = ten_of_each(env)
    for message, call in {
        "the states of MountainCar cannot be counted": lambda: approx.lspi(log, rl.MountainCar()),
        "experience must be an Experience, not list": lambda: approx.lspi([], env),
        "features of 3 states were given, and the task has 4": lambda: approx.lspi(log, env, np.eye(3)),
        "gamma": lambda: approx.lspi(log, env, gamma=1.5),
        "the task has states 0 to 1": lambda: approx.lspi(log, chain(2, [0])),
        "most": lambda: approx.lspi(log, env, most=0),
    }.items():
        with pytest.raises(rl.InputError, match=message):
            call()
