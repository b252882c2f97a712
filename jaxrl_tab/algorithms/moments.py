"""Exact learning curves, without seeds: mean and covariance of what prediction has learned after each episode.

Under a fixed policy the methods of prediction change their table by what is linear in it, so that mean and second
moments obey an exact recursion (Singh and Dayan 1998, Analytical mean squared error curves for temporal difference
learning, Machine Learning 32, 5-40; see `exact.affine`). They are those of the very methods of `prediction`:

    curve = rl.moments.learning_curve(env, rl.prediction.TD(v0=0.5), num_episodes=100, alpha=[0.05, 0.1, 0.2])
    curve.mse                 # [alpha, episodes + 1]: the sum of curve.squared_bias and curve.variance
    rl.moments.best_alpha(env, rl.prediction.TD(v0=0.5), num_episodes=10)

What must be kept beside the table depends on how an episode is gone through. TD(0) and n-step TD learn on the way: the
chain goes forward, and a place in it is a state with the n - 1 before it. Monte Carlo with a constant alpha and
off-line TD(lambda) learn from returns: the chain is gone through from its end, and the return is one number more.
**On-line TD(lambda) has no such recursion** for lambda above 0: its traces are numbers of the whole episode so far, by
which the table is multiplied.

In control nothing is linear; for tiny tasks there is `control_distribution`.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrl_tab.algorithms.distribution import Distribution, control_distribution
from jaxrl_tab.algorithms.prediction import TD, MonteCarloPrediction, NStepTD, OffPolicyPrediction, TDLambda
from jaxrl_tab.core import memory
from jaxrl_tab.core.declared import of_environment, of_method
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.core.types import Environment, fitted
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.affine import NEGLIGIBLE, Arrow, Recursion

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Best", "Distribution", "LearningCurve", "best_alpha", "control_distribution", "learning_curve"]

CUT = 1e-12  # the probability of an episode up to the time limit that may be left out
SWEPT = ("alpha", "lam", "n")
METHODS = (TD, NStepTD, TDLambda, MonteCarloPrediction)  # and none that is off-policy
MOST_PLACES = 2**17  # in the chain of an episode
ROUNDS, POINTS = 5, 17  # of looking for the best alpha, and how many are tried in each


class Outcome(NamedTuple):
    """What may happen in a state: with what probability which state comes next (None: the end), and what it earns."""

    prob: float
    s_next: int | None
    reward: float


class _Task(NamedTuple):
    """The states that the policy comes to, numbered anew, and what it does there.

    Attributes:
        states: their numbers in the environment, int [S].
        start: float [S].
        outcomes: of each state.
        v: v_pi, float [S].
        gamma: discount rate.
        steps: after about so many steps next to no episode is still under way.
    """

    states: Int[np.ndarray, " S"]
    start: Float[np.ndarray, " S"]
    outcomes: list[list[Outcome]]
    v: Float[np.ndarray, " S"]
    gamma: float
    steps: float

    def error(self, s: int, reward: float, weight: float, s_next: int | None) -> float:
        """How far reward + weight v_pi(s') is from v_pi(s)."""
        return reward + (0 if s_next is None else weight * self.v[s_next]) - self.v[s]


@dataclass(frozen=True)
class LearningCurve:
    """The exact distribution, up to its second moments, of V after each episode.

    All is float64; `*grid` are the values of alpha, lambda and n that were asked for as lists, in this order, and
    `episodes` counts from 0, where V is the initial table. `state` are the states that count: those that the policy
    comes to and that are not terminal. Where alpha is so large that second moments grow without bound within an
    episode, they are infinite, and the rest is NaN.

    Attributes:
        grid: the hyperparameters that vary, each with its values.
        states: the numbers of the states, int [state].
        true_values: v_pi, [state].
        bias: E[V] - v_pi, [*grid, episodes, state].
        covariance: of V, [*grid, episodes, state, state].
        mse: the mean over states of E[(V - v_pi)^2], [*grid, episodes].
    """

    grid: dict[str, tuple]
    states: Int[np.ndarray, " state"]
    true_values: Float[np.ndarray, " state"]
    bias: Float[np.ndarray, "*grid episodes state"]
    covariance: Float[np.ndarray, "*grid episodes state state"]
    mse: Float[np.ndarray, "*grid episodes"]

    @property
    def mean(self) -> Float[np.ndarray, "*grid episodes state"]:
        """E[V]."""
        return self.true_values + self.bias

    @property
    def squared_bias(self) -> Float[np.ndarray, "*grid episodes"]:
        """The mean over states of the squared bias."""
        return (self.bias**2).mean(-1)

    @property
    def variance(self) -> Float[np.ndarray, "*grid episodes"]:
        """The mean over states of the variance of V: what is left of `mse`."""
        return np.einsum("...ii->...", self.covariance) / len(self.states)

    def to_xarray(self) -> "xr.Dataset":
        """The curve as a dataset; dimensions are those of `grid`, then episode, state, state_1."""
        import xarray as xr

        axes = (*self.grid, "episode")
        variables = {
            "mse": (axes, self.mse),
            "squared_bias": (axes, self.squared_bias),
            "variance": (axes, self.variance),
            "bias": ((*axes, "state"), self.bias),
            "covariance": ((*axes, "state", "state_1"), self.covariance),
            "true_values": (("state",), self.true_values),
        }
        coords = {
            **{name: list(x) for name, x in self.grid.items()},
            "episode": np.arange(self.mse.shape[-1]),
            "state": self.states,
        }
        return xr.Dataset(variables, coords)

    def __repr__(self) -> str:
        axes = ", ".join(f"{len(values)} {name}" for name, values in self.grid.items()) or "one setting"
        return f"<LearningCurve of {len(self.states)} states: {axes}, {self.mse.shape[-1] - 1} episodes>"


class Best(NamedTuple):
    """The alpha with the least mean squared error, and that error."""

    alpha: float
    mse: float


def learning_curve(
    env: Environment,
    method: Any,
    *,
    num_episodes: int,
    alpha: Sequence[float] | float | None = None,
    lam: Sequence[float] | float | None = None,
    n: Sequence[int] | int | None = None,
) -> LearningCurve:
    """The exact mean and covariance of V after each episode, for a grid of alpha, lambda and n at once.

    Args:
        env: an environment with `outcomes`. Where `step` adds noise to the rewards of `outcomes`, it does not count.
        method: `prediction.TD`, `NStepTD`, `TDLambda(offline=True)` or `MonteCarloPrediction`, of every visit, with a
            policy, gamma and v0. Its alpha is a number, unless `alpha` is given. (lambda = 0 need not be off-line.)
        num_episodes: how many, at least 1.
        alpha, lam, n: instead of those of the method, which has these: a number, or a list of them, which is an axis.

    How large a task may be: there are S^3 / 2 numbers for S states by TD(0) and Monte Carlo, 2 S^3 by TD(lambda), and
    b^(n - 1) times as many by n-step TD with b outcomes in each state. So 40 states take a second, 100 are about the
    most, n is at most some 10 where a coin is tossed in each state; what would take more than five minutes is refused.

    Raises:
        InputError: another method, or a schedule of alpha; the policy may not end within the time limit, which the
            recursion leaves out; the task is too large; a number is out of range.
    """
    whole(None, "num_episodes", num_episodes, 1)
    given = {name: x for name, x in {"alpha": alpha, "lam": lam, "n": n}.items() if x is not None}
    axes = {name: tuple(x) for name, x in given.items() if not np.isscalar(x)}
    for name, x in axes.items():
        if not x or len(set(x)) < len(x):
            raise InputError(f"{name} must be a number, or a list of some that are different, not {shown(x)}")
    methods = {}
    for point in itertools.product(*(axes.get(name, (given[name],)) for name in given)):
        methods[point] = _checked(method, dict(zip(given, point, strict=True)))
    first = next(iter(methods.values()))
    task = _task(env, first)
    shape = tuple(len(values) for values in axes.values())
    size = len(task.states)
    needed = 8 * len(methods) * (num_episodes + 1) * (size + 1) ** 2
    if 2 * needed > memory.free():
        raise InputError(
            f"covariances of {size} states after {num_episodes:,} episodes for {len(methods):,} settings need "
            f"{memory.words(2 * needed)}: take fewer"
        )
    moments = np.empty((len(methods), num_episodes + 1, size + 1, size + 1))
    for members in _same_recursion(list(methods.values())):
        moments[members] = _run(task, [list(methods.values())[i] for i in members], num_episodes, env)
    moments = moments.reshape(*shape, num_episodes + 1, size + 1, size + 1)
    bias, second = moments[..., -1, :-1], moments[..., :-1, :-1]
    with np.errstate(invalid="ignore"):  # infinities
        covariance = second - bias[..., :, None] * bias[..., None, :]
    mse = np.einsum("...ii->...", second) / size
    return LearningCurve(axes, task.states, task.v, bias, covariance, mse)


def best_alpha(env: Environment, method: Any, *, num_episodes: int, whole_run: bool = False) -> Best:
    """The alpha in (0, 1] with the least exact mean squared error, to some four digits, and that error.

    Args:
        env, method, num_episodes: as in `learning_curve`.
        whole_run: whether the error is the mean over the episodes from 1 on, as in figures 7.2 and 12.3 of the book, or
            that after the last one.

    It is looked for on ever finer grids, from .001 to 1 on a logarithmic scale: of several minima the one that the
    coarsest of 17 points is nearest to.
    """
    low, high = np.log(1e-3), 0.0
    best = Best(np.nan, np.inf)
    for _ in range(ROUNDS):
        alphas = np.exp(np.linspace(low, high, POINTS))
        curve = learning_curve(env, method, num_episodes=num_episodes, alpha=alphas.tolist())
        errors = curve.mse[:, 1:].mean(1) if whole_run else curve.mse[:, -1]
        errors = np.where(np.isnan(errors), np.inf, errors)
        i = int(errors.argmin())
        if errors[i] <= best.mse:
            best = Best(float(alphas[i]), float(errors[i]))
        low, high = np.log(alphas[max(i - 1, 0)]), np.log(alphas[min(i + 1, POINTS - 1)])
    return best


# --- what is asked for -------------------------------------------------------------------------------


def _checked(method: Any, values: Mapping[str, Any]) -> Any:
    """The method with these values. Raises InputError where its table has no such recursion."""
    known = isinstance(method, METHODS) and not isinstance(method, OffPolicyPrediction)
    if not known or of_method(method).features is not None:
        raise InputError(
            "there are exact learning curves of TD, NStepTD, TDLambda(offline=True) and MonteCarloPrediction, "
            f"as instances, not of {shown(method)}"
        )
    name = type(method).__name__
    for key in values:
        if not hasattr(method, key):
            raise InputError(f"{name} has no {key}", who=name, field=key)
    method = replace(method, **values)
    if not np.isscalar(method.alpha):
        raise InputError(
            f"{name}: alpha must be a number, for a schedule is not the same in every episode", field="alpha"
        )
    if isinstance(method, TDLambda) and not method.offline and method.lam > 0:
        raise InputError(
            f"{name}: the traces of on-line TD(lambda) remember the whole episode, so that its covariance has no exact "
            "recursion; offline=True (--offline) has one, and n-step TD lies between TD(0) and Monte Carlo too"
        )
    if isinstance(method, MonteCarloPrediction) and method.first_visit:
        raise InputError(
            f"{name}: which visit is the first is no matter of the last states; take first_visit=False"
        )
    return method


def _same_recursion(methods: Sequence[Any]) -> list[list[int]]:
    """The places of the methods that differ in alpha alone."""
    groups: dict[Any, list[int]] = {}
    for i, method in enumerate(methods):
        groups.setdefault((getattr(method, "lam", None), getattr(method, "n", None)), []).append(i)
    return list(groups.values())


def _task(env: Environment, method: Any) -> _Task:
    """What a policy does. Raises InputError where its episodes may last to the time limit."""
    planning.check_finite(env)
    if differs := of_environment(env).differs:
        raise InputError(f"{differs} there, so that no curve is that of all")
    model = planning.exact_model(env)
    pi = fitted(method, env).probabilities(env)
    gamma = float(method.gamma)
    reached = planning.entered(model, pi) & ~planning.terminal_states(model)
    states = np.flatnonzero(reached)
    place = {int(s): i for i, s in enumerate(states)}
    start = model.start[states]
    if not np.isclose(start.sum(), 1):
        raise InputError("an episode must not begin in a terminal state")
    chain = np.zeros((len(states), len(states)))
    outcomes: list[list[Outcome]] = [[] for _ in states]
    for i, s in enumerate(states):
        for a, k in zip(*np.nonzero((pi[s] > 0)[:, None] & (model.prob[s] > 0)), strict=True):
            p, over = float(pi[s, a] * model.prob[s, a, k]), bool(model.terminal[s, a, k])
            s_next = None if over else place[int(model.s_next[s, a, k])]
            outcomes[i].append(Outcome(p, s_next, float(model.reward[s, a, k])))
            if s_next is not None:
                chain[i, s_next] += p
    left = float((start @ np.linalg.matrix_power(chain, env.max_steps)).sum())
    if left > CUT:
        raise InputError(
            f"an episode lasts to the time limit of {env.max_steps:,} steps with probability {left:.3g}, and the exact "
            "recursion is one of episodes that end before it: take a policy that ends, or a larger max_steps"
        )
    reward = np.array([sum(o.prob * o.reward for o in each) for each in outcomes])
    v = np.linalg.solve(np.eye(len(states)) - gamma * chain, reward)
    slowest = abs(np.linalg.eigvals(chain)).max()
    steps = 1 if slowest < 1e-3 else min(float(env.max_steps), np.log(NEGLIGIBLE) / np.log(slowest))
    return _Task(states, start, outcomes, v, gamma, steps)


def _run(task: _Task, methods: Sequence[Any], num_episodes: int, env: Environment) -> np.ndarray:
    """The second moments of (V - v_pi, 1) after each episode, [methods, episodes + 1, S + 1, S + 1]."""
    alpha = np.array([method.alpha for method in methods], float)
    size, method = len(task.states), methods[0]
    v0 = np.broadcast_to(np.asarray(method.v0, float), (env.num_states, 1))[task.states, 0]
    first = np.append(v0 - task.v, 1.0)
    x = np.broadcast_to(np.outer(first, first), (len(alpha), size + 1, size + 1))
    recursion, put_in, take_out = _recursion(task, method, _More(alpha, task.steps, num_episodes))
    curve, unbounded = [x], np.full((size + 1, size + 1), np.inf)
    unbounded[-1] = unbounded[:, -1] = np.nan
    for _ in range(num_episodes):
        with np.errstate(invalid="ignore"):  # infinities
            x = take_out @ recursion(put_in @ x @ put_in.T) @ take_out.T
        x[~np.isfinite(x).all((1, 2))] = unbounded
        curve.append(x)
    return np.stack(curve, 1)


class _More(NamedTuple):
    """The last arguments of a `Recursion`."""

    alpha: Float[np.ndarray, " G"]
    steps: float
    episodes: int


def _recursion(task: _Task, method: Any, more: "_More") -> tuple[Recursion, np.ndarray, np.ndarray]:
    """An episode; what makes its vector of (V - v_pi, 1); and what makes that of its vector again."""
    if isinstance(method, MonteCarloPrediction):
        return _monte_carlo(task, more)
    if isinstance(method, TDLambda) and method.lam > 0:
        return _off_line(task, float(method.lam), more)
    return _n_step(task, getattr(method, "n", 1), more)


# --- forward: TD(0) and n-step TD --------------------------------------------------------------------

Pending = tuple[
    tuple[int, float, float], ...
]  # of each step that is still to learn: s, rewards since, weight of V


def _n_step(task: _Task, n: int, more: "_More") -> tuple[Recursion, np.ndarray, np.ndarray]:
    """A place of the chain is a state, and what the steps before it have still to learn from, as in `NStepSarsa`."""
    size, one = len(task.states) + 1, len(task.states)
    places: dict[tuple[int | None, Pending], int] = {}
    to_visit: list[tuple[int | None, Pending]] = []
    arrows: list[Arrow] = []

    def place(s: int | None, pending: Pending) -> int:
        key = s, pending
        if key not in places:
            places[key] = len(places)
            to_visit.append(key)
            if len(places) > MOST_PLACES:
                raise InputError(
                    f"n = {n} is too large here: an episode has more than {MOST_PLACES:,} pasts of {n - 1} steps"
                )
        return places[key]

    def learned(oldest: tuple[int, float, float], s_next: int | None) -> list[tuple[int, int, float]]:
        s, g, weight = oldest
        from_value = [] if s_next is None else [(s, s_next, weight)]
        return [(s, one, task.error(s, g, weight, s_next)), (s, s, -1.0), *from_value]

    over = place(None, ())
    begin = {place(int(s), ()): float(task.start[s]) for s in np.flatnonzero(task.start)}
    while to_visit:
        s, pending = to_visit.pop()
        here = places[s, pending]
        if s is None:  # the episode is over, and the steps that are left learn too, the oldest first
            if pending:
                arrows.append(Arrow(here, place(None, pending[1:]), 1.0, step=learned(pending[0], None)))
            continue
        for p, s_next, reward in task.outcomes[s]:
            discount = 0.0 if s_next is None else task.gamma
            steps = (*((i, g + w * reward, w * discount) for i, g, w in pending), (s, reward, discount))
            if s_next is not None and len(steps) < n:
                arrows.append(Arrow(here, place(s_next, steps), p))
            else:
                there = place(s_next, steps[1:])
                arrows.append(Arrow(here, there, p, step=learned(steps[0], s_next)))
    weights = np.zeros(len(places))
    weights[[*begin]] = [*begin.values()]
    count = np.zeros(len(places))
    count[over] = 1
    recursion = Recursion(size, weights, count, arrows, *more)
    return recursion, np.eye(size), np.eye(size)


# --- backward: Monte Carlo and off-line TD(lambda) ---------------------------------------------------


def _monte_carlo(task: _Task, more: "_More") -> tuple[Recursion, np.ndarray, np.ndarray]:
    """The vector is (V - v_pi, G - v_pi, 1): from the last step to the first V(s) <- V(s) + alpha (G - V(s))."""
    size = len(task.states)
    g, one = size, size + 1

    def arrow(s: int, outcome: Outcome) -> tuple[list, list]:
        _, s_next, reward = outcome
        discount = 0.0 if s_next is None else task.gamma
        error = task.error(s, reward, discount, s_next)
        base = [(g, g, discount), (g, one, error)]
        return base, [(s, g, discount), (s, one, error), (s, s, -1.0)]

    put_in = np.delete(np.eye(size + 2), g, 1)
    return _backward(task, size + 2, arrow, more), put_in, put_in.T


def _off_line(task: _Task, lam: float, more: "_More") -> tuple[Recursion, np.ndarray, np.ndarray]:
    """The vector is (what V changes by, G - v_pi, V - v_pi, 1), where G is the lambda-return by the V of the beginning.

    For the increments of accumulating traces add up to alpha (G - V(s)) of all steps (book, section 12.2).
    """
    size = len(task.states)
    g, one = size, 2 * size + 1
    value = lambda s: size + 1 + s

    def arrow(s: int, outcome: Outcome) -> tuple[list, list]:
        _, s_next, reward = outcome
        discount = 0.0 if s_next is None else task.gamma
        new = [(g, discount * lam), (one, task.error(s, reward, discount, s_next))]
        if s_next is not None:
            new.append((value(s_next), discount * (1 - lam)))
        return [(g, i, x) for i, x in new], [*((s, i, x) for i, x in new), (s, value(s), -1.0)]

    put_in, take_out = np.zeros((2 * size + 2, size + 1)), np.zeros((size + 1, 2 * size + 2))
    for s in range(size):
        put_in[value(s), s] = take_out[s, s] = take_out[s, value(s)] = 1
    put_in[one, size] = take_out[size, one] = 1
    return _backward(task, 2 * size + 2, arrow, more), put_in, take_out


def _backward(task: _Task, size: int, arrow: Any, more: "_More") -> Recursion:
    """An episode from its end: the chain goes from each state to those before it, and may have begun in any of them."""
    end = len(task.states)
    arrows = []
    for s, outcomes in enumerate(task.outcomes):
        for outcome in outcomes:
            base, step = arrow(s, outcome)
            source = end if outcome.s_next is None else outcome.s_next
            arrows.append(Arrow(source, s, outcome.prob, base, step))
    begin = np.zeros(end + 1)
    begin[end] = 1
    return Recursion(size, begin, np.append(task.start, 0.0), arrows, *more)
