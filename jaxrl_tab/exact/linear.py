"""The best values as a linear program, and its dual: how often the best policy does what."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core.checks import RATE, check_within
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.model import Model, name_of, terminal_states
from jaxrl_tab.exact.optimum import solved, unless
from jaxrl_tab.exact.values import waiting

TOLERANCE = 1e-10  # the smallest that HiGHS takes, for constraints and for reduced costs
NOTHING = 1e-9  # a state that is left less often than this, of once or more, is one to stay in


class LinearProgram(NamedTuple):
    """The solution of both linear programs of a task, float64.

    Attributes:
        v: the best values, [S]; NaN where `planning.value_iteration` has it.
        policy: a best policy, [S, A].
        occupancy: how often it does what from the start, the step at t counted gamma^t times, [S, A].
        value: the sum of occupancy and reward, which is the best value from the start.
    """

    v: Float[np.ndarray, " S"]
    policy: Float[np.ndarray, "S A"]
    occupancy: Float[np.ndarray, "S A"]
    value: float


def linear_programming(env: Environment, gamma: float = 1.0) -> LinearProgram:
    """The optimum from two linear programs, by HiGHS in SciPy (Manne 1960; Puterman 1994, section 6.9).

    The values are the smallest that no action can improve on, and the occupancy is the one that earns the most of those
    that some policy can have:

        minimise sum_s v(s)             where v(s) >= r(s, a) + gamma sum_s' p(s' | s, a) v(s') for all s, a
        maximise sum_sa x(s, a) r(s, a) where x >= 0, and for all s'
                                        sum_a x(s', a) = start(s') + gamma sum_sa p(s' | s, a) x(s, a)

    At gamma = 1 the smallest such values need not be the best ones: where one can wait for nothing for ever, nothing
    keeps them from being below 0. There v(s) >= 0 is one more constraint, and to stop one more action of the second.

    The numbers are those of HiGHS, whose tolerance, 1e-10, is that of a constraint and not of a value, and is the same
    for all states, however large their rewards are: for exact values take `value_iteration`.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: as `value_iteration`; or HiGHS gave up.
    """
    check_within("gamma", gamma, RATE)
    model, _, out = solved(env, 0.0, gamma)
    flow, reward = _flow(model, gamma), (model.prob * model.reward).sum(2).ravel()
    states, actions = model.prob.shape[:2]
    home, staying = waiting(model)
    home &= gamma == 1
    has = np.ones(states * actions, bool) if model.available is None else model.available.ravel()
    floor = np.where(home, 0.0, -np.inf)
    bounds = np.stack([floor, np.full(states, np.inf)], 1)
    values = _minimum(env, np.ones(states), bounds, A_ub=-flow.T[has], b_ub=-reward[has])
    policy = np.zeros(states * actions)
    policy[has] = np.maximum(-values.ineqlin.marginals, 0)
    policy = policy.reshape(states, actions)
    policy = np.where((policy.sum(1) < NOTHING)[:, None], staying, policy)
    often = np.zeros(states * actions + home.sum())
    columns, pays = _with_stopping(flow, home), np.append(reward, np.zeros(home.sum()))
    used = np.append(has, np.full(home.sum(), True))
    most = _minimum(
        env,
        -pays[used],
        np.tile([0, np.inf], (used.sum(), 1)),
        A_eq=columns[:, used],
        b_eq=model.start,
    )
    often[used] = most.x
    occupancy = often[: states * actions].reshape(states, actions)
    occupancy[terminal_states(model)] = 0
    v = np.where(terminal_states(model), 0, values.x)
    return LinearProgram(unless(out, v), policy / policy.sum(1, keepdims=True), occupancy, -float(most.fun))


def _flow(model: Model, gamma: float) -> Any:
    """What a pair (s, a) takes out of each state, less what it brings into it: sparse [S, S A]."""
    from scipy import sparse  # here, because it takes 0.3 s

    states, actions, _ = model.prob.shape
    pair = np.broadcast_to(np.arange(states * actions).reshape(states, actions, 1), model.prob.shape)
    brought = gamma * model.prob * ~model.terminal
    entries = brought.ravel(), (model.s_next.ravel(), pair.ravel())
    size = states, states * actions
    taken = np.ones(size[1]), (np.repeat(np.arange(states), actions), np.arange(size[1]))
    return sparse.csc_array(taken, shape=size) - sparse.csc_array(entries, shape=size)


def _with_stopping(flow: Any, home: Any) -> Any:
    """The same with a column more for each state in which one may stop."""
    from scipy import sparse

    stop = sparse.csc_array(sparse.eye_array(len(home), format="csc"))[:, home]
    return sparse.csc_array(sparse.hstack([flow, stop]))


def _minimum(env: Environment, cost: np.ndarray, bounds: np.ndarray, **constraints: Any) -> Any:
    from scipy.optimize import linprog

    precise = {"primal_feasibility_tolerance": TOLERANCE, "dual_feasibility_tolerance": TOLERANCE}
    found = linprog(cost, bounds=bounds, method="highs", options=precise, **constraints)
    if found.status:
        raise InputError(f"{name_of(env)}: HiGHS found no optimum: {found.message}")
    return found
