"""What holds for every method and every environment: a new line in a registry is tested with no edit here."""

import batches
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import batch
from jaxrl_tab.types import Algorithm, Environment, FiniteEnvironment, Transition, pytree


def pairs(each):
    """(method, environment): each method with so many environments that follow one another in the registry,

    the next method with the next ones, and round again.
    """
    methods, envs = list(rl.ALGORITHMS), list(rl.ENVS)
    return [(m, envs[(i * each + k) % len(envs)]) for i, m in enumerate(methods) for k in range(each)]


# Each method in three environments or more, and each environment with two methods or more.
SEVERAL = pairs(max(3, -(-2 * len(rl.ENVS) // len(rl.ALGORITHMS))))


def test_several_pairs_leave_nothing_out():
    """Whatever is registered later."""
    assert len(set(SEVERAL)) == len(SEVERAL)
    assert min(sum(m == name for m, _ in SEVERAL) for name in rl.ALGORITHMS) >= 3
    assert min(sum(e == name for _, e in SEVERAL) for name in rl.ENVS) >= 2


@pytest.mark.parametrize(("method", "env_name"), SEVERAL)
def test_every_method_in_several_environments(method, env_name):
    """jit and vmap; shapes and dtypes; a batch of one program; the lanes are different runs."""
    env, algorithm = rl.make(env_name), rl.ALGORITHMS[method]()
    keys = jax.random.split(jax.random.key(0), 3)
    state, log = jax.jit(jax.vmap(lambda key: rl.train(key, algorithm, env, num_steps=300, log_every=100)))(
        keys
    )
    assert state.q.shape == (3, env.num_states, env.num_actions)
    assert state.q.dtype == jnp.float32
    assert np.isfinite(state.q).all()
    assert all(x.shape == (3, 3) for x in log if x is not None)
    assert [x.dtype for x in log[:5]] == [jnp.int32, jnp.int32, jnp.float32, jnp.int32, jnp.float32]
    assert (log.steps == 100).all()
    assert any(not np.array_equal(x[0], x[1]) for x in jax.tree.leaves((state, log)))


@pytest.mark.parametrize("name", rl.ENVS)
def test_environments_keep_the_protocol(name):
    env = rl.make(name)
    assert isinstance(env, Environment)
    assert isinstance(env, FiniteEnvironment)
    leaves, treedef = jax.tree.flatten(env)
    assert jax.tree.structure(jax.tree.unflatten(treedef, leaves)) == treedef
    assert env.initial().shape == (env.num_states,)


@pytest.mark.parametrize("name", rl.ALGORITHMS)
def test_methods_keep_the_protocol(name):
    cls = rl.ALGORITHMS[name]
    algorithm: Algorithm = cls()
    assert algorithm.gamma == 1.0
    assert algorithm.init(5, 2).q.shape == (5, 2)
    assert cls.__doc__
    for parameter, bad in (("alpha", 0), ("epsilon", 1.5), ("gamma", -0.1), ("alpha", float("nan"))):
        with pytest.raises(rl.InputError, match=rf"{cls.__name__}: {parameter} must be .*, not "):
            cls(**{parameter: bad})


ACTS_LATE = [name for name, cls in rl.ALGORITHMS.items() if getattr(cls, "acts_after_update", False)]


@pytest.mark.parametrize("name", ACTS_LATE)
def test_methods_that_say_that_they_act_after_their_update_do(name):
    """For then the driver draws A' in their place: from the same key it must be the same."""
    algorithm = rl.ALGORITHMS[name](alpha=1.0, epsilon=0.5)
    start = algorithm.init(2, 4)
    # S' = S, where the update changes the policy; at the end of the episode, for methods that wait for it.
    t = Transition(*map(jnp.asarray, (0, 1, -1.0, 0, 1.0, True)))

    def both(key):
        state, a_next = algorithm.update(key, start, t)
        return a_next, algorithm.policy(key, state, t.s_next), algorithm.policy(key, start, t.s_next)

    given, drawn, too_early = jax.vmap(both)(jax.random.split(jax.random.key(0), 100))
    np.testing.assert_array_equal(given, drawn)
    assert (given != too_early).any()


def test_a_subclass_with_an_update_of_its_own_acts_as_it_says(windy):
    """Sarsa's update in a class that inherits from Q-learning is Sarsa: A' is not drawn again."""

    @pytree
    class Borrowed(rl.QLearning):
        update = rl.Sarsa.update

    run = jax.jit(lambda method: rl.train(jax.random.key(0), method, windy, num_steps=1000, log_every=1000))
    np.testing.assert_array_equal(run(Borrowed(alpha=0.5))[0].q, run(rl.Sarsa(alpha=0.5))[0].q)


@pytest.mark.parametrize(("method", "env_name"), pairs(1))
def test_results_depend_on_seed_and_hyperparameters_alone(method, env_name):
    """Bitwise: a batch of 2 in reverse order on one device against a batch of 200 on two."""
    env = rl.make(env_name)

    def run(seeds, **kwargs):
        algorithm = rl.ALGORITHMS[method]()
        many = jax.tree.map(lambda x: (x + 0.01 * seeds).astype(np.float32), algorithm)
        budget = batch.Budget(num_steps=100, num_episodes=None, log_every=100, exact=False)
        return batches.run(env, many, seeds, budget, **kwargs)

    q, log = run(np.arange(200) % 50)
    few_q, few_log = run(np.array([33, 7]), devices=jax.devices()[1:])
    np.testing.assert_array_equal(few_q, q[[183, 7]])
    np.testing.assert_array_equal(few_log.rewards, log.rewards[[33, 157]])


@pytest.mark.parametrize("name", rl.ALGORITHMS)
def test_one_program_for_all_hyperparameter_values(name, windy):
    """Neither values, nor their number, nor Python numbers against arrays make a second program."""
    kwargs = {"num_steps": 64, "log_every": 64}
    first = rl.sweep(windy, name, {"alpha": [0.1, 0.5]}, num_seeds=2, **kwargs)
    programs = batch._compiled.cache_info().misses
    again = rl.sweep(
        windy, name, {"alpha": np.array([1, 0.25, 0.75]), "gamma": 0.5, "epsilon": 1}, num_seeds=70, **kwargs
    )
    assert batch._compiled.cache_info().misses == programs
    assert first.compile_seconds > 0
    assert again.log.steps.shape == (3, 70, 1)
