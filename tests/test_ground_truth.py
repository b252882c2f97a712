"""Published and independently simulated numbers (fixed seeds; tolerances in standard errors)."""

import numpy as np
import pytest

import jaxrl_tab as rl


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


@pytest.mark.slow
@pytest.mark.parametrize(("method", "want"), [("sarsa", -26.79), ("q-learning", -49.94)])
def test_cliff_walking_on_line(method, want):
    """Book, example 6.6: Q-learning learns the shorter path and falls; mean return of episodes 401 to 500."""
    cliff = rl.make("cliff-walking")
    result = rl.sweep(cliff, method, {"alpha": 0.5, "epsilon": 0.1}, num_seeds=400, num_episodes=500)
    within(result.log.returns[:, 400:].mean(-1), want)
    assert result.optimal_value == -13


def test_methods_find_what_is_optimal(windy):
    """With all actions explored and a step size that falls, the greedy policy of each ends up exact."""
    grid = {"alpha": 0.5, "epsilon": 0.1}
    for method in ("q-learning", "expected-sarsa"):
        result = rl.sweep(windy, method, grid, num_seeds=20, num_steps=50_000, log_every=50_000, exact=True)
        assert np.median(result.log.greedy_value) == pytest.approx(-15, rel=1e-5), method
