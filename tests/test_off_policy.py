"""Off-policy Monte Carlo: against plain loops of the book's formulas, against exact values, and by hand.

Each was seen to fail on code broken in the ways that its docstring tells.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from test_monte_carlo import EPSILON, FIXED, GAMMAS, N, check, played, task_apart

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.core.policies import UCB, EpsilonGreedy, Greedy, Softmax, Table
from jaxrl_tab.core.schedules import Power
from jaxrl_tab.core.types import Transition

# --- decision for decision, in float64 ---------------------------------------------------------------


def eighths(num_states, num_actions, least=0):
    """Some policy, float [S, A], of whole eighths of which each action has at least so many."""
    rand = np.random.default_rng(1)
    spare = 8 - least * num_actions
    return (least + rand.multinomial(spare, np.full(num_actions, 1 / num_actions), num_states)) / 8


def greedy(agent):
    return lambda row, s: reference.soft(row, 0)


def some_table(agent):
    pi = eighths(*agent.q.shape)
    return lambda row, s: pi[s]


def soft_by_visit(agent):
    return lambda row, s: reference.soft(row, 1 / (agent.returns[s].sum() + 1))


TARGETS = {
    "greedy": (lambda env: None, greedy),
    "table": (lambda env: Table(eighths(env.num_states, env.num_actions)), some_table),
    "by visit": (lambda env: EpsilonGreedy(Power(clock="visit")), soft_by_visit),
}
KINDS = {
    "weighted": ("greedy", {}),
    "weighted, by visit, first": ("by visit", {"first_visit": True}),
    "ordinary": ("greedy", {"weighting": "ordinary"}),
    "per-decision, table, first": ("table", {"weighting": "per-decision", "first_visit": True}),
}


@pytest.mark.parametrize(
    ("kind", "env_name"),
    [
        *((kind, "random mdp") for kind in KINDS),
        pytest.param("weighted", "windy, stochastic, king", marks=pytest.mark.slow),
    ],
)
def test_every_step_agrees_with_the_plain_loop(kind, env_name):
    """Broken once -> each fails: its own ratio in a weight; pi by the Q before the update; W not a

    product; ordinary without weights; per-decision ratios on the own reward; b by another policy; mean
    weights of all visits in first-visit; nothing, or the mean under b, after a time limit.
    """
    (env, task), (target, fields) = task_apart(env_name), KINDS[kind]
    ours, plain = TARGETS[target]
    shape = env.num_states, env.num_actions
    if target == "table" and env_name == "random mdp":
        b = eighths(*shape, least=1)
        behaviour, plain_behaviour = {"behaviour": Table(b)}, b
    else:
        behaviour, plain_behaviour = {"epsilon": EPSILON}, None
    method = lambda gamma: rl.OffPolicyMonteCarlo(
        gamma=gamma, q0=0.5, target=ours(env), **behaviour, **fields
    )
    (state, log), words = played(env, method)
    for i, gamma in enumerate(GAMMAS):
        rates = reference.Rates(N, FIXED(EPSILON))
        agent = reference.OffPolicyReturns(
            shape,
            rates,
            gamma,
            0.5,
            target=None,
            behaviour=plain_behaviour,
            **{"weighting": "weighted", **fields},
        )
        agent.target = plain(agent)
        check(agent, task, words, state, log, i)
        np.testing.assert_array_equal(state.clock.visits[i], agent.returns)
        if state.mean_weight is not None:  # C, up to rounding
            np.testing.assert_allclose(state.mean_weight[i] * agent.returns, agent.c, rtol=1e-10)


# --- against exact values ----------------------------------------------------------------------------

RUNS, PLAYED, GAMMA = 64, 2000, 0.9
PI = np.array([[0.25, 0.75], [0.5, 0.5], [1.0, 0.0], [0.5, 0.5]])
B = np.array([[0.5, 0.5], [0.75, 0.25], [0.5, 0.5], [0.5, 0.5]])


def short_episodes():
    """Three states and a terminal one, two actions; a step ends the episode with probability 0.4 or more."""
    rand = np.random.default_rng(3)
    p = np.zeros((4, 2, 4))
    p[:3] = 0.6 * rand.dirichlet(np.ones(4), (3, 2))
    p[:, :, 3] += 1 - p.sum(2)
    return rl.FiniteMDP(p, rand.integers(-4, 5, (4, 2)), terminal=[3], start=[0.5, 0.25, 0.25, 0.0])


def learned(method):
    """Q of each of RUNS runs, [RUNS, 3, 2]: of the states that are not terminal."""
    run = lambda key: rl.train(key, method, short_episodes(), num_steps=PLAYED, log_every=PLAYED)[0].q
    return np.asarray(jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), RUNS)))[:, :3]


@pytest.mark.parametrize("weighting", ["weighted", "per-decision"])  # ordinary: see test_importance
def test_it_learns_the_values_of_the_target_policy(weighting):
    """The mean over runs is q_pi, within 4 of its standard errors, and is not q_b.

    (Weighted averages are biased, by what falls like 1 over the number of episodes.)

    Broken once: ratios cut at 1; per-decision without ratios -> fails.
    """
    env = short_episodes()
    fields = {"gamma": GAMMA, "target": Table(PI), "behaviour": Table(B)}
    q = learned(rl.OffPolicyMonteCarlo(weighting=weighting, first_visit=True, **fields))
    error = q.std(0, ddof=1) / np.sqrt(RUNS)
    q_pi, q_b = (
        planning.backup(planning.exact_model(env), planning.evaluate(env, probs, GAMMA), GAMMA)[:3]
        for probs in (PI, B)
    )
    assert (abs(q.mean(0) - q_pi) < 4 * error).all()
    assert (abs(q.mean(0) - q_b) > 10 * error).any()


def test_the_greedy_target_is_learned_while_exploring():
    """Behaving at random. Only where two actions differ by 0.12 some runs take the worse one.

    Broken once: the behaviour policy as target -> fails.
    """
    env = short_episodes()
    q = learned(rl.OffPolicyMonteCarlo(gamma=GAMMA, epsilon=1.0))
    v_star, q_star = planning.value_iteration(env, GAMMA)
    regret = (v_star[:3] - np.take_along_axis(q_star[None, :3], q.argmax(2)[..., None], 2)[..., 0]).max(1)
    assert (regret < 0.13).all()
    assert (abs(q.mean(0) - q_star[:3]) < 4 * q.std(0, ddof=1) / np.sqrt(RUNS)).all()


# --- by hand: states 0, 1 and a terminal 2; two actions, of which pi takes 0, and b either; gamma 1/2 ------

TAKES_0 = np.array([[1.0, 0.0]] * 3)
EITHER = np.full((3, 2), 0.5)
EPISODES_BY_HAND = (
    ((0, 1, 2.0, 1), (1, 0, 4.0, 2)),  # rho of its second action is 2, so W = 2; G = 2 + 4/2 = 4
    ((0, 1, 1.0, 1), (1, 1, 8.0, 2)),  # rho = 0, so W = 0
    ((0, 1, 0.0, 1), (1, 0, 4.0, 2)),  # W = 2, G = 2
)


@pytest.fixture(scope="module")
def learn():
    """Q after those episodes; the last is cut by a time limit where `cut`."""

    @jax.jit
    def learn(method, transitions):
        one = lambda state, t: (method.update(jax.random.key(0), state, t)[0], None)
        return jax.lax.scan(one, method.init(3, 2, 10), transitions)[0].q

    def of(weighting, cut=False):
        rows = [
            (*step, 0.5, False) if step is episode[0] else (*step, 0.5 if cut else 0.0, True)
            for episode in EPISODES_BY_HAND
            for step in episode
        ]
        method = rl.OffPolicyMonteCarlo(
            gamma=0.5, target=Table(TAKES_0), behaviour=Table(EITHER), weighting=weighting, q0=1.0
        )
        return learn(method, Transition(*map(jnp.asarray, zip(*rows, strict=True))))

    return of


@pytest.mark.parametrize(
    ("weighting", "value"),
    [
        ("weighted", (2 * 4 + 0 * 5 + 2 * 2) / (2 + 0 + 2)),
        ("ordinary", (2 * 4 + 0 * 5 + 2 * 2) / 3),
        ("per-decision", ((2 + 2 * 4 / 2) + (1 + 0 * 8 / 2) + (0 + 2 * 4 / 2)) / 3),
    ],
)
def test_three_ways_to_weigh(weighting, value, learn):
    """Of (0, 1), whose own action has no ratio; (1, 0) and (1, 1) are last, with weight 1.

    Broken once: ratios cut at 1 -> fails.
    """
    q = learn(weighting)
    np.testing.assert_allclose(q, [[1, value], [4, 8], [1, 1]], rtol=1e-6)


def test_after_a_time_limit_there_is_the_value_under_the_target(learn):
    """Q(2, .) = 1, half of which is added to each last reward, so 4.5 for 4 and 8.5 for 8.

    Broken once: discounted twice; treated as terminal -> fails.
    """
    value = (2 * (2 + 4.5 / 2) + 2 * (0 + 4.5 / 2)) / 4
    np.testing.assert_allclose(learn("weighted", cut=True), [[1, value], [4.5, 8.5], [1, 1]], rtol=1e-6)


# --- what is refused ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"target": Table(EITHER), "behaviour": Table(TAKES_0)},
            "behaviour leaves out action 1 in state 0, which target can take; give it a positive probability",
        ),
        ({"behaviour": Table(TAKES_0)}, "behaviour leaves out action 1 in state 0, which target can take"),
        ({"target": Table(EITHER), "epsilon": 0.0}, "behaviour leaves out action 0 in state 0, which target"),
        (
            {"target": Softmax(1.0), "behaviour": Greedy()},
            "behaviour leaves out actions that target can take",
        ),
        ({"behaviour": UCB()}, "behaviour leaves out actions that target can take; let it take all of them"),
        ({"weighting": "per_decision"}, "weighting 'per_decision' is unknown; did you mean 'per-decision'?"),
        ({"weighting": None}, "weighting None is unknown; choose one of weighted, ordinary, per-decision"),
        ({"target": 0.5}, "target must be a policy such as"),
        (
            {"target": Table(EITHER), "behaviour": Table(EITHER[:2])},
            "target is a table (3, 2), and behaviour",
        ),
    ],
)
def test_what_cannot_be_learned_is_refused(fields, message):
    """Broken once: coverage judged the other way round -> fails."""
    with pytest.raises(rl.InputError) as error:
        rl.OffPolicyMonteCarlo(**fields)
    assert str(error.value).startswith(f"OffPolicyMonteCarlo: {message}")
    assert "\n" not in str(error.value)
