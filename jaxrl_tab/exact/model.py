"""The model of an environment: every outcome of every action in every state, and what leads where."""

import functools
import hashlib
import io
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxrl_tab.core import memory, policies
from jaxrl_tab.core.checks import check_pytree, first, foreign, is_distribution
from jaxrl_tab.core.declared import name_of, of_environment
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.types import Available, Environment, FiniteEnvironment, available_actions, stand_ins

T = TypeVar("T")

BYTES_OF_OUTCOME = 64  # in the model and, while it is made, in JAX
KEPT_BYTES = 2**27  # of the last models, and what was solved in them, that `once_for_an_environment` keeps
FILE_BYTES = 2**20  # of what is kept for later processes, at most


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
    available: Available | None = None


def check_finite(env: Environment) -> None:
    """Raises InputError where `env` can only be sampled, so that nothing exact can be said about it."""
    if isinstance(env, str):
        raise InputError(f"env must be an environment such as make('windy-gridworld'), not {shown(env)}")
    if not isinstance(env, FiniteEnvironment):
        raise InputError(
            f"{name_of(env)} can only be sampled; exact values need one with `outcomes` and `initial`{foreign(env)}"
        )


def check_lasting(env: Environment) -> None:
    """Raises InputError where `env` can only be sampled, or changes in a run: nothing exact then holds in all steps."""
    check_finite(env)
    if of_environment(env).at is not None:
        raise InputError(
            f"{name_of(env)} changes while a run goes on, so that no exact values hold in all of its rows; leave out "
            "exact"
        )


def enumerate_model(env: Any) -> Model:
    """The Model of a finite environment in JAX arrays of the ambient precision, under `jit` too."""
    states = jnp.arange(env.num_states, dtype=jnp.int32)
    actions = jnp.arange(env.num_actions, dtype=jnp.int32)
    available = available_actions(env)
    if available is not None:
        actions = stand_ins(available)
    # The axis of `actions` that goes with the states: it has one only where these differ in their actions.
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


_kept: dict[Any, Any] = {}
Keeper = Callable[[Any, Callable[[], Any], Callable[[Any], bytes | None], Callable[[bytes], Any]], Any]
_keeper: Keeper = lambda name, make, pack, unpack: make()


def keep_with(keeper: Keeper) -> None:
    """From now on what is worked out once is kept for later processes, too, as `engine.programs.kept` keeps things."""
    global _keeper
    _keeper = keeper


def once_for_an_environment(like: Any) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """`work(env, *numbers)`, done once for an environment: the last results are kept, up to `KEPT_BYTES`.

    They are found again by value, not by identity: by the class of `env`, what is static in it, and a checksum of
    its arrays. So an environment that is made twice is worked out once, and one whose arrays were written to anew.
    The results are pytrees of arrays, which nobody may write to.

    Args:
        like: a pytree of the same structure as the results, in which None may stand for an array.
    """

    def once(work: Callable[..., T]) -> Callable[..., T]:
        @functools.wraps(work)
        def remembered(env: Any, *numbers: Any) -> T:
            try:
                key = work, _value(env), tuple((type(x), x) for x in numbers)
                result = _kept.get(key)
            # A key of JAX in it is no array, not everything can be compared, and a list may hold itself.
            except (TypeError, ValueError, SystemError):
                return work(env, *numbers)
            if result is None:
                name = "exact", work.__qualname__, env, numbers
                make = lambda: work(env, *numbers)
                _kept[key] = result = _keeper(name, make, _to_bytes, lambda data: _from_bytes(data, like))
                while memory.size(list(_kept.values())) > KEPT_BYTES:
                    _kept.pop(next(iter(_kept)), None)
            return result

        return remembered

    return once


def _to_bytes(result: Any) -> bytes | None:
    """Its arrays; None where they are too large for a file."""
    if memory.size(result) > FILE_BYTES:
        return None
    leaves = jax.tree.leaves(result, is_leaf=_is_none)
    to = io.BytesIO()
    np.savez(to, **{str(i): x for i, x in enumerate(leaves) if x is not None})
    return to.getvalue()


def _from_bytes(data: bytes, like: Any) -> Any:
    """What `_to_bytes` was given."""
    structure = jax.tree.structure(like, is_leaf=_is_none)
    with np.load(io.BytesIO(data)) as arrays:
        leaves = [arrays.get(str(i)) for i in range(structure.num_leaves)]
    for x in leaves:
        if x is not None:
            x.flags.writeable = False
    return jax.tree.unflatten(structure, leaves)


def _is_none(x: Any) -> bool:
    return x is None


def _value(env: Any) -> tuple:
    """A key for a pytree: equal where structure, types and the contents of all arrays are equal."""
    leaves, structure = jax.tree.flatten(env)
    arrays = [np.ascontiguousarray(x) for x in leaves]
    digests = [hashlib.sha256(x.view(np.uint8).data).digest() for x in arrays]
    about = zip(map(type, leaves), (x.dtype for x in arrays), map(np.shape, leaves), digests, strict=True)
    return structure, tuple(about)


def exact_model(env: Environment) -> Model:
    """The Model of a finite environment in float64 NumPy arrays that cannot be written to, checked.

    It is worked out once: see `once_for_an_environment`.

    Raises:
        InputError: `env` can only be sampled, is a batch of environments, or breaks the rules of one; the
            message names the first wrong state or (s, a).
    """
    check_finite(env)
    check_pytree(name_of(env), env)
    # As views, for a live program that closes over an array makes JAX 0.10 remember its value in 32 bits.
    return jax.tree.map(np.ndarray.view, _checked_model(env))


@once_for_an_environment(like=Model(*[None] * len(Model._fields)))
def _checked_model(env: Any) -> Model:
    _check_size(env)
    # In 64 bits from the first operation on, or 1/3 would be a float32 third.
    with jax.enable_x64(), jax.numpy_dtype_promotion("standard"):
        # A copy, for the reason given above.
        env = jax.tree.map(lambda x: x.copy() if isinstance(x, np.ndarray) else x, env)
        model = jax.tree.map(np.asarray, _enumerate_jit(env))
    _check_model(name_of(env), model)
    return model


def _check_size(env: Any) -> None:
    """Raises InputError where all outcomes, of one for each state and action at least, do not fit in memory."""
    pairs = env.num_states * env.num_actions
    if pairs >= 2**31 or BYTES_OF_OUTCOME * pairs > memory.free():
        raise InputError(
            f"{name_of(env)}: {env.num_states:,} states with {env.num_actions:,} actions each are more than fit in "
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
    if array_module(model) is np:
        return spread(np.nonzero(possible)[0], model.s_next[possible], model.start > 0)
    return settle(lambda x: x.at[model.s_next].max(x[:, None, None] & possible), model.start > 0)


def backup(model: Model, v: Float[Any, "... S"], gamma: Any) -> Float[Any, "... S A"]:
    """q(s, a) = sum over outcomes of p (r + gamma' v(s')), float [..., S, A] (book, equation 4.6).

    `model` and `v` are either NumPy or JAX arrays; gamma' is 0 where the outcome is terminal. The value of an
    action that is not available is UNAVAILABLE.
    """
    over = model.terminal | (model.prob == 0)  # so that 0 times -inf counts as 0
    v_next = array_module(model).where(over, 0, v[..., model.s_next])
    return available_only(model, (model.prob * (model.reward + gamma * v_next)).sum(-1))


def ending_at(model: Model, states: Bool[Any, " S"]) -> Model:
    """The model in which `states` are terminal, so that whatever they pay has no part in anything."""
    where, states = array_module(model).where, states[:, None, None]
    return model._replace(
        s_next=where(states, np.arange(len(states), dtype=np.int32)[:, None, None], model.s_next),
        reward=where(states, 0, model.reward),
        terminal=model.terminal | states,
    )


def array_module(model: Model) -> Any:
    return jnp if isinstance(model.prob, jax.Array) else np


def while_loop(model: Model, go_on: Callable[[Any], Any], body: Callable[[Any], Any], carry: Any) -> Any:
    """`lax.while_loop`, or the same in plain Python where the model is NumPy."""
    if array_module(model) is jnp:
        return lax.while_loop(go_on, body, carry)
    while go_on(carry):
        carry = body(carry)
    return carry


def either(model: Model, condition: Any, yes: Callable[[], T], no: Callable[[], T]) -> T:
    """`lax.cond`, or the same in plain Python where the model is NumPy."""
    if array_module(model) is jnp:
        return lax.cond(condition, yes, no)
    return yes() if condition else no()


def available_only(model: Model, q: Float[Any, "... S A"]) -> Float[Any, "... S A"]:
    """`q` with UNAVAILABLE in place of what the model does not have."""
    return (
        q if model.available is None else array_module(model).where(model.available, q, policies.UNAVAILABLE)
    )


def with_sizes(model: Model) -> Model:
    """The model with |r| for every reward r: its values tell how large the numbers are that are added up."""
    return model._replace(reward=abs(model.reward))


# What leads where.
def settle(change: Callable[[Any], Any], states: Any) -> Bool[Any, " S"]:
    """Applies `change`, which only adds or only removes states, to a set, bool [S], until nothing changes."""
    carry = states, change(states)
    return lax.while_loop(lambda c: (c[0] != c[1]).any(), lambda c: (c[1], change(c[1])), carry)[1]


def spread(
    source: Int[np.ndarray, " N"], target: Int[np.ndarray, " N"], states: Bool[np.ndarray, " S"]
) -> Bool[np.ndarray, " S"]:
    """What can be reached from `states` along arrows from `source` to `target`, these included, bool [S]."""
    # In plain Python, since to import SciPy's graphs takes longer than this does for a hundred thousand arrows.
    if len(source) > len(states) ** 2:  # then some are there several times
        arrows = np.zeros((len(states), len(states)), bool)
        arrows[source, target] = True
        source, target = np.nonzero(arrows)
    order = np.argsort(source, kind="stable")
    targets = target[order].tolist()
    first = np.searchsorted(source[order], np.arange(len(states) + 1)).tolist()
    reached = states.tolist()
    to_visit = np.flatnonzero(states).tolist()
    while to_visit:
        s = to_visit.pop()
        for s_next in targets[first[s] : first[s + 1]]:
            if not reached[s_next]:
                reached[s_next] = True
                to_visit.append(s_next)
    return np.array(reached, bool)


def reaching(
    model: Model, taken: Bool[Any, "S A K"], states: Bool[Any, " S"]
) -> tuple[Bool[Any, " S"], Bool[Any, " S"], Bool[Any, " S"]]:
    """From which states those of three sets can be reached along the outcomes `taken`, these included, bool [S] each.

    The first set is `states`. The second and the third are what is left over: the states from which the set before
    cannot be reached.
    """
    if array_module(model) is np:
        source, target, found = model.s_next[taken], np.nonzero(taken)[0], []
        for _ in range(3):
            found.append(spread(source, target, states))
            states = ~found[-1]
        return found[0], found[1], found[2]

    # One set after another in the same loop: three loops would take three times as long to compile.
    def grow(carry: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        number, states, found = carry
        more = states | (taken & states[model.s_next]).any((1, 2))
        is_whole = (more == states).all()
        found = jnp.where(np.arange(3)[:, None] == number, more, found)
        return number + is_whole, jnp.where(is_whole, ~more, more), found

    nothing = jnp.zeros((3, len(taken)), bool)
    found = lax.while_loop(lambda carry: carry[0] < 3, grow, (jnp.int32(0), states, nothing))[2]
    return found[0], found[1], found[2]


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
