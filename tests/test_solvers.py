"""Ways to the best values: backward induction, linear programs, accelerated sweeps, entropy; beside plain loops."""

import json

import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.cli import main
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import FiniteMDP, FrozenLake, RandomWalk, WindyGridworld

S, A, END = 6, 3, 5


def tables(seed, end=True):
    """p and r [S, A, S'] with zeros in both; the last state is terminal. State 4 is terrible and out of reach."""
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(S, 0.5), size=(S, A))
    p[:4, :, 4] = 0
    p[:, :, END] += 0.05
    p /= p.sum(2, keepdims=True)
    r = rng.normal(size=p.shape) * (rng.random(p.shape) < 0.7)
    r[4] = -1e6
    if end:
        p[END], r[END] = np.eye(S)[END], 0
    else:
        p[END] = p[0]
    return p, r


def made(p, r, end=True):
    return FiniteMDP(p, r, terminal=[END] if end else [], start=0)


def backed_up(p, r, v, gamma, end=True):
    """q, entry by entry."""
    q = np.zeros((S, A))
    for s, a, s_next in np.ndindex(S, A, S):
        if s != END or not end:
            q[s, a] += p[s, a, s_next] * (r[s, a, s_next] + gamma * v[s_next])
    return q


def best_values(p, r, gamma, end=True, sweeps=2000):
    v = np.zeros(S)
    reward, chain = np.einsum("sat,sat->sa", p, r), gamma * p * (np.arange(S) != END if end else 1)
    for _ in range(sweeps):
        v = (reward + chain @ v).max(1)
    return v


WAIT = FiniteMDP(np.eye(3)[[[0, 1], [2, 2], [2, 2]]], np.array([[0.0, 1], [-3, -3], [0, 0]]), terminal=[2])
"""In state 0: wait for nothing, or take 1 and pay 3 afterwards. Waiting for ever is best, and worth 0."""


# --- so many steps -----------------------------------------------------------------------------------


def test_backward_induction_is_that_of_a_plain_loop():
    """Broken once: v of the step itself instead of the next; gamma left out -> fails."""
    p, r = tables(0)
    found = planning.finite_horizon(made(p, r), 4, gamma=0.9)
    v = np.zeros(S)
    for t in reversed(range(4)):
        q = backed_up(p, r, v, 0.9)
        v = q.max(1)
        np.testing.assert_allclose(found.q[t], q, rtol=1e-12)
        np.testing.assert_allclose(found.v[t], v, rtol=1e-12)
        np.testing.assert_array_equal(found.policy[t].argmax(1)[:4], q.argmax(1)[:4])
    assert (found.v[4] == 0).all()


def test_what_is_best_depends_on_the_time_that_is_left():
    """1 at once, or 3 after two steps: with one step left the first is best."""
    env = FiniteMDP(np.eye(3)[[[2, 1], [2, 2], [2, 2]]], np.array([[1.0, 0], [3, 3], [0, 0]]), terminal=[2])
    found = planning.finite_horizon(env, 2)
    np.testing.assert_array_equal(found.policy[:, 0], [[0, 1], [1, 0]])
    np.testing.assert_array_equal(found.v[:, 0], [3, 1, 0])
    # Without an end, at gamma = 1: nothing is infinite in so many steps.
    walk = FiniteMDP(np.ones((1, 1, 1)), np.array([[-2.0]]), terminal=[])
    assert planning.finite_horizon(walk, 5).v[0, 0] == -10
    with pytest.raises(InputError, match="horizon must be a whole number of at least 1, not 0"):
        planning.finite_horizon(walk, 0)
    with pytest.raises(InputError, match="more than half of what is free"):
        planning.finite_horizon(RandomWalk(), 2**31 - 1)


# --- linear programs ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("gamma", "end"), [(0.9, True), (1.0, True), (0.9, False)])
def test_linear_programs_find_the_best_values_and_what_their_policy_does(gamma, end):
    """Broken once, each -> fails: no gamma in the flow; reduced costs without their sign."""
    p, r = tables(1, end)
    env = made(p, r, end)
    found = planning.linear_programming(env, gamma)
    expected = best_values(p, r, gamma, end)
    np.testing.assert_allclose(found.v, expected, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(planning.policy_value(env, found.policy, gamma), expected[0], atol=1e-7)
    # Strong duality; and the occupancy is that of a policy.
    assert found.value == pytest.approx(expected[0], abs=1e-7)
    assert (found.occupancy * np.einsum("sat,sat->sa", p, r)).sum() == pytest.approx(expected[0], abs=1e-7)
    occupancy = planning.occupancy(env, found.policy, gamma)
    np.testing.assert_allclose(found.occupancy.sum(1), occupancy, atol=1e-7)


def test_linear_programs_know_that_waiting_is_worth_0():
    """Broken once: no bound at states where one can wait -> v[0] is -2."""
    found = planning.linear_programming(WAIT)
    np.testing.assert_allclose(found.v, [0, -3, 0], atol=1e-9)
    np.testing.assert_array_equal(found.policy[0], [1, 0])
    assert found.value == 0


def test_no_way_finds_values_that_are_not_finite():
    treadmill = FiniteMDP(np.eye(2)[[[1], [0]]], -np.ones((2, 1)), terminal=[])
    for solve in (planning.linear_programming, planning.action_gaps, planning.accelerated_value_iteration):
        with pytest.raises(InputError, match="gamma"):
            solve(treadmill, 1.0)
    with pytest.raises(InputError, match="no episode ever ends"):
        planning.soft_value_iteration(treadmill, 0.1)


# --- sweeps ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["plain", "anderson", "anchored"])
@pytest.mark.parametrize("seed", [2, 3])
def test_sweeps_of_every_kind_come_to_the_best_values(by, seed):
    p, r = tables(seed)
    found = planning.accelerated_value_iteration(made(p, r), 0.9, by)
    expected = best_values(p, r, 0.9)
    assert found.settled and found.sweeps == len(found.residual) - 1
    np.testing.assert_allclose(found.v, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.error[0], abs(expected).max())


def test_plain_sweeps_and_anchored_ones_are_those_of_their_formulas():
    """Broken once: b_n of the sweep before -> fails."""
    p, r = tables(4)
    gamma, env = 0.8, made(p, r)
    expected = best_values(p, r, gamma)
    plain, anchored = np.zeros(S), np.zeros(S)
    errors = {"plain": [], "anchored": []}
    for n in range(1, 20):
        plain = backed_up(p, r, plain, gamma).max(1)
        weight = 1 / sum(gamma ** (-2 * i) for i in range(n + 1))
        anchored = (1 - weight) * backed_up(p, r, anchored, gamma).max(1)
        errors["plain"].append(abs(plain - expected).max())
        errors["anchored"].append(abs(anchored - expected).max())
    for by, of_loop in errors.items():
        found = planning.accelerated_value_iteration(env, gamma, by)
        np.testing.assert_allclose(found.error[1:20], of_loop, rtol=1e-9)


def test_anchored_sweeps_keep_the_bound_of_lee_and_ryu():
    """On a ring of states whose values plain sweeps carry round: the bound is below what plain sweeps come to."""
    n, gamma = 50, 0.999
    ring = np.eye(n)[(np.arange(n) + 1) % n][:, None, :]
    env = FiniteMDP(ring, np.eye(n)[:1].T, terminal=[])
    residual = {}
    for by in ("plain", "anchored"):
        found = planning.accelerated_value_iteration(env, gamma, by, max_sweeps=300)
        assert not found.settled and found.sweeps == 300
        residual[by] = found.residual[1:]
    power = gamma ** np.arange(2, 302)
    bound = (1 / gamma - gamma) * (1 + 2 * gamma - power) / (1 / power - power) * found.error[0]
    assert (residual["anchored"] <= bound).all()
    assert residual["anchored"][-1] < residual["plain"][-1] / 5


def test_anderson_needs_few_sweeps_where_plain_ones_need_many():
    lake = FrozenLake()
    sweeps = {by: planning.accelerated_value_iteration(lake, 0.99, by).sweeps for by in ("plain", "anderson")}
    assert sweeps["anderson"] < sweeps["plain"] / 10
    with pytest.raises(
        InputError, match="at gamma = 1 anderson sweeps may settle at values that no policy has"
    ):
        planning.accelerated_value_iteration(lake)
    # Plain sweeps from 0 settle above, at gamma = 1, and say how far.
    waiting = planning.accelerated_value_iteration(WAIT, by="plain")
    assert waiting.settled and waiting.error[-1] == 1


# --- entropy -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("temperature", "gamma"), [(0.1, 0.9), (2.0, 0.9), (0.05, 1.0)])
def test_soft_values_are_those_of_plain_sweeps(temperature, gamma):
    """Broken once: no entropy in the evaluation; softmax of q without its temperature -> fails."""
    p, r = tables(6)
    found = planning.soft_value_iteration(made(p, r), temperature, gamma)
    v, q = np.zeros(S), np.zeros((S, A))
    for _ in range(600):
        q = backed_up(p, r, v, gamma)
        v = temperature * np.log(np.exp((q - q.max(1, keepdims=True)) / temperature).sum(1)) + q.max(1)
        v[END] = 0
    np.testing.assert_allclose(found.v, v, rtol=1e-9, atol=1e-9)
    weight = np.exp((q - v[:, None]) / temperature)[:4]
    np.testing.assert_allclose(found.policy[:4], weight, rtol=1e-6, atol=1e-8)


def test_soft_values_tend_to_the_best_ones():
    env = WindyGridworld()
    v, _ = planning.value_iteration(env, 0.9)
    for temperature in (1e-1, 1e-4, 1e-12):
        over = planning.soft_value_iteration(env, temperature, 0.9).v - v
        assert over.min() > -1e-12 and over.max() < 10 * temperature * np.log(4) + 1e-12
    np.testing.assert_allclose(
        planning.soft_value_iteration(RandomWalk(), 5.0).v,
        planning.evaluate(RandomWalk(), np.ones((21, 1))),
        atol=1e-12,
    )


def test_wandering_that_earns_more_than_it_costs_is_refused():
    """Each step costs 1, and four actions earn log 4 times the temperature: above .72 nobody would ever end."""
    assert planning.soft_value_iteration(WindyGridworld(), 0.2).v[30] < -14
    with pytest.raises(
        InputError, match="at temperature 1 and gamma = 1 the soft values are not finite: to wander"
    ):
        planning.soft_value_iteration(WindyGridworld(), 1.0)
    with pytest.raises(InputError, match="temperature must be greater than 0"):
        planning.soft_value_iteration(WindyGridworld(), 0.0)


# --- on the command line -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ("policy-iteration", "Policy iteration: 2 improvements"),
        ("value-iteration", "Value iteration from v = 0: 703 sweeps; values are at most"),
        ("modified", "with 5 sweeps of evaluation after each; values are"),
        ("anderson", "sweeps (value iteration without it: 703); values are"),
        ("anchored", "(value iteration without it: 703)"),
        ("linear-programming", "no occupancy earns more than 0.542026, which is"),
    ],
)
def test_solve_says_what_each_way_took(way, said, capsys):
    assert main(["solve", "frozen-lake", "--gamma", "0.99", "--by", way]) == 0
    out = capsys.readouterr().out
    assert said in out and "value from the start 0.542026" in out


def test_solve_with_a_horizon_and_with_entropy(capsys):
    assert main(["solve", "frozen-lake", "--horizon", "20"]) == 0
    out = capsys.readouterr().out
    assert "ended after 20 steps: value from the start 0.199133" in out
    assert "In 4 states another action is best when less time is left" in out
    assert main(["solve", "frozen-lake", "--horizon", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert np.shape(found["q"]) == (3, 16, 4) and found["start_value"][0] == 0
    assert main(["solve", "frozen-lake", "--temperature", "0.1", "--gamma", "0.9", "--json"]) == 0
    soft = json.loads(capsys.readouterr().out)["entropy_soft"]
    v = planning.soft_value_iteration(rl.make("frozen-lake"), 0.1, 0.9).v
    np.testing.assert_allclose(soft["v"], v)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ("--by anderson", "at gamma = 1 anderson sweeps may settle at values that no policy has"),
        (
            "--by modified --steps",
            "--steps shows policy iteration step by step, and --by modified does it unseen",
        ),
        ("--sweeps 3 --by anderson", "give both, or --by modified"),
        ("--horizon 0", "horizon must be a whole number of at least 1, not 0"),
        (
            "--horizon 3 --epsilon 0.1",
            "--horizon is a task of its own, solved by backward induction; leave --epsilon",
        ),
        ("--temperature 0", "temperature must be greater than 0"),
    ],
)
def test_solve_says_in_a_line_what_does_not_go(argv, said, capsys):
    assert main(["solve", "frozen-lake", *argv.split()]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
