"""n-step Sarsa: between Sarsa and Monte Carlo (book, section 7.2; Silver, lecture 5)."""

from functools import partial
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.clock import Clock, end_step, step_size
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Transition


class Memory(NamedTuple):
    """The last n steps of the episode, each with what it will learn from.

    It is a ring: the next step overwrites the oldest one.

    Attributes:
        s, a: S and A, int32 [n].
        alpha: the step size when they were visited, float [n].
        g: the rewards since then, discounted and summed, float [n].
        weight: what the value of the state that has been reached counts in their returns: gamma^k after k
            steps, and 0 where that state is terminal; float [n].
    """

    s: Int[Array, "*n"]
    a: Int[Array, "*n"]
    alpha: Float[Array, "*n"]
    g: Float[Array, "*n"]
    weight: Float[Array, "*n"]


class NStepState(NamedTuple):
    """A learner that looks n steps back.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
        memory: the last steps, [n] each.
        slot: where the next step goes in the memory, int32 [].
        filled: how many steps of this episode are in the memory, int32 [].
    """

    q: Float[Array, "S A"]
    clock: Clock
    memory: Memory
    slot: Int[Array, ""]
    filled: Int[Array, ""]


@pytree
class NStepSarsa(TDControl):
    """On-policy control that learns from n rewards and the value after them.

    G_{t:t+n} = R_{t+1} + ... + gamma^{n-1} R_{t+n} + gamma^n Q(S_{t+n}, A_{t+n})      (book, equation 7.4)

    Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G_{t:t+n} - Q(S_t, A_t)]      (book, equation 7.5)

    S_t, A_t learns n - 1 steps later. Where the episode ends, the steps that are left learn too, the oldest
    first: up to a terminal state from fewer rewards and no value; at a time limit from the value of the state
    that was reached. n = 1 is Sarsa; with n at least as long as an episode it is Monte Carlo.

    A schedule of alpha gives what it was when the pair was visited.
    """

    n: int = static(default=4, at_least=1, help="How many rewards it looks ahead.")

    backup: ClassVar[Backup] = Backup(
        "action, state, action, ..., state, action",
        "Where a terminal state comes before that, the rewards up to it, and no value.",
    )

    def init(self, num_states: int, num_actions: int) -> NStepState:
        q, clock = super().init(num_states, num_actions)
        index, real = jnp.zeros(self.n, jnp.int32), jnp.zeros(self.n, q.dtype)
        memory = Memory(index, index, alpha=real, g=real, weight=real)
        return NStepState(q, clock, memory, slot=jnp.int32(0), filled=jnp.int32(0))

    def update(self, key, state: NStepState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        alpha = step_size(self.alpha, state.clock, t.s, t.a)
        memory = _remember(state.memory, state.slot, t, jnp.asarray(alpha, state.q.dtype))
        slot = _wrap(state.slot + 1, self.n)
        filled = jnp.minimum(state.filled + 1, self.n)
        oldest = _wrap(slot + self.n - filled, self.n)
        due = jnp.where(t.last, filled, (filled == self.n).astype(jnp.int32))
        learn = partial(_learn, self.n)
        q = tables.lane_by_lane(learn, state.q, memory, oldest, due, t.s_next, a_next)
        clock = end_step(state.clock, t.last)
        state = NStepState(q, clock, memory, slot, filled=jnp.where(t.last, 0, filled))
        return state, a_next


def _remember(memory: Memory, slot: Int[Array, ""], t: Transition, alpha: Float[Array, ""]) -> Memory:
    """The memory with this step in `slot`, and its reward in the returns of all steps."""
    put = lambda x, value: tables.put(x, value, slot)
    g, weight = put(memory.g, jnp.zeros_like(alpha)), put(memory.weight, jnp.ones_like(alpha))
    return Memory(
        s=put(memory.s, t.s),
        a=put(memory.a, t.a),
        alpha=put(memory.alpha, alpha),
        g=g + weight * t.r,
        weight=weight * t.discount,
    )


def _learn(n: int, lane, q, memory: Memory, oldest, due, s_next, a_next):
    """The updates that are due, the oldest step's first, each by Q as it then is; for `lane_by_lane`."""
    first = tables.entry(oldest, lane)
    reached = lane, tables.entry(s_next, lane), tables.entry(a_next, lane)

    def one(i, q):
        slot = _wrap(first + i, n)
        s, a, alpha, g, weight = jax.tree.map(lambda x: tables.entry(x, lane, slot), memory)
        old = tables.entry(q, lane, s, a)
        target = g + weight * tables.entry(q, *reached)
        return tables.write(q, old + alpha * (target - old), lane, s, a)

    return lax.fori_loop(jnp.int32(0), tables.entry(due, lane), one, q)


def _wrap(slot: Int[Array, ""], n: int) -> Int[Array, ""]:
    """A place in a ring of n, from one that may be up to n too far."""
    return jnp.where(slot >= n, slot - n, slot)
