"""What can be known of a method before it runs: a step size that must diverge, and the deadly triad."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrl_tab.algorithms.q_learning import QLearning
from jaxrl_tab.approx.deep import DeepQNetwork
from jaxrl_tab.approx.features import Concatenate, OneHot
from jaxrl_tab.approx.least_squares import LSTD
from jaxrl_tab.approx.observed import Features, Ranged, Rows
from jaxrl_tab.approx.off_policy import OffPolicyLinear
from jaxrl_tab.approx.semi_gradient import Linear
from jaxrl_tab.core import linear
from jaxrl_tab.core.checks import concrete
from jaxrl_tab.core.types import Environment


def step_sizes(methods: Iterable[Any], env: Environment) -> Iterator[str]:
    """A line for all step sizes of a method with some features that make errors larger in each update.

    An update of a state multiplies its error by 1 - alpha |x(s)|^2, which is larger than 1 in size where alpha is above
    2 / |x(s)|^2. Only numbers are looked at, of methods that learn about the policy that acts.
    """
    found: dict[tuple[str, Features], list[float]] = {}
    for method in methods:
        is_judged = isinstance(method, Linear) and not isinstance(method, OffPolicyLinear | LSTD)
        if not is_judged or getattr(method, "optimizer", ""):
            continue
        alpha: Any = getattr(method, "alpha", None)
        if isinstance(alpha, int | float | np.ndarray) and np.ndim(alpha) == 0:
            share = method.features.active if method.per_tiling else 1
            found.setdefault((type(method).__name__, method.features), []).append(float(alpha) / share)
    for (name, features), alphas in found.items():
        square = largest_square(features.fitted(env))
        if too_large := sorted(alpha for alpha in set(alphas) if alpha * square > 2 * (1 + 1e-6)):
            numbers = ", ".join(f"{alpha:.4g}" for alpha in too_large)
            yield (
                f"{name} must diverge with a step size of {numbers}: it is above 2 / {square:.4g} = {2 / square:.4g}, "
                f"and where |x(s)|^2 of {features} is {square:.4g}, each update then makes the error larger"
            )


def largest_square(features: Features) -> float:
    """The largest |x(s)|^2 of fitted features: of all states; where they cannot be counted, of a grid of observations.

    At its corners are those of polynomials and cosines.
    """
    if isinstance(features, OneHot):
        return 1.0
    if features.active:
        return float(features.active)
    if isinstance(features, Rows):
        return float((features.numbers**2).sum(1).max())
    ends = next(part.ends for part in _parts(features) if isinstance(part, Ranged))
    points = (5, 5, 5, 3, 3, 3)[len(ends) - 1] if len(ends) <= 6 else 2
    grid = list(itertools.islice(itertools.product(*(np.linspace(a, b, points) for a, b in ends)), 1000))
    with jax.ensure_compile_time_eval():
        every = lambda observed: linear.all_of(features(observed), features.size, jnp.result_type(float))
        return float((jax.vmap(every)(jnp.asarray(grid, float)) ** 2).sum(1).max())


def _parts(features: Features) -> tuple[Features, ...]:
    return features.parts if isinstance(features, Concatenate) else (features,)


def has_deadly_triad(method: Any) -> bool:
    """Whether the three parts of the deadly triad are there: it approximates, bootstraps, and is off-policy."""
    if isinstance(method, DeepQNetwork):
        return not _is_greedy(method)
    if not isinstance(method, Linear) or isinstance(method.features, OneHot):
        return False
    if isinstance(method, QLearning):
        return not _is_greedy(method)
    return isinstance(method, OffPolicyLinear) or getattr(method, "target", None) is not None


def _is_greedy(method: Any) -> bool:
    """Whether it acts greedily, which is what it learns about."""
    epsilon = concrete(method.epsilon)
    return method.behaviour is None and epsilon is not None and not np.any(epsilon != 0)
