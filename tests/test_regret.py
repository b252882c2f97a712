"""Where the regret comes from: visits and losses, beside linear systems solved in plain NumPy and rational numbers."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_planning import random_mdp, random_policy

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.core.errors import InputError

# --- oracles -----------------------------------------------------------------------------------------


def chain_of(env, policy, gamma):
    """The matrix [S, S] of gamma times the probabilities of the steps that do not end the episode, entry by entry."""
    model = planning.exact_model(env)
    chain = np.zeros((env.num_states, env.num_states))
    for s, a, k in np.ndindex(model.prob.shape):
        if not model.terminal[s, a, k]:
            chain[s, model.s_next[s, a, k]] += gamma * policy[s, a] * model.prob[s, a, k]
    return chain


def plain_visits(env, policy, gamma):
    """The visits of a policy that ends from everywhere, by a dense linear system."""
    model = planning.exact_model(env)
    over = planning.terminal_states(model)
    chain = np.where(over[:, None], 0, chain_of(env, policy, gamma))
    return np.where(over, 0, np.linalg.solve(np.eye(len(chain)) - chain.T, model.start))


def check_identity(env, policy, gamma=1.0):
    """The regret, as it adds up, is v* - v_pi; it and the occupancy are those of a plain linear system."""
    v, q = planning.value_iteration(env, gamma)
    by_action = planning.action_regret_map(env, policy, gamma)
    regret = planning.regret_map(env, policy, gamma)
    visits = planning.occupancy(env, policy, gamma)
    assert regret.dtype == by_action.dtype == visits.dtype == np.float64
    np.testing.assert_allclose(visits, plain_visits(env, policy, gamma), rtol=1e-9, atol=1e-12)
    gaps = np.where(np.asarray(policy) > 0, v[:, None] - q, 0)
    np.testing.assert_allclose(by_action, visits[:, None] * policy * gaps, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(by_action.sum(1), regret)
    assert (by_action >= 0).all()
    lost = planning.start_value(env, v) - planning.policy_value(env, policy, gamma)
    assert regret.sum() == pytest.approx(lost, rel=1e-10, abs=1e-10)
    model = planning.exact_model(env)
    earned = (np.asarray(policy)[:, :, None] * model.prob * model.reward).sum((1, 2)) @ visits
    assert earned == pytest.approx(planning.policy_value(env, policy, gamma), rel=1e-10, abs=1e-10)
    return regret


# --- the identity ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "episodes"), [("cliff-walking", 300), ("windy-gridworld", 300)])
def test_what_sarsa_loses_adds_up(name, episodes):
    """Broken once: the visits of the policy in which all actions are equally likely -> fails."""
    env = rl.make(name)
    state, _ = rl.train(jax.random.key(0), rl.Sarsa(alpha=0.5), env, num_episodes=episodes)
    policy = planning.epsilon_greedy_policy(np.asarray(state.q, float), 0.1)
    regret = check_identity(env, policy)
    assert regret.sum() > 1
    # What it does where it does not come to costs nothing.
    assert (regret[planning.occupancy(env, policy) == 0] == 0).all()


def test_the_cliff_by_hand():
    """It goes by the top row, 17 steps instead of 13: the second and the third step up cost two more each."""
    cliff = rl.make("cliff-walking")
    actions = np.zeros(48, int)  # up
    actions[0:12] = 1  # right, in the top row
    actions[[11, 23, 35]] = 2  # down, in the last column
    regret = check_identity(cliff, np.eye(4)[actions])
    assert regret.sum() == 4
    np.testing.assert_array_equal(np.flatnonzero(regret), [12, 24])
    np.testing.assert_array_equal(regret[[12, 24]], [2, 2])
    visits = planning.occupancy(cliff, np.eye(4)[actions])
    assert visits.sum() == 17
    assert set(visits) == {0, 1}


def test_blackjack_at_the_strategy_of_the_book():
    env = rl.make("blackjack")
    for seed in range(2):
        check_identity(env, random_policy(np.random.default_rng(seed), env.num_states, 2))


def test_several_starts_and_a_discount():
    """Broken once: the visits of the first start state alone -> fails."""
    p = np.random.default_rng(3).dirichlet(np.ones(6), size=(6, 3))
    r = np.random.default_rng(4).normal(size=(6, 3))
    start = np.array([0.5, 0, 0.25, 0, 0.25, 0])
    for terminal in [(), (5,)]:
        env = rl.FiniteMDP(p, r, terminal=terminal, start=start)
        policy = random_policy(np.random.default_rng(5), 6)
        check_identity(env, policy, 0.9)
    visits = planning.occupancy(rl.FiniteMDP(p, r, start=start), policy, 0.9)
    assert visits.sum() == pytest.approx(1 / (1 - 0.9), rel=1e-12)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.5, 0.99, 1.0]), st.booleans())
def test_it_adds_up_in_any_task(seed, gamma, deterministic):
    env, rng = random_mdp(seed), np.random.default_rng(seed)
    policy = np.eye(3)[rng.integers(3, size=5)] if deterministic else random_policy(rng)
    check_identity(env, policy, gamma)


def test_actions_that_a_state_does_not_have_cost_nothing():
    env = rl.make("maximization-bias")
    _, q = planning.value_iteration(env)
    policy = planning.epsilon_greedy_policy(q, 0.5)
    with pytest.raises(InputError, match="does not have action"):
        planning.regret_map(env, np.full(q.shape, 1 / q.shape[1]))
    by_action = planning.action_regret_map(
        env, np.where(q > -1e29, policy, 0) / np.where(q > -1e29, policy, 0).sum(1, keepdims=True)
    )
    assert 0 < by_action.sum() < 1


# --- states that are bad -----------------------------------------------------------------------------


def aside(big):
    """From 0 to the end, by 1 or the longer way by 2; from state 3 nobody ends, and nobody comes there by action 0."""
    moves, rewards = [[1, 2], [4, 3], [1, 1], [3, 3], [4, 4]], np.zeros((5, 2))
    rewards[:4] = -1
    rewards[3] = -big
    return rl.FiniteMDP(np.eye(5)[np.array(moves)], rewards, terminal=[4])


@pytest.mark.parametrize("big", [1.0, 1e9, 1e100])
def test_a_state_without_an_end_beside_the_way_changes_nothing(big):
    """Broken once: all states are solved for -> fails."""
    env, there = aside(big), [[0.25, 0.75], [1, 0], [1, 0], [1, 0], [1, 0]]
    np.testing.assert_array_equal(planning.occupancy(env, there), [1, 1, 0.75, 0, 0])
    np.testing.assert_array_equal(planning.regret_map(env, there, 0.5), [0.1875, 0, 0, 0, 0])
    with pytest.raises(InputError, match=r"from state 3 no policy ever ends|state 3"):
        planning.regret_map(env, [[1, 0], [0.5, 0.5], *there[2:]])


def test_the_numbers_of_one_bad_state_do_not_reach_the_others():
    """A state that costs 1e15 and is never come to; gamma below 1 leaves it its value. Rewards elsewhere are small."""
    rng = np.random.default_rng(0)
    p, r = rng.dirichlet(np.ones(4), size=(5, 2)), rng.normal(size=(5, 2))
    p = np.concatenate([p, np.zeros((5, 2, 1))], 2)
    p[4] = [[0.2] * 5] * 2
    policy = random_policy(rng, 5, 2)
    maps = []
    for big in (0, 1e15):
        r[4] = -big
        maps.append(planning.regret_map(rl.FiniteMDP(p, r), policy, 0.95))
    np.testing.assert_array_equal(maps[0], maps[1])
    assert maps[0][4] == 0


def test_a_policy_that_never_ends_is_refused_by_the_state_that_it_comes_to():
    windy = rl.make("windy-gridworld")
    up = np.tile([1.0, 0, 0, 0], (70, 1))
    with pytest.raises(
        InputError, match=r"may come to state 0, from which it never ends, so at gamma = 1 its visits"
    ):
        planning.occupancy(windy, up)
    with pytest.raises(
        InputError, match=r"may come to state 0, from which .* its regret is infinite"
    ) as error:
        planning.regret_map(windy, up)
    assert "\n" not in str(error.value)
    visits = planning.occupancy(windy, up, 0.75)
    np.testing.assert_allclose(visits[[30, 20, 10, 0]], [1, 0.75, 0.75**2, 0.75**3 / 0.25])
    optimum = planning.start_value(windy, planning.value_iteration(windy, 0.75)[0])
    assert planning.regret_map(windy, up, 0.75).sum() == pytest.approx(optimum + 4, rel=1e-12)


def test_what_is_lost_by_waiting_for_nothing_is_lost_where_one_waits():
    """Wait for 0 or go on to 5: no step of waiting loses anything, and waiting for ever loses 5."""
    moves = np.array([[0, 1], [2, 3], [2, 1], [3, 3]])
    rewards = np.array([[0, 0], [0, 5], [0, 0], [0, 0]], float)
    env = rl.FiniteMDP(np.eye(4)[moves], rewards, terminal=[3])
    np.testing.assert_array_equal(planning.regret_map(env, [[1, 0], [0, 1], [0, 1], [1, 0]]), [5, 0, 0, 0])
    half = [[0, 1], [0.5, 0.5], [1, 0], [1, 0]]
    np.testing.assert_array_equal(planning.regret_map(env, half), [0, 0, 2.5, 0])
    lost = planning.value_iteration(env)[0][0] - planning.policy_value(env, half)
    assert lost == 2.5


def test_a_chain_that_hardly_ever_goes_on_keeps_its_digits():
    """Broken once: 1 - p(s | s) taken as a difference -> off by 1e-4."""
    tiny = 3e-13
    p = np.zeros((2, 1, 2))
    p[0, 0], p[1, 0] = [1 - tiny, tiny], [0, 1]
    env = rl.FiniteMDP(p, np.ones((2, 1)), terminal=[1])
    assert planning.occupancy(env, np.ones((2, 1)))[0] == pytest.approx(1 / 3e-13, rel=1e-12)


# --- in the long run ---------------------------------------------------------------------------------


def markov(p, terminal=(), start=0):
    p = np.array(p, float)
    return rl.FiniteMDP(p[:, None, :], np.zeros((len(p), 1)), terminal=terminal, start=start), np.ones(
        (len(p), 1)
    )


def test_the_stationary_distribution_is_that_of_the_matrix():
    p = np.random.default_rng(1).dirichlet(np.ones(7), size=7)
    mu = planning.stationary_distribution(*markov(p))
    np.testing.assert_allclose(mu @ p, mu, atol=1e-15)
    values, vectors = np.linalg.eig(p.T)
    one = vectors[:, np.argmax(values.real)].real
    np.testing.assert_allclose(mu, one / one.sum(), rtol=1e-10)


def test_of_a_periodic_chain_it_is_the_share_of_time():
    np.testing.assert_allclose(
        planning.stationary_distribution(*markov([[0, 1, 0], [0, 0, 1], [1, 0, 0]])), [1 / 3] * 3
    )


def test_of_several_sets_it_is_their_mixture_from_the_start():
    """From state 0 to {1} with 1/4, to {2, 3} with 3/4. Broken once: all sets alike -> fails."""
    p = [[0.5, 0.125, 0.375, 0], [0, 1, 0, 0], [0, 0, 0.5, 0.5], [0, 0, 1, 0]]
    np.testing.assert_allclose(planning.stationary_distribution(*markov(p)), [0, 0.25, 0.5, 0.25], rtol=1e-15)
    np.testing.assert_allclose(
        planning.stationary_distribution(*markov(p, start=2)), [0, 0, 2 / 3, 1 / 3], rtol=1e-15
    )
    np.testing.assert_allclose(planning.stationary_distribution(*markov(p, start=[0, 1, 0, 0])), [0, 1, 0, 0])


def test_of_an_episodic_task_it_is_the_on_policy_distribution(windy):
    policy = np.full((70, 4), 0.25)
    visits = planning.occupancy(windy, policy)
    np.testing.assert_allclose(
        planning.stationary_distribution(windy, policy), visits / visits.sum(), rtol=1e-10
    )
    walk = rl.make("random-walk", states=5)
    visits = planning.occupancy(walk, np.ones((7, 1)))
    np.testing.assert_allclose(visits, [0, 1, 2, 3, 2, 1, 0], rtol=1e-13)


def test_where_an_episode_may_never_end_the_rest_of_time_is_spent_there():
    p = [[0, 0.5, 0.5], [0, 1, 0], [0, 0, 1]]
    np.testing.assert_allclose(planning.stationary_distribution(*markov(p, terminal=[2])), [0, 1, 0])


def test_a_large_chain_takes_no_time():
    """A ring of 30 000 states, and a walk on it."""
    n = 30_000
    states = np.arange(n)
    outcomes = [[[(0.5, (s + 1) % n, 0.0), (0.5, (s - 1) % n, 0.0)]] for s in states.tolist()]
    env = rl.FiniteMDP.from_outcomes(outcomes)
    np.testing.assert_allclose(planning.stationary_distribution(env, np.ones((n, 1))), 1 / n, rtol=1e-5)


@pytest.mark.parametrize(
    "function", [planning.occupancy, planning.regret_map, planning.stationary_distribution]
)
def test_what_is_no_policy_is_refused(function, windy):
    with pytest.raises(InputError, match="the task has 70 states and 4 actions"):
        function(windy, np.ones((3, 3)) / 3)
