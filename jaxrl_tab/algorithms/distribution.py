"""The exact distribution over what a method has learned in a tiny task: all that may happen, and how probable it is.

No recursion helps in control, where what is learned decides what is done. But where episodes are short and outcomes
few, all runs can be gone through: step by step, and runs in which the learner and the state have become the same, to
the last bit, go on as one. What is gone through is the method itself, its `update`, with every draw instead of one.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrl_tab.algorithms.every_draw import no_words, over_draws
from jaxrl_tab.core import memory
from jaxrl_tab.core.clock import Schedule
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.core.types import Environment, Transition, fitted, init_learner
from jaxrl_tab.exact import planning

MOST = 2**17  # learners that may be told apart


class Distribution(NamedTuple):
    """What a method may have learned.

    Attributes:
        prob: how probable each table is, float64 [N], the most probable first; they add up to 1.
        q: the tables, float [N, S, A]; no two are the same.
    """

    prob: Float[np.ndarray, " N"]
    q: Float[np.ndarray, "N S A"]

    @property
    def mean(self) -> Float[np.ndarray, "S A"]:
        """E[Q], float64."""
        return np.tensordot(self.prob, self.q.astype(float), 1)

    @property
    def variance(self) -> Float[np.ndarray, "S A"]:
        """Var Q, float64."""
        return np.tensordot(self.prob, (self.q.astype(float) - self.mean) ** 2, 1)


def control_distribution(env: Environment, method: Any, *, num_episodes: int) -> Distribution:
    """The exact distribution over Q after so many episodes, of any method in a tiny task such as a bandit.

    It is that of `train`, with numbers as there (in float32, unless JAX is told otherwise); but draws have their
    probabilities, where those of `train` are right to 2^-24.

    Args:
        env: an environment with `outcomes`. Where `step` adds noise to the rewards of `outcomes`, it does not count.
        method: a method for one run, such as `rl.QLearning(alpha=0.5)`.
        num_episodes: how many, at least 1.

    Raises:
        InputError: there are more than 131 072 learners to tell apart, where the task is not tiny or its episodes may
            be long; the method starts episodes anywhere, or draws in another way than by `policies`.
    """
    whole(None, "num_episodes", num_episodes, 1)
    planning.check_finite(env)
    if not hasattr(method, "update") or isinstance(method, type):
        raise InputError(f"method must be an instance such as QLearning(), not {shown(method)}")
    if of_method(method).exploring_starts:
        raise InputError("a method that starts episodes anywhere has no such distribution")
    model = planning.exact_model(env)
    method = fitted(method, env)
    begin = jax.jit(jax.vmap(partial(_begin, method)))
    step = jax.jit(jax.vmap(partial(_step, method, jax.tree.map(jnp.asarray, model[:4]))))
    keeps_time = any(
        isinstance(x, Schedule) for x in jax.tree.leaves(method, is_leaf=lambda x: isinstance(x, Schedule))
    )
    learners = jax.tree.map(lambda x: np.asarray(x)[None], init_learner(method, env))
    prob = np.ones(1)
    starts = np.flatnonzero(model.start)
    for _ in range(num_episodes):
        learners, states, prob = _times(learners, starts, prob, model.start[starts])
        chance, actions = _at(begin, learners, states)
        (learners, states), actions, prob = _spread((learners, states), prob, chance, actions)
        learners, prob = _episode(step, keeps_time, env.max_steps, (learners, states, actions), prob)
    (q,), prob = _merged((np.asarray(learners.q),), prob)
    order = np.argsort(-prob, kind="stable")
    return Distribution(prob[order] / prob.sum(), q[order])


def _episode(
    step: Any, keeps_time: bool, max_steps: int, runs: Any, prob: np.ndarray
) -> tuple[Any, np.ndarray]:
    """The learners at the end of an episode that has begun: `runs` are learners, states and actions."""
    ended: list[Any] = []
    for time in range(max_steps):
        cut = np.full(len(prob), time + 1 == max_steps)
        chance, found = _at(step, *runs, cut)
        _, (learners, states, actions, last), prob = _spread((), prob, chance, found)
        if not keeps_time and hasattr(
            learners, "clock"
        ):  # nothing goes by it, and it would tell learners apart
            learners = learners._replace(clock=jax.tree.map(np.zeros_like, learners.clock))
        ended.append(_merged(_where(learners, last), prob[last]))
        runs, prob = _merged(_where((learners, states, actions), ~last), prob[~last])
        if not len(prob):
            break
    parts, probs = zip(*ended, strict=True)
    return _merged(jax.tree.map(lambda *x: np.concatenate(x), *parts), np.concatenate(probs))


def _begin(method: Any, learner: Any, s: Any) -> Any:
    """How an episode begins: all first actions."""
    return over_draws(lambda: method.policy(no_words(), learner, s))


def _step(method: Any, model: Any, learner: Any, s: Any, a: Any, cut: Any) -> Any:
    """All that may come of a step: of each outcome, and of each draw of the method."""
    prob, s_next, reward, terminal = (x[s, a] for x in model)

    def of_outcome(p: Any, s_next: Any, r: Any, over: Any) -> Any:
        gamma = jnp.asarray(method.gamma, learner.q.dtype)
        last = over | cut
        t = Transition(s, a, r.astype(learner.q.dtype), s_next, jnp.where(over, 0, gamma), last)
        chance, (after, a_next) = over_draws(lambda: method.update(no_words(), learner, t))
        a_next = jnp.where(last, 0, a_next)  # nobody takes it
        same = jnp.broadcast_to
        return p * chance, (after, same(s_next, chance.shape), a_next, same(last, chance.shape))

    found = jax.vmap(of_outcome)(prob, s_next, reward, terminal)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), found)


def _at(function: Any, *arguments: Any) -> Any:
    """`function` of many, filled up to a power of 8, so that few programs are compiled."""
    count = len(arguments[-1])
    size = 1
    while size < count:
        size *= 8
    fill = lambda x: np.concatenate([x, np.broadcast_to(x[:1], (size - count, *x.shape[1:]))])
    found = function(*jax.tree.map(fill, arguments))
    return jax.tree.map(lambda x: np.asarray(x)[:count], found)


def _times(learners: Any, starts: np.ndarray, prob: np.ndarray, start: np.ndarray) -> Any:
    """Each learner in each start state."""
    count = len(prob)
    learners = jax.tree.map(lambda x: np.repeat(x, len(starts), 0), learners)
    return learners, np.tile(starts.astype(np.int32), count), np.outer(prob, start).ravel()


def _spread(kept: Any, prob: np.ndarray, chance: np.ndarray, found: Any) -> Any:
    """What may come of each of many, [N, P], as one list, without what cannot happen."""
    chance = chance.astype(float)
    chance /= chance.sum(1, keepdims=True)
    which, way = np.nonzero(chance)
    each = sum(x.nbytes for x in jax.tree.leaves(found)) // chance.size
    if len(which) > 8 * MOST or len(which) * each > memory.free() // 4:
        raise _too_many()
    take = lambda x: x[which, way]
    return jax.tree.map(lambda x: x[which], kept), jax.tree.map(take, found), prob[which] * chance[which, way]


def _where(tree: Any, chosen: np.ndarray) -> Any:
    return jax.tree.map(lambda x: x[chosen], tree)


def _merged(tree: Any, prob: np.ndarray) -> tuple[Any, np.ndarray]:
    """Those that are the same to the last bit as one."""
    if not len(prob):
        return tree, prob
    parts = []
    for x in jax.tree.leaves(tree):
        plain = x + 0 if x.dtype.kind == "f" else x  # -0 is 0
        parts.append(np.ascontiguousarray(plain).reshape(len(prob), -1).view(np.uint8))
    rows = np.concatenate(parts, 1)
    _, first, of = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    if len(first) > MOST:
        raise _too_many()
    return _where(tree, first), np.bincount(of.ravel(), prob)


def _too_many() -> InputError:
    return InputError(
        f"there are more than {MOST:,} learners to tell apart: take fewer episodes, or a task with fewer outcomes and "
        "shorter episodes"
    )
