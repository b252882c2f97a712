"""Weighted double Q-learning: between Q-learning and double Q-learning (Zhang, Pan and Kochenderfer 2017)."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxrl_tab.algorithms.double import DoubleControl, DoubleState
from jaxrl_tab.core import policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import LearnsFrom
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Transition


@pytree
class WeightedDoubleQLearning(DoubleControl):
    """Off-policy control that takes the value of the best action from both tables, and so neither too high nor too low.

    a* = argmax_a Q1(S', a), a_L = argmin_a Q1(S', a), d = |Q2(S', a*) - Q2(S', a_L)|, w = d / (c + d)
    Q1(S, A) <- Q1(S, A) + alpha [R + gamma (w Q1(S', a*) + (1 - w) Q2(S', a*)) - Q1(S, A)]

    or both the other way round, by a fair coin (Zhang et al. 2017, algorithm 1). c = 0 is Q-learning with two tables,
    and for large c it is double Q-learning. Of several actions that are best, or worst, one is drawn. Actions are
    drawn from the behaviour policy by the mean of Q1 and Q2, after the update.
    """

    c: float = field(
        default=1.0,
        at_least=0,
        help="How far apart values must be that a table is trusted in its own choice.",
    )

    acts_after_update: ClassVar[bool] = True
    learns_from: ClassVar[LearnsFrom] = LearnsFrom.TRANSITIONS
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "One table chooses the action, and a weighted mean of both gives its value. A coin says which chooses.",
    )

    def update(self, key, state: DoubleState, t: Transition):
        state, first = self.begin(state, t), policies.coin(key)
        row, _ = state.own_and_other(first, t.s_next)
        negative = jnp.where(row > policies.UNAVAILABLE, -row, policies.UNAVAILABLE)
        best = policies.sample(jax.random.fold_in(key, 0), policies.greedy(row))
        worst = policies.sample(jax.random.fold_in(key, 1), policies.greedy(negative))
        own, other = state.own_and_other(first, t.s_next, best)
        _, least = state.own_and_other(first, t.s_next, worst)
        apart = abs(other - least)
        weight = jnp.where(apart > 0, apart / (self.c + apart), 0)
        q_next = weight * own + (1 - weight) * other
        state = self.learn_one(state, t, first, t.r + t.discount * q_next)
        return state, self.policy(key, state, t.s_next)
