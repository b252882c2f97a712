"""The exact distribution over Q in tiny tasks: a formula worked by hand, and the simulator with 20 000 seeds."""

import numpy as np
import pytest
from marks import slow_but_first

import jaxrl_tab as rl
from jaxrl_tab.algorithms import distribution
from jaxrl_tab.algorithms.moments import control_distribution
from jaxrl_tab.core.errors import InputError

DOORS = rl.make("two-doors")


@pytest.mark.slow
def test_a_greedy_agent_is_locked_in_as_the_formula_says():
    """While both averages are 0 it opens the right door, which has a prize, with 1/2, or the left one for nothing."""
    greedy = rl.QLearning(alpha=rl.schedules.sample_average(), epsilon=0.0)
    for plays in (1, 3):
        found = control_distribution(DOORS, greedy, num_episodes=plays)
        assert found.prob.sum() == pytest.approx(1, abs=1e-12)
        assert len(np.unique(found.q, axis=0)) == len(found.q)
        locked = found.prob[(found.q[:, 0, 0] == 0) & (found.q[:, 0, 1] > 0)].sum()
        assert locked == pytest.approx((1 - 0.25**plays) * DOORS.lock_in_probability(), abs=1e-6)


TINY = rl.FiniteMDP(
    [[[0.5, 0.5, 0.0], [0.0, 0.25, 0.75]], [[0.5, 0.0, 0.5], [0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]] * 2],
    [[1.0, 2.0], [0.5, -1.0], [0.0, 0.0]],
    terminal=[2],
    start=[0.5, 0.5, 0.0],
    max_steps=3,
)


@pytest.mark.parametrize(
    "method",
    slow_but_first(
        [
            rl.Sarsa(alpha=0.5, epsilon=0.25),
            rl.DoubleQLearning(alpha=0.5, epsilon=0.5),
            rl.NStepSarsa(n=2, alpha=0.25),
        ]
    ),
    ids=repr,
)
def test_the_simulator_has_this_distribution(method):
    """Of each table that is likely enough, how many of 20 000 seeds have it; two episodes with a time limit of 3 steps.

    Broken once: a time limit that does not end the episode -> fails; each way as probable as any other
    -> fails.
    """
    found = control_distribution(TINY, method, num_episodes=2)
    fields = {name: getattr(method, name) for name in ("alpha", "epsilon", "n") if hasattr(method, name)}
    q = rl.sweep(TINY, type(method), fields, num_seeds=20_000, num_episodes=2).q
    tables, counts = np.unique(q.reshape(20_000, -1), axis=0, return_counts=True)
    known = {
        table.tobytes(): p for table, p in zip(found.q.reshape(len(found.q), -1) + 0, found.prob, strict=True)
    }
    seen = {table.tobytes(): n for table, n in zip(tables + 0, counts, strict=True)}
    assert seen.keys() <= known.keys()
    n, p = np.array([[seen.get(key, 0), p] for key, p in known.items()]).T
    np.testing.assert_array_less(abs(n - 20_000 * p), 4.5 * np.sqrt(20_000 * p) + 3)
    off = abs(q.mean(0, dtype=float) - found.mean)[:2]
    np.testing.assert_array_less(off, 4.5 * np.sqrt(found.variance[:2] / 20_000) + 1e-6)


@pytest.mark.parametrize(
    ("env", "method", "message"),
    [
        (DOORS, rl.QLearning, "an instance such as QLearning"),
        (DOORS, rl.MonteCarlo(exploring_starts=True), "starts episodes anywhere"),
        (TINY, rl.Sarsa(alpha=0.3), "more than 20 learners"),
    ],
)
def test_what_has_none_is_refused_in_a_line(env, method, message, monkeypatch):
    monkeypatch.setattr(distribution, "MOST", 20)
    with pytest.raises(InputError, match=message):
        control_distribution(env, method, num_episodes=9)
