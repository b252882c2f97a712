"""River swim, the chain, two loops, the deep sea and garnets: their tables by hand, and their published numbers."""

import json

import jax
import numpy as np
import pytest
from test_envs import ENVIRONMENTS, merged, table

import jaxrl_tab as rl
from jaxrl_tab import cli
from jaxrl_tab.exact import planning
from jaxrl_tab.show.words import six_digits


def test_the_river_is_that_of_the_paper():
    """By hand, from figure 1 of Strehl and Littman (2008)."""
    prob, outcome = table("river-swim")
    p, _, _ = merged(prob, outcome)
    right = np.diag([0.7, 0.6, 0.6, 0.6, 0.6, 0.3]) + 0.3 * np.eye(6, k=1)
    right += np.diag([0.1, 0.1, 0.1, 0.1, 0.7], k=-1)
    np.testing.assert_allclose(p[:, 1], right, atol=1e-7)
    np.testing.assert_array_equal(p[:, 0], np.eye(6)[[0, 0, 1, 2, 3, 4]])
    pays = prob * outcome.reward
    np.testing.assert_allclose(pays.sum((1, 2)), [5, 0, 0, 0, 0, 3000], rtol=1e-6)
    assert pays[0, 0].sum() == 5 and pays[5, 1, outcome.s_next[5, 1] == 4].sum() == 0
    np.testing.assert_allclose(ENVIRONMENTS["river-swim"].initial(), [0, 0.5, 0.5, 0, 0, 0])


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        # pi(s + 1) / pi(s) = up / down, so the shares are powers; 10 000 with 0.3 in the last state
        ("river-swim", {}, 3000 * (81 * 3 / 7) / (1 + 3 + 9 + 27 + 81 + 81 * 3 / 7)),
        ("river-swim", {"variant": "osband"}, 0.4286),  # Osband and others
        ("chain", {}, 3.6768),  # 3677 in 1000 steps: Strens (2000), table 1
        ("chain", {"states": 3, "slip": 0.1}, 0.1 * 2 + 0.9**3 * 10),
        ("two-loops", {}, 2),
        ("two-loops", {"long_reward": 9.0}, 1),
    ],
)
def test_the_largest_average_reward(name, parameters, expected):
    rate, *_ = planning.relative_value_iteration(rl.make(name, **parameters))
    assert rate == pytest.approx(expected, rel=1e-4)


def test_who_discounts_goes_round_the_short_loop():
    """Up to gamma^5 = 1/3."""
    edge = (1 / 3) ** 0.2
    for gamma, best in ((edge - 0.001, 0), (edge + 0.001, 1)):
        _, q = planning.value_iteration(rl.make("two-loops"), gamma)
        assert q[0].argmax() == best


def test_the_treasure_is_at_the_end_of_one_way():
    """Whatever action is right where. Broken once: the treasure wherever one ends in the last column -> fails."""
    env = rl.make("deep-sea", size=5).instance(jax.random.key(3))
    right = np.asarray(env.right).astype(int)
    assert 0 < right.sum() < 25
    model, s, total = planning.exact_model(env), 0, 0.0
    for _ in range(5):
        at = s, right[s], 0
        s, total = int(model.s_next[at]), total + model.reward[at]
    assert (s, bool(model.terminal[at])) == (25, True)
    assert total == pytest.approx(0.99)
    v, _ = planning.value_iteration(env)
    assert v[0] == pytest.approx(0.99)
    # At random it is found once in 2^5 dives, and half of all steps cost.
    v = planning.evaluate(env, np.full((26, 2), 0.5))
    assert v[0] == pytest.approx(1 / 32 - 5 / 2 * 0.01 / 5)


def test_garnets_are_drawn_as_they_should_be():
    env = rl.make("garnet", states=12, actions=3, branching=4, own=True)
    drawn = [env.instance(jax.random.key(i)) for i in range(40)]
    successors = np.stack([mdp.successors for mdp in drawn])
    assert (np.diff(successors, axis=-1) > 0).all()  # different ones, in order
    count, n = np.bincount(successors.ravel(), minlength=12), successors.size
    assert (abs(count - n / 12) < 5 * np.sqrt(n / 12)).all()
    prob = np.stack([mdp.prob for mdp in drawn])
    np.testing.assert_allclose(prob.sum(-1), 1, atol=1e-6)
    # Of 4 pieces each is of Beta(1, 3): mean 1/4, variance 3/80.
    assert abs(prob.var() - 3 / 80) < 0.002
    reward = np.stack([mdp.reward[..., 0] for mdp in drawn])
    assert abs(reward.mean()) < 5 / np.sqrt(reward.size)
    assert abs(reward.var() - 1) < 5 * np.sqrt(2 / reward.size)
    one, other = (planning.exact_model(rl.make("garnet", number=n)) for n in (0, 1))
    assert (one.reward != other.reward).all()


# --- on the command line ------------------------------------------------------------------------------


def test_the_command_knows_that_a_task_does_not_end(capsys):
    """`list` says so, `solve` shows the average reward, and the table of a sweep what a step earns."""
    assert cli.main(["list", "chain", "deep-sea"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("(continuing)") == 1 and "Tasks that are continuing have no end" in printed
    assert cli.main(["solve", "chain", "--json"]) == 0
    solved = json.loads(capsys.readouterr().out)
    assert solved["average_reward"] == pytest.approx(3.6768)
    np.testing.assert_array_equal(solved["policy"], [[1, 0]] * 5)
    typed = ["--alpha", "0.5", "--gamma", "0.9", "--steps", "2000", "--seeds", "2"]
    assert cli.main(["sweep", "chain", "q-learning", *typed]) == 0
    printed = capsys.readouterr().out
    grid = {"alpha": 0.5, "gamma": 0.9}
    ds = rl.sweep(rl.make("chain"), "q-learning", grid, num_seeds=2, num_steps=2000).to_xarray()
    assert six_digits(float(ds.rewards[:, -2:].sum()) / 400) in printed
    assert "The task does not end." in printed and "unfinished" not in printed
