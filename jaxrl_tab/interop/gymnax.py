"""gymnax 1.0, both ways."""

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnax.environments import environment, spaces
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.interop import draws
from jaxrl_tab.types import Environment, InputError, Outcome, check_pytree, nearest, pytree, shown, static, whole

MAX_STATES = 20_000  # of an imported task: with many more a table is no way to learn, and finding them is slow
LANES = 16_384  # transitions that are worked out at once
KEYS = 64  # tried for each state and action where draws cannot be enumerated


@pytree
class EnumeratedGymnax(FiniteMDP):
    """An environment of gymnax as a finite MDP, made by `from_gymnax`.

    Attributes:
        observations: what gymnax shows in each state, [S, ...]: to act there by what was learned here. The
            last one found, where that is drawn anew each time.
    """

    observations: Any = None


@pytree
class SampledGymnax:
    """An environment of gymnax that can only be sampled, made by `from_gymnax`: no exact values.

    A step that leads to a state that was not found when the states were looked for gives the reward NaN.

    Attributes:
        states: the state of gymnax, as arrays [S, ...]: a list of those that matter.
        is_terminal: bool [S].
        observations: as in `EnumeratedGymnax`, [S, ...].
        env, params: of gymnax.
        leaves: which leaves of the state of gymnax matter.
        max_steps: time limit of an episode, in steps.
    """

    states: list[Any]
    is_terminal: Bool[Array | np.ndarray, " S"]
    observations: Any
    env: Any = static()
    params: "_Params" = static()
    leaves: tuple[int, ...] = static()
    max_steps: int = static()

    @property
    def num_states(self) -> int:
        return self.is_terminal.shape[-1]

    @property
    def num_actions(self) -> int:
        return self.env.action_space(self.params.value).n

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        _, state = self.env.reset_env(key, self.params.value)
        return self._find(state, False)[0]

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        _, example = jax.eval_shape(self.env.reset_env, key, self.params.value)
        leaves, treedef = jax.tree.flatten(example)
        leaves = [jnp.zeros(x.shape, x.dtype) for x in leaves]
        for i, x in zip(self.leaves, self.states, strict=True):
            leaves[i] = jnp.asarray(x)[s]
        state = jax.tree.unflatten(treedef, leaves)
        _, state, reward, terminal, _ = self.env.step_env(key, state, a, self.params.value)
        s_next, found = self._find(state, terminal)
        return Outcome(s_next, jnp.where(found, jnp.asarray(reward, float), jnp.nan), jnp.asarray(terminal, bool))

    def _find(self, state: Any, terminal: Any) -> tuple[Int[Array, ""], Bool[Array, ""]]:
        """The number of a state of gymnax, and whether it has one."""
        leaves = jax.tree.leaves(state)
        same = jnp.asarray(self.is_terminal) == terminal
        for i, table in zip(self.leaves, self.states, strict=True):
            equal = jnp.asarray(table) == jnp.asarray(leaves[i], table.dtype)[None]
            same &= equal.reshape(len(same), -1).all(1)
        return jnp.argmax(same).astype(jnp.int32), same.any()


class _Params(NamedTuple):
    ...
