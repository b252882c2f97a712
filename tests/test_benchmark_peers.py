"""The peers in Numba learn what the book says, checked without Numba: their steps run as the Python they are.

A step is one function, so its run can be watched: what an update must have been is worked out from the table
before it, from S, A and S'.
"""

import importlib
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from benchmarks import problems
from jaxrl_tab import approx

STEPS = 2500
FLOATS = 280  # of a table
NAMES = ("benchmarks.numba_tools", "benchmarks.numba_windy", "benchmarks.numba_mountain_car")


@pytest.fixture
def peers(monkeypatch):
    """The module of the peers, imported where Numba compiles nothing."""
    fake = types.ModuleType("numba")
    fake.njit = lambda function=None, **_: function or (lambda f: f)
    fake.prange = range
    monkeypatch.setitem(sys.modules, "numba", fake)
    for name in NAMES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    with np.errstate(over="ignore"):  # words of 64 bits overflow, as they should
        yield importlib.import_module("benchmarks.numba_windy")
    for name in NAMES:
        sys.modules.pop(name, None)


def walk(peers, method, steps=STEPS):
    """(S, A, S', A', Q before, Q after) of each step of a lane; S' is the goal where an episode ends."""
    begin, step, numbers = peers.METHODS[method]
    successors = problems.windy_successors()
    q = np.zeros(numbers, np.float32)
    lane = begin(q, np.uint64(0))
    for _ in range(steps):
        s, a, before = int(lane[0]) // 4, int(lane[1]), q.copy()
        lane = step(q, lane)
        s_next = successors[s, a]
        assert int(lane[0]) // 4 == (problems.START if s_next == problems.GOAL else s_next)
        yield s, a, s_next, int(lane[1]), before, q.copy()
    assert lane[2] >= 5, "episodes, for their ends are what is hard"


def changed(before, after):
    return np.flatnonzero(before != after).tolist()


def test_expected_sarsa_learns_from_the_mean_over_actions(peers):
    """Broken once: OF_EACH without the division by 4 -> fails."""
    for s, a, s_next, _, before, after in walk(peers, "expected-sarsa"):
        q = before.astype(float).reshape(70, 4)
        greedy = q[s_next] == q[s_next].max()
        pi = 0.1 / 4 + 0.9 * greedy / greedy.sum()
        q[s, a] += 0.5 * (-1 + pi @ q[s_next] - q[s, a])
        np.testing.assert_allclose(after.reshape(70, 4), q, rtol=1e-5, atol=1e-6)


def test_double_q_learning_takes_the_best_action_of_one_table_and_its_value_of_the_other(peers):
    """Broken once: the value taken from the table that learns -> fails."""
    learned = [0, 0]
    for s, a, s_next, _, before, after in walk(peers, "double-q-learning"):
        tables = before.astype(float).reshape(2, 70, 4)
        entries = changed(before, after)
        if not entries:
            continue  # the target was the value already
        (entry,) = entries
        which = entry // FLOATS
        learned[which] += 1
        assert entry == which * FLOATS + 4 * s + a
        mine, other = tables[which], tables[1 - which]
        best = np.flatnonzero(mine[s_next] == mine[s_next].max())
        targets = mine[s, a] + 0.5 * (-1 + other[s_next, best] - mine[s, a])
        assert np.isclose(after[entry], targets, rtol=1e-5, atol=1e-6).any()
    assert min(learned) > 0.45 * sum(learned)


def test_double_q_learning_acts_by_the_sum_of_both_tables(peers):
    """A greedy action nine times in ten, and by chance in the tenth. Broken once: by Q1 alone -> fails."""
    greedy = 0
    for _, _, s_next, a_next, _, after in walk(peers, "double-q-learning"):
        row = after.reshape(2, 70, 4)[:, problems.START if s_next == problems.GOAL else s_next].sum(0)
        greedy += row[a_next] == row.max()
    assert greedy > 0.9 * STEPS


def test_n_step_sarsa_learns_from_four_rewards_and_the_value_after_them(peers):
    """The book's box (section 7.2) on the walk that the peer took. Step sizes are dyadic, so all is exact.

    Broken once: without THREE in the last updates, and with NONE kept at the end of an episode -> fails.
    """
    q, episode = np.zeros((70, 4)), []
    for s, a, s_next, a_next, _, after in walk(peers, "n-step-sarsa"):
        episode.append((s, a))
        terminal = s_next == problems.GOAL
        value = 0 if terminal else q[s_next, a_next]
        due = range(4, 0, -1) if terminal else [4] * (len(episode) >= 4)
        for k in due:  # the pair of k steps ago, which saw k rewards
            pair = episode[-k]
            q[pair] += 0.5 * (-k + value - q[pair])
        if terminal:
            episode = []
        np.testing.assert_allclose(after[:FLOATS].reshape(70, 4), q, rtol=1e-5, atol=1e-6)


def test_the_mountain_car_goes_its_way_and_learns(peers):
    """A hundred steps of somebody who pushes anyhow, beside our own task and features.

    Broken once: a second tiling moved along the speed by 1 instead of 3; the cosine of x -> each fails.
    """
    car = importlib.import_module("benchmarks.numba_mountain_car")
    ours, features = rl.MountainCar(), approx.TileCoding(8, 8, low=(-1.2, -0.07), high=(0.5, 0.07))
    rand = np.random.default_rng(0)
    points = rand.uniform((-1.2, -0.07), (0.5, 0.07), (100, 2)).astype(np.float32)
    actions = rand.integers(0, 3, 100)
    after = jax.vmap(ours.step, (None, 0, 0))(jax.random.key(0), points, jnp.asarray(actions, jnp.int32))
    ones = jax.vmap(features)(jnp.asarray(points)).ones
    w, tiles, rng = np.zeros(car.WEIGHTS, np.float32), np.zeros(8, np.uint32), car.generator(np.uint64(1))
    table = np.zeros((648, 3))
    for point, a, s_next, tile in zip(points, actions, after.s_next, ones, strict=True):
        np.testing.assert_allclose(car.drive(*point, np.uint64(a)), s_next, atol=3e-7)
        car.find_tiles(tiles, *point)
        np.testing.assert_array_equal(tiles, 3 * np.asarray(tile))
        best, value, rng = car.greedy(w, tiles, rng)
        q = table[tile].sum(0)
        assert q[int(best)] == pytest.approx(q.max(), abs=1e-5)
        assert value == pytest.approx(q.max(), abs=1e-5)
        car.learn(w, tiles, np.uint64(a), np.float32(-1))
        table[tile, a] += 0.5 / 8 * (-1 - q[a])
    np.testing.assert_allclose(w.reshape(648, 3), table, atol=1e-6)
    w[:] = 0
    ties = [int(car.greedy(w, tiles, car.generator(np.uint64(seed)))[0]) for seed in range(300)]
    assert np.bincount(ties).min() > 70
