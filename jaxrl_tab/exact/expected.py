"""What a step of linear TD is on average: whether it diverges, told without a single sample (book, chapter 11).

Each of these methods moves its weights z by g - G z on average: over the states by how often they come, over what the
policy that acts does there, and over what that leads to. So the expected update is z <- M z + g with M = I - G, and it
goes where the powers of M go: it diverges, from nearly anywhere, where an eigenvalue of M is larger than 1 in size.

With features X, how often states come mu, D = diag(mu), rewards r, and gamma in P (`projected.LinearValues`):

    A = X^T D (X - P X),  b = X^T D r,  C = X^T D X

    baird = rl.make("baird")
    of = linear_values(baird, baird.target_policy, baird.features, 0.99, behaviour=baird.behaviour_policy)
    semi_gradient(of, 0.01).diverges  # True
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import RATE, check_within
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.exact.given import numbers
from jaxrl_tab.exact.projected import LinearValues

ROUNDING = 1e-9  # an eigenvalue is larger than 1 in size where it is so by more than this


class ExpectedUpdate(NamedTuple):
    """The expected update z <- M z + g, float64.

    z are the weights w [n]; of a method with second weights v, w and then v [2n].

    Attributes:
        matrix: M, [k, k].
        constant: g, [k].
    """

    matrix: Float[np.ndarray, "k k"]
    constant: Float[np.ndarray, " k"]

    @property
    def radius(self) -> float:
        """The largest size of an eigenvalue of M, by which the weights grow in the long run, at each update."""
        return float(abs(np.linalg.eigvals(self.matrix)).max())

    @property
    def diverges(self) -> bool:
        """Whether the weights grow without bound from nearly anywhere.

        An eigenvalue of 1 does not count: what lies in its direction stays as it is, such as weights that have no part
        in any value.
        """
        return self.radius > 1 + ROUNDING

    def curve(self, start: ArrayLike, updates: int) -> Float[np.ndarray, "_ k"]:
        """The weights after 0, 1, ... updates. Second weights, where `start` has none, begin as 0."""
        size, updates = len(self.constant), whole("curve", "updates", updates, 0)
        given = _start(start, size, size // 2)
        z = [np.append(given, np.zeros(size - len(given)))]
        for _ in range(updates):
            z.append(self.matrix @ z[-1] + self.constant)
        return np.stack(z)


def semi_gradient(of: LinearValues, alpha: float) -> ExpectedUpdate:
    """Semi-gradient TD(0), on-policy, or off-policy with ratios: w <- w + alpha (b - A w)      (equation 11.2)."""
    _check(of, alpha=alpha)
    return _weighed(of, alpha, of.mu)


def dynamic_programming(of: LinearValues, alpha: float) -> ExpectedUpdate:
    """Semi-gradient DP, in which every state counts the same      (book, equation 11.9).

    w <- w + alpha / |S| sum_s (E_pi[R + gamma v(S') | s] - v(s)) x(s)
    """
    _check(of, alpha=alpha)
    return _weighed(of, alpha, np.full(len(of.mu), 1 / len(of.mu)))


def emphatic(of: LinearValues, alpha: float, lam: float = 0.0) -> ExpectedUpdate:
    """Emphatic TD(lambda) in the long run (book, sections 11.8 and 12.11; Sutton, Mahmood and White 2016).

    With f = (I - P^T)^-1 mu a state counts by its emphasis m = lambda mu + (1 - lambda) f, and its trace goes on by
    lambda P: so A = X^T diag(m) (I - lambda P)^-1 (I - P) X, and b as much of r.

    Raises:
        InputError: the emphasis grows without bound, as at gamma = 1 where pi never ends; or so do the traces.
    """
    _check(of, alpha=alpha)
    check_within("lam", lam, RATE)
    onward, one = of.onward.toarray(), np.eye(len(of.mu))
    for share, what in ((1.0, "emphasis grows"), (lam, "traces grow")):
        if np.linalg.matrix_rank(one - share * onward) < len(one):
            raise InputError(f"the {what} without bound: take gamma below 1")
    emphasis = lam * of.mu + (1 - lam) * np.linalg.solve(one - onward.T, of.mu)
    weighed = np.linalg.solve(one - lam * onward.T, emphasis[:, None] * of.features).T
    a, b = weighed @ (of.features - onward @ of.features), weighed @ of.reward
    return ExpectedUpdate(np.eye(len(a)) - alpha * a, alpha * b)


def emphatic_curve(
    of: LinearValues, alpha: float, start: ArrayLike, updates: int, lam: float = 0.0
) -> Float[np.ndarray, "_ n"]:
    """The weights after 0, 1, ... expected updates of emphatic TD(lambda), whose emphasis grows from the first on.

    F <- mu + P^T F and Z <- lambda P^T Z + diag(lambda mu + (1 - lambda) F) X, beginning with 0; then
    w <- w + alpha Z^T (r + P X w - X w)      (figure 11.6, of lambda = 0)
    """
    _check(of, alpha=alpha)
    check_within("lam", lam, RATE)
    updates = whole("emphatic_curve", "updates", updates, 0)
    w, followed, onward = [_start(start, of.features.shape[1])], np.zeros(len(of.mu)), of.onward.toarray()
    traces = np.zeros_like(of.features)
    for _ in range(updates):
        followed = of.mu + onward.T @ followed
        emphasis = lam * of.mu + (1 - lam) * followed
        traces = lam * onward.T @ traces + emphasis[:, None] * of.features
        error = of.reward + onward @ (of.features @ w[-1]) - of.features @ w[-1]
        w.append(w[-1] + alpha * traces.T @ error)
    return np.stack(w)


def gtd2(of: LinearValues, alpha: float, beta: float) -> ExpectedUpdate:
    """GTD2: w <- w + alpha A^T v and v <- v + beta (b - A w - C v), at the same time      (book, section 11.7)."""
    _check(of, alpha=alpha, beta=beta)
    a, b, c = _moments(of, of.mu)
    return _second(np.zeros_like(a), alpha * a.T, np.zeros_like(b), a, b, c, beta)


def tdc(of: LinearValues, alpha: float, beta: float) -> ExpectedUpdate:
    """TDC: w <- w + alpha (b - A w - (C - A)^T v) and v <- v + beta (b - A w - C v), at the same time.

    (Book, section 11.7.)
    """
    _check(of, alpha=alpha, beta=beta)
    a, b, c = _moments(of, of.mu)
    return _second(-alpha * a, -alpha * (c - a).T, alpha * b, a, b, c, beta)


def _second(of_w, of_v, constant, a, b, c, beta: float) -> ExpectedUpdate:
    """The update of w, by what w and v add to it, beside v <- v + beta (b - A w - C v)."""
    step = np.block([[of_w, of_v], [-beta * a, -beta * c]])
    return ExpectedUpdate(np.eye(len(step)) + step, np.append(constant, beta * b))


def _weighed(of: LinearValues, alpha: float, weights: Float[np.ndarray, " S"]) -> ExpectedUpdate:
    a, b, _ = _moments(of, weights)
    return ExpectedUpdate(np.eye(len(a)) - alpha * a, alpha * b)


def _moments(of: LinearValues, weights: Float[np.ndarray, " S"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, b and C, where states count by these weights."""
    weighed = of.features.T * weights
    return (
        weighed @ (of.features - of.onward @ of.features),
        weighed @ of.reward,
        weighed @ of.features,
    )


def _check(of: LinearValues, **rates: float) -> None:
    """Raises InputError unless there is something of which to work out the update, and step sizes are positive."""
    if not isinstance(of, LinearValues):
        raise InputError(f"expected updates are those of planning.linear_values(...), not of {shown(of)}")
    if of.policy is not None:
        raise InputError("expected updates are those of values of states: leave of_actions out")
    for name, rate in rates.items():
        check_within(name, rate, {"greater_than": 0})


def _start(start: ArrayLike, *sizes: int) -> Float[np.ndarray, " _"]:
    """Weights that are given, of one of these numbers."""
    given = numbers("start", start)
    if given.shape not in [(size,) for size in sizes]:
        raise InputError(f"start must be {sizes[0]} weights, not {list(given.shape)}")
    return given
