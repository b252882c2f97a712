"""Logged experience: the transitions that somebody recorded, as checked arrays."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int, Num
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import assign, concrete, first, numbers
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Available, Transition

NAME = "Experience"
WHOLE, REAL = ("iu", "whole numbers"), ("iuf", "numbers")  # kinds of dtypes

TRUTH = "b", "booleans, or 0 and 1"
KINDS = {"s": WHOLE, "a": WHOLE, "r": REAL, "s_next": WHOLE, "terminal": TRUTH, "last": TRUTH}


@pytree
class Experience:
    """N transitions (S, A, R, S'), in the order in which they happened.

    Arrays or lists; traced arrays are taken as they are, unchecked.

    Attributes:
        s: S, whole numbers [N].
        a: A, whole numbers [N].
        r: R, finite numbers [N].
        s_next: S', the state before any reset, whole numbers [N].
        terminal: whether S' is terminal, booleans (or 0 and 1) [N]. A time limit makes no state terminal.
        last: where episodes end, booleans [N]: at terminal states; where a time limit, or the end of the log,
            cuts one short. Elsewhere the next transition starts in S'. By default only terminal states and
            the end of the log are. `True` stands for True everywhere: transitions in no order.

    Raises:
        InputError: something is wrong, named with the index of the first wrong transition.
    """

    s: Int[Any, " N"]
    a: Int[Any, " N"]
    r: Num[Any, " N"]
    s_next: Int[Any, " N"]
    terminal: Bool[Any, " N"]
    last: Bool[Any, " N"] | Any = None

    def __post_init__(self):
        values = vars(self) | {"last": _ends(self.terminal) if self.last is None else self.last}
        fields = {
            name: _truth(name, x) if KINDS[name] is TRUTH else numbers(NAME, name, x)
            for name, x in values.items()
        }
        if any(concrete(x) is None for x in fields.values()):
            return
        if fields["last"].ndim == 0:
            fields["last"] = np.full(fields["s"].shape, fields["last"])
        for name, kind in KINDS.items():
            _check_array(name, fields[name], kind, fields["s"].size)
        assign(self, **fields)
        self._check_order()

    def _check_order(self) -> None:
        if (i := first(~np.isfinite(self.r))) is not None:
            raise InputError(f"{NAME}: r[{i[0]}] is {self.r[i]}, not a finite number")
        if (i := first(self.terminal & ~self.last)) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} enters a terminal state, which ends the episode: "
                f"last[{i[0]}] must be True"
            )
        if not self.last[-1]:
            raise InputError(
                f"{NAME}: the last transition must end its episode, if only because the log does: "
                f"last[{len(self.last) - 1}] must be True"
            )
        if (i := first((self.s_next[:-1] != self.s[1:]) & ~self.last[:-1])) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} leads to state {self.s_next[i]}, and transition {i[0] + 1} "
                f"starts in state {self.s[1:][i]}; if an episode was cut short there, last[{i[0]}] must be "
                "True; for transitions in no order give last=True"
            )

    @classmethod
    def from_episodes(
        cls, episodes: Sequence[tuple[Any, Any, Any]], terminal: ArrayLike = True
    ) -> "Experience":
        """The experience of E episodes S_0, A_0, R_1, S_1, A_1, R_2, ..., S_T.

        Args:
            episodes: of each the states S_0 to S_T, whole numbers [T + 1]; the actions A_0 to A_{T-1}, whole
                numbers [T]; and the rewards R_1 to R_T, [T]. T may differ, and is at least 1.
            terminal: whether S_T is terminal, for each episode or for all; if not, it was cut short.

        Raises:
            InputError: as `Experience`; the message names the first wrong episode.
        """
        try:
            episodes = list(episodes)
        except TypeError:
            raise InputError(
                f"{NAME}: episodes must be a list of (states, actions, rewards), not {shown(episodes)}"
            ) from None
        if not episodes:
            raise InputError(f"{NAME}: there must be at least one episode")
        columns = []
        for e, episode in enumerate(episodes):
            try:
                s, a, r = episode
            except (TypeError, ValueError):
                raise InputError(
                    f"{NAME}: episode {e} must be (states, actions, rewards), not {shown(episode)}"
                ) from None
            arrays = {"s": s, "a": a, "r": r}
            s, a, r = (numbers(NAME, f"{name} of episode {e}", x) for name, x in arrays.items())
            if a.ndim != 1 or not len(a) or r.shape != a.shape or s.shape != (len(a) + 1,):
                raise InputError(
                    f"{NAME}: episode {e} must have T actions, T rewards and T + 1 states, the last one "
                    f"included, for a T of at least 1; not arrays of shape {a.shape}, {r.shape} and {s.shape}"
                )
            columns.append((s[:-1], a, r, s[1:], np.arange(len(a)) == len(a) - 1))
        s, a, r, s_next, last = map(np.concatenate, zip(*columns, strict=True))
        return cls(s, a, r, s_next, _terminal_ends(terminal, last), last)

    @classmethod
    def from_padded(cls, s: Any, a: Any, r: Any, lengths: Any, terminal: ArrayLike = True) -> "Experience":
        """The experience of E episodes in arrays as long as the longest of them.

        Args:
            s: the states S_0 to S_T of each episode, whole numbers [E, T_max + 1]; then anything.
            a: the actions A_0 to A_{T-1}, whole numbers [E, T_max].
            r: the rewards R_1 to R_T, [E, T_max].
            lengths: T of each episode, whole numbers [E], from 1 to T_max.
            terminal: whether S_T is terminal, for each episode or for all; if not, it was cut short.

        Raises:
            InputError: as `Experience`.
        """
        arrays = {"s": s, "a": a, "r": r, "lengths": lengths}
        s, a, r, lengths = (numbers(NAME, name, x) for name, x in arrays.items())
        shape = a.shape
        if a.ndim != 2 or (r.shape, s.shape, lengths.shape) != (shape, (shape[0], shape[1] + 1), shape[:1]):
            raise InputError(
                f"{NAME}: a and r must be [E, T], s [E, T + 1] with the last states, and lengths [E]; not "
                f"{a.shape}, {r.shape}, {s.shape} and {lengths.shape}"
            )
        _check_array("lengths", lengths, WHOLE, shape[0])
        if (e := first((lengths < 1) | (lengths > shape[1]))) is not None:
            raise InputError(f"{NAME}: lengths[{e[0]}] is {lengths[e]}, and must be from 1 to {shape[1]}")
        steps = np.arange(shape[1])
        taken = steps < lengths[:, None]
        last = (steps == lengths[:, None] - 1)[taken]
        return cls(
            s[:, :-1][taken], a[taken], r[taken], s[:, 1:][taken], _terminal_ends(terminal, last), last
        )

    def check(self, num_states: int, num_actions: int, behaviour: Table | None = None) -> None:
        """Raises InputError unless this can be experience of such a task, and of such a policy.

        Args:
            num_states: the number of states of the task, terminal ones included.
            num_actions: the number of its actions.
            behaviour: the policy that is said to have acted.
        """
        num_states = whole(NAME, "num_states", num_states)
        num_actions = whole(NAME, "num_actions", num_actions)
        if behaviour is not None:
            behaviour.check(num_states, num_actions)
        if any(concrete(x) is None for x in vars(self).values()):
            return
        states, actions = ("state", num_states), ("action", num_actions)
        for name, (what, count) in {"s": states, "a": actions, "s_next": states}.items():
            x = getattr(self, name)
            if (i := first((x < 0) | (x >= count))) is not None:
                raise InputError(f"{NAME}: {name}[{i[0]}] is {x[i]}; the task has {what}s 0 to {count - 1}")
        b = None if behaviour is None else concrete(behaviour.probabilities)
        if b is not None and (i := first(b[self.s, self.a] == 0)) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} takes action {self.a[i]} in state {self.s[i]}, which the "
                "behaviour policy never does; it is not the policy that acted"
            )

    def check_available(self, available: Available) -> None:
        """Raises InputError where an action was taken that its state does not have; traced ones pass."""
        is_available, s, a = (concrete(x) for x in (available, self.s, self.a))
        if is_available is None or s is None or a is None:
            return
        if (i := first(~is_available.astype(bool)[s, a])) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} takes action {a[i]} in state {s[i]}, which does not have it; see available"
            )

    def transitions(self, gamma: Any, dtype: Any) -> Transition:
        """What methods learn from: a Transition of [N] each, with rewards and gamma' of type `dtype`."""
        s, a, s_next = (jnp.asarray(x, jnp.int32) for x in (self.s, self.a, self.s_next))
        terminal, last = jnp.asarray(self.terminal, bool), jnp.asarray(self.last, bool)
        discount = jnp.where(terminal, 0, jnp.asarray(gamma, dtype))
        return Transition(s, a, jnp.asarray(self.r, dtype), s_next, discount, last)


def _check_array(name: str, x: np.ndarray, kind: tuple[str, str], size: int) -> None:
    """Raises InputError unless `x` has one axis of this size, 1 or more, and a dtype of this kind."""
    letters, words = kind
    if x.ndim != 1 or not x.size:
        raise InputError(f"{NAME}: {name} must be {words} [N], at least one, not of shape {list(x.shape)}")
    if len(x) != size:
        raise InputError(f"{NAME}: {name} must have length {size}, as s has, not {len(x)}")
    if x.dtype.kind not in letters:
        raise InputError(f"{NAME}: {name} must be {words}, not {x.dtype}")


def _truth(name: str, value: Any) -> Any:
    """`value` as booleans, where it is nothing but 0 and 1, as a file of numbers has them; else as it is."""
    x = numbers(NAME, name, value)
    return x.astype(bool) if concrete(x) is None or np.isin(x, (0, 1)).all() else x


def _ends(terminal: Any) -> Any:
    """The ends of episodes where only terminal states end them, and the end of the log."""
    terminal = _truth("terminal", terminal)
    if terminal.ndim != 1 or terminal.dtype != bool:
        return terminal  # `Experience` refuses it with a message
    return terminal | (np.arange(terminal.size) == terminal.size - 1)


def _terminal_ends(terminal: Any, last: Bool[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Which transitions enter a terminal state, where `terminal` says it of all episodes, or of each."""
    terminal, ends = _truth("terminal", terminal), np.flatnonzero(last)
    if terminal.dtype.kind != "b" or terminal.shape not in ((), ends.shape):
        raise InputError(
            f"{NAME}: terminal must be True, False, or booleans [E] = {list(ends.shape)}, not "
            f"{terminal.dtype} {list(terminal.shape)}"
        )
    enters = np.zeros_like(last)
    enters[ends] = terminal
    return enters
