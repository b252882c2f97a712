"""Methods that plan with a model that they learn: against plain loops, and by hand; and docs/models.md."""

import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from marks import slow_but
from test_one_step import ALPHAS, EPSILON, words_of_updates
from test_reference import GAMMAS, STEPS, env_and_task, initial_tables, uniforms, words_of

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.algorithms import posterior
from jaxrl_tab.cli import main
from jaxrl_tab.core import policies, rng
from jaxrl_tab.figures import FIGURES


def planning_words(key, n=5):
    """The words by which the state and the action of each planning step are drawn, [steps, n, 2]."""
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    draw = jax.vmap(lambda word: jax.vmap(jax.random.bits)(fold(rng.as_key(word), jnp.arange(2 * n))))
    return uniforms(draw(words_of_updates(key))).reshape(STEPS, n, 2)


def posterior_numbers(key, pairs, states, tries=20):
    """What `reference.PSRL` asks for: the numbers of a model that is drawn in a step."""
    words = words_of_updates(key)
    places = jnp.arange(pairs * (states + 1)).reshape(states + 1, -1)  # those of the rewards come last
    places = jnp.concatenate([jnp.arange(pairs * states).reshape(pairs, states), places[-1][:, None]], 1)
    draw = jax.vmap(jax.vmap(rng.pair, (None, None, 0)), (None, 0, None))
    draw = jax.jit(jax.vmap(draw, (None, 0, None)))

    def numbers(t):
        drawn = np.stack(draw(words[t], places, jnp.arange(tries)), -1)
        return (2 * (drawn >> 9) + 1) * 2.0**-24, np.where(drawn[:, -1, 0, 1] & 1 == 1, 1, -1)

    return numbers


PSRL = {"prior": 2.0, "r0": 0.25, "spread": 0.5, "every": 3, "sweeps": 9}

METHODS = {
    "dyna-q": (
        rl.DynaQ,
        {"planning_steps": 3},
        lambda key, *args: reference.DynaQ(*args, words=planning_words(key, 3)),
    ),
    "dyna-q-plus": (
        rl.DynaQPlus,
        {"kappa": 0.25},
        lambda key, *args: reference.DynaQ(*args, words=planning_words(key), kappa=0.25),
    ),
    "prioritized-sweeping": (
        rl.PrioritizedSweeping,
        {"planning_steps": 3, "theta": 0.25},
        lambda key, *args: reference.PrioritizedSweeping(*args, n=3, theta=0.25),
    ),
    "r-max": (
        rl.RMax,
        {"m": 3, "sweeps": 9},
        lambda key, *args: reference.RMax(*args, m=3, sweeps=9),
    ),
    "psrl": (
        rl.PSRL,
        PSRL | {"samples": 2},
        lambda key, shape, *args: reference.PSRL(
            shape,
            *args,
            numbers=posterior_numbers(key, 2 * shape[0] * shape[1], shape[0]),
            samples=2,
            **PSRL,
        ),
    ),
}


@pytest.mark.parametrize("name", slow_but(["dyna-q-plus", "prioritized-sweeping", "r-max"], METHODS))
def test_every_step_agrees_with_the_plain_loop(name):
    """In a random task, whose last outcomes change. Broken once: a state is twice in the list; a lower priority
    replaces a higher one; a model is drawn a step too late; the first of two draws counts -> fails.
    """
    env, task = env_and_task("random mdp")
    cls, fixed, plain = METHODS[name]
    keys, q0 = jax.random.split(jax.random.key(11), 4), initial_tables(env)

    def run(key, alpha, gamma, q0):
        step_size = {"alpha": alpha} if hasattr(cls, "alpha") else {}
        method = cls(epsilon=EPSILON, gamma=gamma, q0=q0, **step_size, **fixed)
        return rl.train(key, method, env, num_steps=STEPS, log_every=STEPS)

    state, log = jax.jit(jax.vmap(run))(keys, jnp.array(ALPHAS), jnp.array(GAMMAS), q0)
    for i, (key, alpha, gamma) in enumerate(zip(keys, ALPHAS, GAMMAS, strict=True)):
        rates = reference.Rates(lambda *_, alpha=alpha: alpha, lambda *_: EPSILON)
        agent = plain(key, (env.num_states, env.num_actions), rates, gamma, q0[i])
        finished = reference.run(agent, task, STEPS, words_of(key))
        np.testing.assert_allclose(state.q[i], agent.q, atol=2e-4, rtol=2e-4)
        assert log.episodes[i, 0] == len(finished) > 0
        assert log.lengths[i, 0] == sum(n for _, n in finished)


@pytest.mark.slow
def test_without_planning_dyna_q_is_q_learning(windy):
    run = jax.jit(lambda method: rl.train(jax.random.key(0), method, windy, num_steps=1000, log_every=1000))
    np.testing.assert_array_equal(
        run(rl.DynaQ(alpha=0.5, planning_steps=0))[0].q, run(rl.QLearning(alpha=0.5))[0].q
    )


def test_below_draws_each_number_alike_and_never_the_count():
    """Broken once: rounded instead of cut off -> fails."""
    words = jnp.append(jax.random.bits(jax.random.key(0), (9999,), jnp.uint32), jnp.uint32(2**32 - 1))
    for count in (1, 3, 7, 2**20 + 1):
        drawn = np.asarray(jax.vmap(lambda w, n=count: policies.below(rng.as_key(w), jnp.int32(n)))(words))
        assert drawn.min() >= 0 and drawn[-1] == count - 1 == drawn.max()
        assert abs(drawn.mean() - (count - 1) / 2) <= 4 * count / np.sqrt(12 * len(words))


def test_gamma_and_normal_variables_have_their_moments():
    """Of shapes far below and above 1; within 5 standard errors. Broken once: u^(1 / shape) left out -> fails."""
    words = jax.random.bits(jax.random.key(0), (20_000,), jnp.uint32)
    shapes = np.array([0.05, 0.5, 1.0, 7.5, 300.0], np.float32)
    over_words = jax.vmap(posterior.log_gamma, (0, None, None))
    logs = jax.jit(jax.vmap(over_words, (None, None, 0)))(words, jnp.int32(3), shapes)
    for shape, x in zip(shapes.astype(float), np.exp(np.asarray(logs, float)), strict=True):
        assert abs(x.mean() - shape) <= 5 * np.sqrt(shape / len(x))
        of_variance = np.sqrt((2 * shape**2 + 6 * shape) / len(x))  # its standard error, of a gamma variable
        assert abs(x.var() - shape) <= 5 * of_variance
    z = np.asarray(jax.jit(jax.vmap(posterior.normal, (0, None)))(words, jnp.int32(3)), float)
    assert abs(z.mean()) <= 5 / np.sqrt(len(z)) and abs(z.var() - 1) <= 5 * np.sqrt(2 / len(z))
    assert abs((z**4).mean() - 3) <= 5 * np.sqrt(96 / len(z))


def test_logarithms_and_exponentials_are_right_to_the_last_bits():
    x = np.exp(np.random.default_rng(0).uniform(-80, 80, 20_000)).astype(np.float32)
    logs = np.asarray(jax.jit(jax.vmap(posterior.log))(x), float)
    np.testing.assert_allclose(logs, np.log(x.astype(float)), rtol=3e-7, atol=1e-7)
    back = np.asarray(jax.jit(jax.vmap(posterior.exp))(logs.astype(np.float32)), float)
    np.testing.assert_allclose(back, np.exp(logs.astype(np.float32).astype(float)), rtol=3e-7)


@pytest.mark.parametrize("name", ["r-max", "psrl"])
def test_what_learns_by_no_step_size_has_none_and_takes_any_policy(name):
    """Broken once: what epsilon is by default asked of the base class -> fails."""
    with pytest.raises(
        rl.InputError, match=f"^{name} has no parameter 'alpha'; choose one of epsilon, gamma, q0"
    ):
        rl.sweep(rl.make("chain"), name, {"alpha": 0.1}, num_seeds=1, num_steps=1)
    softmax = policies.Softmax(0.5)
    assert rl.ALGORITHMS[name](behaviour=softmax).selection is softmax
    with pytest.raises(rl.InputError, match="give epsilon or behaviour, not both"):
        rl.ALGORITHMS[name](behaviour=softmax, epsilon=0.1)


@pytest.mark.slow
def test_psrl_draws_from_the_same_words_in_float64():
    """Broken once: words of 64 bits, of which no draw was ever accepted -> fails."""
    x64 = {}
    for enabled in (False, True):
        with jax.enable_x64(enabled):
            method = rl.PSRL(gamma=0.5, spread=0.5)
            x64[enabled] = np.asarray(
                rl.train(rng.key(0), method, rl.make("two-doors"), num_steps=20, log_every=20)[0].q
            )
    assert (x64[False].dtype, x64[True].dtype) == (np.float32, np.float64)
    np.testing.assert_allclose(x64[True], x64[False], rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_those_who_explore_with_a_model_swim_up_the_river_where_others_stay_at_the_bank():
    """R-max where q0 is optimistic, PSRL anyhow. Broken once: q0 = 0; the mean model -> fails."""
    env = rl.make("river-swim")
    budget: Any = {"num_seeds": 20, "num_steps": 6000, "log_every": 3000}
    best = planning.start_value(env, planning.value_iteration(env, 0.95)[0])
    settings = {"r-max": {"q0": 20 * best, "m": 30}, "psrl": {"spread": 100.0, "every": 20}, "q-learning": {}}
    earned = {
        method: rl.sweep(env, method, {"gamma": 0.95, **grid}, **budget).log.rewards[:, -1]
        for method, grid in settings.items()
    }
    for method in ("r-max", "psrl"):
        assert np.median(earned[method]) > 20 * np.median(earned["q-learning"])


# --- docs/models.md ----------------------------------------------------------------------------------

PAGE = (Path(__file__).parent.parent / "docs/models.md").read_text(encoding="utf-8")


def test_the_page_shows_the_code_that_there_is():
    """Broken once: a line of the page changed -> fails."""
    (shown,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert shown == textwrap.dedent(inspect.getsource(rl.DynaQ.update))


def test_the_commands_of_the_page_are_understood(capsys):
    """Broken once: an option misspelt -> fails."""
    commands = [line.partition("#")[0].split() for line in PAGE.splitlines() if line.startswith("jaxrl-tab ")]
    assert len(commands) == 11
    for _, command, *words in commands:
        if command == "sweep":
            assert main([command, *words, "--dry-run"]) == 0
        elif command == "figure":
            assert words[0] in FIGURES
    named = re.findall(r"`jaxrl-tab figure ([a-z-]+)`", PAGE)
    assert len(named) == 3 and {*named} <= FIGURES.keys()
