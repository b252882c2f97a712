"""n-step TD off-policy, as a method with one entry a state (book, sections 7.3 and 7.4); see `prediction`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.n_step import NStepState, Sums, bootstrapped
from jaxrl_tab.algorithms.n_step_sarsa import NStepSarsa
from jaxrl_tab.core import tables
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Transition


class Weighed(NamedTuple):
    """The last n steps: S and A, int32 [n]; alpha, R and the ratio pi(A | S) / b(A | S), float [n]."""

    s: Int[Array, "*n"]
    a: Int[Array, "*n"]
    alpha: Float[Array, "*n"]
    r: Float[Array, "*n"]
    ratio: Float[Array, "*n"]


@pytree
class NStepOfStates(NStepSarsa):
    """What `prediction.NStepOffPolicyTD` learns with: one action, whose ratio is a part of what follows the state."""

    control_variates: bool = static(default=False, help="One ratio for each decision, with control variates.")

    @property
    def remembers(self) -> type:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Weighed if self.control_variates else Sums

    def weighed(self, state: NStepState, t: Transition, ratio: Float[Array, ""]) -> NStepState:
        """The learner after a step whose action has this ratio."""
        state = self.begin(state, t)
        if not self.control_variates:
            memory = self.remember(state, t, g=0, weight=1).rewarded(t).weighed(ratio)
            return self.learned(state, t, memory, bootstrapped, t.s_next, t.a)
        memory = self.remember(state, t, r=t.r, ratio=ratio)
        filled = jnp.minimum(state.filled + 1, self.n)
        return self.learned(state, t, memory, _corrected, t.s_next, t.discount, filled, self.gamma)


def _corrected(lane, read, *inputs):
    """The returns with control variates (book, equation 7.13), as `NStepControl.learned` asks for them."""
    s_next, discount, filled, gamma = jax.tree.map(lambda x: x[lane], inputs)

    def target(q, i, step):
        def back(k, rest):
            at = read(filled - 1 - k)
            return gamma * (at.ratio * (at.r + rest) + (1 - at.ratio) * tables.entry(q, lane, at.s, at.a))

        rest = discount * tables.entry(q, lane, s_next, step.a)
        rest = lax.fori_loop(jnp.int32(0), filled - 1 - i, back, rest)
        return step.ratio * (step.r + rest) + (1 - step.ratio) * tables.entry(q, lane, step.s, step.a)

    return target
