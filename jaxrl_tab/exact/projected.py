"""What values that are linear in features can be: the best of them, and where learning ends (book, chapters 9 and 11).

With features x(s) and weights w the values are v(s) = x(s) . w. The best weights are those with the least value error,
which is the mean of (v - v_pi)^2 by how often the policy is in each state, mu. Semi-gradient TD ends elsewhere, at its
fixed point. Two more errors need no v_pi: that of the Bellman equation, delta = r + gamma P v - v, and its projection,
which is what of it the features can express.

mu is the share of all steps, as `stationary_distribution` has it: of a task that does not end its stationary
distribution, and else the expected visits of an episode (book, box of section 9.2). There gamma is no part of it, for a
method that learns from each step as it comes knows nothing of such weights.

All of it holds for pairs of a state and an action as well, each action with weights of its own.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import RATE, check_within, first
from jaxrl_tab.core.coverage import check_coverage
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.given import checked_policy, numbers
from jaxrl_tab.exact.model import backup, exact_model, from_state_to_state, name_of
from jaxrl_tab.exact.values import policy_values
from jaxrl_tab.exact.visits import stationary_distribution

SINGULAR = 1e-12  # a system with a smaller reciprocal of its condition has no one solution


@dataclass(frozen=True)
class LinearValues:
    """All that is exact about the values of a policy as a linear function of features, in float64.

    N is the number of states, with weights [n]; or of pairs of a state and an action, with weights [n, A].

    Attributes:
        features: X, [N, n]; of pairs [N, n A], those of each in the columns of its action.
        mu: the share of steps in each state or pair, by the policy that acts, [N]; it adds up to 1.
        values: v_pi or q_pi, [N].
        reward: the expected reward, [N].
        onward: gamma p(s' | .), sparse [N, S]; nothing leads on from an end.
        policy: of pairs, the policy that is learned about, [S, A]; else None.
    """

    features: Float[np.ndarray, "N n"]
    mu: Float[np.ndarray, " N"]
    values: Float[np.ndarray, " N"]
    reward: Float[np.ndarray, " N"]
    onward: Any
    policy: Float[np.ndarray, "S A"] | None

    def value_error(self, w: ArrayLike) -> float:
        """VE(w) = sum_s mu(s) [v_pi(s) - v(s)]^2      (equation 9.1)."""
        return self._mean_square(self._values(w) - self.values)

    def bellman_error(self, w: ArrayLike) -> float:
        """BE(w) = sum_s mu(s) delta(s)^2,  delta = r + gamma P v - v      (equation 11.19)."""
        return self._mean_square(self._delta(w))

    def projected_bellman_error(self, w: ArrayLike) -> float:
        """PBE(w) = sum_s mu(s) [projection of delta](s)^2, that on what the features can express      (11.22)."""
        basis = self._basis()[0]
        return float(((basis.T @ (self._root * self._delta(w))) ** 2).sum())

    def best_weights(self) -> Float[np.ndarray, "..."]:
        """The weights with the least VE: the projection of v_pi. Where several have it, the smallest of them."""
        basis, into = self._basis()
        known = np.where(self.mu > 0, self.values, 0)
        return self._shaped(into @ (basis.T @ (self._root * known)))

    def td_fixed_point(self) -> Float[np.ndarray, "..."]:
        """Where TD(0) ends: w = A^-1 b, A = X^T D (X - gamma P X), b = X^T D r, D = diag(mu)      (equation 9.12).

        There PBE is 0. It may be a fixed point without being reached: off-policy, TD may go away from it. Where
        features depend on each other, so that several weights have the same values, these are the smallest of them.

        Raises:
            InputError: there is none, or there are several with different values.
        """
        basis, into = self._basis()
        onward = self._root[:, None] * self._ahead(self.features @ into)
        system = np.eye(basis.shape[1]) - basis.T @ onward  # A, of what the features can express
        # Not by its condition number, which is that of different things: the least singular value beside 1.
        if system.size and np.linalg.svd(system, compute_uv=False)[-1] < SINGULAR:
            raise InputError(
                "TD has no single fixed point here: A = X^T D (X - gamma P X) is singular, for with some weights every "
                "state is worth what follows it; take gamma below 1, other features, or the policy that is learned "
                "about to act"
            )
        return self._shaped(into @ np.linalg.solve(system, basis.T @ (self._root * self.reward)))

    @property
    def _root(self) -> Float[np.ndarray, " N"]:
        return np.sqrt(self.mu)

    def _basis(self) -> tuple[Float[np.ndarray, "N k"], Float[np.ndarray, "n k"]]:
        """Orthonormal U [N, k] that span D^(1/2) X, and weights [n, k] with which D^(1/2) X is U: the smallest."""
        weighted = self._root[:, None] * self.features
        u, sizes, v = np.linalg.svd(weighted, full_matrices=False)
        kept = sizes > least_size(weighted.shape) * sizes.max(initial=0)
        return u[:, kept], v[kept].T / sizes[kept]

    def _mean_square(self, x: Float[np.ndarray, " N"]) -> float:
        return float((self.mu * np.where(self.mu > 0, x, 0) ** 2).sum())

    def _values(self, w: ArrayLike) -> Float[np.ndarray, " N"]:
        given, wanted = numbers("w", w), self._shaped(np.zeros(self.features.shape[1])).shape
        if given.shape not in (wanted, (*wanted, 1)[:2]):
            raise InputError(f"w must be the weights {list(wanted)} of the features, not {list(given.shape)}")
        return self.features @ given.reshape(-1)

    def _delta(self, w: ArrayLike) -> Float[np.ndarray, " N"]:
        v = self._values(w)
        return self.reward + self._ahead(v[:, None])[:, 0] - v

    def _ahead(self, values: Float[np.ndarray, "N k"]) -> Float[np.ndarray, "N k"]:
        """gamma P of several functions."""
        if self.policy is not None:
            values = (self.policy[:, :, None] * values.reshape(*self.policy.shape, -1)).sum(1)
        return self.onward @ values

    def _shaped(self, w: Float[np.ndarray, " n"]) -> Float[np.ndarray, "..."]:
        return w if self.policy is None else w.reshape(-1, self.policy.shape[1])


def least_size(shape: tuple[int, ...]) -> float:
    """The part of the largest below which what is left of a matrix is rounding."""
    return max(shape) * float(np.finfo(float).eps)


def linear_values(
    env: Environment,
    policy_probs: ArrayLike,
    features: ArrayLike,
    gamma: float = 1.0,
    *,
    behaviour: ArrayLike | None = None,
    of_actions: bool = False,
) -> LinearValues:
    """What is exact about the values of a policy, as a linear function of features.

    Args:
        env: an environment with `outcomes`; its time limit does not count.
        policy_probs: pi, the policy whose values they are, [S, A].
        features: x(s) of each state, [S, n].
        gamma: discount rate, in [0, 1].
        behaviour: the policy that acts, [S, A]; by default pi. It must take every action that pi does.
        of_actions: whether it is about action values, q(s, a) = x(s) . w(., a), instead of v.

    Raises:
        InputError: a policy, the features or gamma are wrong; or some value is not finite, at gamma = 1.
    """
    check_within("gamma", gamma, RATE)
    model = exact_model(env)
    pi = checked_policy(model, policy_probs)
    b = pi if behaviour is None else checked_policy(model, behaviour)
    check_coverage("linear_values", Table(pi), Table(b))
    x = numbers("features", features)
    if x.ndim != 2 or len(x) != len(pi) or not np.isfinite(x).all():
        raise InputError(
            f"features must be finite numbers of each of the {len(pi)} states, [S, n], not {list(x.shape)}"
        )
    mu = stationary_distribution(env, b)
    v = policy_values(model, pi, gamma).v
    if (s := first((mu > 0) & ~np.isfinite(v))) is not None:
        raise InputError(
            f"{name_of(env)}: from state {s[0]} this policy may go on for ever, so at gamma = 1 it has no finite value "
            "there; take gamma below 1"
        )
    leads = np.where(model.terminal, 0, gamma * model.prob)  # of each pair
    reward = (model.prob * model.reward).sum(2)
    if not of_actions:
        onward = from_state_to_state(model, pi[:, :, None] * leads)
        return LinearValues(x, mu, v, (pi * reward).sum(1), onward, None)
    from scipy import sparse  # here, because it takes 0.3 s

    states, actions, count = leads.shape
    pair = np.repeat(np.arange(states * actions), count)
    size = states * actions, states
    onward = sparse.csr_array((leads.ravel(), (pair, model.s_next.ravel())), shape=size)
    q = backup(model, np.where(np.isfinite(v), v, 0), gamma)
    weighed = (mu[:, None] * b).ravel()
    return LinearValues(np.kron(x, np.eye(actions)), weighed, q.ravel(), reward.ravel(), onward, pi)
