"""Value iteration in fewer sweeps: by what the last sweeps did (Anderson), or by staying near the first values."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core.checks import RATE, check_within
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.model import backup
from jaxrl_tab.exact.optimum import rounding, solved, unless
from jaxrl_tab.exact.values import greedy_to, largest


class Sweeps(NamedTuple):
    """What sweeps from v = 0 came to, float64.

    Attributes:
        policy: what is greedy to q, [S, A].
        v: the values after the last sweep, [S]; NaN where `planning.value_iteration` has it.
        q: what is expected of each action if these hold from the next step on, [S, A].
        error: the largest |v - v*| of any state after each sweep, [N + 1]; the first is that of v = 0.
        residual: the most by which a sweep changes any of these values, [N + 1].
        settled: whether the tolerance was reached.
    """

    policy: Float[np.ndarray, "S A"]
    v: Float[np.ndarray, " S"]
    q: Float[np.ndarray, "S A"]
    error: Float[np.ndarray, " N"]
    residual: Float[np.ndarray, " N"]
    settled: bool

    @property
    def sweeps(self) -> int:
        """How many sweeps were made: N."""
        return len(self.error) - 1


def accelerated_value_iteration(
    env: Environment,
    gamma: float = 1.0,
    by: str = "anderson",
    *,
    memory: int = 5,
    tol: float = 1e-10,
    max_sweeps: int = 10_000,
) -> Sweeps:
    """Value iteration from v = 0, sweep by sweep, in one of three ways. With T v = max_a E[R + gamma v(S')],

    - **plain**: v <- T v, whose error shrinks by gamma at each sweep (book, section 4.4);
    - **anderson**: v <- sum_i w_i T v_i of the last `memory` + 1 values v_i, where the weights w add up to 1 and make
      the squared length of sum_i w_i (T v_i - v_i) least (Anderson 1965; Geist and Scherrer 2018, Anderson
      acceleration for reinforcement learning). Where the next sweep changes values by more than gamma times what the
      last one did, which plain sweeps never do, it goes back, makes the plain one, and forgets what was before. So it
      settles always: after twice as many sweeps as plain ones at worst, and often after a few;
    - **anchored**: v_n <- b_n v_0 + (1 - b_n) T v_{n-1}, where b_n = 1 / sum_{i <= n} gamma^(-2 i) (Lee and Ryu 2023,
      Accelerating value iteration with anchoring). Its Bellman error |T v_n - v_n| is at most

          (1/gamma - gamma) (1 + 2 gamma - gamma^(n+1)) / (gamma^-(n+1) - gamma^(n+1))

      times |v_0 - v*| (or the same of the worst values, if that is more): about 4 / (n + 1) for gamma near 1, where
      plain sweeps have no better bound than 2. That is for the worst of all tasks; in many, plain sweeps are quicker.

    The last two are for gamma below 1. Without discounting T has more than one fixed point where one can wait for
    nothing, and to reach beyond a sweep may lead to values that no policy has.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        by: "plain", "anderson" or "anchored".
        memory: how many earlier values `anderson` looks back at.
        tol: sweeps end where no value can be further from v* than this; at gamma = 1, where a sweep changes none by
            more, which is no bound (from v = 0, waiting for nothing may look better than it is): `error` tells. Of
            large numbers no more is asked than rounding allows, as in `value_iteration`.
        max_sweeps: how many sweeps to make at most; `settled` tells whether they were enough.

    Raises:
        InputError: as `value_iteration`; a number is out of range; or gamma is 1, and `by` is not plain.
    """
    check_within("gamma", gamma, RATE)
    check_within("tol", tol, {"greater_than": 0})
    memory, max_sweeps = whole(None, "memory", memory), whole(None, "max_sweeps", max_sweeps)
    ways = {"plain": _Plain, "anderson": lambda gamma: _Anderson(gamma, memory), "anchored": _Anchored}
    if by not in ways:
        raise InputError(f"by must be one of {', '.join(ways)}, not {shown(by)}")
    if gamma == 1 and by != "plain":
        raise InputError(
            f"at gamma = 1 {by} sweeps may settle at values that no policy has; take gamma below 1, "
            "or plain value iteration"
        )
    model, last, out = solved(env, 0.0, gamma)
    unsure, way = rounding(model, last, gamma), ways[by](gamma)
    enough = tol if gamma == 1 else tol * (1 - gamma) / max(gamma, np.finfo(float).tiny)
    v, errors, residuals = np.zeros(len(last.v)), [], []
    while True:
        q = backup(model, v, gamma)
        change = largest(q) - v
        errors.append(abs(v - last.v).max())
        residuals.append(abs(change).max())
        settled = not (abs(change) > np.maximum(enough, unsure)).any()
        if settled or len(errors) > max_sweeps:
            found = unless(out, v), unless(out, q)
            return Sweeps(greedy_to(q), *found, np.array(errors), np.array(residuals), settled)
        v = way.next(v, largest(q))


class _Plain:
    def __init__(self, gamma: float):
        pass

    def next(self, v: np.ndarray, backed_up: np.ndarray) -> np.ndarray:
        """The values to try next, from the last ones and what a sweep makes of them."""
        return backed_up


class _Anchored:
    """Halpern's iteration towards v = 0, with the weights of Lee and Ryu."""

    def __init__(self, gamma: float):
        self.gamma, self.weight = gamma, 1.0

    def next(self, v: np.ndarray, backed_up: np.ndarray) -> np.ndarray:
        # b_n = 1 / sum_{i <= n} gamma^(-2 i), from b_{n-1}, without a power that overflows.
        shrunk = self.gamma**2 * self.weight
        self.weight = shrunk / (1 + shrunk)
        return (1 - self.weight) * backed_up


class _Anderson:
    def __init__(self, gamma: float, memory: int):
        self.gamma, self.memory = gamma, memory
        self.past: list[tuple[np.ndarray, np.ndarray]] = []  # changes by a sweep, and what it made

    def next(self, v: np.ndarray, backed_up: np.ndarray) -> np.ndarray:
        change = backed_up - v
        if self.past and abs(change).max() > self.gamma * abs(self.past[-1][0]).max():
            plain = self.past[-1][1]
            self.past = []
            return plain
        self.past = [*self.past[-self.memory :], (change, backed_up)]
        changes, made = (np.stack(x, 1) for x in zip(*self.past, strict=True))
        weights = np.linalg.lstsq(np.diff(changes, axis=1), change, rcond=None)[0]
        return backed_up - np.diff(made, axis=1) @ weights
