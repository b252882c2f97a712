"""The exact value of the policy that acts, recorded while it learns: `policy_value`."""

import jax
import numpy as np
import pytest
from marks import slow_but

import jaxrl_tab as rl
from jaxrl_tab import stats

WINDY, DOORS, CARDS = map(rl.make, ("windy-gridworld", "two-doors", "blackjack"))
KEY = jax.random.key(0)


def value(env, pi, gamma):
    """By NumPy: v = r + gamma P v, of the states that are not terminal, and the mean of it over the starts."""
    model = rl.planning.exact_model(env)
    n = env.num_states
    weight = pi[:, :, None] * model.prob
    chain = np.zeros((n, n))
    np.add.at(chain, (np.arange(n)[:, None, None], model.s_next), weight)
    goes_on = ~np.asarray(rl.planning.terminal_states(model))
    system = np.eye(goes_on.sum()) - gamma * chain[np.ix_(goes_on, goes_on)]
    v = np.zeros(n)
    v[goes_on] = np.linalg.solve(system, (weight * model.reward).sum((1, 2))[goes_on])
    return np.asarray(env.initial(), float) @ v


def epsilon_greedy(q, epsilon):
    best = q == q.max(1, keepdims=True)
    return epsilon / q.shape[1] + (1 - epsilon) * best / best.sum(1, keepdims=True)


def softmax(q, temperature):
    x = np.exp((q - q.max(1, keepdims=True)) / temperature)
    return x / x.sum(1, keepdims=True)


CASES = {
    "sarsa": ({"epsilon": 0.2}, lambda q, k: epsilon_greedy(q, 0.2)),
    "q-learning": ({"epsilon": 0.2, "gamma": 0.9}, lambda q, k: epsilon_greedy(q, 0.2)),
    "double-q-learning": ({"epsilon": 0.2}, lambda q, k: epsilon_greedy(q, 0.2)),
    "sarsa-lambda": ({"epsilon": 0.2}, lambda q, k: epsilon_greedy(q, 0.2)),
    "n-step-sarsa": ({"behaviour": rl.policies.Softmax(0.7)}, lambda q, k: softmax(q, 0.7)),
    "monte-carlo": ({"epsilon": rl.schedules.glie()}, lambda q, k: epsilon_greedy(q, 1 / k)),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", slow_but(["sarsa", "monte-carlo", "double-q-learning"], CASES))
def test_it_is_what_a_linear_system_gives(name):
    """Broken once: the greedy policy in its place -> fails; the clock of the beginning -> fails for GLIE."""
    options, policy = CASES[name]
    method = rl.ALGORITHMS[name](alpha=0.3, **options)
    table = lambda state: {"table": state.q}
    _, log = rl.train(KEY, method, DOORS, num_episodes=12, log_every=1, exact=True, record=table)
    episodes = 1 + np.cumsum(log.episodes)  # the next one is acted by the policy that there is now
    for q, k, found in zip(log.recorded["table"], episodes, log.policy_value, strict=True):
        expected = value(DOORS, policy(np.asarray(q, float), k), options.get("gamma", 1.0))
        np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert len(set(np.asarray(log.policy_value))) > 1


@pytest.mark.slow
def test_actions_that_there_are_not_are_not_taken():
    """Left or right in one state, ten actions in the other. Broken once: a method that does not know it -> fails."""
    env, table = rl.make("maximization-bias"), lambda state: {"table": state.q}
    _, log = rl.train(KEY, rl.Sarsa(), env, num_episodes=8, log_every=4, exact=True, record=table)
    for q, found in zip(log.recorded["table"], log.policy_value, strict=True):
        left = epsilon_greedy(np.asarray(q, float)[:1, :2], 0.1)[0, 0]
        assert found == pytest.approx(-0.1 * left, rel=1e-6)


@pytest.mark.slow
def test_the_best_policy_that_explores_is_worth_what_planning_says():
    """-17.048 on the windy gridworld, of which the optimum is -15."""
    probs, v, _ = rl.planning.epsilon_soft(WINDY, 0.1)
    method = rl.Sarsa(behaviour=rl.policies.Table(probs))
    _, log = rl.train(KEY, method, WINDY, num_steps=10, log_every=10, exact=True)
    assert log.policy_value[0] == pytest.approx(rl.planning.start_value(WINDY, v), rel=1e-6)
    assert log.policy_value[0] == pytest.approx(-17.0483, abs=1e-4)


@pytest.mark.slow
def test_returns_of_a_policy_that_stays_scatter_about_it():
    """Blackjack, 64 seeds of 100 games, with a step size that changes nothing."""
    q0 = np.random.default_rng(0).normal(size=(CARDS.num_states, 2)).astype(np.float32)
    method = rl.ALGORITHMS["monte-carlo"](alpha=1e-9, epsilon=0.1, q0=q0)
    run = lambda key: rl.train(key, method, CARDS, num_episodes=100, log_every=100, exact=True)[1]
    log = jax.jit(jax.vmap(run))(jax.random.split(KEY, 64))
    (exact,) = np.unique(log.policy_value)
    returns = np.asarray(log.returns).ravel() / 100
    assert abs(returns.mean() - exact) < 3 * returns.std() / 8


@pytest.mark.slow
def test_it_is_not_there_where_a_method_does_not_say_how_it_acts():
    """The other exact numbers are. Broken once: asked all the same -> AttributeError."""

    @rl.pytree
    class Own:
        """Sarsa, without its probabilities."""

        gamma: float = 1.0
        init, policy, update = (getattr(rl.Sarsa(), name) for name in ("init", "policy", "update"))

    _, log = rl.train(KEY, Own(), DOORS, num_steps=10, log_every=10, exact=True)
    assert log.policy_value is None and log.greedy_value.shape == (1,)


@pytest.mark.slow
def test_what_goes_round_for_ever_is_worth_nothing_finite_and_what_is_no_policy_nan():
    """Broken once: NaN not asked for -> a number."""
    worth = lambda pi: rl.planning.measurer(WINDY, 1.0)(jax.numpy.zeros((70, 4)), pi)[2]
    west = np.tile(np.eye(4, dtype=np.float32)[3], (70, 1))
    assert np.isneginf(jax.jit(worth)(west))
    assert np.isnan(jax.jit(worth)(np.where(np.arange(70)[:, None] == 30, np.nan, west)))
    assert jax.jit(worth)(3 * west + 1e-3) == jax.jit(worth)(west + 1e-3 / 3)  # weights, not probabilities


@pytest.mark.slow
def test_both_backends_record_it():
    def swept(name):
        return rl.sweep(DOORS, "sarsa", num_seeds=9, num_steps=30, log_every=10, exact=True, backend=name).log

    ours, theirs = swept("lanes"), swept("xla")
    np.testing.assert_array_equal(ours.policy_value, theirs.policy_value)
    assert ours.policy_value.shape == (9, 3)


@pytest.mark.slow
def test_the_table_has_it():
    """The median over seeds at the end. Broken once: the first row -> fails."""
    ds = rl.sweep(
        DOORS, "sarsa", {"alpha": 0.3}, num_seeds=9, num_steps=30, log_every=10, exact=True
    ).to_xarray()
    own = stats.Methods.of({"sarsa": ds}).settings["sarsa"]
    assert own.numbers("policy_value") == [ds.policy_value.isel(row=-1).median()]
    assert own.numbers("policy_value") != [ds.policy_value.isel(row=0).median()]
