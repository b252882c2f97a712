"""An episode as a table for people: a row for each step."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np

from jaxrl_tab.core.declared import Learns, of_environment
from jaxrl_tab.core.steps import Steps
from jaxrl_tab.core.types import Environment
from jaxrl_tab.show.states import state_names
from jaxrl_tab.show.words import counted, significant

AT_ENDS = 10  # steps at the beginning, and at the end, of an episode that is too long to show
ENTRIES = 2  # of what a step changed, that are named


@dataclasses.dataclass(frozen=True, eq=False)
class Told:
    """An episode as a table of text.

    Attributes:
        env: the environment.
        steps: the episode.
        learns: what the method learns.
        gamma: its discount rate.
    """

    env: Environment
    steps: Steps
    learns: Learns
    gamma: float

    @property
    def head(self) -> tuple[str, ...]:
        """The names of the columns."""
        of_error = ("error δ",) if self._has_error else ()
        return ("step", "state S", "action A", "reward R", "next state S'", *of_error, "what changed")

    def row(self, i: int) -> tuple[str, ...]:
        """The cells of a step, from 0."""
        seen = self.steps.experience
        error = self.steps.delta[i]
        of_error = (("–" if np.isnan(error) else _short(error)),) if self._has_error else ()
        return (
            str(i + 1),
            self._at(seen.s[i]),
            self._action(int(seen.a[i])),
            _short(float(seen.r[i])),
            self._at(seen.s_next[i]),
            *of_error,
            self._changed(i),
        )

    def rows(self) -> Iterator[tuple[str, ...]]:
        """The rows of all steps; of a long episode its beginning and its end, and between them what is left out."""
        steps, left_out = range(len(self.steps)), len(self.steps) - 2 * AT_ENDS
        if left_out <= AT_ENDS:
            yield from map(self.row, steps)
            return
        yield from map(self.row, steps[:AT_ENDS])
        yield ("…", *[""] * (len(self.head) - 2), f"{counted(left_out, 'steps')} are left out")
        yield from map(self.row, steps[-AT_ENDS:])

    @property
    def end(self) -> str:
        """How the episode ended, in a sentence."""
        seen = self.steps.experience
        total = float((np.asarray(seen.r, float) * self.gamma ** np.arange(len(self.steps))).sum())
        how = "in a terminal state" if seen.terminal[-1] else "at the time limit"
        return f"It ends {how} after {counted(len(self.steps), 'steps')}; its return is {significant(total)}."

    @cached_property
    def _has_error(self) -> bool:
        return not np.isnan(self.steps.delta).all()

    @cached_property
    def _state(self) -> Callable[[int], str]:
        return state_names(self.env)

    def _at(self, s: Any) -> str:
        """The name of a state; where it is numbers, these."""
        return ", ".join(significant(x, 3) for x in s.tolist()) if np.ndim(s) else self._state(int(s))

    def _action(self, a: int) -> str:
        return of_environment(self.env).action_names[a]

    def _changed(self, i: int) -> str:
        """The entries that changed most, each with its value before and after the step."""
        change, seen = self.steps.changes[i], self.steps.experience
        if not len(change.s):
            return "nothing"
        if not self.env.num_states:
            most = abs(change.after - change.before).max()
            return f"{counted(len(change.s), 'weights')}, ≤ {significant(float(most), 2)}"
        most = np.argsort(-abs(change.after - change.before), kind="stable")[:ENTRIES]
        entries = []
        for s, a, *values in zip(*(x[most] for x in change), strict=True):
            here = bool(s == seen.s[i]) and (self.learns is Learns.STATES or bool(a == seen.a[i]))
            before, after = (_short(float(x)) for x in values)
            entries.append(f"{self._entry(int(s), int(a), here)}: {before} to {after}")
        more = len(change.s) - len(most)
        return ", ".join([*entries, *([f"and {more} more"] if more else [])])

    def _entry(self, s: int, a: int, here: bool) -> str:
        """The name of an entry; that of the step itself is Q(S, A), θ(S, A) or V(S)."""
        if self.learns is Learns.STATES:
            return "V(S)" if here else f"V({self._state(s)})"
        symbol = self.learns.symbol
        return f"{symbol}(S, A)" if here else f"{symbol}({self._state(s)}, {self._action(a)})"


def _short(x: float) -> str:
    """A number of four digits; what is left of a rounding error is 0."""
    return significant(round(x, 6), 4)
