"""An episode step by step: what happened in each step, and what was learned from it."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrl_tab.core.experience import Experience


class Change(NamedTuple):
    """The entries of a table that a step changed.

    Attributes:
        s, a: the states and the actions of these entries, int [k]. In a table of state values a is 0.
        before, after: their values before and after the step, float [k].
    """

    s: Int[np.ndarray, " k"]
    a: Int[np.ndarray, " k"]
    before: Float[np.ndarray, " k"]
    after: Float[np.ndarray, " k"]

    @classmethod
    def between(cls, before: Float[np.ndarray, "S A"], after: Float[np.ndarray, "S A"]) -> "Change":
        """What differs from one table to the next."""
        s, a = np.nonzero((before != after) & ~(np.isnan(before) & np.isnan(after)))
        return cls(s, a, before[s, a], after[s, a])


class Seen(NamedTuple):
    """The transitions of an episode whose states are numbers: as `Experience`, which is of states that are counted.

    Attributes:
        s, s_next: S and S', float [N, d].
        a, r, terminal, last: as there, [N].
    """

    s: Float[np.ndarray, "N d"]
    a: Int[np.ndarray, " N"]
    r: Float[np.ndarray, " N"]
    s_next: Float[np.ndarray, "N d"]
    terminal: Bool[np.ndarray, " N"]
    last: Bool[np.ndarray, " N"]


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """An episode of N steps.

    Attributes:
        experience: its transitions, in their order.
        delta: the error from which the method learned in each step, float [N]. NaN where it did not learn from
            one error, as where it waits for the end of the episode.
        changes: what each step changed in the table of values; of weights, where states cannot be counted; N of them.
    """

    experience: Experience | Seen
    delta: Float[np.ndarray, " N"]
    changes: tuple[Change, ...]

    def __len__(self) -> int:
        return len(self.changes)
