"""Garnets: tasks that are drawn (Archibald, McKinnon and Thomas 1995; Bhatnagar, Sutton, Ghavamzadeh and Lee 2009)."""

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart
from jaxrl_tab.envs.finite_mdp import FiniteMDP, drawn


@pytree
class Garnet(FixedStart):
    """A task that is drawn at random and does not end: a Generalized Average Reward Non-stationary Environment Testbed.

    Each action leads from each state to some different states, drawn from all. How probable they are is given by the
    pieces of a stick that is broken at random places; the reward of the action is drawn from N(0, 1). Episodes start
    in state 0. (What is non-stationary, states that are drawn anew while a run goes on, is left out, as it mostly is.)

    All runs have the task of this `number`, or, with `own`, each draws its own from its key.
    """

    states: int = static(default=30, at_least=2, help="Number of states.")
    actions: int = static(default=4, at_least=2, help="Number of actions.")
    branching: int = static(default=2, at_least=1, help="To how many states an action may lead.")
    number: int = static(default=0, at_least=0, help="Which task it is: its seed.")
    own: bool = static(default=False, help="Whether each run draws a task of its own.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    start_state = 0
    continuing = True

    def __post_init__(self):
        if self.branching > self.states:
            problem = f"branching must be at most the number of states, {self.states}, not {self.branching}"
            raise InputError(problem, who=type(self).__name__, field="branching")

    @property
    def num_states(self) -> int:
        return self.states

    @property
    def num_actions(self) -> int:
        return self.actions

    @property
    def instance(self) -> Callable[[Key[Array, ""]], FiniteMDP] | None:
        return self._drawn if self.own else None

    def _drawn(self, key: Key[Array, ""]) -> FiniteMDP:
        """A task of the same sizes, drawn from `key`."""
        shape = self.states, self.actions
        keys = jax.random.split(key, 3)
        numbers = (
            jax.random.uniform(keys[0], (*shape, self.branching)),
            jax.random.uniform(keys[1], (*shape, self.branching - 1)),
            jax.random.normal(keys[2], shape),
        )
        return drawn(*_task(jnp, self.states, *numbers), max_steps=self.max_steps)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        s_next, prob, reward = _of_seed(self.states, self.actions, self.branching, self.number)
        prob, reward = (jnp.asarray(x, float)[s, a] for x in (prob, reward))
        return prob, Outcome(jnp.asarray(s_next)[s, a], reward, jnp.zeros(self.branching, bool))


@functools.lru_cache(maxsize=16)
def _of_seed(
    states: int, actions: int, branching: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng, shape = np.random.default_rng(seed), (states, actions)
    numbers = rng.random((*shape, branching)), rng.random((*shape, branching - 1)), rng.standard_normal(shape)
    return _task(np, states, *numbers)


def _task(xp: Any, states: int, where: Any, cuts: Any, mean: Any) -> tuple[Any, Any, Any]:
    """s', their probabilities and their rewards, [S, A, K] each, from random numbers [S, A, K], [S, A, K - 1], [S, A].

    All but the last are from 0 to 1. Numbers are put in order one by one, for there are few, and `lanes` sorts no more.
    """
    s_next: list[Any] = []
    for k in range(where.shape[-1]):  # one of those states that are left
        s = xp.minimum(xp.floor(where[..., k] * (states - k)), states - k - 1).astype(np.int32)
        for taken in s_next:
            s = s + (s >= taken).astype(np.int32)
        s_next = _inserted(xp, s_next, s)
    ends: list[Any] = [xp.zeros(mean.shape, cuts.dtype)]
    for k in range(cuts.shape[-1]):
        ends = _inserted(xp, ends, cuts[..., k])
    prob = xp.stack([b - a for a, b in itertools.pairwise([*ends, xp.ones(mean.shape, cuts.dtype)])], -1)
    return xp.stack(s_next, -1), prob, xp.broadcast_to(mean[..., None], prob.shape)


def _inserted(xp: Any, in_order: list[Any], x: Any) -> list[Any]:
    """The arrays, in order entry by entry, with one more."""
    larger = []
    for y in in_order:
        larger.append(xp.minimum(y, x))
        x = xp.maximum(y, x)
    return [*larger, x]
