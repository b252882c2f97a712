"""gymnax 1.0, both ways."""

import dataclasses
import functools
import inspect
from collections.abc import Mapping
from typing import Any, TypeAlias

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnax.environments import environment, spaces
from gymnax.wrappers import LegacyStepAPIWrapper, LogWrapper
from jaxtyping import Array, Bool, Int, Key

from jaxrl_tab.core.checks import check_pytree, numbers
from jaxrl_tab.core.errors import InputError, nearest, shown
from jaxrl_tab.core.names import registered_name
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Environment, Outcome, available_actions, stand_ins
from jaxrl_tab.envs import ENVS, FiniteMDP
from jaxrl_tab.interop.gymnax_numbers import ContinuousGymnax, can_be_told, of_numbers
from jaxrl_tab.interop.gymnax_states import States, Task, continuum, explore, named

# Wrappers that change no reward, action, observation, end or dynamics, by their exact class.
HARMLESS = (LogWrapper, LegacyStepAPIWrapper)


@pytree
class EnumeratedGymnax(FiniteMDP):
    """An environment of gymnax as a finite MDP, made by `from_gymnax`.

    Attributes:
        observations: what gymnax shows in each state, a pytree of arrays [S, ...]: to act there by what was
            learned here.
        title: the name in gymnax.
    """

    observations: Any = None
    title: str | None = static(default=None)


@pytree
class SampledGymnax:
    """An environment of gymnax that can only be sampled, made by `from_gymnax`: there are no exact values.

    A step to a state that was not met when the states were looked for gives the reward NaN.

    Attributes:
        states: the fields of the state of gymnax that matter, by name, arrays [S, ...].
        is_terminal: bool [S].
        is_state: False for numbers that no state has, bool [S].
        observations: as in `EnumeratedGymnax`.
        params: of gymnax.
        env: of gymnax.
        max_steps: time limit of an episode, in steps.
    """

    states: dict[str, Any]
    is_terminal: Bool[Array | np.ndarray, " S"]
    is_state: Bool[Array | np.ndarray, " S"]
    observations: Any
    params: Any
    env: Any = static()
    max_steps: int = static()

    @property
    def title(self) -> str:
        return self.env.name

    @property
    def num_states(self) -> int:
        return self.is_terminal.shape[-1]

    @property
    def num_actions(self) -> int:
        return self.env.num_actions

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        _, state = self.env.reset_env(key, self.params)
        return self._find(state, False)[0]

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        _, example = jax.eval_shape(self.env.reset_env, key, self.params)
        leaves = {name: jnp.zeros(x.shape, x.dtype) for name, x in named(example).items()}
        leaves |= {name: jnp.asarray(x)[s] for name, x in self.states.items()}  # the others do not matter
        state = jax.tree.unflatten(jax.tree.structure(example), list(leaves.values()))
        _, state, reward, terminal, _ = self.env.step_env(key, state, a, self.params)
        terminal = jnp.asarray(terminal, bool)
        s_next, has_number = self._find(state, terminal)
        return Outcome(s_next, jnp.where(has_number, jnp.asarray(reward, float), jnp.nan), terminal)

    def _find(self, state: Any, terminal: Any) -> tuple[Int[Array, ""], Bool[Array, ""]]:
        """The number of a state of gymnax, and whether it has one."""
        leaves = named(state)
        same = jnp.asarray(self.is_state) & (jnp.asarray(self.is_terminal) == terminal)
        for name, x in self.states.items():
            equal = jnp.asarray(x) == jnp.asarray(leaves[name], x.dtype)[None]
            same &= equal.reshape(len(same), -1).all(1)
        return jnp.argmax(same).astype(jnp.int32), same.any()


Imported: TypeAlias = EnumeratedGymnax | SampledGymnax | ContinuousGymnax


@jax.threefry_partitionable(True)  # what is drawn to find the states is the same whatever JAX is set to
def from_gymnax(env: Any, params: Any = None, **parameters: Any) -> Imported:
    """An environment of gymnax as a finite task: all states that can be reached, and what may happen in them.

    Where states come from a continuum, as those of CartPole-v1, the task is a `ContinuousGymnax`, for methods with
    features.

    A state here is what matters of a state there: those of its fields on which rewards, terminations,
    observations or such fields of the next state depend. The time of the episode is seldom one of them, so a
    time limit is `max_steps` here. States are numbered by their observations where these are numbers
    (`spaces.Discrete`), and else in the order of their fields. A terminal state has a number of its own, even
    where it looks like another.

    Probabilities are exact: each draw that a step makes is found in its program and enumerated (`draws`), and
    a probability or reward such as 0.33333334 in float32 is read as 1/3. Where rewards depend on what
    cannot be enumerated, such as a normal number, the task is a `SampledGymnax` instead; where states do, its
    states are those that were met with 64 keys for each state and action.

    Args:
        env: the name of a registered environment, or an environment.
        params: the parameters of gymnax, or a mapping of those that differ from the default ones.
        parameters: what the environment is made with: `from_gymnax("DeepSea-bsuite", size=10)`.

    Raises:
        InputError: the name or a parameter is wrong; a wrapper, or a `step` of its own, changes what is not
            known; actions are not discrete; what is observed does not tell the state, or is no number; there are
            more than 20,000 states; or a time limit of its own ends episodes.
    """
    env, params = _made(env, params, parameters)
    task = Task(env, params)
    if (name := continuum(task)) is not None:
        if can_be_told(task):
            return of_numbers(task)
        raise InputError(
            f"{task.name}: {name} of the start state is another one with each key, as if from a continuum, and is not "
            "observed; a table needs few states, and features what is observed"
        )
    reached = States(task)
    start, outcomes = explore(task, reached)
    number, num_states = reached.numbering()
    rows = lambda x: _rows(np.array(x), number, num_states)
    observations = jax.tree.unflatten(
        task.observation_def, list(map(rows, zip(*reached.observations, strict=True)))
    )
    is_terminal = rows(reached.is_terminal)
    if not task.is_exact:
        is_state = np.isin(np.arange(num_states), number)
        names = [task.names[i] for i in task.leaves]
        states = dict(zip(names, map(rows, zip(*reached.states, strict=True)), strict=True))
        return SampledGymnax(states, is_terminal, is_state, observations, params, env, task.max_steps)
    # A number that no state has leads to itself, as if it were one that is never entered.
    renamed = [[[(1.0, s, 0.0)]] * task.num_actions for s in range(num_states)]
    for s, actions in enumerate(outcomes):
        renamed[number[s]] = [[(p, int(number[s_next]), r) for p, s_next, r in listed] for listed in actions]
    start = rows(np.bincount(list(start), list(start.values()), len(number)))
    mdp = FiniteMDP.from_outcomes(renamed, is_terminal, start, task.max_steps)
    return EnumeratedGymnax(**vars(mdp), observations=observations, title=task.name)


def _rows(x: np.ndarray, number: np.ndarray, num_states: int) -> np.ndarray:
    """`x` [n, ...] in the rows `number` [n] of an array of `num_states`; zeros elsewhere."""
    table = np.zeros((num_states, *x.shape[1:]), x.dtype)
    table[number] = x
    return table


def arguments(name: str) -> dict[str, Any]:
    """The keyword arguments of a registered environment and the fields of its `params`, with their defaults."""
    env, params = _made(name, None, {})
    keywords = inspect.signature(type(env)).parameters.values()
    defaults = {keyword.name: keyword.default for keyword in keywords if keyword.default is not keyword.empty}
    return defaults | {field.name: getattr(params, field.name) for field in dataclasses.fields(params)}


def by_name(name: str, **values: Any) -> Imported:
    """The environment with some of its `arguments`."""
    keywords = inspect.signature(type(_made(name, None, {})[0])).parameters
    params = {key: value for key, value in values.items() if key not in keywords}
    return from_gymnax(name, params, **{key: value for key, value in values.items() if key in keywords})


def _made(env: Any, params: Any, parameters: Mapping[str, Any]) -> tuple[environment.Environment, Any]:
    """The environment and its parameters."""
    if isinstance(env, str):
        if env not in gymnax.registered_envs:
            close = nearest(env, gymnax.registered_envs)
            raise InputError(f"gymnax has no environment {shown(env)}; {close}")
        items = tuple(sorted(parameters.items()))
        try:
            env = _make(env, items) if _is_hashable(items) else _make.__wrapped__(env, items)
        except Exception as error:  # whatever its constructor makes of them
            raise InputError(f"{env}: {' '.join(str(error).split()) or type(error).__name__}") from None
    elif parameters:
        raise InputError(f"{', '.join(parameters)}: parameters go with the name of an environment")
    while type(env) in HARMLESS:
        env = env._env
    if hasattr(env, "_env") and not isinstance(env, environment.Environment):
        raise InputError(
            f"what the wrapper {type(env).__name__} changes would be lost; import the environment that it wraps, "
            "env._env"
        )
    if not isinstance(env, environment.Environment):
        raise InputError(f"env must be the name of an environment of gymnax, or one itself, not {shown(env)}")
    for method in ("step", "reset"):
        owner = next(cls for cls in type(env).__mro__ if method in vars(cls))
        if not owner.__module__.startswith("gymnax."):
            raise InputError(
                f"{env.name}: its own `{method}` would be lost, for what is imported is `{method}_env`; "
                f"write there what {owner.__name__} changes"
            )
    return env, _params(env, params)


def _params(env: environment.Environment, params: Any) -> Any:
    """The parameters of `env`, where `params` are such, or a mapping of those that differ from the default ones."""
    default = env.default_params
    field_names = [field.name for field in dataclasses.fields(default)]
    if isinstance(params, type(default)):
        changed: dict[Any, Any] = {field: getattr(params, field) for field in field_names}
    elif params is None or isinstance(params, Mapping):
        changed = dict(params or {})
    else:
        raise InputError(
            f"{env.name}: params must be those of this environment, or a dict of what differs from "
            f"env.default_params, not {shown(params)}"
        )
    for field, value in changed.items():
        if field not in field_names:
            raise InputError(f"{env.name} has no parameter {field!r}; {nearest(str(field), field_names)}")
        number = numbers(env.name, field, value)
        if number.shape != np.shape(getattr(default, field)) or not np.isfinite(number).all():
            raise InputError(
                f"{env.name}: {field} must be a finite number, as by default, not {shown(value)}"
            )
    return dataclasses.replace(default, **changed)


@functools.lru_cache(maxsize=64)
def _make(name: str, parameters: tuple[tuple[str, Any], ...]) -> Any:
    """Made once: two instances are different to JAX, so that every program would be compiled twice."""
    return gymnax.make(name, **dict(parameters))[0]


def _is_hashable(value: Any) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


# --- the other way -----------------------------------------------------------------------------------


@struct.dataclass
class TabularState(environment.EnvState):
    """Where an episode is.

    Attributes:
        time: steps taken, int32 [].
        s: the state S, int32 [].
        terminal: whether it is terminal, bool [].
    """

    time: Any  # JAX fills pytrees of flax with whatever it works on
    s: Any
    terminal: Any


class Tabular(environment.Environment):
    """An environment of ours for code that is written for gymnax 1.0; see `to_gymnax`."""

    def __init__(self, env: Environment):
        self.env = env

    @property
    def name(self) -> str:
        return registered_name(ENVS, type(self.env))

    @property
    def default_params(self) -> environment.EnvParams:
        return environment.EnvParams(max_steps_in_episode=self.env.max_steps)

    @property
    def num_actions(self) -> int:
        return self.env.num_actions

    def reset_env(self, key: Any, params: Any) -> tuple[Any, TabularState]:
        s = jnp.asarray(self.env.reset(key), jnp.int32)
        return s, TabularState(time=jnp.int32(0), s=s, terminal=jnp.bool(False))

    def step_env(self, key: Any, state: TabularState, action: Any, params: Any) -> tuple[Any, ...]:
        available, action = available_actions(self.env), jnp.asarray(action, jnp.int32)
        if available is not None:
            action = stand_ins(available)[state.s, action]
        outcome = self.env.step(key, state.s, action)
        s, terminal = jnp.asarray(outcome.s_next, jnp.int32), jnp.asarray(outcome.terminal, bool)
        reward = jnp.asarray(outcome.reward, float)
        state = TabularState(time=state.time + 1, s=s, terminal=terminal)
        info = {"discount": self.discount(state, params)}
        if available is not None:
            info["action_mask"] = available[s]
        return s, state, reward, terminal, info

    def observe(self, key: Any, state: TabularState, action: Any, params: Any) -> Any:
        return state.s

    def is_terminated(self, state: TabularState, params: Any) -> Any:
        return state.terminal

    def action_space(self, params: Any = None) -> spaces.Discrete:
        return spaces.Discrete(self.env.num_actions)

    def observation_space(self, params: Any = None) -> spaces.Discrete:
        return spaces.Discrete(self.env.num_states)

    def state_space(self, params: Any) -> spaces.Dict:
        return spaces.Dict(
            {
                "time": spaces.Discrete(params.max_steps_in_episode + 1),
                "s": spaces.Discrete(self.env.num_states),
                "terminal": spaces.Discrete(2),
            }
        )


@functools.lru_cache(maxsize=64)
def to_gymnax(env: Environment) -> Tabular:
    """`env` for code that is written for gymnax 1.0: `reset`, `step` with autoreset, `step_env`, spaces.

    Observations are the numbers of states. The time limit is `max_steps_in_episode` of its parameters. An
    environment that draws the problem of each run, such as the k-armed testbed, keeps the one that it
    holds: give `env.instance(key)`. The same `env` gives the same object, so programs are compiled once.
    Where not all actions are available in each state, `info["action_mask"]`, bool [A], says which are in the
    state that was entered, and another one does what the first of these does.

    Raises:
        InputError: `env` is no environment of ours.
    """
    check_pytree("env", env, ENVS)
    return Tabular(env)
