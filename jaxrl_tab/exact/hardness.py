"""How hard a task is to learn: how far its states lie apart, how close its actions are, how long it remembers."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import FRACTION, RATE, check_within
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.given import checked_policy
from jaxrl_tab.exact.model import Model, backup, exact_model, reachable, terminal_states, with_sizes
from jaxrl_tab.exact.optimum import solved, unless
from jaxrl_tab.exact.systems import sparse_solver
from jaxrl_tab.exact.values import ROUNDING, any_action, fate, policy_values
from jaxrl_tab.exact.visits import entered, occupancy

MOST_STATES = 1000  # of which all this takes seconds, at most half a minute
UNIT = ROUNDING * np.finfo(float).eps
NOTHING = 1e-12  # an improvement by less than this, relatively, is rounding
LONG = 64  # relaxation times, and that for each state: after these nothing is left of the start
ONE = 1e-9  # an eigenvalue whose modulus is so close to 1 is taken for 1


class Gaps(NamedTuple):
    """How much worse each action is than the best one of its state.

    Attributes:
        gap: v*(s) - q*(s, a), float64 [S, A]: 0 for the best actions; NaN where a state does not have the action, and
            where `planning.value_iteration` has it.
        smallest: the smallest that is not 0, of all states that can be reached; infinite where there is none.
        state, action: where that is; -1 where there is none.
    """

    gap: Float[np.ndarray, "S A"]
    smallest: float
    state: int
    action: int


def action_gaps(env: Environment, gamma: float = 1.0) -> Gaps:
    """The action gaps v*(s) - q*(s, a), and the smallest of them that is not 0.

    To tell an action from the best one by its samples takes about 1 / gap^2 of them (the bounds of Simchowitz and
    Jamieson 2019 add these up). What may be rounding, judged state by state, is 0.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: as `value_iteration`.
    """
    check_within("gamma", gamma, RATE)
    model, last, out = solved(env, 0.0, gamma)
    _, size, _ = policy_values(model, last.probs, gamma)
    unsure = UNIT * (size[:, None] + abs(backup(with_sizes(model), size, gamma)))
    gap = last.v[:, None] - last.q
    has = np.ones(gap.shape, bool) if model.available is None else model.available
    gap = np.where(has, np.where(gap > unsure, gap, 0), np.nan)
    counts = (gap > 0) & (reachable(model) & ~terminal_states(model))[:, None]
    if not counts.any():
        return Gaps(unless(out, gap), np.inf, -1, -1)
    s, a = np.unravel_index(np.where(counts, gap, np.inf).argmin(), gap.shape)
    return Gaps(unless(out, gap), float(gap[s, a]), int(s), int(a))


# --- how far ------------------------------------------------------------------------------------------


def diameter(env: Environment) -> float:
    """How long it takes to get from one state to another, if one tries, where that takes longest, in steps.

        max over s and s' of min over policies of E[steps from s to s']

    (Jaksch, Ortner and Auer 2010, Near-optimal regret bounds for reinforcement learning, definition 1). Where an
    episode ends the next one begins, as in `train`, which takes no time; the states are those that can be reached from
    the start and are not terminal. Infinite where one of them cannot be reached from another.

    It is a stochastic shortest path to each state, solved by policy iteration: some seconds for 500 states.

    Args:
        env: an environment with `outcomes`; its time limit does not count.
    """
    states, step = _without_end(exact_model(env))
    n = len(states)
    if n < 2:
        return 0.0
    from scipy import sparse  # here, because it takes 0.3 s
    from scipy.sparse.csgraph import connected_components

    actions = step.shape[0] // step.shape[1]
    mean = sparse.kron(sparse.eye_array(n + 1), np.full((1, actions), 1 / actions), format="csr") @ step
    reached = np.arange(n + 1) if mean[:, [n]].nnz else np.arange(n)
    if connected_components(mean[reached][:, reached], connection="strong")[0] > 1:
        return np.inf
    return max(float(_times_to(goal, step, mean, actions)[:n].max()) for goal in range(n))


def _times_to(goal: int, step: Any, mean: Any, actions: int) -> Float[np.ndarray, " S1"]:
    """The least expected number of steps from each state to the goal; the last one, between episodes, takes none.

    Args:
        step: the probabilities of each state and action, sparse [S1 A, S1].
        mean: the same of the policy that takes any action, sparse [S1, S1], from which the goal is always reached.
    """
    index = np.arange(mean.shape[0])
    takes = (index < len(index) - 1).astype(float)
    elsewhere = (index != goal).astype(float)
    time, before, policy = _time(mean, takes, elsewhere), np.inf, np.full(len(index), -1)
    while time.sum() < before * (1 - NOTHING):
        before, each = time.sum(), takes[:, None] + (step @ time).reshape(-1, actions)
        better = (each.min(1) < time * (1 - UNIT)) & (index != goal)
        policy = np.where(better | (policy < 0), each.argmin(1), policy)  # the first one takes any action
        time = _time(step[index * actions + policy], takes, elsewhere)
    return time


def _time(chain: Any, takes: np.ndarray, elsewhere: np.ndarray) -> Float[np.ndarray, " S1"]:
    """The expected time of a chain until it comes to the goal, which is the one state that is not `elsewhere`."""
    from scipy import sparse

    return sparse_solver(sparse.diags_array(elsewhere) @ chain)(takes * elsewhere)


def _without_end(model: Model) -> tuple[Int[np.ndarray, " S"], Any]:
    """The states that are reached and not terminal, and the probabilities of going from one to another.

    These are sparse [(S + 1) A, S + 1]. The last state lies between the end of an episode and the start of the next.
    """
    from scipy import sparse

    over = terminal_states(model)
    states = np.flatnonzero(reachable(model) & ~over)
    n, actions = len(states), model.prob.shape[1]
    place = np.full(len(over), n)  # also where a terminal state is entered
    place[states] = np.arange(n)
    prob = model.prob[states]
    entered = np.where(model.terminal[states], n, place[model.s_next[states]])
    pair = np.broadcast_to(np.arange(n * actions).reshape(n, actions, 1), prob.shape)
    start = model.start[states] / model.start[states].sum()
    row = [pair.ravel(), np.repeat(n * actions + np.arange(actions), n)]
    column, weight = (
        [entered.ravel(), np.tile(np.arange(n), actions)],
        [prob.ravel(), np.tile(start, actions)],
    )
    entries = np.concatenate(weight), (np.concatenate(row), np.concatenate(column))
    step = sparse.csr_array(entries, shape=((n + 1) * actions, n + 1))
    step.eliminate_zeros()
    return states, step


# --- how long -----------------------------------------------------------------------------------------


class Mixing(NamedTuple):
    """How fast a policy forgets where it began.

    Attributes:
        second_eigenvalue: the second largest modulus of an eigenvalue of its chain; 1 where that is periodic, or has
            several sets of states that it does not leave; 0 for a single state.
        spectral_gap: 1 - that.
        relaxation_time: 1 / spectral_gap, in steps.
        mixing_time: after how many steps the distribution of the state is within `distance` of the stationary one, in
            total variation, from whatever state; infinite where it never is.
    """

    second_eigenvalue: float
    spectral_gap: float
    relaxation_time: float
    mixing_time: float


def mixing(env: Environment, policy_probs: ArrayLike, distance: float = 0.25) -> Mixing:
    """The second eigenvalue and the mixing time of a policy's chain (Levin and Peres 2017, sections 4.5 and 12.2).

    The states are those to which the policy may come from the start. Where an episode ends the next one begins, as in
    `planning.stationary_distribution`, which is what the chain mixes to.

    Args:
        env: an environment with `outcomes`; its time limit does not count.
        policy_probs: the probability of each action in each state, [S, A]; terminal states need a row too.
        distance: see `Mixing`; between 0 and 1.

    Raises:
        InputError: `policy_probs` is no policy, or `distance` is out of range.
    """
    check_within("distance", distance, FRACTION)
    model = exact_model(env)
    probs = checked_policy(model, policy_probs)
    chain = _chain(model, probs)
    sizes = np.sort(abs(np.linalg.eigvals(chain)))
    second = float(sizes[-2]) if len(sizes) > 1 else 0.0
    if second > 1 - ONE:
        return Mixing(1.0, 0.0, np.inf, np.inf)
    return Mixing(second, 1 - second, 1 / (1 - second), _mixing_time(chain, 1 - second, distance))


def _chain(model: Model, probs: Float[np.ndarray, "S A"]) -> Float[np.ndarray, "N N"]:
    """The probabilities of going from one state to another, of those to which the policy may come."""
    states, step = _without_end(model)
    n = len(states)
    rows = step.toarray().reshape(n + 1, -1, n + 1)[:n]
    going = np.einsum("sa,sat->st", probs[states], rows)
    start = model.start[states] / model.start[states].sum()
    visited = entered(model, probs)[states]
    return (going[:, :n] + going[:, n:] * start)[visited][:, visited]


def _mixing_time(chain: Float[np.ndarray, "S S"], gap: float, distance: float) -> int:
    """The smallest t at which all rows of chain^t are that close to what they tend to; its spectral gap is known."""
    limit = chain
    for _ in range(int(np.ceil(np.log2(LONG * len(chain) / gap)))):
        limit = limit @ limit
        limit /= limit.sum(1, keepdims=True)
    apart = lambda x: abs(x - limit[0]).sum(1).max() / 2
    reached = np.eye(len(chain))
    if apart(reached) <= distance:
        return 0
    powers = [chain]  # chain^(2^i), until it is close; then the bits of t - 1, the largest power that is not
    while apart(powers[-1]) > distance:
        powers.append(powers[-1] @ powers[-1])
    t = 0
    for i in reversed(range(len(powers) - 1)):
        if apart(further := reached @ powers[i]) > distance:
            t, reached = t + 2**i, further
    return t + 1


# --- all of it ----------------------------------------------------------------------------------------


class Hardness(NamedTuple):
    """How hard a task is to learn, in numbers; NaN for what was not worked out, see `hardness`.

    Attributes:
        states: how many can be reached and are not terminal.
        diameter: see `diameter`.
        gaps: see `action_gaps`.
        span: the largest of the best values of these states less the smallest.
        steps: the expected number of steps from the start under the best policy, that at t counted gamma^t times:
            the length of an episode, or nearly 1 / (1 - gamma), whichever is less. Infinite where neither is finite.
        best, anything: how fast the best policy and the policy that takes any action mix.
    """

    states: int
    diameter: float
    gaps: Gaps
    span: float
    steps: float
    best: Mixing
    anything: Mixing


def hardness(env: Environment, gamma: float = 1.0) -> Hardness:
    """Measures of how hard a task is to learn, together.

    Of more than `MOST_STATES` states that can be reached, the diameter and what mixing takes are left out.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: as `value_iteration`.
    """
    gaps = action_gaps(env, gamma)
    model, last, out = solved(env, 0.0, gamma)
    states = reachable(model) & ~terminal_states(model) & ~out
    v, few = last.v[states], states.sum() <= MOST_STATES
    unknown = Mixing(*[np.nan] * 4)
    return Hardness(
        int(states.sum()),
        diameter(env) if few else np.nan,
        gaps,
        float(np.ptp(v)) if len(v) else 0.0,
        _steps(env, model, last.probs, gamma),
        mixing(env, last.probs) if few else unknown,
        mixing(env, any_action(model)) if few else unknown,
    )


def _steps(env: Environment, model: Model, probs: Float[np.ndarray, "S A"], gamma: float) -> float:
    """The sum of the occupancy; infinite where it has none."""
    if gamma == 1:
        over = (model.prob * model.terminal).sum(2) > 0
        ticking = np.where(over | terminal_states(model)[:, None], 0, 1)[:, :, None] * np.ones_like(
            model.reward
        )
        _, caught, _ = fate(model._replace(reward=ticking), probs)
        if (caught & entered(model, probs)).any():
            return np.inf
    return float(occupancy(env, probs, gamma).sum())
