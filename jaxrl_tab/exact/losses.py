"""What the policies of many runs lose: the regret of each, and their mean."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.visits import Regret, regret


class Losses(NamedTuple):
    """What some policies lose against the best one, v* - v_pi from the start, and where.

    Attributes:
        lost: by each of them, float64 [n]; infinite where one may never end while rewards go on.
        exploring: the part of it that is lost by actions that are not greedy, float64 [n].
        by_action: by which actions in which states, the mean over those that lose finitely; float64 [S, A]. It adds
            up to the mean of what these have lost.
        visits: how often these are in each state, mean, float64 [S]; discounted where gamma is below 1.
        caught: in how many of the others each state is one where the policy may be caught, int [S].
    """

    lost: Float[np.ndarray, " n"]
    exploring: Float[np.ndarray, " n"]
    by_action: Float[np.ndarray, "S A"]
    visits: Float[np.ndarray, " S"]
    caught: Int[np.ndarray, " S"]

    @property
    def endless(self) -> int:
        """How many lose without bound."""
        return int(np.isinf(self.lost).sum())

    @property
    def by_state(self) -> Float[np.ndarray, " S"]:
        return self.by_action.sum(1)


def losses(env: Environment, gamma: float, policies: Iterable[tuple[np.ndarray, np.ndarray]]) -> Losses:
    """What policies lose.

    Args:
        env: an environment with `outcomes`.
        gamma: discount rate.
        policies: of each the probabilities of its actions, float [S, A], and which actions it holds for the best,
            bool [S, A].

    Raises:
        InputError: as `planning.value_iteration`.
    """
    model, (v, q) = planning.exact_model(env), planning.value_iteration(env, gamma)
    known: dict[bytes, Regret] = {}  # many seeds learn the same
    lost, exploring, found = [], [], []
    for probs, greedy in policies:
        one = known.get(key := probs.tobytes())
        if one is None:
            known[key] = one = regret(model, probs, v, q, gamma)
        found.append(one)
        lost.append(np.inf if one.caught.any() else one.by_action.sum())
        exploring.append(one.by_action.sum(where=~greedy))
    ended = [one for one in found if not one.caught.any()]
    mean = lambda arrays, like: np.mean(arrays, axis=0) if arrays else np.zeros_like(like)
    return Losses(
        np.array(lost),
        np.array(exploring),
        mean([one.by_action for one in ended], q),
        mean([one.visits for one in ended], v),
        np.sum([one.caught for one in found], axis=0, dtype=int),
    )
