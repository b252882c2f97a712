"""Gymnasium, both ways."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from jaxrl_tab import planning, rng
from jaxrl_tab.envs import ENVS, FiniteMDP
from jaxrl_tab.envs.base import MAX_STEPS
from jaxrl_tab.types import Environment, FiniteEnvironment, InputError, check_pytree, shown


def from_gymnasium(env: Any, **parameters: Any) -> FiniteMDP:
    """An environment of Gymnasium that has a table `P` of what may happen, such as Taxi-v4, as a finite MDP.

    States keep their numbers. Outcomes that are equal are added up. A state is terminal where an outcome
    says so (what `P` says of leaving it is not looked at); one that is entered both ways gets a second
    number for it, after all others. In states that cannot be reached from the start, what leads to a
    terminal state ends the episode.

    Args:
        env: the name of a registered environment, or an environment, wrapped or not.
        parameters: what the environment is made with: `from_gymnasium("FrozenLake-v1", is_slippery=False)`.

    Raises:
        InputError: the name or a parameter is wrong, or the environment has no table, or one that is wrong.
    """
    if isinstance(env, str):
        env = _make(env, parameters)
    elif parameters:
        raise InputError(f"{', '.join(parameters)}: parameters go with the name of an environment")
    if not isinstance(env, gymnasium.Env):
        raise InputError(f"env must be the name of an environment of Gymnasium, or one, not {shown(env)}")
    inner = env.unwrapped
    name = env.spec.id if env.spec else type(inner).__name__
    table, start = (getattr(inner, x, None) for x in ("P", "initial_state_distrib"))
    if table is None or start is None:
        raise InputError(
            f"{name} has no table of its outcomes (`P` and `initial_state_distrib`), so only an environment "
            "such as FrozenLake-v1, Taxi-v4 or CliffWalking-v1 can be imported"
        )
    if getattr(inner, "fickle_passenger", False):
        raise InputError(
            f"{name}: the moods of a fickle passenger are not in its table; leave fickle_passenger"
        )
    limit = env.spec.max_episode_steps if env.spec else None
    outcomes, terminal = _outcomes(table, np.asarray(start, float))
    start = np.append(start, np.zeros(len(outcomes) - len(start)))
    return FiniteMDP.from_outcomes(outcomes, terminal, start, limit or MAX_STEPS)


def _make(name: str, parameters: Mapping[str, Any]) -> gymnasium.Env:
    try:
        return gymnasium.make(name, **parameters)
    except gymnasium.error.Error as error:
        raise InputError(f"gymnasium: {' '.join(str(error).split())}") from None
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: {error}") from None


def _outcomes(
    table: Mapping[int, Mapping[int, list]], start: np.ndarray
) -> tuple[list[list[list[tuple[float, int, float]]]], list[int]]:
    """The outcomes [S][A] in Gymnasium's `table`, and the terminal states."""
    todo = list(map(int, np.flatnonzero(start)))
    ends: set[int] = set()
    goes_on = set(todo)
    while todo:
        for p, s_next, _, done in (x for listed in table[todo.pop()].values() for x in listed):
            if p > 0 and done:
                ends.add(int(s_next))
            elif p > 0 and s_next not in goes_on:
                goes_on.add(int(s_next))
                todo.append(int(s_next))
    second = {s: len(table) + i for i, s in enumerate(sorted(ends & goes_on))}

    def entered(s_next: int, done: bool = True) -> int:
        return second.get(int(s_next), int(s_next)) if done else int(s_next)

    outcomes = [
        [[(p, entered(s_next, done), r) for p, s_next, r, done in listed] for listed in actions.values()]
        for _, actions in sorted(table.items())
    ]
    blank = [[] for _ in outcomes[0]]
    return outcomes + [blank] * len(second), [entered(s) for s in ends]


class Tabular(gymnasium.Env):
    """An environment of ours as one of Gymnasium; see `to_gymnasium`."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, env: Environment):
        self.env = env
        name = next((name for name, cls in ENVS.items() if cls is type(env)), type(env).__name__)
        self.spec = EnvSpec(
            f"jaxrl_tab/{name}-v0",
            entry_point=f"{__name__}:Tabular",
            max_episode_steps=env.max_steps,
            kwargs={"env": env},
        )
        self.observation_space = spaces.Discrete(env.num_states)
        self.action_space = spaces.Discrete(env.num_actions)
        self._reset, self._step = jax.jit(env.reset), jax.jit(env.step)
        self._s: int | None = None
        self._steps = 0
        if isinstance(env, FiniteEnvironment):
            self.P, self.initial_state_distrib = _table(env)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[int, dict]:
        super().reset(seed=seed)
        self._s, self._steps = int(self._reset(self._key())), 0
        return self._s, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict]:
        if self._s is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        if not self.action_space.contains(action):
            raise InputError(f"action must be one of 0 to {self.env.num_actions - 1}, not {shown(action)}")
        outcome = self._step(self._key(), self._s, int(action))
        self._s, self._steps = int(outcome.s_next), self._steps + 1
        terminated = bool(outcome.terminal)
        truncated = not terminated and self._steps >= self.env.max_steps
        return self._s, float(outcome.reward), terminated, truncated, {}

    def _key(self) -> jax.Array:
        return rng.key(int(self.np_random.integers(2**32)))


def _table(env: FiniteEnvironment) -> tuple[dict[int, dict[int, list]], np.ndarray]:
    """Gymnasium's `P[s][a]`, lists of (probability, s', reward, done), and the start distribution [S]."""
    model = planning.exact_model(env)
    fields = [x.tolist() for x in model[:4]]
    table = {
        s: {
            a: [outcome for outcome in zip(*(x[s][a] for x in fields), strict=True) if outcome[0] > 0]
            for a in range(env.num_actions)
        }
        for s in range(env.num_states)
    }
    return table, model.start


def to_gymnasium(env: Environment) -> Tabular:
    """`env` as an environment of Gymnasium, which passes `gymnasium.utils.env_checker.check_env`.

    Observations are the numbers of states. A finite MDP has the table `P` and `initial_state_distrib` that
    Gymnasium's own tabular environments have. The time limit truncates, as it does here; there is nothing to
    render. `reset(seed=...)` makes what follows reproducible. An environment that draws the problem of each
    run, such as the k-armed testbed, keeps the one that it holds: give `env.instance(key)`.

    Raises:
        InputError: `env` is no environment of ours.
    """
    check_pytree("env", env, ENVS)
    return Tabular(env)
