"""Episodes that are written out by hand."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxrl_tab.core.types import Task, Transition, init_learner


def learned(method, num_states, episodes, gamma, cut=False):
    """Q [S] of `method`, with one action, after episodes of (S, R, S') each.

    The last S' of each is terminal or, with `cut`, where time ran out.
    """
    rows = []
    for episode in episodes:
        for i, (s, r, s_next) in enumerate(episode):
            last = i == len(episode) - 1
            rows.append((s, 0, r, s_next, 0.0 if last and not cut else gamma, last))
    transitions = Transition(*map(jnp.asarray, zip(*rows, strict=True)))
    return _learn(method, num_states, transitions).q[:, 0]


@partial(jax.jit, static_argnums=1)
def _learn(method, num_states, transitions):
    key = jax.random.key(0)
    one = lambda state, t: (method.update(key, state, t)[0], None)
    return jax.lax.scan(one, init_learner(method, Task(num_states, 1, 10)), transitions)[0]
