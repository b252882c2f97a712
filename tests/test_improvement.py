"""The policy improvement theorem for epsilon-greedy policies (Silver, lecture 5; book, section 5.4).

Of any epsilon-soft policy pi, the policy that is epsilon-greedy to q_pi is nowhere worse. And it is nowhere
better only if pi is the best of all epsilon-soft policies.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrl_tab import planning
from jaxrl_tab.envs import FiniteMDP

STATES, ACTIONS = 5, 3  # one size: one compiled program
ROUNDING = 1e-9


@st.composite
def tasks(draw):
    """A random task whose last state is terminal and can always be reached; half of them are full of ties."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if draw(st.booleans()):
        p = rng.dirichlet(np.ones(STATES), size=(STATES, ACTIONS))
        return FiniteMDP(p, rng.normal(size=p.shape), terminal=[STATES - 1])
    # Each action leads to two states, perhaps the same, and sometimes to the end; rewards are -1, 0 or 1.
    p = np.eye(STATES)[rng.integers(0, STATES, size=(2, STATES, ACTIONS))].mean(0)
    p = 0.875 * p + 0.125 * np.eye(STATES)[-1]
    return FiniteMDP(p, rng.integers(-1, 2, size=(STATES, ACTIONS)).astype(float), terminal=[STATES - 1])


@st.composite
def soft_policies(draw, epsilon):
    """epsilon / A for every action, and the rest spread at random: over all, or to a single action."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    spread = draw(st.sampled_from([0.05, 1.0]))
    return epsilon / ACTIONS + (1 - epsilon) * rng.dirichlet(np.full(ACTIONS, spread), size=STATES)


def improved(env, policy, epsilon, gamma):
    """The values of `policy`, and of the policy that is epsilon-greedy to its action values, [S] each."""
    v = planning.evaluate(env, policy, gamma)
    q = planning.backup(planning.exact_model(env), v, gamma)
    return v, planning.evaluate(env, planning.epsilon_greedy_policy(q, epsilon), gamma)


epsilons = st.floats(0.01, 1.0)
gammas = st.sampled_from([0.0, 0.5, 0.9, 1.0])


@pytest.mark.slow
@settings(max_examples=100, deadline=None, derandomize=True)
@given(tasks(), st.data(), epsilons, gammas)
def test_the_epsilon_greedy_policy_is_nowhere_worse(env, data, epsilon, gamma):
    """Broken once, each -> fails: the minimum in `policies.greedy`; gamma 0 in `planning.backup`."""
    v, better = improved(env, data.draw(soft_policies(epsilon)), epsilon, gamma)
    assert (better >= v - ROUNDING * (1 + abs(v).max())).all()


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(tasks(), st.data(), epsilons, st.sampled_from([0.0, 0.5, 0.9]))
def test_nowhere_better_only_at_the_optimum_among_soft_policies(env, data, epsilon, gamma):
    """The best gain over all states is at least (1 - gamma) times the largest distance to the best policy.

    For v' >= T v with T the backup of the best epsilon-soft policy, a contraction by gamma, so that
    |v~* - v| <= |T v - v| / (1 - gamma). No gain, then, is no distance: v = v~*.
    """
    v, better = improved(env, data.draw(soft_policies(epsilon)), epsilon, gamma)
    _, best, _ = planning.epsilon_soft(env, epsilon, gamma)
    assert (better <= best + ROUNDING * (1 + abs(best).max())).all()
    assert (better - v).max() >= (1 - gamma) * (best - v).max() - ROUNDING * (1 + abs(v).max())


@settings(max_examples=30, deadline=None, derandomize=True)
@given(tasks(), epsilons, gammas)
def test_the_best_soft_policy_cannot_be_improved(env, epsilon, gamma):
    policy, best, _ = planning.epsilon_soft(env, epsilon, gamma)
    v, better = improved(env, policy, epsilon, gamma)
    np.testing.assert_allclose(v, best, rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(better, best, rtol=ROUNDING, atol=ROUNDING)


def test_improving_again_and_again_ends_at_the_best_soft_policy():
    """Generalised policy iteration with exact evaluation, from the uniform policy."""
    rng = np.random.default_rng(0)
    p = rng.dirichlet(np.ones(STATES), size=(STATES, ACTIONS))
    env = FiniteMDP(p, rng.normal(size=p.shape), terminal=[STATES - 1])
    policy, steps = np.full((STATES, ACTIONS), 1 / ACTIONS), []
    for _ in range(10):
        v = planning.evaluate(env, policy)
        steps.append(v)
        policy = planning.epsilon_greedy_policy(planning.backup(planning.exact_model(env), v, 1.0), 0.2)
    assert (np.diff(steps, axis=0) >= -ROUNDING).all()
    assert (steps[1] - steps[0]).max() > 0.01
    np.testing.assert_allclose(steps[-1], planning.epsilon_soft(env, 0.2)[1], rtol=ROUNDING)


def test_the_theorem_needs_a_soft_policy():
    """The policy that is epsilon-greedy to the values of a deterministic one may be worse: it explores."""
    p = np.zeros((STATES, ACTIONS, STATES))
    p[..., -1] = 1
    env = FiniteMDP(p, np.tile([1.0, 0.0, 0.0], (STATES, 1)), terminal=[STATES - 1])
    v, other = improved(env, np.tile([1.0, 0, 0], (STATES, 1)), 0.3, 1.0)
    assert v[0] == pytest.approx(1.0)
    assert other[0] == pytest.approx(0.8)
