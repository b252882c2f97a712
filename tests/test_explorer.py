"""What the report holds to look around in: numbers compared with those worked out from the results by hand."""

import base64
import dataclasses
import json
import re
import zlib

import numpy as np
import pytest
from exploring import decoded
from made_up import make_result

import jaxrl_tab as rl
from jaxrl_tab import report, stats
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.counted import Counted, TablesAndVisits
from jaxrl_tab.engine.part import compute
from jaxrl_tab.engine.sweep import prepare
from jaxrl_tab.experiment.again import RunAgain
from jaxrl_tab.methods import METHODS
from jaxrl_tab.show.explorer import chapter, packing, scores
from jaxrl_tab.show.explorer.measures import STATISTICS
from jaxrl_tab.show.explorer.over_time import OverTime, block, ranks
from jaxrl_tab.stats.columns import Methods

GROUP = 3  # rows of the log in a point of a curve: 100 rows, of which at most 40 points are made


def blocks_of(file):
    """The elements of a page that hold data, by their ids."""
    found = re.findall(
        r'<script type="[\w/]+" id="([\w-]+)">(.*?)</script>', file.read_text(encoding="utf-8")
    )
    return dict(found)


@pytest.fixture(scope="module")
def page(explored):
    found = blocks_of(explored[0])
    return json.loads(found["data-1"]), found


def floats(text, *shape):
    """float32 from a page, by the plainest way: the first bytes of all, the second, ..."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(4, -1)
    return np.array([planes[:, i].tobytes() for i in range(planes.shape[1])]).view("<f4").reshape(shape)


def merged(x):
    """Sums over groups of GROUP rows, of which the last may be shorter: [..., points]."""
    return np.stack([x[..., i : i + GROUP].sum(-1) for i in range(0, x.shape[-1], GROUP)], -1)


def test_curves_are_the_means_of_what_the_results_hold(explored, page):
    """Broken once: single runs from the wrong end of the ranks; groups of rows that overlap -> fails."""
    data, found = page
    ds = explored[1].datasets["windy-gridworld/q-learning"]
    q_learning = data["methods"][1]
    measures = [measure["key"] for measure in data["measures"]]
    assert measures == ["return", "length", "reward", "episodes"]
    points = len(q_learning["x"])
    assert points == 34
    assert q_learning["x"][:2] == [60, 120]
    assert q_learning["x"][-1] == 2000
    curves = floats(found["data-1-curves-1"], 3, 4, len(STATISTICS) + 5, points)
    reward = merged(ds.rewards.values) / merged(ds.steps.values)
    np.testing.assert_allclose(curves[:, 2, 0], reward.mean(1), rtol=1e-6)
    np.testing.assert_allclose(curves[:, 2, 5], np.median(reward, 1), rtol=1e-6)
    episodes = merged(ds.episodes.values).cumsum(-1)
    np.testing.assert_allclose(curves[:, 3, 0], episodes.mean(1), rtol=1e-6)
    ended = merged(ds.episodes.values)
    with np.errstate(invalid="ignore"):
        returns = merged(ds.returns.values.astype(float)) / np.where(ended > 0, ended, np.nan)
    enough = (ended > 0).sum(1) >= 0.9 * 8
    assert enough.any()
    assert not enough.all()
    shown = curves[:, 0, 0]
    np.testing.assert_array_equal(np.isfinite(shown), enough)
    np.testing.assert_allclose(shown[enough], np.ma.masked_invalid(returns).mean(1).data[enough], rtol=1e-6)
    np.testing.assert_array_equal(curves[:, 0, STATISTICS.index("n")], (ended > 0).sum(1))
    low, high = curves[:, 0, 1][enough], curves[:, 0, 2][enough]
    interval = stats.mean_interval(stats.learning_curve(stats.merge_rows(ds, 40)))
    np.testing.assert_allclose(low, interval.low.values[enough], rtol=1e-5)
    assert (high <= -15 + 1e-5).all()  # no mean return is above the optimum
    assert (curves[:, 0, 3][enough] <= low + 1e-5).all()  # for all points at once it is wider
    final = stats.score(ds).values
    for i in range(3):
        worst, best = np.argmin(final[i]), np.argmax(final[i])
        np.testing.assert_allclose(curves[i, 3, len(STATISTICS)], episodes[i, worst], rtol=1e-6)
        tied = np.flatnonzero(final[i] == final[i, best])
        assert any(np.allclose(curves[i, 3, -1], episodes[i, k], rtol=1e-6) for k in tied)
        assert q_learning["runs"][i][0] == worst


def test_scores_of_all_settings(explored, page):
    """Broken once: settings in the order of their ranks -> fails."""
    data, found = page
    ds = explored[1].datasets["windy-gridworld/sarsa"]
    names = [score["key"] for score in data["scores"]]
    assert names[:3] == ["score", "interim", "area"]
    assert names[-1] == "episodes"
    assert data["methods"][0]["axes"][0]["values"] == [0.3, 1.0]
    numbers = floats(found["data-1-scores-0"], 4, len(names), 4)
    for k, part in enumerate(stats.score_interval(ds)):
        np.testing.assert_allclose(numbers[:, 0, k], part.values.ravel(), rtol=1e-6)
    whole = ds.returns.values.astype(float).sum(-1) / ds.episodes.values.sum(-1)
    np.testing.assert_allclose(numbers[:, 1, 0], whole.mean(-1).ravel(), rtol=1e-6)
    np.testing.assert_allclose(numbers[:, -1, 0], ds.episodes.values.sum(-1).mean(-1).ravel(), rtol=1e-6)
    until = [name for name in names if name.startswith("until")]
    assert until
    level = float(until[0].removeprefix("until "))
    ended = merged(ds.episodes.values)
    with np.errstate(invalid="ignore", divide="ignore"):
        reached = np.where(ended > 0, merged(ds.returns.values.astype(float)) / ended, -np.inf) >= level
    times = np.where(reached, merged(ds.steps.values).cumsum(-1), np.inf).min(-1)
    at = names.index(until[0])
    np.testing.assert_array_equal(numbers[:, at, 0], np.median(times, -1).ravel())


def test_tables_over_time_are_those_of_the_same_runs(page):
    """A sweep that records its tables gives the same. Broken once: the first seeds in place of the ranks -> fails."""
    data, _ = page
    best = data["methods"][1]["best"]
    alpha = data["methods"][1]["axes"][0]["values"][best]
    env = rl.make("windy-gridworld")
    again = rl.sweep(
        env, rl.QLearning, {"alpha": alpha}, num_seeds=8, num_steps=2000, log_every=60,
        record=lambda state: {"table": state.q}, progress=False,
    )  # fmt: skip
    assert again.log.recorded is not None
    q = np.asarray(again.log.recorded["table"])
    shown, views, about = decoded(page, 1, best)
    assert (about["moments"], about["averaged"]) == (34, 8)
    half = about["step"] / 2 + 1e-9
    np.testing.assert_allclose(shown[0], q.mean(0, dtype=float), atol=half)
    np.testing.assert_allclose(shown[1], np.median(q, 0), atol=half)
    for view, seed in zip(views[2:], data["methods"][1]["runs"][best], strict=True):
        np.testing.assert_allclose(shown[views.index(view)], q[seed], atol=half)


@pytest.mark.parametrize("method", ["r-learning", "r-max", "psrl", "ucbvi"])
def test_methods_with_arrays_or_records_of_their_own_are_recorded(method):
    """Shapes alone. Broken once: what the method declares, with the state that has the counts, too -> fails."""
    env = "finite-horizon:5:river-swim" if method == "ucbvi" else "river-swim"
    (part,) = rl.Experiment(env, method, seeds=1, steps=20, log_every=10).parts().values()
    budget = dataclasses.replace(part.budget, record=TablesAndVisits(part.env.num_states))
    (needs,) = dataclasses.replace(part, configs=[Counted(part.configs[0])], budget=budget).needs
    _, log = needs.results
    table = (2, part.env.num_states, part.env.num_actions)
    assert {key: x.shape for key, x in log.recorded.items()} == {"table": table, "visits": table}


def test_other_settings_have_their_tables_at_the_end(explored, page):
    """Broken once: the first setting for all -> fails."""
    ds = explored[1].datasets["windy-gridworld/sarsa"]
    data, _ = page
    for setting in set(range(4)) - {data["methods"][0]["best"]}:
        shown, _, about = decoded(page, 0, setting)
        q = ds.q.values.reshape(4, 8, 70, 4)[setting]
        assert about["moments"] == 1
        np.testing.assert_allclose(shown[0, 0], q.mean(0, dtype=float), atol=about["step"] / 2 + 1e-9)
        np.testing.assert_allclose(
            shown[2, 0], q[data["methods"][0]["runs"][setting][0]], atol=about["step"] / 2 + 1e-9
        )


def test_what_is_exact_is_the_solution(page):
    """Broken once: off by 1 -> fails."""
    data, found = page
    exact = floats(found["data-1-exact"], 70, 4)
    np.testing.assert_allclose(exact, rl.planning.value_iteration(rl.make("windy-gridworld"))[1], rtol=1e-6)
    assert data["scene"]["grid"]["letters"] == [[30, "S"], [37, "G"]]
    assert data["scene"]["start"] == [30]


def test_greedy_sets_and_votes():
    """Three runs of one state: 0, 1 and a tie of both. Broken once: ties count as whole votes -> fails."""
    q = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], np.float32).reshape(3, 1, 1, 2)
    packed = block(OverTime(q), slice(None), [2, 0], 3)
    raw = packing.from_text(packed.text)
    views = 4
    sets = packing.unpacked_sets(raw[2 * views * 2 :][:3], (3, 1, 1, 2))[:, 0, 0]
    np.testing.assert_array_equal(sets, [[True, True], [True, True], [True, False]])  # the vote, and two runs
    assert raw[2 * views * 2 + 3 :] == bytes([100])  # half and half, for each of two actions
    uneven = block(OverTime(q[[0, 0, 1]]), slice(None), [0], 3)
    assert packing.from_text(uneven.text)[-1] == 67
    assert packed.numbers == 8


def test_numbers_survive_the_page():
    """Infinite and missing ones, too. Broken once: differences in 8 bits -> fails."""
    rng = np.random.default_rng(0)
    x = rng.normal(0, 30, (3, 5, 4)).cumsum(1)
    x[0, 2, 1], x[1, 0, 0], x[2, 4, 3] = np.nan, np.inf, -np.inf
    steps = packing.Steps.of(x)
    u = packing.codes(x, steps)
    again = packing.decoded(packing.unpacked_codes(packing.packed_codes(u), x.shape), steps)
    np.testing.assert_allclose(again, x, atol=steps.step / 2 + 1e-9)
    y = rng.normal(size=(2, 3)).astype(np.float32)
    np.testing.assert_array_equal(packing.unpacked_floats(packing.packed_floats(y), y.shape), y)
    sets = rng.random((7, 11)) < 0.5
    np.testing.assert_array_equal(packing.unpacked_sets(packing.packed_sets(sets), sets.shape), sets)


def test_few_runs_are_all_shown():
    assert ranks([4]) == {"only one": 4}
    assert ranks([2, 0, 1]) == {"worst": 2, "2. from below": 0, "best": 1}
    assert list(ranks(range(101)).values()) == [0, 25, 50, 75, 100]


def test_thresholds_lie_between_the_worst_and_the_best():
    assert scores.levels_of(np.array([-115.0, -15.0, np.nan]), cost=False) == [-17, -25, -45]
    assert scores.levels_of(np.array([0.1, 1.1]), cost=True) == [0.12, 0.2, 0.4]
    assert scores.levels_of(np.array([np.nan]), cost=False) == []


@pytest.fixture
def windy_set(windy):
    q = rl.planning.value_iteration(windy)[1]
    return make_result(windy, q).to_xarray()


def test_runs_that_are_not_the_same_again_are_left_out(windy, windy_set):
    """As on another kind of machine: the page tells it. Broken once: without the comparison -> fails."""
    methods = Methods.of({"sarsa": windy_set}, windy)

    def again_off_by(off):
        def again(name, setting, places, every, points):
            assert (name, every) == ("windy/sarsa", 1)
            table = windy_set.q.values[setting, places][:, None].repeat(20, 1)
            return OverTime(table + off, np.ones(table.shape, np.int32))

        return again

    for off, moments, text in ((0, 20, ""), (1, 1, "another kind of machine")):
        data = chapter.explorer("windy", methods, again=again_off_by(off)).data["methods"][0]
        assert data["tables"][data["best"]]["moments"] == moments
        assert text in data["missing"]
        assert bool(data["missing"]) == bool(text)


def test_what_one_method_lacks_beside_another_is_left_out(windy, windy_set):
    """A method without `probs` has no policy_value. Broken once: a score without its measure -> KeyError."""
    exact = windy_set.assign(greedy_value=windy_set.returns, policy_value=windy_set.returns)
    methods = Methods.of({"sarsa": exact, "own": exact.drop_vars("policy_value")}, windy)
    shown = [
        {one["key"] for one in chapter.explorer("windy", methods).data[kind]}
        for kind in ("measures", "scores")
    ]
    assert shown[0] >= {"greedy_value"} and shown[1] >= {"greedy_value end"}
    assert not any("policy_value" in key for key in shown[0] | shown[1])


@pytest.mark.slow
def test_of_many_settings_the_page_keeps_the_best(windy, windy_set, tmp_path):
    """10,000 settings are below 10 MB. Broken once: without those beside the best one -> fails."""
    n = 100
    axes = {"alpha": np.geomspace(0.01, 1, n), "epsilon": np.linspace(0, 1, n)}
    one = windy_set.isel(alpha=0, seed=[0, 1], drop=True)
    many = one.expand_dims(axes).assign_attrs(fixed='{"gamma": 1.0}')
    worse = 1 + many.epsilon + abs(np.log(many.alpha)) + 0.01 * many.seed
    many = many.assign(returns=(many.returns * worse).transpose(*many.returns.dims))
    file = report.write(tmp_path, {"windy/sarsa": many}, {"windy": windy}, {})
    assert file.stat().st_size < 10e6
    found = blocks_of(file)
    data = json.loads(found["data-1"])["methods"][0]
    assert data["best"] == 9900  # alpha = 1, epsilon = 0
    assert set(range(9900, 10000)) <= set(data["kept"])  # the other epsilons
    assert set(range(0, 10000, 100)) <= set(data["kept"])  # and the other alphas
    assert 200 < len(data["kept"]) < 1000
    assert len(floats(found["data-1-scores-0"], -1, 4)) % 10000 == 0
    assert len(data["tables"]) < 10000


@pytest.mark.parametrize("method", ["semi-gradient-td-lambda", "semi-gradient-sarsa"])
def test_what_is_recorded_of_features_are_values_of_states(method):
    """At the end it is what the results hold. Broken once: `Counted` without a `row` of its own -> fails."""
    budget = Budget(num_episodes=6, log_every=3)
    part = prepare(rl.RandomWalk(9), METHODS[method], {"features": "aggregation(3)"}, budget, num_seeds=2)
    over = RunAgain({"walk": part})("walk", 0, np.arange(2), 1)
    np.testing.assert_allclose(over.tables[:, -1], compute(part, np.arange(2)).q, rtol=1e-6)
    assert over.tables.shape[1:3] == over.visits.shape[1:3] == (2, 11)
