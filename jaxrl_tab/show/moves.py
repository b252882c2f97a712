"""Where greedy actions lead: paths, and how long they are."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.core import memory
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning


class Moves(NamedTuple):
    """Where each action leads, by its most likely outcome.

    Attributes:
        successor: state, int [S, A].
        terminal: bool [S].
        reachable: whether the state can be reached from a start state, bool [S].
        stochastic: whether any action has several outcomes.
    """

    successor: np.ndarray
    terminal: np.ndarray
    reachable: np.ndarray
    stochastic: bool

    @classmethod
    def of(cls, env: Environment) -> "Moves":
        model = planning.exact_model(env)
        s_next = model.s_next
        same = s_next[..., :, None] == s_next[..., None, :]
        likelihood = (model.prob[..., None, :] * same).sum(-1)  # of the successor, by whichever outcome
        likeliest = np.isclose(likelihood, likelihood.max(-1, keepdims=True))
        rank = likeliest.cumsum(-1)
        middle = (rank[..., -1:] + 1) // 2
        # Of k likeliest outcomes number (k + 1) // 2: of three gusts of wind the one in the middle.
        k = ((rank == middle) & likeliest).argmax(-1)[..., None]

        return cls(
            successor=np.take_along_axis(s_next, k, -1)[..., 0],
            terminal=planning.terminal_states(model),
            reachable=planning.reachable(model),
            stochastic=not np.isclose(likelihood.max(-1), 1).all(),
        )

    def distance(self, q: np.ndarray) -> np.ndarray:
        """Steps to a terminal state by greedy actions, float32 [n, S] for `q` [n, S, A]; inf if never."""
        cost = np.where(np.moveaxis(greedy_actions(q), 0, -1), np.float32(1), np.float32(np.inf))  # [S, A, n]
        cost[self.terminal] = 0
        steps = np.full((len(cost), len(q)), np.float32(np.inf))  # float32 is exact for so few steps
        steps[self.terminal] = 0
        while True:
            before, steps = steps, (steps[self.successor] + cost).min(1)
            if (steps == before).all():
                return steps.T

    def path(self, q: np.ndarray, s: int) -> tuple[np.ndarray, bool]:
        """The states of the greedy path from `s`, and whether it ends; else its last state is a repeat."""
        steps, greedy = self.distance(q[None])[0], greedy_actions(q)
        path = [s]
        while not self.terminal[s] and s not in path[:-1]:
            onward = self.successor[s][greedy[s]]
            s = int(onward[np.argmin(steps[onward])])
            path.append(s)
        return np.array(path), bool(self.terminal[s])


def tables_of_seeds(ds: xr.Dataset) -> Iterable[np.ndarray]:
    """The tables of all seeds, [n, S, A] for some seeds at a time: what is worked out from them may be larger."""
    q = ds.q.transpose("seed", "state", "action").values
    for block in memory.blocks(len(q), 16 * q[0].nbytes):
        yield q[block]


def preferring(q: np.ndarray) -> np.ndarray:
    """In which states some action is better than another, of those that there are: bool [S] for `q` [S, A]."""
    return q.max(-1) > q.min(-1, where=q > UNAVAILABLE, initial=np.inf)


def greedy_actions(q: np.ndarray) -> np.ndarray:
    """Which actions are maximal, up to rounding, bool [..., S, A]."""
    q = np.where(np.isnan(q), -np.inf, q)  # a diverged entry is no maximum
    most = q.max(-1, keepdims=True)
    with np.errstate(invalid="ignore"):  # infinities
        return (q == most) | (q >= most - (1e-9 + 1e-6 * abs(most)))
