"""What holds for every method and every environment: a new line in a registry is tested with no edit here."""

import batches
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning, policies, schedules
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import (
    Algorithm,
    Environment,
    FiniteEnvironment,
    Transition,
    fitted,
    init_learner,
    table_of,
)
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.part import _same_program
from jaxrl_tab.methods import METHODS


def pairs():
    """(method, environment): one after the other through both registries, until both are at their end."""
    methods, envs = list(rl.ALGORITHMS), list(rl.ENVS)
    count = max(len(methods), len(envs))
    both = [(methods[i % len(methods)], envs[i % len(envs)]) for i in range(count)]
    return [(method, env_for(method, env)) for method, env in both]


GOES_ON, HAS_HORIZON = "access-control", "deep-sea"


def in_the_long_run(method):
    return method in METHODS and of_method(METHODS[method]).in_the_long_run


def env_for(name, env):
    """The name of an environment for a method: `env`, or one of the kind that it needs."""
    needs_horizon = name in METHODS and of_method(METHODS[name]).needs_horizon
    return GOES_ON if in_the_long_run(name) else HAS_HORIZON if needs_horizon else env


@pytest.mark.one_in(13)
@pytest.mark.parametrize(("method", "env_name"), pairs())
def test_results_depend_on_seed_and_hyperparameters_alone(method, env_name):
    """Bitwise: runs among others, and in another order. (On one device and on two: see test_batch.)

    Also shapes and dtypes; and the lanes are different runs.
    """
    env = rl.make(env_name)

    def run(seeds):
        algorithm = rl.ALGORITHMS[method]()
        # Each lane has other hyperparameters; but what weighs later steps must not come to be above 1.
        down = {"gamma", "lam", "lam_v"}
        near = lambda path, x: x + 0.01 * (-seeds if path[-1].name in down else seeds)
        many = jax.tree_util.tree_map_with_path(lambda *leaf: near(*leaf).astype(np.float32), algorithm)
        budget = Budget(num_steps=200, num_episodes=None, log_every=100, exact=False)
        return batches.run(env, many, seeds, budget)

    (q, log), (few_q, few_log) = run(np.arange(200) % 50), run(np.array([33, 7]))
    np.testing.assert_array_equal(few_q, q[[183, 7]])
    np.testing.assert_array_equal(few_log.rewards, log.rewards[[33, 157]])
    assert q.shape == (200, env.num_states, env.num_actions)
    assert q.dtype == jnp.float32
    assert np.isfinite(q).all()
    assert all(x.shape == (200, 2) for x in jax.tree.leaves(log))
    assert [x.dtype for x in log[:5]] == [jnp.int32, jnp.int32, jnp.float32, jnp.int32, jnp.float32]
    assert (log.steps == 100).all()
    assert any(
        (x != x[:1]).any() for x in jax.tree.leaves((q, log))
    )  # in some mazes few runs come to a reward


@pytest.mark.parametrize("name", rl.ENVS)
def test_environments_keep_the_protocol(name):
    env = rl.make(name)
    assert isinstance(env, Environment)
    leaves, treedef = jax.tree.flatten(env)
    assert jax.tree.structure(jax.tree.unflatten(treedef, leaves)) == treedef
    if env.num_states:
        assert isinstance(env, FiniteEnvironment)
        assert env.initial().shape == (env.num_states,)
    else:
        assert len(env.low) == len(env.high) == len(env.reset(jax.random.key(0)))


@pytest.mark.parametrize("name", rl.ALGORITHMS)
def test_methods_keep_the_protocol(name):
    cls = rl.ALGORITHMS[name]
    algorithm: Algorithm = cls()
    assert algorithm.gamma == 1.0
    env = rl.FiniteMDP(np.full((5, 2, 5), 0.2), np.zeros((5, 2)), max_steps=4)
    own = fitted(algorithm, env)
    assert jax.eval_shape(lambda: table_of(own, 5, init_learner(own, env))).shape[-2:] == (5, 2)
    assert cls.__doc__
    for parameter, bad in (("alpha", 0), ("epsilon", 1.5), ("gamma", -0.1), ("alpha", float("nan"))):
        if hasattr(algorithm, parameter):
            with pytest.raises(rl.InputError, match=rf"{cls.__name__}: {parameter} must be .*, not "):
                cls(**{parameter: bad})
    gamma = 1.0 if in_the_long_run(name) else 0.25
    # What is swept is no part of the program: other values of it would make another one.
    others = {"alpha": 1, "epsilon": 0.5, "gamma": gamma, "q0": 1, "theta0": 1}
    other = cls(**{name: value for name, value in others.items() if hasattr(algorithm, name)})
    another = cls(alpha=0.3) if hasattr(algorithm, "alpha") else cls(gamma=gamma)
    assert len(_same_program([cls(), other, another])) == (
        1 if isinstance(getattr(algorithm, "alpha", 0.3), float) else 2  # a schedule by default, and a number
    )


def traced(method, env, **budget):
    jax.eval_shape(lambda key: rl.train(key, method, env, **budget), jax.random.key(0))


@pytest.mark.parametrize("name", [*METHODS, *rl.ENVS])
def test_what_is_traced_mixes_no_types(name):
    """So that it runs where somebody has forbidden that (`jax_numpy_dtype_promotion=strict`).

    Broken once: `2 * s_next + terminal` -> fails in every environment.
    """
    with jax.numpy_dtype_promotion("strict"):
        env = rl.make(name if name in rl.ENVS else env_for(name, "random-walk"))
        method = METHODS[name]() if name in METHODS else rl.Sarsa(epsilon=schedules.glie())
        if not env.num_states:
            method = rl.approx.SemiGradientSarsa(features="tile-coding", epsilon=schedules.glie())
        traced(method, env, num_steps=3, exact=name == "td")
        if env.num_states:
            planning.exact_model(env)


def test_a_sweep_mixes_no_types():
    with jax.numpy_dtype_promotion("strict"):
        result = rl.sweep(rl.RandomWalk(), "sarsa", {"alpha": [0.1, 0.2]}, num_seeds=2, num_steps=3)
    assert result.log.steps.sum() == 12


@pytest.mark.parametrize("behaviour", policies.POLICIES)
def test_no_policy_and_no_schedule_mixes_types(behaviour):
    with jax.numpy_dtype_promotion("strict"):
        for schedule in (
            "harmonic:9:visit",
            "power:0.8:step",
            "linear:1:0.1:9:visit",
            "exponential:1:0.9:step",
        ):
            traced(
                rl.MonteCarlo(alpha=schedules.parse(schedule), behaviour=policies.parse(behaviour)),
                rl.RandomWalk(),
                num_steps=3,
            )
        traced(rl.Sarsa(alpha=schedules.Optax(lambda n: 1 / (n + 1))), rl.RandomWalk(), num_steps=3)


ACTS_LATE = [name for name, cls in rl.ALGORITHMS.items() if getattr(cls, "acts_after_update", False)]


@pytest.mark.one_in(8)
@pytest.mark.parametrize("name", ACTS_LATE)
def test_methods_that_say_that_they_act_after_their_update_do(name):
    """For then the driver draws A' in their place: from the same key it must be the same."""
    cls = rl.ALGORITHMS[name]
    algorithm = cls(
        **{x: value for x, value in (("alpha", 1.0), ("epsilon", 0.5), ("c", 0.2)) if hasattr(cls, x)}
    )
    # S' = S, where the update changes the policy; at the end of the episode, for methods that wait for it.
    t = Transition(*map(jnp.asarray, (0, 1, -1.0, 0, 1.0, True)))
    # One reward of 0 before, with which the gradient bandit compares the next.
    start, _ = algorithm.update(jax.random.key(0), algorithm.init(2, 4), t._replace(r=jnp.asarray(0.0)))

    def both(key):
        state, a_next = algorithm.update(key, start, t)
        return a_next, algorithm.policy(key, state, t.s_next), algorithm.policy(key, start, t.s_next)

    given, drawn, too_early = jax.jit(jax.vmap(both))(jax.random.split(jax.random.key(0), 100))
    np.testing.assert_array_equal(given, drawn)
    assert (given != too_early).any()


def test_a_subclass_with_an_update_of_its_own_acts_as_it_says(windy):
    """Sarsa's update in a class that inherits from Q-learning is Sarsa: A' is not drawn again."""

    @pytree
    class Borrowed(rl.QLearning):
        update = rl.Sarsa.update

    run = jax.jit(lambda method: rl.train(jax.random.key(0), method, windy, num_steps=1000, log_every=1000))
    np.testing.assert_array_equal(run(Borrowed(alpha=0.5))[0].q, run(rl.Sarsa(alpha=0.5))[0].q)
