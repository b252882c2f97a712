"""Importance sampling, judged: how far its averages are off, and how much a log is worth.

A return G of a behaviour policy b counts for a target policy pi with the ratio of its episode (book, equation
5.3),

    rho_{t:T-1} = pi(A_t | S_t) / b(A_t | S_t) * ... * pi(A_{T-1} | S_{T-1}) / b(A_{T-1} | S_{T-1}).

Before anything is sampled, `variance` gives the exact variance of rho and of rho G in an environment that
states its dynamics: the mean squared error after n episodes is Var(rho G) / n, or infinite. Afterwards,
`diagnose` tells from the ratios that occurred how many episodes of pi a log is worth.

    importance.variance(env, target=pi, behaviour=b).ordinary[s]
    print(importance.diagnose(experience, target=pi, behaviour=b))

All this is for people, in float64 NumPy.
"""

import warnings
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from jaxrl_tab.core.checks import RATE, check_within, first
from jaxrl_tab.core.coverage import check_coverage
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.policies import Table, as_table, check_among
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.model import Model

MARGIN = 1e-12  # a rate of growth so close to 1, relatively, is taken for 1
FEW = 10  # effective episodes


# --- the exact variance ------------------------------------------------------------------------------


class Variance(NamedTuple):
    """The exact variance of what importance sampling averages; `inf` where it is infinite.

    From each state, float64 [S], or from each state and action, float64 [S, A]. Zero at terminal states; NaN
    where an episode of the target policy may never end, and where a state does not have the action.

    Attributes:
        ratio: Var(rho), of the ratio of the whole episode.
        ordinary: Var(rho G), which ordinary importance sampling averages (book, equation 5.5).
        per_decision: Var of the return in which each reward has the ratio of the actions up to it alone,
            which per-decision importance sampling averages (book, section 5.9).
    """

    ratio: Float[np.ndarray, " S *A"]
    ordinary: Float[np.ndarray, " S *A"]
    per_decision: Float[np.ndarray, " S *A"]


def variance(env: Environment, target: Any, behaviour: Any, gamma: float = 1.0) -> Variance:
    """The variance of rho_{t:T-1} G_t given S_t = s, and of rho_{t:T-1} itself, [S] each.

    That is what one episode contributes to the estimate of v_pi(s). So after n episodes that visit s, counted
    at their first visits, the mean squared error of ordinary importance sampling is `ordinary[s]` / n.

    Warns where Var(rho G) is infinite: the average then tends to v_pi with certainty, and yet its error has
    no variance to shrink.

    Args:
        env: an environment with `outcomes`. Its time limit does not count here. Where `step` adds noise to
            the rewards of `outcomes`, the noise does not count either.
        target: pi, probabilities [S, A] or a `policies.Table` of them.
        behaviour: b, given in the same way; positive wherever pi is.
        gamma: discount rate, in [0, 1].

    Raises:
        InputError: a table is no policy or does not fit; `behaviour` leaves out an action that `target` can
            take, which the message names with its state; from a start state an episode of `target` may never
            end; `env` can only be sampled.
    """
    return _warned(_variances(env, target, behaviour, gamma)[0])


def action_variance(env: Environment, target: Any, behaviour: Any, gamma: float = 1.0) -> Variance:
    """The variance of rho_{t+1:T-1} G_t given S_t = s and A_t = a, and of rho_{t+1:T-1} itself, [S, A] each.

    That is what one episode contributes to the estimate of q_pi(s, a). The action a is given, so its own
    ratio does not count. Args, warning and errors: as `variance`.
    """
    return _warned(_variances(env, target, behaviour, gamma)[1])


def _warned(result: Variance) -> Variance:
    """`result`, with a warning where Var(rho G) is infinite."""
    infinite = np.isinf(result.ordinary)
    if (i := first(infinite)) is not None:
        where = f"state {i[0]}" if infinite.ndim == 1 else f"(s, a) = {i}"
        warnings.warn(
            f"from {where} the variance of rho G is infinite, for the squared ratio grows as fast as "
            "episodes end, or faster; take weighted importance sampling, or a one-step method",
            stacklevel=3,
        )
    return result


def _variances(env: Environment, target: Any, behaviour: Any, gamma: float) -> tuple[Variance, Variance]:
    """The variances from each state, and from each state and action.

    The law of total variance, one step after another. Let X = rho G be what is averaged from a state, and Y
    from a state and action, which is r rho' + gamma X' with the ratio rho' and the X' of the next state. With
    rho = pi / b of the first action, sums over actions and outcomes, and all variances given where one is,

        Var X = Var(rho q)        + sum of pi rho Var Y
        Var Y = Var(r + gamma v') + sum of p (r^2 Var rho' + 2 r gamma Cov(rho', X') + gamma^2 Var X')

    and likewise for Cov(rho, X) and Var rho; per decision there is no rho' beside X'. So a chain with the
    weights pi rho p carries them from step to step, times 1, gamma and gamma^2.
    """
    check_within("gamma", gamma, RATE)
    planning.check_finite(env)
    pi, b = both_policies(target, behaviour, (env.num_states, env.num_actions))
    model = planning.exact_model(env)
    if model.available is not None:
        for name, probabilities in (("target", pi), ("behaviour", b)):
            check_among(name, probabilities, model.available)
    over = planning.terminal_states(model)
    pi = np.where(over[:, None], b, pi)  # nothing is chosen there
    endless = _endless(model, pi, over)
    if (s := first(endless & (model.start > 0))) is not None:
        raise InputError(
            f"from start state {s[0]} an episode of target may never end, and so has no ratio; give a target "
            "that ends, such as a mixture with the behaviour policy"
        )
    pi = np.where(endless[:, None], 0, pi)  # left out of all sums, for no other state leads there
    rho = ratio_of_actions(pi, b)
    r, onward = model.reward, model.prob * ~model.terminal  # onward: the outcomes that do not end the episode
    chain = planning.from_state_to_state(model, pi[:, :, None] * onward)
    squared = planning.from_state_to_state(model, (pi * rho)[:, :, None] * onward)
    infinite = _infinite(model, pi, chain, squared, gamma)

    def later(weight, x):
        """The sum over outcomes of p weight x', float64 [S, A]; where the weight is 0, inf counts as 0."""
        weight = onward * weight
        return np.multiply(weight, x[model.s_next], out=np.zeros_like(weight), where=weight != 0).sum(2)

    def carried(y):
        return (pi * rho * y).sum(1)

    v = _solve(gamma * chain, (pi[:, :, None] * model.prob * r).sum((1, 2)))
    q = planning.backup(model, v, gamma)
    outcome = r + gamma * np.where(model.terminal, 0, v[model.s_next])
    of_outcome = (model.prob * (outcome - q[:, :, None]) ** 2).sum(2)
    of_rho, of_x = rho - 1, rho * q - v[:, None]  # how far the first action moves them from their means

    var_rho = _solve(squared, (b * of_rho**2).sum(1), infinite.ratio)
    finite = np.where(infinite.ratio, 0, var_rho)
    cov = _solve(gamma * squared, (b * of_rho * of_x).sum(1) + carried(later(r, finite)), infinite.ratio)
    cov[infinite.ratio] = 0  # it does not matter beside an infinite Var rho'
    mixed = of_outcome + later(r**2, finite) + 2 * gamma * later(r, cov)
    of_action = (b * of_x**2).sum(1)
    ordinary = _solve(gamma**2 * squared, of_action + carried(mixed), infinite.ordinary)
    per_decision = _solve(gamma**2 * squared, of_action + carried(of_outcome), infinite.per_decision)

    of_states = Variance(var_rho, ordinary, per_decision)
    of_actions = Variance(
        later(1, var_rho),
        of_outcome + later(r**2, var_rho) + 2 * gamma * later(r, cov) + later(gamma**2, ordinary),
        of_outcome + later(gamma**2, per_decision),
    )
    without_variance = ((onward > 0) & endless[model.s_next]).any(2)
    if model.available is not None:
        without_variance |= ~model.available
    for result, undefined in ((of_states, endless), (of_actions, without_variance)):
        for x in result:
            x[undefined] = np.nan
    return of_states, of_actions


def _infinite(model: Model, pi: Float[np.ndarray, "S A"], chain: Any, squared: Any, gamma: float) -> Variance:
    """From which states each variance is infinite, bool [S].

    That of rho is where a loop can be reached in which the squared ratio grows at least as fast as episodes
    end. Such a loop need not matter to rho G: not without any reward, nor, if all rewards come after it,
    where gamma shrinks them fast enough. (Rewards that cancel exactly, on all paths, count as not 0.)
    """
    rewarded = (pi[:, :, None] * model.prob > 0) & (model.reward != 0)
    ratio = _reaching(chain, _growing(squared))
    growing = _growing(gamma**2 * squared) & _reaching(chain, rewarded.any((1, 2)))
    before = (rewarded & ~model.terminal & ratio[model.s_next]).any((1, 2))  # r^2 Var rho' is infinite
    return Variance(ratio, _reaching(gamma * chain, growing | before), _reaching(chain, growing))


def _endless(model: Model, pi: Float[np.ndarray, "S A"], over: Bool[np.ndarray, " S"]):
    """The states from which an episode of `pi` may never end, bool [S]."""
    chance = pi[:, :, None] * model.prob
    chain = planning.from_state_to_state(model, chance * ~model.terminal)
    ending = over | (chance * model.terminal).any((1, 2))
    return _reaching(chain, ~_reaching(chain, ending))


def _reaching(chain: Any, states: Bool[np.ndarray, " S"]) -> Bool[np.ndarray, " S"]:
    """The states from which a chain may come to these, bool [S], and these."""
    steps = chain.tocoo()
    possible = steps.data > 0
    return planning.spread(steps.col[possible], steps.row[possible], states)


def _growing(chain: Any) -> Bool[np.ndarray, " S"]:
    """The states in loops of a weighted chain whose weights do not die out, bool [S].

    In a strongly connected set of states they do if its spectral radius is below 1. That is so if and only if
    1 + C + C^2 + ... is finite, so that x = 1 + C x has a solution without negative entries.
    """
    from scipy import sparse  # here, because it takes 0.3 s
    from scipy.sparse.csgraph import connected_components

    _, component = connected_components(chain, connection="strong")
    steps = chain.tocoo()
    inside = component[steps.row] == component[steps.col]
    entries = steps.data[inside], (steps.row[inside], steps.col[inside])
    loops = sparse.csc_array(entries, shape=chain.shape)
    x = planning.sparse_solver((1 + MARGIN) * loops)(np.ones(len(component)))
    return np.isin(component, component[~(x > 0)])


def _solve(chain: Any, constant: Float[np.ndarray, " S"], infinite: Any = False):
    """Solves x = constant + chain x, float64 [S]; inf where `infinite`, to which no other state leads."""
    x = np.full(len(constant), np.inf)
    finite = np.flatnonzero(~np.broadcast_to(infinite, x.shape))
    x[finite] = planning.sparse_solver(chain[finite][:, finite])(constant[finite])
    return x


# --- the ratios that occurred ------------------------------------------------------------------------


class Diagnosis(NamedTuple):
    """What a log of a behaviour policy is worth for a target policy.

    Attributes:
        episodes: how many there are.
        effective_sample_size: how many episodes of the target policy they are worth.
        largest_ratio: of an episode.
        mean_ratio: over all episodes. Its expectation is 1; where it is far below, the large ratios that make
            up for it have not occurred yet, and the effective sample size is still too good.
        standard_error: of `mean_ratio`; NaN for a single episode.
    """

    episodes: int
    effective_sample_size: float
    largest_ratio: float
    mean_ratio: float
    standard_error: float

    def __str__(self) -> str:
        return (
            f"{self.episodes} episodes, worth {self.effective_sample_size:.4g} of the target policy; largest "
            f"ratio {self.largest_ratio:.4g}; mean ratio {self.mean_ratio:.4g} +- {self.standard_error:.2g} "
            "(expected: 1)"
        )


def ratios(experience: Experience, target: Any, behaviour: Any) -> Float[np.ndarray, " E"]:
    """The ratio rho_{0:T-1} of each episode of a log, float64 [E] (book, equation 5.3).

    Args:
        experience: the log; see `Experience.from_episodes`. Where an episode was cut short, the ratio is that
            of its actions so far.
        target: pi, probabilities [S, A] or a `policies.Table` of them.
        behaviour: b, which acted, given in the same way; positive wherever pi is.

    Raises:
        InputError: a table is no policy, or they differ in shape; `behaviour` leaves out an action that
            `target` takes, or that the log holds; the log holds a state or action that they do not know.
    """
    if not isinstance(experience, Experience):
        raise InputError(
            f"experience must be an Experience, as Experience.from_episodes or collect give it, not "
            f"{type(experience).__name__}"
        )
    pi, b = both_policies(target, behaviour)
    experience.check(*b.shape, behaviour=Table(b))
    rho = ratio_of_actions(pi, b)[experience.s, experience.a]
    ends = np.flatnonzero(experience.last)
    return np.multiply.reduceat(rho, np.append(0, ends[:-1] + 1))


def effective_sample_size(ratios: ArrayLike) -> float:
    """(sum w)^2 / sum w^2: how many samples of equal weight make as sure a mean (Kong 1992).

    From 1, where one ratio outweighs all others, to E, where all are equal; 0 where all are 0.

    Raises:
        InputError: `ratios` are not numbers [E] of 0 or more, at least one.
    """
    w = np.asarray(ratios)
    if w.ndim != 1 or not w.size or w.dtype.kind not in "iuf" or not (np.isfinite(w) & (w >= 0)).all():
        raise InputError(f"ratios must be finite numbers [E] of 0 or more, at least one, not {shown(w)}")
    if not w.any():
        return 0.0
    w = w / w.max()  # so that no square overflows
    return float(w.sum() ** 2 / (w**2).sum())


def diagnose(experience: Experience, target: Any, behaviour: Any) -> Diagnosis:
    """What a log of `behaviour` is worth for learning about `target`, to print.

    Warns where that is fewer than ten episodes, and less than half of those that there are.

    Args and errors: as `ratios`.
    """
    w = ratios(experience, target, behaviour)
    n, worth = len(w), effective_sample_size(w)
    if worth < min(FEW, n / 2):
        warnings.warn(
            f"{n} episodes are worth only {worth:.2g} of the target policy, for a few ratios outweigh all "
            "others; take more episodes, a behaviour policy closer to the target, or a one-step method",
            stacklevel=2,
        )
    error = w.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    return Diagnosis(n, worth, float(w.max()), float(w.mean()), float(error))


# --- policies ----------------------------------------------------------------------------------------


def both_policies(
    target: Any, behaviour: Any, shape: tuple[int, int] | None = None
) -> tuple[Float[np.ndarray, "S A"], Float[np.ndarray, "S A"]]:
    """The probabilities of both policies, float64, checked; of this shape, or else both of the same."""
    b = as_table("behaviour", behaviour, shape)
    pi = as_table("target", target, b.probabilities.shape)
    check_coverage("importance sampling", pi, b)
    pi, b = (np.asarray(table.probabilities, np.float64) for table in (pi, b))
    return pi / pi.sum(1, keepdims=True), b / b.sum(1, keepdims=True)


def ratio_of_actions(pi: Float[np.ndarray, "S A"], b: Float[np.ndarray, "S A"]) -> Float[np.ndarray, "S A"]:
    """pi / b; 0 where both are 0."""
    return np.divide(pi, b, out=np.zeros_like(b), where=b > 0)
