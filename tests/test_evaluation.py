"""What a log says: beside plain loops, all that can happen in a small task, and the book's examples."""

import itertools

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import evaluation, planning
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import FiniteMDP

STATES, ACTIONS, END = 3, 2, 2
PI = np.array([[0.8, 0.2], [0.3, 0.7], [0.5, 0.5]])
B = np.array([[0.5, 0.5], [0.6, 0.4], [0.5, 0.5]])
Q = np.array([[1.0, -0.5], [0.3, 2.0], [0, 0]])


def task():
    p = np.array([[[0.3, 0.5, 0.2], [0.1, 0.2, 0.7]], [[0.4, 0.2, 0.4], [0, 0.1, 0.9]], [[0, 0, 1]] * 2])
    r = np.array([[[1.0, 0, 2], [0, -1, 1]], [[0.5, 1, 0], [0, 2, -1]], [[0, 0, 0]] * 2])
    return p, r, FiniteMDP(p, r, terminal=[END], start=0)


@pytest.fixture(scope="module")
def log():
    return rl.collect(jax.random.key(0), B, task()[2], num_steps=400)


def episodes(log):
    """Of each episode its (s, a, r), step by step, and the state that it was cut short in, or None."""
    found, now = [], []
    for s, a, r, s_next, terminal, last in zip(
        *(np.asarray(getattr(log, name)) for name in ("s", "a", "r", "s_next", "terminal", "last")),
        strict=True,
    ):
        now.append((int(s), int(a), float(r)))
        if last:
            found.append((now, None if terminal else int(s_next)))
            now = []
    return found


def ratios(steps):
    return np.cumprod([PI[s, a] / B[s, a] for s, a, _ in steps])


# --- another policy than the one that acted ----------------------------------------------------------


def test_importance_sampling_is_that_of_plain_loops(log):
    """Broken once, each -> fails: ratios of the step alone; gamma from the second step on."""
    gamma, whole, weight, by_step = 0.9, [], [], []
    for steps, _ in episodes(log):
        rho = ratios(steps)
        g = [gamma**t * r for t, (_, _, r) in enumerate(steps)]
        whole.append(rho[-1] * sum(g))
        weight.append(rho[-1])
        by_step.append(sum(rho * g))
    longest = max(len(steps) for steps, _ in episodes(log))
    per_weighted = 0.0
    for t in range(longest):
        over = under = 0.0
        for steps, _ in episodes(log):
            rho = ratios(steps)
            under += rho[min(t, len(steps) - 1)]
            over += rho[t] * gamma**t * steps[t][2] if t < len(steps) else 0
        per_weighted += over / under
    n = len(whole)
    expected = {
        (False, False): np.mean(whole),
        (True, False): sum(whole) / sum(weight),
        (False, True): np.mean(by_step),
        (True, True): per_weighted,
    }
    for (weighted, per_decision), value in expected.items():
        found = evaluation.importance_sampling(
            log, PI, B, gamma, weighted=weighted, per_decision=per_decision
        )
        assert found.value == pytest.approx(value), (weighted, per_decision)
        assert found.episodes == n and found.low < found.value < found.high
    plain = evaluation.importance_sampling(log, PI, B, gamma)
    assert plain.standard_error == pytest.approx(np.std(whole, ddof=1) / np.sqrt(n))
    by_hand = np.array(whole) - np.array(weight) * expected[True, False]
    linear = evaluation.importance_sampling(log, PI, B, gamma, weighted=True).standard_error
    assert linear == pytest.approx(np.std(by_hand, ddof=1) / np.mean(weight) / np.sqrt(n))


def recursive(steps, cut, q, gamma):
    """Equation 10 of Jiang and Li, from the end of an episode on."""
    v = (PI * q).sum(1)
    value = 0.0 if cut is None else v[cut]
    for s, a, r in reversed(steps):
        value = v[s] + PI[s, a] / B[s, a] * (r + gamma * value - q[s, a])
    return value


def test_doubly_robust_is_the_recursion_of_its_paper(log):
    """Broken once, each -> fails: no value where an episode was cut short; v weighted by the ratio of its own step."""
    n = 20 + int(np.argmin(np.asarray(log.terminal)[20:])) + 1  # the last of its episodes has not ended
    first = {
        name: np.asarray(getattr(log, name))[:n] for name in ("s", "a", "r", "s_next", "terminal", "last")
    }
    short = rl.Experience(**first | {"last": first["last"] | (np.arange(n) == n - 1)})
    for some in (log, short):
        expected = np.mean([recursive(steps, cut, Q, 0.9) for steps, cut in episodes(some)])
        assert evaluation.doubly_robust(some, PI, B, 0.9, q=Q).value == pytest.approx(expected)
    zero = evaluation.doubly_robust(log, PI, B, q=np.zeros((STATES, ACTIONS)))
    assert zero.value == pytest.approx(evaluation.importance_sampling(log, PI, B, per_decision=True).value)
    weighted = evaluation.doubly_robust(log, PI, B, q=np.zeros((STATES, ACTIONS)), weighted=True)
    both = evaluation.importance_sampling(log, PI, B, per_decision=True, weighted=True)
    assert weighted.value == pytest.approx(both.value)


def test_weighted_doubly_robust_is_the_sum_of_its_paper(log):
    """Equation 8 of Thomas and Brunskill, with states after the end whose values are 0."""
    gamma, v, all_of_it = 0.9, (PI * Q).sum(1), episodes(log)
    n, longest, value = len(all_of_it), max(len(steps) for steps, _ in all_of_it), 0.0
    at = lambda rho, t: 1.0 if t < 0 else rho[min(t, len(rho) - 1)]
    every = [ratios(steps) for steps, _ in all_of_it]
    for t in range(longest + 1):
        now, before = (sum(at(rho, t - k) for rho in every) for k in (0, 1))
        for (steps, cut), rho in zip(all_of_it, every, strict=True):
            if t < len(steps):
                s, a, r = steps[t]
                value += gamma**t * (at(rho, t) / now * (r - Q[s, a]) + at(rho, t - 1) / before * v[s])
            elif t == len(steps) and cut is not None:
                value += gamma**t * at(rho, t - 1) / before * v[cut]
    assert n > 50
    assert evaluation.doubly_robust(log, PI, B, gamma, q=Q, weighted=True).value == pytest.approx(value)


def test_doubly_robust_is_unbiased_whatever_the_guess_is():
    """Over all that can happen in two steps, each as often as it does. Broken once: no ratio before v -> fails."""
    goes, r = (
        np.array([[0.3, 0.7], [0.8, 0.2]]),
        np.array([[1.0, 2], [0, -1], [3, 0.5]]),
    )  # from 0 to 1 or 2, then 3
    pi = np.array([[0.9, 0.1], [0.2, 0.8], [0.6, 0.4], [0.5, 0.5]])
    b = np.full((4, 2), 0.5)
    right = np.vstack([r[:1] + goes @ (pi[1:3] * r[1:]).sum(1), r[1:], [[0, 0]]])
    guesses = {"right": right, "wrong": np.array([[0.0, 1], [-2, 1], [5, 0], [0, 0]])}
    moments = dict.fromkeys(guesses, np.zeros(2))
    for a, s, a_next in itertools.product((0, 1), (1, 2), (0, 1)):
        one = rl.Experience([0, s], [a, a_next], [r[0, a], r[s, a_next]], [s, 3], [False, True])
        for name, q in guesses.items():
            value = evaluation.doubly_robust(one, pi, b, q=q).value
            moments[name] = moments[name] + 0.25 * goes[a, s - 1] * np.array([value, value**2])
    true = (pi[0] * right[0]).sum()
    assert moments["wrong"][0] == pytest.approx(true) and moments["right"][0] == pytest.approx(true)
    assert moments["right"][1] < moments["wrong"][1]


def test_a_log_of_another_policy_gives_the_value_of_this_one():
    """4 standard errors; the guess of `lstdq` makes them smaller than those of the ratios alone."""
    env = task()[2]
    log = rl.collect(jax.random.key(1), B, env, num_steps=20_000)
    true = planning.policy_value(env, PI)
    for weighted in (False, True):
        found = evaluation.doubly_robust(log, PI, B, weighted=weighted)
        assert abs(found.value - true) < 4 * found.standard_error
        sampled = evaluation.importance_sampling(log, PI, B, weighted=weighted)
        assert abs(sampled.value - true) < 4 * sampled.standard_error
        assert found.standard_error < 0.85 * sampled.standard_error
    np.testing.assert_allclose(
        evaluation.lstdq(log, PI),
        planning.backup(planning.exact_model(env), planning.evaluate(env, PI), 1.0),
        atol=0.1,
    )


# --- from steps alone --------------------------------------------------------------------------------


def batch_td(log, num_states, gamma, lam, sweeps, alpha):
    """TD(lambda) with increments added up over the whole log, again and again."""
    v = np.zeros(num_states)
    for _ in range(sweeps):
        change = np.zeros(num_states)
        for steps, cut in episodes(log):
            z = np.zeros(num_states)
            states = [s for s, _, _ in steps] + [END if cut is None else cut]
            for t, (s, _, r) in enumerate(steps):
                z *= gamma * lam
                z[s] += 1
                over = t == len(steps) - 1 and cut is None
                change += z * (r + (0 if over else gamma * v[states[t + 1]]) - v[s])
        v += alpha * change
    return v


@pytest.mark.parametrize("lam", [0.0, 0.5, 1.0])
def test_batch_td_comes_to_lstd(lam):
    """Broken once, each -> fails: no trace; the trace kept over the end of an episode."""
    log = rl.collect(jax.random.key(2), B, task()[2], num_steps=40)
    v = evaluation.lstd(log, STATES, 0.9, lam)
    np.testing.assert_allclose(v, batch_td(log, STATES, 0.9, lam, 600, 0.02), atol=1e-9)


def test_lstd_is_the_certainty_equivalence_estimate_or_the_mean_return(log):
    whole = np.asarray(log.last).nonzero()[0][-2] + 1  # without the episode that was cut short
    log = rl.Experience(
        *(getattr(log, name)[:whole] for name in ("s", "a", "r", "s_next", "terminal", "last"))
    )
    count, reward = np.zeros((STATES, STATES)), np.zeros(STATES)
    returns = [[], []]
    for steps, _ in episodes(log):
        states = [s for s, _, _ in steps] + [END]
        for t, (s, _, r) in enumerate(steps):
            count[s, states[t + 1]] += 1
            reward[s] += r
            returns[s].append(sum(r for _, _, r in steps[t:]))
    likely = count[:2] / count[:2].sum(1, keepdims=True)
    certain = np.linalg.solve(np.eye(2) - likely[:, :2], reward[:2] / count[:2].sum(1))
    np.testing.assert_allclose(evaluation.lstd(log, STATES), np.append(certain, 0))
    np.testing.assert_allclose(
        evaluation.lstd(log, STATES, lam=1.0), np.array([np.mean(returns[0]), np.mean(returns[1]), 0])
    )


def predictor():
    """The book's example 6.4: A, 0, B, 0 once; B, 1 six times; B, 0 once."""
    one = lambda states, rewards: (states, [0] * len(rewards), rewards)
    return rl.Experience.from_episodes(
        [one([0, 1, END], [0, 0]), *[one([1, END], [1])] * 6, one([1, END], [0])]
    )


def test_you_are_the_predictor():
    """Book, example 6.4: V(B) is 3/4; V(A) is 3/4 by batch TD, and 0 by batch Monte Carlo."""
    np.testing.assert_allclose(evaluation.lstd(predictor(), STATES), [0.75, 0.75, 0])
    np.testing.assert_allclose(evaluation.lstd(predictor(), STATES, lam=1.0), [0, 0.75, 0], atol=1e-12)


def test_lstdq_is_that_of_the_task_that_the_log_makes_most_likely(log):
    """Broken once: sums of rewards instead of means -> fails."""
    count, reward = np.zeros((STATES, ACTIONS, STATES)), np.zeros((STATES, ACTIONS))
    for s, a, r, s_next in zip(log.s, log.a, log.r, log.s_next, strict=True):
        count[s, a, s_next] += 1
        reward[s, a] += r
    p, r = count / np.maximum(count.sum(2, keepdims=True), 1), reward / np.maximum(count.sum(2), 1)
    p[END], r[END] = np.eye(STATES)[END], 0
    likely = FiniteMDP(p, r, terminal=[END], start=0)
    v = planning.evaluate(likely, PI, 0.9)
    expected = planning.backup(planning.exact_model(likely), v, 0.9)
    np.testing.assert_allclose(evaluation.lstdq(log, PI, 0.9), expected, atol=1e-10)


def test_what_a_log_does_not_hold():
    one = rl.Experience([0, 1], [0, 0], [1.0, 2.0], [1, 2], [False, False], [False, True])
    np.testing.assert_array_equal(evaluation.lstd(one, 4), [3, 2, np.nan, np.nan])
    np.testing.assert_array_equal(evaluation.lstdq(one, np.ones((4, 1)))[:, 0], [3, 2, np.nan, np.nan])
    ring = rl.Experience([0, 1], [0, 0], [1.0, 2.0], [1, 0], [False, False])
    with pytest.raises(InputError, match="the log never comes to an end"):
        evaluation.lstd(ring, 2)
    np.testing.assert_allclose(evaluation.lstd(ring, 2, 0.5), [8 / 3, 10 / 3])


def test_what_is_no_log_of_such_a_policy_is_refused(log):
    with pytest.raises(InputError, match="q must be finite action values"):
        evaluation.doubly_robust(log, PI, B, q=Q[:2])
    with pytest.raises(InputError, match="the task has states 0 to 1"):
        evaluation.lstd(log, 2)
    with pytest.raises(InputError, match="takes action 1 in state 0, which the behaviour policy never does"):
        evaluation.importance_sampling(log, np.eye(2)[[0, 0, 0]], np.array([[1, 0], [0.5, 0.5], [1, 0]]))
    with pytest.raises(InputError, match="gamma must be between 0 and 1"):
        evaluation.doubly_robust(log, PI, B, gamma=2)
    assert str(evaluation.doubly_robust(log, PI, B)).endswith("episodes")
