"""Tabular control as it is usually written in JAX.

One `vmap` over all lanes, one `scan` over all steps, `jax.random.split` in every step, `Q.at[s, a].add`, and
a greedy action drawn from the maximal ones by `jax.random.choice`. No compiler flag is set.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.problems import ALPHA, EPSILON, GOAL, MOVES, SHAPE, START, WIND
from benchmarks.rounds import Round, Timing, warm


def env_step(s, a):
    rows, columns = SHAPE
    row, column = s // columns, s % columns
    move = jnp.array(MOVES)[a]
    row_next = jnp.clip(row + move[0] - jnp.array(WIND)[column], 0, rows - 1)
    column_next = jnp.clip(column + move[1], 0, columns - 1)
    s_next = row_next * columns + column_next
    return s_next, -1.0, s_next == GOAL


def epsilon_greedy(key, q_row):
    explore_key, action_key, tie_key = jax.random.split(key, 3)
    best = q_row == q_row.max()
    greedy = jax.random.choice(tie_key, len(MOVES), p=best / best.sum())
    random = jax.random.randint(action_key, (), 0, len(MOVES))
    return jnp.where(jax.random.uniform(explore_key) < EPSILON, random, greedy)


def learn(q, s, a, reward, done, q_next):
    return q.at[s, a].add(ALPHA * (reward + jnp.where(done, 0, q_next) - q[s, a]))


def train(key, method: str, steps: int):
    """One lane: Q after so many steps, and the number of episodes finished."""

    def step(carry, _):
        key, q, s, a, episodes = carry
        key, action_key = jax.random.split(key)
        s_next, reward, done = env_step(s, a)
        s_after = jnp.where(done, START, s_next)  # an environment that resets itself
        if method == "sarsa":
            a_next = epsilon_greedy(action_key, q[s_after])
            q = learn(q, s, a, reward, done, q[s_after, a_next])
        else:
            q = learn(q, s, a, reward, done, q[s_next].max())
            a_next = epsilon_greedy(action_key, q[s_after])
        return (key, q, s_after, a_next, episodes + done), None

    key, first_key = jax.random.split(key)
    q = jnp.zeros((SHAPE[0] * SHAPE[1], len(MOVES)))
    carry = key, q, jnp.int32(START), epsilon_greedy(first_key, q[START]), jnp.int32(0)
    (_, q, _, _, episodes), _ = jax.lax.scan(step, carry, length=steps)
    return q, episodes


def many_lanes(method: str, lanes: int, steps: int) -> Round:
    """The outcome of a lane is its number of episodes."""
    program = jax.jit(jax.vmap(lambda key: train(key, method, steps)))
    return _rounds(program, lambda seed: jax.random.split(jax.random.key(seed), lanes))


def one_run(method: str, steps: int) -> Round:
    """One run, without `vmap`."""
    return warm(_rounds(jax.jit(lambda key: train(key, method, steps)), jax.random.key))


def _rounds(program, keys) -> Round:
    compiled = program.lower(jax.eval_shape(keys, 0)).compile()

    def run(seed: int) -> Timing:
        begun = time.perf_counter()
        _, episodes = jax.tree.map(np.asarray, compiled(keys(seed)))
        return Timing(time.perf_counter() - begun, np.atleast_1d(episodes))

    return run
