"""Any finite MDP, from arrays or from lists of outcomes (book, section 3.1)."""

import io
import os
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import TOLERANCE, assign, first, numbers
from jaxrl_tab.core.errors import InputError, as_path, reason, shown, whole
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs import cassandra
from jaxrl_tab.envs.base import MAX_STEPS, Finite
from jaxrl_tab.envs.listed import (
    NAME,
    Listed,
    in_order,
    is_sparse,
    kind,
    of_arrays,
    of_other_arrays,
    of_outcomes,
    refusal,
)
from jaxrl_tab.exact.model import spread


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
        discount: the discount rate that the file states from which this was read, if it does; see `load`.

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
    discount: float | None = static(default=None)

    def __init__(
        self,
        probabilities: Any,
        rewards: Any = None,
        terminal: Any = (),
        start: Any = 0,
        max_steps: int = MAX_STEPS,
    ):
        listed = of_arrays(probabilities, rewards)
        is_terminal = _terminal(terminal, listed.num_states)
        assign(self, **_fields(listed, is_terminal, _start(start, is_terminal), max_steps))

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
        listed = of_other_arrays(probabilities, rewards, first_axis)
        is_terminal = _terminal(terminal, listed.num_states)
        return _made(cls, _fields(listed, is_terminal, _start(start, is_terminal), max_steps))

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
        if is_sparse(outcomes) or (isinstance(outcomes, np.ndarray) and outcomes.ndim == 3):
            raise refusal(
                "outcomes must be lists of (p, s', reward); FiniteMDP.from_arrays takes arrays and matrices"
            )
        states = in_order("outcomes", outcomes)
        if not len(states) or not len(in_order("the actions of s = 0", states[0])):
            raise refusal("outcomes must be a list of states, each a list of actions with outcomes")
        is_terminal = _terminal(terminal, len(states))
        start_prob = _start(start, is_terminal)
        listed, ends = of_outcomes(states, is_terminal)
        if ends is not None:
            listed, is_terminal, start_prob = _ended(listed, ends, is_terminal, start_prob)
        return _made(cls, _fields(listed, is_terminal, start_prob, max_steps))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the table to a file, whose name ends in ".npz" and stands for it wherever an environment is named.

        Raises:
            InputError: the name ends otherwise, or this is a batch.
        """
        path = as_path("the file of a table", path)
        if path.suffix != ".npz":
            raise refusal(f"the name of the file must end in .npz, not {shown(str(path))}")
        path.write_bytes(self.to_bytes())

    def to_bytes(self) -> bytes:
        """What `save` writes."""
        if np.ndim(self.successors) != 3:
            raise refusal("a batch of environments cannot be saved; save them one by one")
        content = io.BytesIO()
        names = [*_SAVED, *(["discount"] if self.discount is not None else [])]
        arrays: dict[str, Any] = {name: np.asarray(getattr(self, name)) for name in names}
        np.savez(content, **arrays)
        return content.getvalue()

    @classmethod
    def load(cls, path: str | os.PathLike[str], data: bytes | None = None) -> "FiniteMDP":
        """The table that `save` wrote, or one in Cassandra's format: a file whose name ends in .MDP or .POMDP.

        A POMDP is read as its MDP, whose states are seen; rewards are averaged over what is observed. States and
        actions are numbered as the file has them. A state that all actions lead back to for nothing, and in which no
        episode starts, is terminal, if one can come to such a state from every start. (Their values are the same; for
        learning it matters.) The file's discount rate is kept as `discount`, and nothing uses it: gamma belongs to the
        method.

        Args:
            path: of the file.
            data: its content, where it was read already.

        Raises:
            InputError: there is no such file, or it holds no such table; the message names the line of a text.
        """
        path = as_path("the file of a table", path)
        try:
            content = data if data is not None else path.read_bytes()
        except OSError as error:
            raise InputError(f"{path} cannot be read: {reason(error)}") from None
        if cassandra.is_name(path.name):
            read = cassandra.read(str(path), content)
            fields = _fields(read.outcomes, read.is_terminal, read.start, MAX_STEPS)
            return _made(FiniteMDP, fields | {"discount": read.discount})
        try:
            with np.load(io.BytesIO(content)) as arrays:
                saved = {name: arrays[name] for name in _SAVED}
                discount = float(arrays["discount"]) if "discount" in arrays else None
        except Exception as error:  # there is no end to what zipfile and NumPy raise where a file is damaged
            raise InputError(f"{path} is not a table that FiniteMDP.save wrote: {reason(error)}") from None
        try:
            _check_saved(saved)
        except InputError as error:
            raise InputError(f"{path} is not a table that FiniteMDP.save wrote: {error}") from None
        return _made(FiniteMDP, saved | {"max_steps": int(saved["max_steps"]), "discount": discount})

    @property
    def num_states(self) -> int:
        return self.successors.shape[-3]  # from the right: a stack of environments has axes before it

    @property
    def num_actions(self) -> int:
        return self.successors.shape[-2]

    @property
    def continuing(self) -> bool:
        """Whether no state is terminal; False inside a compiled program, which does not look."""
        return isinstance(self.is_terminal, np.ndarray) and not self.is_terminal.any()

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


def drawn(successors: Any, prob: Any, reward: Any, max_steps: int) -> FiniteMDP:
    """A task that goes on for ever from state 0, of these arrays [S, A, K], traced ones as well; nothing is checked."""
    fields = {
        "successors": successors,
        "prob": prob,
        "reward": reward,
        "max_steps": max_steps,
        "discount": None,
    }
    start = {"start_states": np.zeros(1, np.int32), "start_prob": np.ones(1)}
    return _made(FiniteMDP, fields | start | {"is_terminal": np.zeros(len(successors), bool)})


def _made(cls: type[FiniteMDP], fields: Mapping[str, Any]) -> FiniteMDP:
    """An instance with these fields; `__init__` takes other arguments."""
    mdp = object.__new__(cls)
    assign(mdp, **fields)
    return mdp


def _fields(listed: Listed, is_terminal: Any, start_prob: Any, max_steps: Any) -> dict[str, Any]:
    """The fields of the task whose outcomes are listed, after all checks of these."""
    listed = _absorbed(listed, is_terminal)
    _check_outcomes(listed)
    listed = _added_up(listed.of(listed.prob > 0))
    _check_reachable(listed, is_terminal, start_prob)
    shape = listed.num_states, listed.num_actions, -1
    count = np.bincount(listed.row, minlength=listed.num_states * listed.num_actions)
    # Outcomes of one (s, a) follow one another, so a place in its row of K is that after the row's first.
    at = listed.row, np.arange(len(listed.row)) - (np.cumsum(count) - count)[listed.row]
    successors = _fillers(listed, count)
    prob, reward = np.zeros(successors.shape), np.zeros(successors.shape)
    total = np.bincount(listed.row, listed.prob)[listed.row]
    successors[at], prob[at], reward[at] = listed.s_next, listed.prob / total, listed.reward
    start_states = np.flatnonzero(start_prob)
    return {
        "discount": None,
        "successors": successors.reshape(shape).astype(np.int32),
        "prob": prob.reshape(shape),
        "reward": reward.reshape(shape),
        "is_terminal": is_terminal,
        "start_states": start_states.astype(np.int32),
        "start_prob": start_prob[start_states],
        "max_steps": whole(NAME, "max_steps", max_steps),
    }


def _absorbed(listed: Listed, is_terminal: np.ndarray) -> Listed:
    """`listed`, where terminal states lead to themselves with reward 0, whatever was listed after them."""
    actions = np.arange(listed.num_actions)
    kept = listed.of(~is_terminal[listed.row // listed.num_actions])
    ends = np.flatnonzero(is_terminal)
    rows = (ends[:, None] * listed.num_actions + actions).ravel()
    s_next = np.repeat(ends, listed.num_actions)
    more = rows, s_next, np.ones(len(rows)), np.zeros(len(rows))
    columns = map(np.concatenate, zip(kept[2:], more, strict=True))
    every = Listed(*listed[:2], *columns)
    return every.of(np.argsort(every.row, kind="stable"))


def _added_up(listed: Listed) -> Listed:
    """`listed`, where outcomes of one (s, a), s' and reward are one, in the place of the first."""
    if (np.diff(listed.row * listed.num_states + listed.s_next) > 0).all():
        return listed  # strictly rising, as from arrays: there is nothing to add up
    order = np.lexsort((listed.reward, listed.s_next, listed.row))  # sorted by the last key first
    alike = listed.of(order)
    keys = np.stack([alike.row, alike.s_next, alike.reward])
    is_new = np.append(True, (np.diff(keys) != 0).any(axis=0))
    total = np.bincount(np.cumsum(is_new) - 1, alike.prob)
    firsts = order[is_new]  # the sort is stable, so it is the first of those that are alike
    place = np.argsort(firsts)
    return listed.of(firsts[place])._replace(prob=total[place])


def _fillers(listed: Listed, count: np.ndarray) -> np.ndarray:
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


def _ended(
    listed: Listed, ends: np.ndarray, is_terminal: np.ndarray, start_prob: np.ndarray
) -> tuple[Listed, np.ndarray, np.ndarray]:
    """The outcomes, the terminal states and the start, where those outcomes that are `ends` enter terminal states.

    A state that is entered in both ways gets a second number for being terminal.
    """
    ends = ends | is_terminal[listed.s_next]
    source = listed.row // listed.num_actions
    continues = (listed.prob > 0) & ~ends
    goes_on = spread(source[continues], listed.s_next[continues], start_prob > 0)
    is_end = is_terminal.copy()
    is_end[listed.s_next[(listed.prob > 0) & ends & goes_on[source]]] = True
    both_ways = np.flatnonzero(is_end & goes_on)
    number = np.arange(listed.num_states)
    number[both_ways] = listed.num_states + np.arange(len(both_ways))
    listed = listed._replace(
        num_states=listed.num_states + len(both_ways),
        s_next=np.where(ends, number[listed.s_next], listed.s_next),
    )
    more = np.zeros(len(both_ways))  # the second numbers: terminal, and never the start
    return listed, np.append(is_end & ~goes_on, more == 0), np.append(start_prob, more)


# --- checks ------------------------------------------------------------------------------------------


_SAVED = {  # what is in a file: the kind of the numbers, and the axes
    "successors": ("i", "SAK"),
    "prob": ("f", "SAK"),
    "reward": ("f", "SAK"),
    "is_terminal": ("b", "S"),
    "start_states": ("i", "M"),
    "start_prob": ("f", "M"),
    "max_steps": ("i", ""),
}


def _check_saved(saved: Mapping[str, np.ndarray]) -> None:
    """Raises InputError unless these arrays are the fields of a `FiniteMDP`."""
    sizes: dict[str, int] = {}
    for name, (numbers_of, axes) in _SAVED.items():
        shape = saved[name].shape
        fits = len(shape) == len(axes) and all(
            sizes.setdefault(axis, n) == n > 0 for axis, n in zip(axes, shape, strict=True)
        )
        if saved[name].dtype.kind != numbers_of or not fits:
            raise refusal(f"{name} has the shape {shape} and the type {saved[name].dtype}")
    successors, prob = saved["successors"], saved["prob"]
    _check_states("successor", successors.ravel(), sizes["S"])
    _check_states("start state", saved["start_states"], sizes["S"])
    row = np.repeat(np.arange(sizes["S"] * sizes["A"]), sizes["K"])
    columns = successors.ravel(), prob.ravel(), saved["reward"].ravel()
    _check_outcomes(Listed(sizes["S"], sizes["A"], row, *columns))
    start = np.zeros(sizes["S"])
    start[saved["start_states"]] = saved["start_prob"]
    _start(start, saved["is_terminal"])
    whole(NAME, "max_steps", saved["max_steps"][()])


def _terminal(terminal: Any, num_states: int) -> np.ndarray:
    array = numbers(NAME, "terminal", terminal)
    if array.dtype == bool and array.shape == (num_states,):
        return array.copy()
    if array.ndim != 1 or (array.dtype.kind not in "iu" and array.size):
        raise refusal(
            f"terminal must be a list of states, or True or False for each of the {num_states} "
            f"states, not {kind(array)}"
        )
    states = array.astype(np.int64)
    _check_states("terminal state", states, num_states)
    seen, count = np.unique(states, return_counts=True)
    if (twice := seen[count > 1]).size:
        raise refusal(
            f"terminal has state {twice[0]} more than once; give a list of states, "
            "or True or False for each state"
        )
    return np.isin(np.arange(num_states), states)


def _start(start: Any, is_terminal: np.ndarray) -> np.ndarray:
    """The distribution of the start state, float64 [S]."""
    array, num_states = numbers(NAME, "start", start), len(is_terminal)
    if array.ndim == 0 and array.dtype.kind in "iu":
        _check_states("start state", array[None], num_states)
        prob = (np.arange(num_states) == array).astype(np.float64)
    elif array.shape == (num_states,):
        prob = array.astype(np.float64)
    else:
        raise refusal(
            f"start must be a state or the probabilities of the {num_states} states, not {kind(array)}"
        )
    if (s := first(~((prob >= 0) & np.isfinite(prob)))) is not None:
        raise refusal(f"the start probability of s = {s[0]} is {prob[s]}, not from 0 to 1")
    if abs(prob.sum() - 1) > TOLERANCE:
        raise refusal(f"the start distribution adds up to {prob.sum():.6g}, not to 1")
    if (s := first((prob > 0) & is_terminal)) is not None:
        raise refusal(f"episodes may start in s = {s[0]}, which is terminal")
    return prob / prob.sum()


def _check_outcomes(listed: Listed) -> None:
    """Raises InputError unless they are distributions, with finite rewards of what can happen."""
    p, r = listed.prob, listed.reward
    if (at := first(~((p >= 0) & np.isfinite(p)))) is not None:
        raise refusal(
            f"the probability of s' = {listed.s_next[at]} {listed.after(*at)} is {p[at]}, not from 0 to 1"
        )
    total = np.bincount(listed.row, p, listed.num_states * listed.num_actions)
    if (at := first(abs(total - 1) > TOLERANCE)) is not None:
        where = f"after (s, a) = {divmod(at[0], listed.num_actions)}"
        raise refusal(f"the probabilities {where} add up to {total[at]:.6g}, not to 1")
    if (at := first((p > 0) & ~np.isfinite(r))) is not None:
        hint = (
            "; an action that a state does not have can be a copy of one that it has"
            if r[at] == -np.inf
            else ""
        )
        raise refusal(f"the reward {listed.after(*at)} is {r[at]}, not a finite number{hint}")


def _check_reachable(listed: Listed, is_terminal: np.ndarray, start_prob: np.ndarray) -> None:
    """Raises InputError where a terminal state exists and some start state cannot reach any."""
    source = listed.row // listed.num_actions
    ends = spread(listed.s_next, source, is_terminal)
    if is_terminal.any() and (s := first((start_prob > 0) & ~ends)) is not None:
        raise refusal(
            f"no terminal state can be reached from start state s = {s[0]}; "
            "a task that is meant to go on for ever has no terminal states"
        )


def _check_states(what: str, states: np.ndarray, num_states: int) -> None:
    if (i := first((states < 0) | (states >= num_states))) is not None:
        raise refusal(f"there is no {what} {states[i]}; states are 0 to {num_states - 1}")
