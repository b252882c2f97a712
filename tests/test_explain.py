"""Where methods lose: the numbers beside those of `planning` run by run, the sentences, the command, and the report."""

import dataclasses
import json
import re
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest
from marks import slow_but

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.cli import main
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.engine import acting
from jaxrl_tab.exact.losses import Losses, losses
from jaxrl_tab.show.explained import Explained

CLIFF = rl.make("cliff-walking")


def one(result):
    (explained,) = result.explain().values()
    return explained


# --- the numbers -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cliff():
    """Sarsa and Q-learning, 12 seeds, by two step sizes."""
    budget = {"num_seeds": 12, "num_steps": 8000}
    return {cls: rl.sweep(CLIFF, cls, {"alpha": [0.5, 0.1]}, **budget) for cls in (rl.Sarsa, rl.QLearning)}


@pytest.mark.parametrize("cls", [rl.Sarsa, rl.QLearning])
def test_what_is_told_is_the_mean_of_what_each_run_loses(cls, cliff):
    """Broken once: the tables of another setting -> fails; the share of exploring among greedy actions -> fails."""
    result, explained = cliff[cls], one(cliff[cls])
    best = result.grid["alpha"].index(explained.setting["alpha"])
    assert explained.setting == rl.stats.best(result.to_xarray())
    assert (explained.optimum, explained.seeds) == (-13, 12)
    assert explained.least == pytest.approx(20.7077 - 13, abs=5e-5)
    for found, policy_of in (
        (explained.acting, lambda q: planning.epsilon_greedy_policy(q, 0.1)),
        (explained.greedy, planning.greedy_policy),
    ):
        policies = [policy_of(q) for q in result.q[best].astype(float)]
        values = np.array([planning.policy_value(CLIFF, policy) for policy in policies])
        np.testing.assert_allclose(found.lost, -13 - values, rtol=1e-9, atol=1e-9)
        ended = np.isfinite(values)
        assert found.endless == (~ended).sum()
        maps = [planning.action_regret_map(CLIFF, policy) for policy in np.array(policies)[ended]]
        np.testing.assert_allclose(found.by_action, np.mean(maps, 0), rtol=1e-9, atol=1e-12)
        visits = [planning.occupancy(CLIFF, policy) for policy in np.array(policies)[ended]]
        np.testing.assert_allclose(found.visits, np.mean(visits, 0), rtol=1e-9, atol=1e-12)
        exploring = [
            planning.action_regret_map(CLIFF, policy)[q < q.max(1, keepdims=True)].sum()
            for policy, q in zip(policies, result.q[best], strict=True)
            if np.isfinite(planning.policy_value(CLIFF, policy))
        ]
        np.testing.assert_allclose(found.exploring[ended], exploring, rtol=1e-9, atol=1e-12)
    assert (explained.greedy.exploring == 0).all()


def test_states_are_named_and_add_up(cliff):
    explained = one(cliff[rl.QLearning])
    places = explained.places(explained.acting)
    assert places[0].name == "(3, 0)"
    assert sum(place.share for place in places) == pytest.approx(1)
    assert sum(place.lost for place in places) == pytest.approx(explained.acting.lost.mean())
    lost = [place.lost for place in places]
    assert lost == sorted(lost, reverse=True)
    fall = next(place for place in places if place.name == "(2, 1)")
    assert next(iter(fall.actions)) == "↓"
    assert sum(fall.actions.values()) == pytest.approx(1)


# --- the policy that acts ----------------------------------------------------------------------------

BY_Q = [
    rl.Sarsa(epsilon=rl.schedules.glie()),
    rl.QLearning(behaviour=rl.policies.Softmax(rl.schedules.parse("power:0.5:episode"))),
    rl.MonteCarlo(alpha=0.1, epsilon=rl.schedules.parse("harmonic:3:episode")),
    rl.SarsaLambda(epsilon=0.3),
    rl.DoubleQLearning(behaviour=rl.policies.EpsilonGreedy(0.2)),
    rl.NStepSarsa(epsilon=rl.schedules.parse("harmonic:200:step")),
]
BY_VISITS = [
    rl.Sarsa(behaviour=rl.policies.UCB(2.0)),
    rl.Sarsa(epsilon=rl.schedules.parse("harmonic:2:visit")),
    rl.MonteCarlo(epsilon=rl.schedules.glie(), batch=4),
]
WALKS = rl.make("windy-gridworld", shape=(3, 4), wind=(0, 1, 0, 0), start=(1, 0), goal=(1, 3))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("method", slow_but([*BY_Q[:2], BY_VISITS[1]], [*BY_Q, *BY_VISITS]), ids=repr)
def test_the_policies_that_act_are_those_of_the_learners(method):
    """After 30 episodes. Broken once: the clock of an episode less -> fails; no rerun of batches -> fails."""
    fields = {f.name: getattr(method, f.name) for f in dataclasses.fields(method)}
    if of_method(method).behaviour is not None:
        del fields["epsilon"]
    result = rl.sweep(WALKS, type(method), fields, num_seeds=3, num_episodes=30)
    assert acting._by_q(method) == any(method is other for other in BY_Q)
    steps, episodes = (x.sum(-1) for x in (result.log.steps, result.log.episodes))
    found = acting.acting(result.part, 0, np.arange(3), result.q, steps, episodes)
    for i in range(3):
        learner, _ = rl.train(jax.random.fold_in(jax.random.key(0), i), method, WALKS, num_episodes=30)
        probs = jax.vmap(lambda s, learner=learner: method.probs(learner, s))(np.arange(12))
        np.testing.assert_allclose(found[i], probs, rtol=1e-6)


def test_a_method_that_does_not_tell_its_probabilities_is_explained_by_its_greedy_policies(
    cliff, monkeypatch
):
    result = cliff[rl.QLearning]
    monkeypatch.setattr(acting, "fitted", lambda *_: object())
    explained = one(result)
    assert explained.acting is None
    assert explained.main is explained.greedy
    assert explained.sentences[0] == "The greedy policies of all 12 seeds lose nothing: they are optimal."


def test_what_cannot_be_told_is_left_out_in_a_sentence():
    testbed = rl.sweep(rl.make("k-armed-testbed"), rl.QLearning, num_seeds=2, num_steps=50).explain()
    walk = rl.sweep(rl.make("random-walk"), rl.prediction.TD, num_seeds=2, num_episodes=5).explain()
    for explanation, why in ((testbed, "one problem for all runs"), (walk, "learns no policy")):
        assert not explanation
        (line,) = explanation.left_out
        assert why in line
        assert str(explanation) == line


def test_diverged_runs_are_left_out():
    result = rl.sweep(CLIFF, rl.Sarsa, {"alpha": [0.5]}, num_seeds=4, num_steps=500)
    q = result.q.copy()
    q[0, 1] = np.nan
    assert one(dataclasses.replace(result, q=q)).seeds == 3


# --- sentences ---------------------------------------------------------------------------------------


def made_up(by_action, lost, exploring=None, caught=None, **more):
    by_action = np.asarray(by_action, float)
    lost = np.asarray(lost, float)
    exploring = np.zeros(len(lost)) if exploring is None else np.asarray(exploring, float)
    caught = np.zeros(len(by_action), int) if caught is None else np.asarray(caught)
    return Losses(lost, exploring, by_action, np.ones(len(by_action)), caught)


def explained_of(acting_losses, greedy, seeds=4, least=0.5):
    env = rl.FiniteMDP(np.full((7, 2, 7), 1 / 7), np.ones((7, 2)))
    return Explained("mine", "sarsa", env, {"alpha": 0.5}, -13.0, seeds, acting_losses, greedy, least)


def test_the_sentences_say_what_the_numbers_say():
    by_action = np.zeros((7, 2))
    by_action[[1, 3, 4], [0, 1, 1]] = 1.5, 0.25, 0.25
    best = made_up(np.zeros((7, 2)), [0, 0, 0, 0])
    loses = made_up(by_action, [2, 2, 1, 3], [0.5, 0.5, 0.5, 0.5])
    told = explained_of(loses, best).sentences
    assert told[0].startswith("As it acts in the end it earns 2.00 less than the best policy")
    assert "mean over 4 seeds" in told[0]
    assert told[1] == (
        "25% of that is lost by exploring, 75% by the actions that it holds for the best; a policy that explores as "
        "much loses 0.5 at the least."
    )
    assert told[2] == "75% of it is lost in 1 of 7 states: 1 (75%)."
    assert told[3] == "Without exploring, the greedy policies of all 4 seeds lose nothing: they are optimal."


def test_of_policies_that_go_round_for_ever_it_is_said_where():
    by_action = np.zeros((7, 2))
    by_action[2, 1] = 3
    caught = [0, 2, 0, 0, 0, 1, 0]
    told = explained_of(None, made_up(by_action, [3, np.inf, np.inf, 3], caught=caught)).sentences
    assert told == [
        "Greedy policies of 2 of 4 seeds may go round for ever, and lose without bound; the states in which the most "
        "are caught: 1 (2), 5 (1).",
        "The greedy policies of the other 2 seeds lose 3.00 on average.",
        "All of it is lost in 1 of 7 states: 2 (100%).",
    ]
    (told,) = explained_of(None, made_up(0 * by_action, [np.inf] * 4, caught=[4] + 6 * [0])).sentences
    assert "4 of 4 seeds" in told


def test_many_states_are_counted_and_the_first_are_named():
    by_action = np.zeros((7, 2))
    by_action[:, 0] = [7, 6, 5, 4, 3, 2, 1]
    told = explained_of(None, made_up(by_action, [28] * 4)).sentences
    assert told[1] == "79% of it is lost in 4 of 7 states: 0 (25%), 1 (21%), 2 (18%) and 3 (14%)."
    even = np.ones((7, 2))
    told = explained_of(None, made_up(even, [14] * 4)).sentences
    assert told[1] == "86% of it is lost in 6 of 7 states, most in 0 (14%), 1 (14%) and 2 (14%)."


def test_losses_of_the_best_policy_are_nothing_but_rounding():
    q = planning.value_iteration(CLIFF)[1]
    found = losses(CLIFF, 1.0, [(planning.greedy_policy(q), q == q.max(1, keepdims=True))])
    explained = explained_of(found, found, seeds=1)
    assert explained.places(found) == []
    assert (
        explained.sentences[0]
        == "As it acts in the end it loses nothing: its policy is optimal (mean over 1 seed)."
    )


# --- the command, and the report ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A sweep of two methods in two environments of another kind, with its files."""
    path = tmp_path_factory.mktemp("explain") / "run"
    experiment = rl.Experiment(
        ["cliff-walking", "blackjack"],
        [{"name": "sarsa", "alpha": [0.1, 0.5]}, {"name": "q-learning", "alpha": 0.1}],
        seeds=4,
        steps=3000,
    )
    return path, rl.run(experiment, path, progress=False, formats=())


def test_the_command_says_what_python_says(folder, capsys, tmp_path):
    path, outcome = folder
    expected = outcome.explain()
    assert main(["explain", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["left_out"] == []
    assert told["methods"] == json.loads(json.dumps([one.to_dict() for one in expected.values()]))
    assert {one["environment"] for one in told["methods"]} == {"cliff-walking", "blackjack"}
    first = told["methods"][0]["acting"]
    assert sum(place["lost"] for place in first["states"]) == pytest.approx(first["lost"])
    assert main(["explain", str(path), "--out", str(tmp_path / "maps")]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert expected["cliff-walking/sarsa"].sentences[1] in text
    assert "player 20, dealer shows 10, no usable ace" in text
    names = {str(file.relative_to(tmp_path / "maps")) for file in (tmp_path / "maps").rglob("*.png")}
    assert names == {
        f"{env}/{name}.png" for env in ("cliff-walking", "blackjack") for name in ("sarsa", "q-learning")
    }
    assert str(rl.explain(path)) == str(expected)
    html = expected._repr_html_()
    assert html.count("<table>") == 5


def test_the_report_of_a_folder_is_asked_for_by_its_name(folder, tmp_path):
    """Broken once: a module that cannot be called, or one that reads what is not there -> fails."""
    path = Path(shutil.copytree(folder[0], tmp_path / "run"))
    page = rl.report(path)  # pyright: ignore[reportCallIssue]
    assert page.html == (path / "report.html").read_text() and "Cliff walking" in page.title
    (path / "report.html").unlink()
    again = rl.report(str(path))  # pyright: ignore[reportCallIssue]
    assert again.title == page.title and again.html == (path / "report.html").read_text()
    next((path / "shards").glob("*.npz")).unlink()
    with pytest.raises(rl.InputError, match=r"1 of \d+ shards are missing in .*: resume it first"):
        rl.report(path)  # pyright: ignore[reportCallIssue]


def test_the_report_has_the_sentences_and_a_map_of_each_method(folder):
    """Broken once: the colours of another method -> fails."""
    path, outcome = folder
    page = re.sub(r"\s+", " ", (path / "report.html").read_text(encoding="utf-8"))
    for explained in outcome.explain().values():
        assert re.sub(r"\s+", " ", " ".join(explained.sentences)) in page
    assert page.count('class="heat-map"') == 2 + 2 * 2
    sarsa = outcome.explain()["cliff-walking/sarsa"]
    worst = sarsa.places(sarsa.main)[0]
    begin = page.index('class="heat-map"')
    cell = re.search(rf"<title>{re.escape(worst.name)}: ([\d.]+) is lost .*?</g>", page[begin:])
    assert float(cell[1]) == pytest.approx(worst.lost, rel=1e-5)
    assert 'fill-opacity="0.900"' in cell[0]


def test_a_folder_that_is_not_finished_is_refused(folder, capsys):
    path, _ = folder
    shard = next((path / "shards").iterdir())
    content = shard.read_bytes()
    shard.unlink()
    try:
        assert main(["explain", str(path)]) == 2
        assert re.search(r"1 of \d+ shards are missing in .*: resume it first", capsys.readouterr().err)
    finally:
        shard.write_bytes(content)


def test_an_interval_of_what_is_lost_leaves_out_what_cannot_be():
    """Broken once: the interval of the mean as it is, from -1.9 on -> fails."""
    by_action = np.zeros((7, 2))
    by_action[0, 0] = 1
    told = explained_of(None, made_up(by_action, [0, 0, 0, 4])).to_dict()["greedy"]
    assert (told["lost"], told["low"]) == (1, 0)
