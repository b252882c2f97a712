"""What may happen in a finite MDP, read from arrays, sparse matrices and tables of outcomes; see `FiniteMDP`."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core.checks import first, foreign, is_list, numbers
from jaxrl_tab.core.errors import InputError, is_whole, shown

NAME = "FiniteMDP"
refusal = functools.partial(InputError, who=NAME)  # the error of what people gave for it
FORMS = {"state": "[S, A, S']", "action": "[A, S, S']"}  # of probabilities, by their first axis
PAIRS = "; ddp.to_product_form() of QuantEcon turns pairs of states and actions into [S, A, S']"


class Listed(NamedTuple):
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

    def of(self, chosen: np.ndarray) -> "Listed":
        """The outcomes at these places, or where this mask is true, in that order."""
        return Listed(*self[:2], *(column[chosen] for column in self[2:]))


def _probabilities(probabilities: Any, rewards: Any) -> np.ndarray:
    """p [S, A, S'] as the class takes it."""
    rule = "probabilities must be an array [S, A, S']"
    if is_sparse(probabilities):
        raise refusal(f"{rule}; FiniteMDP.from_arrays takes sparse matrices, one [S, S'] for each action")
    _check_is_array(probabilities, rewards)
    p = numbers(NAME, "probabilities", probabilities).astype(np.float64)
    if p.ndim == 3 and p.shape[0] == p.shape[2] and p.size > 0:
        return p
    hint = _hint(p, rewards)
    if p.ndim == 3 and p.shape[1] == p.shape[2]:
        hint = "; FiniteMDP.from_arrays takes [A, S, S'], and the rewards that belong to it"
    raise refusal(f"probabilities must have shape [S, A, S'], not {p.shape}{hint}")


def _check_is_array(probabilities: Any, rewards: Any) -> None:
    """Raises InputError where these are a table of outcomes, or an environment, instead of two arrays."""
    hint = foreign(probabilities)
    if isinstance(probabilities, Mapping) or rewards is None:
        hint = hint or "; FiniteMDP.from_outcomes takes tables of outcomes"
    if hint:
        raise refusal(f"probabilities must be an array, with rewards beside it{hint}")


def _hint(p: np.ndarray, rewards: Any) -> str:
    """What is wrong with probabilities that have not three axes."""
    if p.ndim == 2:
        return ": they come first, and then the rewards" if getattr(rewards, "ndim", 0) == 3 else PAIRS
    return "; FiniteMDP.from_outcomes takes lists of outcomes" if p.ndim == 4 else ""


def _rewards(rewards: Any, shape: tuple[int, ...]) -> np.ndarray:
    """r [S, A, 1 or S'] as the class takes it."""
    rule = f"rewards must have shape [S, A] = {shape[:2]} or [S, A, S'] = {shape}"
    if is_sparse(rewards):
        raise refusal(f"{rule}; FiniteMDP.from_arrays takes sparse ones")
    r = numbers(NAME, "rewards", rewards).astype(np.float64)
    if r.shape in (shape[:2], shape):
        return r.reshape(*shape[:2], -1)
    hint = ""
    if r.shape == shape[:1]:
        hint = "; FiniteMDP.from_arrays takes [S]"
    elif r.shape in ((shape[1], shape[0]), (shape[1], shape[0], shape[0])):
        hint = "; np.swapaxes(rewards, 0, 1) turns it into one of them"
    raise refusal(f"{rule}, not {r.shape}{hint}")


def of_arrays(probabilities: Any, rewards: Any) -> Listed:
    """The outcomes in arrays as `FiniteMDP` takes them."""
    p = _probabilities(probabilities, rewards)
    r = np.broadcast_to(_rewards(rewards, p.shape), p.shape)
    num_states, num_actions, _ = p.shape
    s, a, s_next = at = np.nonzero(p)
    return Listed(num_states, num_actions, s * num_actions + a, s_next, p[at], r[at])


def of_other_arrays(probabilities: Any, rewards: Any, first_axis: Any) -> Listed:
    """The outcomes in what `from_arrays` takes."""
    if first_axis is not None and not (isinstance(first_axis, str) and first_axis in FORMS):
        raise refusal(f"first_axis must be 'state' or 'action', not {shown(first_axis)}")
    if is_sparse(probabilities):
        if first_axis == "state":
            raise refusal("sparse matrices are one for each action, so first_axis is 'action'")
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
        _check_is_array(probabilities, rewards)
        dense = numbers(NAME, "probabilities", probabilities)
        first_axis = _first_axis(dense.shape, first_axis, _hint(dense, rewards))
        dense = dense.swapaxes(0, 1) if first_axis == "action" else dense
        num_states, num_actions, _ = dense.shape
        s, a, s_next = at = np.nonzero(dense)
        p = dense[at]
    r = _rewards_at((s, a, s_next), (num_states, num_actions), rewards, first_axis)
    row = s * num_actions + a
    return Listed(num_states, num_actions, row, s_next, p.astype(np.float64), r.astype(np.float64))


def _first_axis(shape: tuple[int, ...], first_axis: str | None, hint: str) -> str:
    """Which axis is the first of probabilities with this shape, "state" or "action"."""
    squares = {"state": shape[::2], "action": shape[1:]} if len(shape) == 3 and 0 not in shape else {}
    candidates = FORMS if first_axis is None else {first_axis: FORMS[first_axis]}
    possible = [axis for axis in candidates if len({*squares.get(axis, (1, 2))}) == 1]
    forms = " or ".join(candidates.values())
    if not possible:
        raise refusal(f"probabilities must have shape {forms}, not {shape}{hint}")
    if len(possible) > 1:
        raise refusal(
            f"probabilities of shape {shape} may be {forms}; say first_axis='state' or first_axis='action'"
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
    if is_sparse(rewards) and not hasattr(rewards, "tocoo"):
        matrices = _matrices("rewards", rewards)
        if (shape := (len(matrices), *matrices[0].shape)) == by_action:
            r = np.zeros(len(s))
            for i, matrix in enumerate(matrices):
                r[a == i] = np.asarray(matrix[s[a == i], s_next[a == i]]).ravel()
            return r
    elif is_sparse(rewards) and rewards.shape != size:
        shape = rewards.shape
    else:
        r = numbers(NAME, "rewards", rewards.toarray() if is_sparse(rewards) else rewards)
        shape = r.shape
        for form, index in (((num_states,), s), (size, (s, a))):
            if shape == form:
                return r[index]
        if shape == each:
            return r[(a, s, s_next) if first_axis == "action" else at]
    raise refusal(
        f"rewards must have shape [S] = {(num_states,)}, [S, A] = {size} or {FORMS[first_axis]} = {each}, "
        f"not {shape}"
    )


def is_sparse(matrices: Any) -> bool:
    """Whether it is a SciPy sparse matrix, or a list of matrices some of which are."""
    if isinstance(matrices, np.ndarray) and matrices.dtype == object:
        matrices = matrices.ravel().tolist()
    several = isinstance(matrices, list | tuple) and any(hasattr(x, "tocoo") for x in matrices)
    return several or hasattr(matrices, "tocoo")


def _matrices(what: str, several: Any) -> list[Any]:
    """A list of one matrix [S, S'] for each action as csr_matrix of SciPy."""
    from scipy import sparse  # here, so that importing the package stays cheap

    rule = f"sparse {what} must be a list of one matrix [S, S'] for each action"
    if hasattr(several, "tocoo"):
        raise refusal(f"{rule}, not one of shape {several.shape}{PAIRS if what == 'probabilities' else ''}")
    matrices = [x if hasattr(x, "tocoo") else numbers(NAME, what, x) for x in several]
    for a, matrix in enumerate(matrices):
        if (
            matrix.ndim != 2
            or len({*matrix.shape, *matrices[0].shape}) != 1
            or matrix.dtype.kind not in "biuf"
        ):
            raise refusal(f"{rule}, and that of a = {a} is {kind(matrix)}")
    return [sparse.csr_matrix(sparse.coo_matrix(matrix)) for matrix in matrices]  # duplicates are added up


def of_outcomes(
    states: Sequence[Any] | np.ndarray, is_terminal: np.ndarray
) -> tuple[Listed, np.ndarray | None]:
    """The outcomes in `states` [S][A], but for terminal states, and their `terminated` where they have it."""
    num_actions, every, count = 0, [], []
    for s, of_state in enumerate(states):
        actions = in_order(f"the actions of s = {s}", of_state)
        num_actions = num_actions if s else len(actions)
        if len(actions) != num_actions:
            raise refusal(
                f"s = {s} has {len(actions)} actions, and s = 0 has {num_actions}; "
                "all states must have the same number"
            )
        for a, outcomes in enumerate(actions):
            outcomes = () if is_terminal[s] else outcomes
            if not is_list(outcomes):
                raise refusal(f"outcomes after (s, a) = {(s, a)} must be a list, not {shown(outcomes)}")
            every.extend(outcomes)
            count.append(len(outcomes))
    row = np.repeat(np.arange(len(count)), count)
    listed = Listed(len(states), num_actions, row, row, *np.zeros((2, len(row))))
    for i, outcome in enumerate(every):
        if not is_list(outcome) or len(outcome) not in (3, 4):
            hint = (
                "; FiniteMDP(probabilities, rewards) takes arrays"
                if _as_numbers([every[0]]) is not None
                else ""
            )
            raise refusal(
                f"an outcome {listed.after(i)} must be (p, s', reward) or (p, s', reward, terminated), "
                f"not {shown(outcome)}{hint}"
            )
        if len(outcome) != len(every[0]):
            raise refusal(
                f"an outcome {listed.after(i)} has {len(outcome)} entries, and the first one has "
                f"{len(every[0])}; all or none must say whether they are terminated"
            )
    if not every:
        return listed, None
    prob, s_next, reward, *ends = zip(*every, strict=True)
    prob = _column(listed, "the probability of an outcome", prob, "a number")
    entered = _column(listed, "s' of an outcome", s_next, "the number of a state", _are_no_states)
    reward = _column(listed, "the reward", reward, "a number")
    if (at := first((entered < 0) | (entered >= len(states)))) is not None:
        raise refusal(
            f"there is no state {s_next[at[0]]}, an outcome {listed.after(at[0])}; "
            f"states are 0 to {len(states) - 1}"
        )
    listed = listed._replace(prob=prob.astype(float), s_next=entered.astype(int), reward=reward.astype(float))
    ends = [_column(listed, "terminated", x, "True or False", _are_no_flags) for x in ends]
    return listed, ends[0] == 1 if ends else None


def _column(
    listed: Listed, what: str, column: Sequence[Any], right: str, are_wrong: Any = None
) -> np.ndarray:
    """One entry of all outcomes, such as their probabilities, as numbers [n]."""
    array = _as_numbers(column)
    if array is None:
        wrong = (next(i for i, x in enumerate(column) if _as_numbers([x]) is None),)
    elif are_wrong is None or (wrong := first(are_wrong(column, array))) is None:
        return array
    raise refusal(f"{what} {listed.after(wrong[0])} must be {right}, not {shown(column[wrong[0]])}")


def _as_numbers(column: Sequence[Any]) -> np.ndarray | None:
    """`column` as an array [n] of numbers, or None where it is none."""
    try:
        array = np.asarray(column)
    except ValueError:  # of several shapes
        return None
    return array if array.ndim == 1 and array.dtype.kind in "biuf" else None


def _are_no_states(column: Sequence[Any], array: np.ndarray) -> np.ndarray:
    is_bool = np.array([isinstance(x, bool | np.bool_) for x in column])
    return is_bool | (np.floor(array.astype(float)) != array)


def _are_no_flags(column: Sequence[Any], array: np.ndarray) -> np.ndarray:
    return (array != 0) & (array != 1)


def in_order(what: str, listing: Any) -> Sequence[Any] | np.ndarray:
    """A list; or what a dict has for 0, 1, 2 ..., in this order."""
    if isinstance(listing, Mapping):
        if (odd := next((key for key in listing if not is_whole(key, 0)), None)) is not None:
            raise refusal(f"the keys of {what} must be whole numbers, not {shown(odd)}")
        if (gap := next((i for i in range(len(listing)) if i not in listing), None)) is not None:
            raise refusal(f"the keys of {what} must be 0 to {max(listing)}, and {gap} is missing")
        return [listing[i] for i in range(len(listing))]
    if is_list(listing):
        return listing
    hint = "; FiniteMDP.from_arrays takes sparse matrices" if is_sparse(listing) else foreign(listing)
    raise refusal(f"{what} must be a list, or a dict with the keys 0, 1, 2 ..., not {shown(listing)}{hint}")


def kind(array: Any) -> str:
    return f"{array.dtype} of shape {array.shape}"
