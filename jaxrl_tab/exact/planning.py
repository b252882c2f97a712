"""The exact side: values and policies of an environment that states its dynamics.

The environment is enumerated once into a `Model` (every outcome of every action in every state), and all else
is sums over it (book, chapter 4). For people the model is float64 NumPy. Inside `train`, where the value of
the greedy policy is asked for at every log row, it is JAX arrays, in float64 too (`doubled`), although the
learner beside it is in float32. The formulas are written once, with operators that both understand; only
loops and branches (`while_loop`, `either`), what leads where (`reachable`, `reaching`, `_home`) and linear
systems (`_solve`) tell them apart.

**Every state is judged by its own numbers.** A state in which rewards are a million million times larger
changes no answer elsewhere, unless it can be reached from there. So linear systems are solved without
exchanging rows: elimination then combines a state with those that it leads to and with no others, and it is
stable, for each row is dominated by its diagonal (Higham 2002, Accuracy and Stability of Numerical
Algorithms, theorems 8.12 and 9.9). And what counts as rounding is measured state by state, see `_Values`.

**gamma = 1.** An infinite sum of rewards then need not exist, and what decides that is which states lead to
which, not numbers: `fate` follows the arrows of the graph. Under a policy, a state is *settled* where
nothing is earned or paid ever again (a terminal state; a loop without rewards): its value is 0. A state is
*caught* where no settled state can be reached: there rewards go on for ever. If no state is caught, all
values are finite.
"""

from typing import Literal, overload

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import RATE, check_within, first
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.accelerated import Sweeps, accelerated_value_iteration
from jaxrl_tab.exact.average import average_reward, check_goes_on, relative_value_iteration
from jaxrl_tab.exact.double import doubled, has_double, in_turn
from jaxrl_tab.exact.given import checked_policy, checked_table, checked_values
from jaxrl_tab.exact.hardness import Gaps, Hardness, Mixing, action_gaps, diameter, hardness, mixing
from jaxrl_tab.exact.horizon import FiniteHorizon, finite_horizon
from jaxrl_tab.exact.iterates import Iterates, generalized_policy_iteration
from jaxrl_tab.exact.linear import LinearProgram, linear_programming
from jaxrl_tab.exact.measure import (
    Measure,
    linear_value_measurer,
    long_run_measurer,
    measurer,
    value_measurer,
)
from jaxrl_tab.exact.model import (
    Model,
    backup,
    check_finite,
    check_lasting,
    enumerate_model,
    exact_model,
    from_state_to_state,
    name_of,
    once_for_an_environment,
    reachable,
    spread,
    terminal_states,
)
from jaxrl_tab.exact.optimum import rounding, solved, unless
from jaxrl_tab.exact.projected import LinearValues, linear_values
from jaxrl_tab.exact.soft import Soft, soft_value_iteration
from jaxrl_tab.exact.systems import sparse_solver
from jaxrl_tab.exact.values import (
    from_start,
    greedy_to,
    largest,
    policy_values,
)
from jaxrl_tab.exact.visits import entered, occupancy, regret, stationary_distribution

__all__ = [
    "FiniteHorizon",
    "Gaps",
    "Hardness",
    "Iterates",
    "LinearProgram",
    "LinearValues",
    "Measure",
    "Mixing",
    "Model",
    "Soft",
    "Sweeps",
    "accelerated_value_iteration",
    "action_gaps",
    "action_regret_map",
    "average_reward",
    "backup",
    "check_finite",
    "check_goes_on",
    "check_lasting",
    "checked_values",
    "diameter",
    "doubled",
    "entered",
    "enumerate_model",
    "epsilon_greedy_policy",
    "epsilon_soft",
    "evaluate",
    "evaluation_backup",
    "exact_model",
    "expectation_backup",
    "finite_horizon",
    "from_state_to_state",
    "generalized_policy_iteration",
    "greedy_policy",
    "hardness",
    "has_double",
    "in_turn",
    "largest_return",
    "linear_programming",
    "linear_value_measurer",
    "linear_values",
    "long_run_measurer",
    "measurer",
    "mixing",
    "occupancy",
    "optimality_backup",
    "policy_iteration",
    "policy_value",
    "reachable",
    "regret_map",
    "relative_value_iteration",
    "soft_value_iteration",
    "sparse_solver",
    "spread",
    "start_value",
    "stationary_distribution",
    "terminal_states",
    "value_iteration",
    "value_measurer",
]

PATH_SWEEPS = 100  # of `largest_return`


def expectation_backup(
    env: Environment, q: ArrayLike, policy_probs: ArrayLike, gamma: float = 1.0
) -> Float[np.ndarray, "S A"]:
    """One sweep of q-policy iteration: q(s, a) <- E[R + gamma q(S', A') | s, a], A' ~ pi, float64 [S, A].

    The right-hand side of the Bellman expectation equation for q_pi (book, equation 3.14 for v_pi; Silver,
    lecture 5).

    Args:
        env: an environment with `outcomes`.
        q: action values, [S, A].
        policy_probs: pi, the probability of each action in each state, [S, A].
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: a table has the wrong shape, or `policy_probs` is no policy.
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    v = (checked_policy(model, policy_probs) * checked_values(model, "q", q)).sum(1)
    return backup(model, v, gamma)


def optimality_backup(env: Environment, q: ArrayLike, gamma: float = 1.0) -> Float[np.ndarray, "S A"]:
    """One sweep of q-value iteration: q(s, a) <- E[R + gamma max_a' q(S', a') | s, a], float64 [S, A].

    The right-hand side of the Bellman optimality equation for q* (book, equation 3.20). Args and errors: as
    `expectation_backup`.
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    return backup(model, largest(checked_values(model, "q", q)), gamma)


def evaluation_backup(
    env: Environment, v: ArrayLike, policy_probs: ArrayLike, gamma: float = 1.0
) -> Float[np.ndarray, " S"]:
    """One sweep of iterative policy evaluation: v(s) <- E[R + gamma v(S') | s], A ~ pi, float64 [S].

    The right-hand side of the Bellman expectation equation for v_pi (book, equation 4.5). Args and errors: as
    `expectation_backup`, but for `v`, the values, [S].
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    probs = checked_policy(model, policy_probs)
    return (probs * backup(model, checked_values(model, "v", v), gamma)).sum(1)


def start_value(env: Environment, v: ArrayLike) -> float:
    """The mean of the values `v` [S] over the start distribution."""
    model = exact_model(env)
    return float(from_start(model, checked_values(model, "v", v)))


# --- policies of a table of action values ------------------------------------------------------------
def greedy_policy(q: ArrayLike) -> Float[np.ndarray, "... S A"]:
    """The policy that is greedy to `q`: the maximal actions of a state equally likely, float64 [..., S, A].

    Args:
        q: a table of action values [S, A], or many [..., S, A], such as `result.q` or `ds.q`.

    Raises:
        InputError: `q` is no such table, or an entry is not a number.
    """
    return greedy_to(checked_table(q))


def epsilon_greedy_policy(q: ArrayLike, epsilon: float) -> Float[np.ndarray, "... S A"]:
    """The policy that is epsilon-greedy to `q`, ties split equally, float64 [..., S, A] (book, section 5.4).

    Args and errors: as `greedy_policy`; and `epsilon` must be in [0, 1].
    """
    check_within("epsilon", epsilon, RATE)
    return greedy_to(checked_table(q), epsilon)


# --- exact answers -----------------------------------------------------------------------------------
def evaluate(env: Environment, policy_probs: ArrayLike, gamma: float = 1.0) -> Float[np.ndarray, " S"]:
    """The values of a policy, float64 [S], from its Bellman equations as one sparse linear system.

    Args:
        env: an environment with `outcomes`.
        policy_probs: the probability of each action in each state, [S, A]; terminal states need a row too.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: `policy_probs` is no policy; or gamma is 1 and from some state the policy never ends while
            rewards go on, so that its value is not finite. (Where no reward ever comes again it is 0.)
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    v, _, caught = policy_values(model, checked_policy(model, policy_probs), gamma)
    if caught.any():
        raise InputError(
            f"{name_of(env)}: from state {first(caught)[0]} this policy never ends and rewards go on, so at "
            "gamma = 1 it has no finite value; take gamma below 1, or ask policy_value, from the start alone"
        )
    return v


def policy_value(env: Environment, policy_probs: ArrayLike, gamma: float = 1.0) -> float:
    """The value of a policy from the start distribution; -inf where it may be caught at gamma = 1.

    This is what to ask about a learned Q: `policy_value(env, greedy_policy(q))`. In states that were never
    visited a greedy policy often goes round for ever, but it may never come there.

    Args and errors: as `evaluate`.
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    return float(from_start(model, policy_values(model, checked_policy(model, policy_probs), gamma).v))


@overload
def value_iteration(
    env: Environment,
    gamma: float = ...,
    tol: float = ...,
    max_sweeps: int = ...,
    *,
    history: Literal[False] = ...,
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]: ...
@overload
def value_iteration(
    env: Environment, gamma: float = ..., tol: float = ..., max_sweeps: int = ..., *, history: Literal[True]
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S A"], Iterates]: ...
def value_iteration(
    env: Environment,
    gamma: float = 1.0,
    tol: float = 1e-10,
    max_sweeps: int = 100_000,
    *,
    history: bool = False,
) -> tuple:
    """The optimal values v* and q* (book, section 4.4), float64 [S] and [S, A]; 0 at terminal states.

    At gamma = 1 values need not be finite. Where that is so only of states that cannot be reached from the
    start, all such states have NaN, and the others what they are worth.

    It starts from the values that policy iteration finds, for from 0 a corridor of S states would need S
    sweeps, and at gamma = 1 waiting for nothing may look better than it is. Sweeps then show how far these
    are from v*. The sweeps from 0 on, as in the book, are the history.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        tol: how far the value of any state may be from v*, whatever other states are worth. A bound for gamma
            below 1; at gamma = 1 an estimate, as if the changes went on shrinking at the slower of the last
            two rates. Where float64 does not allow it, for values and rewards of 1e9, say, a state is as
            good as rounding makes it: a sweep changes it by less than a few units in the last place of the
            numbers that are added up for it.
        max_sweeps: how many sweeps to make at most.
        history: whether to give the sweeps from 0 on as well, one by one: v, q, and the `Iterates` of
            `generalized_policy_iteration(env, gamma, sweeps=1)`.

    Raises:
        InputError: gamma is 1 and from some state that can be reached no policy ever ends while rewards go
            on, or a round trip earns more than it costs; or `max_sweeps` were not enough.
    """
    check_within("gamma", gamma, RATE)
    check_within("tol", tol, {"greater_than": 0})
    model, last, out = solved(env, 0.0, gamma)
    v, unsure = last.v, rounding(model, last, gamma)
    old, ratio = np.inf, 1.0
    for _ in range(max_sweeps):
        new_v = largest(backup(model, v, gamma))
        changes = abs(new_v - v)
        change = changes[changes > unsure].max(initial=0)
        rate = gamma if gamma < 1 else max(ratio, change / old)
        v = new_v
        if change * rate <= tol * (1 - rate):
            q = backup(model, v, gamma)
            found = unless(out, largest(q)), unless(out, q)
            return (*found, generalized_policy_iteration(env, gamma, sweeps=1)) if history else found
        old, ratio = change, change / old
    raise InputError(
        f"{name_of(env)}: value iteration did not converge in {max_sweeps} sweeps; raise max_sweeps"
    )


@overload
def policy_iteration(
    env: Environment, gamma: float = ..., *, history: Literal[False] = ...
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]: ...
@overload
def policy_iteration(
    env: Environment, gamma: float = ..., *, history: Literal[True]
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"], Iterates]: ...
def policy_iteration(env: Environment, gamma: float = 1.0, *, history: bool = False) -> tuple:
    """An optimal policy [S, A], v* [S] and q* [S, A], float64 (book, section 4.3).

    In no state is another action better by more than rounding, judged by the numbers that the values of the
    two are added up from, and not by what other states are worth. Of several best actions the policy takes
    any mixture, but at gamma = 1 one that ends where it must to be optimal. (To take the first of several
    best actions may be to go round for ever.)

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        history: whether to give every policy on the way as well: policy, v*, q*, and the `Iterates` of
            `generalized_policy_iteration(env, gamma)`.

    Raises:
        InputError: as `value_iteration`.
    """
    found = epsilon_soft(env, 0.0, gamma)
    return (*found, generalized_policy_iteration(env, gamma)) if history else found


def epsilon_soft(
    env: Environment, epsilon: float, gamma: float = 1.0
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """The best policy that takes every action with probability epsilon / A or more (book, section 5.4).

    Returns:
        The policy [S, A], its values [S] and its action values [S, A], float64; as good as those of
        `policy_iteration`. (`generalized_policy_iteration` shows the way to it.)

    Raises:
        InputError: epsilon is not in [0, 1], or as `value_iteration`.
    """
    check_within("epsilon", epsilon, RATE)
    check_within("gamma", gamma, RATE)
    _, last, out = solved(env, epsilon, gamma)
    return last.probs.copy(), unless(out, last.v), unless(out, last.q)


def largest_return(env: Environment, gamma: float, steps: int, anywhere: bool = False) -> float:
    """The largest |R_1 + gamma R_2 + ...| that so many steps or fewer can give, by any actions and outcomes.

    What the steps after the first `PATH_SWEEPS` can add is bounded by what the last of these could: with each
    step more a path can gain no more than with the step before.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        steps: the number of steps, at least 1.
        anywhere: whether the first step may be in any state, or only where one can come from the start.
    """
    return float(_largest_return(env, gamma, steps, anywhere))


@once_for_an_environment(like=None)
def _largest_return(env: Environment, gamma: float, steps: int, anywhere: bool) -> np.ndarray:
    model = exact_model(env)
    begin = np.full(len(model.start), True) if anywhere else reachable(model)
    reward, goes_on = np.where(model.prob > 0, model.reward, 0), (model.prob > 0) & ~model.terminal
    most, left, change = np.zeros((2, len(begin))), steps, 0.0  # of the rewards, and of the costs
    while left and left > steps - PATH_SWEEPS:
        later = gamma * np.where(goes_on, most[:, model.s_next], 0)
        new = np.maximum(0, (np.stack([reward, -reward]) + later).max((2, 3)))
        change, most, left = (new - most)[:, begin].max(), new, left - 1
        if not change:
            break
    more = left if gamma == 1 else gamma * (1 - gamma**left) / (1 - gamma)
    return np.array(most[:, begin].max() + change * more)


# --- where the regret comes from ---------------------------------------------------------------------
def regret_map(env: Environment, policy_probs: ArrayLike, gamma: float = 1.0) -> Float[np.ndarray, " S"]:
    """Where a policy loses what it earns less than the best one, float64 [S], 0 or more.

    v*(start) - v_pi(start) = sum over s of occupancy(s) sum over a of pi(a | s) (v*(s) - q*(s, a))

    is exact (the performance difference lemma: Kakade and Langford 2002, lemma 6.1, about the best policy). Each
    state has its term: how often the policy is there, times how much its actions there lose, all else being done in
    the best way. `action_regret_map` has the terms of single actions.

    At gamma = 1 a policy may stay for ever where nothing is earned or paid. No single step loses anything there, but
    what could have been earned never is: v*(s) is then lost where it comes to stay, in s.

    Args:
        env: an environment with `outcomes`; its time limit does not count.
        policy_probs: pi, the probability of each action in each state, [S, A]; terminal states need a row too.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: as `value_iteration`; `policy_probs` is no policy; or gamma is 1 and from some state that the
            policy may come to it never ends while rewards go on, so that it loses without bound. (What it does
            where it does not come to does not matter.)
    """
    return action_regret_map(env, policy_probs, gamma).sum(1)


def action_regret_map(
    env: Environment, policy_probs: ArrayLike, gamma: float = 1.0
) -> Float[np.ndarray, "S A"]:
    """By which actions a policy loses what it earns less than the best one, float64 [S, A], 0 or more.

    occupancy(s) pi(a | s) (v*(s) - q*(s, a)) of each state and action; `regret_map` are its sums over the actions.
    """
    v, q = value_iteration(env, gamma)
    model = exact_model(env)
    found = regret(model, checked_policy(model, policy_probs), v, q, gamma)
    if (s := first(found.caught)) is not None:
        raise InputError(
            f"{name_of(env)}: this policy may come to state {s[0]}, from which it never ends and rewards go on, so at "
            "gamma = 1 its regret is infinite; take gamma below 1"
        )
    return found.by_action
