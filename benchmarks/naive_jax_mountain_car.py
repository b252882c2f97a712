"""Semi-gradient Sarsa on the mountain car as it is usually written in JAX.

One `vmap` over all runs, a `scan` over episodes, and in it a `while_loop` over the steps of an episode. No compiler
flag is set.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.problems import CAR_ALPHA, LONGEST, TILES, TILINGS
from benchmarks.rounds import Round, Timing

LOW, HIGH = (-1.2, -0.07), (0.5, 0.07)
SHIFTS = np.array([[t, 3 * t % TILINGS] for t in range(TILINGS)])


def tiles(s):
    """The tile of each tiling, in an array of weights [tilings, tiles + 1, tiles + 1, actions]."""
    low, high = jnp.array(LOW), jnp.array(HIGH)
    fine = jnp.floor((s - low) / (high - low) * TILES * TILINGS).astype(int)
    along = (fine + SHIFTS) // TILINGS
    return jnp.arange(TILINGS), along[:, 0], along[:, 1]


def env_step(s, a):
    position, velocity = s
    velocity = jnp.clip(velocity + 0.001 * (a - 1) - 0.0025 * jnp.cos(3 * position), LOW[1], HIGH[1])
    position = jnp.clip(position + velocity, LOW[0], HIGH[0])
    velocity = jnp.where(position <= LOW[0], 0, velocity)
    return jnp.array([position, velocity]), -1.0, position >= HIGH[0]


def greedy(key, q_row):
    best = q_row == q_row.max()
    return jax.random.choice(key, len(q_row), p=best / best.sum())


def train(key, episodes: int):
    """One run: the length of each episode."""

    def step(carry):
        key, w, s, a, _, length = carry
        key, action_key = jax.random.split(key)
        s_next, reward, done = env_step(s, a)
        q_next = w[tiles(s_next)].sum(0)
        a_next = greedy(action_key, q_next)
        here = *tiles(s), a
        delta = reward + jnp.where(done, 0, q_next[a_next]) - w[here].sum()
        return key, w.at[here].add(CAR_ALPHA / TILINGS * delta), s_next, a_next, done, length + 1

    def episode(carry, _):
        key, w = carry
        key, start_key, action_key = jax.random.split(key, 3)
        s = jnp.array([jax.random.uniform(start_key, minval=-0.6, maxval=-0.4), 0])
        a = greedy(action_key, w[tiles(s)].sum(0))
        carry = key, w, s, a, jnp.array(False), 0
        key, w, *_, length = jax.lax.while_loop(lambda carry: ~carry[4] & (carry[5] < LONGEST), step, carry)
        return (key, w), length

    w = jnp.zeros((TILINGS, TILES + 1, TILES + 1, 3))
    return jax.lax.scan(episode, (key, w), length=episodes)[1]


def many_runs(lanes: int, episodes: int) -> Round:
    """The outcome of a run is the mean length of its episodes."""
    keys = lambda seed: jax.random.split(jax.random.key(seed), lanes)
    program = jax.jit(jax.vmap(lambda key: train(key, episodes)))
    compiled = program.lower(jax.eval_shape(keys, 0)).compile()

    def run(seed: int) -> Timing:
        begun = time.perf_counter()
        lengths = np.asarray(compiled(keys(seed)))
        return Timing(time.perf_counter() - begun, lengths.mean(1))

    return run
