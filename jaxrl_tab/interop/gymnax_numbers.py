"""Environments of gymnax whose states are real numbers, and cannot be counted; see `from_gymnax`."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnax.environments import spaces
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.interop import draws
from jaxrl_tab.interop.gymnax_states import Task, named

UNBOUNDED = 1e30  # where gymnax has no bound it has the largest float

# Of each field the largest number, where gymnax's own has no bound or is of no use: no pole stands beyond these ends;
# its velocities are seldom outside of these, and features take such ones for the end of the range.
ENDS: dict[str, Callable[[Any], dict[str, float]]] = {
    "CartPole-v1": lambda params: {
        "x": params.x_threshold,
        "x_dot": 3.0,
        "theta": params.theta_threshold_radians,
        "theta_dot": 3.5,
    },
    "Acrobot-v1": lambda params: {"joint_angle1": math.pi, "joint_angle2": math.pi},
}


@pytree
class ContinuousGymnax:
    """An environment of gymnax whose states are vectors of real numbers, made by `from_gymnax`.

    A state here is those fields of a state there that matter, one after another, float [d]; the time is none of them.
    Its methods are those with features, of these numbers (`approx`).

    Attributes:
        params: of gymnax.
        env: of gymnax.
        fields: which fields of a state of gymnax these are.
        low, high: the least and the largest of each number; infinite where gymnax says nothing.
        max_steps: time limit of an episode, in steps.
    """

    params: Any
    env: Any = static()
    fields: tuple[str, ...] = static()
    low: tuple[float, ...] = static()
    high: tuple[float, ...] = static()
    max_steps: int = static()

    num_states = 0  # they cannot be counted

    @property
    def title(self) -> str:
        return self.env.name

    @property
    def number_names(self) -> tuple[str, ...]:
        return self.fields if len(self.fields) == len(self.low) else ()

    @property
    def num_actions(self) -> int:
        return self.env.num_actions

    def reset(self, key: Key[Array, ""]) -> Float[Array, " d"]:
        _, state = self.env.reset_env(key, self.params)
        return self._numbers(state)

    def step(self, key: Key[Array, ""], s: Float[Array, " d"], a: Int[Array, ""]) -> Outcome:
        _, state, reward, terminal, _ = self.env.step_env(key, self._state(key, s), a, self.params)
        reward = jnp.asarray(reward, float)
        return Outcome(self._numbers(state), reward, jnp.asarray(terminal, bool))

    def _numbers(self, state: Any) -> Float[Array, " d"]:
        leaves = named(state)
        return jnp.concatenate([jnp.ravel(jnp.asarray(leaves[name], float)) for name in self.fields])

    def _state(self, key: Key[Array, ""], s: Float[Array, " d"]) -> Any:
        """The state of gymnax with these numbers; what does not matter is 0 in it."""
        _, example = jax.eval_shape(self.env.reset_env, key, self.params)
        leaves, at = {}, 0
        for name, x in named(example).items():
            leaves[name] = jnp.zeros(x.shape, x.dtype)
        for name in self.fields:
            x, end = leaves[name], at + leaves[name].size
            leaves[name], at = s[at:end].reshape(x.shape).astype(x.dtype), end
        return jax.tree.unflatten(jax.tree.structure(example), list(leaves.values()))


def of_numbers(task: Task) -> ContinuousGymnax:
    """The task as one of real numbers.

    Raises:
        InputError: not all that matters of its state are real numbers, or what happens depends on the time.
    """
    names = [task.names[i] for i in task.leaves]
    for i, name in zip(task.leaves, names, strict=True):
        if not jnp.issubdtype(task.first[i].dtype, jnp.floating):
            raise InputError(
                f"{task.name}: {name} of its state is no real number, and others are: a state must be a number that is "
                "counted, or real numbers alone"
            )
    low, high = zip(*(end for i in task.leaves for end in _ends(task, i)), strict=True)
    return ContinuousGymnax(task.params, task.env, tuple(names), low, high, task.max_steps)


def can_be_told(task: Task) -> bool:
    """Whether what is observed depends on all that matters of a state, and on nothing else."""
    observe = lambda key, state: task.env.observe(key, state, None, task.params)
    state = jax.tree.unflatten(task.state_def, task.first)
    program = draws.Program(observe, state)
    seen = program.arguments(range(len(program.is_exact)))
    return all(program.is_exact) and set(task.leaves) <= set(seen)


def _ends(task: Task, leaf: int) -> list[tuple[float, float]]:
    """The least and the largest of each number of a field."""
    name, x = task.names[leaf], task.first[leaf]
    own = ENDS.get(task.name, lambda params: {})(task.params)
    if name in own:
        return [(-float(own[name]), float(own[name]))] * x.size
    space = task.env.state_space(task.params)
    box = space.spaces.get(name) if isinstance(space, spaces.Dict) else None
    if not isinstance(box, spaces.Box):
        return [(-math.inf, math.inf)] * x.size
    ends = (np.broadcast_to(np.asarray(end, float), x.shape).ravel() for end in (box.low, box.high))
    return [
        (float(a) if a > -UNBOUNDED else -math.inf, float(b) if b < UNBOUNDED else math.inf)
        for a, b in zip(*ends, strict=True)
    ]
