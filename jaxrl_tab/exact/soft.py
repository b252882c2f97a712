"""The best policy where being unpredictable is worth something, too: entropy-regularised values."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxrl_tab.core.checks import RATE, check_within, first
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.model import (
    Model,
    backup,
    ending_at,
    exact_model,
    name_of,
    reachable,
    terminal_states,
    with_sizes,
)
from jaxrl_tab.exact.optimum import unless
from jaxrl_tab.exact.values import MAX_ROUNDS, ROUNDING, any_action, fate, policy_values


class Soft(NamedTuple):
    """The best policy where rewards count together with the entropy of its choices, float64.

    Attributes:
        policy: pi(a | s), proportional to exp(q(s, a) / temperature), [S, A].
        v: the soft values, [S]: temperature * log sum_a exp(q(s, a) / temperature).
        q: the soft action values, [S, A].
    """

    policy: Float[np.ndarray, "S A"]
    v: Float[np.ndarray, " S"]
    q: Float[np.ndarray, "S A"]


def soft_value_iteration(env: Environment, temperature: float, gamma: float = 1.0) -> Soft:
    """The policy that is best where each choice also earns `temperature` times its entropy, with its values.

        q(s, a) = E[R + gamma v(S') | s, a],    v(s) = temperature * log sum_a exp(q(s, a) / temperature)

    (Ziebart 2010; Haarnoja et al. 2017, equations 3 to 6). As the temperature goes to 0 these are the best values; they
    are never smaller, and for gamma below 1 larger by temperature * log(A) / (1 - gamma) at most. The equations are
    solved by policy iteration, which for them is Newton's method, up to rounding.

    At gamma = 1 wandering about may earn more in entropy than it costs: there is then no finite answer, and the
    error says so. A lower temperature has one where every step costs something.

    Args:
        env: an environment with `outcomes`.
        temperature: how much entropy, in nats, is worth; above 0.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: a number is out of range; or gamma is 1 and values are not finite, because some state that can be
            reached is never left for good, or because of what is said above.
    """
    check_within("temperature", temperature, {"greater_than": 0})
    check_within("gamma", gamma, RATE)
    model, out = _ending(env, gamma)
    over = terminal_states(model)
    probs, v = any_action(model), np.full(len(model.start), -np.inf)
    for _ in range(MAX_ROUNDS):
        bonus = temperature * np.where(over, 0, _entropy(probs))
        with np.errstate(all="ignore"):  # infinite values, which are told below
            earning = model._replace(reward=model.reward + bonus[:, None, None])
            new, size, _ = policy_values(earning, probs, gamma)
            if not np.isfinite(new).all():
                break
            sizes = size + (probs * backup(with_sizes(earning), size, gamma)).sum(1)
            if not (new > v + ROUNDING * np.finfo(float).eps * sizes).any():
                q = backup(model, new, gamma)
                return Soft(_softmax(q, temperature), unless(out, new), unless(out, q))
        v, probs = new, _softmax(backup(model, new, gamma), temperature)
    raise InputError(
        f"{name_of(env)}: at temperature {temperature:g} and gamma = {gamma:g} the soft values are not finite: to "
        "wander about earns more in entropy than it costs; take a lower temperature, or gamma below 1"
    )


def _ending(env: Environment, gamma: float) -> tuple[Model, Bool[np.ndarray, " S"]]:
    """The model, and which states were left out of it, for only from these entropy is earned for ever at gamma = 1."""
    model = exact_model(env)
    none = np.zeros(len(model.start), bool)
    if gamma < 1:
        return model, none
    anything = any_action(model)
    earning = abs(model.reward) + (_entropy(anything) > 0)[:, None, None] * ~model.terminal
    _, caught, _ = fate(model._replace(reward=earning), anything)
    if not caught.any():
        return model, none
    if (s := first(caught & (reached := reachable(model)))) is not None:
        raise InputError(
            f"{name_of(env)}: from state {s[0]} no episode ever ends, so at gamma = 1 its soft value is not finite; "
            "take gamma below 1"
        )
    return ending_at(model, ~reached), ~reached


def _softmax(q: Float[np.ndarray, "S A"], temperature: float) -> Float[np.ndarray, "S A"]:
    weight = np.exp((q - q.max(1, keepdims=True)) / temperature)
    return weight / weight.sum(1, keepdims=True)


def _entropy(probs: Float[np.ndarray, "S A"]) -> Float[np.ndarray, " S"]:
    return -(probs * np.log(np.where(probs > 0, probs, 1))).sum(1)
