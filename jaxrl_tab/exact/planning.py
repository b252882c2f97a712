"""The exact side: values and policies of an environment that states its dynamics.

The environment is enumerated once into a `Model` (every outcome of every action in every state), and all else
is sums over it (book, chapter 4). For people the model is float64 NumPy. Inside `train`, where the value of
the greedy policy is asked for at every log row, it is JAX arrays, in float64 too (`doubled`), although the
learner beside it is in float32. The formulas are written once, with operators that both understand; only
loops (`_loop`), what leads where (`reachable`, `_reaching`, `_home`) and linear systems (`_solve`) tell them apart.

**Every state is judged by its own numbers.** A state in which rewards are a million million times larger
changes no answer elsewhere, unless it can be reached from there. So linear systems are solved without
exchanging rows: elimination then combines a state with those that it leads to and with no others, and it is
stable, for each row is dominated by its diagonal (Higham 2002, Accuracy and Stability of Numerical
Algorithms, theorems 8.12 and 9.9). And what counts as rounding is measured state by state, see `_Values`.

**gamma = 1.** An infinite sum of rewards then need not exist, and what decides that is which states lead to
which, not numbers: `_fate` follows the arrows of the graph. Under a policy, a state is *settled* where
nothing is earned or paid ever again (a terminal state; a loop without rewards): its value is 0. A state is
*caught* where no settled state can be reached: there rewards go on for ever. If no state is caught, all
values are finite.
"""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.core import memory, policies
from jaxrl_tab.core.checks import InputError, check_pytree, first, foreign, is_distribution, shown
from jaxrl_tab.core.pytree import as_array
from jaxrl_tab.core.types import Environment, FiniteEnvironment, available_actions, stand_ins

BYTES_OF_OUTCOME = 64  # in the model and, while it is made, in JAX
ROUNDING = 16  # an action is better if it is so by more than this many units of rounding, see `_Values`
PATH_SWEEPS = 100  # of `largest_return`
MAX_ROUNDS = 1000  # of policy iteration; tens are usual
BLOCK, MAX_BLOCKS = 16, 6  # states that are taken out of a dense chain at once, and how many times

Measure = Callable[[Float[Array, "S A"]], tuple[Float[Array, ""], Float[Array, ""]]]


class Model(NamedTuple):
    """An enumerated environment: the K outcomes of each of A actions in each of S states.

    Attributes:
        prob: their probabilities, float [S, A, K].
        s_next: the states that they enter, int32 [S, A, K].
        reward: their rewards, float [S, A, K].
        terminal: whether they end the episode, bool [S, A, K].
        start: the distribution of the start state, float [S].
        available: which actions there are, bool [S, A]; None for all. The outcomes of another action are
            those of one that there is, so that it leads nowhere else; its value is UNAVAILABLE.
    """

    prob: Float[Any, "S A K"]
    s_next: Int[Any, "S A K"]
    reward: Float[Any, "S A K"]
    terminal: Bool[Any, "S A K"]
    start: Float[Any, " S"]
    available: Bool[Any, "S A"] | None = None


# --- the model ---------------------------------------------------------------------------------------


def check_finite(env: Environment) -> None:
    """Raises InputError where `env` can only be sampled, so that nothing exact can be said about it."""
    if not isinstance(env, FiniteEnvironment):
        raise InputError(
            f"{_name(env)} can only be sampled; exact values need one with `outcomes` and `initial`{foreign(env)}"
        )


def enumerate_model(env: Any) -> Model:
    """The Model of a finite environment in JAX arrays of the ambient precision, under `jit` too."""
    states = jnp.arange(env.num_states, dtype=jnp.int32)
    actions = jnp.arange(env.num_actions, dtype=jnp.int32)
    available = available_actions(env)
    if available is not None:
        actions = stand_ins(available)
    of_states = None if available is None else 0
    prob, outcome = jax.vmap(jax.vmap(env.outcomes, (None, 0)), (0, of_states))(states, actions)
    return Model(
        prob.astype(float),
        outcome.s_next.astype(jnp.int32),
        outcome.reward.astype(float),
        outcome.terminal,
        env.initial().astype(float),
        available,
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
    # In 64 bits from the first operation on, or 1/3 would be a float32 third.
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
    prob, s_next, reward, terminal, start, _ = model
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
    possible = model.prob > 0
    if _namespace(model) is np:
        return spread(np.nonzero(possible)[0], model.s_next[possible], model.start > 0)
    return _settle(lambda x: x.at[model.s_next].max(x[:, None, None] & possible), model.start > 0)


def backup(model: Model, v: Float[Any, "... S"], gamma: Any) -> Float[Any, "... S A"]:
    """q(s, a) = sum over outcomes of p (r + gamma' v(s')), float [..., S, A] (book, equation 4.6).

    `model` and `v` are either NumPy or JAX arrays; gamma' is 0 where the outcome is terminal. The value of an
    action that is not available is UNAVAILABLE.
    """
    over = model.terminal | (model.prob == 0)  # 0 x -inf is nothing here
    v_next = _namespace(model).where(over, 0, v[..., model.s_next])
    return _among(model, (model.prob * (model.reward + gamma * v_next)).sum(-1))


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
    return backup(model, _largest(checked_values(model, "q", q)), gamma)


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


def greedy_policy(q: Float[np.ndarray, "... S A"]) -> Float[np.ndarray, "... S A"]:
    """The policy that is greedy to `q`: the maximal actions of a state equally likely, float64 [..., S, A].

    Args:
        q: a table of action values [S, A], or many [..., S, A], such as `result.q` or `ds.q`.

    Raises:
        InputError: `q` is no such table, or an entry is not a number.
    """
    return _greedy(_checked_table(q))


def epsilon_greedy_policy(q: Float[np.ndarray, "... S A"], epsilon: float) -> Float[np.ndarray, "... S A"]:
    """The policy that is epsilon-greedy to `q`, ties split equally, float64 [..., S, A] (book, section 5.4).

    Args and errors: as `greedy_policy`; and `epsilon` must be in [0, 1].
    """
    check_rate("epsilon", epsilon)
    return _greedy(_checked_table(q), epsilon)


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
    v, _, caught = _policy_value(model, _checked_policy(model, policy_probs), gamma)
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
    return float(_from_start(model, _policy_value(model, _checked_policy(model, policy_probs), gamma).v))


def value_iteration(
    env: Environment, gamma: float = 1.0, tol: float = 1e-10, max_sweeps: int = 100_000
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """The optimal values v* and q* (book, section 4.4), float64 [S] and [S, A]; 0 at terminal states.

    At gamma = 1 values need not be finite. Where that is so only of states that cannot be reached from the
    start, all such states have NaN, and the others what they are worth.

    It starts from the values that policy iteration finds, for from 0 a corridor of S states would need S
    sweeps, and at gamma = 1 waiting for nothing may look better than it is. Sweeps then show how far these
    are from v*.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        tol: how far the value of any state may be from v*, whatever other states are worth. A bound for gamma
            below 1; at gamma = 1 an estimate, as if the changes went on shrinking at the slower of the last
            two rates. Where float64 does not allow it, for values and rewards of 1e9, say, a state is as
            good as rounding makes it: a sweep changes it by less than a few units in the last place of the
            numbers that are added up for it.
        max_sweeps: how many sweeps to make at most.

    Raises:
        InputError: gamma is 1 and from some state that can be reached no policy ever ends while rewards go
            on, or a round trip earns more than it costs; or `max_sweeps` were not enough.
    """
    check_rate("gamma", gamma)
    if not (isinstance(tol, int | float | np.number) and tol > 0):
        raise InputError(f"tol must be greater than 0, not {shown(tol)}")
    model, found, out = _solved(env, 0.0, gamma)
    v, terms = found.v, (found.probs * backup(_sizes(model), abs(found.v), gamma)).sum(1)
    rounding = ROUNDING * np.finfo(v.dtype).eps * terms
    old, ratio = np.inf, 1.0
    for _ in range(max_sweeps):
        new_v = _largest(backup(model, v, gamma))
        changes = abs(new_v - v)
        change = changes[changes > rounding].max(initial=0)
        rate = gamma if gamma < 1 else max(ratio, change / old)
        v = new_v
        if change * rate <= tol * (1 - rate):
            q = backup(model, v, gamma)
            return _unless(out, _largest(q)), _unless(out, q)
        old, ratio = change, change / old
    raise InputError(
        f"{_name(env)}: value iteration did not converge in {max_sweeps} sweeps; raise max_sweeps"
    )


def policy_iteration(
    env: Environment, gamma: float = 1.0
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """An optimal policy [S, A], v* [S] and q* [S, A], float64 (book, section 4.3).

    In no state is another action better by more than rounding, judged by the numbers that the values of the
    two are added up from, and not by what other states are worth. Of several best actions the policy takes
    any mixture, but at gamma = 1 one that ends where it must to be optimal. (To take the first of several
    best actions may be to go round for ever.)

    Raises:
        InputError: as `value_iteration`.
    """
    return epsilon_soft(env, 0.0, gamma)


def epsilon_soft(
    env: Environment, epsilon: float, gamma: float = 1.0
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, " S"], Float[np.ndarray, "S A"]]:
    """The best policy that takes every action with probability epsilon / A or more (book, section 5.4).

    Returns:
        The policy [S, A], its values [S] and its action values [S, A], float64; as good as those of
        `policy_iteration`.

    Raises:
        InputError: epsilon is not in [0, 1], or as `value_iteration`.
    """
    check_rate("epsilon", epsilon)
    check_rate("gamma", gamma)
    _, found, out = _solved(env, epsilon, gamma)
    return found.probs, _unless(out, found.v), _unless(out, found.q)


def largest_return(env: Environment, gamma: float, steps: int, anywhere: bool = False) -> float:
    """The largest |R_1 + gamma R_2 + ...| that so many steps or fewer can give, if chance and actions will.

    What the steps after the first `PATH_SWEEPS` can add is bounded by what the last of these could: with each
    step more a path can gain no more than with the step before.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        steps: the number of steps, at least 1.
        anywhere: whether the first step may be in any state, or only where one can come from the start.
    """
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
    return float(most[:, begin].max() + change * more)


def _solved(env: Environment, epsilon: float, gamma: float) -> tuple[Model, "_Round", Bool[np.ndarray, " S"]]:
    """The model, the last round of policy iteration in it, and which states were left out of both.

    Left out is what cannot be reached, where nothing else has no finite value. Raises InputError where there
    is no finite answer.
    """
    model = exact_model(env)
    found, out = _policy_iteration(model, epsilon, gamma), np.zeros(len(model.start), bool)
    if found.caught.any() and not (found.caught & (there := reachable(model))).any():
        out = ~there
        model = _ending(model, out)
        found = _policy_iteration(model, epsilon, gamma)
    if found.caught.any():
        where, who = f"{_name(env)}: from state {first(found.caught)[0]}", "epsilon-soft " if epsilon else ""
        said = (
            "a round trip earns more than it costs"
            if found.n
            else f"no {who}policy ever ends and rewards go on"
        )
        raise InputError(
            f"{where} {said}, so at gamma = 1 the optimal value is not finite; take gamma below 1"
        )
    if found.better.any():
        raise InputError(f"{_name(env)}: policy iteration did not settle in {MAX_ROUNDS} rounds")
    return model, found, out


def _unless(out: Bool[np.ndarray, " S"], values: Float[np.ndarray, "S *A"]) -> Float[np.ndarray, "S *A"]:
    """`values`, and NaN for the states that were left out."""
    return np.where(out.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)


def _ending(model: Model, states: Bool[Any, " S"]) -> Model:
    """The model in which `states` are terminal, so that whatever they pay has no part in anything."""
    where, states = _namespace(model).where, states[:, None, None]
    return model._replace(
        s_next=where(states, np.arange(len(states), dtype=np.int32)[:, None, None], model.s_next),
        reward=where(states, 0, model.reward),
        terminal=model.terminal | states,
    )


# --- inside a compiled program -----------------------------------------------------------------------


@contextlib.contextmanager
def doubled() -> Iterator[None]:
    """What is traced within is in float64, whatever the program around it is in.

    An environment that is written for 32 bits mixes in some 64-bit constants then, which is all right here.
    A TPU has no float64: there everything stays at the ambient precision.
    """
    with contextlib.ExitStack() as stack:
        if jax.default_backend() != "tpu":
            stack.enter_context(jax.enable_x64())
        stack.enter_context(jax.numpy_dtype_promotion("standard"))
        yield


def has_double() -> bool:
    """Whether float64 is what JAX makes of a number here, as within `doubled`."""
    return jax.dtypes.canonicalize_dtype(float) == np.float64


def _traced_model(env: Any) -> Model:
    """The Model of an environment inside a compiled program, of the states that matter.

    Those that cannot be reached from the start are made terminal: whatever they pay then has no part in
    anything. Probabilities that are thirds of float32 are made to add up to 1.
    """
    model = enumerate_model(jax.tree.map(lambda x: x.copy() if isinstance(x, np.ndarray) else x, env))
    model = _ending(model, ~reachable(model))
    return model._replace(prob=model.prob / model.prob.sum(-1, keepdims=True))


def measurer(env: Environment, gamma: Any) -> Measure:
    """A function from Q [S, A] to (greedy_value [], q_error []), for use under `jit` and `vmap`.

    greedy_value is the exact value, from the start distribution, of the policy that is greedy to Q with ties
    split; -inf where gamma is 1 and that policy may be caught for ever while rewards go on. q_error is the
    largest |Q - Q*| over the states that can be reached from the start and are not terminal, never visited
    ones included; NaN where Q* is not finite in one of them. Both are NaN where Q holds a NaN.

    Everything is computed in float64, also where the program around it is in float32, and comes back in the
    precision of Q. So both have the relative error of a float32, 6e-8, and in addition that of float64, 1e-16
    times the expected number of steps to the end, of the numbers that they are added up from. What `env` and
    `gamma` hold is taken as it is: a tracer in float32 holds 0.99 to 1e-8 only, while 1 - 0.99 is then right
    to 1e-6. (`train` hands on in full what is no tracer when it is called.)

    Args:
        env: an environment with `outcomes`; its leaves may be tracers.
        gamma: discount rate; may be a tracer.

    Raises:
        InputError: `env` can only be sampled.
    """
    check_finite(env)
    with doubled():
        model = _traced_model(env)
        gamma = jnp.asarray(gamma, model.prob.dtype)
        best = _policy_iteration(model, 0.0, gamma)
        found = ~(best.caught.any() | best.better.any())
        matters = ~terminal_states(model)

    def measure(q: Float[Array, "S A"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        if q.shape != model.prob.shape[:2]:
            raise InputError(f"exact values are those of one table [S, A]; this method has {list(q.shape)}")
        counts = matters[:, None] & (q > policies.UNAVAILABLE)
        # Said by itself: in compiled code 0 / 0 may be 0 and a maximum may pass over NaN.
        sound = ~jnp.isnan(q).any()
        with doubled():
            exact_q = q.astype(model.prob.dtype)
            v = _policy_value(model, _greedy(exact_q), gamma).v
            error = jnp.where(counts, abs(exact_q - best.q), 0).max().astype(q.dtype)
            value = _from_start(model, v).astype(q.dtype)
        return jnp.where(sound, value, jnp.nan), jnp.where(sound & found, error, jnp.nan)

    return measure


def value_measurer(env: Environment, policy_probs: Any, gamma: Any) -> Callable[[Any], Float[Array, ""]]:
    """A function from V [S] to the root of its mean squared error as v_pi, for use under `jit` and `vmap`.

    The mean is over the states that can be reached from the start and are not terminal; NaN where v_pi is not
    finite in one of them. In float64, as `measurer`.

    Args:
        env: an environment with `outcomes`; its leaves may be tracers.
        policy_probs: pi, float [S, A]; may be a tracer.
        gamma: discount rate; may be a tracer.

    Raises:
        InputError: `env` can only be sampled.
    """
    check_finite(env)
    with doubled():
        model = _traced_model(env)
        pi, gamma = (jnp.asarray(x, model.prob.dtype) for x in (policy_probs, gamma))
        v_pi = _policy_value(model, pi / pi.sum(1, keepdims=True), gamma).v
        matters = ~terminal_states(model)
        finite = jnp.isfinite(jnp.where(matters, v_pi, 0)).all()

    def measure(v: Float[Array, " S"]) -> Float[Array, ""]:
        with doubled():
            squares = jnp.where(matters, (v.astype(v_pi.dtype) - v_pi) ** 2, 0)
            error = jnp.sqrt(squares.sum() / matters.sum()).astype(v.dtype)
        return jnp.where(finite, error, jnp.nan)

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


def _among(model: Model, q: Float[Any, "... S A"]) -> Float[Any, "... S A"]:
    """`q` with UNAVAILABLE in place of what the model does not have."""
    return q if model.available is None else _namespace(model).where(model.available, q, policies.UNAVAILABLE)


def _largest(q: Float[Any, "... S A"]) -> Float[Any, "... S"]:
    """max over the actions of each state, [..., S]: the only place where planning takes it."""
    return q.max(-1)


def _greedy(q: Float[Any, "... S A"], epsilon: float = 0.0) -> Float[Any, "... S A"]:
    """The policy that is epsilon-greedy to `q`, ties split equally, as `policies.epsilon_greedy`."""
    best = (q == _largest(q)[..., None]).astype(q.dtype)
    greedy = best / best.sum(-1, keepdims=True)
    if not epsilon:
        return greedy
    there = (q > policies.UNAVAILABLE).astype(q.dtype)
    return epsilon * there / there.sum(-1, keepdims=True) + (1 - epsilon) * greedy


def _sizes(model: Model) -> Model:
    """The same with all rewards taken as positive: to see how large the numbers are that are added up."""
    return model._replace(reward=abs(model.reward))


# What leads where.


def _settle(change: Callable[[Any], Any], states: Any) -> Bool[Any, " S"]:
    """Applies `change`, which only adds or only removes, to a set of states, bool [S], until it stays."""
    carry = states, change(states)
    return lax.while_loop(lambda c: (c[0] != c[1]).any(), lambda c: (c[1], change(c[1])), carry)[1]


def spread(
    source: Int[np.ndarray, " N"], target: Int[np.ndarray, " N"], states: Bool[np.ndarray, " S"]
) -> Bool[np.ndarray, " S"]:
    """What can be reached from `states` along arrows from `source` to `target`, these included, bool [S]."""
    from scipy import sparse  # here, because it takes 0.3 s
    from scipy.sparse.csgraph import breadth_first_order

    n, begin = len(states), np.flatnonzero(states)  # one more node, n, leads to all with which it begins
    rows, columns = np.append(source, np.full(len(begin), n)), np.append(target, begin)
    graph = sparse.csr_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(n + 1, n + 1))
    graph.data[:] = 1  # not the number of parallel arrows, which might be 256, or 0
    reached = breadth_first_order(graph, n, return_predecessors=False)
    return np.isin(np.arange(n), reached)


def _reaching(model: Model, taken: Bool[Any, "S A K"], states: Bool[Any, " S"]) -> Bool[Any, " S"]:
    """The states from which `states` can be reached along the outcomes `taken`, these included, bool [S]."""
    if _namespace(model) is np:
        return spread(model.s_next[taken], np.nonzero(taken)[0], states)
    return _settle(lambda x: x | (taken & x[model.s_next]).any((1, 2)), states)


def _home(model: Model, free: Bool[Any, "S A"]) -> Bool[Any, " S"]:
    """The states in which one can stay for ever with actions that are `free`, bool [S]."""
    if _namespace(model) is jnp:
        stays = lambda x: free & ((model.prob == 0) | x[model.s_next]).all(-1)
        return _settle(lambda x: stays(x).any(-1), free.any(-1))
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


def _fate(model: Model, probs: Float[Any, "S A"]) -> tuple[Any, Any, Any]:
    """The states settled under a policy, those caught, and those that may end up caught, bool [S] each."""
    taken = (probs > 0)[:, :, None] & (model.prob > 0)
    settled = ~_reaching(model, taken, (taken & (model.reward != 0)).any((1, 2)))
    caught = ~_reaching(model, taken, settled)
    return settled, caught, _reaching(model, taken, caught)


# The values of a policy.


class _Values(NamedTuple):
    """The values of a policy, and how sure they are.

    Attributes:
        v: float [S]; -inf from states that may come to be caught.
        size: how large the numbers are that each is added up from, so that the rounding error of v(s) is a
            few units in the last place of that, [S]. What cannot be reached from s has no part in it. Sparse,
            it is the expected sum over all steps from s on of the discounted |r| + |v|; dense, that of |r|,
            times S (see `_solve_dense`).
        caught: where the value is not finite because the policy is caught, bool [S]; gamma below 1 catches
            nothing.
    """

    v: Float[Any, " S"]
    size: Float[Any, " S"]
    caught: Bool[Any, " S"]


def _policy_value(model: Model, probs: Float[Any, "S A"], gamma: Any) -> _Values:
    where = _namespace(model).where
    settled, caught, doomed = _fate(model, probs)
    doomed = doomed & (gamma == 1)
    # Terminal states are settled. What leads to a state that is left out is taken to end there.
    v, size = _solve(model, probs, gamma, settled | doomed)
    return _Values(where(doomed, -np.inf, v), where(doomed, 0, size), caught & (gamma == 1))


def _solve(model: Model, probs: Any, gamma: Any, known: Bool[Any, " S"]) -> tuple[Any, Any]:
    """The values of a policy where those of some states are known to be 0, and their `_Values.size`, [S]."""
    weight = probs[:, :, None] * model.prob
    reward, earned = ((weight * r).sum((1, 2)) for r in (model.reward, abs(model.reward)))
    where, over = _namespace(model).where, known[model.s_next]
    onward, leaving = where(over, 0, gamma * weight), where(over, weight, (1 - gamma) * weight).sum((1, 2))
    n = len(reward)
    if _namespace(model) is jnp:
        rows = np.arange(n)[:, None, None]
        chain = jnp.zeros((n, n), weight.dtype).at[rows, model.s_next].add(onward)
        v, size = _solve_dense(chain, leaving, jnp.stack([reward, earned], 1)).T
        return v, n * size
    chain = from_state_to_state(model, onward)
    solve = sparse_solver(chain)
    v = solve(reward)
    # Once more for what is left over (iterative refinement: Higham 2002, chapter 12). It is added up from
    # differences of neighbours, so that it keeps its digits where a chain goes on for long.
    v = v + solve(reward - leaving * v + (onward * (v[model.s_next] - v[:, None, None])).sum((1, 2)))
    return v, abs(v) + solve(earned + chain @ abs(v))


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


def sparse_solver(matrix: Any) -> Callable[[Float[np.ndarray, " S"]], Float[np.ndarray, " S"]]:
    """A function that solves x = constant + matrix x for x [S]; NaN where that has no one solution.

    `matrix` is sparse [S, S], without negative entries. Rows are not exchanged.
    """
    from scipy import sparse
    from scipy.sparse.linalg import splu

    n = matrix.shape[0]
    system = sparse.csc_array(sparse.eye_array(n, format="csc") - matrix)
    in_place = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        return splu(system, **in_place).solve
    except RuntimeError:  # "Factor is exactly singular"
        return lambda constant: np.full(n, np.nan)


@custom_vmap
def _solve_dense(
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


@_solve_dense.def_vmap
def _solve_dense_rule(axis_size, batched, *args):
    """On a CPU one lane after another, so that its matrix stays in the cache."""
    args = (
        x if b else jnp.broadcast_to(x, (axis_size, *x.shape)) for x, b in zip(args, batched, strict=True)
    )
    with doubled():
        if jax.default_backend() == "cpu":
            return lax.map(lambda lane: _solve_dense(*lane), tuple(args)), True
        return jax.vmap(_solve_dense.fun)(*args), True


# The best policy.


class _Round(NamedTuple):
    """A policy in policy iteration, and what is better.

    Attributes:
        probs: the policy [S, A].
        v, q: its values [S] and action values [S, A].
        caught: as in `_Values`; if there are some nothing is improved.
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


def _policy_iteration(model: Model, epsilon: float, gamma: Any) -> _Round:
    """Policy iteration among the epsilon-soft policies, until nothing is better or a policy is caught.

    Only actions that are better by more than rounding replace old ones. So at gamma = 1 no improved policy
    can be caught, unless in a loop that earns more than it costs: along a loop without gain all actions were
    equal, and stayed.
    """
    where, unit = _namespace(model).where, ROUNDING * np.finfo(model.prob.dtype).eps

    def judged(probs, n):
        v, size, caught = _policy_value(model, probs, gamma)
        q = backup(model, where(v == -np.inf, 0, v), gamma)  # where some are caught it is not looked at
        improved = _greedy(q, epsilon)
        best = (improved * q).sum(-1)
        sizes = (improved * backup(_sizes(model), size, gamma)).sum(-1)
        return _Round(probs, v, q, caught, best > v + unit * (size + sizes), improved, n)

    def improve(last):
        return judged(where(last.better[:, None], last.improved, last.probs), last.n + 1)

    def go_on(last):
        return last.better.any() & ~last.caught.any() & (last.n < MAX_ROUNDS)

    # It begins with the first policy as what is better everywhere, so that `judged` is in a program only once.
    probs = _first_policy(model, epsilon, gamma)
    nothing, no = 0 * probs, probs[:, 0] < 0
    return _loop(model, go_on, improve, _Round(probs, nothing[:, 0], nothing, no, ~no, probs, np.int32(-1)))


def _first_policy(model: Model, epsilon: float, gamma: Any) -> Float[Any, "S A"]:
    """A policy [S, A] to improve, which at gamma = 1 is caught only where every policy is.

    Any action, equally likely; but where one can stay for ever for nothing, that, if the rest costs more. For
    nothing is worth more than a loop that is free, and no single step of improvement would find it: with
    "wait for 0" or "take 1, then pay 3" waiting looks worth what the rest is worth.
    """
    namespace = _namespace(model)
    there = namespace.ones(model.prob.shape[:2], bool) if model.available is None else model.available
    anything = there / there.sum(-1, keepdims=True).astype(model.prob.dtype)
    if epsilon:
        return anything
    free = ((model.prob == 0) | (model.reward == 0)).all(-1)
    home = _home(model, free)
    staying = free & ((model.prob == 0) | home[model.s_next]).all(-1) | ~home[:, None]
    staying = (staying & there).astype(model.prob.dtype)
    staying = staying / staying.sum(-1, keepdims=True)
    v, _, caught = _policy_value(model, anything, gamma)
    mixed = namespace.where((home & (v < 0))[:, None], staying, anything)
    lost = caught.any() | _fate(model, mixed)[1].any()
    return namespace.where(lost, staying, mixed)


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
    if model.available is not None:
        policies.check_among("policy_probs", probs, model.available)
    return probs / probs.sum(1, keepdims=True)


def checked_values(model: Model, name: str, values: Any) -> np.ndarray:
    """`values` in float64: v [S], or q [S, A], whatever that says of actions that are not available."""
    array = _numbers(name, values)
    shape = model.prob.shape[: 1 if name == "v" else 2]
    if array.shape != shape:
        each = f"{shape[0]} states" + "".join(f" and {n} actions" for n in shape[1:])
        raise InputError(f"{name} must have one value for each of the {each}, not {array.shape}")
    return array if name == "v" else _among(model, array)


def check_rate(name: str, value: float) -> None:
    """Raises InputError unless `value` is a number in [0, 1]."""
    if not (isinstance(value, int | float | np.number) and 0 <= value <= 1):
        raise InputError(f"{name} must be between 0 and 1, not {shown(value)}")


def _checked_table(q: Any) -> Float[np.ndarray, "... S A"]:
    """`q` in float64. Raises InputError unless it is a table of numbers, or many."""
    array = _numbers("q", q)
    if array.ndim < 2 or not array.size:
        raise InputError(f"q must be action values [S, A] or [..., S, A], not of shape {array.shape}")
    if (i := first(np.isnan(array))) is not None:
        raise InputError(f"q{list(i)} is not a number, so no action is the best there")
    return array
