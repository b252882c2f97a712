"""Methods over several tasks: normalised by what is exact, ranked, and compared, with intervals."""

import numpy as np
import pytest
import xarray as xr
from refusals import refused

import jaxrl_tab as rl
from jaxrl_tab import stats
from jaxrl_tab.show import over_tasks
from jaxrl_tab.stats.columns import Methods
from jaxrl_tab.stats.tasks import across_tasks

DIMS = ("method", "environment", "seed")


def test_what_is_random_is_exact():
    """In the two-state chain of `FiniteMDP` below one of two actions ends: two steps on average, at −1 each."""
    p = np.zeros((2, 2, 2))
    p[0, 0, 0] = p[0, 1, 1] = p[1, :, 1] = 1
    r = np.array([[-1.0, -1.0], [0.0, 0.0]])
    env = rl.FiniteMDP(p, r, start=0, terminal=[1])
    assert stats.random_value(env) == pytest.approx(-2)
    assert stats.random_value(env, 0.5) == pytest.approx(-1 / (1 - 0.25))
    x = xr.DataArray([-2.0, -1.5, -1.0, -3.0], dims="seed")
    np.testing.assert_array_equal(stats.normalised(x, -2.0, -1.0), [0, 0.5, 1, -1])
    refused(lambda: stats.normalised(x, -1.0, -1.0), "no scale has -1")


def test_ranks_and_improvement_by_hand():
    """Ranks of a: 1 and 2, then 1.5 (a tie) and 1. It wins 2 of the 4 pairs in the first task, then 3, with ties."""
    a, b = [[4, 1], [2, 3]], [[2, 3], [2, 2]]
    x = xr.DataArray(np.array([a, b], float), dims=DIMS, coords={"method": ["a", "b"]})
    rank = stats.mean_rank(x).estimate
    np.testing.assert_allclose(rank, [(1 + 2 + 1.5 + 1) / 4, (2 + 1 + 1.5 + 2) / 4])
    p = stats.mean_improvement(x)
    np.testing.assert_allclose(p.estimate, [[0.5, (0.5 + 0.75) / 2], [1 - (0.5 + 0.75) / 2, 0.5]])
    alone = [stats.probability_of_improvement(x[0, i], x[1, i]).estimate for i in range(2)]
    np.testing.assert_allclose(p.estimate[0, 1], np.mean(alone))
    np.testing.assert_allclose(p.low[0, 1], 1 - p.high[1, 0])
    assert p.low[0, 1] < p.estimate[0, 1] < p.high[0, 1]


def test_methods_over_tasks_of_a_sweep(windy):
    """Made-up runs of two methods in two tasks, one of which has no exact values in common: it is left out."""
    rng = np.random.default_rng(0)

    coords = {"seed": range(20), "row": range(10)}
    attrs = {"fixed": '{"gamma": 1.0}', "num_episodes": 10, "log_every": 1}

    def methods(env, means, optimal):
        datasets = {}
        for name, mean in means.items():
            shape = (20, 10)
            scores = mean + rng.normal(0, 1, (20, 1)) + np.zeros(shape)
            log = {"steps": np.ones(shape, int), "episodes": np.ones(shape, int), "returns": scores}
            log |= {"lengths": log["steps"], "rewards": scores}
            ds = xr.Dataset({key: (("seed", "row"), v) for key, v in log.items()}, coords)
            datasets[name] = ds.assign_attrs(attrs, optimal_value=optimal)
        return Methods(datasets, env)

    cliff = rl.CliffWalking()
    a = methods(windy, {"sarsa": -20, "q": -18, "alone": -15}, -15.0)
    b = methods(cliff, {"sarsa": -17, "q": -40}, -13.0)
    tasks = across_tasks({"windy": a, "cliff": b, "none": methods(cliff, {"sarsa": 0, "q": 0}, np.nan)})
    assert tasks.scores.sizes == {"method": 2, "environment": 2, "seed": 20}
    assert tasks.left_out.keys() == {"none", "windy/alone"}
    random = stats.random_value(windy)
    expected = (stats.score(a["sarsa"]) - random) / (-15 - random)
    np.testing.assert_allclose(tasks.scores.sel({"method": "sarsa", "environment": "windy"}), expected)
    pooled = np.sort(tasks.scores.sel({"method": "q"}).values.ravel())
    np.testing.assert_allclose(tasks.iqm.estimate.sel({"method": "q"}), pooled[10:30].mean())
    assert (tasks.mean_rank.estimate.sum() == 3) and (tasks.iqm.low < tasks.iqm.estimate).all()
    refused(lambda: across_tasks({"windy": a}), "two tasks or more are needed")
    assert repr(tasks) == "<Tasks: sarsa, q over windy, cliff>"
    assert f">{float(tasks.iqm.estimate.sel({'method': 'q'})):.4g} (" in tasks._repr_html_()
    best, worst = over_tasks.rows(tasks)
    p = float(tasks.improvement.estimate.sel({"method": "q", "other": "sarsa"}))
    assert (best[0], best[-1], worst[0], worst[-2]) == ("Sarsa", "–", "q", f"{p:.3f}")
    assert over_tasks.head(tasks)[-2] == "beats Sarsa"
    assert over_tasks.to_dict(tasks)["methods"]["q"]["improvement"]["sarsa"][0] == p
    assert sum("Left out" in note for note in over_tasks.notes(tasks, True)) == 2


@pytest.mark.slow
def test_so_often_the_intervals_hold():
    """Five tasks, ten seeds, a shift of half a standard deviation and shared luck: 95%, give or take 3.5%."""
    rng, runs, held = np.random.default_rng(0), 250, np.zeros(2)
    spread = np.arange(1, 6)[:, None]

    def draw(n):
        luck = rng.normal(0, 1, (5, n))
        return np.stack([0.6 * luck + 0.8 * rng.normal(0, 1, (5, n)) + shift for shift in (0.5, 0)]) * spread

    many = xr.DataArray(draw(4000), dims=DIMS)
    won = stats.probability_of_improvement(many[0], many[1]).estimate.mean()
    rank = 1 + (many[0] < many[1]).mean()
    for _ in range(runs):
        x = xr.DataArray(draw(10), dims=DIMS)
        p, r = stats.mean_improvement(x), stats.mean_rank(x)
        held += [p.low[0, 1] <= won <= p.high[0, 1], r.low[0] <= rank <= r.high[0]]
    assert (held / runs > 0.915).all() and (held / runs < 0.99).all(), held / runs
