"""What a log says about a policy that did not act (off-policy evaluation), and about the one that did (LSTD).

    log = rl.collect(key, b, env, num_steps=100_000)
    print(rl.evaluation.doubly_robust(log, target=pi, behaviour=b))      # its value from the start, with an interval
    rl.evaluation.importance_sampling(log, pi, b, weighted=True)
    rl.evaluation.lstd(log, num_states)                                  # v of the policy that acted, [S]
    rl.evaluation.lstdq(log, pi)                                         # q of any policy, from steps alone, [S, A]

`importance.diagnose` tells how much of such a log is left after its ratios.

**How sure.** Episodes are what is independent of each other, so they are the unit. Of a plain mean over episodes the
interval is `stats.mean_interval`; of a weighted one, a ratio of means, a bootstrap over episodes, or of very many the
normal one with the standard error of the linearised ratio. In a small task (600 logs of 20 and of 100 episodes) such
95% intervals held the true value in 92 to 96 of 100 logs, whichever the estimator. None knows of an episode with a huge
ratio that has not occurred: where `importance.diagnose` finds few effective episodes, neither estimate nor interval
means much.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from jaxrl_tab.core import memory
from jaxrl_tab.core.checks import FRACTION, RATE, check_within
from jaxrl_tab.core.errors import InputError, whole
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.policies import Table, as_table
from jaxrl_tab.exact.given import numbers
from jaxrl_tab.exact.importance import both_policies, ratio_of_actions
from jaxrl_tab.exact.values import sparse_solver


class Estimate(NamedTuple):
    """The value of a policy from the start, as a log has it.

    Attributes:
        value: the estimate.
        standard_error: of it; NaN for a single episode.
        low, high: an interval that holds the true value, as often as was asked for, see above.
        episodes: how many there were.
    """

    value: float
    standard_error: float
    low: float
    high: float
    episodes: int

    def __str__(self) -> str:
        return (
            f"{self.value:.4g} +- {self.standard_error:.2g}, from {self.low:.4g} to {self.high:.4g}; "
            f"{self.episodes} episodes"
        )


# --- another policy than the one that acted -----------------------------------------------------------


def importance_sampling(
    experience: Experience,
    target: Any,
    behaviour: Any,
    gamma: float = 1.0,
    *,
    weighted: bool = False,
    per_decision: bool = False,
    confidence: float = 0.95,
) -> Estimate:
    """The value of a policy from the start, by importance sampling (book, sections 5.5 and 5.9).

    Each return counts with the ratio of its episode; or, per decision, each reward with the ratio of the actions up to
    it alone, which varies less. Weighted, ratios are divided by their sum instead of by the number of episodes (per
    decision, those of each step): that is biased, less and less so with more episodes, and varies far less.

    Args:
        experience: a log of whole episodes. Of one that was cut short only what it had earned counts.
        target: pi, probabilities [S, A] or a `policies.Table` of them.
        behaviour: b, which acted, given in the same way; positive wherever pi is.
        gamma: discount rate, in [0, 1].
        weighted, per_decision: see above.
        confidence: of the interval, between 0 and 1.

    Raises:
        InputError: as `importance.ratios`; or a number is out of range.
    """
    log = _padded(experience, target, behaviour, gamma)
    if per_decision:
        return _estimate(log.ratio, log.discount * log.reward, weighted, confidence)
    returns = (log.discount * log.reward).sum(1, keepdims=True)
    return _estimate(log.ratio[:, -1:], returns, weighted, confidence)


def doubly_robust(
    experience: Experience,
    target: Any,
    behaviour: Any,
    gamma: float = 1.0,
    *,
    q: ArrayLike | None = None,
    weighted: bool = False,
    confidence: float = 0.95,
) -> Estimate:
    """The value of a policy from the start, by a guess of its values and what the log says is wrong with it.

    With a guess q of the action values of pi, v(s) = sum_a pi(a | s) q(s, a), and rho_t the ratio of the actions up to
    step t, it is the mean over episodes of

        sum_t gamma^t (rho_{t-1} v(S_t) + rho_t (R_{t+1} - q(S_t, A_t)))

    (Jiang and Li 2016, Doubly robust off-policy value evaluation for reinforcement learning). It is unbiased whatever q
    is, and varies the less the better q is; with q = 0 it is per-decision importance sampling. Weighted, the ratios of
    each step are divided by their mean (Thomas and Brunskill 2016, Data-efficient off-policy policy evaluation for
    reinforcement learning, equation 8): not unbiased, and often the best of all.

    Args:
        experience: a log of whole episodes. What an episode that was cut short would still have earned is v of its last
            state.
        target, behaviour, gamma, confidence: as in `importance_sampling`.
        q: the guess, [S, A]. By default it comes from the log itself, by `lstdq`: for every other episode from the
            rest, so that no episode judges its own guess, which would bias it.
        weighted: see above.

    Raises:
        InputError: as `importance_sampling`; or `q` is no such table.
    """
    log = _padded(experience, target, behaviour, gamma)
    pi, _ = both_policies(target, behaviour)
    guesses = _guesses(experience, log.episode, pi, gamma) if q is None else [_table(q, pi.shape)] * 2
    acted, values = np.zeros_like(log.reward), np.zeros_like(log.ratio)
    begin = np.arange(len(log.reward)) % 2  # which guess is that of an episode
    for half, guess in enumerate(guesses):
        v = (pi * guess).sum(1)
        steps = begin[log.episode] == half
        at = log.episode[steps], log.step[steps]
        acted[at] = guess[experience.s[steps], experience.a[steps]]
        values[at] = v[experience.s[steps]]
        cut = steps & experience.last & ~experience.terminal
        values[log.episode[cut], log.step[cut] + 1] = v[experience.s_next[cut]]
    before = np.ones_like(log.ratio)
    before[:, 1:] = log.ratio[:, :-1]
    amounts = [log.discount * values, log.discount * (log.reward - acted)]
    return _estimate(np.hstack([before, log.ratio]), np.hstack(amounts), weighted, confidence)


class _Log(NamedTuple):
    """A log as E episodes of T steps, with nothing after the end of each; the last step is one more than any has.

    Attributes:
        episode, step: where each transition of the log is, int [N].
        reward: [E, T].
        ratio: of the actions up to a step, [E, T]; after the end it stays what it was.
        discount: gamma^t, [T].
    """

    episode: Int[np.ndarray, " N"]
    step: Int[np.ndarray, " N"]
    reward: Float[np.ndarray, "E T"]
    ratio: Float[np.ndarray, "E T"]
    discount: Float[np.ndarray, " T"]


def _padded(experience: Experience, target: Any, behaviour: Any, gamma: float) -> _Log:
    check_within("gamma", gamma, RATE)
    pi, b = both_policies(target, behaviour)
    _check_log(experience, len(b), b.shape[1], Table(b))
    episode = np.append(0, np.cumsum(experience.last)[:-1])
    first = np.append(0, np.flatnonzero(experience.last)[:-1] + 1)
    step = np.arange(len(episode)) - first[episode]
    shape = len(first), int(step.max()) + 2
    if 64 * shape[0] * shape[1] > memory.free():
        raise InputError(
            f"{shape[0]:,} episodes of up to {shape[1]:,} steps do not fit in memory; take fewer"
        )
    reward, rho = np.zeros(shape), np.ones(shape)
    reward[episode, step] = experience.r
    rho[episode, step] = ratio_of_actions(pi, b)[experience.s, experience.a]
    return _Log(episode, step, reward, rho.cumprod(1), gamma ** np.arange(shape[1]))


def _check_log(experience: Any, num_states: int, num_actions: int, behaviour: Table | None = None) -> None:
    if not isinstance(experience, Experience):
        raise InputError(f"experience must be an Experience, not {type(experience).__name__}")
    experience.check(num_states, num_actions, behaviour)


def _guesses(experience: Experience, episode: np.ndarray, pi: np.ndarray, gamma: float) -> list[np.ndarray]:
    """The guess for each half of the episodes, from the other half; 0 where it knows nothing."""
    others = [episode % 2 != half for half in (0, 1)]
    return [np.nan_to_num(_lstdq(experience, kept, pi, gamma), nan=0.0) for kept in others]


def _table(q: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    table = numbers("q", q)
    if table.shape != shape or not np.isfinite(table).all():
        raise InputError(f"q must be finite action values {list(shape)}, not of shape {list(table.shape)}")
    return table


def _estimate(
    weight: Float[np.ndarray, "E C"], amount: Float[np.ndarray, "E C"], weighted: bool, confidence: float
) -> Estimate:
    """The sum over C columns of the mean over episodes of weight times amount, or of the weighted mean."""
    import xarray as xr  # these take a second

    from jaxrl_tab import stats
    from jaxrl_tab.stats import bootstrap

    check_within("confidence", confidence, FRACTION)
    episodes, earned = len(weight), weight * amount
    if not weighted:
        mean, low, high, _ = stats.mean_interval(
            xr.DataArray(earned.sum(1), dims="seed"), confidence=confidence
        )
        error = earned.sum(1).std(ddof=1) / np.sqrt(episodes) if episodes > 1 else np.nan
        return Estimate(float(mean), float(error), float(low), float(high), episodes)
    mean_weight = weight.mean(0)
    mean = _ratio_of_means(earned.mean(0), mean_weight)
    of = lambda w: _ratio_of_means(w @ earned, w @ weight).sum(-1) - mean.sum()
    linear = _ratio_of_means(earned - weight * mean, mean_weight).sum(1)  # what an episode adds to the ratios
    error = linear.std(ddof=1) / np.sqrt(episodes) if episodes > 1 else np.nan
    value, (low, high) = mean.sum(), bootstrap.statistic_bounds(of, episodes, error, confidence)
    return Estimate(float(value), float(error), float(value + low), float(value + high), episodes)


def _ratio_of_means(over: np.ndarray, under: np.ndarray) -> np.ndarray:
    """over / under; 0 where no ratio is above 0."""
    return np.divide(over, under, out=np.zeros(np.broadcast(over, under).shape), where=under > 0)


# --- from steps alone ---------------------------------------------------------------------------------


def lstd(
    experience: Experience, num_states: int, gamma: float = 1.0, lam: float = 0.0
) -> Float[np.ndarray, " S"]:
    """The values of the policy that acted, by least-squares temporal differences: LSTD(lambda), float64 [S].

    They are where the increments of TD(lambda), added up over the whole log, are 0: what batch TD(lambda) converges to,
    without a step size (Bradtke and Barto 1996; Boyan 2002; book, sections 6.3 and 9.8). Of a table, lambda = 0 gives
    the values of the chain that the log makes most likely, the certainty-equivalence estimate; lambda = 1 gives the
    mean of the returns that followed each visit, as Monte Carlo does.

    Args:
        experience: the log. An episode that was cut short is thought to go on from its last state.
        num_states: S, the number of states of the task, terminal ones included.
        gamma: discount rate, in [0, 1].
        lam: lambda, in [0, 1]. Above 0 it takes some microseconds for each step of the log.

    Returns:
        The values; 0 for states that the log says to be terminal, NaN for others from which it holds no step (which
        count as 0 where they are entered).

    Raises:
        InputError: a number is out of range, the log holds other states; or gamma is 1 and from some state in it the
            log never comes to an end, so that there is no one answer.
    """
    num_states = whole("lstd", "num_states", num_states)
    if 24 * num_states**2 > memory.free():
        raise InputError(f"the system of {num_states:,} states does not fit in memory")
    system, constant = lstd_system(experience, num_states, gamma, lam)
    seen = np.isin(np.arange(num_states), experience.s)
    v = np.full(num_states, np.nan)
    v[experience.s_next[experience.terminal]] = 0
    try:
        v[seen] = np.linalg.solve(system[np.ix_(seen, seen)], constant[seen])
    except np.linalg.LinAlgError:
        raise InputError(
            "lstd: from some state the log never comes to an end, so at gamma = 1 there is no one answer; take gamma "
            "below 1, or a longer log"
        ) from None
    return v


def lstd_system(
    experience: Experience, num_states: int, gamma: float = 1.0, lam: float = 0.0
) -> tuple[Float[np.ndarray, "S S"], Float[np.ndarray, " S"]]:
    """A [S, S] and b [S] of LSTD(lambda), float64: the values that it gives solve A v = b.

    With the accumulating trace z of TD(lambda), A is the sum over steps of z (x(S) - gamma' x(S'))^T, where x(s) is 1
    in state s and gamma' is 0 where S' is terminal, and b that of z R. So those of several logs can be added. Args
    and errors: as `lstd`.
    """
    check_within("gamma", gamma, RATE)
    check_within("lam", lam, RATE)
    num_states = whole("lstd", "num_states", num_states)
    _check_log(experience, num_states, int(np.max(experience.a, initial=0)) + 1)
    system, constant = np.zeros((num_states, num_states)), np.zeros(num_states)
    onward = gamma * ~experience.terminal
    if lam == 0:
        np.add.at(system, (experience.s, experience.s), 1)
        np.subtract.at(system, (experience.s, experience.s_next), onward)
        np.add.at(constant, experience.s, experience.r)
        return system, constant
    steps = zip(experience.s, experience.r, experience.s_next, onward, experience.last, strict=True)
    z = np.zeros(num_states)
    for s, r, s_next, discount, last in steps:
        z[s] += 1
        system[:, s] += z
        system[:, s_next] -= discount * z
        constant += r * z
        z *= 0 if last else gamma * lam
    return system, constant


def lstdq(experience: Experience, target: Any, gamma: float = 1.0) -> Float[np.ndarray, "S A"]:
    """The action values of any policy, by least squares from the steps of a log: LSTDQ, float64 [S, A].

    Of a table they are those in the task that the log makes most likely: each outcome as often as it occurred, each
    reward its mean (Lagoudakis and Parr 2003, section 5.2). Steps need no ratios, so what acted need not be known, and
    may have changed.

    Args:
        experience: the log; transitions in no order will do.
        target: pi, probabilities [S, A] or a `policies.Table` of them.
        gamma: discount rate, in [0, 1].

    Returns:
        The values; 0 in states that the log says to be terminal, NaN for other pairs that it does not hold, which count
        as 0 where pi takes them; NaN everywhere if gamma is 1 and from some state that it holds pi never ends.

    Raises:
        InputError: `target` is no policy, or the log holds a state or action that it does not know.
    """
    check_within("gamma", gamma, RATE)
    pi = np.asarray(as_table("target", target).probabilities, float)
    _check_log(experience, *pi.shape)
    q = _lstdq(experience, np.ones(len(experience.s), bool), pi, gamma)
    q[experience.s_next[experience.terminal]] = 0
    return q


def _lstdq(
    experience: Experience, kept: Bool[np.ndarray, " N"], pi: Float[np.ndarray, "S A"], gamma: float
) -> Float[np.ndarray, "S A"]:
    """The same from some of the steps, without checks."""
    from scipy import sparse  # here, because it takes 0.3 s

    states, actions = pi.shape
    pair = (experience.s * actions + experience.a)[kept]
    count = np.bincount(pair, minlength=pi.size)
    each = np.maximum(count, 1)
    reward = np.bincount(pair, experience.r[kept], pi.size) / each
    entries = gamma * ~experience.terminal[kept] / each[pair], (pair, experience.s_next[kept])
    onward = sparse.csr_array(entries, shape=(pi.size, states))
    choice = pi.ravel(), (np.repeat(np.arange(states), actions), np.arange(pi.size))
    mean = sparse.csr_array(choice, shape=(states, pi.size))
    v = sparse_solver(mean @ onward)(mean @ reward)
    return np.where(count > 0, reward + onward @ v, np.nan).reshape(pi.shape)
