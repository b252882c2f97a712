"""Least-squares policy iteration: the best policy that features can say, from a log (Lagoudakis and Parr 2003)."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrl_tab.approx.features import read
from jaxrl_tab.approx.observed import Rows
from jaxrl_tab.core.checks import RATE, check_pytree, check_within
from jaxrl_tab.core.declared import name_of
from jaxrl_tab.core.errors import InputError, whole
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.types import Environment, available_actions
from jaxrl_tab.envs import ENVS
from jaxrl_tab.exact import planning

MOST = 5000  # weights: the system of more would take minutes


class LeastSquaresPolicy(NamedTuple):
    """What least-squares policy iteration has come to.

    Attributes:
        w: the weights, float64 [n, A].
        q: the values x(s) . w(., a), float64 [S, A]; `UNAVAILABLE` of actions that a state does not have.
        policy: the policy that is greedy to them, ties split, float64 [S, A].
        rounds: how many policies were evaluated.
        is_settled: whether the weights stayed what they were. Where it goes round several policies, they do not.
    """

    w: Float[np.ndarray, "n A"]
    q: Float[np.ndarray, "S A"]
    policy: Float[np.ndarray, "S A"]
    rounds: int
    is_settled: bool


def lspi(
    experience: Experience, env: Environment, features: Any = "one-hot", gamma: float = 0.9, *, most: int = 50
) -> LeastSquaresPolicy:
    """Learns a policy from a log, without a step size: evaluates a policy by LSTDQ, takes the greedy one, and so on.

    LSTDQ solves, for the policy pi and all steps (S, A, R, S') of the log,

        sum x(S, A) [x(S, A) - gamma' x(S', pi)]^T w = sum R x(S, A)      (Lagoudakis and Parr 2003, figures 5 and 8)

    with x(s, a) the features of s in the place of a and 0 in those of others, x(s, pi) = sum_a pi(a | s) x(s, a), and
    gamma' = gamma, or 0 where S' is terminal. It begins with all actions equally likely. What acted need not be
    known, and the same log serves every policy. Where the log leaves weights open, they are the smallest that do.

    Args:
        experience: the log; transitions in no order will do.
        env: the environment: of it the number of states and actions is asked, what is observed of a state, and which
            actions it has. No step is taken in it.
        features: as methods have them, "polynomial(4)" say, or a matrix [S, n].
        gamma: discount rate, in [0, 1].
        most: how many policies are evaluated at most.

    Raises:
        InputError: the states of `env` cannot be counted, the features do not fit them or are too many; or the log is
            none of such a task.
    """
    check_pytree("env", env, ENVS)
    if not isinstance(experience, Experience):
        raise InputError(f"lspi: experience must be an Experience, not {type(experience).__name__}")
    if not env.num_states:
        raise InputError(
            f"lspi: the states of {name_of(env)} cannot be counted, and a log has numbers of states"
        )
    check_within("gamma", gamma, RATE)
    most = whole("lspi", "most", most)
    states, actions = env.num_states, env.num_actions
    experience.check(states, actions)
    fitted = read(features).fitted(env)
    x = fitted.matrix if isinstance(fitted, Rows) else np.eye(states)
    size = x.shape[1]
    if size * actions > MOST:
        raise InputError(
            f"lspi: {fitted} are {size:,} features, of {actions} actions {size * actions:,} weights, and at most "
            f"{MOST:,} are possible"
        )
    available = available_actions(env)
    has = np.ones((states, actions), bool) if available is None else np.asarray(available)
    policy, w, rounds = has / has.sum(1, keepdims=True), np.zeros((size, actions)), 0
    while True:
        before, w = w, _lstdq(experience, x, policy, gamma)
        q = np.where(has, x @ w, UNAVAILABLE)
        policy, rounds = planning.greedy_policy(q), rounds + 1
        is_settled = np.allclose(w, before, rtol=1e-9, atol=1e-12)
        if is_settled or rounds == most:
            return LeastSquaresPolicy(w, q, policy, rounds, is_settled)


def _lstdq(
    log: Experience, x: Float[np.ndarray, "S n"], policy: Float[np.ndarray, "S A"], gamma: float
) -> Float[np.ndarray, "n A"]:
    """The weights of a policy. Steps that are the same are counted once, so that very long logs do."""
    size, actions = x.shape[1], policy.shape[1]
    steps = np.stack([log.s, log.a, log.s_next, log.terminal], 1).astype(int)
    different, which = np.unique(steps, axis=0, return_inverse=True)
    s, a, s_next, terminal = different.T
    count, reward = np.bincount(which.ravel()), np.bincount(which.ravel(), log.r)
    system, constant = np.zeros((actions, size, actions, size)), np.zeros((actions, size))
    for action in range(actions):
        here = a == action
        now, after = x[s[here]], x[s_next[here]]
        times, onward = count[here, None], gamma * (1 - terminal[here])
        system[action, :, action] += now.T @ (times * now)
        for other in range(actions):
            weight = times[:, 0] * onward * policy[s_next[here], other]
            system[action, :, other] -= now.T @ (weight[:, None] * after)
        constant[action] = now.T @ reward[here]
    flat = system.reshape(actions * size, actions * size)
    return np.linalg.lstsq(flat, constant.ravel())[0].reshape(actions, size).T
