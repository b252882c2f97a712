"""Gymnasium, both ways.

When this is imported, all of `ENVS` is registered there: `gymnasium.make("jaxrl_tab/WindyGridworld-v0", moves="king")`.
Gymnasium imports it where the name says so: `gymnasium.make("jaxrl_tab.interop.gymnasium:jaxrl_tab/Taxi-v0")`.
"""

import copy
import functools
import inspect
import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces, wrappers
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.envs.toy_text.blackjack import BlackjackEnv

from jaxrl_tab.core import rng
from jaxrl_tab.core.checks import check_pytree
from jaxrl_tab.core.errors import InputError, check_choice, shown
from jaxrl_tab.core.types import Environment, FiniteEnvironment, available_actions, stand_ins
from jaxrl_tab.envs import ENVS, FiniteMDP
from jaxrl_tab.envs import make as make_ours
from jaxrl_tab.envs.base import MAX_STEPS
from jaxrl_tab.exact import planning
from jaxrl_tab.interop import pictures

# Wrappers that change no reward, action, observation, end or dynamics of an episode, by their exact class.
HARMLESS = (
    wrappers.OrderEnforcing,
    wrappers.PassiveEnvChecker,
    wrappers.RecordEpisodeStatistics,
    wrappers.HumanRendering,
    wrappers.RecordVideo,
    wrappers.RenderCollection,
    wrappers.AddWhiteNoise,  # this and the next change pictures only
    wrappers.ObstructView,
)
TRIED = 1000  # steps in which a table is compared with what an environment does


def from_gymnasium(env: Any, **parameters: Any) -> FiniteMDP:
    """An environment of Gymnasium that has a table `P` of what may happen, such as Taxi-v4, as a finite MDP.

    States and actions keep their numbers. Terminal states go by the flags of the table, as in
    `FiniteMDP.from_outcomes`, which takes a table by itself, whatever is around it. The time limit is that of
    the wrapper `TimeLimit`. Other wrappers are refused, unless they are known to change nothing. An environment
    that is not of Gymnasium itself is tried for 1000 random steps: what it does must be in its table.

    Args:
        env: the name of a registered environment, or an environment, wrapped or not.
        parameters: what the environment is made with: `from_gymnasium("FrozenLake-v1", is_slippery=False)`.

    Raises:
        InputError: the name or a parameter is wrong; the environment has no table, or one that is wrong; or what
            it does is not what the table says.
    """
    if isinstance(env, str | EnvSpec):
        env = _make(env, parameters)
    elif parameters:
        raise InputError(f"{', '.join(parameters)}: parameters go with the name of an environment")
    if isinstance(env, gymnasium.vector.VectorEnv):
        raise InputError("env is a vector of environments, and one is wanted: give its name, or env.envs[0]")
    if not isinstance(env, gymnasium.Env):
        hint = "; FiniteMDP.from_outcomes takes a table by itself" if isinstance(env, Mapping) else ""
        raise InputError(
            f"env must be the name of an environment of Gymnasium, or one, not {shown(env)}{hint}"
        )
    inner = env.unwrapped
    name = env.spec.id if env.spec else type(inner).__name__
    limit = _limit(name, env)
    table, start = (getattr(inner, x, None) for x in ("P", "initial_state_distrib"))
    if table is None or start is None:
        raise InputError(
            f"{name} has no table of its outcomes (`P` and `initial_state_distrib`); {_instead(inner)}"
        )
    if getattr(inner, "fickle_passenger", False):
        raise InputError(
            f"{name}: fickle_passenger changes what happens, and its table does not show that; leave it out"
        )
    mdp = FiniteMDP.from_outcomes(table, (), start, limit)
    _check_spaces(name, inner, len(table), mdp.num_actions)
    _check_steps(name, inner, limit)
    return mdp


def arguments(name: str) -> dict[str, Any]:
    """The keyword arguments of a registered environment, but for how it is rendered, with their defaults."""
    try:
        spec = gymnasium.spec(name)
        creator = (
            load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
        )
    except (gymnasium.error.Error, ImportError) as error:
        raise InputError(f"gymnasium: {' '.join(str(error).split())}") from None
    keywords = inspect.signature(creator).parameters if creator else {}
    return {
        key: spec.kwargs.get(key, keyword.default)
        for key, keyword in keywords.items()
        if key != "render_mode" and keyword.default is not keyword.empty
    }


by_name = from_gymnasium  # the name under which `interop` looks for it in the module of each library


def _make(name: str | EnvSpec, parameters: Mapping[str, Any]) -> gymnasium.Env:
    try:
        return gymnasium.make(name, **parameters)
    except gymnasium.error.Error as error:
        raise InputError(f"gymnasium: {' '.join(str(error).split())}") from None
    except Exception as error:  # whatever its constructor makes of them
        raise InputError(
            f"{getattr(name, 'id', name)}: {' '.join(str(error).split()) or type(error).__name__}"
        ) from None


def _limit(name: str, env: gymnasium.Env) -> int:
    """The time limit of episodes. Raises InputError where a wrapper is not known to change nothing."""
    inner, limits = env.unwrapped, []
    while isinstance(env, gymnasium.Wrapper):
        if type(env) is wrappers.TimeLimit:
            limits.append(env._max_episode_steps)
        elif type(env) not in HARMLESS:
            raise InputError(
                f"{name}: the table `P` does not know what the wrapper {type(env).__name__} changes; "
                "import env.unwrapped, which is the environment without it"
            )
        env = env.env
    if isinstance(inner, Tabular):
        limits.append(inner.env.max_steps)
    if not limits and inner.spec and inner.spec.max_episode_steps:
        limits.append(inner.spec.max_episode_steps)
    return min(limits, default=MAX_STEPS)


def _instead(inner: gymnasium.Env) -> str:
    """What to do about an environment that has no table."""
    if isinstance(inner, BlackjackEnv):
        return (
            'rl.make("blackjack", rules="gymnasium") is that game with sab=False, and has one; '
            'with sab=True, which is the default of Blackjack-v1, it is rules="gymnasium-sab"'
        )
    return "only an environment such as FrozenLake-v1, Taxi-v4 or CliffWalking-v1 can be imported"


def _check_spaces(name: str, inner: gymnasium.Env, num_states: int, num_actions: int) -> None:
    """Raises InputError unless the spaces of `inner`, where it has some, are as large as its table."""
    for what, size in (("observation", num_states), ("action", num_actions)):
        space = getattr(inner, f"{what}_space", None)
        if space is not None and not (
            isinstance(space, spaces.Discrete) and (space.start, space.n) == (0, size)
        ):
            raise InputError(f"{name}: its table has {size} {what}s, and its {what}_space is {shown(space)}")


def _check_steps(name: str, inner: gymnasium.Env, limit: int) -> None:
    """Raises InputError where some steps of `inner` do what is not in its table.

    Environments of Gymnasium itself, and of ours, draw their steps from the table; one that has no `step` has
    nothing to compare.
    """
    draws = type(inner).__module__.startswith("gymnasium.envs.toy_text.") or type(inner) is Tabular
    if draws or type(inner).step is gymnasium.Env.step:
        return
    hint = (
        "FiniteMDP.from_outcomes takes env.unwrapped.P alone, with start=env.unwrapped.initial_state_distrib"
    )
    try:
        wrong = _wrong_step(inner, limit)
    except Exception as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{name}: its steps could not be compared with its table ({why}); {hint}") from None
    if wrong:
        raise InputError(f"{name}: {wrong}, which its table P does not have; {hint}")


def _wrong_step(inner: Any, limit: int) -> str:
    """What a copy of `inner` does in TRIED random steps that its table does not have, or ""."""
    env, choose = copy.deepcopy(inner), np.random.default_rng(0)
    env.render_mode = None
    s, count = int(env.reset(seed=0)[0]), 0
    for _ in range(TRIED):
        if count == 0 and not env.initial_state_distrib[s] > 0:
            return f"an episode starts in state {s}"
        a = int(choose.integers(len(env.P[s])))
        s_next, reward, terminated, truncated, _ = env.step(a)
        s_next, reward, count = int(s_next), float(reward), count + 1
        if not any(
            p > 0 and to == s_next and done == terminated and math.isclose(r, reward, rel_tol=1e-6)
            for p, to, r, done in env.P[s][a]
        ):
            ending = ", terminated" if terminated else ""
            return f"action {a} in state {s} was followed by state {s_next} with reward {reward:g}{ending}"
        if truncated and not terminated and count < limit:
            return f"an episode was truncated after {count} steps"
        ended = terminated or truncated
        s, count = (int(env.reset()[0]), 0) if ended else (s_next, count)
    return ""


class Tabular(gymnasium.Env):
    """An environment of ours as one of Gymnasium; see `to_gymnasium`."""

    metadata = {"render_modes": ["ansi", "rgb_array"], "render_fps": 4}  # noqa: RUF012

    def __init__(self, env: Environment, render_mode: str | None = None):
        if render_mode is not None:
            check_choice(None, "render_mode", render_mode, self.metadata["render_modes"])
        self.env, self.render_mode = env, render_mode
        self.spec = EnvSpec(
            _id(type(env)),
            entry_point=f"{__name__}:Tabular",
            max_episode_steps=env.max_steps,
            kwargs={"env": env, "render_mode": render_mode},
        )
        self.observation_space = spaces.Discrete(env.num_states)
        self.action_space = spaces.Discrete(env.num_actions)
        self._reset, self._step = jax.jit(env.reset), jax.jit(env.step)
        available = available_actions(env)
        self._available = None if available is None else np.asarray(available)
        self._stand_ins = None if available is None else np.asarray(stand_ins(available))
        self._s: int | None = None
        self._action: int | None = None
        self._steps = 0

    @functools.cached_property
    def P(self) -> dict[int, dict[int, list]]:
        """What may follow each action in each state, P[s][a]: a list of (probability, s', reward, terminated)."""
        return _table(self._finite("P"))

    @functools.cached_property
    def initial_state_distrib(self) -> np.ndarray:
        """The distribution of the start state, float64 [S]."""
        return planning.exact_model(self._finite("initial_state_distrib")).start

    def _finite(self, name: str) -> FiniteEnvironment:
        if not isinstance(self.env, FiniteEnvironment):
            raise AttributeError(f"{type(self.env).__name__} can only be sampled, and has no {name}")
        return self.env

    def render(self) -> Any:
        """The state, by `render_mode`: None, a text ("ansi"), or pixels, uint8 [height, width, 3] ("rgb_array")."""
        if self._s is None:
            raise gymnasium.error.ResetNeeded("call reset before render")
        if self.render_mode is None:
            return None
        if self.render_mode == "ansi":
            return pictures.text(self.env, self._s, self._action)
        return pictures.pixels(self.env, self._s)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[int, dict]:
        super().reset(seed=seed)
        self._s, self._action, self._steps = int(self._reset(self._key())), None, 0
        return self._s, self._info()

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict]:
        if self._s is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        if not self.action_space.contains(action):
            raise InputError(f"action must be one of 0 to {self.env.num_actions - 1}, not {shown(action)}")
        action = int(action if self._stand_ins is None else self._stand_ins[self._s, action])
        outcome = self._step(self._key(), self._s, action)
        self._s, self._action, self._steps = int(outcome.s_next), action, self._steps + 1
        terminated = bool(outcome.terminal)
        truncated = not terminated and self._steps >= self.env.max_steps
        return self._s, float(outcome.reward), terminated, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        """Which actions there are, as Gymnasium's Taxi says it, where they are not all everywhere."""
        return {} if self._available is None else {"action_mask": self._available[self._s].astype(np.int8)}

    def _key(self) -> jax.Array:
        return rng.key(int(self.np_random.integers(2**32)))


def _table(env: FiniteEnvironment) -> dict[int, dict[int, list]]:
    """Gymnasium's `P[s][a]`, lists of (probability, s', reward, done)."""
    model = planning.exact_model(env)
    fields = [x.tolist() for x in model[:4]]
    return {
        s: {
            a: [outcome for outcome in zip(*(x[s][a] for x in fields), strict=True) if outcome[0] > 0]
            for a in range(env.num_actions)
        }
        for s in range(env.num_states)
    }


def to_gymnasium(env: Environment, render_mode: str | None = None) -> Tabular:
    """`env` as an environment of Gymnasium, which passes `gymnasium.utils.env_checker.check_env`.

    Observations are the numbers of states. A finite MDP has the table `P` and `initial_state_distrib` that
    Gymnasium's own tabular environments have. The time limit truncates, as it does here. `reset(seed=...)` makes what
    follows reproducible. `render` gives a text ("ansi") or a picture ("rgb_array"): a grid, or else a cell for each
    state, with the agent in it. An environment that draws the problem of each run, such as the k-armed testbed, keeps
    the one that it holds: give `env.instance(key)`.

    Where not all actions are available in each state, `info["action_mask"]`, int8 [A], says which are, and another
    one does what the first of these does. (`from_gymnasium` then takes it for a copy of that action.)

    Raises:
        InputError: `env` is no environment of ours.
    """
    check_pytree("env", env, ENVS)
    return Tabular(env, render_mode)


def make_registered(env_name: str, render_mode: str | None = None, **parameters: Any) -> Tabular:
    """What `gymnasium.make` makes of the name of a registered environment of ours, with its parameters."""
    return to_gymnasium(make_ours(env_name, **parameters), render_mode)


def _id(cls: type) -> str:
    """What an environment of ours is called in Gymnasium."""
    return f"jaxrl_tab/{cls.__name__}-v0"


for _name, _cls in ENVS.items():
    if _id(_cls) not in gymnasium.registry:
        gymnasium.register(_id(_cls), entry_point=f"{__name__}:make_registered", kwargs={"env_name": _name})
