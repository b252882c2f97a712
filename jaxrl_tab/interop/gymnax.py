"""gymnax 1.0, both ways."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnax.environments import environment, spaces
from gymnax.wrappers import LegacyStepAPIWrapper, LogWrapper
from jaxtyping import Array, Bool, Int, Key

from jaxrl_tab.core import rng
from jaxrl_tab.core.checks import InputError, check_pytree, nearest, numbers, shown, whole
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Environment, Outcome, available_actions, stand_ins
from jaxrl_tab.envs import ENVS, FiniteMDP
from jaxrl_tab.interop import draws

MAX_STATES = (
    20_000  # of an imported task: with many more a table is no way to learn, and finding them is slow
)
# Wrappers that change no reward, action, observation, end or dynamics, by their exact class.
HARMLESS = (LogWrapper, LegacyStepAPIWrapper)
LANES = 16_384  # transitions that are worked out at once
KEYS = 64  # tried for each state and action where draws cannot be enumerated


@pytree
class EnumeratedGymnax(FiniteMDP):
    """An environment of gymnax as a finite MDP, made by `from_gymnax`.

    Attributes:
        observations: what gymnax shows in each state, a pytree of arrays [S, ...]: to act there by what was
            learned here.
    """

    observations: Any = None


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
        leaves = {name: jnp.zeros(x.shape, x.dtype) for name, x in _named(example).items()}
        leaves |= {name: jnp.asarray(x)[s] for name, x in self.states.items()}  # the others do not matter
        state = jax.tree.unflatten(jax.tree.structure(example), list(leaves.values()))
        _, state, reward, terminal, _ = self.env.step_env(key, state, a, self.params)
        terminal = jnp.asarray(terminal, bool)
        s_next, found = self._find(state, terminal)
        return Outcome(s_next, jnp.where(found, jnp.asarray(reward, float), jnp.nan), terminal)

    def _find(self, state: Any, terminal: Any) -> tuple[Int[Array, ""], Bool[Array, ""]]:
        """The number of a state of gymnax, and whether it has one."""
        leaves = _named(state)
        same = jnp.asarray(self.is_state) & (jnp.asarray(self.is_terminal) == terminal)
        for name, x in self.states.items():
            equal = jnp.asarray(x) == jnp.asarray(leaves[name], x.dtype)[None]
            same &= equal.reshape(len(same), -1).all(1)
        return jnp.argmax(same).astype(jnp.int32), same.any()


def _named(state: Any) -> dict[str, Any]:
    """The leaves of a state of gymnax, in their order."""
    return {jax.tree_util.keystr(path)[1:]: x for path, x in jax.tree.leaves_with_path(state)}


@jax.threefry_partitionable(True)  # what is drawn to find the states is the same whatever JAX is set to
def from_gymnax(env: Any, params: Any = None, **parameters: Any) -> EnumeratedGymnax | SampledGymnax:
    """An environment of gymnax as a finite task: all states that can be reached, and what may happen in them.

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
    task = _Task(env, params)
    found = _States(task)
    start, outcomes = _explore(task, found)
    number, num_states = found.numbering()
    rows = lambda x: _rows(np.array(x), number, num_states)
    observations = jax.tree.unflatten(
        task.observation_def, list(map(rows, zip(*found.observations, strict=True)))
    )
    is_terminal = rows(found.is_terminal)
    if not task.is_exact:
        is_state = np.isin(np.arange(num_states), number)
        names = [task.names[i] for i in task.leaves]
        states = dict(zip(names, map(rows, zip(*found.states, strict=True)), strict=True))
        return SampledGymnax(states, is_terminal, is_state, observations, params, env, task.max_steps)
    # A number that no state has leads to itself, as if it were one that is never entered.
    renamed = [[[(1.0, s, 0.0)]] * task.num_actions for s in range(num_states)]
    for s, actions in enumerate(outcomes):
        renamed[number[s]] = [[(p, int(number[s_next]), r) for p, s_next, r in listed] for listed in actions]
    start = rows(np.bincount(list(start), list(start.values()), len(number)))
    mdp = FiniteMDP.from_outcomes(renamed, is_terminal, start, task.max_steps)
    return EnumeratedGymnax(**vars(mdp), observations=observations)


def _rows(x: np.ndarray, number: np.ndarray, num_states: int) -> np.ndarray:
    """`x` [n, ...] in the rows `number` [n] of an array of `num_states`; zeros elsewhere."""
    table = np.zeros((num_states, *x.shape[1:]), x.dtype)
    table[number] = x
    return table


def arguments(name: str) -> dict[str, Any]:
    """The keyword arguments of a registered environment and the fields of its `params`, with their defaults."""
    env, params = _made(name, None, {})
    keywords = inspect.signature(type(env)).parameters.values()
    found = {keyword.name: keyword.default for keyword in keywords if keyword.default is not keyword.empty}
    return found | {field.name: getattr(params, field.name) for field in dataclasses.fields(params)}


def by_name(name: str, **values: Any) -> EnumeratedGymnax | SampledGymnax:
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
        given = tuple(sorted(parameters.items()))
        try:
            env = _make(env, given) if _is_hashable(given) else _make.__wrapped__(env, given)
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


def _params(env: environment.Environment, given: Any) -> Any:
    """The parameters `given` for `env`: its own, or a mapping of those that differ from the default ones."""
    default = env.default_params
    known = [field.name for field in dataclasses.fields(default)]
    if isinstance(given, type(default)):
        changed: dict[Any, Any] = {field: getattr(given, field) for field in known}
    elif given is None or isinstance(given, Mapping):
        changed = dict(given or {})
    else:
        raise InputError(
            f"{env.name}: params must be those of this environment, or a dict of what differs from "
            f"env.default_params, not {shown(given)}"
        )
    for field, value in changed.items():
        if field not in known:
            raise InputError(f"{env.name} has no parameter {field!r}; {nearest(str(field), known)}")
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


# --- finding all states ------------------------------------------------------------------------------


class _Task:
    """How episodes begin and go on, as enumerations of the draws.

    Attributes:
        leaves: which leaves of the state of gymnax matter.
        first: all leaves of some start state.
        reset, step: their outputs are the leaves that matter, the time, and the observation; those of `step`
            also the reward, and whether the state is terminal.
    """

    def __init__(self, env: environment.Environment, params: Any):
        self.name, self.env, self.params = env.name, env, params
        if not isinstance(space := env.action_space(params), spaces.Discrete):
            raise InputError(f"{self.name}: actions must be discrete, and they are {shown(space)}")
        if type(env).is_truncated is not environment.Environment.is_truncated:
            raise InputError(
                f"{self.name}: its own rule when to truncate is not understood, but max_steps_in_episode"
            )
        self.num_actions = int(space.n)
        limit = float(params.max_steps_in_episode)  # some environments have it as a float
        self.max_steps = whole(self.name, "max_steps_in_episode", int(limit) if limit.is_integer() else limit)

        def reset(key):
            observation, state = env.reset_env(key, params)
            return state, observation

        def step(key, state, action):
            observation, state, reward, terminal, _ = env.step_env(key, state, action, params)
            return state, reward, jnp.asarray(terminal, bool), observation

        first, observation = jax.tree.map(jnp.asarray, reset(rng.key(0)))
        self.names = list(_named(first))
        if "time" not in self.names:
            raise InputError(f"{self.name}: its state has no field `time`, which counts the steps")
        self.first, self.state_def = jax.tree.flatten(first)
        observed, self.observation_def = jax.tree.flatten(observation)

        begin, go_on = draws.Program(reset), draws.Program(step, first, jnp.int32(0))
        count, self.time = len(self.names), self.names.index("time")
        reward, terminal = count, count + 1
        seen = range(count + 2, count + 2 + len(observed))
        self.leaves: list[int] = []
        needed = lambda: sorted(
            i for i in go_on.arguments([*self.leaves, reward, terminal, *seen]) if i < count
        )
        while (more := needed()) != self.leaves:
            self.leaves = more
        self.reset = begin.enumerate([*self.leaves, self.time, *range(count, count + len(observed))])
        self.step = go_on.enumerate([*self.leaves, self.time, *seen, reward, terminal])

        size = len(self.leaves)
        *states, reward_is_exact, ending = (*self.step.is_exact[:size], *self.step.is_exact[-2:])
        self.states_are_exact = all((*self.reset.is_exact[:size], *states, ending))
        self.is_exact = self.states_are_exact and reward_is_exact

    def beginnings(self, keys: Any) -> "_Seen":
        """What may be at the start, [K, C]: for each key and choice."""
        given = jax.jit(_over_draws(self.reset.function))(self.reset.choices, keys)
        return _Seen.of(given, len(self.leaves))

    def transitions(self, block: int) -> Callable[[Any, list[np.ndarray]], "_Seen"]:
        """A function of keys and the leaves of B = `block` states [B, ...]: what may follow, [B, A, K, C]."""

        def step(choice, key, state, action):
            leaves = list(self.first)  # of no consequence, but for these:
            for i, x in zip(self.leaves, state, strict=True):
                leaves[i] = x
            return self.step.function(choice, key, jax.tree.unflatten(self.state_def, leaves), action)

        over_actions = jax.vmap(_over_draws(step, None, None), (None, None, None, 0))
        run = jax.jit(jax.vmap(over_actions, (None, None, 0, None), axis_size=block))
        actions = np.arange(self.num_actions, dtype=np.int32)
        return lambda keys, states: _Seen.of(run(self.step.choices, keys, states, actions), len(self.leaves))

    def check_time(self, seen: "_Seen", where: np.ndarray, before: Any) -> None:
        """Raises InputError unless the time is `before` + 1 and, if it matters, within the limit.

        Only the places of `where` are looked at.
        """
        time = seen.time[where]
        if (time != np.broadcast_to(before, where.shape)[where] + 1).any():
            raise InputError(
                f"{self.name}: `time` in its state does not count the steps, so its limit is unknown"
            )
        if self.time in self.leaves and (time > self.max_steps).any():
            raise InputError(
                f"{self.name}: what happens depends on the time, and only the time limit of {self.max_steps} "
                "steps ends its episodes: there is no end to its states"
            )

    def time_of(self, states: list[np.ndarray]) -> np.ndarray:
        """The time of states [B], where it matters; else 0."""
        if self.time in self.leaves:
            return states[self.leaves.index(self.time)]
        return np.zeros(len(states[0]) if states else 1, int)


def _over_draws(function: Callable[..., Any], *axes: Any) -> Callable[..., Any]:
    """`function` of a choice and a key, over keys [K] and choices [C]: [K, C]."""
    return jax.vmap(jax.vmap(function, (0, None, *axes)), (None, 0, *axes))


class _Seen(NamedTuple):
    """What may happen, arrays of any shape [...]: probabilities, and what a `_Task` gives."""

    prob: np.ndarray
    state: list[np.ndarray]
    time: np.ndarray
    observation: list[np.ndarray]

    @classmethod
    def of(cls, given: Any, size: int) -> "_Seen":
        outputs, low, high = jax.tree.map(np.asarray, given)
        return cls(draws.probabilities(low, high), outputs[:size], outputs[size], outputs[size + 1 :])


class _States:
    """The states that were found, numbered as they come."""

    def __init__(self, task: _Task):
        self.task = task
        self.states: list[list[np.ndarray]] = []  # the leaves that matter
        self.is_terminal: list[bool] = []
        self.observations: list[list[np.ndarray]] = []
        self._numbers: dict[bytes, int] = {}
        self._looks: dict[bytes, int] = {}  # observation -> the state that looks so, where episodes go on

    def add(self, seen: _Seen, observation: list[np.ndarray], terminal: np.ndarray) -> np.ndarray:
        """The numbers of the states that were seen, int [...]; -1 where the probability is 0."""
        number = np.full(seen.prob.shape, -1)
        possible = seen.prob > 0
        state, observation, terminal = jax.tree.map(
            lambda x: x[possible], (seen.state, observation, terminal)
        )
        if any(np.isnan(x).any() for x in [*state, *observation] if np.issubdtype(x.dtype, np.floating)):
            raise InputError(f"{self.task.name}: a state, or what is observed in it, is not a number (NaN)")
        states, looks = _bytes([*state, terminal]), _bytes(observation)
        both = np.concatenate([states, looks], axis=1)
        _, index, inverse = np.unique(both, axis=0, return_index=True, return_inverse=True)
        numbers = [
            self._add(
                states[i].tobytes(),
                looks[i].tobytes(),
                [x[i] for x in state],
                [x[i] for x in observation],
                bool(terminal[i]),
            )
            for i in index
        ]
        number[possible] = np.array(numbers)[inverse.ravel()]
        return number

    def _add(self, name: bytes, look: bytes, state: Any, observation: Any, terminal: bool) -> int:
        number = self._numbers.setdefault(name, len(self.states))
        if number == len(self.states):
            if number == MAX_STATES:
                raise InputError(
                    f"{self.task.name} has more than {MAX_STATES} states, too many for a table; "
                    "perhaps there is no end to them"
                )
            self.states.append(state)
            self.is_terminal.append(terminal)
            self.observations.append(observation)
        if not terminal and (other := self._looks.setdefault(look, number)) != number:
            differ = [
                self.task.names[i]
                for i, x, y in zip(self.task.leaves, self.states[other], state, strict=True)
                if not np.array_equal(x, y)
            ]
            raise InputError(
                f"{self.task.name}: what is observed is not a state, for two that differ in "
                f"{', '.join(differ)} look the same; a table of states would know what cannot be known"
            )
        return number

    def numbering(self) -> tuple[np.ndarray, int]:
        """The final number of each state, int [n], and how many numbers there are."""
        space = self.task.env.observation_space(self.task.params)
        if isinstance(space, spaces.Discrete) and space.n <= MAX_STATES:
            number = np.array([int(x) for (x,) in self.observations])
            if number.min() >= 0 and number.max() < space.n and len(np.unique(number)) == len(number):
                return number, space.n
        columns = [*zip(*self.states, strict=True), self.is_terminal]
        columns = np.concatenate([np.array(x).reshape(len(self.states), -1) for x in columns], axis=1)
        return np.argsort(np.lexsort(columns.T[::-1])), len(self.states)


def _bytes(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """The rows of arrays [n, ...] as bytes, uint8 [n, bytes]."""
    n = len(arrays[0])
    flat = [np.ascontiguousarray(x.reshape(n, -1)).view(np.uint8) for x in arrays if x.size]
    return np.concatenate([np.zeros((n, 0), np.uint8), *flat], axis=1)


def _check_countable(task: _Task, seen: _Seen) -> None:
    """Raises InputError where a real number of the start state is another one with each key."""
    for i, x in zip(task.leaves, seen.state, strict=True):
        if len(x) > 1 and np.issubdtype(x.dtype, np.floating) and len(np.unique(x, axis=0)) == len(x):
            raise InputError(
                f"{task.name}: {len(x)} keys give {len(x)} different values of {task.names[i]} in the start "
                "state, as if from a continuum; a table needs few states"
            )


def _explore(task: _Task, found: _States) -> tuple[dict[int, float], list[Any]]:
    """Finds all states, breadth first. Returns the probabilities of start states, and outcomes [S][A]."""
    keys = jax.random.split(rng.key(0), 1 if task.states_are_exact else KEYS)
    seen = task.beginnings(keys)
    _check_countable(task, seen)
    numbers = found.add(seen, seen.observation, np.zeros(seen.prob.shape, bool))
    start: dict[int, float] = {}
    for i in map(tuple, np.argwhere(numbers >= 0)):
        start[int(numbers[i])] = start.get(int(numbers[i]), 0.0) + float(seen.prob[i]) / len(keys)
    task.check_time(seen, seen.prob > 0, before=-1)

    block = max(1, LANES // (task.num_actions * len(keys) * len(task.step.choices)))
    step = task.transitions(block)
    outcomes: list[list[list[tuple[float, int, float]]]] = []
    while len(outcomes) < len(found.states):
        todo = np.arange(len(outcomes), min(len(outcomes) + block, len(found.states)))
        outcomes += [[[] for _ in range(task.num_actions)] for _ in todo]
        todo = todo[~np.array(found.is_terminal)[todo]]
        if not len(todo):
            continue
        padded = np.resize(todo, block)  # of one size, so that one program does
        states = [np.array(x) for x in zip(*(found.states[s] for s in padded), strict=True)]
        given = step(keys, states)
        seen = jax.tree.map(lambda x: x[: len(todo)], given)  # noqa: B023
        *observation, reward, terminal = seen.observation
        reward = draws.exact(reward)
        numbers = found.add(seen, observation, terminal)
        task.check_time(
            seen, (seen.prob > 0) & ~terminal, task.time_of(states)[: len(todo), None, None, None]
        )
        for i in map(tuple, np.argwhere(numbers >= 0)):
            outcomes[todo[i[0]]][i[1]].append((seen.prob[i] / len(keys), int(numbers[i]), reward[i]))
    return start, outcomes


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
        return next((name for name, cls in ENVS.items() if cls is type(self.env)), type(self.env).__name__)

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
        there, action = available_actions(self.env), jnp.asarray(action, jnp.int32)
        if there is not None:
            action = stand_ins(there)[state.s, action]
        outcome = self.env.step(key, state.s, action)
        s, terminal = jnp.asarray(outcome.s_next, jnp.int32), jnp.asarray(outcome.terminal, bool)
        reward = jnp.asarray(outcome.reward, float)
        state = TabularState(time=state.time + 1, s=s, terminal=terminal)
        info = {"discount": self.discount(state, params)}
        return s, state, reward, terminal, info if there is None else {**info, "action_mask": there[s]}

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
