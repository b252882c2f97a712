"""The exact side: published numbers, numbers worked by hand, and plain loops over random tasks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrl_tab import planning
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs import CliffWalking, FiniteMDP, RandomWalk, WindyGridworld

# --- tasks and oracles -------------------------------------------------------------------------------


def random_tables(rng, num_states=5, num_actions=3):
    """p [S, A, S'] and r [S, A, S'] of a task in which every state leads to every other."""
    p = rng.dirichlet(np.ones(num_states), size=(num_states, num_actions))
    return p, rng.normal(size=(num_states, num_actions, num_states))


def random_mdp(seed):
    p, r = random_tables(np.random.default_rng(seed))
    return FiniteMDP(p, r, terminal=[len(p) - 1])


def random_policy(rng, num_states=5, num_actions=3):
    return rng.dirichlet(np.ones(num_actions), size=num_states)


def deterministic(moves, rewards, terminal=(), start=0):
    """A task from tables [S][A] of the next state and of the reward."""
    moves = np.array(moves)
    return FiniteMDP(np.eye(len(moves))[moves], np.array(rewards, float), terminal=terminal, start=start)


def loop_values(p, r, terminal, policy, gamma, sweeps):
    """The values of a policy by plain sweeps, entry by entry."""
    v = [0.0] * len(p)
    for _ in range(sweeps):
        old = list(v)
        for s in range(len(p)):
            v[s] = 0.0
            for a in range(len(p[s])):
                for s_next in range(len(p)):
                    future = 0.0 if s_next in terminal else gamma * old[s_next]
                    if s not in terminal:
                        v[s] += policy[s][a] * p[s][a][s_next] * (r[s][a][s_next] + future)
    return np.array(v)


def doubled_value(env, policy, gamma):
    """The value of a policy from the start after 2^50 steps, by doubling; -inf where that is huge."""
    model = planning.exact_model(env)
    n = env.num_states
    step, v = np.zeros((n, n)), np.zeros(n)
    for s, a, k in np.ndindex(model.prob.shape):
        weight = policy[s, a] * model.prob[s, a, k]
        v[s] += weight * model.reward[s, a, k]
        step[s, model.s_next[s, a, k]] += gamma * weight * (not model.terminal[s, a, k])
    for _ in range(50):
        v, step = v + step @ v, step @ step
        step[step < 1e-200] = 0
    value = model.start @ v
    return -np.inf if value < -1e9 else value


WAIT = deterministic([[0, 1], [2, 2], [2, 2]], [[0, 1], [-3, -3], [0, 0]], terminal=[2])
"""In state 0: wait for nothing, or take 1 and pay 3 afterwards. Waiting for ever is best, and worth 0."""

CORRIDOR = deterministic(
    [[0, 0], [0, 2], [1, 3], [2, 4], [4, 4]],
    [[0, 0], [-1, 0], [0, 0], [0, 1], [0, 0]],
    terminal=[0, 4],
    start=2,
)
"""Left or right, freely; -1 at the left end and +1 at the right end."""

TREADMILL = deterministic([[1, 1], [0, 0]], [[-1, -1], [-1, -1]])
"""Two states without an end, 1 to pay at each step."""

TRAP = deterministic([[0, 1], [2, 2], [2, 2]], [[-1, -1], [-1, -1], [0, 0]], terminal=[2])
"""In state 0: stay and pay, or go on to state 1 and the end."""


# --- numbers that are known --------------------------------------------------------------------------


@pytest.mark.parametrize(("moves", "steps"), [("four", 15), ("king", 7), ("king+stay", 7)])
def test_windy_gridworld_optimum(moves, steps):
    env = WindyGridworld(moves=moves)
    v, q = planning.value_iteration(env)
    assert v.dtype == q.dtype == np.float64
    assert (v[30], planning.start_value(env, v)) == (-steps, -steps)
    assert v[37] == 0
    assert (q[37] == 0).all()
    # Not -14: the step that enters the goal costs 1 too.
    assert q.max(1)[np.arange(70) != 37].max() == -1


def test_best_epsilon_soft_policies():
    windy, cliff = WindyGridworld(), CliffWalking()
    assert planning.epsilon_soft(windy, 0.1)[1][30] == pytest.approx(-17.0483, abs=5e-5)
    assert planning.start_value(cliff, planning.epsilon_soft(cliff, 0.1)[1]) == pytest.approx(
        -20.7077, abs=5e-5
    )
    assert planning.start_value(cliff, planning.value_iteration(cliff)[0]) == -13


def test_random_walk_values():
    walk = RandomWalk()
    expected = np.r_[0, np.arange(-0.9, 0.95, 0.1), 0]
    uniform = np.ones((21, 1))
    np.testing.assert_allclose(planning.evaluate(walk, uniform), expected, atol=1e-12)
    np.testing.assert_allclose(planning.value_iteration(walk)[0], expected, atol=1e-10)
    small = RandomWalk(states=5, left_reward=0.0)  # book, example 6.2
    np.testing.assert_allclose(
        planning.evaluate(small, np.ones((7, 1))), np.r_[0, np.arange(1, 6) / 6, 0], atol=1e-12
    )


def test_two_states_by_hand():
    # State 0. Go: 2 and again with 1/2, 4 and the end with 1/2. Quit: 5 and the end. State 1 is the end.
    p = np.array([[[0.5, 0.5], [0, 1]], [[0, 1], [0, 1]]])
    env = FiniteMDP(p, np.array([[[2, 4], [0, 5]], [[0, 0], [0, 0]]]), terminal=[1])
    v, q = planning.value_iteration(env)  # v = 3 + v / 2
    np.testing.assert_allclose(q, [[6, 5], [0, 0]], atol=1e-10)
    v, q = planning.value_iteration(env, gamma=0.5)  # quitting is better
    np.testing.assert_allclose(q, [[4.25, 5], [0, 0]], atol=1e-10)
    v = planning.evaluate(env, np.full((2, 2), 0.5))  # v = (3 + v / 2) / 2 + 5 / 2
    np.testing.assert_allclose(v, [16 / 3, 0])
    probs, v, q = planning.epsilon_soft(env, 0.5)  # v = 3/4 (3 + v / 2) + 5/4
    np.testing.assert_allclose(v, [5.6, 0])
    np.testing.assert_allclose(q, [[5.8, 5], [0, 0]])
    np.testing.assert_array_equal(probs[0], [0.75, 0.25])


def test_probabilities_are_float64_from_the_start():
    model = planning.exact_model(WindyGridworld(stochastic=True))
    assert (model.prob == 1 / 3).all()  # np.float32(1 / 3) is another number


# --- every way to the same values --------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_evaluate_agrees_with_plain_loops(gamma):
    rng = np.random.default_rng(1)
    p, r = random_tables(rng)
    policy = random_policy(rng)
    v = planning.evaluate(FiniteMDP(p, r, terminal=[4]), policy, gamma)
    np.testing.assert_allclose(v, loop_values(p, r, {4}, policy, gamma, sweeps=200), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("gamma", [0.0, 0.9, 1.0])
def test_value_iteration_agrees_with_policy_iteration(gamma):
    for env in (random_mdp(2), WindyGridworld(moves="king", stochastic=True), WAIT, CORRIDOR):
        v, q = planning.value_iteration(env, gamma)
        probs, best, best_q = planning.policy_iteration(env, gamma)
        np.testing.assert_allclose(v, best, atol=1e-9)
        np.testing.assert_allclose(q, best_q, atol=1e-9)
        np.testing.assert_allclose(planning.evaluate(env, probs, gamma), best, atol=1e-9)


def test_value_iteration_is_exact_to_tol_where_changes_shrink_slowly():
    # Each step costs 1 (or 2) and ends with probability 1/100. The first change below 1e-10 comes 1e-8 away.
    p = np.tile([[0.99, 0.01], [0.0, 1.0]], (2, 1, 1)).swapaxes(0, 1)
    v, _ = planning.value_iteration(FiniteMDP(p, np.array([[-2.0, -1.0], [0, 0]]), terminal=[1]))
    assert v[0] == pytest.approx(-100, abs=1.5e-10)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.sampled_from([0.5, 1.0]))
def test_no_epsilon_soft_policy_is_better_than_the_best(seed, epsilon, gamma):
    env = random_mdp(seed)
    probs, v, _ = planning.epsilon_soft(env, epsilon, gamma)
    assert probs.min() >= epsilon / 3 - 1e-12
    np.testing.assert_allclose(planning.evaluate(env, probs, gamma), v, rtol=1e-9, atol=1e-9)
    other = epsilon / 3 + (1 - epsilon) * random_policy(np.random.default_rng(seed))
    assert (planning.evaluate(env, other, gamma) <= v + 1e-9).all()


def test_epsilon_from_0_to_1_goes_from_the_optimum_to_the_uniform_policy():
    env = WindyGridworld()
    np.testing.assert_allclose(planning.epsilon_soft(env, 0.0)[1], planning.value_iteration(env)[0])
    np.testing.assert_allclose(
        planning.epsilon_soft(env, 1.0)[1], planning.evaluate(env, np.full((70, 4), 0.25))
    )


def test_policies_of_q_split_ties():
    q = np.array([[1.0, 3.0, 3.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(planning.greedy_policy(q), [[0, 0.5, 0.5, 0], [0.25] * 4])
    np.testing.assert_allclose(
        planning.epsilon_greedy_policy(q, 0.2), [[0.05, 0.45, 0.45, 0.05], [0.25] * 4], rtol=1e-15
    )


# --- gamma = 1 and no end ----------------------------------------------------------------------------


def test_loops_without_reward_have_value_0():
    _, q = planning.value_iteration(WAIT)
    np.testing.assert_array_equal(q, [[0, -2], [-3, -3], [0, 0]])  # from v = 0 the sweeps stop at [1, -2]
    np.testing.assert_array_equal(planning.policy_iteration(WAIT)[0][0], [1, 0])
    np.testing.assert_array_equal(planning.evaluate(WAIT, [[1, 0]] * 3), [0, -3, 0])


def test_an_optimal_policy_ends_where_turning_round_looks_as_good():
    probs, v, q = planning.policy_iteration(CORRIDOR)
    np.testing.assert_array_equal(v, [0, 1, 1, 1, 0])
    assert planning.policy_value(CORRIDOR, probs) == 1
    assert planning.policy_value(CORRIDOR, planning.greedy_policy(q)) == 1
    first = np.eye(2)[q.argmax(1)]  # goes left from the middle, and right again, for ever
    assert planning.policy_value(CORRIDOR, first) == 0


def test_a_policy_that_never_ends_is_refused_by_name():
    env = WindyGridworld()
    up = np.tile([1.0, 0, 0, 0], (70, 1))
    with pytest.raises(InputError, match=r"WindyGridworld: from state 0 this policy never ends") as error:
        planning.evaluate(env, up)
    assert "\n" not in str(error.value)
    assert planning.evaluate(env, up, gamma=0.75)[30] == pytest.approx(-4)
    # The state that is named is one from which it never ends, not one that may still get away.
    with pytest.raises(InputError, match="from state 0 this"):
        planning.evaluate(TRAP, [[1, 0]] * 3)
    np.testing.assert_allclose(planning.evaluate(TRAP, [[0.5, 0.5]] * 3), [-3, -1, 0])


def test_a_task_without_an_end_is_refused_at_gamma_1_alone():
    for solve in (
        planning.value_iteration,
        planning.policy_iteration,
        lambda env: planning.epsilon_soft(env, 0.1),
    ):
        with pytest.raises(InputError, match=r"FiniteMDP: from state 0 no .*policy ever ends.*gamma = 1"):
            solve(TREADMILL)
    np.testing.assert_allclose(planning.value_iteration(TREADMILL, 0.75)[0], [-4, -4])
    np.testing.assert_allclose(planning.epsilon_soft(TREADMILL, 0.1, 0.75)[1], [-4, -4])


def test_a_round_trip_that_pays_is_refused():
    env = deterministic([[0, 1], [1, 1]], [[1, 0], [0, 0]], terminal=[1])
    for solve in planning.value_iteration, planning.policy_iteration:
        with pytest.raises(InputError, match="from state 0 a round trip earns more than it costs"):
            solve(env)


def test_policy_value_looks_at_what_the_start_leads_to():
    # State 0 goes to the end; the policy never ends from state 1, which is not on the way.
    env = deterministic([[2, 1], [1, 2], [2, 2]], [[-1, -1], [-1, -1], [0, 0]], terminal=[2])
    assert planning.policy_value(env, [[1, 0], [1, 0], [1, 0]]) == -1
    assert planning.policy_value(env, [[0.5, 0.5], [1, 0], [1, 0]]) == -np.inf
    assert planning.start_value(env, np.array([-1, -np.inf, 0])) == -1


# --- what is measured inside a compiled run ----------------------------------------------------------


def tangle(trap):
    """Mostly deterministic, so that greedy policies loop; a free loop between 3 and 4; the end is 5.

    With `trap` all actions in state 2 stay there and cost.
    """
    moves = np.array([[1, 2], [0, 3], [2, 2] if trap else [3, 5], [4, 0], [3, 5], [5, 5]])
    p = np.eye(6)[moves]
    p[1, 1] = [0.25, 0, 0, 0.5, 0, 0.25]
    rewards = np.array([[-1, -1], [-1, -2], [-0.5, -4], [0, -1], [0, -1], [0, 0]], float)
    return FiniteMDP(p, rewards, terminal=[5])


@pytest.mark.slow
def test_measurer_agrees_with_the_exact_side_on_any_q():
    rng = np.random.default_rng(3)
    envs = tangle(trap=False), tangle(trap=True)
    optimal = {gamma: planning.value_iteration(envs[0], gamma)[1] for gamma in (0.75, 1.0)}
    qs = rng.integers(0, 3, size=(200, 6, 2)).astype(float)  # many ties
    qs[0], qs[1], qs[2] = 0, optimal[1.0], np.nan  # the last: a learner that diverged
    gammas = np.where(np.arange(200) % 4 == 3, 0.75, 1.0)
    one = lambda env, q, gamma: planning.measurer(env, gamma)(q)
    with jax.enable_x64():
        batch = jax.tree.map(lambda *x: np.stack(x), *envs)
        measure = jax.jit(jax.vmap(jax.vmap(one, (None, 0, 0)), (0, None, None)))
        value, error = (np.asarray(x) for x in measure(batch, qs, gammas))
    assert np.isnan(value[:, 2]).all()
    assert np.isnan(error[:, 2]).all()
    qs, gammas, value, error = (
        np.delete(x, 2, axis) for x, axis in ((qs, 0), (gammas, 0), (value, 1), (error, 1))
    )

    for i, env in enumerate(envs):
        policies = [planning.greedy_policy(q) for q in qs]
        expected = [doubled_value(env, *case) for case in zip(policies, gammas, strict=True)]
        assert 20 < np.isneginf(expected).sum() < 150
        np.testing.assert_allclose(value[i], expected, rtol=1e-9, atol=1e-9)
        for policy, gamma, x in zip(policies[:8], gammas, expected, strict=False):
            assert planning.policy_value(env, policy, gamma) == pytest.approx(x)
    expected = [abs(q - optimal[gamma])[:5].max() for q, gamma in zip(qs, gammas, strict=True)]
    np.testing.assert_allclose(error[0], expected, atol=1e-9)
    assert error[0, 1] < 1e-9
    np.testing.assert_array_equal(np.isnan(error[1]), gammas == 1)  # no finite Q* to compare with


@pytest.mark.slow
def test_measurer_in_float32_on_batched_winds():
    winds = np.array([[0, 0, 0, 1, 1, 1, 2, 2, 1, 0], [0] * 10, [0, 0, 0, 0, 0, 1, 1, 1, 0, 0]])
    envs = [WindyGridworld(wind=w) for w in winds]
    best = np.array([planning.value_iteration(env)[1] for env in envs])
    wrong = best + np.where(np.arange(4) == 0, 50, 0)  # always up
    nothing = np.zeros_like(best)
    batch = jax.tree.map(lambda *x: np.stack(x), *envs)
    measure = jax.jit(jax.vmap(lambda env, qs: jax.vmap(planning.measurer(env, 1.0))(qs)))
    value, error = measure(batch, np.stack([best, nothing, wrong], axis=1).astype(np.float32))
    assert value.dtype == jnp.float32
    uniform = np.full((70, 4), 0.25)
    for i, env in enumerate(envs):
        assert (value[i, 0], error[i, 0]) == (best[i, 30].max(), 0)
        assert value[i, 1] == pytest.approx(planning.evaluate(env, uniform)[30], rel=1e-3)
        assert error[i, 1] == -best[i].min()
        assert (value[i, 2], error[i, 2]) == (-np.inf, 50)


# --- what is refused ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (np.ones((3, 3)) / 3, r"of shape \(3, 3\), and the task has 3 states and 2 actions"),
        ([[1, 0], [0.5, 0.4], [1, 1]], r"state 1 are not a distribution: \[0.5 0.4\]"),
        ([[1, 0], [0, 1], [1.5, -0.5]], r"state 2 are not a distribution: \[ 1.5 -0.5\]"),
        ([[np.nan, 1], [0, 1], [1, 0]], "state 0"),
    ],
)
def test_what_is_no_policy_is_refused(policy, message):
    with pytest.raises(InputError, match=message):
        planning.evaluate(WAIT, policy)


def test_numbers_out_of_range_are_refused():
    q = np.zeros((3, 2))
    for call, message in (
        (lambda: planning.value_iteration(WAIT, gamma=1.1), "gamma must be between 0 and 1, not 1.1"),
        (lambda: planning.value_iteration(WAIT, tol=0), "tol must be greater than 0"),
        (lambda: planning.policy_iteration(WAIT, gamma=np.nan), "gamma must be"),
        (lambda: planning.epsilon_soft(WAIT, -0.1), "epsilon must be between 0 and 1, not -0.1"),
        (lambda: planning.epsilon_greedy_policy(q, 2), "epsilon must be"),
        (lambda: planning.start_value(WAIT, np.zeros(2)), "each of the 3 states"),
    ):
        with pytest.raises(InputError, match=message):
            call()


class Sampled:
    """An environment that does not state its dynamics."""

    num_states, num_actions, max_steps = 2, 1, 10

    def reset(self, key):
        return jnp.int32(0)

    def step(self, key, s, a):
        return Outcome(jnp.int32(1), jnp.float32(0), jnp.bool_(True))


class Unregistered(Sampled):
    """One that does, but is no pytree."""

    def initial(self):
        return jnp.array([1.0, 0.0])

    def outcomes(self, s, a):
        return jnp.ones(1), Outcome(jnp.ones(1, jnp.int32), jnp.zeros(1), jnp.ones(1, bool))


@pytree
class Given(Unregistered):
    """From state 0 to state 1, which is terminal; each number can be set wrong."""

    prob: float = 1.0
    s_next: int = 1
    reward_at_end: float = 0.0
    start: float = 1.0

    def initial(self):
        return jnp.array([self.start, 0.0])

    def outcomes(self, s, a):
        s_next, reward = jnp.asarray(self.s_next), jnp.where(s == 1, self.reward_at_end, -1.0)
        return jnp.asarray(self.prob)[None], Outcome(s_next[None], reward[None], jnp.ones(1, bool))


@pytest.mark.parametrize(
    ("env", "message"),
    [
        ("taxi", r"env must be an environment such as make\('windy-gridworld'\), not 'taxi'"),
        (Sampled(), "Sampled can only be sampled"),
        (Unregistered(), "Unregistered is not a JAX pytree"),
        (Given(prob=0.9), r"the outcomes of \(s, a\) = \(0, 0\) are not a distribution"),
        (Given(s_next=2), r"outcome of \(s, a\) = \(0, 0\) is not one of the states 0 to 1"),
        (Given(reward_at_end=1.0), "state 1 is terminal, so action 0 must lead back"),
        (Given(reward_at_end=np.nan), r"a reward of \(s, a\) = \(1, 0\) is not a finite number"),
        (Given(start=0.5), "start states are not a distribution"),
        (Given(prob=np.ones(2)), r"shape \[K\] each.* not a batch; they give \(1, 2\), \(1,\)"),
    ],
)
def test_an_environment_that_breaks_the_rules_is_refused(env, message):
    with pytest.raises(InputError, match=message):
        planning.value_iteration(env)


def test_what_can_only_be_sampled_cannot_be_measured():
    with pytest.raises(InputError, match="can only be sampled"):
        planning.measurer(Sampled(), 1.0)
    assert planning.value_iteration(Given())[0].tolist() == [-1, 0]


def test_a_program_that_closes_over_the_environment_changes_no_exact_value():
    """Broken once -> raises: the arrays of the environment handed on as they are, not as copies."""
    env = RandomWalk(states=5)
    outcomes = jax.jit(lambda env, s: env.outcomes(s, jnp.int32(0)), inline=True)
    run = jax.jit(lambda s: outcomes(env, s))  # lives to the end of this function
    run(3)
    np.testing.assert_allclose(planning.evaluate(env, np.ones((7, 1)))[1:6], np.arange(-2, 3) / 3, atol=1e-12)
