"""The exact side: values and policies of an environment that states its dynamics.

The environment is enumerated once into a `Model` (every outcome of every action in every state), and all else
is sums over it (book, chapter 4). For people the model is float64 NumPy. Inside `train`, where the value of
the greedy policy is asked for at every log row, it is JAX arrays at the ambient precision. The formulas are
written once, with operators that both understand; only loops (`_loop`) and linear systems (`_solve`) tell
them apart.

**gamma = 1.** An infinite sum of rewards then need not exist, and what decides that is which states lead to
which, not numbers: `_fate` follows the arrows of the graph. Under a policy, a state is *settled* where
nothing is earned or paid ever again (a terminal state; a loop without rewards): its value is 0. A state is
*caught* where no settled state can be reached: there rewards go on for ever. If no state is caught, all
values are finite.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab import memory, policies
from jaxrl_tab.types import (
    Environment,
    FiniteEnvironment,
    InputError,
    as_array,
    check_pytree,
    first,
    is_distribution,
    shown,
)

GAIN = 1e-11  # policy iteration changes an action for more than this, relative to the largest value
BYTES_OF_OUTCOME = 64  # in the model and, while it is made, in JAX
MAX_ROUNDS = 1000  # of policy iteration; tens are usual
TRACED_SWEEPS = 10_000  # of value iteration inside `train`

Measure = Callable[[Float[Array, "S A"]], tuple[Float[Array, ""], Float[Array, ""]]]


class Model(NamedTuple):
    """An enumerated environment: the K outcomes of each of A actions in each of S states.

    Attributes:
        prob: their probabilities, float [S, A, K].
        s_next: the states that they enter, int32 [S, A, K].
        reward: their rewards, float [S, A, K].
        terminal: whether they end the episode, bool [S, A, K].
        start: the distribution of the start state, float [S].
    """

    prob: Float[Any, "S A K"]
    s_next: Int[Any, "S A K"]
    reward: Float[Any, "S A K"]
    terminal: Bool[Any, "S A K"]
    start: Float[Any, " S"]


# --- the model ---------------------------------------------------------------------------------------


def check_finite(env: Environment) -> None:
    """Raises InputError where `env` can only be sampled, so that nothing exact can be said about it."""
    if not isinstance(env, FiniteEnvironment):
        raise InputError(
            f"{_name(env)} can only be sampled; exact values need one with `outcomes` and `initial`"
        )


def enumerate_model(env: Any) -> Model:
    """The Model of a finite environment in JAX arrays of the ambient precision, under `jit` too."""
    states = jnp.arange(env.num_states, dtype=jnp.int32)
    actions = jnp.arange(env.num_actions, dtype=jnp.int32)
    prob, outcome = jax.vmap(jax.vmap(env.outcomes, (None, 0)), (0, None))(states, actions)
    return Model(
        prob.astype(float),
        outcome.s_next.astype(jnp.int32),
        outcome.reward.astype(float),
        outcome.terminal,
        env.initial().astype(float),
    )


def exact_model(env: Environment) -> Model:
    """The Model of a finite environment in float64 NumPy arrays, checked.

    Raises:
        InputError: `env` can only be sampled, is a batch of environments, or breaks the rules of one; the
            message names the first wrong state or (s, a).
    """
    check_finite(env)
    check_pytree(_name(env), env)
    _check_size(env)
    # In 64 bits from the first operation on, or 1/3 would be a float32 third. An environment that is written
    # for 32 bits mixes in some 64-bit constants then, which is all right here.
    with jax.enable_x64(), jax.numpy_dtype_promotion("standard"):
        # A copy, for a live program that closes over an array makes JAX 0.10 remember its value in 32 bits.
        env = jax.tree.map(lambda x: x.copy() if isinstance(x, np.ndarray) else x, env)
        model = jax.tree.map(np.asarray, _enumerate_jit(env))
    _check_model(_name(env), model)
    return model


def _check_size(env: Any) -> None:
    """Raises InputError where all outcomes, of one for each state and action at least, do not fit in memory."""
    pairs = env.num_states * env.num_actions
    if pairs >= 2**31 or BYTES_OF_OUTCOME * pairs > memory.free():
        raise InputError(
            f"{_name(env)}: {env.num_states:,} states with {env.num_actions:,} actions each are more than fit in "
            "memory; make it smaller"
        )


_enumerate_jit = jax.jit(enumerate_model)


def _check_model(name: str, model: Model) -> None:
    prob, s_next, reward, terminal, start = model
    num_states = len(prob)
    if prob.ndim != 3 or {x.shape for x in model[:4]} != {prob.shape} or start.shape != (num_states,):
        shapes = ", ".join(str(x.shape[2:]) for x in model[:4])
        raise InputError(
            f"{name}: outcomes must give probabilities, s_next, reward and terminal of shape [K] each, and "
            f"initial one of [S], for one environment and not a batch; they give {shapes} and {start.shape}"
        )
    index = np.arange(num_states)
    if (i := first(~is_distribution(prob))) is not None:
        raise InputError(f"{name}: the probabilities of the outcomes of (s, a) = {i} are not a distribution")
    if (i := first(((s_next < 0) | (s_next >= num_states)).any(-1))) is not None:
        raise InputError(f"{name}: an outcome of (s, a) = {i} is not one of the states 0 to {num_states - 1}")
    if (i := first(((prob > 0) & ~np.isfinite(reward)).any(-1))) is not None:
        raise InputError(f"{name}: a reward of (s, a) = {i} is not a finite number")
    stays = (prob == 0) | (terminal & (s_next == index[:, None, None]) & (reward == 0))
    entered = np.isin(index, s_next[terminal & (prob > 0)])
    if (i := first(entered[:, None] & ~stays.all(-1))) is not None:
        raise InputError(
            f"{name}: state {i[0]} is terminal, so action {i[1]} must lead back to it with reward 0"
        )
    if not is_distribution(start):
        raise InputError(f"{name}: the probabilities of the start states are not a distribution")


def terminal_states(model: Model) -> Bool[Any, " S"]:
    """Which states are terminal, bool [S]: those that lead to themselves and nowhere else, and end there."""
    here = model.s_next == np.arange(len(model.s_next))[:, None, None]
    return ((model.terminal & here) | (model.prob == 0)).all((1, 2))


def reachable(model: Model) -> Bool[Any, " S"]:
    """Which states some policy can come to from the start, bool [S]."""
    namespace, states = _namespace(model), np.arange(len(model.start))

    def spread(reached):
        entered = namespace.where(reached[:, None, None] & (model.prob > 0), model.s_next, -1)
        return reached | namespace.isin(states, entered)

    return _settle(model, spread, model.start > 0)


def backup(model: Model, v: Float[Any, " S"], gamma: Any) -> Float[Any, "S A"]:
    """q(s, a) = sum over outcomes of p (r + gamma' v(s')), float [S, A] (book, equation 4.6).

    `model` and `v` are either NumPy or JAX arrays; gamma' is 0 where the outcome is terminal.
    """
    v_next = _namespace(model).where(model.terminal, 0, v[model.s_next])
    return (model.prob * (model.reward + gamma * v_next)).sum(-1)


def expectation_backup(
    env: Environment, q: Float[np.ndarray, "S A"], policy_probs: Float[np.ndarray, "S A"], gamma: float = 1.0
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
    check_rate("gamma", gamma)
    model = exact_model(env)
    v = (_checked_policy(model, policy_probs) * checked_values(model, "q", q)).sum(1)
    return backup(model, v, gamma)


def optimality_backup(
    env: Environment, q: Float[np.ndarray, "S A"], gamma: float = 1.0
) -> Float[np.ndarray, "S A"]:
    """One sweep of q-value iteration: q(s, a) <- E[R + gamma max_a' q(S', a') | s, a], float64 [S, A].

    The right-hand side of the Bellman optimality equation for q* (book, equation 3.20). Args and errors: as
    `expectation_backup`.
    """
    check_rate("gamma", gamma)
    model = exact_model(env)
    return backup(model, checked_values(model, "q", q).max(1), gamma)


def evaluation_backup(
    env: Environment, v: Float[np.ndarray, " S"], policy_probs: Float[np.ndarray, "S A"], gamma: float = 1.0
) -> Float[np.ndarray, " S"]:
    """One sweep of iterative policy evaluation: v(s) <- E[R + gamma v(S') | s], A ~ pi, float64 [S].

    The right-hand side of the Bellman expectation equation for v_pi (book, equation 4.5). Args and errors: as
    `expectation_backup`, but for `v`, the values, [S].
    """
    check_rate("gamma", gamma)
    model = exact_model(env)
    probs = _checked_policy(model, policy_probs)
    return (probs * backup(model, checked_values(model, "v", v), gamma)).sum(1)


def start_value(env: Environment, v: Float[np.ndarray, " S"]) -> float:
    """The mean of the values `v` [S] over the start distribution."""
    model = exact_model(env)
    return float(_from_start(model, checked_values(model, "v", v)))


# --- policies of a table of action values ------------------------------------------------------------


def greedy_policy(q: Float[np.ndarray, "S A"]) -> Float[np.ndarray, "S A"]:
    """The policy that is greedy to `q`: the maximal actions of a state equally likely, float64 [S, A]."""
    with jax.enable_x64():
        return np.asarray(jax.vmap(policies.greedy)(jnp.asarray(_action_values(q))))


def epsilon_greedy_policy(q: Float[np.ndarray, "S A"], epsilon: float) -> Float[np.ndarray, "S A"]:
    """The policy that is epsilon-greedy to `q`, ties split equally, float64 [S, A] (book, section 5.4)."""
    check_rate("epsilon", epsilon)
    with jax.enable_x64():
        return np.asarray(
            jax.vmap(partial(policies.epsilon_greedy, epsilon=epsilon))(jnp.asarray(_action_values(q)))
        )


def _action_values(q: Any) -> np.ndarray:
    """`q` as float64 [S, A]."""
    values = _numbers("q", q)
    if values.ndim != 2 or not values.size:
        raise InputError(f"q must be action values [S, A], not of shape {values.shape}")
    return values


# --- exact answers -----------------------------------------------------------------------------------


def evaluate(
    env: Environment, policy_probs: Float[np.ndarray, "S A"], gamma: float = 1.0
) -> Float[np.ndarray, " S"]:
    """The values of a policy, float64 [S], from its Bellman equations as one sparse linear system.

    Args:
        env: an environment with `outcomes`.
        policy_probs: the probability of each action in each state, [S, A]; terminal states need a row too.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: `policy_probs` is no policy; or gamma is 1 and from some state the policy never ends while
            rewards go on, so that its value is not finite. (Where no reward ever comes again it is 0.)
    """
    check_rate("gamma", gamma)
    model = exact_model(env)
    v, caught = _policy_value(model, _checked_policy(model, policy_probs), gamma)
    if caught.any():
        raise InputError(
            f"{_name(env)}: from state {first(caught)[0]} this policy never ends and rewards go on, so at "
            "gamma = 1 it has no finite value; take gamma below 1, or ask policy_value, from the start alone"
        )
    return v


def policy_value(env: Environment, policy_probs: Float[np.ndarray, "S A"], gamma: float = 1.0) -> float:
    """The value of a policy from the start distribution; -inf where it may be caught at gamma = 1.

    This is what to ask about a learned Q: `policy_value(env, greedy_policy(q))`. In states that were never
    visited a greedy policy often goes round for ever, but it may never come there.

    Args and errors: as `evaluate`.
    """
    check_rate("gamma", gamma)
    model = exact_model(env)
    return float(_from_start(model, _policy_value(model, _checked_policy(model, policy_probs), gamma)[0]))


def value_iteration(
    env: Environment, gamma: float = 1.0, tol: float = 1e-10, max_sweeps: int = 100_000
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """The optimal values v* and q* (book, section 4.4), float64 [S] and [S, A]; 0 at terminal states.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        tol: how far the values may be from v*. A bound for gamma below 1; at gamma = 1 an estimate, as if the
            changes went on shrinking at the slower of the last two rates.
        max_sweeps: how many sweeps to make at most.

    Raises:
        InputError: gamma is 1 and from some state no policy ever ends while rewards go on, or a round trip
            earns more than it costs; or `max_sweeps` were not enough.
    """
    check_rate("gamma", gamma)
    if not (isinstance(tol, int | float | np.number) and tol > 0):
        raise InputError(f"tol must be greater than 0, not {shown(tol)}")
    model = exact_model(env)
    q, converged, caught = _sweeps(model, gamma, tol, max_sweeps)
    _refuse_endless(env, caught, "no policy")
    if not converged:
        raise InputError(
            f"{_name(env)}: value iteration did not converge in {max_sweeps} sweeps; raise max_sweeps, or "
            "use policy_iteration, which finds a round trip that earns more than it costs"
        )
    return q.max(1), q


def policy_iteration(
    env: Environment, gamma: float = 1.0
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """An optimal policy [S, A], v* [S] and q* [S, A], float64 (book, section 4.3).

    Of several best actions the policy takes any mixture, but at gamma = 1 one that ends where it must to
    be optimal. (To take the first of several best actions may be to go round for ever.)

    Raises:
        InputError: as `value_iteration`.
    """
    return _policy_iteration(env, 0.0, gamma)


def epsilon_soft(
    env: Environment, epsilon: float, gamma: float = 1.0
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """The best policy that takes every action with probability epsilon / A or more (book, section 5.4).

    Returns:
        The policy [S, A], its values [S] and its action values [S, A], float64.

    Raises:
        InputError: epsilon is not in [0, 1], or as `value_iteration`.
    """
    check_rate("epsilon", epsilon)
    return _policy_iteration(env, epsilon, gamma)


def _policy_iteration(env: Environment, epsilon: float, gamma: float):
    """Policy iteration among the epsilon-soft policies.

    Only actions that are better by more than rounding replace old ones. So at gamma = 1 no improved policy
    can be caught, unless in a loop that earns more than it costs: along a loop without gain all actions were
    equal, and stayed.
    """
    check_rate("gamma", gamma)
    model = exact_model(env)
    uniform = np.full(model.prob.shape[:2], 1 / model.prob.shape[1])
    probs = uniform if epsilon else _ending_policy(model)
    v, caught = _policy_value(model, probs, gamma)
    _refuse_endless(env, caught, "no epsilon-soft policy" if epsilon else "no policy")
    for _ in range(MAX_ROUNDS):
        q = backup(model, v, gamma)
        best = epsilon * q.mean(1) + (1 - epsilon) * q.max(1)
        better = best > v + GAIN * abs(v).max()
        if not better.any():
            return probs, v, q
        probs = np.where(better[:, None], epsilon_greedy_policy(q, epsilon), probs)
        v, caught = _policy_value(model, probs, gamma)
        if caught.any():
            raise InputError(
                f"{_name(env)}: from state {first(caught)[0]} a round trip earns more than it costs, so at "
                "gamma = 1 the optimal value is not finite; take gamma below 1"
            )
    raise InputError(
        f"{_name(env)}: policy iteration did not settle in {MAX_ROUNDS} rounds; use value_iteration"
    )


# --- inside a compiled program -----------------------------------------------------------------------


def measurer(env: Environment, gamma: Any) -> Measure:
    """A function from Q [S, A] to (greedy_value [], q_error []), for use under `jit` and `vmap`.

    greedy_value is the exact value, from the start distribution, of the policy that is greedy to Q with ties
    split; -inf where gamma is 1 and that policy may be caught for ever while rewards go on. q_error is the
    largest |Q - Q*| over the states that can be reached from the start and are not terminal, never visited
    ones included; NaN where Q* is not finite, or not found in TRACED_SWEEPS sweeps of value iteration. Both
    are NaN where Q holds a NaN.

    Everything is at the ambient precision, usually float32. Both numbers then have a relative error of about
    1e-7 times the expected number of steps to the end (of the greedy and of the optimal policy): 1e-6 is
    usual, and a policy that dithers for 10 000 steps may be off by 1e-3. Under `jax.enable_x64()` that is
    1e-16 times the steps.

    Args:
        env: an environment with `outcomes`; its leaves may be tracers.
        gamma: discount rate; may be a tracer.

    Raises:
        InputError: `env` can only be sampled.
    """
    check_finite(env)
    model = enumerate_model(env)
    gamma = jnp.asarray(gamma, model.prob.dtype)
    q_star, converged, _ = _sweeps(model, gamma, 0.0, TRACED_SWEEPS)
    matters = reachable(model) & ~terminal_states(model)

    def measure(q: Float[Array, "S A"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        v, _ = _policy_value(model, jax.vmap(policies.greedy)(q), gamma)
        counts = matters[:, None] & (q > policies.UNAVAILABLE)
        error = jnp.where(counts, abs(q - q_star), 0).max()
        # Said by itself: in compiled code 0 / 0 may be 0 and a maximum may pass over NaN.
        sound = ~jnp.isnan(q).any()
        value = jnp.where(sound, _from_start(model, v), jnp.nan)
        return value, jnp.where(sound & converged, error, jnp.nan)

    return measure


def value_measurer(env: Environment, policy_probs: Any, gamma: Any) -> Callable[[Any], Float[Array, ""]]:
    """A function from V [S] to the root of its mean squared error as v_pi, for use under `jit` and `vmap`.

    The mean is over the states that can be reached from the start and are not terminal; NaN where v_pi is not
    finite in one of them.

    Args:
        env: an environment with `outcomes`; its leaves may be tracers.
        policy_probs: pi, float [S, A]; may be a tracer.
        gamma: discount rate; may be a tracer.

    Raises:
        InputError: `env` can only be sampled.
    """
    check_finite(env)
    model = enumerate_model(env)
    v_pi, _ = _policy_value(model, policy_probs, jnp.asarray(gamma, model.prob.dtype))
    matters = reachable(model) & ~terminal_states(model)

    def measure(v: Float[Array, " S"]) -> Float[Array, ""]:
        error = jnp.sqrt(jnp.where(matters, (v - v_pi) ** 2, 0).sum() / matters.sum())
        return jnp.where(jnp.isfinite(jnp.where(matters, v_pi, 0)).all(), error, jnp.nan)

    return measure


# --- shared by both sides: NumPy and JAX arrays ------------------------------------------------------


def _namespace(model: Model) -> Any:
    return jnp if isinstance(model.prob, jax.Array) else np


def _loop(model: Model, go_on: Callable[[Any], Any], body: Callable[[Any], Any], carry: Any) -> Any:
    """`lax.while_loop`, or the same in plain Python where the model is NumPy."""
    if _namespace(model) is jnp:
        return lax.while_loop(go_on, body, carry)
    while go_on(carry):
        carry = body(carry)
    return carry


def _settle(model: Model, change: Callable[[Any], Any], states: Any) -> Bool[Any, " S"]:
    """Applies `change`, which only adds or only removes, to a set of states, bool [S], until it stays."""
    carry = states, change(states)
    return _loop(model, lambda c: (c[0] != c[1]).any(), lambda c: (c[1], change(c[1])), carry)[1]


def _fate(model: Model, probs: Float[Any, "S A"]) -> tuple[Any, Any, Any]:
    """The states settled under a policy, those caught, and those that may end up caught, bool [S] each."""
    taken = (probs > 0)[:, :, None] & (model.prob > 0)

    def reaching(states):
        return _settle(model, lambda x: x | (taken & x[model.s_next]).any((1, 2)), states)

    settled = ~reaching((taken & (model.reward != 0)).any((1, 2)))
    caught = ~reaching(settled)
    return settled, caught, reaching(caught)


def _policy_value(model: Model, probs: Float[Any, "S A"], gamma: Any) -> tuple[Any, Any]:
    """The values of a policy, float [S], and where they are not finite because it is caught, bool [S].

    From states that may come to be caught the value is -inf. (gamma below 1 catches nothing.)
    """
    where = _namespace(model).where
    settled, caught, doomed = _fate(model, probs)
    doomed = doomed & (gamma == 1)
    weight = probs[:, :, None] * model.prob
    reward = (weight * model.reward).sum((1, 2))
    known = (settled | doomed)[model.s_next]  # terminal states are settled; without these it is regular
    v = _solve(model, where(known, 0, gamma * weight), reward)
    return where(doomed, -np.inf, v), caught & (gamma == 1)


def _solve(model: Model, weight: Float[Any, "S A K"], reward: Float[Any, " S"]) -> Any:
    """Solves v(s) = reward(s) + sum over (a, k) of weight v(s_next): dense in JAX, sparse in NumPy."""
    n = len(reward)
    if _namespace(model) is jnp:
        rows = np.arange(n)[:, None, None]
        return _solve_dense(jnp.eye(n).at[rows, model.s_next].add(-weight), reward)
    return solve_sparse(from_state_to_state(model, weight), reward)


def from_state_to_state(model: Model, weight: Float[np.ndarray, "S A K"]) -> Any:
    """The sparse matrix, float64 [S, S], of the weights of all outcomes that lead from one state to another.

    Where `weight` is a probability, of action and outcome, it is the matrix of a Markov chain.
    """
    from scipy import sparse  # here, because it takes 0.3 s

    n = len(weight)
    rows = np.broadcast_to(np.arange(n)[:, None, None], weight.shape)
    entries = weight.ravel(), (rows.ravel(), model.s_next.ravel())
    matrix = sparse.csc_array(entries, shape=(n, n))
    matrix.eliminate_zeros()  # so that its pattern is what is possible
    return matrix


def solve_sparse(matrix: Any, constant: Float[np.ndarray, " S"]) -> Any:
    """Solves x = constant + matrix x, for a sparse matrix [S, S]; float64 [S]."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    return spsolve(sparse.eye_array(len(constant), format="csc") - matrix, constant)


@sequential_vmap
def _solve_dense(matrix: Float[Array, "S S"], b: Float[Array, " S"]) -> Float[Array, " S"]:
    """Solves matrix x = b, one lane after another.

    jaxlib spreads a batch of LAPACK calls over the threads that XLA runs programs on, and waits for them.
    With one device for each core every one of these threads is then waiting, and the program hangs.
    """
    return jnp.linalg.solve(matrix, b)


def _ending_policy(model: Model) -> Any:
    """A policy [S, A] that is caught only where every policy is.

    Where it can go on for ever without reward it does, with equal probabilities; elsewhere it does anything.
    """
    free = ((model.prob == 0) | (model.reward == 0)).all(-1)

    def stays(states):
        return free & ((model.prob == 0) | states[model.s_next]).all(-1)

    home = _settle(model, lambda x: stays(x).any(-1), free.any(-1))
    weights = (stays(home) | ~home[:, None]).astype(model.prob.dtype)
    return weights / weights.sum(1, keepdims=True)


def _sweeps(model: Model, gamma: Any, tol: float, max_sweeps: int) -> tuple[Any, Any, Any]:
    """Value iteration.

    Gives q [S, A]; whether it converged, to `tol` or to the precision of the arrays, bool []; and the states
    where rewards go on for ever under any policy, bool [S]: if there are some, nothing is iterated.

    It starts from the values of a policy, so at gamma = 1 it climbs to v*. From 0 it would stay above where a
    loop costs nothing: with "wait for 0" or "take 1, then pay 3", waiting looks worth 1 for ever.
    """
    where, maximum = _namespace(model).where, _namespace(model).maximum
    precision = 4 * np.finfo(model.prob.dtype).eps
    v, caught = _policy_value(model, _ending_policy(model), gamma)

    def sweep(carry):
        v, old, ratio, _, n = carry
        new_v = backup(model, v, gamma).max(1)
        change = abs(new_v - v).max()
        rate = where(gamma < 1, gamma, maximum(ratio, change / old))
        reached = (change * rate <= tol * (1 - rate)) | (change <= precision * abs(new_v).max())
        return new_v, change, change / old, reached, n + 1

    def go_on(carry):
        return ~carry[3] & (carry[4] < max_sweeps) & ~caught.any()

    one = v.dtype.type(1)
    v, _, _, reached, _ = _loop(model, go_on, sweep, (v, one * np.inf, one, np.bool_(False), np.int32(0)))
    return backup(model, v, gamma), reached, caught


def _from_start(model: Model, v: Float[Any, " S"]) -> Any:
    return (model.start * _namespace(model).where(model.start > 0, v, 0)).sum()  # 0 x -inf is nothing here


# --- checks ------------------------------------------------------------------------------------------


def _name(env: Any) -> str:
    return type(env).__name__


def _numbers(name: str, value: Any) -> np.ndarray:
    """`value` in float64. Raises InputError unless it is numbers in a rectangular array."""
    array = as_array(value)
    if array is None or array.dtype.kind not in "biuf":
        raise InputError(f"{name} must be numbers, in rows of equal length, not {shown(value)}")
    return array.astype(np.float64)


def _checked_policy(model: Model, policy_probs: Any) -> np.ndarray:
    probs = _numbers("policy_probs", policy_probs)
    shape = model.prob.shape[:2]
    if probs.shape != shape:
        raise InputError(f"policy_probs must have shape [S, A] = {shape}, not {probs.shape}")
    if (i := first(~is_distribution(probs))) is not None:
        raise InputError(
            f"policy_probs of state {i[0]} are {probs[i].tolist()}; they must be 0 or more and add up to 1"
        )
    return probs / probs.sum(1, keepdims=True)


def checked_values(model: Model, name: str, values: Any) -> np.ndarray:
    """`values` in float64: v [S], or q [S, A]."""
    array = _numbers(name, values)
    shape = model.prob.shape[: 1 if name == "v" else 2]
    if array.shape != shape:
        each = f"{shape[0]} states" + "".join(f" and {n} actions" for n in shape[1:])
        raise InputError(f"{name} must have one value for each of the {each}, not {array.shape}")
    return array


def check_rate(name: str, value: float) -> None:
    """Raises InputError unless `value` is a number in [0, 1]."""
    if not (isinstance(value, int | float | np.number) and 0 <= value <= 1):
        raise InputError(f"{name} must be between 0 and 1, not {shown(value)}")


def _refuse_endless(env: Environment, caught: np.ndarray, who: str) -> None:
    if caught.any():
        raise InputError(
            f"{_name(env)}: from state {first(caught)[0]} {who} ever ends and rewards go on, so at "
            "gamma = 1 the optimal value is not finite; take gamma below 1"
        )
