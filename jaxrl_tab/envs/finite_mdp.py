"""Any finite MDP, from arrays (book, section 3.1)."""

import itertools
from collections.abc import Sequence
from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab import policies
from jaxrl_tab.envs.base import MAX_STEPS, Finite, assign, numbers
from jaxrl_tab.types import TOLERANCE, InputError, Outcome, first, pytree, static, whole

NAME = "FiniteMDP"

# of each state and action the outcomes (probability, s', reward)
Listed: TypeAlias = Sequence[Sequence[Sequence[tuple[float, int, float]]]]


@pytree
class FiniteMDP(Finite):
    """Any finite MDP, from its probabilities and rewards.

    A task without terminal states is allowed: it goes on until its time limit. Of each state and action only
    the successors of positive probability are kept, K at most, so an outcome is a row of K and not of S.
    Environments of equal S, A, K and M can be stacked, leaf by leaf, and batched by `vmap`.

    Args:
        probabilities: p(s' | s, a), [S, A, S']; each row adds up to 1 (within 1e-6; it is then rescaled).
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
        self, probabilities: Any, rewards: Any, terminal: Any = (), start: Any = 0, max_steps: int = MAX_STEPS
    ):
        p = _probabilities(probabilities)
        r = _rewards(rewards, p.shape)
        is_terminal = _terminal(terminal, len(p))
        p[is_terminal] = np.eye(len(p))[is_terminal, None]
        r[is_terminal] = 0
        _check_rows(p, r)
        start_prob = _start(start, is_terminal)
        possible = p > 0

        k = np.arange(possible.sum(axis=-1).max())
        successors = np.argsort(~possible, axis=-1, kind="stable")[:, :, k]
        prob = np.take_along_axis(p, successors, axis=-1)
        reward = np.take_along_axis(np.broadcast_to(r, p.shape), successors, axis=-1)
        _fill(self, successors, prob, reward, is_terminal, start_prob, max_steps)

    @classmethod
    def from_outcomes(
        cls, outcomes: Listed, terminal: Any = (), start: Any = 0, max_steps: int = MAX_STEPS
    ) -> "FiniteMDP":
        """Any finite MDP, from the outcomes of each action, `outcomes[s][a] = [(p, s', reward), ...]`.

        No array [S, A, S'] is made, and a state s' may be entered with different rewards: they are kept
        apart. Outcomes of one s' and reward are added up.

        Args:
            outcomes: a list [S] of lists [A] of the outcomes, in any order; their probabilities add up to 1.
            terminal, start, max_steps: as of the class.

        Raises:
            InputError: something given is wrong; the message names the first wrong (s, a) or state.
        """
        num_states, num_actions = len(outcomes), len(outcomes[0]) if outcomes else 0
        is_terminal = _terminal(terminal, num_states)
        merged = np.empty((num_states, num_actions), object)
        for s, actions in enumerate(outcomes):
            if len(actions) != num_actions:
                raise InputError(
                    f"{NAME}: s = {s} has {len(actions)} actions, and s = 0 has {num_actions}; "
                    "all states must have the same number"
                )
            for a, listed in enumerate(actions):
                merged[s, a] = {(s, 0.0): 1.0} if is_terminal[s] else _added_up(listed)
        most = max(map(len, merged.flat), default=0)
        if not most:
            raise InputError(
                f"{NAME}: outcomes must be a list of states, each a list of actions with outcomes"
            )

        prob, reward = np.zeros((2, num_states, num_actions, most))
        successors = np.zeros((num_states, num_actions, most), int)
        for (s, a), found in np.ndenumerate(merged):
            entered = {s_next for s_next, _ in found}
            others = itertools.chain((x for x in range(num_states) if x not in entered), itertools.repeat(s))
            filled = itertools.chain(found.items(), (((x, 0.0), 0.0) for x in others))
            for k, ((s_next, r), p) in enumerate(itertools.islice(filled, most)):
                successors[s, a, k], reward[s, a, k], prob[s, a, k] = s_next, r, p
        if (i := first((successors < 0) | (successors >= num_states))) is not None:
            raise InputError(
                f"{NAME}: there is no state {successors[i]}, an outcome {_after(i)}; "
                f"states are 0 to {num_states - 1}"
            )
        _check_rows(prob, reward, successors)
        mdp = object.__new__(cls)
        _fill(mdp, successors, prob, reward, is_terminal, _start(start, is_terminal), max_steps)
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


def _fill(mdp, successors, prob, reward, is_terminal, start_prob, max_steps) -> None:
    """Sets the fields of `mdp`, from checked arrays [S, A, K] and [S]."""
    _check_reachable(successors, prob, is_terminal, start_prob)
    start_states = np.flatnonzero(start_prob)
    assign(
        mdp,
        successors=successors.astype(np.int32),
        prob=prob / prob.sum(axis=-1, keepdims=True),
        reward=np.where(prob > 0, reward, 0),
        is_terminal=is_terminal,
        start_states=start_states.astype(np.int32),
        start_prob=start_prob[start_states],
        max_steps=whole(NAME, "max_steps", max_steps),
    )


def _added_up(listed: Sequence[tuple[float, int, float]]) -> dict[tuple[int, float], float]:
    """(s', reward) -> probability."""
    total: dict[tuple[int, float], float] = {}
    for p, s_next, r in listed:
        outcome = int(s_next), float(r)
        total[outcome] = total.get(outcome, 0.0) + float(p)
    return total


# --- checks: each returns a fresh array that the constructor may write to ----------------------------


def _probabilities(probabilities: Any) -> np.ndarray:
    p = numbers(NAME, "probabilities", probabilities).astype(np.float64)
    if p.ndim == 3 and p.shape[0] == p.shape[2] and p.size > 0:
        return p
    turned = p.ndim == 3 and p.shape[1] == p.shape[2]
    hint = "; np.swapaxes(probabilities, 0, 1) turns [A, S, S'] into it" if turned else ""
    raise InputError(f"{NAME}: probabilities must have shape [S, A, S'], not {p.shape}{hint}")


def _rewards(rewards: Any, shape: tuple[int, ...]) -> np.ndarray:
    r = numbers(NAME, "rewards", rewards).astype(np.float64)
    if r.shape not in (shape[:2], shape):
        raise InputError(
            f"{NAME}: rewards must have shape [S, A] = {shape[:2]} or [S, A, S'] = {shape}, not {r.shape}"
        )
    return r.reshape(*shape[:2], -1)


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


def _check_rows(p: np.ndarray, r: np.ndarray, successors: np.ndarray | None = None) -> None:
    """Raises InputError unless `p` [S, A, S'] are distributions and `r` [S, A, 1 or S'] finite if p > 0.

    With `successors` [S, A, K] given, `p` and `r` are of these, [S, A, K].
    """
    if (i := first(~((p >= 0) & np.isfinite(p)))) is not None:
        s_next = i[2] if successors is None else successors[i]
        raise InputError(f"{NAME}: the probability of s' = {s_next} {_after(i)} is {p[i]}, not from 0 to 1")
    total = p.sum(axis=-1)
    if (i := first(abs(total - 1) > TOLERANCE)) is not None:
        raise InputError(f"{NAME}: the probabilities {_after(i)} add up to {total[i]:.6g}, not to 1")
    if (i := first((p > 0) & ~np.isfinite(r))) is not None:
        one = np.broadcast_to(r, p.shape)[i]
        raise InputError(f"{NAME}: the reward {_after(i)} is {one}, not a finite number")


def _check_reachable(
    successors: np.ndarray, prob: np.ndarray, is_terminal: np.ndarray, start_prob: np.ndarray
) -> None:
    """Raises InputError where a terminal state exists and some start state cannot reach any."""
    ends = is_terminal
    while (more := ends | ((prob > 0) & ends[successors]).any(axis=(1, 2))).sum() > ends.sum():
        ends = more
    if is_terminal.any() and (s := first((start_prob > 0) & ~ends)) is not None:
        raise InputError(
            f"{NAME}: no terminal state can be reached from start state s = {s[0]}; "
            "a task that is meant to go on for ever has no terminal states"
        )


def _check_states(what: str, states: np.ndarray, num_states: int) -> None:
    if (i := first((states < 0) | (states >= num_states))) is not None:
        raise InputError(f"{NAME}: there is no {what} {states[i]}; states are 0 to {num_states - 1}")


def _after(index: tuple[int, ...]) -> str:
    return f"after (s, a) = ({index[0]}, {index[1]})"


def _kind(array: np.ndarray) -> str:
    return f"{array.dtype} of shape {array.shape}"
