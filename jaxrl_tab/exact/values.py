"""The values of policies in a model, and the best policy: the linear algebra of dynamic programming."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxrl_tab.core import policies
from jaxrl_tab.exact.double import in_turn
from jaxrl_tab.exact.model import (
    Model,
    array_module,
    backup,
    either,
    from_state_to_state,
    reaching,
    settle,
    while_loop,
    with_sizes,
)
from jaxrl_tab.exact.systems import sparse_solver

ROUNDING = 16  # an action is better if it is so by more than this many units of rounding, see `_Values`
MAX_ROUNDS = 1000  # of policy iteration; tens are usual
NEARLY = 1 - 2.0**-20  # a discount rate at which what is best is best in the long run, too
ANYTHING = -1  # the number of the round in which any action is taken, before the first policy is known
BLOCK, MAX_BLOCKS = 16, 6  # states that are taken out of a dense chain at once, and how many times


def largest(q: Float[Any, "... S A"]) -> Float[Any, "... S"]:
    """max over the actions of each state, [..., S]: the only place where planning takes it."""
    return q.max(-1)


def greedy_to(q: Float[Any, "... S A"], epsilon: float = 0.0) -> Float[Any, "... S A"]:
    """The policy that is epsilon-greedy to `q`, ties split equally, as `policies.epsilon_greedy`."""
    best = (q == largest(q)[..., None]).astype(q.dtype)
    greedy = best / best.sum(-1, keepdims=True)
    if not epsilon:
        return greedy
    is_available = (q > policies.UNAVAILABLE).astype(q.dtype)
    return epsilon * is_available / is_available.sum(-1, keepdims=True) + (1 - epsilon) * greedy


def _home(model: Model, free: Bool[Any, "S A"]) -> Bool[Any, " S"]:
    """The states in which one can stay for ever with actions that are `free`, bool [S]."""
    if array_module(model) is jnp:
        stays = lambda x: free & ((model.prob == 0) | x[model.s_next]).all(-1)
        return settle(lambda x: stays(x).any(-1), free.any(-1))
    # State by state: what leads to one that is lost is lost too, if it has nothing else that is free.
    s, a, k = np.nonzero((model.prob > 0) & free[:, :, None])
    entered, pair = model.s_next[s, a, k], s * free.shape[1] + a
    order = np.argsort(entered, kind="stable")
    leading, begin = pair[order].tolist(), np.searchsorted(entered[order], np.arange(len(free) + 1)).tolist()
    left, use = free.sum(1).tolist(), free.ravel().tolist()
    lost = [state for state, count in enumerate(left) if not count]
    while lost:
        state = lost.pop()
        for i in leading[begin[state] : begin[state + 1]]:
            if use[i]:
                use[i] = False
                left[i // free.shape[1]] -= 1
                if not left[i // free.shape[1]]:
                    lost.append(i // free.shape[1])
    return np.array(left) > 0


def fate(model: Model, probs: Float[Any, "S A"]) -> tuple[Any, Any, Any]:
    """The states settled under a policy, those caught, and those that may end up caught, bool [S] each."""
    taken = (probs > 0)[:, :, None] & (model.prob > 0)
    to_rewards, to_settled, doomed = reaching(model, taken, (taken & (model.reward != 0)).any((1, 2)))
    return ~to_rewards, ~to_settled, doomed


# The values of a policy.
class _Values(NamedTuple):
    """The values of a policy, and how sure they are.

    Attributes:
        v: float [S]; -inf from states that may come to be caught.
        size: how large the numbers are that each is added up from, so that the rounding error of v(s) is a
            few units in the last place of that, [S]. What cannot be reached from s has no part in it. Sparse,
            it is the expected sum over all steps from s on of the discounted |r| + |v|; dense, that of |r|,
            times S (see `solve_dense`).
        caught: where the value is not finite because the policy is caught, bool [S]; gamma below 1 catches
            nothing.
    """

    v: Float[Any, " S"]
    size: Float[Any, " S"]
    caught: Bool[Any, " S"]


def policy_values(model: Model, probs: Float[Any, "S A"], gamma: Any) -> _Values:
    where = array_module(model).where
    settled, caught, doomed = fate(model, probs)
    doomed = doomed & (gamma == 1)
    # Terminal states are settled. What leads to a state that is left out is taken to end there.
    v, size = _solve(model, probs, gamma, settled | doomed)
    return _Values(where(doomed, -np.inf, v), where(doomed, 0, size), caught & (gamma == 1))


def _solve(model: Model, probs: Any, gamma: Any, is_zero: Bool[Any, " S"]) -> tuple[Any, Any]:
    """The values of a policy where those of some states are known to be 0, and their `_Values.size`, [S]."""
    weight = probs[:, :, None] * model.prob
    reward, earned = ((weight * r).sum((1, 2)) for r in (model.reward, abs(model.reward)))
    where, over = array_module(model).where, is_zero[model.s_next]
    onward, leaving = where(over, 0, gamma * weight), where(over, weight, (1 - gamma) * weight).sum((1, 2))
    n = len(reward)
    if array_module(model) is jnp:
        rows = np.arange(n)[:, None, None]
        chain = jnp.zeros((n, n), weight.dtype).at[rows, model.s_next].add(onward)
        v, size = solve_dense(chain, leaving, jnp.stack([reward, earned], 1)).T
        return v, n * size
    chain = from_state_to_state(model, onward)
    solve = sparse_solver(chain)
    v = solve(reward)
    # Once more for what is left over (iterative refinement: Higham 2002, chapter 12). It is added up from
    # differences of neighbours, so that it keeps its digits where a chain goes on for long.
    v = v + solve(reward - leaving * v + (onward * (v[model.s_next] - v[:, None, None])).sum((1, 2)))
    return v, abs(v) + solve(earned + chain @ abs(v))


@in_turn
def solve_dense(
    chain: Float[Array, "S S"], leaving: Float[Array, " S"], constants: Float[Array, "S R"]
) -> Float[Array, "S R"]:
    """Solves x = constants + chain x, without a single subtraction.

    State after state is taken out of the chain: what leads to it leads from now on to what it leads to. Then
    the last state's x is known, and with it that of the one before. The probability of going on from a state,
    1 - chain[s, s], is added up from where it goes on to, which keeps every digit, however long that takes
    (Grassmann, Taksar and Heyman 1985, Regenerative analysis and steady state distributions for Markov
    chains). So no entry of x has a larger error than some units in the last place of what |constants| give
    there. States are taken out in blocks, so that most of the work is a product of matrices. It is not left
    to LAPACK, whose result depends on the number of cores, and which needs them for itself.

    Args:
        chain: the weights with which states lead to each other, 0 or more.
        leaving: 1 - the sum of these weights, of each state, 0 or more.
        constants: the constants of several systems.
    """
    n, systems = constants.shape
    rest = jnp.concatenate([chain, leaving[:, None], constants], 1)
    size = max(BLOCK, -(-n // MAX_BLOCKS))
    taken = []
    while len(rest):
        block, rest = rest[:size], rest[size:]
        onward = _out_of_block(block, systems)  # from these states to later ones, and what they add
        rest = rest[:, len(block) :] + rest[:, : len(block)] @ onward
        taken.append(onward)
    x = jnp.zeros((0, systems), constants.dtype)
    for onward in reversed(taken):
        x = jnp.concatenate([onward[:, : len(x)] @ x + onward[:, -systems:], x])
    return x


def _out_of_block(block: Float[Array, "B N"], systems: int) -> Float[Array, "B M"]:
    """Where the first B states, whose rows these are, lead to when they have been left for later ones."""
    size = len(block)
    index = jnp.arange(size, dtype=jnp.int32)
    row = lambda x, k: lax.dynamic_slice(x, (k, jnp.int32(0)), (1, x.shape[1]))
    column = lambda x, k: lax.dynamic_slice(x, (jnp.int32(0), k), (size, 1))
    put = lambda x, k, new: lax.dynamic_update_slice(x, new, (k, jnp.int32(0)))

    def take_out(k, carry):
        inside, outside = carry
        to_inside, to_outside = jnp.where(index > k, row(inside, k), 0), row(outside, k)
        going_on = to_inside.sum() + to_outside[:, :-systems].sum()
        to_inside, to_outside = to_inside / going_on, to_outside / going_on
        coming = jnp.where(index[:, None] > k, column(inside, k), 0)
        inside, outside = inside + coming * to_inside, outside + coming * to_outside
        return put(inside, k, to_inside), put(outside, k, to_outside)

    def put_back(i, outside):
        k = size - 1 - i
        return outside + jnp.where(index[:, None] < k, column(inside, k), 0) * row(outside, k)

    first, last = jnp.int32(0), jnp.int32(size)
    inside, outside = lax.fori_loop(first, last, take_out, (block[:, :size], block[:, size:]))
    return lax.fori_loop(first, last, put_back, outside)


# The best policy.
class Round(NamedTuple):
    """A policy in policy iteration, and an improvement on it.

    Attributes:
        probs: the policy [S, A].
        v, q: its values [S] and action values [S, A].
        caught: as in `_Values`; where it holds for any state, nothing is improved.
        better: where `improved` is better by more than rounding, bool [S].
        improved: a policy [S, A].
        n: how many times it was improved.
    """

    probs: Float[Any, "S A"]
    v: Float[Any, " S"]
    q: Float[Any, "S A"]
    caught: Bool[Any, " S"]
    better: Bool[Any, " S"]
    improved: Float[Any, "S A"]
    n: Any


def iterate_policies(model: Model, epsilon: float, gamma: Any) -> Round:
    """Policy iteration among the epsilon-soft policies, until nothing is better or a policy is caught.

    Only actions that are better by more than rounding replace old ones. So at gamma = 1 no improved policy
    can be caught, unless in a loop that earns more than it costs: along a loop without gain all actions were
    equal, and stayed.
    """
    where, unit = array_module(model).where, ROUNDING * np.finfo(model.prob.dtype).eps

    def judged(probs, n):
        v, size, caught = policy_values(model, probs, gamma)
        q = backup(model, where(v == -np.inf, 0, v), gamma)  # not used where some are caught
        improved = greedy_to(q, epsilon)
        best = (improved * q).sum(-1)
        sizes = (improved * backup(with_sizes(model), size, gamma)).sum(-1)
        return Round(probs, v, q, caught, best > v + unit * (size + sizes), improved, n)

    def improve(last):
        probs = where(last.better[:, None], last.improved, last.probs)
        if not epsilon:
            first = lambda: _first_policy(model, last.v, last.caught)
            probs = either(model, last.n == ANYTHING, first, lambda: probs)
        return judged(probs, last.n + 1)

    def go_on(last):
        return (last.n < 0) | last.better.any() & ~last.caught.any() & (last.n < MAX_ROUNDS)

    # A made-up round comes first, whose improvement is to take any action: so a program has `judged` only once.
    anything = any_action(model)
    nothing, no = 0 * anything, anything[:, 0] < 0
    begin = np.int32(ANYTHING if epsilon else ANYTHING - 1)
    return while_loop(
        model, go_on, improve, Round(anything, nothing[:, 0], nothing, no, ~no, anything, begin)
    )


def any_action(model: Model) -> Float[Any, "S A"]:
    """The policy [S, A] that takes all available actions equally often."""
    namespace = array_module(model)
    is_available = namespace.ones(model.prob.shape[:2], bool) if model.available is None else model.available
    return is_available / is_available.sum(-1, keepdims=True).astype(model.prob.dtype)


def first_policy(model: Model, epsilon: float, gamma: Any) -> Float[Any, "S A"]:
    """The policy [S, A] that policy iteration begins with: any action, equally likely, but for `_first_policy`."""
    anything = any_action(model)
    if epsilon:
        return anything
    v, _, caught = policy_values(model, anything, gamma)
    return _first_policy(model, v, caught)


def _first_policy(model: Model, v: Float[Any, " S"], caught: Bool[Any, " S"]) -> Float[Any, "S A"]:
    """A policy [S, A] to improve, which at gamma = 1 is caught only where every policy is.

    Any action, equally likely; but where one can stay for ever for nothing, that, if the rest costs more. For
    nothing is worth more than a loop that is free, and no single step of improvement would find it: with
    "wait for 0" or "take 1, then pay 3" waiting looks worth what the rest is worth.

    Args:
        v, caught: of the policy that takes any action.
    """
    where, anything = array_module(model).where, any_action(model)
    home, staying = waiting(model)
    mixed = where((home & (v < 0))[:, None], staying, anything)
    lost = caught.any() | fate(model, mixed)[1].any()
    return where(lost, staying, mixed)


def waiting(model: Model) -> tuple[Bool[Any, " S"], Float[Any, "S A"]]:
    """Where one can stay for ever for nothing, bool [S]; and a policy [S, A] that does, and elsewhere takes any."""
    free = ((model.prob == 0) | (model.reward == 0)).all(-1)
    home = _home(model, free)
    staying = free & ((model.prob == 0) | home[model.s_next]).all(-1) | ~home[:, None]
    staying = (staying & (any_action(model) > 0)).astype(model.prob.dtype)
    return home, staying / staying.sum(-1, keepdims=True)


def from_start(model: Model, v: Float[Any, " S"]) -> Any:
    return (model.start * array_module(model).where(model.start > 0, v, 0)).sum()  # 0 times -inf counts as 0
