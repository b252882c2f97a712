"""Exact means exact: random tasks in which the rewards of each state are of a size of their own, against rational

numbers; and the same inside a program in float32.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.engine.traced import _restored, in_full
from jaxrl_tab.exact.values import iterate_policies

S, A = 6, 2
GAMMAS = 0.0, 0.5, 0.9, 0.99, 1.0
SUM = np.vectorize(Fraction)


def task(seed, gamma):
    """p [S, A, S'] and r [S, A]: rewards of 1e-6 to 1e15, and states that cannot be reached from state 0.

    At gamma = 1 the last state is the end, action 0 goes on in its direction, and every step costs.
    """
    rng = np.random.default_rng(seed)
    size, ends = 10.0 ** rng.integers(-6, 16, S), gamma == 1
    p, r = np.zeros((S, A, S)), size[:, None] * rng.integers(-9, 10, (S, A)) / 8
    for s in range(S):
        for a in range(A):
            first = rng.integers(s + 1, S) if ends and a == 0 and s < S - 1 else rng.integers(S)
            other = rng.choice(np.delete(np.arange(S), first))
            p[s, a, [first, other]] = rng.choice([0.25, 0.5, 0.75]), 0
            p[s, a, other] = 1 - p[s, a, first]
    if ends:
        p[-1], r = np.eye(S)[-1], -abs(r) - size[:, None] / 8
        r[-1] = 0
    return p, r


def environment(p, r, gamma):
    return rl.FiniteMDP(p, r, terminal=[S - 1] if gamma == 1 else ())


def values(p, r, probs, gamma):
    """v of a policy by Gauss and Jordan, in rational numbers, [S]."""
    weight = SUM(probs)[:, :, None] * SUM(p)
    m = SUM(np.eye(S, dtype=int)) - Fraction(gamma) * weight.sum(1)
    m = np.column_stack([m, (SUM(probs) * SUM(r)).sum(1)])
    if gamma == 1:
        m[-1] = SUM(np.eye(S + 1, dtype=int)[S - 1])
    for k in range(S):
        row = next(i for i in range(k, S) if m[i, k])
        m[[k, row]] = m[[row, k]]
        m[k] = m[k] / m[k, k]
        for i in range(S):
            if i != k:
                m[i] = m[i] - m[i, k] * m[k]
    return m[:, -1]


def optimal(p, r, gamma):
    """v* and q*, by policy iteration in rational numbers."""
    policy = np.zeros(S, int)
    while True:
        v = values(p, r, np.eye(A, dtype=int)[policy], gamma)
        q = SUM(r) + Fraction(gamma) * (SUM(p) * v).sum(-1)
        better = q.max(1) > q[np.arange(S), policy]
        if not better.any():
            return v, q
        policy = np.where(better, q.argmax(1), policy)


def check(got, want, least=0.0):
    """Within 1e-11 of itself, in every state, or within `least`."""
    for x, y in zip(np.ravel(got), np.ravel(want), strict=True):
        assert abs(Fraction(float(x)) - y) <= max(abs(y) * Fraction(1, 10**11), Fraction(least)), (got, want)


@pytest.mark.parametrize("gamma", GAMMAS)
def test_planning_agrees_with_rational_numbers_in_every_state(gamma):
    """Broken once -> fails: rounding judged in policy iteration by the largest value anywhere."""
    for seed in range(12):
        p, r = task(seed, gamma)
        env = environment(p, r, gamma)
        v, q = optimal(p, r, gamma)
        found_v, found_q = planning.value_iteration(env, gamma, tol=1e-10)
        check(found_v, v, least=1.0001e-10)
        check(found_q, q, least=1.0001e-10)
        probs, best_v, best_q = planning.policy_iteration(env, gamma)
        check(best_v, v)
        check(best_q, q)
        check(values(p, r, probs, gamma), v)
        soft, soft_v, _ = planning.epsilon_soft(env, 0.25, gamma)
        check(soft_v, values(p, r, soft, gamma))
        mixed = soft / 2 + probs / 2
        check(planning.evaluate(env, mixed, gamma), values(p, r, mixed, gamma))


@pytest.mark.slow
def test_what_a_program_in_float32_measures_agrees_with_rational_numbers():
    """Alone and in a batch, to the last bit. Broken once -> fails: float32 throughout."""

    def measured(full, env, q):
        with planning.doubled():
            exact_env, gamma = _restored(full, env)
        return planning.measurer(exact_env, gamma)(q)

    cases = [(gamma, *task(seed, gamma)) for seed in range(8) for gamma in GAMMAS]
    envs = [environment(p, r, gamma) for gamma, p, r in cases]
    assert jnp.zeros(()).dtype == jnp.float32
    rng = np.random.default_rng(0)
    qs = rng.integers(0, 2, (len(cases), S, A)).astype(np.float32)
    stack = lambda trees: jax.tree.map(lambda *x: np.stack(x), *trees)
    pairs = [(env, gamma) for env, gamma in zip(envs, (c[0] for c in cases), strict=True)]
    args = stack([in_full(pair) for pair in pairs]), stack(pairs), qs
    value, error = jax.jit(jax.vmap(measured))(*args)
    one = jax.jit(measured)
    for i, (gamma, p, r) in enumerate(cases):
        greedy, q = planning.greedy_policy(qs[i]), optimal(p, r, gamma)[1]
        if np.isfinite(value[i]):
            want = float(values(p, r, greedy, gamma)[0])
            scale = float(values(p, abs(r), greedy, gamma)[0])
            assert value[i] == pytest.approx(want, rel=1e-6, abs=1e-12 * scale)
        reached = planning.reachable(planning.exact_model(envs[i]))
        reached[-1] &= gamma < 1
        want = float(abs(SUM(qs[i][reached].astype(float)) - q[reached]).max())
        assert error[i] == pytest.approx(want, rel=1e-6)
    for i in (0, 17):
        alone = one(*jax.tree.map(lambda x, i=i: x[i], args))
        assert tuple(map(float, alone)) == (value[i], error[i])


# --- one state that is very bad ----------------------------------------------------------------------


def ring(big):
    """Four states: stay for 1, or go on, for 10 from the last; the fifth cannot be reached and pays -big."""
    p, r = np.zeros((5, 2, 5)), np.zeros((5, 2))
    for s in range(4):
        p[s, 0, s] = p[s, 1, (s + 1) % 4] = 1
        r[s] = 1, 10 * (s == 3)
    p[4, :, 4], r[4] = 1, -big
    return rl.FiniteMDP(p, r)


AROUND = 10 / (1 - 0.99**4) * 0.99 ** np.array([3, 2, 1, 0])  # 246.2438, 248.7312, 251.2436, 253.7814


@pytest.mark.parametrize("big", [0, 1e9, 1e15, -1e15, 1e100])
def test_one_very_bad_state_spoils_no_answer(big):
    env = ring(big)
    np.testing.assert_allclose(planning.value_iteration(env, 0.99)[0][:4], AROUND, rtol=0, atol=1e-10)
    probs, v, _ = planning.policy_iteration(env, 0.99)
    np.testing.assert_array_equal(probs[:4], [[0, 1]] * 4)
    np.testing.assert_allclose(v[:4], AROUND, rtol=1e-13)


def test_sweeps_go_on_until_every_state_is_exact(monkeypatch):
    """From a start that is 1 off. Broken once -> fails: rounding judged by the largest value anywhere."""
    model, found, out = planning.solved(ring(1e15), 0.0, 0.99)
    monkeypatch.setattr(planning, "solved", lambda *_: (model, found._replace(v=found.v - 1), out))
    v, _ = planning.value_iteration(ring(1e15), 0.99)
    np.testing.assert_allclose(v[:4], AROUND, rtol=0, atol=1e-10)


def table(state):
    return {"table": state.q}


@pytest.mark.slow
def test_nor_does_it_inside_a_run_and_gamma_is_that_which_was_given():
    """On two devices, alone, and under x64.

    Broken once -> fails: numbers that are not handed on in full (0.99 in float32 moves the error by 1e-6 of
    itself); states that cannot be reached kept in the model.
    """
    env, method = ring(1e15), rl.QLearning(alpha=0.5, gamma=0.99)
    budget = {"num_steps": 200, "exact": True, "record": table}
    result = rl.sweep(env, rl.QLearning, {"alpha": 0.5, "gamma": [0.5, 0.99]}, num_seeds=130, **budget)
    q = AROUND[:, None] * np.array([[0.99, 1]]) + [1, 0]
    learned = result.log.recorded["table"][1].astype(float)
    np.testing.assert_allclose(result.log.q_error[1], abs(learned[..., :4, :] - q).max((-1, -2)), rtol=1.5e-7)
    for i in (0, 129):
        key = jax.random.fold_in(jax.random.key(0), i)
        log = rl.train(key, method, env, **budget)[1]
        for field in ("q_error", "greedy_value"):
            np.testing.assert_array_equal(getattr(log, field), getattr(result.log, field)[1, i])
    with jax.enable_x64():
        log = rl.train(jax.random.key(0), method, env, **budget)[1]
        error = abs(np.asarray(log.recorded["table"])[:, :4] - q).max((-1, -2))
        np.testing.assert_allclose(log.q_error, error, rtol=1e-13)


@pytest.mark.slow
def test_a_policy_that_dithers_for_long_is_measured_to_the_last_digit_of_float32(windy):
    """-60300.65, by elimination in rational numbers."""
    budget = {"num_steps": 3000, "exact": True, "record": table}
    log = rl.sweep(windy, rl.QLearning, {"alpha": 1.0}, num_seeds=48, **budget).log
    assert log.greedy_value[47, 1] == np.float32(-60300.6496806045)
    for q, value in zip(log.recorded["table"][47], log.greedy_value[47], strict=True):
        want = planning.policy_value(windy, planning.greedy_policy(q))
        assert value == want if np.isinf(want) else value == pytest.approx(want, rel=1e-7)


@pytest.mark.slow
def test_a_problem_that_is_drawn_in_the_run_is_measured_as_it_was_drawn():
    """Some 1000 pulls of each arm: Q is near q* of that problem. Broken once: the numbers of `env` -> fails."""
    env, method = rl.make("k-armed-testbed"), rl.QLearning(alpha=rl.schedules.sample_average(), epsilon=1.0)
    log = rl.sweep(
        env, type(method), vars(method), num_seeds=3, num_steps=10_000, log_every=10_000, exact=True
    ).log
    assert log.q_error.max() < 0.2
    assert len(set(log.greedy_value.ravel())) == 3


# --- shapes ------------------------------------------------------------------------------------------


def test_policies_of_many_tables_are_taken_table_by_table():
    """Broken once: the maximum over the states -> fails."""
    q = np.array([[1, 2], [0, 5]])
    many = np.stack([q, q, -q])[None]
    np.testing.assert_array_equal(planning.greedy_policy(many)[0, 0], [[0, 1], [0, 1]])
    np.testing.assert_array_equal(planning.greedy_policy(many)[0, 2], [[1, 0], [1, 0]])
    np.testing.assert_allclose(
        planning.epsilon_greedy_policy(many, 0.2)[0, 1], [[0.1, 0.9], [0.1, 0.9]], rtol=1e-15
    )
    ds = rl.sweep(ring(0), "sarsa", {"alpha": [0.1, 0.5]}, num_seeds=2, num_steps=200).to_xarray()
    probs = planning.greedy_policy(ds.q)
    assert probs.shape == (2, 2, 5, 2)
    np.testing.assert_array_equal(probs[1, 0], planning.greedy_policy(ds.q.values[1, 0]))


@pytest.mark.parametrize(
    ("q", "message"),
    [
        ([1.0, 2.0], r"q must be action values \[S, A\] or \[..., S, A\], not of shape \(2,\)"),
        ([["a"]], "q must be numbers"),
        ([[1.0, np.nan]], r"q\[0, 1\] is not a number"),
    ],
)
def test_what_is_no_table_is_refused(q, message):
    for policy in (planning.greedy_policy, lambda q: planning.epsilon_greedy_policy(q, 0.1)):
        with pytest.raises(rl.InputError, match=message):
            policy(q)


@pytest.mark.parametrize("forever", [-1e9, 1e9, 1e-3])
def test_at_gamma_1_what_cannot_be_reached_need_not_be_finite(forever):
    """Three states before the end, 3, to which action 1 leads for -1 a state; action 0 waits for -2. State 4 cannot

    be reached and pays for ever. Broken once: refused, as where a state that can be reached is so -> fails.
    """
    p, r = np.zeros((5, 2, 5)), np.zeros((5, 2))
    for s in range(3):
        p[s, 0, s] = p[s, 1, s + 1] = 1
        r[s] = -2, -1
    p[3, :, 3] = p[4, :, 4] = 1
    r[4] = forever
    env = rl.FiniteMDP(p, r, terminal=[3])
    v, q = planning.value_iteration(env)
    np.testing.assert_array_equal(v, [-3, -2, -1, 0, np.nan])
    np.testing.assert_array_equal(q[:4], [[-5, -3], [-4, -2], [-3, -1], [0, 0]])
    probs, v, _ = planning.policy_iteration(env)
    np.testing.assert_array_equal(probs[:3], [[0, 1]] * 3)
    np.testing.assert_array_equal(v, [-3, -2, -1, 0, np.nan])
    _, v, _ = planning.epsilon_soft(
        env, 0.5
    )  # each state is left in three of four steps: 4/3 steps, 1/3 at -2
    np.testing.assert_allclose(v[:4], np.array([3, 2, 1, 0]) * -(1 + 2 / 3), rtol=1e-12)
    p[0, 0] = np.eye(5)[4]
    with pytest.raises(rl.InputError, match="from state 4 no policy ever ends"):
        planning.value_iteration(rl.FiniteMDP(p, r, terminal=[3]))


# --- long corridors ----------------------------------------------------------------------------------


def test_a_long_corridor_is_solved_at_once():
    """30 001 states with one action, and with two: free moves, 1 at the right end. (With a breadth-first search

    taken round by round, or sweeps from 0, each of them would take minutes.)
    """
    n = 30_001
    walk = rl.RandomWalk(states=n)
    want = np.r_[0, 2 * np.arange(1, n + 1) / (n + 1) - 1, 0]
    np.testing.assert_allclose(planning.value_iteration(walk)[0], want, atol=1e-10)
    s = np.arange(n)[:, None]
    moves = np.concatenate([np.maximum(s - 1, 0), np.minimum(s + 1, n - 1)], 1)
    model = planning.Model(
        np.ones((n, 2, 1)),
        np.where(s == n - 1, s, moves)[..., None].astype(np.int32),
        ((moves == n - 1) & (s < n - 1))[..., None].astype(float),
        (moves == n - 1)[..., None] | (s == n - 1)[..., None],
        np.eye(1, n)[0],
    )
    found = iterate_policies(model, 0.0, 1.0)
    assert found.n < 5
    np.testing.assert_allclose(found.v, [1] * (n - 1) + [0], rtol=1e-12)
