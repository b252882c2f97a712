"""An episode of a run, step by step, while the method learns; and what the run learns over time."""

import dataclasses
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray

from jaxrl_tab.core import rng
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import InputError, whole
from jaxrl_tab.core.experience import Experience
from jaxrl_tab.core.names import registered_name
from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.steps import Change, Seen, Steps
from jaxrl_tab.core.types import Algorithm, Environment, fitted, init_learner, table_of
from jaxrl_tab.engine import stepwise
from jaxrl_tab.engine.budget import Tables
from jaxrl_tab.engine.results import label, parameters
from jaxrl_tab.engine.train import checked_pair, train
from jaxrl_tab.envs import name_of
from jaxrl_tab.methods import METHODS
from jaxrl_tab.show import learning
from jaxrl_tab.show.steps import Told
from jaxrl_tab.show.tasks import policy_of
from jaxrl_tab.show.words import counted, label_of, title_of

EPISODES = 500  # of a run, where nobody says how many
MOMENTS = 40  # at which learning is shown
RECORDED = 200  # rows in which a run records its table, about


class OverTime(NamedTuple):
    """What a run had learned at some moments.

    Attributes:
        episodes: how many episodes were over, int [moments], ascending from 0.
        q: the table of values then, float [moments, S, A]; in prediction [moments, S, 1].
    """

    episodes: Int[np.ndarray, " moments"]
    q: Float[np.ndarray, "moments S A"]


@dataclasses.dataclass(frozen=True, eq=False)
class Watched:
    """An episode of a run, as `watch` gives it. In a notebook it shows its steps.

    Attributes:
        env, algorithm: the environment, and the method with its hyperparameters.
        seed, root_seed: whose random numbers these are: those of this seed in a sweep of this root.
        num_episodes: how many episodes the run has.
        at: which of them this is, from 1.
        before: the table of values before the episode, as `q`; where states cannot be counted, the weights [n, A].
        steps: what happened, and what was learned, step by step.
        learner: the state of the learner after the episode.
    """

    env: Any
    algorithm: Any
    seed: int
    root_seed: int
    num_episodes: int
    at: int
    before: Float[np.ndarray, "S A"]
    steps: Steps
    learner: Any

    @property
    def q(self) -> Float[np.ndarray, "S A"]:
        """The table of values after the episode, float [S, A]; in prediction V as [S, 1]."""
        return _table(self.algorithm, self.env, self.learner)

    @property
    def name(self) -> str:
        """What is watched, for people."""
        values = {name: label(x) for name, x in parameters(self.algorithm).items() if np.ndim(x) == 0}
        setting = {name: x for name, x in values.items() if x is not None and x is not False}
        method = label_of(registered_name(METHODS, type(self.algorithm)), setting)
        return f"{method}, in {title_of(name_of(self.env))}"

    @property
    def told(self) -> Told:
        """The episode as a table for people."""
        return Told(self.env, self.steps, of_method(self.algorithm).learns, float(self.algorithm.gamma))

    @cached_property
    def over_time(self) -> OverTime:
        """What the run had learned at some 40 moments, of which most are early; it is run again for that."""
        every = -(-self.num_episodes // RECORDED)
        key = _key(self.root_seed, self.seed)
        _, log = train(
            key,
            self.algorithm,
            self.env,
            num_episodes=self.num_episodes,
            log_every=every,
            record=Tables(self.env.num_states),
        )
        assert log.recorded is not None
        tables = np.asarray(log.recorded["table"])
        rows = np.unique(np.rint(np.geomspace(1, len(tables), MOMENTS)).astype(int))
        before = _table(self.algorithm, self.env, _first_learner(self.algorithm, self.env))
        episodes = np.minimum(rows * every, self.num_episodes)
        return OverTime(np.append(0, episodes), np.concatenate([before[None], tables[rows - 1]]))

    def save(self, file: Path | str) -> Path:
        """Writes what the run learns over time as an animation: `learning.gif`, or a page `learning.html`.

        A grid shows the value of each cell and the greedy actions; so do the tables in which people see the
        states of Blackjack; any other environment shows the value of each action in each state.

        Raises:
            InputError: the file has another ending, is there already, or cannot be written; or the environment
                has no picture.
        """
        file = learning.check(file, self.env)
        learning.write(file, self._pictures, self._titles, self.name)
        return file

    @property
    def _titles(self) -> list[str]:
        total = counted(self.num_episodes, "episodes")
        return [f"after {n:,} of {total}".replace(",", " ") for n in self.over_time.episodes]

    @cached_property
    def _pictures(self) -> Any:
        tables, what = self.over_time.q, ""
        if of_method(self.algorithm).learns is Learns.PREFERENCES:
            tables, what = policy_of(tables), ": probabilities of actions"
        titles = [f"{self.name}\n{title}{what}" for title in self._titles]
        return learning.pictures(self.env, tables, titles)

    def __repr__(self) -> str:
        steps = counted(len(self.steps), "steps")
        return f"<Watched: {self.name}: episode {self.at} of {self.num_episodes}, seed {self.seed}, {steps}>"

    def _repr_html_(self) -> str:
        told = self.told
        title = f"{self.name}: episode {self.at} of {self.num_episodes}, seed {self.seed}. {told.end}"
        return table(title, told.head, told.rows())


def watch(
    env: Environment | Algorithm,
    algorithm: Algorithm | Environment,
    *,
    num_episodes: int = EPISODES,
    at: int | None = None,
    seed: int = 0,
    root_seed: int = 0,
) -> Watched:
    """An episode of a run, step by step, while the method learns.

    It is an episode of the run that `sweep` makes with this seed: the same random numbers, and so the same
    states, actions and values, to the last bit.

    Args:
        env: the environment.
        algorithm: the method with its hyperparameters. It may also stand before the environment, as in `train`.
        num_episodes: how many episodes the run has.
        at: which of them to watch, 1 to `num_episodes`; by default the last.
        seed: the number of the seed, as the results of a sweep have it: the first is 0.
        root_seed: the `seed` of that sweep.

    Raises:
        InputError: something given is wrong; nothing was compiled.
    """
    algorithm, env = checked_pair(algorithm, env)
    whole("watch", "num_episodes", num_episodes)
    at = num_episodes if at is None else whole("watch", "at", at)
    for name, value in (("seed", seed), ("root_seed", root_seed)):
        whole("watch", name, value, 0)
    if at > num_episodes:
        raise InputError(
            f"episode {at} is beyond the {counted(num_episodes, 'episodes')} of the run: let it have more",
            who="watch",
            field="at",
        )
    if not env.num_states and hasattr(algorithm, "network"):
        raise InputError(
            f"watch shows the weights of features where states cannot be counted, and {type(algorithm).__name__} has "
            "a network"
        )
    if jax.eval_shape(lambda: _first_learner(algorithm, env).q).ndim != 2:
        raise InputError(
            f"watch shows one table of values [S, A], and {type(algorithm).__name__} has several"
        )
    key = _key(root_seed, seed)
    episode = _episode(key, algorithm, env, at)
    return Watched(env, algorithm, int(seed), int(root_seed), int(num_episodes), at, *episode)


def _key(root_seed: int, seed: int) -> PRNGKeyArray:
    """The key of a run in a sweep; see `part.Part`."""
    return jax.random.fold_in(rng.key(root_seed), seed)


def _first_learner(algorithm: Any, env: Any) -> Any:
    return init_learner(fitted(algorithm, env), env)


def _table(algorithm: Any, env: Any, learner: Any) -> Float[np.ndarray, "S A"]:
    return np.asarray(table_of(fitted(algorithm, env), env.num_states, learner))


def _episode(key: PRNGKeyArray, algorithm: Any, env: Any, at: int) -> tuple[np.ndarray, Steps, Any]:
    """Of episode `at` of a run: the table of values before it, its steps, and the learner after it."""
    if at == 1:
        run = stepwise.at_start(key, algorithm, env)
    else:
        learner, log = train(key, algorithm, env, num_episodes=at - 1)
        run = stepwise.after_episode(key, algorithm, env, learner, log.steps.sum())
    transitions, deltas, changes, last = [], [], [], False
    before = q = _table(algorithm, env, run.learner)
    while not last:
        run, step = stepwise.next_step(key, algorithm, env, run)
        (t, terminal), delta, after = jax.device_get(step)
        transitions.append((t.s, t.a, t.r, t.s_next, terminal, t.last))
        deltas.append(delta)
        changes.append(Change.between(q, after))
        q, last = after, bool(t.last)
    seen = map(np.array, zip(*transitions, strict=True))
    experience = Experience(*seen) if env.num_states else Seen(*seen)
    return before, Steps(experience, np.array(deltas), tuple(changes)), run.learner
