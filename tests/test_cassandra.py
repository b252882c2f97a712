"""Cassandra's format: every form, against tables by hand; and errors that name the line."""

import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import cli
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.exact import planning

TIGER = """# Kaelbling, Littman and Cassandra (1998)
discount: 0.95
values: reward
states: tiger-left tiger-right
actions: listen open-left open-right
observations: tiger-left tiger-right
T:listen
identity
T:open-left
uniform
T:open-right
uniform
O:listen
0.85 0.15
0.15 0.85
O:open-left
uniform
O:open-right
uniform
R:listen : * : * : * -1
R:open-left : tiger-left : * : * -100
R:open-left : tiger-right : * : * 10
R:open-right : tiger-left : * : * 10
R:open-right : tiger-right : * : * -100
"""

# Every form of T and R of an MDP; what comes later overrules what came before.
FORMS = """values: cost
discount: 0.5   # names and numbers mean the same
states: a b c
actions: 3
start: 0.5 0.5 0
T: 0
0.2 0.8 0
0 0.5 0.5
0 0 1
T: 1 uniform
T: 1 : b
1 0 0
T: 1 : c : * 0
T: 1 : c : c 1.0
T: * : a : 1 0.7
T: * : a : c 0.1
T: 0 : 0 : 0 0.2
T: 1 : a : a 0.2
T: 2 identity
T: 2 : a reset
R: * : * : * 1
R: 0 : a
1 2 3
R: 1
0 1 2
3 4 5
6 7 8
R: 1 : b : a -2.5e0
R: * : c : * 0
"""
P = np.array(
    [
        [[0.2, 0.7, 0.1], [0.2, 0.7, 0.1], [0.5, 0.5, 0]],
        [[0, 0.5, 0.5], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 1], [0, 0, 1]],
    ]
)
COST = np.array(
    [
        [[1, 2, 3], [0, 1, 2], [1, 1, 1]],
        [[1, 1, 1], [-2.5, 4, 5], [1, 1, 1]],
        [[0, 0, 0], [0, 0, 0], [0, 0, 0]],
    ],
    float,
)


def load(text, name="some.mdp"):
    return FiniteMDP.load(name, text.encode())


def dense(env):
    """p [S, A, S'] and p r of a table."""
    p, pr = np.zeros((2, env.num_states, env.num_actions, env.num_states))
    for (s, a, k), s_next in np.ndenumerate(env.successors):
        p[s, a, s_next] += env.prob[s, a, k]
        pr[s, a, s_next] += env.prob[s, a, k] * env.reward[s, a, k]
    return p, pr


def test_every_form_is_read():
    """Broken once: a vector adds to the row that was there, in place of it -> fails."""
    env = load(FORMS)
    p, pr = dense(env)
    np.testing.assert_allclose(p, P, atol=1e-12)
    np.testing.assert_allclose(pr, -P * COST, atol=1e-12)
    assert env.discount == 0.5
    np.testing.assert_array_equal(env.is_terminal, [False, False, True])  # for nothing, for ever
    np.testing.assert_array_equal(env.initial(), [0.5, 0.5, 0])


def test_a_pomdp_is_read_as_its_mdp():
    """Who sees the tiger opens the other door each time, for 10 / (1 - 0.95)."""
    env = load(TIGER, "tiger.POMDP")
    assert (env.num_states, env.num_actions, env.discount) == (2, 3, 0.95)
    v, q = planning.value_iteration(env, 0.95)
    np.testing.assert_allclose(v, 200)
    np.testing.assert_allclose(q, [[189, 90, 200], [189, 200, 90]])


def test_rewards_are_averaged_over_what_is_observed():
    text = TIGER + "R: listen : tiger-left : tiger-left : tiger-right 19\nR: * : * : 1\n0 8\n"
    _, pr = dense(load(text.replace("R: * : * : 1\n0 8\n", ""), "tiger.pomdp"))
    assert pr[0, 0, 0] == pytest.approx(-0.85 + 0.15 * 19)
    _, pr = dense(load(text, "tiger.pomdp"))
    assert pr[1, 0, 1] == pytest.approx(0.85 * 8)
    assert pr[0, 1, 1] == pytest.approx(0.5 * 4)


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        ("start: uniform", [1 / 3] * 3),
        ("start: b", [0, 1, 0]),
        ("start: 1", [0, 1, 0]),
        ("start include: a 2", [0.5, 0, 0.5]),
        ("start exclude: b", [0.5, 0, 0.5]),
        ("", [1 / 3] * 3),
    ],
)
def test_the_start(start, expected):
    np.testing.assert_allclose(load(FORMS.replace("start: 0.5 0.5 0", start)).initial(), expected)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0 0.5 0.5\n", "0 0.5\n", "line 7: 9 numbers are wanted here, and there are 8"),
        ("0 0.5 0.5\n", "0 0.5 0.5 0\n", "line 7: 9 numbers are wanted here, and there are 10 or more"),
        ("0 0.5 0.5\n", "0 0.5 O.5\n", "line 8: 'O.5' is not a number"),
        ("T: 2 identity", "T: 3 identity", "line 19: '3' is none of the actions; they are 0 to 2"),
        ("T: 1 : b\n", "T: 1 : B\n", "line 11: 'B' is none of the states; "),
        ("0 0.5 0.5\n", "0 0.5 0.4\n", "line 7: the probabilities add up to 0.9, not to 1"),
        (
            "T: 1 : a : a 0.2",
            "T: 1 : a : a 0.3",
            "line 18: the probabilities of what follows on action 1 in a add",
        ),
        ("values: cost", "values: costs", "line 1: values are 'reward' or 'cost', not 'costs'"),
        ("discount: 0.5", "discount: 1.5", "line 2: discount must be from 0 to 1, not 1.5"),
        ("states: a b c\nactions: 3", "states:\nactions: 3", "line 3: there are no states"),
        ("states: a b c", "states: a b a", "line 3: 'a' is there twice among the states"),
        ("R: 1 : b : a -2.5e0", "R: 1 : b : a : c -2.5e0", "line 28: there are more than 3 entries"),
        (
            "T: 2 identity\nT: 2 : a reset\n",
            "",
            "line 16: the probabilities of what follows on action 2 in a add up to 0.8",
        ),
        ("states: a b c\n", "", "line 4: states must be said before start"),
    ],
)
def test_errors_name_the_line(old, new, message):
    assert old in FORMS
    with pytest.raises(InputError) as error:
        load(FORMS.replace(old, new))
    assert str(error.value).startswith("some.mdp") and message in str(error.value), error.value


def test_it_is_an_environment_wherever_one_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiger.POMDP").write_text(TIGER)
    env = rl.make("tiger.POMDP")
    env.save("tiger.npz")
    again = FiniteMDP.load("tiger.npz")
    assert again.discount == 0.95 and (again.reward == env.reward).all()
    assert cli.main(["solve", "tiger.POMDP", "--gamma", "0.9"]) == 0
    assert "a discount rate of 0.95: `--gamma 0.95` takes it" in capsys.readouterr().out
    assert cli.main(["solve", "tiger.POMDP"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "earns 10 a step in the long run" in printed
    assert "`--gamma 0.95`, which its source states" in printed
    with pytest.raises(InputError, match=r"take gamma below 1, as the 0\.95 that its source states"):
        planning.value_iteration(env)
    assert cli.main(["solve", "none.MDP"]) != 0
    assert "there is no file none.MDP" in capsys.readouterr().err
