"""Vectors that are changed step by step while a Markov chain goes its way: their exact mean and covariance.

A vector w, of D numbers of which the last is always 1, begins as a random one that knows nothing of the chain. With
each arrow that the chain takes it is multiplied by the matrix of that arrow, T = Q + alpha R, so that every change is
affine. Then the second moments X(n) = E[w w^T; the chain is at n] of one step are linear in those of the step before,

    X'(m) = sum over arrows from n to m of p T X(n) T^T,

and w at the end, when the chain is over, has the second moments that all steps add up to (Singh and Dayan 1998,
Analytical mean squared error curves for temporal difference learning, Machine Learning 32). The last row of X is E[w].

T X T^T is of degree 2 in alpha, so three sparse matrices serve for all alpha. X is symmetric: half of it is kept.

What all steps add up to solves a linear system, one for each alpha and for all episodes; or it is added up, step by
step, for all alpha at once. It depends which takes less time. The first takes some 5e-7 s times N^2 D^2 / 2 for N
places in the chain: so it was measured for N from 6 to 1132 and D from 6 to 90, within a factor of 10. The second
takes 3e-9 s for each entry of the matrices in each step of each episode.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrl_tab.core import memory
from jaxrl_tab.core.errors import InputError

Entries = Sequence[tuple[int, int, float]]  # row, column, value

NEGLIGIBLE = 1e-16  # of what is there already: what is still under way may be left out
TO_SOLVE, TO_ADD = 5e-7, 3e-9  # seconds, see above
LONGEST = 300.0  # seconds that may be expected


class Arrow(NamedTuple):
    """A step of the chain.

    Attributes:
        source, target: the places that it leads from and to.
        prob: how probable it is at `source`.
        base: the rows of Q that are not those of the identity, as entries.
        step: R, as entries.
    """

    source: int
    target: int
    prob: float
    base: Entries = ()
    step: Entries = ()


class Recursion:
    """An episode, for one alpha or many: what it makes of the second moments of w.

    Args:
        size: D.
        begin: with what probability the chain begins at each place, float [N].
        over: what part of what is at a place is over, and counts, float [N].
        arrows: the steps of the chain; it must end with certainty.
        alpha: float [G].
        steps: after about so many steps next to nothing is left.
        episodes: how many it will be asked for.

    Raises:
        InputError: it needs more memory than there is, or would take too long.
    """

    def __init__(
        self,
        size: int,
        begin: Float[np.ndarray, " N"],
        over: Float[np.ndarray, " N"],
        arrows: Sequence[Arrow],
        alpha: Float[np.ndarray, " G"],
        steps: float,
        episodes: int,
    ) -> None:
        self.size, self._begin, self._over, self._alpha, self._steps = size, begin, over, alpha, steps
        half = size * (size + 1) // 2
        places = f"the second moments of {size} numbers at {len(begin):,} places"
        to_solve = TO_SOLVE * len(begin) ** 2 * half * len(alpha)
        to_add = TO_ADD * len(arrows) * 2 * half * len(alpha) * steps * episodes
        if min(to_solve, to_add) > LONGEST:
            raise InputError(
                f"{places} would take some {min(to_solve, to_add) / 60:,.0f} minutes: take a task of fewer states, a "
                "smaller n, fewer values, or fewer episodes"
            )
        needed = 8 * len(begin) * half * len(alpha) * 6 + 16 * len(arrows) * half * 6
        if needed > memory.free() // 2:
            raise InputError(f"{places} need {memory.words(needed)}, which is more than half of what is free")
        self._rows, self._columns = np.triu_indices(size)
        self._at = np.zeros((size, size), int)
        self._at[self._rows, self._columns] = self._at[self._columns, self._rows] = np.arange(half)
        self._powers = self._matrices(arrows, len(begin) * half)
        self._solvers = [self._solver(a) for a in alpha] if to_solve <= to_add else None

    def __call__(self, moments: Float[np.ndarray, "G D D"]) -> Float[np.ndarray, "G D D"]:
        """The second moments at the end of an episode, of those at its beginning.

        Infinite where those of long episodes grow faster than these become rare, so that there is no number.
        """
        begun = moments[:, self._rows, self._columns].T  # [half, G]
        x = (self._begin[:, None, None] * begun).reshape(-1, begun.shape[1])
        if self._solvers is None:
            total = self._added_up(x)
        else:
            solved = np.stack([solve(column) for solve, column in zip(self._solvers, x.T, strict=True)], 1)
            total = self._ended(solved)
        return total[self._at].transpose(2, 0, 1)

    def _ended(self, x: Float[np.ndarray, "_ G"]) -> Float[np.ndarray, "half G"]:
        return np.tensordot(self._over, x.reshape(len(self._over), -1, x.shape[1]), 1)

    def _added_up(self, x: Float[np.ndarray, "_ G"]) -> Float[np.ndarray, "half G"]:
        """What is over after each step, all together."""
        total, left, (zero, one, two) = self._ended(x), np.inf, self._powers
        with np.errstate(over="ignore", invalid="ignore"):  # where alpha is too large
            for _ in range(int(4 * self._steps) + 100):
                x = zero @ x + self._alpha * (one @ x) + self._alpha**2 * (two @ x)
                total += self._ended(x)
                left = abs(x).max(0)
                if not (left > NEGLIGIBLE * abs(total).max(0)).any():
                    break
            return np.where(left <= NEGLIGIBLE * abs(total).max(0), total, np.inf)

    def _solver(self, alpha: float) -> Callable[[Float[np.ndarray, " _"]], Float[np.ndarray, " _"]]:
        """Gives what all steps add up to, at all places, of what is begun with: x = begun + L x."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        zero, one, two = self._powers
        system = sparse.csc_array(sparse.eye_array(zero.shape[0]) - (zero + alpha * one + alpha**2 * two))
        try:
            solve = splu(system).solve
        except RuntimeError:  # "Factor is exactly singular"
            return lambda begun: np.full(len(begun), np.inf)
        # L takes second moments to second moments. So if those that belong to the identity, begun everywhere, are
        # none, the sum of all steps does not exist (Perron and Frobenius, of a cone).
        everywhere = np.eye(self.size)[self._rows, self._columns]
        full = solve(np.tile(everywhere, len(self._begin))).reshape(len(self._begin), -1)[:, self._at]
        is_finite = np.linalg.eigvalsh(full).min() > 0
        return solve if is_finite else lambda begun: np.full(len(begun), np.inf)

    def _matrices(self, arrows: Sequence[Arrow], n: int) -> list[Any]:
        """The sparse matrices of alpha^0, alpha^1 and alpha^2, [n, n]."""
        from scipy import sparse  # here, because it takes 0.3 s

        found: list[list[Any]] = [[], [], []]
        for arrow in arrows:
            q, r = _with_rows(self.size, arrow.base), _entries(arrow.step)
            for parts, pairs in zip(found, ([(q, q)], [(q, r), (r, q)], [(r, r)]), strict=True):
                parts += [self._product(arrow, one, other) for one, other in pairs]
        matrices = []
        for parts in found:
            target, source, value = (np.concatenate(x) for x in zip(*parts, strict=True))
            matrices.append(sparse.csr_array((value, (target, source)), shape=(n, n)))
        return matrices

    def _product(
        self, arrow: Arrow, one: "_Matrix", other: "_Matrix"
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The map from X to p one X other^T, as entries (target, source, value)."""
        half = len(self._rows)
        i, j = np.broadcast_arrays(one.row[:, None], other.row[None])
        kept = i <= j
        source = self._at[one.column[:, None], other.column[None]][kept]
        value = (one.value[:, None] * other.value[None])[kept]
        return (
            arrow.target * half + self._at[i[kept], j[kept]],
            arrow.source * half + source,
            arrow.prob * value,
        )


class _Matrix(NamedTuple):
    """A sparse matrix as its entries, of which several may be at the same place."""

    row: Int[np.ndarray, " N"]
    column: Int[np.ndarray, " N"]
    value: Float[np.ndarray, " N"]


def _entries(entries: Entries) -> _Matrix:
    table = np.array([*entries], float).reshape(-1, 3)
    return _Matrix(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2])


def _with_rows(size: int, rows: Entries) -> _Matrix:
    """The identity with these rows instead of its own."""
    own = _entries(rows)
    kept = np.setdiff1d(np.arange(size), own.row)
    return _Matrix(*map(np.concatenate, zip((kept, kept, np.ones(len(kept))), own, strict=True)))
