"""Gymnasium both ways: against plain value iteration on its own tables, its own checks, and round trips."""

import warnings

import gymnasium
import jax
import numpy as np
import pytest
import sampling
from gymnasium.utils.env_checker import check_env

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.interop import from_gymnasium, make, to_gymnasium

SLIPPERY = {"desc": ["SFF", "FHF", "FFG"], "success_rate": 0.5}


def plain_value_iteration(env, gamma=1.0):
    """v* of Gymnasium's own table, by loops: an outcome that is done has no future."""
    v = np.zeros(env.observation_space.n)
    for _ in range(5000):
        old = v.copy()
        for s, actions in env.unwrapped.P.items():
            v[s] = max(
                sum(p * (r + (0 if done else gamma * v[s_next])) for p, s_next, r, done in outcomes)
                for outcomes in actions.values()
            )
        if np.abs(v - old).max() < 1e-12:
            return v
    raise AssertionError("no convergence")


@pytest.mark.parametrize(
    ("name", "parameters", "max_steps", "from_the_start"),
    [
        ("FrozenLake-v1", {}, 100, 14 / 17),
        ("FrozenLake-v1", {"is_slippery": False}, 100, 1),
        ("FrozenLake-v1", SLIPPERY, 100, None),
        ("Taxi-v4", {}, 200, 7.93),
        ("CliffWalking-v1", {}, 10_000, -13),
        ("CliffWalking-v1", {"is_slippery": True, "max_episode_steps": 77}, 77, None),
    ],
)
def test_optimal_values_are_those_of_the_table(name, parameters, max_steps, from_the_start):
    theirs = gymnasium.make(name, **parameters)
    env = from_gymnasium(name, **parameters)
    assert (env.num_states, env.num_actions) == (theirs.observation_space.n, theirs.action_space.n)
    assert env.max_steps == max_steps
    v, _ = planning.value_iteration(env)
    counts = planning.reachable(planning.exact_model(env)) & ~env.is_terminal
    expected = plain_value_iteration(theirs)
    np.testing.assert_allclose(v[counts], expected[counts], atol=1e-8)
    assert (v[env.is_terminal] == 0).all()
    start = theirs.unwrapped.initial_state_distrib
    np.testing.assert_allclose(env.initial(), start, rtol=1e-6)
    if from_the_start is not None:
        assert start @ v == pytest.approx(from_the_start, abs=1e-6)


def test_terminal_states_go_by_the_done_flag():
    """The goal of the cliff is not absorbing in the table; of the taxi 404 states can be reached."""
    cliff = from_gymnasium("CliffWalking-v1")
    assert np.flatnonzero(cliff.is_terminal).tolist() == [47]
    assert gymnasium.make("CliffWalking-v1").unwrapped.P[47][3] == [(1, 36, -100, False)]
    taxi = from_gymnasium("Taxi-v4")
    assert taxi.is_terminal.sum() == 4
    assert planning.reachable(planning.exact_model(taxi)).sum() == 404


def test_equal_outcomes_are_added_up():
    """At the top left, two of three slips lead back; Gymnasium lists them one by one."""
    prob, outcome = from_gymnasium("FrozenLake-v1").outcomes(0, 0)
    listed = sorted((s, p) for p, s in zip(prob.tolist(), outcome.s_next.tolist(), strict=True) if p > 0)
    assert listed == [(0, pytest.approx(2 / 3)), (4, pytest.approx(1 / 3))]


class Odd(gymnasium.Env):
    """A table in which state 1 is entered with an end and without, and with different rewards."""

    observation_space, action_space = gymnasium.spaces.Discrete(2), gymnasium.spaces.Discrete(1)
    P = {  # noqa: RUF012
        0: {0: [(0.25, 1, 1.0, True), (0.25, 1, 3.0, True), (0.25, 1, 0.0, False), (0.25, 0, 0.0, False)]},
        1: {0: [(1.0, 0, 8.0, False)]},
    }
    initial_state_distrib = np.array([1.0, 0.0])


def test_a_state_that_ends_and_goes_on_gets_two_numbers():
    """Broken once -> fails: such a state terminal in all cases. Rewards on the same way are kept apart."""
    env = from_gymnasium(Odd())
    v, _ = planning.value_iteration(env)
    assert env.is_terminal.tolist() == [False, False, True]
    assert v == pytest.approx([6, 14, 0])  # v0 = (1 + 3 + (8 + v0) + v0) / 4
    prob, outcome = env.outcomes(0, 0)
    listed = {
        (s, r): p
        for p, s, r in zip(prob.tolist(), outcome.s_next.tolist(), outcome.reward.tolist(), strict=True)
    }
    assert listed == dict.fromkeys([(2, 1.0), (2, 3.0), (1, 0.0), (0, 0.0)], 0.25)


@pytest.mark.parametrize(
    ("given", "parameters", "message"),
    [
        (
            "FrozenLake-v9",
            {},
            "gymnasium: Environment version `v9` for environment `FrozenLake` doesn't exist",
        ),
        ("NoSuchLake-v1", {}, "gymnasium: Environment `NoSuchLake` doesn't exist"),
        ("FrozenLake-v1", {"slip": 1}, "FrozenLake-v1: .*slip"),
        ("Blackjack-v1", {}, "Blackjack-v1 has no table of its outcomes"),
        ("Taxi-v4", {"fickle_passenger": True}, "Taxi-v4: the moods of a fickle passenger"),
        (Odd(), {"slip": 1}, "slip: parameters go with the name"),
        (7, {}, "env must be the name of an environment of Gymnasium, or one, not 7"),
    ],
)
def test_what_is_wrong_is_said(given, parameters, message):
    with pytest.raises(rl.InputError, match=message):
        from_gymnasium(given, **parameters)


@pytest.mark.parametrize("name", ["taxi", "gym:Taxi-v4", "gymnasium:", ""])
def test_names_have_a_prefix(name):
    with pytest.raises(rl.InputError, match="is not of the form gymnasium:NAME or gymnax:NAME"):
        make(name)


def test_a_name_with_a_prefix():
    assert make("gymnasium:FrozenLake-v1", is_slippery=False).num_states == 16


# --- ours for them -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gusty():
    """Three gusts of wind, a time limit that is often met."""
    return rl.make(
        "windy-gridworld", stochastic=True, shape=(3, 4), wind=(0, 1, 1, 0), start=(2, 0), goal=(0, 3)
    )


@pytest.mark.parametrize("env", [rl.CliffWalking(), rl.make("blackjack"), rl.make("k-armed-testbed")])
def test_gymnasiums_own_check(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(to_gymnasium(env))


def test_round_trip(gusty):
    """The table of ours, imported again, is ours; also through gymnasium.make, which wraps it."""
    for theirs in (to_gymnasium(gusty), gymnasium.make(to_gymnasium(gusty).spec)):
        again = from_gymnasium(theirs)
        assert isinstance(again, FiniteMDP)
        assert again.max_steps == gusty.max_steps
        for gamma in (0.9, 1.0):
            for x, y in zip(*(planning.value_iteration(e, gamma) for e in (gusty, again)), strict=True):
                np.testing.assert_allclose(x, y, atol=1e-9)


def walk(env, num_steps, seed):
    """Transitions of a random walk by Gymnasium's rules, and how often it was terminated and truncated."""
    choose = np.random.default_rng(seed)
    s, _ = env.reset(seed=seed)
    seen, ends = [], np.zeros(2, int)
    for _ in range(num_steps):
        a = choose.integers(env.action_space.n)
        s_next, reward, terminated, truncated, _ = env.step(a)
        seen.append((s, a, reward, s_next))
        ends += terminated, truncated
        s = env.reset()[0] if terminated or truncated else s_next
    return *map(np.array, zip(*seen, strict=True)), ends


def test_what_happens_is_what_the_environment_states(gusty):
    env = rl.make(
        "windy-gridworld",
        **{f: getattr(gusty, f) for f in ("shape", "wind", "start", "goal")},
        stochastic=True,
        max_steps=10,
    )
    s, a, reward, s_next, (terminated, truncated) = walk(to_gymnasium(env), 4000, seed=0)
    p = sampling.p_value_of_transitions(planning.exact_model(env), s, a, reward, s_next)
    assert p > 0.001
    assert (s_next == 3).sum() == terminated > 50
    assert 400 > truncated > 50


def test_seeds_make_it_reproducible(gusty):
    first, again, other = (walk(to_gymnasium(gusty), 200, seed)[3] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_use_is_checked(gusty):
    env = to_gymnasium(gusty)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(rl.InputError, match="action must be one of 0 to 3, not 4"):
        env.step(4)
    with pytest.raises(rl.InputError, match="env must be an instance, such as CliffWalking"):
        to_gymnasium("cliff-walking")  # pyright: ignore[reportArgumentType]


def test_q_learning_learns_the_lake():
    """What is imported is an environment like any other."""
    env = from_gymnasium("FrozenLake-v1", is_slippery=False)
    method = rl.QLearning(alpha=0.5, epsilon=0.5, gamma=0.9)
    run = jax.jit(jax.vmap(lambda key: rl.train(key, method, env, num_steps=10_000, log_every=10_000)[0].q))
    q = run(jax.random.split(jax.random.key(0), 20))
    np.testing.assert_allclose(q[:, 0].max(1), 0.9**5, rtol=1e-4)
