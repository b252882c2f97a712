"""Control by a neural network that learns from what it remembers (Mnih et al. 2015; Silver, lecture 6).

Each step is put into a memory, a ring of the last `buffer` of them; and of `batch` of these, drawn anew, the network
learns by its gradient. The values that it learns towards are those of a copy of it, which is made every `target_every`
steps: so what it learns stays in place for a while, as in supervised learning.
"""

import dataclasses
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.algorithms.control import ValueControl
from jaxrl_tab.approx import features, network
from jaxrl_tab.approx.network import Weights
from jaxrl_tab.approx.semi_gradient import EPSILON_GREEDY_ALONE, OF_FEATURES, check_counts
from jaxrl_tab.core import clock, optimizers, policies, rng, tables
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.checks import assign
from jaxrl_tab.core.clock import Clock
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.linear import X, all_of
from jaxrl_tab.core.policies import EpsilonGreedy
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Available, Environment, State, Transition


class Replay(NamedTuple):
    """Steps that are remembered, [N, ...] each; or one of them, or a batch.

    Attributes:
        x, x_next: the features of S and of S' (`linear.X`).
        a: A, int32.
        r: R, float.
        discount: gamma', float.
        a_next: A', int32; None where nothing is learned from it.
        available: which actions S' has, bool [..., A]; None where each state has all.
    """

    x: Any
    a: Int[Array, "*n"]
    r: Float[Array, "*n"]
    discount: Float[Array, "*n"]
    x_next: Any
    a_next: Int[Array, "*n"] | None
    available: Bool[Array, "*n A"] | None


class DeepState(NamedTuple):
    """A learner whose Q is a network.

    Attributes:
        weights: of the network.
        target: of its copy.
        optimizer: the state of the optimiser.
        memory: the last steps. It is a ring: step t is at t mod N.
        clock: what the schedule of epsilon counts.
    """

    weights: Weights
    target: Weights
    optimizer: Any
    memory: Replay
    clock: Clock

    @property
    def q(self) -> Float[Array, "... n A"]:
        """The weights of the last layer, of which Q is a linear function, and what is added, float [n + 1, A]."""
        last = self.weights[-1]
        return jnp.concatenate([last.w, last.b[..., None, :]], -2)


@pytree
class Deep(ValueControl):
    """Control whose Q is a network with an output for each action. A method adds what it learns towards."""

    network: Any = static(
        default="mlp(64, 64)",
        help="The widths of its hidden layers; after them activation='tanh' takes the place of relu.",
    )
    features: Any = static(default="observation", help=f"What the network sees of a state. {OF_FEATURES}")
    optimizer: Any = static(
        default="optax:adam(0.001)",
        help="The optimiser, as the call that makes it in optax, with its learning rate.",
    )
    buffer: int = static(default=10_000, at_least=1, help="N, how many of the last steps it remembers.")
    batch: int = static(default=32, at_least=1, help="Of how many of them it learns in each step.")
    target_every: int = static(default=500, at_least=1, help="C, after how many steps the copy is made anew.")
    q0: float = field(default=0.0, help="What is added to each output before the first step.")

    def __post_init__(self):
        readers = {"network": network.read, "features": features.read, "optimizer": optimizers.whole}
        for name, read in readers.items():
            try:
                assign(self, **{name: read(getattr(self, name))})
            except InputError as error:
                raise error.renamed(type(self).__name__, name) from None
        if self.batch > self.buffer:
            problem = f"a batch of {self.batch:,} steps cannot be drawn from a memory of {self.buffer:,}"
            raise InputError(problem, who=type(self).__name__, field="batch")
        super().__post_init__()

    def fitted_to(self, env: Environment) -> Self:
        """The method where its features are those of the states of an environment. Raises InputError as they do."""
        check_counts(self, env)
        fitted = dataclasses.replace(self, features=self.features.fitted(env))
        who = type(self).__name__
        if jnp.ndim(self.q0):
            raise InputError("q0 is a table, and Q is a network: give one number", who=who, field="q0")
        weights = jax.eval_shape(lambda key: fitted.first(key, env.num_states, env.num_actions), rng.key(0))
        optimizers.check_fits(self.optimizer, weights, who)
        return fitted

    def restricted_to(self, available: Available, **more: Any) -> Self:
        if not isinstance(self.selection, EpsilonGreedy):
            raise InputError(EPSILON_GREEDY_ALONE, who=type(self).__name__, field="behaviour")
        return super().restricted_to(available, q0=self.q0, **more)

    on_policy: ClassVar[bool] = False  # whether A' is remembered

    def works_with(self, state: DeepState) -> Any:
        """The gradient, what the optimiser makes of it, and a batch with what each layer gives, forth and back."""
        batch: Replay = jax.tree.map(lambda x: x[: self.batch], state.memory)
        outputs = [jnp.zeros((2, self.batch, len(layer.b))) for layer in state.weights]
        return state.weights, state.weights, batch, outputs

    left_to_xla: ClassVar[str] = "it multiplies matrices"

    def init(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, num_states: int, num_actions: int, key: Key[Array, ""]
    ) -> DeepState:
        for policy in self.all_policies:
            policy.check(num_states, num_actions)
        weights = self.first(key, num_states, num_actions)
        zero, real, x = jnp.int32(0), jnp.zeros(()), self.features.nowhere
        a_next = zero if self.on_policy else None
        available = None if self.available is None else jnp.ones(num_actions, bool)
        step = Replay(x, zero, real, real, x, a_next, available)
        memory = jax.tree.map(lambda x: jnp.zeros((self.buffer, *x.shape), x.dtype), step)
        by_visit = any(p.by_visit for p in self.all_policies)
        counts = clock.start(num_states, num_actions, by_visit)
        return DeepState(weights, weights, optimizers.start(self.optimizer, weights), memory, counts)

    def first(self, key: Key[Array, ""], num_states: int, num_actions: int) -> Weights:
        """The weights before the first step."""
        *hidden, last = self.network.init(key, self._inputs(num_states), num_actions)
        return (*hidden, last._replace(b=last.b + self.q0))

    # --- Q ---------------------------------------------------------------------------------------------

    def row(self, state: DeepState, s: State) -> Float[Array, " A"]:
        return self._values(state.weights, self.features(s), self._available(s))

    def value(self, state: DeepState, s: State, a: Int[Array, ""]) -> Float[Array, ""]:
        return self.row(state, s)[a]

    def _values(self, weights: Weights, x: X, available: Bool[Array, " A"] | None) -> Float[Array, " A"]:
        """Q(s, .) by these weights."""
        row = self.network(weights, all_of(x, weights[0].w.shape[0], weights[0].w.dtype))
        return row if available is None else jnp.where(available, row, policies.UNAVAILABLE)

    def _available(self, s: State) -> Bool[Array, " A"] | None:
        available = self.available
        return None if available is None else tables.row(jnp.asarray(available, float), s) > 0

    def _inputs(self, num_states: int) -> int:
        return num_states if isinstance(self.features, features.OneHot) else self.features.size

    # --- learning --------------------------------------------------------------------------------------

    def learned(self, key: Key[Array, ""], state: DeepState, t: Transition, a_next: Any = None) -> DeepState:
        """The learner after a step: it is remembered, and a batch is learned from."""
        state = self.remembered(state, t, a_next)
        state = self.improved(state, self.drawn(key, state), state.clock.step >= self.batch)
        is_due = state.clock.step % self.target_every == 0
        target = jax.tree.map(lambda new, old: jnp.where(is_due, new, old), state.weights, state.target)
        return state._replace(target=target, clock=clock.end_step(state.clock, t.last))

    def remembered(self, state: DeepState, t: Transition, a_next: Any = None) -> DeepState:
        """The learner with this step in its memory."""
        x, x_next = self.features(t.s), self.features(t.s_next)
        step = Replay(x, t.a, t.r, t.discount, x_next, a_next, self._available(t.s_next))
        slot = (state.clock.step - 1) % self.buffer
        put = lambda old, new: tables.put_at(old, jnp.asarray(new, old.dtype), slot)
        return state._replace(memory=jax.tree.map(put, state.memory, step))

    def drawn(self, key: Key[Array, ""], state: DeepState) -> Int[Array, " batch"]:
        """Places in the memory, each as likely as the other, where there is a step; one may be drawn again."""
        filled = jnp.minimum(state.clock.step, self.buffer)
        words = jax.random.bits(jax.random.fold_in(key, 1), (self.batch,), jnp.uint32)
        return ((words >> 8).astype(float) * 2**-24 * filled).astype(jnp.int32)

    def improved(self, state: DeepState, places: Int[Array, " batch"], is_ready: Any = True) -> DeepState:
        """The learner after it learned from a batch; unchanged where it is not ready."""
        batch: Replay = jax.tree.map(lambda x: x[places], state.memory)
        target = jax.vmap(self.towards, (None, 0))(state.target, batch)
        gradient = jax.grad(self.loss)(state.weights, batch, target)
        ascent = jax.tree.map(lambda x: -x, gradient)
        change, optimizer = optimizers.change(self.optimizer, ascent, state.optimizer, state.weights)
        weights = jax.tree.map(jnp.add, state.weights, change)
        new, old = (weights, optimizer), (state.weights, state.optimizer)
        weights, optimizer = jax.tree.map(lambda new, old: jnp.where(is_ready, new, old), new, old)
        return state._replace(weights=weights, optimizer=optimizer)

    def loss(self, weights: Weights, batch: Replay, target: Float[Array, " batch"]) -> Float[Array, ""]:
        """The mean over a batch of 1/2 [target - q(S, A)]^2."""

        def half_square(step: Replay, target: Float[Array, ""]) -> Float[Array, ""]:
            row = self._values(weights, step.x, None)
            taken = jnp.arange(len(row), dtype=jnp.int32) == step.a
            error = target - jnp.where(taken, row, 0).sum()
            return 0.5 * error * error

        return jax.vmap(half_square)(batch, target).mean()

    def towards(self, weights: Weights, step: Replay) -> Float[Array, ""]:
        """What the value of a step that is remembered is to be, by the weights of the copy."""
        raise NotImplementedError


@pytree
class DeepQNetwork(Deep):
    """Semi-gradient Q-learning with a network, experience replay and a target copy: DQN.

    theta <- theta + alpha mean_j [R_j + gamma max_a q(S'_j, a; theta-) - q(S_j, A_j; theta)] grad q(S_j, A_j; theta)
                                                                                  (Mnih et al. 2015, algorithm 1)

    The steps j are drawn from the memory, and theta- are the weights of the copy. Errors are not clipped; an optimiser
    that clips gradients is `optax.chain(optax.clip(1.0), optax.adam(0.001))`.
    """

    acts_after_update: ClassVar[bool] = True
    backup: ClassVar[Backup] = Backup(
        "action, state, max action",
        "Of steps that are remembered; the values ahead are those of an older copy.",
    )

    def update(self, key, state: DeepState, t: Transition):
        state = self.learned(key, self.begin(state, t), t)
        return state, self.policy(key, state, t.s_next)

    def towards(self, weights: Weights, step: Replay) -> Float[Array, ""]:
        return step.r + step.discount * policies.largest(self._values(weights, step.x_next, step.available))


@pytree
class DeepSarsa(Deep):
    """Semi-gradient Sarsa with a network, experience replay and a target copy (Zhao et al. 2016).

    theta <- theta + alpha mean_j [R_j + gamma q(S'_j, A'_j; theta-) - q(S_j, A_j; theta)] grad q(S_j, A_j; theta)

    A' is remembered with its step. It was drawn from the policy of that time, so with a long memory it is not quite
    on-policy.
    """

    on_policy: ClassVar[bool] = True
    backup: ClassVar[Backup] = Backup(
        "action, state, action", "Of steps that are remembered; the values ahead are those of an older copy."
    )

    def update(self, key, state: DeepState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        return self.learned(key, state, t, a_next), a_next

    def towards(self, weights: Weights, step: Replay) -> Float[Array, ""]:
        row = self._values(weights, step.x_next, None)
        return step.r + step.discount * row[step.a_next]
