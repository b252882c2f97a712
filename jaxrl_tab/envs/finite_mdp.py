"""Any finite MDP, from arrays or from lists of outcomes (book, section 3.1)."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab import policies
from jaxrl_tab.envs.base import MAX_STEPS, Finite, assign, numbers
from jaxrl_tab.types import TOLERANCE, InputError, Outcome, first, is_whole, pytree, shown, static, whole

NAME = "FiniteMDP"
FORMS = {"state": "[S, A, S']", "action": "[A, S, S']"}  # of probabilities, by their first axis
PAIRS = "; ddp.to_product_form() of QuantEcon turns pairs of states and actions into [S, A, S']"


@pytree
class FiniteMDP(Finite):
    """Any finite MDP, from its probabilities and rewards.

    A task without terminal states is allowed: it goes on until its time limit. Of each state and action only
    the successors of positive probability are kept, K at most, so an outcome is a row of K and not of S.
    Environments of equal S, A, K and M can be stacked, leaf by leaf, and batched by `vmap`.

    `from_arrays` takes arrays and sparse matrices as pymdptoolbox and QuantEcon have them, `from_outcomes`
    what may happen, in lists or dicts, as in the table `P` of Gymnasium.

    Args:
        probabilities: p(s' | s, a), [S, A, S']; each row adds up to 1 (within 1e-6; it is then rescaled).
            The state is the first axis also where S = A, and [A, S, S'] would have the same shape.
        rewards: the expected reward r(s, a) [S, A], or r(s, a, s') [S, A, S'].
        terminal: the terminal states, as a list of their numbers or as booleans [S]. Their rows in
            `probabilities` and `rewards` are not looked at: a terminal state leads to itself with reward 0.
        start: the state in which episodes start, or the distribution of the start state, [S].
        max_steps: time limit of an episode, in steps.

    Attributes:
        successors: s', int32 [S, A, K]; where (s, a) has fewer than K, some other states fill the row.
        prob: their probabilities, float64 [S, A, K]; 0 for what fills the row.
        reward: their rewards, float64 [S, A, K].
        is_terminal: bool [S].
        start_states: the states in which episodes may start, int32 [M].
        start_prob: their probabilities, float64 [M].
        max_steps: time limit of an episode, in steps.

    Raises:
        InputError: something given is wrong; the message names the first wrong (s, a) or state.
    """

    successors: Int[Array | np.ndarray, "S A K"]
    prob: Float[Array | np.ndarray, "S A K"]
    reward: Float[Array | np.ndarray, "S A K"]
    is_terminal: Bool[Array | np.ndarray, " S"]
    start_states: Int[Array | np.ndarray, " M"]
    start_prob: Float[Array | np.ndarray, " M"]
    max_steps: int = static(default=MAX_STEPS)

    def __init__(
        self,
        probabilities: Any,
        rewards: Any = None,
        terminal: Any = (),
        start: Any = 0,
        max_steps: int = MAX_STEPS,
    ):
        p = _probabilities(probabilities, rewards)
        listed = _of_arrays(p, _rewards(rewards, p.shape))
        is_terminal = _terminal(terminal, len(p))
        _fill(self, listed, is_terminal, _start(start, is_terminal), max_steps)

    @classmethod
    def from_arrays(
        cls,
        probabilities: Any,
        rewards: Any,
        terminal: Any = (),
        start: Any = 0,
        max_steps: int = MAX_STEPS,
        *,
        first_axis: str | None = None,
    ) -> "FiniteMDP":
        """Any finite MDP, from arrays or sparse matrices as other tools have them.

        `from_arrays(P, R)` is for what pymdptoolbox takes, where the action is the first axis, and
        `from_arrays(Q, R)` for a `DiscreteDP` of QuantEcon, where the state is. The shape tells which it is,
        except where S = A: then `first_axis` must say it. Sparse matrices are never made dense.

        Args:
            probabilities: p(s' | s, a), [S, A, S'] or [A, S, S'], or a list of one SciPy sparse matrix
                [S, S'] for each action.
            rewards: r(s) [S], of leaving s; or r(s, a) [S, A]; or r(s, a, s') with the axes of
                `probabilities`, or as a list of one sparse matrix [S, S'] for each action.
            terminal, start, max_steps: as of the class.
            first_axis: "state" or "action"; by default as the shape of `probabilities` says.

        Raises:
            InputError: something given is wrong; the message names the first wrong (s, a) or state.
        """
        listed = _of_other_arrays(probabilities, rewards, first_axis)
        is_terminal = _terminal(terminal, listed.num_states)
        mdp = object.__new__(cls)
        _fill(mdp, listed, is_terminal, _start(start, is_terminal), max_steps)
        return mdp

    @classmethod
    def from_outcomes(
        cls, outcomes: Any, terminal: Any = (), start: Any = 0, max_steps: int = MAX_STEPS
    ) -> "FiniteMDP":
        """Any finite MDP, from the outcomes of each action, `outcomes[s][a] = [(p, s', reward), ...]`.

        No array [S, A, S'] is made, and a state s' may be entered with different rewards: they are kept
        apart. Outcomes of one s' and reward are added up.

        An outcome may also be (p, s', reward, terminated), as in the table `P` of Gymnasium. A state is
        then terminal where an outcome that can follow from the start says so, or where `terminal` does; what
        is listed after it is not looked at. One that is entered both ways gets a second number for being
        terminal, after all others. (In states that cannot be reached from the start, entering such a state
        ends the episode, and nothing else does.)

        Args:
            outcomes: a list [S] of lists [A] of lists of the outcomes, in any order; their probabilities add
                up to 1. Dicts with the keys 0 to S - 1 and 0 to A - 1 serve as well.
            terminal, start, max_steps: as of the class.

        Raises:
            InputError: something given is wrong; the message names the first wrong (s, a) or state.
        """
        states = _in_order("outcomes", outcomes)
        if not len(states) or not len(_in_order("the actions of s = 0", states[0])):
            raise InputError(
                f"{NAME}: outcomes must be a list of states, each a list of actions with outcomes"
            )
        is_terminal = _terminal(terminal, len(states))
        start_prob = _start(start, is_terminal)
        listed, ends = _of_outcomes(states, is_terminal)
        if ends is not None:
            listed, is_terminal, start_prob = _ended(listed, ends, is_terminal, start_prob)
        mdp = object.__new__(cls)
        _fill(mdp, listed, is_terminal, start_prob, max_steps)
        return mdp

    @property
    def num_states(self) -> int:
        return self.successors.shape[-3]  # from the right: a stack of environments has axes before it

    @property
    def num_actions(self) -> int:
        return self.successors.shape[-2]

    def initial(self) -> Float[Array, " S"]:
        start_prob = jnp.asarray(self.start_prob, float)
        return jnp.zeros(self.num_states, dtype=float).at[self.start_states].set(start_prob)

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        start_states, start_prob = jnp.asarray(self.start_states), jnp.asarray(self.start_prob, float)
        return start_states[0 if len(start_states) == 1 else policies.sample(key, start_prob)]

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        s_next = jnp.asarray(self.successors)[s, a]
        prob, reward = (jnp.asarray(x, float)[s, a] for x in (self.prob, self.reward))
        return prob, Outcome(s_next, reward, jnp.asarray(self.is_terminal)[s_next])


class _Listed(NamedTuple):
    """All outcomes of an MDP, one after another, those of (s, a) before those of (s, a + 1) and (s + 1, a).

    Attributes:
        num_states, num_actions: S and A.
        row: s A + a, int [n].
        s_next: s', int [n].
        prob, reward: float64 [n].
    """

    num_states: int
    num_actions: int
    row: np.ndarray
    s_next: np.ndarray
    prob: np.ndarray
    reward: np.ndarray

    def after(self, i: int) -> str:
        """Where outcome `i` is, for a message."""
        return f"after (s, a) = {divmod(int(self.row[i]), self.num_actions)}"

    def of(self, chosen: np.ndarray) -> "_Listed":
        """Some of them, in another order perhaps."""
        return _Listed(*self[:2], *(column[chosen] for column in self[2:]))


def _fill(mdp: Any, listed: _Listed, is_terminal: Any, start_prob: Any, max_steps: Any) -> None:
    """Sets the fields of `mdp`, after all checks of what is listed."""
    listed = _absorbed(listed, is_terminal)
    _check_outcomes(listed)
    listed = _added_up(listed.of(listed.prob > 0))
    _check_reachable(listed, is_terminal, start_prob)
    shape = listed.num_states, listed.num_actions, -1
    count = np.bincount(listed.row, minlength=listed.num_states * listed.num_actions)
    at = listed.row, np.arange(len(listed.row)) - (np.cumsum(count) - count)[listed.row]
    successors = _others(listed, count)
    prob, reward = np.zeros(successors.shape), np.zeros(successors.shape)
    total = np.bincount(listed.row, listed.prob)[listed.row]
    successors[at], prob[at], reward[at] = listed.s_next, listed.prob / total, listed.reward
    start_states = np.flatnonzero(start_prob)
    assign(
        mdp,
        successors=successors.reshape(shape).astype(np.int32),
        prob=prob.reshape(shape),
        reward=reward.reshape(shape),
        is_terminal=is_terminal,
        start_states=start_states.astype(np.int32),
        start_prob=start_prob[start_states],
        max_steps=whole(NAME, "max_steps", max_steps),
    )


def _absorbed(listed: _Listed, is_terminal: np.ndarray) -> _Listed:
    """`listed`, where terminal states lead to themselves with reward 0, whatever was listed after them."""
    actions = np.arange(listed.num_actions)
    kept = listed.of(~is_terminal[listed.row // listed.num_actions])
    ends = np.flatnonzero(is_terminal)
    rows = (ends[:, None] * listed.num_actions + actions).ravel()
    s_next = np.repeat(ends, listed.num_actions)
    more = rows, s_next, np.ones(len(rows)), np.zeros(len(rows))
    columns = map(np.concatenate, zip(kept[2:], more, strict=True))
    every = _Listed(*listed[:2], *columns)
    return every.of(np.argsort(every.row, kind="stable"))


def _added_up(listed: _Listed) -> _Listed:
    """`listed`, where outcomes of one (s, a), s' and reward are one, in the place of the first."""
    if (np.diff(listed.row * listed.num_states + listed.s_next) > 0).all():
        return listed  # as of arrays
    order = np.lexsort((listed.reward, listed.s_next, listed.row))
    alike = listed.of(order)
    keys = np.stack([alike.row, alike.s_next, alike.reward])
    is_new = np.append(True, (np.diff(keys) != 0).any(axis=0))
    total = np.bincount(np.cumsum(is_new) - 1, alike.prob)
    one = order[is_new]
    place = np.argsort(one)
    return listed.of(one[place])._replace(prob=total[place])


def _others(listed: _Listed, count: np.ndarray) -> np.ndarray:
    """States [S A, K] to fill rows with whose `count` of outcomes is less than K.

    From place `count` on they are those that are not entered, in their order, and s itself where these end.
    """
    most = count.max()
    width = min(most, listed.num_states)
    is_entered = np.zeros((len(count), width), bool)
    near = listed.s_next < width
    is_entered[listed.row[near], listed.s_next[near]] = True
    states = np.repeat(np.arange(len(count)) // listed.num_actions, most).reshape(-1, most)
    which = np.arange(most) - count[:, None]
    at = np.nonzero((which >= 0) & (which < width - is_entered.sum(axis=1, keepdims=True)))
    states[at] = np.argsort(is_entered, axis=1, kind="stable")[at[0], which[at]]
    return states


def _reached(num_states: int, source: np.ndarray, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The states that steps from `source` to `target` lead to from those of `start`, bool [S]."""
    from scipy import sparse  # late, for importing the package is to stay cheap

    begin = np.flatnonzero(start)  # one more vertex leads to all of them
    ends = np.append(source, np.full(len(begin), num_states)), np.append(target, begin)
    graph = sparse.csr_matrix((np.ones(len(ends[0]), bool), ends), shape=(num_states + 1,) * 2)
    found = sparse.csgraph.breadth_first_order(graph, num_states, return_predecessors=False)
    return np.isin(np.arange(num_states), found)


# --- reading what was given --------------------------------------------------------------------------


def _probabilities(probabilities: Any, rewards: Any) -> np.ndarray:
    """p [S, A, S'] as the class takes it."""
    wanted = f"{NAME}: probabilities must be an array [S, A, S']"
    if _is_sparse(probabilities):
        raise InputError(
            f"{wanted}; FiniteMDP.from_arrays takes sparse matrices, one [S, S'] for each action"
        )
    if hasattr(probabilities, "unwrapped"):
        raise InputError(f"{wanted}; rl.interop.from_gymnasium takes an environment of Gymnasium")
    if isinstance(probabilities, Mapping) or rewards is None:
        raise InputError(
            f"{wanted}, with rewards beside it; FiniteMDP.from_outcomes takes tables of outcomes"
        )
    p = numbers(NAME, "probabilities", probabilities).astype(np.float64)
    if p.ndim == 3 and p.shape[0] == p.shape[2] and p.size > 0:
        return p
    hint = ""
    if p.ndim == 3 and p.shape[1] == p.shape[2]:
        hint = "; FiniteMDP.from_arrays takes [A, S, S'], and the rewards that belong to it"
    elif p.ndim == 2 and np.ndim(rewards) == 3:
        hint = ": they come first, and then the rewards"
    elif p.ndim == 2:
        hint = PAIRS
    elif p.ndim == 4:
        hint = "; FiniteMDP.from_outcomes takes lists of outcomes"
    raise InputError(f"{NAME}: probabilities must have shape [S, A, S'], not {p.shape}{hint}")


def _rewards(rewards: Any, shape: tuple[int, ...]) -> np.ndarray:
    """r [S, A, 1 or S'] as the class takes it."""
    wanted = f"{NAME}: rewards must have shape [S, A] = {shape[:2]} or [S, A, S'] = {shape}"
    if _is_sparse(rewards):
        raise InputError(f"{wanted}; FiniteMDP.from_arrays takes sparse ones")
    r = numbers(NAME, "rewards", rewards).astype(np.float64)
    if r.shape in (shape[:2], shape):
        return r.reshape(*shape[:2], -1)
    hint = ""
    if r.shape == shape[:1]:
        hint = "; FiniteMDP.from_arrays takes [S]"
    elif r.shape in ((shape[1], shape[0]), (shape[1], shape[0], shape[0])):
        hint = "; np.swapaxes(rewards, 0, 1) turns it into one of them"
    raise InputError(f"{wanted}, not {r.shape}{hint}")


def _of_arrays(p: np.ndarray, r: np.ndarray) -> _Listed:
    """The outcomes in `p` [S, A, S'] and `r` [S, A, 1 or S']."""
    s, a, s_next = at = np.nonzero(p)
    num_states, num_actions, _ = p.shape
    r = np.broadcast_to(r, p.shape)[at]
    return _Listed(num_states, num_actions, s * num_actions + a, s_next, p[at], r)


def _of_other_arrays(probabilities: Any, rewards: Any, first_axis: Any) -> _Listed:
    """The outcomes in what `from_arrays` takes."""
    if first_axis is not None and not (isinstance(first_axis, str) and first_axis in FORMS):
        raise InputError(f"{NAME}: first_axis must be 'state' or 'action', not {shown(first_axis)}")
    if _is_sparse(probabilities):
        if first_axis == "state":
            raise InputError(f"{NAME}: sparse matrices are one for each action, so first_axis is 'action'")
        first_axis, matrices = "action", _matrices("probabilities", probabilities)
        num_states, num_actions = matrices[0].shape[0], len(matrices)
        s, s_next, p = (
            np.concatenate([getattr(m.tocoo(), column) for m in matrices])
            for column in ("row", "col", "data")
        )
        a = np.repeat(np.arange(num_actions), [m.nnz for m in matrices])
        order = np.lexsort((s_next, a, s))
        s, a, s_next, p = s[order].astype(np.int64), a[order], s_next[order].astype(np.int64), p[order]
    else:
        dense = numbers(NAME, "probabilities", probabilities)
        first_axis = _first_axis(dense.shape, first_axis)
        dense = dense.swapaxes(0, 1) if first_axis == "action" else dense
        num_states, num_actions, _ = dense.shape
        s, a, s_next = at = np.nonzero(dense)
        p = dense[at]
    r = _rewards_at((s, a, s_next), (num_states, num_actions), rewards, first_axis)
    row = s * num_actions + a
    return _Listed(num_states, num_actions, row, s_next, p.astype(np.float64), r.astype(np.float64))


def _first_axis(shape: tuple[int, ...], said: str | None) -> str:
    """Which axis is the first of probabilities with this shape, "state" or "action"."""
    squares = {"state": shape[::2], "action": shape[1:]} if len(shape) == 3 and 0 not in shape else {}
    asked = FORMS if said is None else {said: FORMS[said]}
    possible = [axis for axis in asked if len({*squares.get(axis, (1, 2))}) == 1]
    wanted = " or ".join(asked.values())
    if not possible:
        hint = PAIRS if len(shape) == 2 else ""
        raise InputError(f"{NAME}: probabilities must have shape {wanted}, not {shape}{hint}")
    if len(possible) > 1:
        raise InputError(
            f"{NAME}: probabilities of shape {shape} may be {wanted}; say first_axis='state' or first_axis='action'"
        )
    return possible[0]


def _rewards_at(
    at: tuple[np.ndarray, np.ndarray, np.ndarray], size: tuple[int, int], rewards: Any, first_axis: str
) -> np.ndarray:
    """The rewards [n] of the outcomes `at` (s, a, s'), in what `from_arrays` takes."""
    s, a, s_next = at
    num_states, num_actions = size
    by_action = num_actions, num_states, num_states
    each = by_action if first_axis == "action" else (*size, num_states)
    if _is_sparse(rewards) and not hasattr(rewards, "tocoo"):
        matrices = _matrices("rewards", rewards)
        if (shape := (len(matrices), *matrices[0].shape)) == by_action:
            found = np.zeros(len(s))
            for i, matrix in enumerate(matrices):
                found[a == i] = np.asarray(matrix[s[a == i], s_next[a == i]]).ravel()
            return found
    elif _is_sparse(rewards) and rewards.shape != size:
        shape = rewards.shape
    else:
        r = numbers(NAME, "rewards", rewards.toarray() if _is_sparse(rewards) else rewards)
        shape = r.shape
        for known, index in (((num_states,), s), (size, (s, a))):
            if shape == known:
                return r[index]
        if shape == each:
            return r[(a, s, s_next) if first_axis == "action" else at]
    raise InputError(
        f"{NAME}: rewards must have shape [S] = {(num_states,)}, [S, A] = {size} or {FORMS[first_axis]} = {each}, "
        f"not {shape}"
    )


def _is_sparse(given: Any) -> bool:
    """Whether it is a SciPy sparse matrix, or a list of matrices some of which are."""
    if isinstance(given, np.ndarray) and given.dtype == object:
        given = given.ravel().tolist()
    several = isinstance(given, list | tuple) and any(hasattr(x, "tocoo") for x in given)
    return several or hasattr(given, "tocoo")


def _matrices(what: str, given: Any) -> list[Any]:
    """A list of one matrix [S, S'] for each action as csr_matrix of SciPy."""
    from scipy import sparse  # late, for importing the package is to stay cheap

    wanted = f"{NAME}: sparse {what} must be a list of one matrix [S, S'] for each action"
    if hasattr(given, "tocoo"):
        raise InputError(
            f"{wanted}, not one of shape {given.shape}{PAIRS if what == 'probabilities' else ''}"
        )
    matrices = [x if hasattr(x, "tocoo") else numbers(NAME, what, x) for x in given]
    for a, matrix in enumerate(matrices):
        if (
            matrix.ndim != 2
            or len({*matrix.shape, *matrices[0].shape}) != 1
            or matrix.dtype.kind not in "biuf"
        ):
            raise InputError(f"{wanted}, and that of a = {a} is {_kind(matrix)}")
    return [sparse.csr_matrix(sparse.coo_matrix(matrix)) for matrix in matrices]  # duplicates are added up


def _of_outcomes(states: Sequence[Any], is_terminal: np.ndarray) -> tuple[_Listed, np.ndarray | None]:
    """The outcomes in `states` [S][A], but for terminal states, and their `terminated` where they have it."""
    num_actions, every, count = 0, [], []
    for s, given in enumerate(states):
        actions = _in_order(f"the actions of s = {s}", given)
        num_actions = num_actions if s else len(actions)
        if len(actions) != num_actions:
            raise InputError(
                f"{NAME}: s = {s} has {len(actions)} actions, and s = 0 has {num_actions}; "
                "all states must have the same number"
            )
        for a, found in enumerate(actions):
            found = () if is_terminal[s] else found
            if not _is_list(found):
                raise InputError(
                    f"{NAME}: outcomes after (s, a) = {(s, a)} must be a list, not {shown(found)}"
                )
            every.extend(found)
            count.append(len(found))
    row = np.repeat(np.arange(len(count)), count)
    listed = _Listed(len(states), num_actions, row, row, *np.zeros((2, len(row))))
    for i, outcome in enumerate(every):
        if not _is_list(outcome) or len(outcome) not in (3, 4):
            hint = "; FiniteMDP(probabilities, rewards) takes arrays" if np.ndim(every[0]) == 0 else ""
            raise InputError(
                f"{NAME}: an outcome {listed.after(i)} must be (p, s', reward) or (p, s', reward, terminated), "
                f"not {shown(outcome)}{hint}"
            )
        if len(outcome) != len(every[0]):
            raise InputError(
                f"{NAME}: an outcome {listed.after(i)} has {len(outcome)} entries, and the first one has "
                f"{len(every[0])}; all or none must say whether they are terminated"
            )
    if not every:
        return listed, None
    prob, s_next, reward, *ends = zip(*every, strict=True)
    prob = _column(listed, "the probability of an outcome", prob, "a number")
    entered = _column(listed, "s' of an outcome", s_next, "the number of a state", _are_no_states)
    reward = _column(listed, "the reward", reward, "a number")
    if (at := first((entered < 0) | (entered >= len(states)))) is not None:
        raise InputError(
            f"{NAME}: there is no state {s_next[at[0]]}, an outcome {listed.after(at[0])}; "
            f"states are 0 to {len(states) - 1}"
        )
    listed = listed._replace(prob=prob.astype(float), s_next=entered.astype(int), reward=reward.astype(float))
    ends = [_column(listed, "terminated", x, "True or False", _are_no_flags) for x in ends]
    return listed, ends[0] == 1 if ends else None


def _column(
    listed: _Listed, what: str, given: Sequence[Any], right: str, are_wrong: Any = None
) -> np.ndarray:
    """What stands in one place of all outcomes, as numbers [n]."""
    array = _as_numbers(given)
    if array is None:
        wrong = (next(i for i, x in enumerate(given) if _as_numbers([x]) is None),)
    elif are_wrong is None or (wrong := first(are_wrong(given, array))) is None:
        return array
    raise InputError(f"{NAME}: {what} {listed.after(wrong[0])} must be {right}, not {shown(given[wrong[0]])}")


def _as_numbers(given: Sequence[Any]) -> np.ndarray | None:
    """`given` as an array [n] of numbers, or None where it is none."""
    try:
        array = np.asarray(given)
    except ValueError:  # of several shapes
        return None
    return array if array.ndim == 1 and array.dtype.kind in "biuf" else None


def _are_no_states(given: Sequence[Any], array: np.ndarray) -> np.ndarray:
    is_bool = np.array([isinstance(x, bool | np.bool_) for x in given])
    return is_bool | (np.floor(array.astype(float)) != array)


def _are_no_flags(given: Sequence[Any], array: np.ndarray) -> np.ndarray:
    return (array != 0) & (array != 1)


def _in_order(what: str, given: Any) -> Sequence[Any]:
    """A list; or what a dict has for 0, 1, 2 ..., in this order."""
    if isinstance(given, Mapping):
        if all(is_whole(key, 0) for key in given) and sorted(given) == list(range(len(given))):
            return [given[i] for i in range(len(given))]
        raise InputError(f"{NAME}: {what} must have the keys 0 to {len(given) - 1}, not {shown([*given])}")
    if _is_list(given):
        return given
    hint = ""
    if hasattr(given, "unwrapped"):
        hint = "; rl.interop.from_gymnasium takes an environment of Gymnasium"
    if hasattr(given, "tocoo"):
        hint = "; FiniteMDP.from_arrays takes sparse matrices"
    raise InputError(
        f"{NAME}: {what} must be a list, or a dict with the keys 0, 1, 2 ..., not {shown(given)}{hint}"
    )


def _is_list(given: Any) -> bool:
    if isinstance(given, np.ndarray):
        return given.ndim > 0
    return isinstance(given, Sequence) and not isinstance(given, str | bytes)


def _ended(
    listed: _Listed, ends: np.ndarray, is_terminal: np.ndarray, start_prob: np.ndarray
) -> tuple[_Listed, np.ndarray, np.ndarray]:
    """All of it where the outcomes of `ends` enter terminal states, which may get second numbers for that."""
    ends = ends | is_terminal[listed.s_next]
    source = listed.row // listed.num_actions
    on = (listed.prob > 0) & ~ends
    goes_on = _reached(listed.num_states, source[on], listed.s_next[on], start_prob > 0)
    is_end = is_terminal.copy()
    is_end[listed.s_next[(listed.prob > 0) & ends & goes_on[source]]] = True
    twice = np.flatnonzero(is_end & goes_on)
    number = np.arange(listed.num_states)
    number[twice] = listed.num_states + np.arange(len(twice))
    listed = listed._replace(
        num_states=listed.num_states + len(twice), s_next=np.where(ends, number[listed.s_next], listed.s_next)
    )
    more = np.zeros(len(twice))
    return listed, np.append(is_end & ~goes_on, more == 0), np.append(start_prob, more)


# --- checks ------------------------------------------------------------------------------------------


def _terminal(terminal: Any, num_states: int) -> np.ndarray:
    given = numbers(NAME, "terminal", terminal)
    if given.dtype == bool and given.shape == (num_states,):
        return given.copy()
    if given.ndim != 1 or (given.dtype.kind not in "iu" and given.size):
        raise InputError(
            f"{NAME}: terminal must be a list of states, or True or False for each of the {num_states} "
            f"states, not {_kind(given)}"
        )
    states = given.astype(np.int64)
    _check_states("terminal state", states, num_states)
    seen, count = np.unique(states, return_counts=True)
    if (twice := seen[count > 1]).size:
        raise InputError(
            f"{NAME}: terminal has state {twice[0]} more than once; give a list of states, "
            "or True or False for each state"
        )
    return np.isin(np.arange(num_states), states)


def _start(start: Any, is_terminal: np.ndarray) -> np.ndarray:
    """The distribution of the start state, float64 [S]."""
    given, num_states = numbers(NAME, "start", start), len(is_terminal)
    if given.ndim == 0 and given.dtype.kind in "iu":
        _check_states("start state", given[None], num_states)
        prob = (np.arange(num_states) == given).astype(np.float64)
    elif given.shape == (num_states,):
        prob = given.astype(np.float64)
    else:
        raise InputError(
            f"{NAME}: start must be a state or the probabilities of the {num_states} states, "
            f"not {_kind(given)}"
        )
    if (s := first(~((prob >= 0) & np.isfinite(prob)))) is not None:
        raise InputError(f"{NAME}: the start probability of s = {s[0]} is {prob[s]}, not from 0 to 1")
    if abs(prob.sum() - 1) > TOLERANCE:
        raise InputError(f"{NAME}: the start distribution adds up to {prob.sum():.6g}, not to 1")
    if (s := first((prob > 0) & is_terminal)) is not None:
        raise InputError(f"{NAME}: episodes may start in s = {s[0]}, which is terminal")
    return prob / prob.sum()


def _check_outcomes(listed: _Listed) -> None:
    """Raises InputError unless they are distributions, with finite rewards of what can happen."""
    p, r = listed.prob, listed.reward
    if (at := first(~((p >= 0) & np.isfinite(p)))) is not None:
        raise InputError(
            f"{NAME}: the probability of s' = {listed.s_next[at]} {listed.after(*at)} is {p[at]}, not from 0 to 1"
        )
    total = np.bincount(listed.row, p, listed.num_states * listed.num_actions)
    if (at := first(abs(total - 1) > TOLERANCE)) is not None:
        where = f"after (s, a) = {divmod(at[0], listed.num_actions)}"
        raise InputError(f"{NAME}: the probabilities {where} add up to {total[at]:.6g}, not to 1")
    if (at := first((p > 0) & ~np.isfinite(r))) is not None:
        hint = (
            "; an action that a state does not have can be a copy of one that it has"
            if r[at] == -np.inf
            else ""
        )
        raise InputError(f"{NAME}: the reward {listed.after(*at)} is {r[at]}, not a finite number{hint}")


def _check_reachable(listed: _Listed, is_terminal: np.ndarray, start_prob: np.ndarray) -> None:
    """Raises InputError where a terminal state exists and some start state cannot reach any."""
    source = listed.row // listed.num_actions
    ends = _reached(listed.num_states, listed.s_next, source, is_terminal)
    if is_terminal.any() and (s := first((start_prob > 0) & ~ends)) is not None:
        raise InputError(
            f"{NAME}: no terminal state can be reached from start state s = {s[0]}; "
            "a task that is meant to go on for ever has no terminal states"
        )


def _check_states(what: str, states: np.ndarray, num_states: int) -> None:
    if (i := first((states < 0) | (states >= num_states))) is not None:
        raise InputError(f"{NAME}: there is no {what} {states[i]}; states are 0 to {num_states - 1}")


def _kind(array: Any) -> str:
    return f"{array.dtype} of shape {array.shape}"
