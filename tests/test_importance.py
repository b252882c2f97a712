"""Importance sampling judged: against enumeration in fractions, plain simulation, and numbers by hand."""

from fractions import Fraction
from itertools import pairwise

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import importance, planning
from jaxrl_tab.algorithms.prediction import OffPolicyMonteCarloPrediction
from jaxrl_tab.core.policies import Table

# --- oracles -----------------------------------------------------------------------------------------


def moments(samples):
    """The variances of rho, rho G and per decision, from (probability, rho, G, per decision) of each path."""
    prob, rho, g, per_decision = zip(*samples, strict=True)
    mean = lambda x: sum(p * y for p, y in zip(prob, x, strict=True))
    assert mean([1] * len(samples)) == 1
    rho_g = [x * y for x, y in zip(rho, g, strict=True)]
    return [mean([y**2 for y in x]) - mean(x) ** 2 for x in (rho, rho_g, per_decision)]


def paths(task, s, gamma, actions=None):
    """All paths from s under b: (probability, rho, G, per decision). With `actions`, for these as given."""
    p, r, pi, b = task
    if s == len(p) - 1:
        return [(1, 1, 0, 0)]
    found = []
    for a in range(len(p[s])) if actions is None else actions:
        chance, rho = (b[s][a], pi[s][a] / b[s][a]) if actions is None else (1, 1)
        for s_next, q in p[s][a].items():
            for prob, ratio, g, x in paths(task, s_next, gamma):
                own = r[s, a, s_next]
                found.append((chance * q * prob, rho * ratio, own + gamma * g, rho * (own + gamma * x)))
    return found


def random_task(seed, num_states=5, num_actions=2):
    """A task without loops, and two policies, in fractions; pi leaves out some actions, b none."""
    rng = np.random.default_rng(seed)

    def distribution(n, least):
        weights = [int(w) for w in rng.integers(least, 6, n)]
        weights[0] += not any(weights)
        return [Fraction(w, sum(weights)) for w in weights]

    p = [
        [dict(enumerate(distribution(num_states - 1 - s, 1), s + 1)) for _ in range(num_actions)]
        for s in range(num_states - 1)
    ]
    p.append([{num_states - 1: Fraction(1)}] * num_actions)
    r = {i: Fraction(int(rng.integers(-3, 4))) for i in np.ndindex(num_states, num_actions, num_states)}
    pi, b = ([distribution(num_actions, least) for _ in range(num_states)] for least in (0, 1))
    return p, r, pi, b


def as_arrays(task):
    p, r, pi, b = task
    shape = len(p), len(p[0]), len(p)
    probabilities, rewards = np.zeros(shape), np.zeros(shape)
    for s, a, s_next in np.ndindex(shape):
        probabilities[s, a, s_next] = p[s][a].get(s_next, 0)
        rewards[s, a, s_next] = r[s, a, s_next]
    env = rl.FiniteMDP(probabilities, rewards, terminal=[len(p) - 1])
    return env, np.array(pi, float), np.array(b, float)


def walk(right, num_states=3, slip=0.1, each=0.0, max_steps=200):
    """Left or right along a walk that starts in the middle, -1 and +1 at its ends; and a policy to the right.

    A step goes the other way with probability `slip`, and gives `each` where it ends nothing. Both ends are
    one terminal state, the last.
    """
    end = num_states
    p, r = np.zeros((2, end + 1, 2, end + 1))
    for s in range(end):
        for a, near, far in ((0, s - 1, s + 1), (1, s + 1, s - 1)):
            for s_next, chance in ((near, 1 - slip), (far, slip)):
                p[s, a, s_next if 0 <= s_next < end else end] += chance
    r[:end] = each
    r[0, :, end], r[end - 1, :, end] = -1, 1
    env = rl.FiniteMDP(p, r, terminal=[end], start=end // 2, max_steps=max_steps)
    return env, np.tile([1 - right, right], (end + 1, 1))


WALK, TO_THE_RIGHT = walk(right=0.7, each=-0.5)
EVENLY = np.full((4, 2), 0.5)
START = 1


@pytest.fixture(scope="module")
def exact():
    return importance.variance(WALK, TO_THE_RIGHT, EVENLY, 0.9)


# --- the exact variance ------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [Fraction(0), Fraction(1, 2), Fraction(1)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_variance_is_that_of_all_paths(seed, gamma):
    """Broken once, each failed: rho for rho^2 in the chain; no covariance; gamma for gamma^2; the own ratio

    counted for a pair (s, a); r' for r.
    """
    task = random_task(seed)
    env, pi, b = as_arrays(task)
    of_states = importance.variance(env, pi, b, float(gamma))
    of_actions = importance.action_variance(env, Table(pi), Table(b), float(gamma))
    for s in range(len(pi)):
        want = np.array(moments(paths(task, s, gamma)), float)
        np.testing.assert_allclose([x[s] for x in of_states], want, rtol=1e-12, atol=1e-12)
        for a in range(len(pi[s])):
            want = np.array(moments(paths(task, s, gamma, actions=[a])), float)
            np.testing.assert_allclose([x[s, a] for x in of_actions], want, rtol=1e-12, atol=1e-12)


def test_the_blackjack_state_of_the_book():
    """GROUND_TRUTH.md: from (13, usable ace, dealer 2), "stick on 20 or 21", random behaviour."""
    env = rl.make("blackjack")
    hit = np.array(
        [total < 20 for _ in (False, True) for total in range(12, 22) for _ in range(10)] + [False]
    )
    exact = importance.variance(env, np.stack([~hit, hit], 1), np.full((201, 2), 0.5))
    s = env.state(13, 2, usable=True)
    assert exact.ordinary[s] == pytest.approx(10.15621, abs=5e-6)
    assert exact.ratio[s] == pytest.approx(9.79059, abs=5e-6)
    assert exact.per_decision[s] == pytest.approx(10.15621, abs=5e-6)  # all reward comes with the last action


def test_variance_of_the_returns_alone_where_both_policies_are_one():
    env, _ = walk(right=0.5)
    exact = importance.variance(env, EVENLY, EVENLY)
    assert (exact.ratio == 0).all()
    win = (planning.evaluate(env, EVENLY)[:-1] + 1) / 2  # +1 or -1
    np.testing.assert_allclose(exact.ordinary, np.append(4 * win * (1 - win), 0))
    np.testing.assert_allclose(exact.per_decision, exact.ordinary)


def test_variance_with_loops_is_that_of_a_plain_simulation(exact):
    """200 000 episodes of the walk, within 4 standard errors."""
    rng, n, gamma = np.random.default_rng(0), 200_000, 0.9
    s, rho, g, x, scale = np.full(n, START), np.ones(n), np.zeros(n), np.zeros(n), 1.0
    going = np.ones(n, bool)
    while going.any():
        a = rng.integers(0, 2, n)
        step = np.where(rng.random(n) < 0.1, 1 - 2 * a, 2 * a - 1)
        rho = np.where(going, rho * np.where(a == 1, 0.7, 0.3) / 0.5, rho)
        s = np.where(going, s + step, s)
        ended = going & ((s < 0) | (s > 2))
        reward = np.where(ended, step, -0.5 * going)
        g += scale * reward
        x += scale * rho * reward
        scale *= gamma
        going &= ~ended
    for sample, want in zip((rho, rho * g, x), exact, strict=True):
        squares = (sample - sample.mean()) ** 2
        assert abs(squares.mean() - want[START]) < 4 * squares.std() / np.sqrt(n)


@pytest.mark.slow
@pytest.mark.parametrize("weighting", ["ordinary", "per-decision"])
def test_the_spread_of_estimates_over_seeds_is_the_exact_variance(weighting, exact):
    """V of the start after 20 episodes has the variance Var / 20: over 1024 seeds, within 4 standard errors.

    Broken once: the ratio of the state's own action left out -> fails; the two weightings exchanged -> fails.
    """
    n, seeds = 20, 1024
    method = OffPolicyMonteCarloPrediction(
        pi=TO_THE_RIGHT, behaviour=EVENLY, gamma=0.9, weighting=weighting, first_visit=True
    )

    def one(key):
        return rl.train(key, method, WALK, num_episodes=n, log_every=n)[0].v[START]

    v = np.asarray(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), seeds)), float)
    want = getattr(exact, weighting.replace("-", "_"))[START] / n
    squares = (v - v.mean()) ** 2
    assert abs(squares.mean() - want) < 4 * squares.std() / np.sqrt(seeds)
    assert abs(v.mean() - planning.evaluate(WALK, TO_THE_RIGHT, 0.9)[START]) < 4 * np.sqrt(want / seeds)


# --- infinite variance -------------------------------------------------------------------------------

LEFT = np.array([[1.0, 0.0], [1.0, 0.0]])
EITHER = np.full((2, 2), 0.5)


@pytest.mark.parametrize(("back", "gamma"), [(0.49, 1.0), (0.4, 1.0), (0.9, 0.74), (0.9, 0.0)])
def test_the_loop_of_the_book_where_it_is_finite(back, gamma):
    """A return of gamma^(k-1) has the ratio 2^k and the probability back^(k-1) (1 - back) / 2^k."""
    exact = importance.variance(rl.InfiniteVariance(back=back), LEFT, EITHER, gamma)
    second = 2 * (1 - back) / (1 - 2 * back * gamma**2)
    assert exact.ordinary[0] == pytest.approx(second - ((1 - back) / (1 - back * gamma)) ** 2, rel=1e-12)
    assert np.isinf(exact.ratio[0]) == (back >= 0.5)
    assert exact.ordinary[1] == exact.ratio[1] == 0


@pytest.mark.parametrize(("back", "gamma"), [(0.9, 1.0), (0.5, 1.0), (0.9, 0.75)])
def test_the_loop_of_the_book_where_it_is_infinite(back, gamma):
    """Broken once: a growth of exactly 1 let pass -> back = 0.5 fails."""
    env = rl.InfiniteVariance(back=back)
    with pytest.warns(UserWarning, match=r"from state 0 the variance of rho G is infinite.*take weighted"):
        exact = importance.variance(env, LEFT, EITHER, gamma)
    assert all(np.isinf(x[0]) and x[1] == 0 for x in exact)
    with pytest.warns(UserWarning, match=r"from \(s, a\) = \(0, 0\) the variance of rho G is infinite"):
        exact = importance.action_variance(env, LEFT, EITHER, gamma)
    assert all(np.isinf(x[0, 0]) and x[0, 1] == 0 for x in exact)


def before_a_loop(on_the_way, at_the_end):
    """State 0 leads into the loop of the book, in state 1, with one reward; the loop ends with another."""
    p = np.zeros((3, 2, 3))
    p[0, 0, 1] = p[0, 1, 2] = p[1, 1, 2] = 1
    p[1, 0, [1, 2]] = 0.9, 0.1
    r = np.zeros((3, 2, 3))
    r[0, 0, 1], r[1, 0, 2] = on_the_way, at_the_end
    return rl.FiniteMDP(p, r, terminal=[2]), np.eye(2)[[0, 0, 0]], np.full((3, 2), 0.5)


def test_an_infinite_ratio_need_not_matter():
    """Broken once: infinite wherever the ratio is -> fails."""
    exact = importance.variance(*before_a_loop(on_the_way=0, at_the_end=0))
    assert np.isinf(exact.ratio[:2]).all()
    np.testing.assert_array_equal(exact.ordinary, 0)
    np.testing.assert_array_equal(exact.per_decision, 0)
    exact = importance.variance(*before_a_loop(on_the_way=0, at_the_end=1), gamma=0.7)
    assert np.isinf(exact.ratio[:2]).all()
    second, mean = 2 * 0.1 / (1 - 2 * 0.9 * 0.49), 0.1 / (1 - 0.9 * 0.7)
    np.testing.assert_allclose(exact.ordinary, [2 * 0.49 * second - 0.49 * mean**2, second - mean**2, 0])


@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0])
def test_a_reward_before_an_infinite_ratio_does_matter_except_per_decision(gamma):
    with pytest.warns(UserWarning, match="from state 0"):
        exact = importance.variance(*before_a_loop(on_the_way=1, at_the_end=0), gamma)
    np.testing.assert_array_equal(exact.ordinary, [np.inf, 0, 0])
    np.testing.assert_array_equal(exact.per_decision, [1, 0, 0])  # 2 or 0, evenly


def test_a_loop_of_many_states_that_grows_by_exactly_one():
    """Seven states in a ring, of which target stays in and behaviour leaves with 0.3; 0.7^-1 per step, and

    the ring holds with 0.7 per step. Just below that, the variance is finite.
    """
    for hold, infinite in ((0.7, True), (0.7 * (1 - 1e-9), False)):
        p = np.zeros((8, 2, 8))
        for s in range(7):
            p[s, 0, [(s + 1) % 7, 7]] = hold, 1 - hold
            p[s, 1, 7] = 1
        r = np.ones((8, 2))
        env = rl.FiniteMDP(p, r, terminal=[7])
        pi, b = np.tile([1.0, 0.0], (8, 1)), np.tile([0.7, 0.3], (8, 1))
        if infinite:
            with pytest.warns(UserWarning, match="infinite"):
                exact = importance.variance(env, pi, b)
        else:
            exact = importance.variance(env, pi, b)
        assert (np.isinf(exact.ratio[:7]) == infinite).all()
        assert (np.isinf(exact.ordinary[:7]) == infinite).all()


def test_a_state_that_only_behaviour_leaves_for_the_loop_is_finite():
    """Broken once: outcomes of probability 0 kept in the pattern of the chain -> fails, for then state 1

    and the loop in state 0, which leads to state 1, are one set.
    """
    p = np.zeros((3, 2, 3))
    p[0, 0] = 0.8, 0.1, 0.1  # the loop, from which state 1 can be entered
    p[0, 1, 2] = p[1, 0, 2] = p[1, 1, 0] = 1
    env = rl.FiniteMDP(p, np.ones((3, 2)), terminal=[2])
    with pytest.warns(UserWarning, match="from state 0"):
        exact = importance.variance(env, np.eye(2)[[0, 0, 0]], np.full((3, 2), 0.5))
    for x in exact:
        np.testing.assert_array_equal(x, [np.inf, 1, 0])
    with pytest.warns(UserWarning, match=r"from \(s, a\) = \(0, 0\)"):
        exact = importance.action_variance(env, np.eye(2)[[0, 0, 0]], np.full((3, 2), 0.5))
    for x in exact:
        np.testing.assert_array_equal(x, [[np.inf, 0], [0, np.inf], [0, 0]])


def test_a_huge_variance_is_not_an_infinite_one():
    """A long walk, in which the squared ratio almost doubles with each step to the right; but it ends."""
    env, pi = walk(right=0.95, num_states=101, slip=0.0)
    exact = importance.variance(env, pi, np.full(pi.shape, 0.5))
    assert 1e10 < exact.ratio[50] < np.inf
    # One state after another, from the ends: x(s) = w_left x(s - 1) + w_right x(s + 1), x = 1 beyond them.
    left, right = 0.05**2 / 0.5, 0.95**2 / 0.5
    up = [(0.0, 1.0)]  # x(s - 1) = slope x(s) + constant
    for _ in range(101):
        slope, constant = up[-1]
        rest = 1 - left * slope
        up.append((right / rest, left * constant / rest))
    x = [1.0]
    for slope, constant in reversed(up[1:]):
        x.append(slope * x[-1] + constant)
    np.testing.assert_allclose(exact.ratio[:-1], np.array(x[:0:-1]) - 1, rtol=1e-9)
    assert all(a > b for a, b in pairwise(x[:0:-1]))


# --- the ratios that occurred ------------------------------------------------------------------------

PI, B = np.array([[0.9, 0.1], [0.5, 0.5], [0.5, 0.5]]), np.array([[0.3, 0.7], [0.25, 0.75], [0.5, 0.5]])
LOG = rl.Experience.from_episodes(
    [
        ([0, 1, 2], [0, 1], [0, 1]),
        ([0, 2], [1], [0]),
        ([1, 0, 1], [0, 0], [0, 0]),  # cut short
    ],
    terminal=[True, True, False],
)


def test_ratios_of_episodes_by_hand():
    """Broken once: the first action of an episode multiplied to the one before -> fails."""
    want = [3 * 2 / 3, 1 / 7, 2 * 3]
    np.testing.assert_allclose(importance.ratios(LOG, PI, B), want)
    diagnosis = importance.diagnose(LOG, Table(PI), Table(B))
    worth = sum(want) ** 2 / sum(w**2 for w in want)
    assert diagnosis.episodes == 3
    assert diagnosis.effective_sample_size == pytest.approx(worth)
    assert diagnosis.largest_ratio == pytest.approx(6)
    assert diagnosis.mean_ratio == pytest.approx(sum(want) / 3)
    assert diagnosis.standard_error == pytest.approx(np.std(want, ddof=1) / np.sqrt(3))
    assert str(diagnosis) == (
        "3 episodes, worth 1.657 of the target policy; largest ratio 6; mean ratio 2.714 +- 1.7 (expected: 1)"
    )


@pytest.mark.parametrize(
    ("ratios", "worth"),
    [([1, 1, 1, 1], 4), ([5.0], 1), ([0, 0, 3], 1), ([0.0, 0.0], 0), ([3, 1], 1.6), ([3e200, 1e200], 1.6)],
)
def test_effective_sample_size(ratios, worth):
    assert importance.effective_sample_size(ratios) == pytest.approx(worth)


def test_a_log_shows_the_exact_variance_of_the_ratio(exact):
    """About 4000 episodes: Var rho and the mean of rho, which is 1, within 4 standard errors."""
    log = rl.collect(jax.random.key(1), EVENLY, WALK, 40_000)
    diagnosis = importance.diagnose(log, TO_THE_RIGHT, EVENLY)
    assert abs(diagnosis.mean_ratio - 1) < 4 * diagnosis.standard_error
    w = importance.ratios(log, TO_THE_RIGHT, EVENLY)
    squares = (w - w.mean()) ** 2
    assert abs(squares.mean() - exact.ratio[START]) < 4 * squares.std() / np.sqrt(len(w))
    assert diagnosis.effective_sample_size == pytest.approx(len(w) / (1 + w.var() / w.mean() ** 2))


def test_a_log_that_is_worth_little_is_said_to_be():
    episodes = [([0, 2], [0], [0])] + 19 * [([0, 2], [1], [0])]
    log = rl.Experience.from_episodes(episodes)
    pi = np.array([[0.999, 0.001], [0.5, 0.5], [0.5, 0.5]])
    with pytest.warns(UserWarning, match=r"20 episodes are worth only 1 of the target policy"):
        diagnosis = importance.diagnose(log, pi, B)
    assert diagnosis.largest_ratio == pytest.approx(3.33)
    single = importance.diagnose(rl.Experience.from_episodes(episodes[:1]), pi, B)
    assert single.effective_sample_size == 1
    assert np.isnan(single.standard_error)


# --- what is refused ---------------------------------------------------------------------------------


def test_a_target_that_never_ends_has_no_ratio():
    p = np.zeros((3, 2, 3))
    p[0, :, 2] = p[1, 0, 1] = p[1, 1, 2] = 1
    stay, b = np.eye(2)[[0, 0, 0]], np.full((3, 2), 0.5)
    elsewhere = rl.FiniteMDP(p, np.ones((3, 2)), terminal=[2])
    for x in importance.variance(elsewhere, stay, b):
        np.testing.assert_array_equal(np.isnan(x), [False, True, False])
    for x in importance.action_variance(elsewhere, stay, b):
        np.testing.assert_array_equal(np.isnan(x), [[False, False], [True, False], [False, False]])
    here = rl.FiniteMDP(p, np.ones((3, 2)), terminal=[2], start=1)
    with pytest.raises(rl.InputError, match="from start state 1 an episode of target may never end"):
        importance.variance(here, stay, b)


@pytest.mark.parametrize(
    ("target", "behaviour", "gamma", "message"),
    [
        (EVENLY, np.eye(2)[[0, 0, 0, 1]], 1.0, "leaves out action 1 in state 0, which target can take"),
        (EVENLY[:3], EVENLY, 1.0, r"target: probabilities are of shape \(3, 2\), and the task has 4 states"),
        (EVENLY, EVENLY.T, 1.0, r"behaviour: .* state 0 are not a distribution"),
        (
            EVENLY,
            Table(EVENLY[:, [0, 1, 0, 1]] / 2),
            1.0,
            "behaviour: .* the task has 4 states and 2 actions",
        ),
        (EVENLY, EVENLY, 1.5, "gamma must be between 0 and 1, not 1.5"),
    ],
)
@pytest.mark.parametrize("function", [importance.variance, importance.action_variance])
def test_policies_that_do_not_fit_are_refused(function, target, behaviour, gamma, message):
    with pytest.raises(rl.InputError, match=message):
        function(WALK, target, behaviour, gamma)


@pytest.mark.parametrize(
    ("log", "target", "behaviour", "message"),
    [
        (LOG, PI, np.eye(2)[[0, 0, 0]], "leaves out action 1 in state 0"),
        (LOG, np.eye(2)[[0, 0, 0]], np.eye(2)[[0, 0, 0]], "takes action 1 in state 1, which the behaviour"),
        (LOG, PI[:2], B, r"target: probabilities are of shape \(2, 2\), and the task has 3 states"),
        (LOG, PI[:2], B[:2], "is 2; the task has states 0 to 1"),
        ([[0, 1]], PI, B, "experience must be an Experience, as .* give it, not list"),
    ],
)
def test_logs_that_do_not_fit_are_refused(log, target, behaviour, message):
    with pytest.raises(rl.InputError, match=message):
        importance.diagnose(log, target, behaviour)


@pytest.mark.parametrize("ratios", [[], [[1.0]], [-1.0], [np.nan], ["a"], -np.ones(100), -np.ones((9, 9))])
def test_ratios_that_are_none_are_refused(ratios):
    with pytest.raises(rl.InputError, match="ratios must be finite numbers") as error:
        importance.effective_sample_size(ratios)
    assert "\n" not in str(error.value)


def test_an_environment_that_can_only_be_sampled_is_refused():
    class Sampled:
        num_states, num_actions, max_steps = 4, 2, 10
        reset = step = None

    with pytest.raises(rl.InputError, match="Sampled can only be sampled"):
        importance.variance(Sampled(), EVENLY, EVENLY)
