"""Tasks that end after a given number of steps: their exact values, their names, and what they say about themselves."""

import json
from typing import Any

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import cli
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.exact import planning
from jaxrl_tab.show.states import state_names

RIVER = rl.make("river-swim", variant="osband")
NAME = "finite-horizon:5:river-swim"


@pytest.mark.parametrize("gamma", [1.0, 0.9])
@pytest.mark.parametrize("name", ["river-swim", "frozen-lake", "recycling-robot", "blackjack"])
def test_the_exact_values_are_those_of_backward_induction(name, gamma):
    """A task that goes on, one that ends by itself, and two in which not every state has every action, or many start.

    Broken once: `h >= horizon` in place of `horizon - 1` -> fails.
    """
    inner, h = rl.make(name), 4
    env = rl.FiniteHorizon(inner, h)
    expected = planning.finite_horizon(inner, h, gamma)
    v, q = planning.value_iteration(env, gamma)
    shape = h, inner.num_states
    np.testing.assert_allclose(v[:-1].reshape(shape), expected.v[:-1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(q[:-1].reshape(*shape, -1), expected.q, rtol=1e-9, atol=1e-12)
    assert v[-1] == 0
    # What is worth that at each step is worth it from the start.
    policy = np.concatenate([expected.policy.reshape(h * shape[1], -1), expected.policy[0, :1]])
    value = planning.policy_value(env, policy, gamma)
    assert value == pytest.approx(planning.start_value(inner, expected.v[0]))


def test_an_episode_ends_for_good():
    """After H steps, with discount 0: the last step learns from its reward alone."""
    env = rl.FiniteHorizon(RIVER, 3)
    state, log = rl.train(
        jax.random.key(0), rl.QLearning(alpha=1.0, epsilon=1.0, q0=7.0), env, num_episodes=300
    )
    assert (np.asarray(log.lengths) == 3).all()
    last = np.asarray(state.q)[12]  # step 2, state 0
    np.testing.assert_allclose(last, [0.005, 0], rtol=1e-6)


def test_what_it_says_about_itself():
    env = rl.FiniteHorizon(RIVER, 5)
    declared = of_environment(env)
    assert (env.num_states, env.max_steps, declared.horizon) == (31, 5, 5)
    assert not declared.continuing and declared.differs == ""
    (panel,) = env.panels()
    assert panel.states.shape == (5, 6) and panel.states[2, 3] == 15
    name = state_names(env)
    assert [name(s) for s in (0, 15, 30)] == ["step 0, state 0", "step 2, state 3", "end"]
    # Too many for tables; each lake in its own place; and what states are called.
    assert rl.FiniteHorizon(RIVER, 90).panels() == ()
    assert state_names(rl.FiniteHorizon(RIVER, 90))(15) == "step 2, state 3"
    assert [panel.title for panel in rl.FiniteHorizon(rl.FrozenLake(), 3).panels()] == [
        f"step {h}" for h in range(3)
    ]
    # What differs between runs, or steps of a run, does so here.
    sea = rl.FiniteHorizon(rl.make("deep-sea", size=4), 3)
    assert sea.instance is not None and sea.instance(jax.random.key(0)).env.right.shape == (16,)
    maze = rl.FiniteHorizon(rl.make("blocking-maze"), 3)
    assert maze.at is not None and of_environment(maze).differs
    before, after = (planning.exact_model(maze.at(jax.numpy.int32(step))).s_next for step in (0, 2000))
    assert (before != after).any()
    assert of_environment(rl.make("deep-sea", size=4)).horizon == 4


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rl.FiniteHorizon(RIVER, 0), "FiniteHorizon: horizon must be a whole number of at least 1"),
        (lambda: rl.FiniteHorizon(3, 2), r"env must be an environment such as RiverSwim\(\), not 3"),
        (lambda: rl.FiniteHorizon(RIVER, 2**30), "horizon|more states than can be numbered"),
        (
            lambda: rl.make("finite-horizon"),
            "say what ends, and after how many steps: finite-horizon:STEPS:ENV",
        ),
        (
            lambda: rl.make("finite-horizon:river-swim"),
            "is not of the form finite-horizon:STEPS:ENV, such as",
        ),
        (lambda: rl.make("finite-horizon:2:"), "is not of the form finite-horizon:STEPS:ENV, such as"),
        (
            lambda: rl.make("finite-horizon:0:chain"),
            "the number of steps must be a whole number of at least 1",
        ),
        (lambda: rl.make("finite-horizon:2:chian"), "'chian' is not an environment; did you mean 'chain'"),
        (
            lambda: rl.make("finite-horizon:2:chain", slip=2),
            "chain: slip must be finite and between 0 and 1, not 2",
        ),
        (lambda: rl.make("finite-horizon:2:chain", max_steps=2), "has no parameter 'max_steps'"),
    ],
)
def test_what_is_wrong_is_said(make, message):
    with pytest.raises(rl.InputError, match=message):
        make()


def test_names_and_instances_stand_for_the_same():
    """In Python, in a file, and as what is written of an instance: the same task."""
    named = rl.make(NAME, variant="osband")
    assert repr(named) == repr(rl.FiniteHorizon(RIVER, 5))
    length: Any = {"seeds": 1, "episodes": 2}
    table = {"name": NAME, "variant": "osband", "states": [5, 6]}
    written = rl.Experiment(table, "sarsa", **length)
    assert list(written.parts()) == [f"river-swim,horizon=5,states={n}/sarsa" for n in (5, 6)]
    given = rl.Experiment(rl.FiniteHorizon(RIVER, 5), "sarsa", **length)
    again = rl.Experiment.from_data(json.loads(json.dumps(given.data())))
    assert again.data() == given.data()
    assert given.environment == [
        {"name": NAME, "label": "river-swim,horizon=5", "variant": "osband", "states": 6}
    ]
    # A table is kept as its file.
    mdp = rl.FiniteMDP(np.ones((1, 1, 1)), np.array([[-2.0]]))
    (table,) = rl.Experiment(rl.FiniteHorizon(mdp, 3), "sarsa", **length).environment
    assert table["name"].startswith("finite-horizon:3:FiniteMDP-") and len(table["sha256"]) == 64


def test_on_the_command_line(capsys):
    assert cli.main(["solve", NAME, "--variant", "osband", "--json"]) == 0
    solved = json.loads(capsys.readouterr().out)
    assert cli.main(["solve", "river-swim", "--variant", "osband", "--horizon", "5", "--json"]) == 0
    expected = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(solved["optimal"]["v"][:-1], np.ravel(expected["v"][:-1]), atol=1e-9)
    assert cli.main(["list", NAME]) == 0
    printed = capsys.readouterr().out
    assert "RiverSwim that ends after 5 steps." in printed and "--variant" in printed


@pytest.mark.slow
def test_a_folder_keeps_a_copy_of_the_table(capsys, tmp_path):
    rl.FiniteMDP(np.ones((1, 2, 1)), np.array([[-1.0, -2.0]])).save(tmp_path / "one.npz")
    out = str(tmp_path / "out")
    words = [
        f"finite-horizon:3:{tmp_path / 'one.npz'}",
        "sarsa",
        "--alpha",
        "0.5",
        "--episodes",
        "4",
        "--seeds",
        "2",
    ]
    assert cli.main(["sweep", *words, "--out", out, "--no-pictures"]) == 0
    (tmp_path / "one.npz").unlink()
    assert cli.main(["resume", out, "--no-pictures"]) == 0
    assert "exact optimum -3" in capsys.readouterr().out
