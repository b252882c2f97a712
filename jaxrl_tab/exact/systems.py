"""Sparse linear systems x = constant + matrix x, solved without exchanging rows: see `planning` for why.

Elimination is the rule. Of many states that lead far and wide it would fill the matrix: for 100 000 states with random
successors it would need more memory than there is. There nearly every policy forgets soon where it started, and so a
few dozen products with the matrix do as well, by BiCGSTAB (van der Vorst 1992). Its answer is taken only where it is
right in each state by that state's own numbers; else elimination has to do.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

FEW = 2000  # states: for so many elimination is quick whatever leads where
BANDED = 2e10  # operations that elimination may take, if all entries lay in a band
CLOSER = 1e-8  # what BiCGSTAB leaves over, as part of what it was given
ITERATIONS, AGAIN = 400, 8  # of BiCGSTAB, and how often it is begun again from what is left over
TINY = np.finfo(float).tiny
UNITS = 8 * np.finfo(float).eps  # of the numbers that a state is added up from: what may be left over there

Solve = Callable[[Float[np.ndarray, " S"]], Float[np.ndarray, " S"]]


def sparse_solver(matrix: Any) -> Solve:
    """A function that solves x = constant + matrix x for x [S]; NaN where that has no one solution.

    `matrix` is sparse [S, S], without negative entries. Rows are not exchanged.
    """
    return _eliminating(matrix) if _is_narrow(matrix) else _iterating(matrix)


def _is_narrow(matrix: Any) -> bool:
    """Whether elimination is sure to be quick: there are few states, or each leads only to some that are near it."""
    n = matrix.shape[0]
    if n <= FEW:
        return True
    from scipy.sparse import csgraph

    entries = matrix.tocoo()
    order = csgraph.reverse_cuthill_mckee(matrix.tocsr())  # brings near what leads to each other
    place = np.empty(n, int)
    place[order] = np.arange(n)
    band = abs(place[entries.row] - place[entries.col]).max(initial=0)
    return n * float(band) ** 2 <= BANDED


def _eliminating(matrix: Any) -> Solve:
    from scipy import sparse
    from scipy.sparse.linalg import splu

    n = matrix.shape[0]
    system = sparse.csc_array(sparse.eye_array(n, format="csc") - matrix)
    in_place = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        return splu(system, **in_place).solve
    except RuntimeError:  # "Factor is exactly singular"
        return lambda constant: np.full(n, np.nan)


def _iterating(matrix: Any) -> Solve:
    """A solver by products with the matrix, and by elimination from the first time on that they do not do."""
    from scipy import sparse

    rows = sparse.csr_array(matrix)
    eliminated: list[Solve] = []

    def solve(constant: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        x, rest, left = np.zeros(len(constant)), constant, np.inf
        for _ in range(0 if eliminated else AGAIN):
            with np.errstate(all="ignore"):
                x = x + _bicgstab(rows, rest)
                rest = constant - (x - rows @ x)
                size = abs(constant) + rows @ abs(x) + abs(x)
            if (abs(rest) <= UNITS * size).all():
                return x
            if not abs(rest).max() < left / 2:
                break
            left = abs(rest).max()
        eliminated[:] = eliminated or [_eliminating(matrix)]
        return eliminated[0](constant)

    return solve


def _bicgstab(matrix: Any, constant: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """An x for which x - matrix x is close to the constant, in the notation of van der Vorst (1992).

    It is not SciPy's: that has BLAS add up its vectors, whose sums depend on the number of cores, and which waits for
    all of them.
    """
    times = lambda y: y - matrix @ y
    product = lambda y, z: (y * z).sum()
    x = np.zeros(len(constant))
    r = p = constant
    rho, least = product(r, r), CLOSER**2 * product(r, r)
    for _ in range(ITERATIONS):
        if product(r, r) <= least:
            break
        v = times(p)
        alpha = rho / product(constant, v)
        s = r - alpha * v
        t = times(s)
        omega = product(t, s) / max(product(t, t), TINY)
        x = x + alpha * p + omega * s
        r = s - omega * t
        new = product(constant, r)
        p = r + new / rho * alpha / omega * (p - omega * v)
        rho = new
    return x
