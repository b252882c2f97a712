"""Tasks of gymnax whose states are real numbers, for methods with features."""

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.interop import from_gymnax

FIELDS = {
    "CartPole-v1": ("x", "x_dot", "theta", "theta_dot"),
    "MountainCar-v0": ("position", "velocity"),
    "Acrobot-v1": ("joint_angle1", "joint_angle2", "velocity_1", "velocity_2"),
}


@pytest.mark.parametrize(
    "name", [x if x == "CartPole-v1" else pytest.param(x, marks=pytest.mark.slow) for x in FIELDS]
)
def test_each_step_is_that_of_gymnax(name):
    """To the last bit: of 30 episodes, 40 steps each, of somebody who takes any action.

    Broken once: the fields of the state in the order of their names -> fails.
    """
    ours, (theirs, params) = from_gymnax(name), gymnax.make(name)
    assert ours.fields == FIELDS[name]
    keys = jax.random.split(jax.random.key(0), 30)
    actions = jax.random.randint(jax.random.key(1), (30, 40), 0, ours.num_actions)

    def episode(key, actions):
        def one(states, action):
            mine, state = states
            outcome = ours.step(key, mine, action)
            _, state, reward, terminal, _ = theirs.step_env(key, state, action, params)
            vector = jnp.stack([getattr(state, field) for field in ours.fields])
            same = (outcome.s_next == vector).all() & (outcome.reward == reward)
            return (outcome.s_next, state), (same & (outcome.terminal == terminal), terminal)

        return jax.lax.scan(one, (ours.reset(key), theirs.reset_env(key, params)[1]), actions)[1]

    same, terminal = jax.jit(jax.vmap(episode))(keys, actions)
    assert same.all()
    assert terminal.any() == (name == "CartPole-v1")
    assert ours.max_steps == params.max_steps_in_episode


def test_it_learns_to_hold_the_pole():
    """Who expects much of what was not tried holds it for hundreds of steps; a table is refused."""
    pole = rl.make("gymnax:CartPole-v1")
    tiles = {"features": "tile-coding(8, 4)", "alpha": 0.3, "per_tiling": True}
    grid = tiles | {"epsilon": 0.0, "q0": 100.0, "gamma": 0.99}
    result = rl.sweep(pole, approx.SemiGradientSarsa, grid, num_seeds=8, num_episodes=100, progress=False)
    lengths = np.asarray(result.log.lengths)
    assert lengths[:, :5].mean() < 60
    assert lengths[:, -20:].mean() > 150
    assert (result.log.rewards == lengths).all()
    assert result.environment == result.to_xarray().attrs["environment"] == "CartPole-v1"  # over all pictures
    with pytest.raises(rl.InputError, match="cannot be counted"):
        rl.train(jax.random.key(0), rl.Sarsa(), pole, num_steps=3)
