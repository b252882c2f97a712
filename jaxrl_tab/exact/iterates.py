"""Generalized policy iteration, iterate by iterate: evaluation, improvement, evaluation, ... (book, section 4.6).

Two things are to hold of a policy pi and of values v: v = v_pi, and pi is greedy to v. Evaluation makes the first
true and spoils the second, improvement the other way round; where both hold, the policy is the best one (Silver,
lecture 3). How thorough an evaluation is can be chosen: exact, which is policy iteration; a single sweep, which is
value iteration; or k sweeps (modified policy iteration: Puterman and Shin 1978).
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from jaxrl_tab.core import memory
from jaxrl_tab.core.checks import RATE, TOLERANCE, check_within, first
from jaxrl_tab.core.errors import InputError, whole
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.given import checked_policy
from jaxrl_tab.exact.model import Model, backup, name_of, with_sizes
from jaxrl_tab.exact.optimum import solved
from jaxrl_tab.exact.values import (
    ROUNDING,
    any_action,
    first_policy,
    from_start,
    greedy_to,
    policy_values,
)

if TYPE_CHECKING:
    import xarray as xr


class Iterates(NamedTuple):
    """The policies and values of generalized policy iteration, float64; iterate n is that after n improvements.

    Attributes:
        policy: [N, S, A]: the first policy, and each improved one.
        v: values after the evaluation of each, [N, S]: v_pi; or what the sweeps make of the values before, of which the
            first are 0. NaN where `value_iteration` has it. At gamma = 1 it is -inf where a policy may never end.
        q: what is expected of each action if v holds from the next step on, [N, S, A]; the next policy is greedy to it.
        start_value: v from the start distribution, [N].
        changed: in how many states an iterate acts otherwise than the one before, int [N].
        least_change, largest_change: of v since the iterate before, over all states, [N]; NaN for the first. With exact
            evaluation no change is below 0 (but for rounding): this is the policy improvement theorem.
        error: the largest |v - v*| of any state, [N]; v* are the best values, or those of the best epsilon-soft policy.
        zigzag: the way between the lines v = v_pi and pi = greedy(v), [2 N - 1, 2]. It begins with the first policy and
            values; then come an improvement and an evaluation, in turn. Of each point the distances from the two: the
            largest |E[R + gamma v(S')] - v(s)| if pi acts, and the most that greedy actions gain on pi for a step.
        sweeps: of each evaluation; None where it is exact.
        settled: whether another iterate would be the same.
    """

    policy: Float[np.ndarray, "N S A"]
    v: Float[np.ndarray, "N S"]
    q: Float[np.ndarray, "N S A"]
    start_value: Float[np.ndarray, " N"]
    changed: Int[np.ndarray, " N"]
    least_change: Float[np.ndarray, " N"]
    largest_change: Float[np.ndarray, " N"]
    error: Float[np.ndarray, " N"]
    zigzag: Float[np.ndarray, "M 2"]
    sweeps: int | None
    settled: bool

    def to_xarray(self) -> "xr.Dataset":
        """All of it as a dataset, of dimensions improvement, state and action; the zigzag's are step and distance."""
        import xarray as xr

        dims = {"policy": ("state", "action"), "v": ("state",), "q": ("state", "action")}
        arrays = self._asdict()
        sweeps, settled, zigzag = (arrays.pop(name) for name in ("sweeps", "settled", "zigzag"))
        variables = {name: (("improvement", *dims.get(name, ())), x) for name, x in arrays.items()}
        distances = {"distance": ["v = v_pi", "pi = greedy(v)"]}
        about = {"sweeps": sweeps or "until exact", "settled": int(settled)}
        return xr.Dataset(variables | {"zigzag": (("step", "distance"), zigzag)}, distances, about)

    def __repr__(self) -> str:
        how = "exact evaluation" if self.sweeps is None else f"sweeps={self.sweeps}"
        ended = "settled" if self.settled else "not settled"
        return (
            f"<Iterates: {len(self.v) - 1} improvements, {how}, {ended}, largest error {self.error[-1]:.3g}>"
        )


def generalized_policy_iteration(
    env: Environment,
    gamma: float = 1.0,
    *,
    sweeps: int | None = None,
    epsilon: float = 0.0,
    policy: ArrayLike | None = None,
    improvements: int = 1000,
    tol: float = 1e-10,
) -> Iterates:
    """Every policy and every value on the way from a first policy to the best (book, sections 4.3 to 4.6).

    An improvement takes the greedy actions in the states where they are better by more than rounding. It goes on until
    there is none, and until sweeps change no value by more than `tol`.

    The first policy takes any action, equally likely, as in the book's figure 4.1: it ends wherever an end can be
    reached. (Where it is better to stay for nothing for ever, it stays.) A `policy` of your own may never end; at
    gamma = 1 with exact evaluation its values are then -inf, and each improvement brings in the states from which a
    single action leads to those that end.

    Sweeps that begin with v = 0 may settle above the best values at gamma = 1: where one can wait for nothing, waiting
    goes on to look as good as v = 0 made it look. `error` tells.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate, in [0, 1].
        sweeps: of iterative policy evaluation before each improvement but the first, whose values are 0: 1 is value
            iteration. None evaluates exactly: policy iteration.
        epsilon: improved policies are epsilon-greedy (book, section 5.4).
        policy: the first one, [S, A].
        improvements: how many to make at most.
        tol: see above.

    Raises:
        InputError: as `value_iteration`; `policy` is no policy, or takes some action with a probability below
            epsilon / A; or the iterates do not fit in half of the memory that is free.
    """
    check_within("gamma", gamma, RATE)
    check_within("epsilon", epsilon, RATE)
    check_within("tol", tol, {"greater_than": 0})
    improvements = whole(None, "improvements", improvements, 0)
    sweeps = None if sweeps is None else whole(None, "sweeps", sweeps)
    model, last, out = solved(env, epsilon, gamma)
    probs = first_policy(model, epsilon, gamma) if policy is None else _soft(model, policy, epsilon)
    rows, zigzag, settled = _iterated(model, probs, sweeps, epsilon, gamma, tol, improvements)
    if not rows:
        raise InputError(f"{name_of(env)}: so many iterates do not fit in memory; ask for fewer improvements")
    policies, v, q = map(np.stack, zip(*rows, strict=True))
    nothing = np.full((1, len(last.v)), np.nan)
    changes = np.concatenate([nothing, _difference(v[1:], v[:-1])])
    return Iterates(
        policies,
        np.where(out, np.nan, v),
        np.where(out[:, None], np.nan, q),
        np.array([from_start(model, x) for x in v]),
        np.append(0, (policies[1:] != policies[:-1]).any(-1).sum(-1)),
        changes.min(1),
        changes.max(1),
        abs(_difference(v, last.v)).max(1),
        np.array(zigzag),
        sweeps,
        settled,
    )


def _iterated(
    model: Model,
    probs: np.ndarray,
    sweeps: int | None,
    epsilon: float,
    gamma: float,
    tol: float,
    improvements: int,
) -> tuple[list[tuple[np.ndarray, ...]], list[tuple[float, float]], bool]:
    """Policy, v and q of each iterate, the zigzag, and whether it settled; no iterate where memory does not do."""
    exact, unit = sweeps is None, ROUNDING * np.finfo(float).eps
    room = memory.free() / 4  # they are copied once, into arrays of all
    rows, zigzag = [], []
    v = size = np.zeros(len(probs))
    if exact:
        v, size = _evaluated(model, probs, v, sweeps, gamma)
    while True:
        q = backup(model, v, gamma)
        improved = greedy_to(q, epsilon)
        acting, best = v if exact else _expected(probs, q), _expected(improved, q)
        rounding = unit * (size + _expected(improved, backup(with_sizes(model), size, gamma)))
        better = best > acting + rounding
        if model.available is not None:  # -inf is below what stands for an action that there is not
            better &= ~((improved > 0) & ~model.available).any(-1)
        change = abs(_difference(v, rows[-1][1])) if rows else np.full(len(v), np.inf)
        settled = not better.any() and (exact or bool((change <= np.maximum(tol, rounding)).all()))
        rows.append((probs, v, q))
        zigzag.append(_distances(v, acting, best))
        if settled or len(rows) > improvements:
            return rows, zigzag, settled
        if (len(rows) + 1) * memory.size(rows[0]) > room:
            return [], zigzag, settled
        probs = np.where(better[:, None], improved, probs)
        zigzag.append(_distances(v, _expected(probs, q), best))
        v, size = _evaluated(model, probs, v, sweeps, gamma)


def _evaluated(
    model: Model, probs: np.ndarray, v: np.ndarray, sweeps: int | None, gamma: float
) -> tuple[np.ndarray, np.ndarray]:
    """v_pi, or what so many sweeps make of v; and how large the numbers are that it is added up from. [S] each."""
    if sweeps is None:
        v, size, _ = policy_values(model, probs, gamma)
        return v, size
    for _ in range(sweeps):
        v = _expected(probs, backup(model, v, gamma))
    return v, abs(v)


def _distances(v: np.ndarray, acting: np.ndarray, best: np.ndarray) -> tuple[float, float]:
    """How far v is from that of the policy, and how far the policy is from greedy.

    `acting` and `best` are what is expected for a step of the policy, and of one that is greedy, if v holds after it.
    """
    return abs(_difference(acting, v)).max(), max(0.0, _difference(best, acting).max())


def _expected(probs: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The sum over actions of pi(a | s) q(s, a), [S]; -inf only where such an action is taken."""
    return (probs * np.where(probs > 0, q, 0)).sum(-1)


def _difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """x - y, and 0 where both are -inf."""
    with np.errstate(invalid="ignore"):
        return np.where(x == y, 0, x - y)


def _soft(model: Model, policy: Any, epsilon: float) -> np.ndarray:
    """The policy, which must take every action with probability epsilon / A or more."""
    probs = checked_policy(model, policy)
    if (at := first(probs < epsilon * any_action(model) - TOLERANCE)) is not None:
        raise InputError(
            f"policy takes action {at[1]} in state {at[0]} with probability {probs[at]:.6g}, which is less than "
            f"epsilon / A, with epsilon = {epsilon:g}"
        )
    return probs
