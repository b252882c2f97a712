"""All states of an environment of gymnax that can be reached, and what may happen in them; see `from_gymnax`."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnax.environments import environment, spaces

from jaxrl_tab.core import rng
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.interop import draws

MAX_STATES = 20_000  # of an imported task: with more a table is no way to learn, and finding them is slow
LANES = 16_384  # transitions that are worked out at once
KEYS = 64  # tried for each state and action where draws cannot be enumerated


def named(state: Any) -> dict[str, Any]:
    """The leaves of a state of gymnax, in their order."""
    return {jax.tree_util.keystr(path)[1:]: x for path, x in jax.tree.leaves_with_path(state)}


class Task:
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
        self.names = list(named(first))
        if "time" not in self.names:
            raise InputError(f"{self.name}: its state has no field `time`, which counts the steps")
        self.first, self.state_def = jax.tree.flatten(first)
        observed, self.observation_def = jax.tree.flatten(observation)

        begin, go_on = draws.Program(reset), draws.Program(step, first, jnp.int32(0))
        count, self.time = len(self.names), self.names.index("time")
        reward, terminal = count, count + 1
        seen = range(count + 2, count + 2 + len(observed))
        self.leaves: list[int] = []
        # What the leaves that matter depend on matters too, until there are no more.
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

    @functools.cached_property
    def start(self) -> tuple[Any, "Seen"]:
        """Keys [K], and what may be at the start, [K, C]: for each key and choice."""
        keys = jax.random.split(rng.key(0), 1 if self.states_are_exact else KEYS)
        outcomes = jax.jit(_over_draws(self.reset.function))(self.reset.choices, keys)
        return keys, Seen.of(outcomes, len(self.leaves))

    def transitions(self, block: int) -> Callable[[Any, list[np.ndarray]], "Seen"]:
        """A function of keys and the leaves of B = `block` states [B, ...]: what may follow, [B, A, K, C]."""

        def step(choice, key, state, action):
            leaves = list(self.first)  # those that do not matter may have any value
            for i, x in zip(self.leaves, state, strict=True):
                leaves[i] = x
            return self.step.function(choice, key, jax.tree.unflatten(self.state_def, leaves), action)

        over_actions = jax.vmap(_over_draws(step, None, None), (None, None, None, 0))
        run = jax.jit(jax.vmap(over_actions, (None, None, 0, None), axis_size=block))
        actions = np.arange(self.num_actions, dtype=np.int32)
        return lambda keys, states: Seen.of(run(self.step.choices, keys, states, actions), len(self.leaves))

    def check_time(self, seen: "Seen", where: np.ndarray, before: Any) -> None:
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


class Seen(NamedTuple):
    """What may happen, arrays of any shape [...]: probabilities, and what a `Task` gives."""

    prob: np.ndarray
    state: list[np.ndarray]
    time: np.ndarray
    observation: list[np.ndarray]

    @classmethod
    def of(cls, outcomes: Any, size: int) -> "Seen":
        outputs, low, high = jax.tree.map(np.asarray, outcomes)
        return cls(draws.probabilities(low, high), outputs[:size], outputs[size], outputs[size + 1 :])


class States:
    """The states that were found, numbered as they come."""

    def __init__(self, task: Task):
        self.task = task
        self.states: list[list[np.ndarray]] = []  # the leaves that matter
        self.is_terminal: list[bool] = []
        self.observations: list[list[np.ndarray]] = []
        self._numbers: dict[bytes, int] = {}
        self._looks: dict[bytes, int] = {}  # observation -> the state that looks so, where episodes go on

    def add(self, seen: Seen, observation: list[np.ndarray], terminal: np.ndarray) -> np.ndarray:
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
        # The inverse of the order by the first column, then the second, ...: the rank of each state.
        return np.argsort(np.lexsort(columns.T[::-1])), len(self.states)


def _bytes(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """The rows of arrays [n, ...] as bytes, uint8 [n, bytes]."""
    n = len(arrays[0])
    flat = [np.ascontiguousarray(x.reshape(n, -1)).view(np.uint8) for x in arrays if x.size]
    return np.concatenate([np.zeros((n, 0), np.uint8), *flat], axis=1)


def continuum(task: Task) -> str | None:
    """Of the start state a real number that is another one with each key; None where there is none."""
    seen = task.start[1]
    for i, x in zip(task.leaves, seen.state, strict=True):
        if len(x) > 1 and np.issubdtype(x.dtype, np.floating) and len(np.unique(x, axis=0)) == len(x):
            return task.names[i]
    return None


def explore(task: Task, reached: States) -> tuple[dict[int, float], list[Any]]:
    """Finds all states, breadth first. Returns the probabilities of start states, and outcomes [S][A]."""
    keys, seen = task.start
    numbers = reached.add(seen, seen.observation, np.zeros(seen.prob.shape, bool))
    start: dict[int, float] = {}
    for i in map(tuple, np.argwhere(numbers >= 0)):
        start[int(numbers[i])] = start.get(int(numbers[i]), 0.0) + float(seen.prob[i]) / len(keys)
    task.check_time(seen, seen.prob > 0, before=-1)

    block = max(1, LANES // (task.num_actions * len(keys) * len(task.step.choices)))
    step = task.transitions(block)
    outcomes: list[list[list[tuple[float, int, float]]]] = []
    while len(outcomes) < len(reached.states):
        todo = np.arange(len(outcomes), min(len(outcomes) + block, len(reached.states)))
        outcomes += [[[] for _ in range(task.num_actions)] for _ in todo]
        todo = todo[~np.array(reached.is_terminal)[todo]]
        if not len(todo):
            continue
        padded = np.resize(todo, block)  # of one size, so that one program does
        states = [np.array(x) for x in zip(*(reached.states[s] for s in padded), strict=True)]
        seen = step(keys, states)
        seen = jax.tree.map(lambda x: x[: len(todo)], seen)  # noqa: B023
        *observation, reward, terminal = seen.observation
        reward = draws.exact(reward)
        numbers = reached.add(seen, observation, terminal)
        task.check_time(
            seen, (seen.prob > 0) & ~terminal, task.time_of(states)[: len(todo), None, None, None]
        )
        for i in map(tuple, np.argwhere(numbers >= 0)):
            outcomes[todo[i[0]]][i[1]].append((seen.prob[i] / len(keys), int(numbers[i]), reward[i]))
    return start, outcomes
