"""How often a policy comes to each state: until its episodes end, or in the long run.

All is told from the start distribution, and a state that cannot be reached from there has no part in anything. A
state in which the chain stays for long is left before it is counted: what counts is where it goes when it does go, so
that no digit is lost to 1 - p(s | s). What is left of rounding is 1e-16 times the expected number of steps, relatively.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import RATE, check_within, first
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.given import checked_policy
from jaxrl_tab.exact.model import (
    Model,
    ending_at,
    exact_model,
    name_of,
    reaching,
    spread,
    terminal_states,
)
from jaxrl_tab.exact.systems import sparse_solver
from jaxrl_tab.exact.values import fate

DENSE = 200  # states, up to which a matrix with all its zeros is the quicker one


class _Chain(NamedTuple):
    """A Markov chain as arrows between its states.

    Attributes:
        source, target: the states that each arrow leads from and to, int [N]; none leads from a state to itself.
        weight: how probable each is, float [N].
        away: with what probability a state is left, for another one or for good, float [S].
    """

    source: Int[np.ndarray, " N"]
    target: Int[np.ndarray, " N"]
    weight: Float[np.ndarray, " N"]
    away: Float[np.ndarray, " S"]

    def visits(self, begin: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """The expected number of steps in each state where one begins as `begin` says, float [S].

        From every state that can be reached the chain must be left for good in the end.
        """
        reached = np.flatnonzero(spread(self.source, self.target, begin > 0))
        place = np.full(len(begin), -1)
        place[reached] = np.arange(len(reached))
        inside = place[self.source] >= 0
        source, target = place[self.source[inside]], place[self.target[inside]]
        away = self.away[reached]
        visits = np.zeros(len(begin))
        visits[reached] = _solve(self.weight[inside] / away[source], target, source, begin[reached]) / away
        return visits


def _solve(jumps: np.ndarray, target: np.ndarray, source: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """How often each state is left: x = begin + jumps x, float [S]."""
    n = len(begin)
    if n <= DENSE:
        matrix = np.eye(n)
        np.subtract.at(matrix, (target, source), jumps)
        try:
            return np.linalg.solve(matrix, begin)
        except np.linalg.LinAlgError:
            raise InputError("a policy takes so long to end that its visits are beyond float64") from None
    from scipy import sparse  # here, because it takes 0.3 s

    return sparse_solver(sparse.csc_array((jumps, (target, source)), shape=(n, n)))(begin)


def _chain(model: Model, probs: Float[np.ndarray, "S A"], gamma: float) -> _Chain:
    """The chain of a policy, which with 1 - gamma is left for good in each step."""
    weight = probs[:, :, None] * model.prob
    state = np.broadcast_to(np.arange(len(weight))[:, None, None], weight.shape)
    stays = (model.s_next == state) & ~model.terminal
    goes = (weight > 0) & ~model.terminal & ~stays
    away = np.where(stays, (1 - gamma) * weight, weight).sum((1, 2))
    return _Chain(state[goes], model.s_next[goes], gamma * weight[goes], away)


def visits(model: Model, probs: Float[np.ndarray, "S A"], gamma: float) -> Float[np.ndarray, " S"]:
    """The expected visits of each state from the start, the one at step t counted gamma^t times, float64 [S].

    At gamma = 1 the policy must end in the end from wherever it may come.
    """
    return _chain(model, probs, gamma).visits(model.start)


def occupancy(env: Environment, policy_probs: ArrayLike, gamma: float = 1.0) -> Float[np.ndarray, " S"]:
    """How often a policy is in each state: sum over t of gamma^t P(S_t = s), from the start, float64 [S].

    At gamma = 1 that is the expected number of visits in an episode, eta(s) of the book (equation 9.2), and the sum
    is the expected length of an episode; below 1 it is the discounted state visitation, not divided by anything, and
    the sum is 1 / (1 - gamma) where no episode ends. What is counted are steps, so terminal states have 0. The
    time limit does not count. v_pi from the start is the sum of occupancy(s) times the expected reward of a step in s.

    Args:
        env: an environment with `outcomes`.
        policy_probs: the probability of each action in each state, [S, A]; terminal states need a row too.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: `policy_probs` is no policy; or gamma is 1 and from some state that the policy may come to it
            never ends, so that it is there infinitely often: see `stationary_distribution`. (From a state that it
            does not come to it need not end.)
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    probs = checked_policy(model, policy_probs)
    if gamma == 1 and (s := first(_for_ever(model, probs))) is not None:
        raise InputError(
            f"{name_of(env)}: this policy may come to state {s[0]}, from which it never ends, so at gamma = 1 its "
            "visits have no number; take gamma below 1, or stationary_distribution"
        )
    return np.where(terminal_states(model), 0, visits(model, probs, gamma))


def _for_ever(model: Model, probs: Float[np.ndarray, "S A"]) -> Bool[np.ndarray, " S"]:
    """The states to which a policy may come from the start, and from which it never ends, bool [S]."""
    taken = (probs > 0)[:, :, None] & (model.prob > 0)
    ending = terminal_states(model) | (taken & model.terminal).any((1, 2))
    return reaching(model, taken, ending)[1] & entered(model, probs)


def entered(model: Model, probs: Float[np.ndarray, "S A"]) -> Bool[np.ndarray, " S"]:
    """The states to which a policy may come from the start, bool [S]."""
    taken = (probs > 0)[:, :, None] & (model.prob > 0)
    return spread(np.nonzero(taken)[0], model.s_next[taken], model.start > 0)


class Regret(NamedTuple):
    """Where and by what a policy loses what it earns less than the best one.

    Attributes:
        by_action: the terms of `planning.action_regret_map`, float [S, A]; 0 where it loses without bound.
        visits: how often it is in each state, float [S]; 0 where it loses without bound.
        caught: where it may come to, never end, and go on losing, bool [S].
    """

    by_action: Float[np.ndarray, "S A"]
    visits: Float[np.ndarray, " S"]
    caught: Bool[np.ndarray, " S"]


def regret(
    model: Model,
    probs: Float[np.ndarray, "S A"],
    v: Float[np.ndarray, " S"],
    q: Float[np.ndarray, "S A"],
    gamma: float,
) -> Regret:
    """The regret of a policy, from v* and q*."""
    loss, caught = v[:, None] - q, np.zeros(len(v), bool)
    if gamma == 1:
        settled, caught, doomed = fate(model, probs)
        if (doomed & (model.start > 0)).any():
            return Regret(np.zeros_like(q), np.zeros_like(v), caught & entered(model, probs))
        caught = np.zeros_like(caught)  # nobody comes there
        # Where it stays for nothing it loses at once all that could still be earned.
        model, loss = ending_at(model, settled), np.where(settled[:, None], v[:, None], loss)
    often = visits(model, probs, gamma)
    weight = often[:, None] * probs
    by_action = np.multiply(weight, loss, out=np.zeros_like(weight), where=weight > 0)
    return Regret(by_action, often, caught)


def stationary_distribution(env: Environment, policy_probs: ArrayLike) -> Float[np.ndarray, " S"]:
    """The share of all steps that a policy spends in each state in the long run, from the start, float64 [S].

    Of a task without an end it is a stationary distribution of the policy's chain, mu = mu P; where an episode ends
    the next one begins, as in `train`, and it is the on-policy distribution of the book (section 9.2; equation 9.3),
    `occupancy` divided by its sum. It adds up to 1; terminal states, and states that are left for good, have 0.

    Two things to know. Where the chain is **periodic** the distribution of S_t goes round and does not settle; the
    share of time does, and is given. Where the chain may be caught in **one of several** sets of states, each has a
    stationary distribution of its own, and none is *the* one: given is their mixture, with the probabilities with
    which the chain comes to each from the start. (From a start within a set it is that of the set.)

    Args, errors: as `occupancy`; there is always an answer.
    """
    model = exact_model(env)
    chain = _without_end(model, checked_policy(model, policy_probs))
    begin = np.zeros(len(chain.away))
    begin[-1] = 1
    member = _closed_sets(chain, spread(chain.source, chain.target, begin > 0))
    # How probably each set is the last one: until then there is a chain that is left for good where it enters one.
    enters = member[chain.target] >= 0
    flow = _only(chain, ~enters).visits(np.where(member >= 0, 0, begin))
    last = np.zeros(member.max() + 1)
    np.add.at(last, member[chain.target[enters]], (flow[chain.source] * chain.weight)[enters])
    if len(last) == 1:
        last[:] = 1
    share = np.zeros(len(begin))
    for one, chance in enumerate(last):
        share += chance * _of_set(chain, member == one)
    share = np.where(terminal_states(model), 0, share[:-1])  # what lies between episodes takes no time
    return share / share.sum()


def long_run(model: Model, probs: Float[np.ndarray, "S A"]) -> list[Float[np.ndarray, " S"]]:
    """The stationary distributions of all sets of states that a policy never leaves, whatever it comes from."""
    chain = _chain(model, probs, 1.0)
    member = _closed_sets(chain, ~terminal_states(model))
    return [_of_set(chain, member == one) for one in range(member.max() + 1)]


def _without_end(model: Model, probs: Float[np.ndarray, "S A"]) -> _Chain:
    """The chain with one state more, the last, between the end of an episode and the start of the next."""
    chain, n = _chain(model, probs, 1.0), len(probs)
    over = (probs[:, :, None] * model.prob * model.terminal).sum((1, 2))
    ends, starts = np.flatnonzero(over), np.flatnonzero(model.start)
    between = lambda states: np.full(len(states), n)
    return _Chain(
        np.concatenate([chain.source, ends, between(starts)]),
        np.concatenate([chain.target, between(ends), starts]),
        np.concatenate([chain.weight, over[ends], model.start[starts]]),
        np.append(chain.away, 1.0),
    )


def _closed_sets(chain: _Chain, reached: Bool[np.ndarray, " S"]) -> Int[np.ndarray, " S"]:
    """Which set of states that is never left each state is in, of those that are `reached`; int [S], -1 for none."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    n = len(reached)
    arrows = sparse.csr_array((np.ones(len(chain.source)), (chain.source, chain.target)), shape=(n, n))
    _, component = connected_components(arrows, connection="strong")
    left = component[chain.source[component[chain.source] != component[chain.target]]]
    closed = reached & ~np.isin(component, left)
    member = np.full(n, -1)
    member[closed] = np.unique(component[closed], return_inverse=True)[1]
    return member


def _of_set(chain: _Chain, inside: Bool[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """The stationary distribution of a set of states that is never left: of the steps from one return to the next."""
    home = np.flatnonzero(inside)[-1]
    begin = np.zeros(len(inside))
    begin[home] = 1
    if inside.sum() == 1:
        return begin
    steps = _only(chain, inside[chain.source] & (chain.target != home)).visits(begin)
    return steps / steps.sum()


def _only(chain: _Chain, kept: Bool[np.ndarray, " N"]) -> _Chain:
    """The chain with these arrows alone: where it would take another one it is left for good."""
    return chain._replace(source=chain.source[kept], target=chain.target[kept], weight=chain.weight[kept])
