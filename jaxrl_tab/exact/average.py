"""The average reward of a step: of a policy, and the largest (book, section 10.3; Puterman 1994, chapter 8)."""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import check_within, first
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.given import checked_policy
from jaxrl_tab.exact.model import (
    Model,
    backup,
    ending_at,
    exact_model,
    from_state_to_state,
    name_of,
    reachable,
    terminal_states,
)
from jaxrl_tab.exact.optimum import unless
from jaxrl_tab.exact.values import NEARLY, ROUNDING, greedy_to, iterate_policies, largest
from jaxrl_tab.exact.visits import long_run, stationary_distribution

STAYING = 0.5  # how much of each step is left out, so that no chain goes round and round
BETWEEN = 100  # sweeps of a policy alone, between two over all actions
APART = 1e-6  # rates that differ by more than that, relatively, are not one rate


def average_reward(env: Environment, policy_probs: ArrayLike) -> float:
    """The average reward of a step in the long run, r(pi), from the start distribution (book, equation 10.6).

    Of a chain with several sets of states that are never left it is the mean of their rates, with the probabilities
    with which the policy comes to each. Where episodes end the next one begins at once, as in `train`.

    Args:
        env: an environment with `outcomes`; its time limit does not count.
        policy_probs: the probability of each action in each state, [S, A]; terminal states need a row too.

    Raises:
        InputError: `policy_probs` is no policy.
    """
    model = exact_model(env)
    rewards = (checked_policy(model, policy_probs) * (model.prob * model.reward).sum(2)).sum(1)
    return float(stationary_distribution(env, policy_probs) @ rewards)


def relative_value_iteration(
    env: Environment, tol: float = 1e-10, max_sweeps: int = 100_000
) -> tuple[float, Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """The largest average reward of a step g*, the bias h, and a policy, of a task that does not end.

    They solve g* + h(s) = max_a E[R + h(S') | s, a] (Puterman 1994, equation 8.4.1), and the policy is greedy to the
    right side. h(s) is how much more is earned from s on than at the rate g*; weighted by how often the policy is in
    each state its mean is 0. That is for tasks with one rate, wherever they begin (unichain ones, and all where each
    state can be reached from each).

    Half of each step is left out (the aperiodicity transformation: Puterman, section 8.5.4), so that a chain that goes
    round and round settles, too. It starts from what is best at a discount rate of 1 - 1e-6.

    Args:
        env: an environment with `outcomes`; its time limit does not count.
        tol: how far g* may be off at most: it is between the least and the largest change of any state in a sweep.
            Where float64 does not allow it, a few units in the last place of the values.
        max_sweeps: how many sweeps over all actions to make at most; between two, policies are followed in less time.

    Returns:
        g*; h, float64 [S], NaN where no policy comes to; and the policy, float64 [S, A].

    Raises:
        InputError: the task ends; its rate depends on where it begins; or `max_sweeps` were not enough.
    """
    check_within("tol", tol, {"greater_than": 0})
    check_goes_on(env)
    model = exact_model(env)
    inside = reachable(model)
    model = ending_at(model, ~inside)
    found = iterate_policies(model, 0.0, NEARLY)
    _check_one_rate(env, model, greedy_to(found.q))
    home = int(np.flatnonzero(inside)[0])
    h = np.where(inside, found.v - found.v[home], 0)
    for _ in range(max_sweeps):
        q = backup(model, h, 1.0)
        changes = (largest(q) - h)[inside]
        low, high = changes.min(), changes.max()
        if high - low <= max(tol, ROUNDING * np.finfo(float).eps * abs(h).max()):
            policy = greedy_to(q)
            mean = stationary_distribution(env, policy) @ h
            return float((low + high) / 2), unless(~inside, h - mean), policy
        h[inside] += STAYING * changes
        h[inside] -= h[home]
        _follow(model, greedy_to(q), h, inside, home)
    raise InputError(
        f"{name_of(env)}: relative value iteration did not converge in {max_sweeps} sweeps; raise max_sweeps"
    )


def _follow(
    model: Model, policy: Float[np.ndarray, "S A"], h: Float[np.ndarray, " S"], inside: np.ndarray, home: int
) -> None:
    """Makes sweeps of one policy alone, in `h`: each takes a product with a matrix, and not all actions.

    So relative value iteration becomes modified policy iteration (Puterman 1994, section 8.7).
    """
    weight = np.where(model.terminal, 0, policy[:, :, None] * model.prob)
    rewards = (policy[:, :, None] * model.prob * model.reward).sum((1, 2))
    chain = from_state_to_state(model, weight)
    for _ in range(BETWEEN):
        h[inside] += STAYING * (rewards + chain @ h - h)[inside]
        h[inside] -= h[home]


def check_goes_on(env: Environment, who: str = "the average reward") -> None:
    """Raises InputError where a task can end, for there `who` is not what is asked for."""
    model = exact_model(env)
    ends = ((model.prob > 0) & model.terminal).any((1, 2)) & reachable(model) & ~terminal_states(model)
    if (s := first(ends)) is not None:
        raise InputError(f"{name_of(env)} can end in state {s[0]}, and {who} is for tasks that do not end")


def _check_one_rate(env: Environment, model: Model, policy: Float[np.ndarray, "S A"]) -> None:
    """Raises InputError where a best policy earns more from one state than from another in the long run."""
    rewards = (policy * (model.prob * model.reward).sum(2)).sum(1)
    rates = [(float(share @ rewards), int(np.argmax(share))) for share in long_run(model, policy)]
    (low, s), (high, other) = min(rates), max(rates)
    if high - low > APART * max(abs(low), abs(high)):
        raise InputError(
            f"{name_of(env)}: the best rate depends on where it begins: a step in the long run earns {low:.6g} from "
            f"state {s} and {high:.6g} from state {other}; there is no one average reward"
        )
