"""How hard a task is to learn: closed forms, and plain loops over a random task."""

import json

import numpy as np
import pytest

from jaxrl_tab import planning
from jaxrl_tab.cli import main
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import FiniteMDP, FrozenLake, RandomWalk, WindyGridworld


def corridor(n, success):
    """Left or right in a row of n states without an end; a step goes nowhere with probability 1 - success."""
    p = np.zeros((n, 2, n))
    for s in range(n):
        for a, s_next in enumerate((max(s - 1, 0), min(s + 1, n - 1))):
            p[s, a, s_next] += success
            p[s, a, s] += 1 - success
    return FiniteMDP(p, np.eye(n)[:, -1:] * np.ones(2), terminal=[], start=0)


def ring(n, stay):
    """Stay with this probability, or go on, round and round."""
    p = stay * np.eye(n) + (1 - stay) * np.eye(n)[(np.arange(n) + 1) % n]
    return FiniteMDP(p[:, None], np.zeros((n, 1)), terminal=[], start=0)


# --- how far -----------------------------------------------------------------------------------------


def test_diameters_with_a_closed_form():
    """Broken once: the mean over states instead of the most -> fails."""
    assert planning.diameter(corridor(7, 1.0)) == pytest.approx(6)
    assert planning.diameter(corridor(7, 0.25)) == pytest.approx(6 / 0.25)
    assert planning.diameter(ring(5, 0.5)) == pytest.approx(4 / 0.5)
    assert planning.diameter(ring(1, 0.5)) == 0
    # A state that is never left: the others cannot be reached from it.
    caught = FiniteMDP(np.eye(2)[[[0, 1], [1, 1]]], np.zeros((2, 2)), terminal=[], start=0)
    assert planning.diameter(caught) == np.inf
    # From one side of the middle of a walk to the other end: it begins again and again, of which half do come there
    # first. From state i, T to the end n satisfies T(i) = 1 + (T(i - 1) + T(i + 1)) / 2 with T(0) = T(middle).
    n, middle = 5, 3
    system, ones = np.eye(n), np.ones(n)
    for i in range(n - 1):
        system[i, i + 1] -= 0.5
        system[i, i - 1 if i else middle - 1] -= 0.5
    system[n - 1], ones[n - 1] = np.eye(n)[n - 1], 0
    assert planning.diameter(RandomWalk(states=5)) == pytest.approx(np.linalg.solve(system, ones).max())


def test_the_diameter_is_that_of_plain_sweeps():
    rng = np.random.default_rng(0)
    n, actions = 5, 3
    p = rng.dirichlet(np.full(n, 0.4), size=(n, actions))
    env = FiniteMDP(p, np.zeros(p.shape), terminal=[], start=0)
    times = np.zeros((n, n))
    for goal in range(n):
        for _ in range(3000):
            times[goal] = 1 + (p @ times[goal]).min(1)
            times[goal, goal] = 0
    assert planning.diameter(env) == pytest.approx(times.max(), rel=1e-9)


# --- how close ---------------------------------------------------------------------------------------


def test_action_gaps_by_hand():
    """Broken once: rounding counted as a gap; states out of reach counted -> fails."""
    gaps = planning.action_gaps(WindyGridworld())
    v, q = planning.value_iteration(WindyGridworld())
    np.testing.assert_allclose(gaps.gap, v[:, None] - q, atol=1e-12)
    assert gaps.smallest == 1 and gaps.gap[gaps.state, gaps.action] == 1
    alone = planning.action_gaps(RandomWalk())
    assert (alone.smallest, alone.state, alone.action) == (np.inf, -1, -1)
    # Out of reach a gap does not count, however small it is.
    p = np.eye(3)[[[2, 2], [2, 2], [2, 2]]]
    env = FiniteMDP(p, np.array([[1, 0.25], [0, 1e-5], [0, 0]]), terminal=[2], start=0)
    assert planning.action_gaps(env)[1:] == (0.75, 0, 1)
    # The same sum in another order is no gap.
    p = np.array([[[0, 0.1, 0.2, 0.7], [0, 0.7, 0.2, 0.1]], *([row, row] for row in np.eye(4)[1:])])
    env = FiniteMDP(p, np.array([[3e9, 3e9], *[[0, 0]] * 3]), terminal=[1, 2, 3], start=0)
    assert planning.action_gaps(env).smallest == np.inf


# --- how long ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "stay"), [(2, 0.9), (5, 0.5), (4, 0.3)])
def test_the_second_eigenvalue_of_a_ring(n, stay):
    """stay + (1 - stay) exp(2 pi i / n); broken once: the third one -> fails."""
    found = planning.mixing(ring(n, stay), np.ones((n, 1)))
    second = max(abs(stay + (1 - stay) * np.exp(2j * np.pi * k / n)) for k in range(1, n))
    assert found.second_eigenvalue == pytest.approx(second)
    assert found.relaxation_time == pytest.approx(1 / (1 - second))
    chain, far, t = np.eye(n), 1.0, 0
    while far > 0.25:
        chain, t = (
            chain @ planning.from_state_to_state(m := planning.exact_model(ring(n, stay)), m.prob).toarray(),
            t + 1,
        )
        far = abs(chain - 1 / n).sum(1).max() / 2
    assert found.mixing_time == t


def test_what_never_forgets():
    """A fixed rhythm; two sets of states that are not left; and what forgets at once."""
    assert planning.mixing(ring(3, 0.0), np.ones((3, 1))).mixing_time == np.inf
    apart = FiniteMDP(np.eye(2)[[[0], [1]]], np.zeros((2, 1)), terminal=[], start=[0.5, 0.5])
    assert planning.mixing(apart, np.ones((2, 1))).second_eigenvalue == 1
    tossed = FiniteMDP(np.full((2, 1, 2), 0.5), np.zeros((2, 1)), terminal=[], start=0)
    found = planning.mixing(tossed, np.ones((2, 1)))
    assert found.mixing_time == 1 and found.second_eigenvalue == pytest.approx(0, abs=1e-12)
    with pytest.raises(InputError, match="distance"):
        planning.mixing(tossed, np.ones((2, 1)), distance=0)


def test_hardness_and_its_table(capsys):
    lake = FrozenLake()
    found = planning.hardness(lake)
    v = planning.value_iteration(lake)[0]
    assert found.states == 11
    assert found.steps == pytest.approx(planning.occupancy(lake, planning.policy_iteration(lake)[0]).sum())
    assert found.span == pytest.approx(v.max() - v[v > 0].min())
    assert planning.hardness(ring(3, 0.5), 0.9).steps == pytest.approx(10)
    assert planning.hardness(ring(3, 0.5)).steps == np.inf
    assert main(["solve", "frozen-lake", "--hardness"]) == 0
    out = capsys.readouterr().out
    for text in ("diameter", "40.9091", "smallest action gap", "0.0392157", "mixing time"):
        assert text in out
    assert main(["solve", "random-walk", "--hardness", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["hardness"]
    assert found["gaps"]["smallest"] == "infinite" and found["diameter"] == pytest.approx(196)
