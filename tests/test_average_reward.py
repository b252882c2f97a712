"""The average reward: its methods against plain loops, its exact numbers against all policies and long sums."""

import contextlib
import io
import itertools
import re
from pathlib import Path

import jax
import numpy as np
import pytest
import reference
import reference_one_step as plain
from refusals import refused
from test_reference import STEPS, task_of, words_of

import jaxrl_tab as rl
from jaxrl_tab import planning

# Five states without an end, three actions, and a time limit that is met.
RAND = np.random.default_rng(0)
P, PAYS = RAND.dirichlet(np.full(5, 0.5), (5, 3)), RAND.integers(-4, 5, (5, 3, 5)) / 4
R, START = (P * PAYS).sum(2), np.array([0.5, 0.5, 0, 0, 0])
ENV = rl.FiniteMDP(P, PAYS, start=START, max_steps=50)
AROUND = rl.FiniteMDP(np.array([[[0.0, 1]], [[1, 0]]]), np.array([[1.0], [3]]))  # goes round and round
APART = rl.FiniteMDP(np.array([[[1.0, 0]], [[0, 1]]]), np.array([[1.0], [3]]), start=[0.25, 0.75])


def long_sum(policy):
    """The mean reward of very many steps, by squaring the mean of the first steps again and again."""
    chain, mean = np.einsum("sa,sat->st", policy, P), np.eye(len(P))
    for _ in range(40):
        mean, chain = (mean + chain @ mean) / 2, chain @ chain
        chain /= chain.sum(1, keepdims=True)
    return START @ mean @ (policy * R).sum(1)


# --- the methods -------------------------------------------------------------------------------------

METHODS = {
    "r-learning": (rl.RLearning, plain.RLearning, {"beta": 0.125}),
    "differential-q-learning": (rl.DifferentialQLearning, plain.DifferentialQLearning, {"eta": 0.25}),
    "differential-sarsa": (rl.DifferentialSarsa, plain.DifferentialSarsa, {"beta": 0.125}),
}


@pytest.mark.parametrize("name", METHODS)
def test_every_step_agrees_with_the_plain_loop(name):
    """Broken once, each -> fails: the rate not taken off; the rate of R-learning in all steps, or before Q."""
    cls, loop, more = METHODS[name]
    q0 = np.random.default_rng(2).normal(size=(5, 3)).astype(np.float32)
    method = cls(alpha=0.25, epsilon=0.25, q0=q0, **more)
    state, log = rl.train(jax.random.key(7), method, ENV, num_steps=STEPS, log_every=STEPS // 2)
    rates = reference.Rates(lambda *_: 0.25, lambda *_: 0.25)
    agent = loop((5, 3), rates, 1.0, q0, beta=next(iter(more.values())))
    finished = reference.run(agent, task_of(ENV), STEPS, words_of(jax.random.key(7)))
    assert log.episodes.sum() == len(finished) == STEPS // ENV.max_steps
    np.testing.assert_allclose(state.q, agent.q, atol=1e-4)
    np.testing.assert_allclose([state.rate, (log.recorded or {})["rate"][-1]], agent.rate, atol=1e-5)
    assert abs((log.recorded or {})["rate"][0] - agent.rate) > 1e-3  # at the end of each row


@pytest.mark.slow
def test_the_best_rate_is_learned_while_exploring():
    """By the two methods that learn off-policy, with a step size of 1 over the visits: 40 seeds, 4 standard errors."""
    best = planning.relative_value_iteration(ENV)[0]
    grid = {"alpha": "power:0.8:visit", "epsilon": 0.5, "eta": 1.0}
    result = rl.sweep(ENV, "differential-q-learning", grid, num_seeds=40, num_steps=40_000, log_every=40_000)
    rate = (result.log.recorded or {})["rate"][..., -1].ravel()
    assert abs(rate.mean() - best) < 4 * rate.std() / np.sqrt(40) + 2e-3
    assert np.isnan(result.optimal_value)  # for there is no best return


@pytest.mark.parametrize("name", METHODS)
def test_what_is_discounted_and_what_ends_is_refused(name):
    """Broken once: looked at in `sweep` alone -> fails."""
    cls, *_ = METHODS[name]
    refused(lambda: cls(gamma=0.9), f"{cls.__name__}: gamma must be exactly 1, not 0.9")
    for run in (
        lambda: rl.sweep(rl.RandomWalk(), cls, {}, num_seeds=1, num_steps=1),
        lambda: rl.train(jax.random.key(0), cls(), rl.RandomWalk(), num_steps=1),
        lambda: jax.jit(lambda key: rl.train(key, cls(), rl.RandomWalk(), num_steps=1))(jax.random.key(0)),
    ):
        refused(run, f"RandomWalk can end in state 1, and {name} is for tasks that do not end")


# --- exact numbers -----------------------------------------------------------------------------------


def test_relative_value_iteration_finds_the_best_of_all_policies():
    """Of 3^5 in all. Broken once: the mean of h not 0, or a sweep without `STAYING` -> fails."""
    best, h, policy = planning.relative_value_iteration(ENV)
    rates = [long_sum(np.eye(3)[list(actions)]) for actions in itertools.product(range(3), repeat=5)]
    assert best == pytest.approx(max(rates), abs=1e-9)
    assert planning.average_reward(ENV, policy) == pytest.approx(best, abs=1e-9)
    np.testing.assert_allclose(h + best, (R + P @ h).max(1), atol=1e-9)
    assert planning.stationary_distribution(ENV, policy) @ h == pytest.approx(0, abs=1e-9)
    rate, h, _ = planning.relative_value_iteration(AROUND)
    assert rate == pytest.approx(2)
    np.testing.assert_allclose(h, [-0.5, 0.5])


def test_the_average_reward_of_any_policy():
    policy = np.random.default_rng(1).dirichlet(np.ones(3), 5)
    assert planning.average_reward(ENV, policy) == pytest.approx(long_sum(policy), abs=1e-9)
    assert planning.average_reward(APART, np.ones((2, 1))) == pytest.approx(2.5)
    walk, policy = rl.RandomWalk(states=5, left_reward=0), np.ones((7, 1))
    assert planning.average_reward(walk, policy) == pytest.approx(
        0.5 / 9
    )  # 9 steps in an episode, half of a reward


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: planning.relative_value_iteration(rl.RandomWalk()),
            "can end in state 1, and the average reward is",
        ),
        (
            lambda: planning.relative_value_iteration(APART),
            "FiniteMDP: the best rate depends on where it begins: a step in the long run earns 1 from state 0 and 3 "
            "from state 1",
        ),
        (lambda: planning.relative_value_iteration(ENV, max_sweeps=1), "did not converge in 1 sweeps; raise"),
        (lambda: planning.relative_value_iteration(ENV, tol=0), "tol must be greater than 0, not 0"),
    ],
)
def test_what_has_no_answer_is_refused(call, message):
    refused(call, message)


@pytest.mark.slow
def test_exact_values_beside_a_run_are_rates():
    """Of the greedy policy and of the one that acts; and Q - q* but for a constant.

    Broken once: values at gamma = 1, the largest |Q - q*| -> fails.
    """
    method, record = rl.DifferentialSarsa(alpha=0.25, epsilon=0.25), lambda state: {"table": state.q}
    _, log = rl.train(jax.random.key(1), method, ENV, num_steps=300, log_every=100, exact=True, record=record)
    best, h, _ = planning.relative_value_iteration(ENV)
    tables = np.asarray((log.recorded or {})["table"], float)
    far = tables - (R + P @ h - best)
    np.testing.assert_allclose(np.asarray(log.q_error), (far.max((1, 2)) - far.min((1, 2))) / 2, rtol=1e-5)
    rate = lambda policies: [planning.average_reward(ENV, policy) for policy in policies]
    of_greedy, of_acting = (
        rate(planning.greedy_policy(tables)),
        rate(planning.epsilon_greedy_policy(tables, 0.25)),
    )
    np.testing.assert_allclose(
        np.asarray([log.greedy_value, log.policy_value]), [of_greedy, of_acting], atol=2e-7
    )


# --- access control ----------------------------------------------------------------------------------


def test_access_control_is_the_example_of_the_book():
    """By counting the busy servers that become free one by one. Broken once: the new one stays busy -> fails."""
    env = rl.make("access-control", servers=3, free=0.25)
    p, r = plain.array_of(task_of(env).outcomes)
    want, pays = np.zeros_like(p), np.zeros_like(r)
    for free, kind, accept in itertools.product(range(4), range(4), range(2)):
        is_served = accept and free > 0
        busy, s = 3 - free + is_served, 4 * free + kind
        pays[s, accept] = is_served * (1, 2, 4, 8)[kind]
        for coins in itertools.product([False, True], repeat=busy):
            chance = np.prod([0.25 if coin else 0.75 for coin in coins])
            for following in range(4):
                want[s, accept, 4 * (3 - busy + sum(coins)) + following] += chance / 4
    np.testing.assert_allclose(p, want, atol=1e-6)
    np.testing.assert_array_equal(r, pays)
    np.testing.assert_array_equal(env.initial(), [0] * 12 + [0.25] * 4)
    (panel,) = env.panels()
    assert panel.states[2, 3] == 4 * 3 + 2 and panel.rows[2] == "4"
    refused(lambda: rl.AccessControl(priorities=[]), "priorities must be a row of one number or more")


def test_access_control_of_ten_servers():
    rate, _, policy = planning.relative_value_iteration(rl.AccessControl())
    assert rate == pytest.approx(2.747642, abs=1e-6)  # by loops over the states, in NumPy
    accepts = policy[:, 1].reshape(11, 4)[1:].T > 0.5
    np.testing.assert_array_equal(accepts.argmax(1)[1:], [3, 0, 0])  # from 4 free servers on, and from 1
    assert not accepts[0].any()  # whoever pays 1, never


@pytest.mark.slow
def test_the_page_is_true():
    """docs/average-reward.md: what it shows is what its lines print."""
    page = (Path(__file__).parents[1] / "docs/average-reward.md").read_text(encoding="utf-8")
    (code,), (shown,) = (re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL) for kind in ("python", "text"))
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, {})
    assert printed.getvalue() == shown
    for number in ("2.7476", "2.6469"):
        assert number in page
