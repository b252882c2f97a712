"""Methods that learn preferences: against plain loops, against the exact gradient, and in all that shows them."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import reference_gradient as plain
from marks import slow_but
from refusals import refused
from test_reference import STEPS, env_and_task, words_of

import jaxrl_tab as rl
from jaxrl_tab import planning, schedules
from jaxrl_tab.cli import main
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.show.explorer.chapter import explorer
from jaxrl_tab.show.tasks import policy_of
from jaxrl_tab.stats.columns import Methods

GAMMA, ALPHA = 0.9, 0.25
AVERAGE = schedules.sample_average()
one_over = lambda n: 1 / n

# --- decision for decision, in float64 ---------------------------------------------------------------

# The method, what it is given, and the same for its plain loop.
CASES = {
    "gradient-bandit": (rl.GradientBandit, {}, plain.GradientBandit, {}),
    "gradient-bandit, no baseline": (rl.GradientBandit, {"baseline": False}, plain.GradientBandit, {"baseline": False}),
    "reinforce": (rl.Reinforce, {}, plain.Reinforce, {}),
    "reinforce, adam": (rl.Reinforce, {"optimizer": "adam"}, plain.Reinforce, {"optimizer": plain.Adam}),
    "reinforce-baseline": (rl.ReinforceBaseline, {"alpha_v": AVERAGE}, plain.Reinforce, {"alpha_v": one_over}),
    "groups": (
        rl.ReinforceBaseline,
        {"alpha_v": AVERAGE, "groups": "1,0,0,2,1"},
        plain.Reinforce,
        {"alpha_v": one_over, "groups": [1, 0, 0, 2, 1]},
    ),
    "actor-critic": (rl.ActorCritic, {"alpha_v": AVERAGE}, plain.ActorCritic, {"alpha_v": one_over}),
    "actor-critic, adam": (
        rl.ActorCritic,
        {"alpha_v": 0.5, "optimizer": "adam(b1=0.8)"},
        plain.ActorCritic,
        {"alpha_v": lambda n: 0.5, "optimizer": lambda: plain.Adam(b1=0.8)},
    ),
    "actor-critic-lambda": (
        rl.ActorCriticLambda,
        {"alpha_v": 0.5, "lam": 0.8, "lam_v": 0.4},
        plain.ActorCritic,
        {"alpha_v": lambda n: 0.5, "lam": 0.8, "lam_v": 0.4},
    ),
}  # fmt: skip


SOME = ["gradient-bandit", "groups"]


@pytest.mark.parametrize("name", slow_but(SOME, CASES))
def test_every_step_agrees_with_the_plain_loop(name):
    """Time limits are often met. Broken once -> each fails: the returns of an episode learned from backwards; gamma^t

    left out; a time limit treated as terminal; the baseline with the present reward in it; traces that outlive their
    episode; the visits of pairs counted for V; the optimiser asked in each step of an episode.
    """
    cls, fields, loop, given = CASES[name]
    given = dict(given)
    env, task = env_and_task("random mdp")
    key = jax.random.key(5)
    with jax.enable_x64():
        method = cls(alpha=ALPHA, gamma=GAMMA, **fields)
        state, log = jax.jit(lambda key: rl.train(key, method, env, num_steps=STEPS, log_every=STEPS))(key)
    if "optimizer" in given:
        given = given | {"optimizer": given["optimizer"]()}
    rates = reference.Rates(lambda *_: ALPHA, lambda *_: 0)
    groups = given.pop("groups", None)
    agent = loop((env.num_states, env.num_actions), rates, GAMMA, **given)
    if groups is not None:
        agent = plain.Grouped(agent, groups)
    finished = reference.run(agent, task, STEPS, words_of(key))
    np.testing.assert_allclose(state.q, agent.q if groups is None else agent.q[groups], atol=1e-9)
    if hasattr(state, "v") and state.v is not None:
        np.testing.assert_allclose(state.v, agent.v[: len(state.v)], atol=1e-9)
    assert log.episodes[0] == len(finished) > 100
    np.testing.assert_allclose(log.returns[0], sum(float(g) for g, _ in finished), rtol=1e-5)


def test_plain_descent_of_optax_is_plain_ascent():
    """To the last bit. Broken once: the sign left as it was -> fails."""
    env, _ = env_and_task("random mdp")
    run = lambda method: jax.jit(lambda key: rl.train(key, method, env, num_steps=99))(jax.random.key(0))[0].q
    np.testing.assert_array_equal(run(rl.ActorCritic(optimizer="sgd")), run(rl.ActorCritic()))


# --- the policy gradient theorem ---------------------------------------------------------------------


def start_value(theta, env, gamma=GAMMA):
    """The value of the softmax policy of theta from the start, by a linear system."""
    model = planning.enumerate_model(env)
    pi = jax.nn.softmax(theta)
    over = planning.terminal_states(model)
    weight = jnp.where(over[:, None, None], 0, pi[:, :, None] * model.prob)
    s = jnp.arange(len(theta))[:, None, None]
    chain = jnp.zeros((len(theta), len(theta))).at[s, model.s_next].add(gamma * weight)
    v = jnp.linalg.solve(jnp.eye(len(theta)) - chain, (weight * model.reward).sum((1, 2)))
    return model.start @ v


@pytest.mark.parametrize("cls", slow_but([rl.Reinforce], [rl.Reinforce, rl.ReinforceBaseline]))
def test_what_one_episode_adds_is_on_average_the_exact_gradient(cls):
    """Whatever the baseline is. Broken once: gamma^t left out -> 40 standard errors."""
    rand = np.random.default_rng(0)
    start = [0.25, 0.25, 0.25, 0.25, 0.0]
    env = rl.FiniteMDP(
        rand.dirichlet(np.ones(5), (5, 3)), rand.normal(size=(5, 3)), [4], start, max_steps=200
    )
    theta = rand.normal(size=(5, 3)).astype(np.float32).astype(float)
    fields: Any = {"theta0": jnp.array(theta, jnp.float32), "optimizer": "sgd"}
    fields |= {"v0": 2.0, "alpha_v": 1e-6} if cls is rl.ReinforceBaseline else {}
    method = cls(alpha=1.0, gamma=GAMMA, **fields)
    keys = jax.random.split(jax.random.key(0), 20_000)
    state, _ = jax.jit(jax.vmap(lambda key: rl.train(key, method, env, num_episodes=1)))(keys)
    with jax.enable_x64():
        exact = np.asarray(jax.jit(jax.grad(lambda theta: start_value(theta, env)))(jnp.array(theta)))
    steps = (np.asarray(state.q, float) - theta)[:, :4]  # in the terminal state nothing is learned
    apart = (steps.mean(0) - exact[:4]) / (steps.std(0) / np.sqrt(len(keys)))
    assert abs(apart).max() < 4 < abs(exact[:4] / steps.std(0)).max() * np.sqrt(len(keys))


# --- what is said ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"optimizer": "adm"}, "Reinforce: optimizer: optax has no optimiser 'adm'; did you mean 'adam'?"),
        ({"optimizer": "adam(warmth=1)"}, "'warmth'; adam takes b1, b2, eps"),
        (
            {"optimizer": "adam(__import__)"},
            "is not the name of an optimiser in optax with its numbers in paren",
        ),
        ({"optimizer": "cosine_decay_schedule(1, 2)"}, "optax has no optimiser"),
        (
            {"optimizer": "adam", "alpha": AVERAGE},
            "alpha cannot go by visits where an optimizer makes one step",
        ),
        ({"groups": "0;1"}, "groups must be whole numbers such as \"0,0,1,2\", not '0;1'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(fields, message):
    refused(lambda: rl.Reinforce(**fields), message)


def test_groups_fit_the_task():
    refused(
        lambda: rl.train(jax.random.key(0), rl.ActorCritic(groups="0,1"), rl.RandomWalk(), num_steps=9),
        "groups has 2",
    )


def test_an_optimiser_is_printed_as_it_is_typed():
    assert rl.ActorCritic(optimizer="sgd( .5, nesterov=True )").optimizer == "sgd(.5,nesterov=True)"
    assert rl.ActorCritic(optimizer="sign-sgd()").optimizer == "sign_sgd"


def test_exploration_rates_do_not_apply(capsys):
    """On the command line the line says who has one. Broken once: an option of all methods -> fails."""
    assert main(["sweep", "short-corridor", "reinforce", "--epsilon", "0.1"]) == 2
    assert (
        "reinforce has no --epsilon, which belongs to the methods of control that" in capsys.readouterr().err
    )
    refused(
        lambda: rl.sweep(rl.ShortCorridor(), "reinforce", {"epsilon": 0.1}, num_seeds=1, num_steps=1),
        "has no parameter 'epsilon'",
    )


def test_optimisers_and_groups_are_typed(capsys):
    """Broken once: text without a default taken for a table of probabilities -> fails."""
    typed = ["--groups", "0,0,0,1", "--optimizer", "adam", "sgd(momentum=0.9)"]
    assert (
        main(["sweep", "short-corridor", "actor-critic", *typed, "--alpha", "0.1", "--dry-run", "--json"])
        == 0
    )
    assert '"programs": 2' in capsys.readouterr().out


# --- in all that shows them --------------------------------------------------------------------------


@pytest.mark.slow
def test_exact_values_are_those_of_the_policy_and_there_is_no_error_of_preferences():
    """Broken once: q_error kept; theta taken for a policy by its greedy actions -> fails."""
    env = rl.ShortCorridor()
    given = {"alpha": 2.0**-7, "groups": "0,0,0,1"}
    result = rl.sweep(env, "actor-critic", given, num_seeds=3, num_episodes=40, log_every=20, exact=True)
    ds = result.to_xarray()
    assert ds.attrs["learns"] == "preferences" and "q_error" not in ds and not ds.diverged.any()
    assert (ds.q[:, 0] == ds.q[:, 1]).all() and (ds.q[:, 0] != ds.q[:, 3]).any()
    for seed in range(3):
        pi = np.asarray(jax.nn.softmax(ds.q[seed].values.astype(float)))
        np.testing.assert_allclose(ds.policy_value[seed, -1], planning.policy_value(env, pi), rtol=1e-5)
    assert np.isneginf(ds.greedy_value).all()  # who goes always the same way never arrives
    (explained,) = result.explain().values()
    assert explained.acting is not None
    lost = planning.start_value(env, planning.value_iteration(env)[0]) - ds.policy_value[:, -1]
    np.testing.assert_allclose(explained.acting.lost, lost, rtol=1e-4)


def test_the_report_shows_the_policy():
    """Broken once: preferences shown as values -> fails."""
    env = rl.TwoDoors()
    ds = rl.sweep(env, "reinforce", {"alpha": 0.5}, num_seeds=3, num_episodes=20).to_xarray()
    page = explorer("doors", Methods.of({"reinforce": ds}, env))
    (method,) = page.data["methods"]
    (table,) = method["tables"].values()
    assert method["policy"] and 0 <= table["low"] < 1  # the smallest number that is shown
    np.testing.assert_allclose(policy_of(np.array([[0.0, np.log(3), UNAVAILABLE]])), [[0.25, 0.75, 0]])


def test_an_episode_is_told_in_preferences(capsys):
    assert main(["watch", "two-doors", "actor-critic", "--episodes", "3", "--at", "1"]) == 0
    shown = capsys.readouterr().out
    assert "error δ" in shown and "θ(S, A): 0 to" in shown and "Q(" not in shown
    assert "the probability of each of them" in shown


@pytest.mark.slow
def test_the_page_is_true(capsys):
    """docs/policy-gradient.md: what it shows is what its lines print."""
    page = (Path(__file__).parents[1] / "docs/policy-gradient.md").read_text(encoding="utf-8")
    (code,), (shown,) = (
        re.findall(r"```python\n(.*?)```", page, re.DOTALL),
        re.findall(r"```text\n(.*?)```", page, re.DOTALL),
    )
    exec(code, {})
    assert capsys.readouterr().out == shown
