"""What the n-step methods share: the last n steps in a ring, and who of them learns when (book, chapter 7)."""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import linear, tables
from jaxrl_tab.core.clock import Clock, end_step
from jaxrl_tab.core.policies import Policy
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Transition

Returns = Callable[..., Callable[..., Float[Array, ""]]]
Correction = Callable[..., tuple[Array, Any]]
Follow = Callable[[Array, Array, Array, Array, Any], Array]


class NStepState(NamedTuple):
    """A learner that looks n steps back.

    Attributes:
        q: Q, float [S, A].
        clock: what the schedules of alpha and epsilon count.
        memory: the last n steps of the episode, a NamedTuple of arrays [n]: S, A, alpha, and what else the method
            `remembers`. It is a ring: the next step overwrites the oldest one.
        slot: where the next step goes in the memory, int32 [].
        filled: how many steps of this episode are in the memory, int32 [].
        optimizer: the state of the optimiser of weights, where there is one (`approx.optimized`), else None.
    """

    q: Float[Array, "S A"]
    clock: Clock
    memory: Any
    slot: Int[Array, ""]
    filled: Int[Array, ""]
    optimizer: Any = None


@pytree
class NStepControl(TDControl):
    """Control that learns from n rewards and what is expected after them. A method adds its `update`.

    S_t, A_t learns n - 1 steps later. Where the episode ends, the steps that are left learn too, the oldest first.
    """

    n: int = static(default=4, at_least=1, help="How many rewards it looks ahead.")

    remembers: ClassVar[type[Any]]  # the type of the memory: its fields are s, a, alpha, and numbers

    def init(self, num_states: int, num_actions: int) -> NStepState:
        q, clock = super().init(num_states, num_actions)
        ring = lambda x: jnp.zeros((self.n, *x.shape), x.dtype)
        index, real = ring(jnp.int32(0)), ring(q[0, 0])
        _, _, *numbers = self.remembers._fields
        memory = self.remembers(jax.tree.map(ring, self.nowhere), index, *[real] * len(numbers))
        return NStepState(q, clock, memory, slot=jnp.int32(0), filled=jnp.int32(0))

    def remember(self, state: NStepState, t: Transition, **numbers: Any) -> Any:
        """The memory with this step in it: S, A, alpha, and these numbers."""
        alpha = self.step_size(state, t)
        step = self.remembers(self.x(t.s), t.a, alpha, **numbers)
        put = lambda x, value: tables.put_at(x, jnp.asarray(value, x.dtype), state.slot)
        return jax.tree.map(put, state.memory, step)

    def learned(
        self, state: NStepState, t: Transition, memory: Any, returns: Returns, *inputs: Any
    ) -> NStepState:
        """The learner after what is due was learned: by the oldest step of a full memory; at the end, by all.

        Q(S, A) <- Q(S, A) + alpha [G - Q(S, A)], for one step after another, each by Q as it then is.

        Args:
            state: the learner as it was before this step.
            t: this step.
            memory: what is remembered, this step too.
            returns: `returns(lane, read, *inputs)` gives `target(q, i, step)`, which is G of the step that is i places
                after the oldest; `read(i)` reads what is remembered of one. It is part of a body of
                `tables.lane_by_lane`, and so must not close over anything that is traced.
            inputs: pytrees of what it needs besides.
        """
        slot = _wrap(state.slot + 1, self.n)
        filled = jnp.minimum(state.filled + 1, self.n)
        oldest = _wrap(slot + self.n - filled, self.n)
        due = jnp.where(t.last, filled, (filled == self.n).astype(jnp.int32))
        learn = partial(_learn, self.n, returns, self.correction)
        learned = state.q, state.optimizer
        q, optimizer = tables.lane_by_lane(learn, learned, memory, oldest, due, *inputs)
        clock = end_step(state.clock, t.last)
        return NStepState(q, clock, memory, slot, jnp.where(t.last, 0, filled), optimizer)

    @property
    def correction(self) -> Correction:
        """What the error of a step that is remembered does to Q."""
        return _by_alpha


def _by_alpha(lane, learned, step, error):
    q, optimizer = learned
    return linear.add(q, step.s, step.a, step.alpha * error, lane), optimizer


def _learn(
    n: int, returns: Returns, correction: Correction, lane, learned, memory: Any, oldest, due, *inputs
):
    """The updates that are due, the oldest step's first; for `lane_by_lane`."""
    first = tables.entry(oldest, lane)
    read = lambda i: jax.tree.map(lambda x: tables.entry(x, lane, _wrap(first + i, n)), memory)
    target = returns(lane, read, *inputs)

    def one(i, learned):
        step, q = read(i), learned[0]
        old = linear.entry(q, step.s, step.a, lane)
        return correction(lane, learned, step, target(q, i, step) - old)

    return lax.fori_loop(jnp.int32(0), tables.entry(due, lane), one, learned)


def _wrap(slot: Int[Array, ""], n: int) -> Int[Array, ""]:
    """A place in a ring of n, from one that may be up to n too far."""
    return jnp.where(slot >= n, slot - n, slot)


# --- returns that are known as the rewards come in ------------------------------------------------------


class Sums(NamedTuple):
    """The last n steps, each with what it will learn from.

    Attributes:
        s, a: what stands for S (`ValueControl.x`), int32 [n] or more, and A, int32 [n].
        alpha: the step size when they were visited, float [n]; off-policy times the ratios of later actions.
        g: the rewards since then, discounted and summed, float [n].
        weight: what the value of the state that has been reached counts in their returns: gamma^k after k
            steps, and 0 where that state is terminal; float [n].
    """

    s: Any
    a: Int[Array, "*n"]
    alpha: Float[Array, "*n"]
    g: Float[Array, "*n"]
    weight: Float[Array, "*n"]

    def weighed(self, ratio: Float[Array, ""]) -> "Sums":
        """With this ratio on the errors of all."""
        return self._replace(alpha=self.alpha * ratio)

    def rewarded(self, t: Transition) -> "Sums":
        """With the reward of the last step in the returns of all."""
        return self._replace(g=self.g + self.weight * t.r, weight=self.weight * t.discount)


def bootstrapped(lane, read, s_next, a_next):
    """G = the rewards and, with its weight, Q(S', A'); as `NStepControl.learned` asks for it."""
    s_next, a_next = jax.tree.map(lambda x: tables.entry(x, lane), (s_next, a_next))
    return lambda q, i, step: step.g + step.weight * linear.entry(q, s_next, a_next, lane)


# --- returns that are worked out backwards, by the Q of the moment --------------------------------------


class Beyond(NamedTuple):
    """What the walk back goes by, besides the memory.

    Attributes:
        s_next, discount: of the last step.
        filled: how many steps there are in the memory, int32.
        pi: the target policy.
        clock: what its schedules count.
        gamma: of the method.
    """

    s_next: Int[Array, "*lanes"]
    discount: Float[Array, "*lanes"]
    filled: Int[Array, "*lanes"]
    pi: Policy
    clock: Clock
    gamma: Any


@pytree
class Branching(OffPolicyControl, NStepControl):
    """n-step methods whose returns branch at every state, into all actions, and follow the one that was taken.

    G_{t:h} = R_{t+1} + gamma U_{t+1},  where U is made of G_{t+1:h} and of the mean of Q(S_{t+1}, .) under pi

    Beyond the last step U is the mean alone; Q and pi are those of the moment of the update.
    """

    def branched(self, state: NStepState, t: Transition, follow: Follow, **numbers: Any) -> NStepState:
        """The learner after a step, of which besides S, A, alpha and R these numbers are remembered.

        `follow(expected, q, pi, g, step)` gives U of a state in which a step was made that is remembered: `expected` is
        the mean of Q(S, .), q and pi are Q(S, A) and pi(A | S), and g is the return from there, each []. It must not
        close over anything that is traced.
        """
        memory = self.remember(state, t, r=t.r, **numbers)
        filled = jnp.minimum(state.filled + 1, self.n)
        beyond = Beyond(t.s_next, t.discount, filled, self.pi, state.clock, self.gamma)
        return self.learned(state, t, memory, partial(_walk_back, follow), beyond)


def _walk_back(follow: Follow, lane, read, beyond: Beyond):
    """The returns of `Branching`, as `NStepControl.learned` asks for them."""
    s_next, discount, filled, pi, clock, gamma = jax.tree.map(lambda x: x[lane], beyond)

    def mean(q, s):
        row = lax.dynamic_slice(q, (lane, s, jnp.int32(0)), (1, 1, q.shape[2]))[0, 0]
        probs = pi.probs(row, clock, s)
        return probs @ row, row, probs

    def target(q, i, step):
        def back(k, rest):
            later = read(filled - 1 - k)
            expected, row, probs = mean(q, later.s)
            q_taken, pi_taken = tables.entry(row, later.a), tables.entry(probs, later.a)
            return gamma * follow(expected, q_taken, pi_taken, later.r + rest, later)

        rest = discount * mean(q, s_next)[0]
        return step.r + lax.fori_loop(jnp.int32(0), filled - 1 - i, back, rest)

    return target
