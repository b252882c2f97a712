"""The loop: what a method is told at the end of an episode, and what the log adds up to."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import policies
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition
from jaxrl_tab.engine import by_lanes

N = 400


class Tape(NamedTuple):
    q: jax.Array  # [S, A], never learned: the driver takes its dtype
    n: jax.Array  # []
    seen: jax.Array  # [N, 7]: s, a, r, s_next, discount, last, and the A' that was given


@pytree
class Recorder:
    """A method that writes down every transition and acts at random."""

    gamma: float = 0.5

    def init(self, num_states, num_actions):
        return Tape(jnp.zeros((num_states, num_actions)), jnp.int32(0), jnp.zeros((N, 7)))

    def policy(self, key, state, s):
        return policies.sample(key, jnp.ones(state.q.shape[1]))

    def update(self, key, state, t: Transition):
        a_next = self.policy(key, state, t.s_next)
        line = jnp.stack([jnp.asarray(x, float) for x in (*t, a_next)])
        seen = state.seen.at[state.n].set(line)
        return state._replace(n=state.n + 1, seen=seen), a_next


def record(env, key=0, log_every=7):
    state, log = jax.jit(lambda key: rl.train(key, Recorder(), env, num_steps=N, log_every=log_every))(
        jax.random.key(key)
    )
    fields = [np.asarray(x) for x in state.seen.T]
    return Transition(*fields[:6]), fields[6], log


@pytest.fixture(scope="module")
def walk():
    """Five states between two ends, cut off after 4 steps: some episodes terminate, others do not."""
    return rl.RandomWalk(states=5, max_steps=4), *record(rl.RandomWalk(states=5, max_steps=4))


def test_termination_and_time_limit_are_told_apart(walk):
    """Broken once: bootstrapping through a terminal state, as if it were a time limit -> fails; a time limit
    that ends bootstrapping, as if it were terminal -> fails.
    """
    _, t, _, _ = walk
    terminal = np.isin(t.s_next, [0, 6])
    np.testing.assert_array_equal(t.discount, np.where(terminal, 0.0, 0.5))
    starts = np.flatnonzero(np.append(True, t.last[:-1] == 1))
    lengths = np.diff(np.append(starts, N))[:-1]
    cut = (t.last == 1) & ~terminal
    assert set(lengths) == {3, 4}  # 3 steps to an end, or cut at 4
    assert cut.any() and (t.last[terminal] == 1).all() and (t.discount[cut] == 0.5).all()


def test_s_next_is_the_state_before_the_reset(walk):
    """Broken once: S' taken after the automatic reset -> fails."""
    _, t, _, _ = walk
    ended = t.last[:-1] == 1
    assert (t.s[1:][ended] == 3).all()  # the middle: the reset happened
    assert set(t.s_next[:-1][ended]) > {0, 6}  # and S' does not know of it
    np.testing.assert_array_equal(t.s[1:][~ended], t.s_next[:-1][~ended])


@pytest.fixture(scope="module")
def windy_run(windy):
    return record(windy)


def test_the_action_that_update_gave_is_the_action_taken(windy_run):
    """Broken once: A' drawn again after Sarsa's update -> fails, and so do the plain loops of Sarsa."""
    t, a_next, _ = windy_run
    goes_on = t.last[:-1] == 0
    np.testing.assert_array_equal(t.a[1:][goes_on], a_next[:-1][goes_on])
    assert set(t.a) == {0, 1, 2, 3}


def test_the_log_adds_up_to_the_transitions(walk):
    _, t, _, log = walk
    ends = np.flatnonzero(t.last)
    begins = np.append(0, ends[:-1] + 1)
    rewards = [t.r[b : e + 1] for b, e in zip(begins, ends, strict=True)]
    returns = [sum(0.5**k * r for k, r in enumerate(episode)) for episode in rewards]
    row = np.arange(N) // 7
    for name, per_step in {
        "steps": np.ones(N),
        "episodes": t.last,
        "rewards": t.r,
        "lengths": np.bincount(ends, ends - begins + 1, N),
        "returns": np.bincount(ends, returns, N),
    }.items():
        np.testing.assert_allclose(getattr(log, name), np.bincount(row, per_step), err_msg=name)
    assert log.steps[-1] == N % 7 and log.steps.dtype == jnp.int32


def test_log_every_changes_nothing_but_the_rows(windy, windy_run):
    one, _, _ = record(windy, log_every=N)
    many, _, _ = windy_run
    for x, y in zip(one, many, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.fixture(scope="module")
def episodes(windy):
    """Four runs until 30 episodes are over, by one row an episode and by rows of 7."""

    def run(key, log_every):
        method = rl.Sarsa(alpha=0.5, epsilon=0.25)
        return rl.train(key, method, windy, num_episodes=30, log_every=log_every)

    keys = jax.random.split(jax.random.key(1), 4)
    return {n: jax.jit(jax.vmap(lambda key, n=n: run(key, n)))(keys) for n in (1, 7)}


def test_episodes_are_what_the_same_number_of_steps_gives(windy, episodes):
    """The two budgets are two ways to stop one run, so the learner is the same, also under vmap."""
    state, log = episodes[1]
    assert (log.episodes == 1).all()
    np.testing.assert_array_equal(log.steps, log.lengths)
    np.testing.assert_array_equal(log.returns, -log.lengths)
    steps = int(log.steps[2].sum())
    key = jax.random.split(jax.random.key(1), 4)[2]
    method = rl.Sarsa(alpha=0.5, epsilon=0.25)
    budget = {"num_steps": steps, "log_every": steps}
    again, by_steps = jax.jit(lambda key: rl.train(key, method, windy, **budget))(key)
    np.testing.assert_array_equal(again.q, state.q[2])
    assert by_steps.episodes.sum() == 30


def test_rows_of_several_episodes_are_sums_of_rows_of_one(episodes):
    (one_state, one), (seven_state, seven) = episodes[1], episodes[7]
    np.testing.assert_array_equal(one_state.q, seven_state.q)
    for name in ("steps", "episodes", "returns", "lengths", "rewards"):
        want = np.add.reduceat(np.asarray(getattr(one, name)), np.arange(0, 30, 7), axis=1)
        np.testing.assert_array_equal(getattr(seven, name), want)


@pytest.mark.slow
def test_exact_values_beside_the_log(windy):
    """The recorded numbers are those of the final table, computed again on the host in float64."""
    method = rl.QLearning(alpha=0.5, epsilon=0.1)
    v_star, q_star = rl.planning.value_iteration(windy)
    s_next = rl.planning.exact_model(windy).s_next
    come_to = {30}
    while (more := come_to | set(s_next[sorted(come_to)].ravel().tolist())) != come_to:
        come_to = more
    assert len(come_to) < 69  # the wind keeps some cells out of reach: they do not count
    budget = {"num_steps": 9000, "log_every": 3000, "exact": True}
    state, log = jax.jit(lambda key: rl.train(key, method, windy, **budget))(jax.random.key(0))
    policy = rl.planning.greedy_policy(np.asarray(state.q))
    want = rl.planning.policy_value(windy, policy)
    np.testing.assert_allclose(log.greedy_value[-1], want, rtol=1e-4)
    error = np.abs(state.q - q_star)[sorted(come_to - {37})].max()
    np.testing.assert_allclose(log.q_error[-1], error, rtol=1e-4)
    assert log.greedy_value.shape == log.steps.shape
    assert log.greedy_value.max() <= v_star[30] + 1e-3
    assert log.q_error[-1] < log.q_error[0]


@pytest.mark.parametrize(
    ("budget", "message"),
    [
        ({}, "give either a number of steps or one of episodes"),
        ({"num_steps": 10, "num_episodes": 1}, "give either a number of steps or one of episodes"),
        ({"num_steps": 0}, "num_steps must be a whole number of at least 1, not 0"),
        ({"num_steps": True}, "num_steps must be a whole number of at least 1, not True"),
        ({"num_episodes": 2.5}, "num_episodes must be a whole number of at least 1, not 2.5"),
        ({"num_steps": 10, "log_every": -1}, "log_every must be a whole number of at least 1, not -1"),
    ],
)
def test_bad_budgets_are_refused(windy, budget, message):
    with pytest.raises(rl.InputError, match=message):
        rl.train(jax.random.key(0), rl.Sarsa(), windy, **budget)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "q-learning"}, "algorithm must be an instance, such as QLearning(), not 'q-learning'"),
        ({"algorithm": "td"}, "algorithm must be an instance, such as TD(), not 'td'"),
        ({"algorithm": "sarsaa"}, "algorithm must be an instance, such as Sarsa(), not 'sarsaa'"),
        ({"algorithm": rl.Sarsa}, "algorithm must be an instance, such as Sarsa(), not the class"),
        ({"env": "cliff-walking"}, "env must be an instance, such as CliffWalking(), not 'cliff-walking'"),
        ({"key": 0}, "key must be a JAX key such as jax.random.key(0), not 0"),
        ({"key": None}, "key must be a JAX key such as jax.random.key(0), not None"),
        ({"key": np.zeros(2)}, "key must be a JAX key such as jax.random.key(0), not [0. 0.]"),
        (
            {"key": jax.random.split(jax.random.key(0), 3)},
            "key must be one key, not a batch of shape (3,): jax.vmap goes over its keys",
        ),
    ],
)
def test_names_classes_and_numbers_are_refused_where_instances_and_keys_are_wanted(windy, change, message):
    """Also by `learn`, `replay` and `collect`, which take no names either."""
    good = {"key": jax.random.key(0), "algorithm": rl.QLearning(), "env": windy} | change
    log = rl.Experience([0], [0], [0.0], [1], [True])
    key, method, env = good.values()
    calls = [lambda: rl.train(key, method, env, num_steps=1), lambda: rl.collect(key, method, env, 1)]
    if "env" not in change:
        calls.append(lambda: rl.learn(key, method, log, 2, 2))
        calls.append(lambda: rl.replay(key, method, log, 2, 2, num_updates=1))
    for call in calls:
        with pytest.raises(rl.InputError) as error:
            call()
        assert str(error.value).replace("behaviour", "algorithm") == message


def test_keys_of_the_old_kind_are_keys(windy):
    """The same run as with the new kind, alone and in a batch."""
    run = lambda key: rl.train(key, rl.Sarsa(), windy, num_steps=50, log_every=50)[0].q
    old = jax.random.PRNGKey(3)
    np.testing.assert_array_equal(run(old), run(jax.random.key(3)))
    np.testing.assert_array_equal(jax.jit(jax.vmap(run))(old[None])[0], run(old))


def test_rewards_that_float32_cannot_hold_are_refused():
    """They would be infinite. Exact values are computed in float64, which holds them."""
    p, r = np.zeros((2, 2, 2)), np.array([[-1, 1e39], [0, 0]])
    p[:, :, 1] = 1
    env = rl.FiniteMDP(p, r, terminal=[1])
    assert rl.planning.value_iteration(env)[0][0] == 1e39
    said = r"^FiniteMDP: reward holds 1e\+39, and float32 has numbers up to 3\.4e\+38 in size$"
    with pytest.raises(rl.InputError, match=said):
        rl.train(jax.random.key(0), rl.Sarsa(), env, num_steps=10)
    with pytest.raises(rl.InputError, match=said):
        rl.sweep(env, rl.Sarsa, num_seeds=2, num_steps=10)


def test_method_and_environment_may_stand_in_either_order(windy):
    """Broken once: without the exchange in `train`, and in `sweep` -> each fails."""
    key = jax.random.key(1)
    state, log = rl.train(key, rl.Sarsa(), windy, num_steps=50)
    other, again = rl.train(key, windy, rl.Sarsa(), num_steps=50)
    np.testing.assert_array_equal(state.q, other.q)
    np.testing.assert_array_equal(log.rewards, again.rewards)
    results = [rl.sweep(*pair, num_seeds=2, num_steps=50) for pair in ((windy, "sarsa"), (rl.Sarsa, windy))]
    np.testing.assert_array_equal(*(result.q for result in results))


def test_a_run_of_many_rows_that_xla_measures_is_left_to_xla(windy, monkeypatch):
    """A call of XLA in each row takes long. The bits are the same. Broken once: rows not counted -> fails."""

    def run():
        method, record = rl.Sarsa(alpha=0.37), lambda state: {"largest": state.q.max()}
        return rl.train(jax.random.key(0), method, windy, num_steps=50, log_every=1, record=record)

    few = run()
    monkeypatch.setattr(by_lanes, "MEASURED_ROWS", 49)
    monkeypatch.setattr(by_lanes, "kernel", None)  # whoever makes one fails
    for x, y in zip(jax.tree.leaves(few), jax.tree.leaves(run()), strict=True):
        np.testing.assert_array_equal(x, y)
