"""The best values and actions where a task ends after a given number of steps: backward induction."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core import memory
from jaxrl_tab.core.checks import RATE, check_within
from jaxrl_tab.core.errors import InputError, whole
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.model import backup, exact_model, name_of
from jaxrl_tab.exact.values import greedy_to, largest


class FiniteHorizon(NamedTuple):
    """The optimum of a task that ends after H steps, float64; t counts the steps that were taken, from 0.

    Attributes:
        policy: what to do at step t, [H, S, A]; of several best actions any, equally likely.
        v: the largest expected sum of the rewards of steps t to H - 1, [H + 1, S]; v[H] is 0.
        q: the same after each action at step t, [H, S, A].
    """

    policy: Float[np.ndarray, "H S A"]
    v: Float[np.ndarray, "H1 S"]
    q: Float[np.ndarray, "H S A"]


def finite_horizon(env: Environment, horizon: int, gamma: float = 1.0) -> FiniteHorizon:
    """The best values and actions at each step of a task that ends after `horizon` steps, by backward induction.

        q_t(s, a) = E[R + gamma v_{t+1}(S') | s, a],    v_t(s) = max_a q_t(s, a),    v_H = 0

    (Puterman 1994, section 4.5). What is best may be another action the less time is left, so a policy is one for each
    step. There is always an answer, also at gamma = 1 where episodes never end. `v[0]` is what `horizon` sweeps of
    value iteration make of v = 0.

    Args:
        env: an environment with `outcomes`. Its own time limit does not count.
        horizon: H, the number of steps, at least 1.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: a number is out of range; `env` can only be sampled; or the tables do not fit in half of the memory
            that is free.
    """
    check_within("gamma", gamma, RATE)
    horizon, model = whole(None, "horizon", horizon), exact_model(env)
    states, actions = model.prob.shape[:2]
    needed = 8 * horizon * states * (2 * actions + 1)
    if 2 * needed > memory.free():
        raise InputError(
            f"{name_of(env)}: tables of {horizon:,} steps take {memory.words(needed)}, more than half of what is free"
        )
    v, q = np.zeros((horizon + 1, states)), np.zeros((horizon, states, actions))
    for t in reversed(range(horizon)):
        q[t] = backup(model, v[t + 1], gamma)
        v[t] = largest(q[t])
    return FiniteHorizon(greedy_to(q), v, q)
