"""Generalized policy iteration, iterate by iterate: beside plain loops over random tasks, and known numbers."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxrl_tab import planning
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs import CliffWalking, FiniteMDP, WindyGridworld
from jaxrl_tab.envs.base import Finite

STATES, ACTIONS = 5, 3  # one size: one compiled program
END = STATES - 1
ROUNDING = 1e-9

seeds = st.integers(0, 2**32 - 1)
gammas = st.sampled_from([0.5, 0.9, 1.0])
epsilons = st.sampled_from([0.0, 0.1, 0.5])


def tables(seed):
    """p [S, A, S'] and r [S, A, S'], by chance; the last state is terminal."""
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.ones(STATES), size=(STATES, ACTIONS))
    return p, rng.normal(size=p.shape)


def made(p, r):
    return FiniteMDP(p, r, terminal=[END], start=0)


def backed_up(p, r, v, gamma):
    """q [S][A], entry by entry."""
    q = np.zeros((STATES, ACTIONS))
    for s in range(STATES - 1):
        for a in range(ACTIONS):
            for s_next in range(STATES):
                q[s, a] += p[s, a, s_next] * (r[s, a, s_next] + gamma * v[s_next] * (s_next != END))
    return q


def solved(p, r, policy, gamma):
    """v_pi from a dense linear system over the states that are not terminal."""
    chain = np.einsum("sa,sat->st", policy, p)[:END, :END]
    reward = np.einsum("sa,sat,sat->s", policy, p, r)[:END]
    return np.append(np.linalg.solve(np.eye(END) - gamma * chain, reward), 0.0)


def plain(p, r, gamma, sweeps, epsilon, improvements):
    """(policy, v, q) of each iterate: improve, then evaluate, as in the boxes of the book's sections 4.3 and 4.4."""
    policy = np.full((STATES, ACTIONS), 1 / ACTIONS)
    v = np.zeros(STATES) if sweeps else solved(p, r, policy, gamma)
    for _ in range(improvements + 1):
        q = backed_up(p, r, v, gamma)
        yield policy.copy(), v, q
        for s in range(END):
            policy[s] = epsilon / ACTIONS
            policy[s, np.argmax(q[s])] += 1 - epsilon
        if sweeps is None:
            v = solved(p, r, policy, gamma)
        for _ in range(sweeps or 0):
            v = (policy * backed_up(p, r, v, gamma)).sum(1)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seeds, gammas, epsilons, st.sampled_from([None, 1, 3]))
def test_every_iterate_is_that_of_plain_loops(seed, gamma, epsilon, sweeps):
    """Broken once, each -> fails: q of the values before; the last evaluation left out; no epsilon."""
    p, r = tables(seed)
    found = planning.generalized_policy_iteration(made(p, r), gamma, sweeps=sweeps, epsilon=epsilon)
    assert found.settled and len(found.v) == len(found.policy) == len(found.q)
    expected = list(plain(p, r, gamma, sweeps, epsilon, len(found.v) - 1))
    for n, (policy, v, q) in enumerate(expected):
        np.testing.assert_allclose(found.policy[n], policy, atol=1e-12)
        np.testing.assert_allclose(found.v[n], v, rtol=ROUNDING, atol=ROUNDING)
        np.testing.assert_allclose(found.q[n], q, rtol=ROUNDING, atol=ROUNDING)
        assert found.start_value[n] == pytest.approx(v[0])
    best = planning.epsilon_soft(made(p, r), epsilon, gamma)[1]
    for n, (before, after) in enumerate(itertools.pairwise(expected), 1):
        change = after[1] - before[1]
        assert found.changed[n] == (abs(after[0] - before[0]).max(1) > 1e-12).sum()
        assert found.least_change[n] == pytest.approx(change.min(), abs=ROUNDING)
        assert found.largest_change[n] == pytest.approx(change.max(), abs=ROUNDING)
        assert found.error[n] == pytest.approx(abs(after[1] - best).max(), abs=ROUNDING)
    np.testing.assert_allclose(found.zigzag, list(way(p, r, gamma, epsilon, expected)), atol=ROUNDING)
    assert found.error[-1] < 1e-8


def way(p, r, gamma, epsilon, iterates):
    """The distances from both lines: of each pair of policy and values, and in between."""
    for n, (policy, v, q) in enumerate(iterates):
        best = epsilon * q.mean(1) + (1 - epsilon) * q.max(1)
        for acting in [policy] if n + 1 == len(iterates) else [policy, iterates[n + 1][0]]:
            step = (acting * q).sum(1)
            yield abs(step - v).max(), (best - step).max()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seeds, gammas, st.sampled_from([0.0, 0.02, 0.3, 1.0]), st.booleans())
def test_no_improvement_makes_any_state_worse_until_the_best_policy_of_its_kind(seed, gamma, epsilon, own):
    """The policy improvement theorem, from any soft policy. Broken once: the least of q as the best -> fails."""
    env, policy = made(*tables(seed)), None
    if own:
        chance = np.random.default_rng(seed).dirichlet(np.ones(ACTIONS), size=STATES)
        policy = epsilon / ACTIONS + (1 - epsilon) * chance
    found = planning.generalized_policy_iteration(env, gamma, epsilon=epsilon, policy=policy)
    assert (np.diff(found.v, axis=0) >= -ROUNDING).all() and (found.least_change[1:] >= -ROUNDING).all()
    assert (found.policy >= epsilon / ACTIONS - 1e-12).all()
    best, v, _ = planning.epsilon_soft(env, epsilon, gamma)
    np.testing.assert_allclose(found.v[-1], v, rtol=ROUNDING, atol=ROUNDING)
    if epsilon < 1:
        np.testing.assert_allclose(found.policy[-1][:END], best[:END], atol=1e-12)
    # What the greedy actions gain for a step is what is then wrong with the values: straight down in the picture.
    np.testing.assert_allclose(found.zigzag[1::2, 0], found.zigzag[:-1:2, 1], atol=1e-8)
    np.testing.assert_allclose(found.zigzag[1::2, 1], 0, atol=1e-8)
    np.testing.assert_allclose(found.zigzag[::2, 0], 0, atol=1e-12)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(seeds, gammas)
def test_one_sweep_is_value_iteration_and_many_are_policy_iteration(seed, gamma):
    env = made(*tables(seed))
    v, q, swept = planning.value_iteration(env, gamma, history=True)
    one = planning.generalized_policy_iteration(env, gamma, sweeps=1)
    again = np.zeros(STATES)
    for n in range(len(one.v)):
        np.testing.assert_array_equal(one.v[n], swept.v[n])
        np.testing.assert_allclose(one.v[n], again, rtol=1e-12, atol=1e-12)
        again = planning.optimality_backup(env, np.tile(again[:, None], ACTIONS), gamma).max(1)
    np.testing.assert_allclose(one.v[-1], v, atol=1e-8)
    np.testing.assert_allclose(one.q[-1], q, atol=1e-8)

    many = planning.generalized_policy_iteration(env, gamma, sweeps=400)
    exact = planning.generalized_policy_iteration(env, gamma, policy=many.policy[1])
    for n in range(len(exact.v)):
        np.testing.assert_array_equal(many.policy[n + 1], exact.policy[n])
        np.testing.assert_allclose(many.v[n + 1], exact.v[n], rtol=1e-9, atol=1e-9)
    policy, v, _, history = planning.policy_iteration(env, gamma, history=True)
    np.testing.assert_array_equal(history.policy[-1], policy)
    np.testing.assert_array_equal(history.v[-1], v)


def test_a_first_policy_that_never_ends_is_worth_minus_infinity_until_the_end_is_brought_in():
    """Ring by ring around the goal: after n improvements all states at most n steps away have values."""
    env = WindyGridworld()
    up = np.tile([1.0, 0, 0, 0], (70, 1))
    found = planning.generalized_policy_iteration(env, policy=up)
    steps = -planning.value_iteration(env)[0]
    for n in range(1, len(found.v)):
        assert np.isfinite(found.v[n][steps <= n]).all()
    assert np.isneginf(found.start_value[:15]).all() and found.start_value[15] == -15
    assert not np.isnan(found.zigzag).any() and (found.least_change[1:] == 0).all()
    # With the policy that takes any action all is finite, and one improvement is enough.
    usual = planning.generalized_policy_iteration(env)
    assert (
        np.isfinite(usual.v).all()
        and usual.start_value.tolist()[1:] == [-15]
        and usual.changed.tolist() == [0, 69]
    )
    discounted = planning.generalized_policy_iteration(env, 0.75, policy=up)
    assert np.isfinite(discounted.v).all() and discounted.v[0][30] == pytest.approx(-4)


def test_an_action_that_is_not_there_is_never_better_than_never_to_end():
    """Stay, go on, or what no state has: -inf is less than what stands for that. Broken once: taken -> fails."""

    @pytree
    class Stairs(Finite):
        num_states, num_actions, max_steps = 4, 3, 9

        def available(self, s):
            return jnp.arange(3) < 2

        def initial(self):
            return jnp.eye(4)[0]

        def outcomes(self, s, a):
            s_next = jnp.minimum(jnp.where(a == 0, s, s + 1), 3).astype(jnp.int32)[None]
            return jnp.ones(1), Outcome(s_next, jnp.where(s < 3, -1.0, 0.0)[None], s_next == 3)

    found = planning.generalized_policy_iteration(Stairs(), policy=[[1, 0, 0]] * 4)
    inf = np.inf
    assert found.v[:, :3].tolist() == [[-inf] * 3, [-inf, -inf, -1], [-inf, -2, -1], [-3, -2, -1]]
    assert (found.policy[..., 2] == 0).all()


def test_cliff_walking_is_learned_from_the_end_backwards():
    """By hand: at first the way along the top, 17 steps; then the cliff's edge is found, cell by cell from the goal."""
    found = planning.generalized_policy_iteration(CliffWalking())
    assert [round(x) for x in found.start_value[1:]] == [-17, -15, -15, -15, -15, -15, -15, -13]
    assert found.settled and len(found.changed) == 9


def test_waiting_for_nothing_looks_better_than_it_is_to_sweeps():
    """In state 0: wait for nothing, or take 1 and pay 3 afterwards. Waiting for ever is best, and worth 0."""
    moves, rewards = np.array([[0, 1], [2, 2], [2, 2]]), np.array([[0.0, 1], [-3, -3], [0, 0]])
    env = FiniteMDP(np.eye(3)[moves], rewards, terminal=[2])
    exact = planning.generalized_policy_iteration(env)
    assert exact.error[-1] == 0 and exact.policy[-1][0].tolist() == [1, 0]
    swept = planning.generalized_policy_iteration(env, sweeps=1)
    assert swept.settled and swept.v[-1][0] == 1 and swept.error[-1] == 1


def test_it_stops_after_so_many_improvements_and_says_that_it_has_not_settled():
    found = planning.generalized_policy_iteration(WindyGridworld(), sweeps=1, improvements=4)
    assert not found.settled and found.start_value.tolist() == [0, -1, -2, -3, -4]
    assert repr(found) == "<Iterates: 4 improvements, sweeps=1, not settled, largest error 11>"


def test_as_a_dataset(tmp_path):
    found = planning.generalized_policy_iteration(WindyGridworld(), sweeps=3)
    ds = found.to_xarray()
    assert dict(ds.sizes) == {"improvement": 8, "state": 70, "action": 4, "step": 15, "distance": 2}
    for name, x in found._asdict().items():
        if name not in ("sweeps", "settled"):
            np.testing.assert_array_equal(ds[name], x)
    ds.to_netcdf(tmp_path / "x.nc", engine="h5netcdf")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sweeps": 0}, "sweeps must be a whole number of at least 1, not 0"),
        ({"improvements": -1}, "improvements must be a whole number of at least 0, not -1"),
        ({"epsilon": 2}, "epsilon must be between 0 and 1, not 2"),
        ({"tol": 0}, "tol must be greater than 0, not 0"),
        ({"policy": [[1.0, 0]]}, "policy"),
        (
            {"policy": np.tile([1.0, 0, 0, 0], (70, 1)), "epsilon": 0.2},
            "policy takes action 1 in state 0 with probability 0, which is less than epsilon / A, with epsilon = 0.2",
        ),
    ],
)
def test_what_is_wrong_is_said(given, message):
    with pytest.raises(InputError, match=message) as error:
        planning.generalized_policy_iteration(WindyGridworld(), **given)
    assert "\n" not in str(error.value)


def test_what_does_not_fit_in_memory_is_refused(monkeypatch):
    from jaxrl_tab.exact import iterates

    monkeypatch.setattr(iterates.memory, "free", lambda: 40 * 70 * 9 * 8)
    with pytest.raises(InputError, match="ask for fewer improvements"):
        planning.generalized_policy_iteration(WindyGridworld(), sweeps=1)
    assert len(planning.generalized_policy_iteration(WindyGridworld(), sweeps=1, improvements=5).v) == 6
