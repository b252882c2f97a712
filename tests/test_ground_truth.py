"""Published and independently simulated numbers (fixed seeds; tolerances in standard errors).

Those of figures come out in test_figures.
"""

import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning


def within(got, want, errors=3.0):
    """`got` [seeds] has mean `want`, to so many of its standard errors."""
    error = np.std(got, ddof=1) / np.sqrt(len(got))
    assert abs(np.mean(got) - want) < errors * error, f"{np.mean(got)} +- {error}, not {want}"


@pytest.fixture(scope="module")
def sarsa(windy):
    return rl.sweep(windy, rl.Sarsa, {"alpha": 0.5, "epsilon": 0.1}, num_seeds=200, num_steps=8000)


def test_windy_gridworld_sarsa_finishes_160_episodes_in_8000_steps(sarsa):
    """Book, example 6.5. Ten thousand seeds of a plain loop: 160.15, standard deviation 9.7."""
    episodes = sarsa.log.episodes.sum(-1)
    within(episodes, 160.15)
    assert 9.7 * 0.85 < episodes.std(ddof=1) < 9.7 * 1.15
    assert sarsa.optimal_value == -15


def test_windy_gridworld_sarsa_ends_at_episodes_of_26_steps_and_not_of_17(sarsa):
    late = slice(60, 80)  # steps 6000 to 8000
    lengths, episodes = (x[:, late].sum(-1) for x in (sarsa.log.lengths, sarsa.log.episodes))
    within(lengths / episodes - 25.9, 0, errors=4)


@pytest.mark.parametrize("method", ["q-learning", "expected-sarsa"])
def test_methods_find_what_is_optimal(method, windy):
    """With all actions explored the greedy policy of most runs ends up exact."""
    grid = {"alpha": 0.5, "epsilon": 0.1}
    q = rl.sweep(windy, method, grid, num_seeds=20, num_steps=20_000, log_every=20_000).q
    values = [planning.policy_value(windy, planning.greedy_policy(table)) for table in q]
    assert np.median(values) == pytest.approx(-15, rel=1e-5)
